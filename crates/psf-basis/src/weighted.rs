//! Principal components of samples whose pixels have weights.

use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};
use ndarray::{Array1, Array2, Array3, ArrayView1, ArrayView2, Axis, concatenate, s};
use psf_types::{PsfSamples, SamplePositions};
use rayon::prelude::*;

use crate::decomposition::{
    BasisError, columns_of, decompose, orthonormal_in_order, rows_of_columns, stamps_of,
};
use crate::fit::{BasisFit, BasisMethod, Svd, rows_of};
use crate::rank::{RankSelection, Spectrum};
use crate::smooth::smooth_components;

/// Weighted principal components: of samples with bad pixels, or of very different noise.
///
/// The mean, the components and the coefficients minimise `sum_ju w_ju (h_ju - B_0u - sum_k a_jk B_ku)^2`
/// over samples `j` and pixels `u`. They are found in turns (S. Bailey 2012, PASP 124, 1015), starting from
/// the components of [`Svd`], which also determines the rank. Pixels of weight 0 do not count, and are not
/// measured by the errors of the fit.
///
/// ```
/// use ndarray::Array3;
/// use psf_basis::{BasisMethod, WeightedPca};
/// use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};
/// // Samples that differ in one direction, and a bad pixel.
/// let mut stamps = Array3::from_shape_fn((5, 3, 3), |(j, y, x)| (1 + y) as f64 + (j * x) as f64);
/// let mut weights = Array3::ones((5, 3, 3));
/// (stamps[[3, 1, 1]], weights[[3, 1, 1]]) = (999.0, 0.0);
/// let positions = (0..5).map(|j| Position::of_pixel(j, 0)).collect();
/// let samples = PsfSamples::new(stamps, SamplePositions::new(positions, None)?, StampGrid::new(3, 3)?)?;
/// let svd = psf_basis::Svd::new().with_rank("1".parse()?);
/// let fit = WeightedPca::new(weights)?.with_svd(svd).fit(&samples)?;
/// assert!(fit.max_error() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct WeightedPca {
    /// `[sample, y, x]`.
    weights: Array3<f64>,
    svd: Svd,
}

/// The turns end when the sum of squares falls by less than this fraction.
const CONVERGED: f64 = 1e-10;
const MOST_TURNS: usize = 200;
/// Added to the diagonal of normal equations, relative to their trace, for samples with few good pixels.
const RIDGE: f64 = 1e-13;

impl WeightedPca {
    /// Weights `[sample, y, x]`, such as inverse variances of the pixels. 0 for bad pixels.
    ///
    /// # Errors
    /// [`BasisError::BadWeight`] for a weight that is not finite and at least 0, or a sample without any
    /// weight above 0.
    pub fn new(weights: Array3<f64>) -> Result<Self, BasisError> {
        for (sample, of_sample) in weights.outer_iter().enumerate() {
            let bad = of_sample.iter().find(|w| !(**w >= 0.0 && w.is_finite()));
            let sum = of_sample.sum();
            if let Some(&got) = bad.or(Some(&sum).filter(|sum| **sum <= 0.0)) {
                return Err(BasisError::BadWeight { sample, got });
            }
        }
        Ok(Self {
            weights,
            svd: Svd::new(),
        })
    }

    /// Sets the first components and the rank: those that this method finds for samples whose bad pixels are
    /// filled with the mean.
    #[must_use]
    pub fn with_svd(self, svd: Svd) -> Self {
        Self { svd, ..self }
    }

    /// The weights of the same samples, each divided by its divisor: inverse variances grow by its square.
    ///
    /// # Panics
    /// If there is not one divisor for each sample.
    #[must_use]
    pub fn for_divided(mut self, divisors: &[f64]) -> Self {
        assert_eq!(divisors.len(), self.weights.dim().0, "a divisor for each sample");
        for (mut weights, divisor) in self.weights.outer_iter_mut().zip(divisors) {
            weights.mapv_inplace(|w| w * divisor * divisor);
        }
        self
    }

