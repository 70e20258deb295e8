//! The surface brightness of one galaxy, and its Fourier transform.

use std::cell::Cell;

use psf_types::{LightProfile, Outskirts, RadialLight, SersicProfile, SersicSource};
use statrs::function::gamma::{gamma_ur, ln_gamma};

use crate::elementary::{exp, ln};
use crate::half_light::half_light_constant;
use crate::radii;
use crate::transform::{Precision, Transforms};

/// A half-light radius below this value is replaced by this value. Even for `n = 8`, almost all
/// light then falls in one pixel.
const SMALLEST_RADIUS_PX: f64 = 1e-9;
/// The numbers of points at which brightness is computed together: chunks of the first size, which are
/// several vectors, so that the processor need not wait for each step. Points that are left over are
/// computed in chunks of the second size.
const POINTS: [usize; 2] = [16, 8];
/// The m-th derivative of a power `r^-k` along a radius is `r^-(k + m)` times `k (k + 1) ... (k + m -
/// 1)`, whose m-th root is at most `k + ALONG_RADIUS` for the orders of the scale (up to 4).
const ALONG_RADIUS: f64 = 1.5;
/// Across the radius, the fourth derivative has the factor `3 k (k + 2)`, whose fourth root is at most
/// `(ACROSS_RADIUS (k + 1))^(1/2)`. For lower orders the root is smaller.
const ACROSS_RADIUS: f64 = 1.733;
/// Light fainter than `exp(-DARK)` times the central brightness counts as 0: single precision holds
/// no smaller numbers.
const DARK: f32 = 80.0;
/// The light of one galaxy of unit flux: `I(r) = central * exp(-b (r / re)^(1/n))` with
/// `r = |(u, v)|`. Here `u` is the pixel offset along the major axis, and `v` is the offset across
/// the major axis divided by the axis ratio `q`.
///
/// Its Fourier transform is real, and a function of `k_u^2 + q^2 k_v^2` alone.
#[derive(Debug, Clone)]
pub struct SersicLight {
    /// Central brightness, per pixel.
    central: f64,
    index: f64,
    b: f64,
    re: f64,
    q: f64,
    /// (u, v) of a step of one pixel in x.
    step_x: [f64; 2],
    /// (u, v) of a step of one pixel in y.
    step_y: [f64; 2],
    transforms: Transforms,
}

impl SersicLight {
    /// The light of a galaxy.
    pub fn new(galaxy: &SersicSource) -> Self {
        Self::of_profile(galaxy.profile())
    }

    /// The light of a profile.
    pub fn of_profile(shape: SersicProfile) -> Self {
        let (n, q) = (shape.index(), shape.axis_ratio());
        let re = shape.half_light_radius_px().max(SMALLEST_RADIUS_PX);
        let (sin, cos) = shape.angle_deg().to_radians().sin_cos();
        let (b, central) = constants(n);
        Self {
            central: central / (q * re * re),
            index: n,
            b,
            re,
            q,
            step_x: [cos, -sin / q],
            step_y: [sin, cos / q],
            transforms: Transforms::default(),
        }
    }

    /// The light of a round galaxy with a half-light radius of 1 pixel.
    pub(crate) fn of_index(n: f64) -> Self {
        let (b, central) = constants(n);
        Self {
            central,
            index: n,
            b,
            re: 1.0,
            q: 1.0,
            step_x: [1.0, 0.0],
            step_y: [0.0, 1.0],
            transforms: Transforms::default(),
        }
    }

    /// The transform at `kx`, and at `ky = first_ky + i * step` for value `i`.
    fn transform_along_y<F: Precision>(&self, kx: f64, first_ky: f64, step: f64, values: &mut [F]) {
        // With the unit vectors along and across the major axis, the square of the wavenumber is a
        // quadratic form in (kx, ky).
        let (cos, sin) = (self.step_x[0], self.step_y[0]);
        let [along, across] = self.squares();
        let yy = along * sin * sin + across * cos * cos;
        // At this ky it is least.
        let nearest = (across - along) * sin * cos * kx / yy;
        let least = along * across * kx * kx / yy;
        self.transforms
            .of_index(self.index)
            .along_line([least, yy], (first_ky - nearest, step), values);
    }

    /// Factors of the squared components `k_u^2` and `k_v^2` of a wavenumber along and across the
    /// major axis. Their sum is the square of the wavenumber in radians per half-light radius.
    fn squares(&self) -> [f64; 2] {
        [1.0, self.q * self.q].map(|square| self.re * self.re * square)
    }

