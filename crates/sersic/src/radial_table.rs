//! The brightness of a profile at radii that many pixels need, from cubic pieces.

/// Pieces in a factor of two of the squared radius, as a power of two. A piece's error relative to the brightness is about
/// `(k / 2 / 32)^4 / 384`, `k = -d ln I / d ln r`: 6e-7 at `k = 8`.
const PIECES_LOG2: u32 = 5;
/// Bits of a double's mantissa within a piece.
const BITS_WITHIN: u32 = 52 - PIECES_LOG2;

/// Cubic pieces over the squared radius; the bits of a double name its piece.
#[derive(Debug)]
pub(crate) struct RadialTable {
    first: u64,
    /// Coefficients of the powers 0 to 3 of the place within the piece, from 0 to 1.
    pieces: Vec<[f64; 4]>,
}

impl RadialTable {
    /// `function` gives the value and the derivative by the squared radius. Both ends are positive and finite.
    pub(crate) fn new(
        lowest_squared: f64,
        highest_squared: f64,
        function: impl Fn(f64) -> (f64, f64),
    ) -> Self {
        let first = lowest_squared.to_bits() >> BITS_WITHIN;
        let last = (highest_squared.to_bits() >> BITS_WITHIN).max(first);
        let start_of = |piece: u64| f64::from_bits(piece << BITS_WITHIN);
        let (mut start, mut at_start) = (start_of(first), function(start_of(first)));
        let pieces = (first..=last).map(|piece| {
            let end = start_of(piece + 1);
            let at_end = function(end);
            let width = end - start;
            let (rise, slope, end_slope) = (at_end.0 - at_start.0, at_start.1 * width, at_end.1 * width);
            let coefficients = [
                at_start.0,
                slope,
                3.0 * rise - 2.0 * slope - end_slope,
                slope + end_slope - 2.0 * rise,
            ];
            (start, at_start) = (end, at_end);
            coefficients
        });
        Self {
            first,
            pieces: pieces.collect(),
        }
    }

    /// The value at a squared radius; `None` outside the table.
    #[inline]
    pub(crate) fn value(&self, squared: f64) -> Option<f64> {
        let (_, [c0, c1, c2, c3], place) = self.piece(squared)?;
        Some(c0 + place * (c1 + place * (c2 + place * c3)))
    }

    /// The value and its first two derivatives by the squared radius; the second is good to `(k / 2 / 32)^2 / 12`, about 1e-3.
    #[inline]
    pub(crate) fn derivatives(&self, squared: f64) -> Option<[f64; 3]> {
        let (piece, [c0, c1, c2, c3], place) = self.piece(squared)?;
        // The width of a piece is a power of two: its inverse is exact.
        let per_width =
            (f64::from_bits((piece + 1) << BITS_WITHIN) - f64::from_bits(piece << BITS_WITHIN)).recip();
        Some([
            c0 + place * (c1 + place * (c2 + place * c3)),
            (c1 + place * (2.0 * c2 + place * 3.0 * c3)) * per_width,
            (2.0 * c2 + 6.0 * place * c3) * per_width * per_width,
        ])
    }

    /// The number of the piece, its coefficients, and the place in it.
    #[inline]
    fn piece(&self, squared: f64) -> Option<(u64, [f64; 4], f64)> {
        const WITHIN: u64 = (1 << BITS_WITHIN) - 1;
        let bits = squared.to_bits();
        let piece = bits >> BITS_WITHIN;
        let index = usize::try_from(piece.wrapping_sub(self.first)).ok()?;
        let place = (bits & WITHIN) as f64 * const { 1.0 / (1_u64 << BITS_WITHIN) as f64 };
        Some((piece, *self.pieces.get(index)?, place))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_are_met_and_the_outside_is_told() {
        let table = RadialTable::new(0.3, 1e5, |w| (w.powi(-4), -4.0 * w.powi(-5)));
        for i in 0..1000 {
            let w = 0.3 * (3e5_f64).powf(f64::from(i) / 1000.0);
            let error = table.value(w).unwrap() * w.powi(4) - 1.0;
            assert!(error.abs() < 4e-6, "{w}: {error}");
            let [value, first, second] = table.derivatives(w).unwrap();
            assert_eq!(value, table.value(w).unwrap());
            assert!((first / (-4.0 * w.powi(-5)) - 1.0).abs() < 1e-3);
            assert!((second / (20.0 * w.powi(-6)) - 1.0).abs() < 1e-2);
        }
        for outside in [0.0, 0.2, 1.1e5, f64::INFINITY, f64::NAN, -1.0] {
            assert_eq!(table.value(outside), None);
        }
    }
}
