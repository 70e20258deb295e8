//! The surface brightness of one galaxy, and its Fourier transform.

use std::sync::{Arc, OnceLock};

use psf_types::{LightProfile, Outskirts, SersicSource};
use statrs::function::gamma::{gamma_ur, ln_gamma};

use crate::transform::Transform;

/// A half-light radius below this value is replaced by this value. Even for `n = 8`, almost all
/// light then falls in one pixel.
const SMALLEST_RADIUS_PX: f64 = 1e-9;
/// Along any line, the m-th derivative of the brightness `I` is at most about
/// `I ((k + DERIVATIVE_OFFSET) / r)^m` for the orders used here (up to 8), with
/// `k = -d ln I / d ln r`. The reason is that the derivatives of a power `r^-k` have the factors
/// `k, k + 1 ... k + 7`, whose geometric mean is about `k + 3`.
const DERIVATIVE_OFFSET: f64 = 3.0;
/// Light fainter than `exp(-DARK)` times the central brightness counts as 0. Numbers so small that
/// doubles lose digits would take long to compute with.
const DARK: f64 = 300.0;

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
    transform: OnceLock<Arc<Transform>>,
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
        self.transform.get_or_init(|| Transform::of_index(self.index))
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
    /// `farthest`.
    fn between(&self, nearest: f64, farthest: f64) -> Outskirts {
        let slope = self.exponent(farthest * farthest) / self.index;
        Outskirts {
            brightness: self.central * (-self.exponent(nearest * nearest)).exp(),
            scale_px: self.q * nearest / (slope + DERIVATIVE_OFFSET),
        }
    }
}

impl LightProfile for SersicLight {
    fn transform_into(&self, kx: f64, first_ky: f64, step: f64, values: &mut [f64]) {
        // With the unit vectors along and across the major axis, k_u^2 + q^2 k_v^2 is a quadratic
        // form in (kx, ky).
        let (cos, sin) = (self.step_x[0], self.step_y[0]);
        let table = self.transform();
        let (along, across) = (self.re * self.re, self.re * self.re * self.q * self.q);
        let xx = (along * cos * cos + across * sin * sin) * kx * kx;
        let xy = 2.0 * (along - across) * sin * cos * kx;
        let yy = along * sin * sin + across * cos * cos;
        for (i, value) in values.iter_mut().enumerate() {
            let ky = first_ky + i as f64 * step;
            *value = table.at((xx + ky * (xy + ky * yy)).max(0.0));
        }
    }

    fn transform_limits(&self, k: f64) -> [f64; 2] {
        let along = self.re * self.re * k * k;
        [along, self.q * self.q * along].map(|x| self.transform().at(x))
    }

    fn brightness(&self, dx: f64, dy: f64) -> [f64; 4] {
        let (u, v) = self.turned(dx, dy);
        let r_squared = u * u + v * v;
        // Single precision is enough here, and faster.
        let half = 0.5 / self.index;
        let power = ((r_squared / (self.re * self.re)) as f32).powf(half as f32);
        let exponent = self.b * f64::from(power);
        if exponent > DARK {
            return [0.0; 4];
        }
        let brightness = self.central * (-exponent).exp();
        // Derivatives with respect to the squared radius.
        let slope = half * exponent;
        let first = -slope * brightness / r_squared;
        let second = slope * (slope + 1.0 - half) * brightness / (r_squared * r_squared);
        let ([ux, vx], [uy, vy]) = (self.step_x, self.step_y);
        let (x, y) = (u * ux + v * vx, u * uy + v * vy);
        [
            brightness,
            2.0 * first * (ux * ux + vx * vx) + 4.0 * second * x * x,
            2.0 * first * (ux * uy + vx * vy) + 4.0 * second * x * y,
            2.0 * first * (uy * uy + vy * vy) + 4.0 * second * y * y,
        ]
    }

    fn outskirts(&self, distance_px: f64) -> Outskirts {
        self.between(distance_px, distance_px)
    }

