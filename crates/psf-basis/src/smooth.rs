//! Components of noisy samples that only stand out because they vary smoothly over the field.
//!
//! A component whose coefficients vary smoothly over the field lies in few of the many dimensions that
//! samples have: in the values of a polynomial in x and y. There the noise is much smaller than in all of
//! them. So the samples, divided by their noise, are first averaged with orthonormal polynomials as weights,
//! `y_i = sum_j q_ij h_j / sigma_j`, and the singular vectors of these few sums are the components. White
//! noise has singular values up to `sqrt L + sqrt m` there, for `m` polynomials and stamps of `L` pixels, in
//! place of `sqrt L + sqrt P` for `P` samples.
//!
//! Degrees are tried from the lowest on, each for what those before it left, because fewer polynomials have
//! less noise. Two things could be mistaken for components: white noise, below the threshold in 99 % of
//! cases, and noise that is not white. The second is measured: with signs drawn at random for the samples,
//! everything smooth turns into noise, and the largest singular value is that of the noise alone (Hong, Sheng
//! and Dobriban 2020, arXiv:2012.02985).

use faer::{Mat, MatRef, concat};
use ndarray::{Array1, Array2, ArrayView2, aview1};
use psf_types::maths::term_count;
use psf_types::{Position, SamplePositions};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::decomposition::{BasisError, columns_of, count_above, decompose, product, subtract_projection};
use crate::noise::{MAX_NOISE_RATIO, NoiseFloor};

/// Degrees of the polynomials.
const DEGREES: [usize; 6] = [1, 2, 3, 4, 6, 8];
/// Samples for each polynomial. With fewer, much of the noise is smooth, too.
const SAMPLES_PER_TERM: usize = 3;
/// A polynomial counts as dependent on others if less than this part of it is left.
const DEPENDENT: f64 = 1e-8;

/// Returns more components `[pixel, k]` of the samples, orthonormal and orthogonal to the components
/// `[pixel, k]` that are known. `rows` `[sample, pixel]` are the samples without their mean, and `variances`
/// those of the noise in each sample.
pub(crate) fn smooth_components(
    rows: ArrayView2<'_, f64>,
    positions: &SamplePositions,
    known: MatRef<'_, f64>,
    variances: &[f64],
) -> Result<Mat<f64>, BasisError> {
    // A sample without noise would outweigh all others.
    let least = variances.iter().copied().fold(0.0, f64::max) / (MAX_NOISE_RATIO * MAX_NOISE_RATIO);
    let noise: Vec<f64> = variances.iter().map(|v| v.max(least).sqrt()).collect();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let signs: Array1<f64> = noise
        .iter()
        .map(|_| if random.random() { 1.0 } else { -1.0 })
        .collect();
    let polynomials = polynomials(positions, &noise) / aview1(&noise);
    // The samples' sums `[pixel, polynomial]`, and those of the noise alone.
    let sums = |weights: &Array2<f64>| {
        let mut sums = product(columns_of(rows), columns_of(weights.view()));
        // Twice, because the known components may be large.
        subtract_projection(&mut sums, known);
        subtract_projection(&mut sums, known);
        sums
    };
    let (mut of_samples, mut of_noise) = (sums(&polynomials), sums(&(&polynomials * &signs)));

    let mut components = known.to_owned();
    for terms in DEGREES.map(|degree| term_count(degree) * positions.state_count()) {
        let dimensions = rows.ncols() - components.ncols();
        if terms > polynomials.nrows() || terms >= dimensions {
            break;
        }
        let (values, vectors) = decompose(of_samples.subcols(0, terms))?;
        let (noise, _) = decompose(of_noise.subcols(0, terms))?;
        let white = NoiseFloor::new(1.0, dimensions, terms);
        let found = count_above(&values, white.threshold * (noise[0] / white.edge).max(1.0));
        if found == 0 {
            continue;
        }
        let mut more = vectors.subcols(0, found).to_owned();
        subtract_projection(&mut more, components.as_ref());
        subtract_projection(&mut of_samples, more.as_ref());
        subtract_projection(&mut of_noise, more.as_ref());
        components = concat![[components, more]];
    }
    Ok(components
        .subcols(known.ncols(), components.ncols() - known.ncols())
        .to_owned())
}

/// Polynomials at the samples `[polynomial, sample]`, divided by the samples' noise, and made orthonormal. In
/// ascending order of their degrees, as many as the samples of the smallest state allow. Each state has its
/// own.
fn polynomials(positions: &SamplePositions, noise: &[f64]) -> Array2<f64> {
    let states: Vec<Vec<usize>> = (0..positions.state_count())
        .map(|state| positions.samples_of_state(state))
        .collect();
    let least = states.iter().map(Vec::len).min().unwrap_or(0);
    let fits = |degree: &usize| SAMPLES_PER_TERM * term_count(*degree) <= least;
    let degree = DEGREES.into_iter().rfind(fits);
    // Within -1 and 1.
    let [(x0, x1), (y0, y1)] = Position::bounds(positions.as_slice());
    let scaled = |v: f64, low: f64, high: f64| {
        if high > low {
            2.0 * (v - low) / (high - low) - 1.0
        } else {
            0.0
        }
    };
    let mut all = Array2::zeros((0, noise.len()));
    for order in degree.map_or(0..0, |degree| 0..degree + 1) {
        for of_y in 0..=order {
            for samples in &states {
                let mut polynomial = Array1::zeros(noise.len());
                for &sample in samples {
                    let at = positions.as_slice()[sample];
                    let (x, y) = (scaled(at.x(), x0, x1), scaled(at.y(), y0, y1));
                    let value = x.powi((order - of_y) as i32) * y.powi(of_y as i32);
                    polynomial[sample] = value / noise[sample];
                }
                let before = polynomial.dot(&polynomial).sqrt();
                // Gram and Schmidt, twice because of rounding.
                for _ in 0..2 {
                    let along: Array1<f64> = all.dot(&polynomial);
                    polynomial -= &along.dot(&all);
                }
                let norm = polynomial.dot(&polynomial).sqrt();
                // All samples may lie in a line.
                let is_new = norm > DEPENDENT * before;
                polynomial *= if is_new { 1.0 / norm } else { 0.0 };
                all.push_row(polynomial.view())
                    .expect("one value for each sample");
            }
        }
    }
    all
}
