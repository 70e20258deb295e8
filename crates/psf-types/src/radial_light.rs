//! The distribution of a profile's light over its isophotes, from which photons are drawn.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use crate::maths::gauss_legendre;

/// The radii of the isophotes on which the photons of a profile fall.
///
/// Two independent standard normal deviates `(a, b)` have a random direction, and a photon lies within the
/// isophote that encloses the fraction `1 - exp(-s / 2)` of the light, with `s = a^2 + b^2`. If `r(s)` is the
/// radius of this isophote, the photon of a round profile falls at `(a, b) F(s)` with `F(s) = r(s) / sqrt(s)`.
/// For a Gaussian profile, `F` is constant.
///
/// `F` is a table with cubic Hermite interpolation. The light within an interpolated radius is exact to 1e-6 of
/// the light. The last 1e-7 of the light lies on the isophote of [`farthest_px`](Self::farthest_px).
#[derive(Debug, Clone)]
pub struct RadialLight {
    /// `F` and its derivative by `s` at each of [`nodes`](Self::nodes), for a scale of 1.
    table: Arc<[[f32; 2]]>,
    scale_px: f64,
}

/// The exponents of 2 at which the table in `s` begins and ends. The first 5e-7 of the light lie below it.
const OCTAVES: [i32; 2] = [-20, 5];
/// The number of steps in an octave is 2 to this power.
const STEP_BITS: u32 = 3;
const STEPS: usize = 1 << STEP_BITS;
const MANTISSA_BITS: u32 = 23;
/// The bits of a number that are below the step.
const BELOW_STEP: u32 = MANTISSA_BITS - STEP_BITS;

/// Brightness is integrated between radii with this number of steps in an octave, from and to these powers of
/// 2 in pixels. No frame is larger.
const PIECES_PER_OCTAVE: i32 = 8;
const RADII: [i32; 2] = [-40, 21];
const RULE: [(f64, f64); 4] = gauss_legendre();
/// Steps of Newton's method or, where it leaves the piece, of bisection.
const MOST_STEPS: usize = 60;
/// They end at this relative step.
const LAST_STEP: f64 = 1e-13;
/// The largest exponent of `F` as a power of `s` that is taken from the derivative. Where a profile ends, its
/// derivative is not finite.
const MOST_EXPONENT: f64 = 20.0;

impl RadialLight {
    /// The values of `s` at which the table has nodes.
    pub fn nodes() -> impl Iterator<Item = f64> {
        let octaves = (OCTAVES[0]..OCTAVES[1]).flat_map(|octave| {
            (0..STEPS).map(move |step| (1.0 + step as f64 / STEPS as f64) * power(octave))
        });
        octaves.chain([power(OCTAVES[1])])
    }

    /// From `ln F` and its derivative by `ln s` at each of the [`nodes`](Self::nodes). The radii are multiplied
    /// by `scale_px`.
    pub fn from_logarithms(logarithms: &[[f64; 2]], scale_px: f64) -> Self {
        let of_node = |([ln_factor, exponent], s): (&[f64; 2], f64)| {
            let factor = ln_factor.exp();
            [factor as f32, (factor * exponent / s) as f32]
        };
        Self {
            table: logarithms.iter().zip(Self::nodes()).map(of_node).collect(),
            scale_px,
        }
    }

    /// This table with other radii: a scale of 1 is that of [`from_logarithms`](Self::from_logarithms).
    #[must_use]
    pub fn scaled(&self, scale_px: f64) -> Self {
        Self {
            table: Arc::clone(&self.table),
            scale_px,
        }
    }