    /// Returns (u, v) of an offset from the centre in pixels.
    fn turned(&self, dx: f64, dy: f64) -> (f64, f64) {
        (
            dx * self.step_x[0] + dy * self.step_y[0],
            dx * self.step_x[1] + dy * self.step_y[1],
        )
    }

    /// Returns `b (r / re)^(1/n)`.
    fn exponent(&self, r_squared: f64) -> f64 {
        self.b * ((r_squared / (self.re * self.re)).ln() * (0.5 / self.index)).exp()
    }

    /// Brightness and its length scale at points with a radius in (u, v) from `nearest` to
    /// `farthest`, and with an angle to the major axis there whose sine is at most `sine`.
    fn between(&self, nearest: f64, farthest: f64, sine: f64) -> Outskirts {
        let (half, b) = ((0.5 / self.index) as f32, self.b as f32);
        let ratios = [nearest, farthest].map(|radius| (radius / self.re) as f32);
        let [brightness, exponent] = pulp::Arch::new().dispatch(once(
            #[inline(always)]
            || {
                let [nearest, farthest] = ratios.map(
                    #[inline(always)]
                    |ratio| (b * exp((half * ln(ratio * ratio)).clamp(-DARK, DARK))).min(DARK),
                );
                [exp(-nearest), farthest]
            },
        ));
        let k = f64::from(exponent) / self.index;
        // A step of a pixel along the minor axis is 1 / q in (u, v).
        let along = (k + ALONG_RADIUS) * (sine / self.q).max(1.0);
        let across = (ACROSS_RADIUS * (k + 1.0)).sqrt() / self.q;
        Outskirts {
            brightness: self.central * f64::from(brightness),
            scale_px: nearest / along.max(across),
        }
    }
}

/// The constant `b` of an index, and the central brightness of a round galaxy of unit flux with a half-light
/// radius of 1 pixel. Those of a thread's last index are kept.
fn constants(n: f64) -> (f64, f64) {
    thread_local! {
        static LAST: Cell<(f64, f64, f64)> = const { Cell::new((0.0, 0.0, 0.0)) };
    }
    let (index, b, central) = LAST.get();
    if index == n {
        return (b, central);
    }
    let b = half_light_constant(n);
    let total = (std::f64::consts::TAU * n).ln() - 2.0 * n * b.ln() + ln_gamma(2.0 * n);
    let central = (-total).exp();
    LAST.set((n, b, central));
    (b, central)
}

/// Returns a closure that can be called once only. Any other closure would be called through a
/// function that is not inlined, and so not compiled for the processor's instructions.
#[inline(always)]
fn once<R, F: FnOnce() -> R>(work: F) -> F {
    work
}

impl LightProfile for SersicLight {
    fn transform_into(&self, kx: f64, first_ky: f64, step: f64, values: &mut [f32]) {
        self.transform_along_y(kx, first_ky, step, values);
    }

    fn transform_f64_into(&self, kx: f64, first_ky: f64, step: f64, values: &mut [f64]) {
        self.transform_along_y(kx, first_ky, step, values);
    }

    fn transform_limits(&self, step: f64, smallest: &mut [f32], largest: &mut [f32]) {
        let [along, across] = self.squares();
        let transform = self.transforms.of_index(self.index);
        transform.along_line([0.0, along], (0.0, step), smallest);
        transform.along_line([0.0, across], (0.0, step), largest);
    }

    fn add_blurred(&self, covariance: [f64; 3], flux: f64, offsets: &[[f32; 2]], values: &mut [f64]) {
        // The covariance in (u, v).
        let [xx, xy, yy] = covariance;
        let ([ux, vx], [uy, vy]) = (self.step_x, self.step_y);
        let of = |a: [f64; 2], b: [f64; 2]| {
            (xx * a[0] * b[0] + xy * (a[0] * b[1] + a[1] * b[0]) + yy * a[1] * b[1]) as f32
        };
        let blurred = Blurred {
            uu: of([ux, uy], [ux, uy]),
            uv: of([ux, uy], [vx, vy]),
            vv: of([vx, vy], [vx, vy]),
            step_x: self.step_x.map(|step| step as f32),
            step_y: self.step_y.map(|step| step as f32),
            half: (0.5 / self.index) as f32,
            per_re: (1.0 / (self.re * self.re)) as f32,
            b: self.b as f32,
        };
        pulp::Arch::new().dispatch(AddBlurred {
            blurred,
            scale: self.central * flux,
            offsets,
            values,
        });
    }

