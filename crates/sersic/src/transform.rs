//! The Fourier transforms of Sersic profiles, tabulated.
//!
//! The transform of a round profile of unit flux, at the wavenumber `k` in radians per half-light
//! radius, is the inverse Mellin transform
//!
//! ```text
//! T(k) = 1 / (2 pi i) * integral of  p^-z 2^(z-1) Gamma(z/2) / Gamma(1 - z/2) Gamma(n (2-z)) / Gamma(2n)  dz
//! ```
//!
//! along a line parallel to the imaginary axis, with `p = k / b^n`. It follows from the Mellin
//! transforms of `J_0` (Gradshteyn and Ryzhik 6.561.14) and of `exp(-r^(1/n))`, and from Parseval's
//! formula for them. The trapezoidal rule converges exponentially for it. On the line `Re z = 1`
//! nothing is added. The line `Re z = -1` lies on the other side of the pole at 0, which adds 1.

use std::collections::HashMap;
use std::f64::consts::{LN_2, PI, TAU};
use std::sync::{Arc, Mutex, OnceLock};

use num_complex::Complex64;

use crate::profile::half_light_constant;

/// The table begins and ends at these powers of two of the squared wavenumber. Below, the transform
/// is 1 but for 1e-5, even for `n = 8`. Above, it is below 1e-7.
const OCTAVES: [i32; 2] = [-36, 34];
/// A table has `2^PIECES_LOG2` cubic pieces for each factor of two in the squared wavenumber. The
/// error of a piece is then at most 2e-7 of the flux.
const PIECES_LOG2: u32 = 4;
/// Number of mantissa bits of a double that give the position within a piece.
const BITS_WITHIN: u32 = 52 - PIECES_LOG2;
/// The step in `ln n` between the tables that are computed from the integral. The tables of other
/// indices are interpolated from the six nearest of them, with an error of 1e-7 of the flux.
const STEP: f64 = 0.1;
/// Half the number of tables that an interpolation uses.
const HALF_SUPPORT: i32 = 3;
/// The first computed table is that of `exp(FIRST * STEP)`. The indices from 0.3 to 8 then have
/// three computed tables on either side.
const FIRST: i32 = -15;
const TABLES: usize = 40;
/// The step of the trapezoidal rule. Its error is about `exp(-2 pi / STEP_OF_RULE) = 2e-14`.
const STEP_OF_RULE: f64 = 0.2;
/// The most indices whose tables are kept for later galaxies.
const KEPT: usize = 64;

/// The Fourier transform of a round profile of unit flux, as a function of the squared wavenumber
/// `x` in radians per half-light radius. The leading bits of `x` (a double) are the number of the
/// cubic piece that contains it.
#[derive(Debug)]
pub(crate) struct Transform {
    /// Coefficients of the powers 0 to 3 of the position within a piece, which is from 0 to 1. The
    /// first piece holds all smaller wavenumbers, the last one all larger wavenumbers.
    pieces: Box<[[f64; 4]; PIECES + 2]>,
}

impl Transform {
    /// The transform of the profile of index `n`. The tables of the first few indices are kept.
    pub(crate) fn of_index(n: f64) -> Arc<Self> {
        static TABLES_KEPT: OnceLock<Mutex<HashMap<u64, Arc<Transform>>>> = OnceLock::new();
        let tables = TABLES_KEPT.get_or_init(Mutex::default);
        if let Ok(tables) = tables.lock()
            && let Some(known) = tables.get(&n.to_bits())
        {
            return Arc::clone(known);
        }
        let made = Arc::new(Self::interpolated(n));
        if let Ok(mut tables) = tables.lock()
            && tables.len() < KEPT
        {
            tables.insert(n.to_bits(), Arc::clone(&made));
        }
        made
    }