    /// Computes `ln F` and its derivative by `ln s` at each of the [`nodes`](Self::nodes), by integration of
    /// the brightness on the isophotes of radius `r` (in pixels) over `2 pi axis_ratio r dr`. This takes about
    /// 10 000 values of the brightness.
    pub fn logarithms(brightness: &dyn Fn(f64) -> f64, axis_ratio: f64) -> Vec<[f64; 2]> {
        let per_radius = |r: f64| TAU * axis_ratio * r * brightness(r);
        let within = |from: f64, to: f64| -> f64 {
            let of_node = |(t, weight): (f64, f64)| weight * per_radius(from + (to - from) * t);
            (to - from) * RULE.into_iter().map(of_node).sum::<f64>()
        };
        let pieces = RADII.map(|octave| octave * PIECES_PER_OCTAVE);
        let radii: Vec<f64> = (pieces[0]..=pieces[1])
            .map(|k| (f64::from(k) / f64::from(PIECES_PER_OCTAVE)).exp2())
            .collect();
        let mut sums = vec![0.5 * radii[0] * per_radius(radii[0])];
        for pair in radii.windows(2) {
            sums.push(sums[sums.len() - 1] + within(pair[0], pair[1]));
        }
        let total = sums[sums.len() - 1];
        let at = |s: f64| {
            let target = -total * (-0.5 * s).exp_m1();
            let piece = sums.partition_point(|&sum| sum < target).clamp(1, sums.len() - 1) - 1;
            let (mut low, mut high) = (radii[piece], radii[piece + 1]);
            let mut r = 0.5 * (low + high);
            for _ in 0..MOST_STEPS {
                let excess = sums[piece] + within(radii[piece], r) - target;
                if excess < 0.0 {
                    low = r;
                } else {
                    high = r;
                }
                let newton = r - excess / per_radius(r);
                let next = if newton > low && newton < high {
                    newton
                } else {
                    0.5 * (low + high)
                };
                let step = (next - r).abs();
                r = next;
                if step <= LAST_STEP * r {
                    break;
                }
            }
            // d(r^2) / dp = total / (pi q I), and dp / ds = exp(-s / 2) / 2.
            let per_s = total / (PI * axis_ratio * brightness(r)) * 0.5 * (-0.5 * s).exp();
            let exponent = 0.5 * (s * per_s / (r * r) - 1.0);
            [r.ln() - 0.5 * s.ln(), exponent.clamp(-0.5, MOST_EXPONENT)]
        };
        Self::nodes().map(at).collect()
    }

    /// The offset of a photon of a round profile, in pixels along the major axis, for two standard normal
    /// deviates.
    #[inline]
    pub fn offset(&self, a: f64, b: f64) -> (f64, f64) {
        const FIRST: f32 = 1.0 / (1 << -OCTAVES[0]) as f32;
        const LAST: f32 = (1 << OCTAVES[1]) as f32;
        let s = (a * a + b * b) as f32;
        let factor = if s >= LAST {
            self.table[self.table.len() - 1][0] * (LAST / s).sqrt()
        } else {
            let bits = s.max(FIRST).to_bits();
            let node = ((bits >> BELOW_STEP) - (FIRST.to_bits() >> BELOW_STEP)) as usize;
            let step = f32::from_bits(bits >> MANTISSA_BITS << MANTISSA_BITS) / STEPS as f32;
            let t = (bits & ((1 << BELOW_STEP) - 1)) as f32 / (1 << BELOW_STEP) as f32;
            let [[v0, d0], [v1, d1]] = [self.table[node], self.table[node + 1]];
            let (d0, d1, rise) = (d0 * step, d1 * step, v1 - v0);
            v0 + t * (d0 + t * (3.0 * rise - 2.0 * d0 - d1 + t * (d0 + d1 - 2.0 * rise)))
        };
        let factor = f64::from(factor) * self.scale_px;
        (a * factor, b * factor)
    }

    /// The distance along the major axis beyond which no photon falls.
    pub fn farthest_px(&self) -> f64 {
        f64::from(self.table[self.table.len() - 1][0]) * power(OCTAVES[1]).sqrt() * self.scale_px
    }

    /// Numbers that differ between different distributions of light: the scale, and a few values of the table.
    pub fn fingerprint(&self) -> [u64; 4] {
        let bits = |part: usize| u64::from(self.table[(self.table.len() - 1) * part / 3][0].to_bits());
        [self.scale_px.to_bits(), bits(1), bits(2), bits(3)]
    }
}

fn power(exponent: i32) -> f64 {
    f64::from(exponent).exp2()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Gaussian has a constant factor, its standard deviation. A disc of constant brightness holds light in
    /// proportion to the squared radius.
    #[test]
    fn radii_of_a_gaussian_and_of_a_disc() {
        let gauss = |r: f64| (-0.5 * (r / 3.0).powi(2)).exp();
        let light = RadialLight::from_logarithms(&RadialLight::logarithms(&gauss, 0.5), 1.0);
        let disc = |r: f64| f64::from(u8::from(r < 2.0));
        let disc = RadialLight::from_logarithms(&RadialLight::logarithms(&disc, 1.0), 1.0);
        for i in 0..4000 {
            let s = (f64::from(i) * 0.004_3 - 12.0).exp().min(31.0);
            let (x, y) = light.offset(0.6 * s.sqrt(), 0.8 * s.sqrt());
            assert!((x.hypot(y) / (3.0 * s.sqrt()) - 1.0).abs() < 1e-6, "{s}");
            let (x, y) = disc.offset(s.sqrt(), 0.0);
            let light_within = (x.hypot(y) / 2.0).powi(2);
            assert!(
                (light_within + (-0.5 * s).exp_m1()).abs() < 2e-3,
                "{s} {light_within}"
            );
        }
    }
}