    fn outskirts(&self, distance_px: f64) -> Outskirts {
        // Where the light is brightest: at the end of the major axis.
        self.between(distance_px, distance_px, 0.0)
    }

    fn around(&self, (dx, dy): (f64, f64), half_px: f64) -> Outskirts {
        let (u, v) = self.turned(dx, dy);
        let distance = |x: f64, y: f64| (x * x + y * y).sqrt();
        let (middle, reach) = (distance(u, v), half_px * std::f64::consts::SQRT_2 / self.q);
        // Every point is at least as far from the centre as it is in pixels.
        let in_pixels = distance((dx.abs() - half_px).max(0.0), (dy.abs() - half_px).max(0.0));
        let nearest = (middle - reach).max(in_pixels);
        let sine = ((v.abs() + reach) / nearest).min(1.0);
        self.between(nearest, middle + reach, sine)
    }

    fn axis_ratio(&self) -> f64 {
        self.q
    }

    fn radius(&self, dx: f64, dy: f64) -> f64 {
        let (u, v) = self.turned(dx, dy);
        (u * u + v * v).sqrt()
    }

    fn brightness(&self, radius_px: f64) -> f64 {
        self.central * (-self.exponent(radius_px * radius_px)).exp()
    }

    fn index(&self) -> f64 {
        self.index
    }

    fn squared_norm(&self) -> f64 {
        // The square is a Sersic profile with twice the constant b. The flux of a profile is its
        // central brightness times a factor that is proportional to b^(-2 n).
        self.central * (-2.0 * self.index).exp2()
    }

    fn flux_beyond(&self, distance_px: f64) -> f64 {
        if distance_px <= 0.0 {
            return 1.0;
        }
        gamma_ur(2.0 * self.index, self.exponent(distance_px * distance_px))
    }

    fn radial_light(&self) -> RadialLight {
        radii::of_index(self.index).scaled(self.re)
    }
}

/// A galaxy's light, blurred by a narrow kernel, in single precision.
struct Blurred {
    /// The covariance of the kernel in (u, v).
    uu: f32,
    uv: f32,
    vv: f32,
    /// (u, v) of a step of one pixel in x, and in y.
    step_x: [f32; 2],
    step_y: [f32; 2],
    /// Half the inverse Sersic index.
    half: f32,
    /// The inverse of the squared half-light radius.
    per_re: f32,
    b: f32,
}

impl Blurred {
    /// The light at an offset, relative to the central brightness.
    #[inline(always)]
    fn at(&self, [dx, dy]: [f32; 2]) -> f32 {
        let (u, v) = (
            dx * self.step_x[0] + dy * self.step_y[0],
            dx * self.step_x[1] + dy * self.step_y[1],
        );
        let r_squared = u * u + v * v;
        let exponent = self.b * exp((self.half * ln(r_squared * self.per_re)).clamp(-DARK, DARK));
        let is_dark = exponent > DARK;
        let exponent = exponent.min(DARK);
        let brightness = if is_dark { 0.0 } else { exp(-exponent) };
        // Derivatives with respect to the squared radius, relative to the brightness and times powers
        // of the squared radius.
        let first = -self.half * exponent;
        let second = first * (first - (1.0 - self.half));
        let along = (self.uu * u * u + 2.0 * self.uv * u * v + self.vv * v * v) / r_squared;
        let change = (first * (self.uu + self.vv) + 2.0 * second * along) / r_squared;
        brightness + brightness * change
    }

    /// Adds the light at up to `N` offsets, times `scale`.
    #[inline(always)]
    fn add_at<const N: usize>(&self, scale: f64, offsets: &[[f32; 2]], values: &mut [f64]) {
        let mut all = [[1.0; 2]; N];
        all[..offsets.len()].copy_from_slice(offsets);
        let mut light = [0.0; N];
        for (light, offset) in light.iter_mut().zip(all) {
            *light = self.at(offset);
        }
        for (value, light) in values.iter_mut().zip(light) {
            *value += scale * f64::from(light);
        }
    }
}

/// The arguments of [`LightProfile::add_blurred`].
struct AddBlurred<'a> {
    blurred: Blurred,
    /// The central brightness times the flux.
    scale: f64,
    offsets: &'a [[f32; 2]],
    values: &'a mut [f64],
}