    /// The samples with the mean in place of pixels of weight 0, scaled to the sample.
    ///
    /// # Errors
    /// [`BasisError::WeightShape`] if there is not one weight for each pixel.
    pub fn filled(&self, samples: &PsfSamples) -> Result<PsfSamples, BasisError> {
        let mut stamps = samples.stamps().to_owned();
        if stamps.dim() != self.weights.dim() {
            let (expected, got) = (stamps.dim(), self.weights.dim());
            return Err(BasisError::WeightShape { expected, got });
        }
        let weighted = (&stamps * &self.weights).sum_axis(Axis(0));
        let whole = self.weights.sum_axis(Axis(0));
        let mean = ndarray::Zip::from(&weighted)
            .and(&whole)
            .map_collect(|sum, weight| if *weight > 0.0 { sum / weight } else { 0.0 });
        for (mut stamp, weights) in stamps.outer_iter_mut().zip(self.weights.outer_iter()) {
            let products = ndarray::Zip::from(&stamp)
                .and(&weights)
                .and(&mean)
                .fold((0.0, 0.0), |(own, of_mean), h, w, m| {
                    (own + w * h * m, of_mean + w * m * m)
                });
            let scale = if products.1 > 0.0 {
                products.0 / products.1
            } else {
                1.0
            };
            ndarray::Zip::from(&mut stamp)
                .and(&weights)
                .and(&mean)
                .for_each(|h, w, m| {
                    if *w == 0.0 {
                        *h = scale * m;
                    }
                });
        }
        Ok(PsfSamples::new(
            stamps,
            samples.positions().clone(),
            samples.grid(),
        )?)
    }
}

impl BasisMethod for WeightedPca {
    fn fit(&self, samples: &PsfSamples) -> Result<BasisFit, BasisError> {
        let mut filled = self.filled(samples)?;
        let weights = self.weights.as_standard_layout();
        let weights = rows_of(weights.view());
        if weights.iter().any(|w| *w == 0.0) {
            // Few components fill bad pixels better than the mean does, and do not follow what is filled in.
            let first = self.svd.with_rank(RankSelection::Elbow).fit(&filled)?;
            filled = Turns::solved(&first, first.rank(), &filled, weights).filled(&filled)?;
        }
        let first = self.svd.fit(&filled)?;
        let spectrum = first.spectrum().expect("that of an SVD");
        let mut turns = Turns::solved(&first, first.rank() - spectrum.smooth, &filled, weights);
        let mut spectrum = spectrum.clone();
        if spectrum.smooth > 0 {
            spectrum.smooth = turns.add_smooth(filled.positions())?;
        }
        turns.into_fit(&filled, spectrum)
    }
}

/// The unknowns, which are found in turns.
struct Turns<'a> {
    rows: ArrayView2<'a, f64>,
    weights: ArrayView2<'a, f64>,
    mean: Option<Array1<f64>>,
    /// `[component, pixel]`.
    components: Array2<f64>,
    /// `[sample, component]`.
    coefficients: Array2<f64>,
}

impl<'a> Turns<'a> {
    /// Starts from the first `rank` components of a fit, and takes turns until they no longer change the sum
    /// of squares.
    fn solved(first: &BasisFit, rank: usize, samples: &'a PsfSamples, weights: ArrayView2<'a, f64>) -> Self {
        let basis = first.basis();
        let mut turns = Self {
            rows: rows_of(samples.stamps()),
            weights,
            mean: basis.mean().map(|mean| mean.iter().copied().collect()),
            components: rows_of(basis.components()).slice_move(s![..rank, ..]).to_owned(),
            coefficients: Array2::zeros((0, 0)),
        };
        let mut before = f64::INFINITY;
        for _ in 0..MOST_TURNS {
            turns.update_coefficients();
            turns.update_stamps();
            let squares = turns.squares();
            if squares >= before * (1.0 - CONVERGED) {
                break;
            }
            before = squares;
        }
        turns.update_coefficients();
        turns
    }

    /// The part of a sample that the mean leaves.
    fn rest(&self, sample: usize) -> Array1<f64> {
        match &self.mean {
            Some(mean) => &self.rows.row(sample) - mean,
            None => self.rows.row(sample).to_owned(),
        }
    }

