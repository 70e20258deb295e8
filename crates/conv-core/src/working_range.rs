//! Scaling of light to values near 1, for light whose transforms would overflow or underflow.

use ndarray::{Array2, ArrayView2, CowArray, Ix2};

use crate::ConvReal;

/// A source that exceeds the mean of the other light by more than this factor is left out of
/// transforms. The transform would spread the rounding noise of the source over the whole tile, and
/// this noise would hide faint light.
pub(crate) fn contrast<T: ConvReal>() -> f64 {
    // About 250 in f32 and 1e11 in f64. The noise stays below a few 1e-6 of the faint light in f32,
    // and below 1e-5 in f64.
    3e-5 / T::epsilon().as_f64()
}

/// A source may exceed the mean of the other *sources* by this fraction of [`contrast`]. The noise is
/// then below a few 1e-6 of a faint star's PSF.
const OF_SOURCES: f64 = 0.1;

/// The brightest source that a tile of `pixels` may contain when it is transformed, if the tile's
/// other `sources` (lit pixels or stars) have this total flux.
pub(crate) fn brightest_allowed<T: ConvReal>(total: f64, sources: usize, pixels: usize) -> f64 {
    contrast::<T>() * (total / pixels as f64).max(OF_SOURCES * total / sources as f64)
}

/// A power of two that scales light to values near 1, and its inverse for the result. Multiplying
/// by these powers is exact. There are two exceptions: values that are negligible next to the
/// largest, and results that the precision cannot represent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rescaling<T> {
    pub(crate) down: T,
    pub(crate) back: T,
}

/// In f32, light is not scaled if its largest absolute value is between 2^-80 and 2^80. Sums over a
/// frame and products with kernels then neither overflow nor lose significant bits. f32 holds
/// 2^-126 to 2^128, so a factor of at least 2^46 is left at both ends.
const EXPONENTS_OF_F32: i32 = 80;
/// In f64, light is not scaled if its largest absolute value is between 2^-900 and 2^900. f64 holds
/// 2^-1022 to 2^1024.
const EXPONENTS_OF_F64: i32 = 900;

impl<T: ConvReal> Rescaling<T> {
    /// Returns the factors for light with this largest absolute value. `None` if the light needs no
    /// scaling, or if the value is zero or not finite.
    pub(crate) fn for_largest(largest: f64) -> Option<Self> {
        let (safe, most) = if size_of::<T>() == size_of::<f32>() {
            (EXPONENTS_OF_F32, 126)
        } else {
            (EXPONENTS_OF_F64, 1022)
        };
        let bound = 2_f64.powi(safe);
        if largest == 0.0 || (1.0 / bound..=bound).contains(&largest) || !largest.is_finite() {
            return None;
        }
        // Both powers are normal numbers, so they are exact.
        let exponent = (largest.log2().floor() as i32).clamp(-most, most);
        Some(Self {
            down: T::nearest(2_f64.powi(-exponent)),
            back: T::nearest(2_f64.powi(exponent)),
        })
    }

    /// Returns the scaled light and the power of two that scales its image back. If no scaling is
    /// needed, returns the light itself and `None`.
    pub(crate) fn of_pixels(light: ArrayView2<'_, T>) -> (CowArray<'_, T, Ix2>, Option<T>) {
        let largest = light.iter().fold(T::zero(), |m, v| m.max(v.abs()));
        match Self::for_largest(largest.as_f64()) {
            None => (light.into(), None),
            Some(scale) => (light.mapv(|v| v * scale.down).into(), Some(scale.back)),
        }
    }
}

/// Scales an image back if its light was scaled.
pub(crate) fn take_back<T: ConvReal>(image: &mut Array2<T>, back: Option<T>) {
    if let Some(back) = back {
        image.mapv_inplace(|v| v * back);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scales values back exactly. The smallest subnormal number lies `bits` bits below the smallest
    /// normal one.
    fn scales_exactly<T: ConvReal>(bits: i32, values: [f64; 5]) {
        for largest in values {
            let Rescaling { down, back } = Rescaling::<T>::for_largest(largest).unwrap();
            assert!(down * back == T::one() && down.is_normal() && back.is_normal());
            let near_one = T::nearest(largest) * down;
            let range = 2_f64.powi(-bits)..4.0;
            assert!(range.contains(&near_one.as_f64()), "{largest:e}: {near_one}");
            assert_eq!((near_one * back).as_f64(), largest);
        }
    }

    #[test]
    fn ordinary_light_is_left_alone_and_the_rest_is_scaled_exactly() {
        for largest in [0.0, 1e-24, 1.0, 1e8, 1e24] {
            assert_eq!(Rescaling::<f32>::for_largest(largest), None, "{largest}");
        }
        for largest in [1e-270, 1e270] {
            assert_eq!(Rescaling::<f64>::for_largest(largest), None, "{largest}");
        }
        let extreme = [f32::from_bits(1), 1e-38, 1e-30, 1e30, f32::MAX];
        scales_exactly::<f32>(23, extreme.map(f64::from));
        scales_exactly::<f64>(52, [f64::from_bits(1), 1e-308, 1e-300, 1e300, f64::MAX]);
    }
}