    fn interpolated(n: f64) -> Self {
        let place = n.ln() / STEP;
        let below = place.floor() as i32;
        let nodes: Vec<i32> = (below + 1 - HALF_SUPPORT..=below + HALF_SUPPORT).collect();
        let weights = nodes.iter().map(|&node| {
            let others = nodes.iter().filter(|&&other| other != node);
            let factor = |&other: &i32| (place - f64::from(other)) / f64::from(node - other);
            others.map(factor).product::<f64>()
        });
        let mut samples = vec![[0.0; 2]; PIECES + 1];
        for (&node, weight) in nodes.iter().zip(weights) {
            for (sum, sample) in samples.iter_mut().zip(computed(node)) {
                sum[0] += weight * sample[0];
                sum[1] += weight * sample[1];
            }
        }
        let piece = |(number, ends): (usize, &[[f64; 2]])| {
            let width = start_of(number + 1) - start_of(number);
            let (rise, slope, end_slope) = (ends[1][0] - ends[0][0], ends[0][1] * width, ends[1][1] * width);
            [
                ends[0][0],
                slope,
                3.0 * rise - 2.0 * slope - end_slope,
                slope + end_slope - 2.0 * rise,
            ]
        };
        let mut pieces: Box<[_; PIECES + 2]> = vec![[0.0; 4]; PIECES + 2]
            .try_into()
            .expect("the number of pieces");
        pieces[0] = [1.0, 0.0, 0.0, 0.0];
        let computed = samples.windows(2).enumerate().map(piece);
        pieces[1..].iter_mut().zip(computed).for_each(|(to, v)| *to = v);
        Self { pieces }
    }

    /// The transform at a squared wavenumber, which is not negative.
    #[inline(always)]
    pub(crate) fn at(&self, x: f64) -> f64 {
        const WITHIN: u64 = (1 << BITS_WITHIN) - 1;
        let bits = x.to_bits();
        let piece = (bits >> BITS_WITHIN) as i64 - (FIRST_PIECE as i64 - 1);
        let [c0, c1, c2, c3] = self.pieces[piece.clamp(0, PIECES as i64 + 1) as usize];
        let place = (bits & WITHIN) as f64 * const { 1.0 / (1_u64 << BITS_WITHIN) as f64 };
        c0 + place * (c1 + place * (c2 + place * c3))
    }
}

/// The leading bits of the first squared wavenumber of the tables.
const FIRST_PIECE: u64 = ((OCTAVES[0] + 1023) as u64) << PIECES_LOG2;
/// Number of pieces of a table.
const PIECES: usize = ((OCTAVES[1] - OCTAVES[0]) as usize) << PIECES_LOG2;

/// The squared wavenumber at which a piece starts.
fn start_of(piece: usize) -> f64 {
    f64::from_bits((FIRST_PIECE + piece as u64) << BITS_WITHIN)
}

/// The transform and its derivative with respect to `x` at the starts of the pieces, for the index
/// `exp(node * STEP)`. Computed when first needed.
fn computed(node: i32) -> &'static [[f64; 2]] {
    static COMPUTED: [OnceLock<Vec<[f64; 2]>>; TABLES] = [const { OnceLock::new() }; TABLES];
    COMPUTED[(node - FIRST) as usize].get_or_init(|| {
        let n = (f64::from(node) * STEP).exp();
        let lines = [Line::new(n, 1.0), Line::new(n, -1.0)];
        let shift = n * half_light_constant(n).ln();
        (0..=PIECES)
            .map(|piece| {
                let x = start_of(piece);
                let ln_p = 0.5 * x.ln() - shift;
                // Takes the line whose terms are smaller, which loses fewer digits.
                let smaller = usize::from(lines[1].size(ln_p) < lines[0].size(ln_p));
                let [value, slope] = lines[smaller].integral(ln_p);
                [value, 0.5 * slope / x]
            })
            .collect()
    })
}

/// The factors of the integral that do not depend on the wavenumber, on a line `Re z = const`.
struct Line {
    real: f64,
    /// Value beside the integral: the residue of the pole at 0, if the line lies left of it.
    residue: f64,
    /// The factors at `Im z = 0, step, 2 step ...`.
    factors: Vec<Complex64>,
    /// Sum of their absolute values.
    size: f64,
}

impl Line {
    fn new(n: f64, real: f64) -> Self {
        // |Gamma(n (2 - z))| falls as exp(-pi n |Im z| / 2).
        let end = (80.0 / (PI * n)).max(8.0);
        let count = (end / STEP_OF_RULE).ceil() as usize;
        let ln_total = ln_gamma(Complex64::new(2.0 * n, 0.0));
        let factors: Vec<Complex64> = (0..=count)
            .map(|j| {
                let z = Complex64::new(real, j as f64 * STEP_OF_RULE);
                let ln = ln_gamma(z / 2.0) - ln_gamma(1.0 - z / 2.0) + ln_gamma(n * (2.0 - z)) - ln_total
                    + (z - 1.0) * LN_2;
                // The terms of -Im z are the conjugates, so all but the first count twice.
                let twice = if j == 0 { 1.0 } else { 2.0 };
                ln.exp() * (twice * STEP_OF_RULE / TAU)
            })
            .collect();
        Self {
            real,
            residue: if real < 0.0 { 1.0 } else { 0.0 },
            size: factors.iter().map(|f| f.norm()).sum(),
            factors,
        }
    }