    fn update_coefficients(&mut self) {
        let solved: Vec<Array1<f64>> = (0..self.rows.nrows())
            .into_par_iter()
            .map(|sample| {
                least_squares(
                    self.components.t(),
                    self.rest(sample).view(),
                    self.weights.row(sample),
                )
                .0
            })
            .collect();
        let shape = (self.rows.nrows(), self.components.nrows());
        self.coefficients = Array2::from_shape_fn(shape, |(sample, k)| solved[sample][k]);
    }

    /// The mean and the components at every pixel: least squares over the samples.
    fn update_stamps(&mut self) {
        let first = usize::from(self.mean.is_some());
        let terms = Array2::from_shape_fn((self.rows.nrows(), self.components.nrows() + first), |(j, k)| {
            if k < first {
                1.0
            } else {
                self.coefficients[(j, k - first)]
            }
        });
        let solved: Vec<Option<Array1<f64>>> = (0..self.rows.ncols())
            .into_par_iter()
            .map(|pixel| {
                let weights = self.weights.column(pixel);
                // A pixel that is bad in all samples keeps its values.
                let known = weights.iter().any(|w| *w > 0.0);
                known.then(|| least_squares(terms.view(), self.rows.column(pixel), weights).0)
            })
            .collect();
        for (pixel, solved) in solved.into_iter().enumerate() {
            let Some(solved) = solved else { continue };
            if let Some(mean) = &mut self.mean {
                mean[pixel] = solved[0];
            }
            for (k, value) in solved.iter().skip(first).enumerate() {
                self.components[(k, pixel)] = *value;
            }
        }
    }

    /// Adds the components that vary smoothly over the field, and returns their number. The turns would not
    /// keep them, because each explains less of the samples than noise does.
    fn add_smooth(&mut self, positions: &SamplePositions) -> Result<usize, BasisError> {
        let mut rows = self.filled_rows();
        if let Some(mean) = &self.mean {
            rows -= mean;
        }
        // Any orthonormal stamps that span the same space.
        let (_, known) = decompose(columns_of(self.components.as_standard_layout().view()))?;
        self.components = rows_of_columns(known.as_ref(), self.components.nrows());
        self.update_coefficients();
        let left = &rows - &self.coefficients.dot(&self.components);
        let samples = left.outer_iter().zip(self.weights.outer_iter());
        let variances: Vec<f64> = samples
            .map(|(left, weights)| {
                let good = weights.iter().filter(|w| **w > 0.0).count();
                left.dot(&left) / good.saturating_sub(self.components.nrows()).max(1) as f64
            })
            .collect();
        let more = smooth_components(rows.view(), positions, known.as_ref(), &variances)?;
        let found = more.ncols();
        self.components = concatenate![Axis(0), self.components, rows_of_columns(more.as_ref(), found)];
        self.update_coefficients();
        Ok(found)
    }

    /// The weighted sum of squares.
    fn squares(&self) -> f64 {
        let of_samples = (0..self.rows.nrows()).into_par_iter().map(|sample| {
            let rest = self.rest(sample) - self.coefficients.row(sample).dot(&self.components);
            let squares = rest.iter().zip(self.weights.row(sample)).map(|(d, w)| w * d * d);
            squares.sum::<f64>()
        });
        // In a fixed order.
        of_samples.collect::<Vec<_>>().into_iter().sum()
    }

    /// The samples `[sample, pixel]` with the model in place of bad pixels.
    fn filled_rows(&self) -> Array2<f64> {
        let mut rows = self.rows.to_owned();
        for (sample, mut row) in rows.outer_iter_mut().enumerate() {
            let mut model = self.coefficients.row(sample).dot(&self.components);
            if let Some(mean) = &self.mean {
                model += mean;
            }
            for ((value, weight), model) in row.iter_mut().zip(self.weights.row(sample)).zip(&model) {
                if *weight == 0.0 {
                    *value = *model;
                }
            }
        }
        rows
    }

    /// As [`filled_rows`](Self::filled_rows), with the positions and the grid of the samples.
    fn filled(&self, samples: &PsfSamples) -> Result<PsfSamples, BasisError> {
        let (grid, positions) = (samples.grid(), samples.positions().clone());
        Ok(PsfSamples::new(
            stamps_of(self.filled_rows(), grid),
            positions,
            grid,
        )?)
    }

