//! The surface brightness of one galaxy, and its Fourier transform.

use std::sync::OnceLock;

use psf_types::{LightProfile, Outskirts, SersicSource};
use statrs::function::gamma::{gamma_ur, ln_gamma};
use wide::f32x8;

use crate::half_light::half_light_constant;
use crate::transform::Transform;

/// A half-light radius below this value is replaced by this value. Even for `n = 8`, almost all
/// light then falls in one pixel.
const SMALLEST_RADIUS_PX: f64 = 1e-9;
/// The number of points at which brightness is computed together.
const POINTS: usize = 8;
/// The m-th derivative of a power `r^-k` along a radius is `r^-(k + m)` times `k (k + 1) ... (k + m -
/// 1)`, whose m-th root is at most about `k + ALONG_RADIUS` for the orders used here (up to 6).
const ALONG_RADIUS: f64 = 2.3;
/// Across the radius, the sixth derivative has the factor `15 k (k + 2) (k + 4)`, whose sixth root is
/// at most about `(ACROSS_RADIUS (k + 2))^(1/2)`. For lower orders the root is smaller.
const ACROSS_RADIUS: f64 = 2.5;
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
    /// Computed when first needed.
    transform: OnceLock<Box<Transform>>,
}

impl SersicLight {
    /// The light of a galaxy.
    pub fn new(galaxy: &SersicSource) -> Self {
        let shape = galaxy.profile();
        let (n, q) = (shape.index(), shape.axis_ratio());
        let re = shape.half_light_radius_px().max(SMALLEST_RADIUS_PX);
        let b = half_light_constant(n);
        let (sin, cos) = shape.angle_deg().to_radians().sin_cos();
        let total =
            (std::f64::consts::TAU * n * q).ln() + 2.0 * re.ln() - 2.0 * n * b.ln() + ln_gamma(2.0 * n);
        Self {
            central: (-total).exp(),
            index: n,
            b,
            re,
            q,
            step_x: [cos, -sin / q],
            step_y: [sin, cos / q],
            transform: OnceLock::new(),
        }
    }

    fn transform(&self) -> &Transform {
        self.transform
            .get_or_init(|| Box::new(Transform::of_index(self.index)))
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
        let k = self.exponent(farthest * farthest) / self.index;
        // A step of a pixel along the minor axis is 1 / q in (u, v).
        let along = (k + ALONG_RADIUS) * (sine / self.q).max(1.0);
        let across = (ACROSS_RADIUS * (k + 2.0)).sqrt() / self.q;
        Outskirts {
            brightness: self.central * (-self.exponent(nearest * nearest)).exp(),
            scale_px: nearest / along.max(across),
        }
    }
}

impl LightProfile for SersicLight {
    fn transform_into(&self, kx: f64, first_ky: f64, step: f64, values: &mut [f64]) {
        // With the unit vectors along and across the major axis, k_u^2 + q^2 k_v^2 is a quadratic
        // form in (kx, ky).
        let (cos, sin) = (self.step_x[0], self.step_y[0]);
        let (along, across) = (self.re * self.re, self.re * self.re * self.q * self.q);
        let xx = (along * cos * cos + across * sin * sin) * kx * kx;
        let xy = 2.0 * (along - across) * sin * cos * kx;
        let yy = along * sin * sin + across * cos * cos;
        self.transform()
            .along_line([xx, xy, yy], (first_ky, step), values);
    }

    fn transform_limits(&self, k: f64) -> [f64; 2] {
        let along = self.re * self.re * k * k;
        let mut limits = [0.0; 2];
        let to_across = (self.q * self.q - 1.0) * along;
        self.transform()
            .along_line([along, to_across, 0.0], (0.0, 1.0), &mut limits);
        limits
    }

    fn add_blurred(&self, covariance: [f64; 3], flux: f64, offsets: &[[f32; 2]], values: &mut [f64]) {
        // The covariance in (u, v), and the sum of its uu and vv.
        let [xx, xy, yy] = covariance;
        let ([ux, vx], [uy, vy]) = (self.step_x, self.step_y);
        let of = |a: [f64; 2], b: [f64; 2]| {
            f32x8::splat((xx * a[0] * b[0] + xy * (a[0] * b[1] + a[1] * b[0]) + yy * a[1] * b[1]) as f32)
        };
        let (uu, uv, vv) = (
            of([ux, uy], [ux, uy]),
            of([ux, uy], [vx, vy]),
            of([vx, vy], [vx, vy]),
        );
        let trace = uu + vv;
        let [ux, vx, uy, vy] = [ux, vx, uy, vy].map(|step| f32x8::splat(step as f32));
        let half = f32x8::splat((0.5 / self.index) as f32);
        let per_re = f32x8::splat((1.0 / (self.re * self.re)) as f32);
        let b = f32x8::splat(self.b as f32);
        for (offsets, values) in offsets.chunks(POINTS).zip(values.chunks_mut(POINTS)) {
            let axis = |axis: usize| {
                f32x8::new(std::array::from_fn(|i| {
                    offsets.get(i).map_or(1.0, |offset| offset[axis])
                }))
            };
            let (dx, dy) = (axis(0), axis(1));
            let (u, v) = (dx * ux + dy * uy, dx * vx + dy * vy);
            let r_squared = u * u + v * v;
            let exponent = b * (half * (r_squared * per_re).ln()).exp();
            let brightness = exponent
                .simd_gt(f32x8::splat(DARK))
                .select(f32x8::ZERO, (-exponent).exp());
            // Derivatives with respect to the squared radius, relative to the brightness and times
            // powers of the squared radius.
            let first = -half * exponent;
            let second = first * (first - (f32x8::ONE - half));
            let along = (uu * u * u + (uv + uv) * u * v + vv * v * v) / r_squared;
            let change = (first * trace + (second + second) * along) / r_squared;
            let sum = (brightness + brightness * change).to_array();
            let scale = self.central * flux;
            for (value, sum) in values.iter_mut().zip(sum) {
                *value += scale * f64::from(sum);
            }
        }
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

    fn flux_beyond(&self, distance_px: f64) -> f64 {
        if distance_px <= 0.0 {
            return 1.0;
        }
        gamma_ur(2.0 * self.index, self.exponent(distance_px * distance_px))
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