    fn around(&self, (dx, dy): (f64, f64), reach_px: f64) -> Outskirts {
        let (u, v) = self.turned(dx, dy);
        let (middle, reach) = (u.hypot(v), reach_px / self.q);
        // Every point is at least as far from the centre as it is in pixels.
        let nearest = (middle - reach).max(dx.hypot(dy) - reach_px).max(0.0);
        self.between(nearest, middle + reach)
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

/// Returns the `b` for which half of the light lies within `re`: `P(2n, b) = 1/2`, with the
/// regularised lower incomplete gamma function `P`.
pub(crate) fn half_light_constant(n: f64) -> f64 {
    // Newton's method, from the start of an asymptotic series (Ciotti and Bertin 1999, A&A 352,
    // 447), which is below the solution for small n.
    let mut b = (2.0 * n - 1.0 / 3.0 + 4.0 / (405.0 * n)).max(SMALLEST_START);
    for _ in 0..NEWTON_STEPS {
        let slope = ((2.0 * n - 1.0) * b.ln() - b - ln_gamma(2.0 * n)).exp();
        b = (b + (gamma_ur(2.0 * n, b) - 0.5) / slope).max(0.5 * b);
    }
    b
}

/// The least value from which Newton's method for `b` starts.
const SMALLEST_START: f64 = 0.1;
/// Steps of Newton's method: the error is then rounding, for `n` from 0.2 to 11.
const NEWTON_STEPS: usize = 6;

#[cfg(test)]
mod tests {
    use psf_types::{LightProfile, Position, SersicProfile, SersicSource};
    use statrs::function::gamma::gamma_lr;

    use super::*;

    #[test]
    fn half_of_the_light_lies_within_the_half_light_radius() {
        // Known values: n = 0.5 is a Gaussian with b = ln 2. Values for n = 1 and 4 are from Graham
        // and Driver (2005).
        for (n, b, within) in [
            (0.5, std::f64::consts::LN_2, 1e-14),
            (1.0, 1.678_346_990_016_66, 1e-13),
            (4.0, 7.669_249_442_500_8, 1e-12),
        ] {
            let found = half_light_constant(n);
            assert!((found - b).abs() < within, "n = {n}: {found}");
        }
        for i in 0..400 {
            let n = 0.2 * 1.0101_f64.powi(i);
            let half = gamma_lr(2.0 * n, half_light_constant(n));
            assert!((half - 0.5).abs() < 1e-12, "{n}: {half}");
        }
    }

    fn light(re: f64, n: f64, q: f64, angle: f64) -> SersicLight {
        let profile = SersicProfile::new(re, n, q, angle).unwrap();
        SersicLight::new(&SersicSource::new(Position::of_pixel(0, 0), 1.0, profile).unwrap())
    }

    #[test]
    fn derivatives_are_those_of_the_brightness() {
        let light = light(5.0, 2.3, 0.4, 25.0);
        let (x, y, h) = (17.0, -9.0, 0.25);
        let at = |i: f64, j: f64| light.brightness(x + i * h, y + j * h)[0];
        let [value, xx, xy, yy] = light.brightness(x, y);
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
    const ROUNDING: f64 = 1e-5;

    #[test]
    fn outskirts_are_limits() {
        for (n, q) in [(0.5, 1.0), (1.0, 0.2), (4.0, 0.6)] {
            let light = light(3.0, n, q, 40.0);
            for distance in [4.0, 15.0, 60.0] {
                let limits = light.outskirts(distance);
                for step in 0..36 {
                    let angle = f64::from(step).to_radians() * 10.0;
                    let at = (distance * angle.cos(), distance * angle.sin());
                    let [brightness, xx, _, yy] = light.brightness(at.0, at.1);
                    assert!(brightness <= limits.brightness * (1.0 + ROUNDING));
                    let largest = limits.brightness / limits.scale_px.powi(2);
                    assert!(xx.abs().max(yy.abs()) <= largest, "n = {n}, {distance} at {step}");
                    let around = light.around(at, 0.5);
                    assert!(around.brightness >= brightness && around.scale_px > 0.0);
                }
            }
        }
    }
}