    fn into_fit(self, samples: &PsfSamples, spectrum: Spectrum) -> Result<BasisFit, BasisError> {
        let (grid, rank) = (samples.grid(), self.components.nrows());
        let (ny, nx) = grid.dim();
        // Errors then measure good pixels alone.
        let filled = self.filled(samples)?;
        // Weights may be inverse variances up to a factor, such as 0 and 1.
        let good = self.weights.iter().filter(|w| **w > 0.0).count();
        let unknowns = (rank + usize::from(self.mean.is_some())) * ny * nx + rank * samples.len();
        let scale = (self.squares() / good.saturating_sub(unknowns).max(1) as f64).sqrt();
        let stamps = stamps_of(self.components, grid);
        let mean = self
            .mean
            .map(|mean| mean.into_shape_with_order((ny, nx)).expect("row-major"));
        let (basis, coefficients) = orthonormal_in_order(mean, stamps, self.coefficients.view(), grid)?;
        let components = rows_of(basis.components());
        let is_noisy = spectrum.noise_sigma.is_some();
        let noise = is_noisy.then(|| {
            let rows = self.rows.outer_iter().zip(self.weights.outer_iter());
            rows.map(|(row, weights)| scale * least_squares(components.t(), row, weights).1)
                .collect()
        });
        let fit = BasisFit::new(&filled, basis.clone(), coefficients, Some(spectrum))?;
        Ok(fit.with_noise(noise))
    }
}

/// Solves `min_a sum_i w_i (y_i - sum_k t_ik a_k)^2` for terms `[i, k]`. Also returns the square root of the
/// solution's mean variance, if weights are inverse variances of `y`.
fn least_squares(
    terms: ArrayView2<'_, f64>,
    values: ArrayView1<'_, f64>,
    weights: ArrayView1<'_, f64>,
) -> (Array1<f64>, f64) {
    let count = terms.ncols();
    if count == 0 {
        return (Array1::zeros(0), 0.0);
    }
    let (mut normal, mut known) = (Mat::<f64>::zeros(count, count), Mat::<f64>::zeros(count, 1));
    for ((row, value), weight) in terms.outer_iter().zip(values).zip(weights) {
        if *weight == 0.0 {
            continue;
        }
        for (i, ti) in row.iter().enumerate() {
            let weighted = weight * ti;
            known[(i, 0)] += weighted * value;
            for (j, tj) in row.iter().take(i + 1).enumerate() {
                normal[(i, j)] += weighted * tj;
            }
        }
    }
    let trace: f64 = (0..count).map(|i| normal[(i, i)]).sum();
    for i in 0..count {
        normal[(i, i)] += RIDGE * trace + f64::MIN_POSITIVE;
    }
    match normal.llt(Side::Lower) {
        Ok(factor) => {
            let solved = factor.solve(&known);
            let inverse = factor.solve(Mat::<f64>::identity(count, count));
            let variance = (0..count).map(|i| inverse[(i, i)]).sum::<f64>() / count as f64;
            (Array1::from_shape_fn(count, |i| solved[(i, 0)]), variance.sqrt())
        }
        Err(_) => (Array1::zeros(count), f64::INFINITY),
    }
}

#[cfg(test)]
mod tests {
    use psf_types::{Position, SamplePositions, StampGrid};
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::PixelNoise;

    /// Sums of three stamps, and weights with a tenth of the pixels bad.
    fn samples_with_bad_pixels() -> (PsfSamples, PsfSamples, Array3<f64>) {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let stamps = Array3::from_shape_fn((3, 8, 8), |(k, y, x)| {
            ((k + 1) as f64 * (y as f64 + 0.3 * x as f64)).sin()
        });
        let mut exact = Array3::zeros((30, 8, 8));
        for mut sample in exact.outer_iter_mut() {
            sample.fill(2.0);
            for stamp in stamps.outer_iter() {
                sample.scaled_add(random.random_range(-1.0..1.0), &stamp);
            }
        }
        let mut weights = Array3::from_shape_fn(exact.dim(), |_| random.random_range(0.5..2.0));
        let mut spoilt = exact.clone();
        for (value, weight) in spoilt.iter_mut().zip(&mut weights) {
            if random.random::<f64>() < 0.1 {
                (*value, *weight) = (50.0, 0.0);
            }
        }
        let positions = (0..30).map(|j| Position::of_pixel(j, 0)).collect();
        let positions = SamplePositions::new(positions, None).unwrap();
        let made =
            |stamps| PsfSamples::new(stamps, positions.clone(), StampGrid::new(8, 8).unwrap()).unwrap();
        (made(exact), made(spoilt), weights)
    }