    fn size(&self, ln_p: f64) -> f64 {
        self.size.ln() - self.real * ln_p
    }

    /// The transform, and its derivative with respect to `ln k`.
    fn integral(&self, ln_p: f64) -> [f64; 2] {
        let turn = Complex64::from_polar(1.0, -STEP_OF_RULE * ln_p);
        let mut power = Complex64::new((-self.real * ln_p).exp(), 0.0);
        let (mut value, mut slope) = (self.residue, 0.0);
        for (j, factor) in self.factors.iter().enumerate() {
            let term = factor * power;
            value += term.re;
            slope -= (Complex64::new(self.real, j as f64 * STEP_OF_RULE) * term).re;
            power *= turn;
        }
        [value, slope]
    }
}

/// The logarithm of the gamma function, but for multiples of `2 pi i`: Stirling's series, after a
/// shift to a large argument.
fn ln_gamma(z: Complex64) -> Complex64 {
    // Coefficients B_2m / (2m (2m - 1)) of Stirling's series.
    const SERIES: [f64; 6] = [
        1.0 / 12.0,
        -1.0 / 360.0,
        1.0 / 1260.0,
        -1.0 / 1680.0,
        1.0 / 1188.0,
        -691.0 / 360_360.0,
    ];
    const LARGE: f64 = 12.0;
    let (mut z, mut shift) = (z, Complex64::ZERO);
    while z.re < LARGE {
        shift += z.ln();
        z += 1.0;
    }
    let inverse = z.inv();
    let square = inverse * inverse;
    let series = SERIES
        .iter()
        .rev()
        .fold(Complex64::ZERO, |sum, &c| sum * square + c)
        * inverse;
    (z - 0.5) * z.ln() - z + 0.5 * TAU.ln() + series - shift
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Documented error of a transform, as a fraction of the flux.
    const ERROR: f64 = 3e-7;

    #[test]
    fn known_transforms() {
        let b = half_light_constant(1.0);
        for i in 0..2000 {
            let x = 10.0_f64.powf(-8.0 + f64::from(i) * 0.007);
            let gauss = (-x / (4.0 * LN_2)).exp();
            assert!((Transform::of_index(0.5).at(x) - gauss).abs() < ERROR, "{x}");
            let disc = (1.0 + x / (b * b)).powf(-1.5);
            assert!((Transform::of_index(1.0).at(x) - disc).abs() < ERROR, "{x}");
        }
        for n in [0.3, 0.5, 2.0, 8.0] {
            assert_eq!(Transform::of_index(n).at(0.0), 1.0);
            assert_eq!(Transform::of_index(n).at(f64::INFINITY), 0.0);
        }
    }

    /// Values of GalSim 2.8.5: `galsim.Sersic(n=n, half_light_radius=1).kValue(k, 0)` with a
    /// `kvalue_accuracy` of 1e-10.
    #[test]
    fn transforms_match_galsim() {
        const WAVENUMBERS: [f64; 6] = [0.05, 0.3, 1.0, 3.0, 10.0, 30.0];
        for (n, values) in [
            (
                0.5,
                [
                    0.999_098_722,
                    0.968_060_553,
                    0.697_206_418,
                    0.038_927_130,
                    0.0,
                    0.0,
                ],
            ),
            (
                0.77,
                [
                    0.998_887_401,
                    0.960_951_785,
                    0.659_737_065,
                    0.087_656_268,
                    0.001_536_005,
                    0.000_037_966,
                ],
            ),
            (
                1.37,
                [
                    0.998_230_432,
                    0.940_720_723,
                    0.604_661_407,
                    0.150_453_688,
                    0.011_720_947,
                    0.000_743_072,
                ],
            ),
            (
                2.6,
                [
                    0.995_496_330,
                    0.888_488_292,
                    0.561_900_876,
                    0.217_454_155,
                    0.043_083_824,
                    0.006_585_243,
                ],
            ),
            (
                4.0,
                [
                    0.988_353_558,
                    0.836_920_315,
                    0.544_502_480,
                    0.259_431_503,
                    0.077_690_147,
                    0.018_867_562,
                ],
            ),
        ] {
            for (k, value) in WAVENUMBERS.into_iter().zip(values) {
                let error = Transform::of_index(n).at(k * k) - value;
                assert!(error.abs() < ERROR, "n = {n}, k = {k}: {error:e}");
            }
        }
    }
}