impl pulp::NullaryFnOnce for AddBlurred<'_> {
    type Output = ();
    // Inlined, so that it is compiled for each instruction set.
    #[inline(always)]
    fn call(self) {
        let Self { blurred, scale, .. } = self;
        let whole = self.offsets.len() / POINTS[0] * POINTS[0];
        let (offsets, rest) = self.offsets.split_at(whole);
        let (values, values_of_rest) = self.values.split_at_mut(whole);
        for (offsets, values) in offsets.chunks(POINTS[0]).zip(values.chunks_mut(POINTS[0])) {
            blurred.add_at::<{ POINTS[0] }>(scale, offsets, values);
        }
        for (offsets, values) in rest.chunks(POINTS[1]).zip(values_of_rest.chunks_mut(POINTS[1])) {
            blurred.add_at::<{ POINTS[1] }>(scale, offsets, values);
        }
    }
}

#[cfg(test)]
mod tests {
    use psf_types::{LightProfile, Position, SersicProfile, SersicSource};

    use super::*;

    fn light(re: f64, n: f64, q: f64, angle: f64) -> SersicLight {
        let profile = SersicProfile::new(re, n, q, angle).unwrap();
        SersicLight::new(&SersicSource::new(Position::of_pixel(0, 0), 1.0, profile).unwrap())
    }

    /// The brightness and its derivatives by xx, xy and yy.
    fn brightness(light: &SersicLight, dx: f64, dy: f64) -> [f64; 4] {
        let blurred = |covariance: [f64; 3]| {
            let mut value = [0.0];
            light.add_blurred(covariance, 1.0, &[[dx as f32, dy as f32]], &mut value);
            value[0]
        };
        let value = blurred([0.0; 3]);
        [
            value,
            2.0 * (blurred([1.0, 0.0, 0.0]) - value),
            blurred([0.0, 1.0, 0.0]) - value,
            2.0 * (blurred([0.0, 0.0, 1.0]) - value),
        ]
    }

    #[test]
    fn derivatives_are_those_of_the_brightness() {
        let light = light(5.0, 2.3, 0.4, 25.0);
        let (x, y, h) = (17.0, -9.0, 0.25);
        let at = |i: f64, j: f64| brightness(&light, x + i * h, y + j * h)[0];
        let [value, xx, xy, yy] = brightness(&light, x, y);
        let numeric = [
            at(0.0, 0.0),
            (at(1.0, 0.0) + at(-1.0, 0.0) - 2.0 * value) / (h * h),
            (at(1.0, 1.0) + at(-1.0, -1.0) - at(1.0, -1.0) - at(-1.0, 1.0)) / (4.0 * h * h),
            (at(0.0, 1.0) + at(0.0, -1.0) - 2.0 * value) / (h * h),
        ];
        for (exact, numeric) in [value, xx, xy, yy].into_iter().zip(numeric) {
            assert!((exact / numeric - 1.0).abs() < 5e-3, "{exact} {numeric}");
        }
    }

    /// Relative rounding of the brightness in single precision.
    const ROUNDING: f64 = 4e-5;

    #[test]
    fn brightness_is_that_of_the_profile() {
        let mut worst = 0.0_f64;
        for n in [0.5, 1.0, 2.3, 4.0, 6.0] {
            let light = light(2.0, n, 0.4, 25.0);
            for step in 1..3000 {
                let (dx, dy) = (0.13 * f64::from(step), -0.07 * f64::from(step));
                let (u, v) = light.turned(dx, dy);
                let exponent = light.exponent(u * u + v * v);
                let exact = light.central * (-exponent).exp();
                if exponent < f64::from(DARK) - 1.0 {
                    worst = worst.max((brightness(&light, dx, dy)[0] / exact - 1.0).abs());
                }
            }
        }
        assert!(worst < ROUNDING, "{worst:e}");
    }

    #[test]
    fn outskirts_are_limits() {
        for (n, q) in [(0.5, 1.0), (1.0, 0.2), (4.0, 0.6)] {
            let light = light(3.0, n, q, 40.0);
            for distance in [4.0, 15.0, 60.0] {
                let limits = light.outskirts(distance);
                for step in 0..36 {
                    let angle = f64::from(step).to_radians() * 10.0;
                    let at = (distance * angle.cos(), distance * angle.sin());
                    let [value, xx, _, yy] = brightness(&light, at.0, at.1);
                    assert!(value <= limits.brightness * (1.0 + ROUNDING));
                    let largest = limits.brightness / limits.scale_px.powi(2);
                    assert!(xx.abs().max(yy.abs()) <= largest, "n = {n}, {distance} at {step}");
                    let around = light.around(at, 0.5);
                    assert!(around.brightness >= value && around.scale_px > 0.0);
                }
            }
        }
    }
}