    #[test]
    fn bad_pixels_do_not_count() {
        let (exact, spoilt, weights) = samples_with_bad_pixels();
        let svd = Svd::new().with_rank(RankSelection::Fixed(3));
        let fit = WeightedPca::new(weights)
            .unwrap()
            .with_svd(svd)
            .fit(&spoilt)
            .unwrap();
        assert!(fit.max_error() < 1e-4, "{}", fit.max_error());
        let basis = fit.basis();
        for (sample, own) in fit.coefficients().values().outer_iter().enumerate() {
            let mut model = basis.mean().unwrap().to_owned();
            for (a, stamp) in own.iter().zip(basis.components().outer_iter()) {
                model.scaled_add(*a, &stamp);
            }
            // Bad pixels are found from the others.
            let error = (&model - &exact.stamp(sample))
                .iter()
                .fold(0.0_f64, |m, v| m.max(v.abs()));
            assert!(error < 1e-3, "sample {sample}: {error}");
        }
    }

    #[test]
    fn equal_weights_give_the_components_of_the_samples() {
        let (exact, _, weights) = samples_with_bad_pixels();
        let svd = Svd::new().with_rank(RankSelection::Fixed(2));
        let equal = WeightedPca::new(Array3::from_elem(weights.dim(), 4.0))
            .unwrap()
            .with_svd(svd);
        let (weighted, plain) = (equal.fit(&exact).unwrap(), svd.fit(&exact).unwrap());
        for (a, b) in weighted.errors().iter().zip(plain.errors()) {
            assert!((a - b).abs() < 1e-6);
        }
        // These samples have no noise.
        assert!(weighted.noise().is_none());
    }

    #[test]
    fn the_noise_of_coefficients_is_that_of_the_weights() {
        let (exact, _, weights) = samples_with_bad_pixels();
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let sigmas: Vec<f64> = (0..exact.len()).map(|j| 0.02 * (1 + j % 3) as f64).collect();
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let mut stamps = exact.stamps().to_owned();
        let mut weights = weights;
        for (mut stamp, sigma) in stamps.outer_iter_mut().zip(&sigmas) {
            stamp.mapv_inplace(|v| v + sigma * normal());
        }
        for (mut weights, sigma) in weights.outer_iter_mut().zip(&sigmas) {
            // Inverse variances up to a factor.
            weights.fill(7.0 / sigma.powi(2));
        }
        let noisy = PsfSamples::new(stamps, exact.positions().clone(), exact.grid()).unwrap();
        let svd = Svd::new()
            .with_rank(RankSelection::Fixed(3))
            .with_noise(PixelNoise::Known(0.04));
        let fit = WeightedPca::new(weights)
            .unwrap()
            .with_svd(svd)
            .fit(&noisy)
            .unwrap();
        for (noise, sigma) in fit.noise().unwrap().iter().zip(&sigmas) {
            assert!((noise / sigma - 1.0).abs() < 0.1, "{noise} {sigma}");
        }
    }

    #[test]
    fn bad_weights_are_refused() {
        let mut weights = Array3::ones((2, 2, 2));
        weights[[1, 0, 1]] = -1.0;
        let error = WeightedPca::new(weights).unwrap_err();
        assert!(matches!(error, BasisError::BadWeight { sample: 1, got } if got == -1.0));
        let mut weights = Array3::ones((2, 2, 2));
        weights.index_axis_mut(Axis(0), 0).fill(0.0);
        assert!(matches!(
            WeightedPca::new(weights),
            Err(BasisError::BadWeight { sample: 0, .. })
        ));
        let (exact, ..) = samples_with_bad_pixels();
        let wrong = WeightedPca::new(Array3::ones((2, 2, 2))).unwrap().fit(&exact);
        assert!(matches!(wrong, Err(BasisError::WeightShape { .. })));
    }
}
