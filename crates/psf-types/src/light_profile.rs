//! The light of an extended source, as a function on the sky.

use crate::RadialLight;

/// The light of an extended source of unit flux, as a function of the offset from its centre. The
/// light at an offset equals the light at the opposite offset, so its Fourier transform is real.
///
/// Offsets `(dx, dy)` and distances are in pixels of the frame, brightness is flux per pixel.
/// Brightness falls with the distance along every line from the centre.
pub trait LightProfile {
    /// Computes the Fourier transform `G(k) = integral of I(v) exp(-i k v) dv` at wavenumbers in
    /// radians per pixel: at `kx`, and at `ky = first_ky + i * step` for value `i`. `G(0) = 1`.
    fn transform_into(&self, kx: f64, first_ky: f64, step: f64, values: &mut [f32]);

    /// As [`transform_into`](Self::transform_into), in double precision. The default implementation converts values
    /// of single precision.
    fn transform_f64_into(&self, kx: f64, first_ky: f64, step: f64, values: &mut [f64]) {
        let mut single = vec![0.0; values.len()];
        self.transform_into(kx, first_ky, step, &mut single);
        values.iter_mut().zip(single).for_each(|(to, v)| *to = v.into());
    }

    /// Computes the transform along the major axis (its smallest value over all directions if it falls
    /// with the wavenumber) and along the minor axis (its largest value), at `i * step` radians per
    /// pixel for value `i`.
    fn transform_limits(&self, step: f64, smallest: &mut [f32], largest: &mut [f32]);

    /// Adds the light at offsets `[dx, dy]` other than 0, blurred by a kernel that is narrow there:
    /// `flux * (I + xx I_xx / 2 + xy I_xy + yy I_yy / 2)`, with the kernel's covariance
    /// `[xx, xy, yy]` in square pixels and the second derivatives of the brightness `I`.
    fn add_blurred(&self, covariance: [f64; 3], flux: f64, offsets: &[[f32; 2]], values: &mut [f64]);

    /// Describes the light at a distance from the centre, for the direction in which it is
    /// brightest and changes most.
    fn outskirts(&self, distance_px: f64) -> Outskirts;

    /// Describes the light on a square of side `2 half_px` around the offset `(dx, dy)`.
    fn around(&self, offset: (f64, f64), half_px: f64) -> Outskirts;

    /// Returns the ratio of the minor to the major axis of the isophotes.
    fn axis_ratio(&self) -> f64;

    /// Returns the radius of the isophote through an offset in pixels: its distance from the centre
    /// along the major axis.
    fn radius(&self, dx: f64, dy: f64) -> f64;

    /// Returns the brightness, in flux per pixel, on the isophote of a radius, in double precision.
    fn brightness(&self, radius_px: f64) -> f64;

    /// Returns the exponent `n` for which the brightness at small radii is a smooth function of the
    /// `n`-th root of the radius. It is 1 or the index of a Sersic profile.
    fn index(&self) -> f64;

    /// Returns the integral of the squared brightness, per pixel.
    fn squared_norm(&self) -> f64;

    /// An upper limit of the flux farther than `distance_px` from the centre, from 0 to 1.
    fn flux_beyond(&self, distance_px: f64) -> f64;

    /// The distance from the centre beyond which a fraction of the flux lies, by [`flux_beyond`](Self::flux_beyond).
    fn radius_beyond(&self, fraction: f64) -> f64 {
        // Logarithms of the radius.
        let (mut low, mut high) = (-60.0_f64, 60.0_f64);
        for _ in 0..50 {
            let middle = f64::midpoint(low, high);
            if self.flux_beyond(middle.exp()) > fraction {
                low = middle;
            } else {
                high = middle;
            }
        }
        high.exp()
    }

    /// Returns the distribution of the light over the isophotes, from which photons are drawn.
    ///
    /// The default implementation integrates the [`brightness`](Self::brightness), which takes 10 000 values
    /// of it. It is called for every source that is drawn photon by photon, so a profile should keep its
    /// distribution.
    fn radial_light(&self) -> RadialLight {
        let logarithms = RadialLight::logarithms(&|radius| self.brightness(radius), self.axis_ratio());
        RadialLight::from_logarithms(&logarithms, 1.0)
    }
}

/// Limits of a profile's brightness and of its derivatives, in some part of the sky.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outskirts {
    /// The largest brightness, in flux per pixel.
    pub brightness: f64,
    /// A length: the m-th derivative of the brightness is at most about
    /// `brightness / scale_px^m`, for orders up to 4.
    pub scale_px: f64,
}
