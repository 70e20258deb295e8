//! Fits a basis to samples. There are two methods: [`Svd`] computes the basis from the samples, and
//! [`GivenStamps`] uses stamps from elsewhere.

use ndarray::{Array2, Array3, ArrayView1, ArrayView2, ArrayView3, Axis, concatenate};
use psf_types::{DataError, PsfBasis, PsfSamples, SampleCoefficients, named, through_text};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::circles::{Circles, SampleFlux};
use crate::components::{Components, Krylov, is_large};
use crate::decomposition::{
    BasisError, ROUNDING_UNITS, fix_signs, orthonormal_in_order, rows_of_columns, stamps_of,
};
use crate::noise::{NoiseSearch, PixelNoise, degrees_of_freedom, leverages, variances_after};
use crate::rank::{RankSelection, Spectrum};
use crate::smooth::smooth_components;

/// A method that makes a basis and the samples' coefficients from PSF samples.
///
/// Object-safe, so that methods can be swapped at run time. Implementations usually return
/// [`BasisFit::new`], which measures the truncation errors.
pub trait BasisMethod: std::fmt::Debug {
    /// Fits a basis to the samples.
    ///
    /// # Errors
    /// [`BasisError`]. Methods in other crates use [`BasisError::External`].
    fn fit(&self, samples: &PsfSamples) -> Result<BasisFit, BasisError>;
}

/// A basis, the samples' coefficients in it, and the error of each sample.
#[derive(Debug, Clone, PartialEq)]
pub struct BasisFit {
    basis: PsfBasis,
    coefficients: SampleCoefficients,
    spectrum: Option<Spectrum>,
    errors: Vec<f64>,
    circle_errors: Vec<f64>,
    noise: Option<Vec<f64>>,
}

impl BasisFit {
    /// Combines the parts of a fit and measures the truncation error of every sample,
    /// `||h_j - B_0 - sum_k a_jk B_k||_2 / ||h_j||_2`, and the error of its flux in circles.
    ///
    /// # Errors
    /// [`BasisError::Data`] when the parts do not match each other or the samples.
    pub fn new(
        samples: &PsfSamples,
        basis: PsfBasis,
        coefficients: Array2<f64>,
        spectrum: Option<Spectrum>,
    ) -> Result<Self, BasisError> {
        // `SampleCoefficients` checks that there is one row of coefficients for each sample.
        let coefficients = SampleCoefficients::new(coefficients, samples.positions().clone())?;
        let what = "coefficients, one for each component of the basis";
        DataError::check_count(what, basis.rank(), coefficients.component_count())?;
        check_grid(samples, &basis)?;
        let rows = rows_of(samples.stamps());
        let of_samples = (&Sizes::new(rows), &Circles::new(samples.grid()));
        Ok(Self::measured(
            (rows, false),
            of_samples,
            basis,
            coefficients,
            spectrum,
        ))
    }

    /// Measures the truncation error of every row `[sample, pixel]`, and the error of its flux in circles.
    /// `is_centred` states whether the mean stamp is already subtracted from the rows.
    fn measured(
        (rows, is_centred): (ArrayView2<'_, f64>, bool),
        (sizes, circles): (&Sizes, &Circles),
        basis: PsfBasis,
        coefficients: SampleCoefficients,
        spectrum: Option<Spectrum>,
    ) -> Self {
        let noisy = spectrum.as_ref().is_some_and(|of| of.noise_sigma.is_some());
        let (components, values) = (rows_of(basis.components()), coefficients.values());
        let mean = mean_of(&basis).filter(|_| !is_centred);
        let block = (BLOCK_PIXELS / rows.ncols()).clamp(FEWEST, BLOCK);
        let blocks: Vec<_> = rows
            .axis_chunks_iter(Axis(0), block)
            .zip(values.axis_chunks_iter(Axis(0), block))
            .zip(sizes.norms.chunks(block).zip(sizes.fluxes.chunks(block)))
            .collect();
        let errors = blocks
            .into_par_iter()
            .flat_map_iter(|((block, weights), (norms, fluxes))| {
                let mut residual = &block - &weights.dot(&components);
                if let Some(mean) = mean {
                    residual -= &mean;
                }
                let sizes = norms.iter().zip(fluxes);
                let errors = residual.outer_iter().zip(sizes).map(|(rest, (norm, &flux))| {
                    let in_circles = circles.error(rest, flux, noisy);
                    (rest.dot(&rest).sqrt() / norm, in_circles)
                });
                errors.collect::<Vec<_>>()
            });
        let (errors, circle_errors) = errors.unzip();
        Self {
            basis,
            coefficients,
            spectrum,
            errors,
            circle_errors,
            noise: None,
        }
    }

    /// States the noise of the samples' coefficients ([`noise`](Self::noise)).
    #[must_use]
    pub fn with_noise(self, noise: Option<Vec<f64>>) -> Self {
        Self { noise, ..self }
    }

    /// The standard deviation of the noise in each sample's coefficients, in sample order. None if there is
    /// no noise, or if it is not known.
    ///
    /// [`Svd`] finds it from the part of each sample that the basis leaves out, which is noise where the
    /// fit found any.
    pub fn noise(&self) -> Option<&[f64]> {
        self.noise.as_deref()
    }

    /// The noise of samples of these norms, from their truncation errors.
    fn noise_of_residuals(&self, norms: &[f64]) -> Option<Vec<f64>> {
        self.spectrum.as_ref()?.noise_sigma.filter(|&sigma| sigma > 0.0)?;
        let values = self.coefficients.values();
        let squares = |row: ArrayView1<'_, f64>| row.dot(&row);
        let sizes: Vec<f64> = values.columns().into_iter().map(|a| squares(a).sqrt()).collect();
        let of_mean = usize::from(self.basis.mean().is_some());
        let (pixels, components) = (self.basis.grid().pixel_count(), self.rank() + of_mean);
        if pixels <= components {
            return None;
        }
        let of_mean = of_mean as f64 / norms.len() as f64;
        let leverages = leverages(values, &sizes, self.rank());
        let noise = self.errors.iter().zip(norms).zip(leverages);
        let noise: Vec<f64> = noise
            .map(|((error, norm), leverage)| {
                error * norm / degrees_of_freedom(pixels, components, leverage + of_mean).sqrt()
            })
            .collect();
        noise.iter().all(|n| *n > 0.0 && n.is_finite()).then_some(noise)
    }

    /// The basis.
    pub fn basis(&self) -> &PsfBasis {
        &self.basis
    }

    /// The samples' coefficients.
    pub fn coefficients(&self) -> &SampleCoefficients {
        &self.coefficients
    }

    /// The truncation error of every sample: relative L2 norm, in sample order.
    pub fn errors(&self) -> &[f64] {
        &self.errors
    }

    /// For every sample, the largest error of the flux in a circle about the source, relative to the
    /// sample's flux: `max_R |sum_{|u| <= R} dh(u)| / |sum_u h(u)|`, in sample order. `R` are multiples
    /// of half a stamp pixel. If the samples are noisy, only what noise does not explain counts (five
    /// standard deviations of the noise in the circle). 0 for samples without flux.
    pub fn circle_errors(&self) -> &[f64] {
        &self.circle_errors
    }

    /// Returns the basis and the coefficients without copying them.
    pub fn into_parts(self) -> (PsfBasis, SampleCoefficients) {
        (self.basis, self.coefficients)
    }

    /// The spectrum of singular values, or `None` if the method has none.
    pub fn spectrum(&self) -> Option<&Spectrum> {
        self.spectrum.as_ref()
    }

    /// The number of components, without the mean.
    pub fn rank(&self) -> usize {
        self.basis.rank()
    }

    /// The largest truncation error over the samples.
    pub fn max_error(&self) -> f64 {
        self.errors.iter().copied().fold(0.0, f64::max)
    }

    /// The root mean square of the truncation errors.
    pub fn rms_error(&self) -> f64 {
        (self.errors.iter().map(|e| e * e).sum::<f64>() / self.errors.len() as f64).sqrt()
    }
}

/// Samples are processed in blocks of at most this size, so that the residuals of thousands of samples
/// need little memory.
const BLOCK: usize = 64;
/// Blocks of wide stamps are smaller: about this number of pixels, but at least [`FEWEST`] samples,
/// because every block reads the whole basis.
const BLOCK_PIXELS: usize = 1 << 24;
/// The smallest number of samples in a block.
const FEWEST: usize = 8;

/// Returns stamps `[stamp, y, x]`, which must be in row-major order, as `[stamp, pixel]`.
pub(crate) fn rows_of(stamps: ArrayView3<'_, f64>) -> ArrayView2<'_, f64> {
    let (count, ny, nx) = stamps.dim();
    stamps.into_shape_with_order((count, ny * nx)).expect("row-major")
}

/// The mean stamp of a basis, pixel after pixel.
fn mean_of(basis: &PsfBasis) -> Option<ArrayView1<'_, f64>> {
    let pixels = basis.grid().pixel_count();
    basis
        .mean()
        .map(|mean| mean.into_shape_with_order(pixels).expect("row-major"))
}

/// The sizes of samples, to which their errors are relative.
struct Sizes {
    norms: Vec<f64>,
    fluxes: Vec<SampleFlux>,
}

impl Sizes {
    /// The sizes of rows `[sample, pixel]`.
    fn new(rows: ArrayView2<'_, f64>) -> Self {
        Self {
            norms: rows.outer_iter().map(|row| row.dot(&row).sqrt()).collect(),
            fluxes: rows.outer_iter().map(SampleFlux::of).collect(),
        }
    }
}

/// A basis of given stamps, with an optional mean stamp. It is for bases from elsewhere, such as analytic
/// modes, the principal components of another instrument, or factors without negative values.
///
/// Orthogonal stamps are scaled to unit norm. Other stamps are made orthonormal
/// ([`orthonormal_in_order`](crate::orthonormal_in_order)). The coefficients are inner products,
/// `a_jk = <h_j - B_0, B_k>`, which is the least-squares solution.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenStamps {
    mean: Option<Array2<f64>>,
    stamps: Array3<f64>,
}

impl GivenStamps {
    /// Stamps `[component, y, x]` of any norm except 0.
    ///
    /// # Errors
    /// [`BasisError::ZeroStamp`] for a stamp that is zero everywhere.
    pub fn new(stamps: Array3<f64>, mean: Option<Array2<f64>>) -> Result<Self, BasisError> {
        let mut stamps = stamps.as_standard_layout().into_owned();
        let mean = mean.map(|mean| mean.as_standard_layout().into_owned());
        for (index, mut stamp) in stamps.axis_iter_mut(Axis(0)).enumerate() {
            let norm = stamp.iter().map(|v| v * v).sum::<f64>().sqrt();
            if norm == 0.0 {
                return Err(BasisError::ZeroStamp { index });
            }
            stamp.mapv_inplace(|v| v / norm);
        }
        Ok(Self { mean, stamps })
    }
}

impl BasisMethod for GivenStamps {
    fn fit(&self, samples: &PsfSamples) -> Result<BasisFit, BasisError> {
        let (stamps, grid) = (self.stamps.clone(), samples.grid());
        let own = PsfBasis::new(self.mean.clone(), stamps, grid);
        let basis = match own {
            Err(DataError::NotOrthonormal { .. }) => {
                let each = Array2::eye(self.stamps.dim().0);
                orthonormal_in_order(self.mean.clone(), self.stamps.clone(), each.view(), grid)?.0
            }
            own => own?,
        };
        project(samples, basis)
    }
}

/// Finds the coefficients of samples in a basis, `a_jk = <h_j - B_0, B_k>`, the least-squares
/// solution. The basis is unchanged.
///
/// # Errors
/// [`BasisError::Data`] when the samples' stamps have another grid than the basis.
pub fn project(samples: &PsfSamples, basis: PsfBasis) -> Result<BasisFit, BasisError> {
    check_grid(samples, &basis)?;
    let components = rows_of(basis.components());
    let rows = rows_of(samples.stamps());
    let blocks: Vec<_> = rows.axis_chunks_iter(Axis(0), BLOCK).collect();
    let products: Vec<_> = blocks
        .into_par_iter()
        .map(|block| block.dot(&components.t()))
        .collect();
    let views: Vec<_> = products.iter().map(|block| block.view()).collect();
    let mut coefficients = concatenate(Axis(0), &views).expect("equal numbers of components");
    if let Some(mean) = mean_of(&basis) {
        coefficients -= &components.dot(&mean);
    }
    BasisFit::new(samples, basis, coefficients, None)
}

/// Checks that samples have the stamp grid of a basis.
fn check_grid(samples: &PsfSamples, basis: &PsfBasis) -> Result<(), BasisError> {
    if basis.grid() == samples.grid() {
        return Ok(());
    }
    let (expected, got) = (samples.grid().dim(), basis.grid().dim());
    Err(DataError::StampShape { expected, got }.into())
}

/// The choice whether to subtract the mean stamp before the decomposition.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum Centring {
    /// The mean of the samples is a separate stamp. Samples of unit flux then have components of
    /// zero flux, so that every truncation preserves the flux.
    #[default]
    Mean,
    /// No mean stamp, as in Bai, Jia et al. 2025, the paper that describes psfield's method.
    None,
}

named!(Centring, "centring", "mean or none", "mean" => Mean, "none" => None);
through_text!(Centring);

/// The leading left singular vectors of the matrix whose columns are the samples,
/// `X - mean = U S V^T`, `B_k = U_k`. Of all bases of `K` components this one has the smallest sum
/// of squared residuals over all samples (Eckart and Young 1936).
///
/// The decomposition is a thin SVD in f64. If there are at least 1024 samples and 1024 pixels, only
/// leading components are computed, in a block Krylov space, unless the rank is `full`. Each has a
/// residual of at most 1e-12 of the largest singular value. If the selected rank depends on
/// components that have not converged, all are computed. The value of largest magnitude in each
/// component is positive, which fixes the signs. The result does not depend on the number of
/// threads.
///
/// ```
/// use ndarray::Array3;
/// use psf_basis::{BasisMethod, RankSelection, Svd};
/// use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};
/// let stamps = Array3::from_shape_fn((4, 3, 3), |(j, y, x)| if (y, x) == (1, 1) { 9.0 } else { 0.1 * j as f64 });
/// let positions = (0..4).map(|j| Position::of_pixel(j, 0)).collect();
/// let samples = PsfSamples::new(stamps, SamplePositions::new(positions, None)?, StampGrid::new(3, 3)?)?;
/// let fit = Svd::new().with_rank(RankSelection::Full).fit(&samples)?;
/// assert_eq!(fit.rank(), 1);
/// assert!(fit.max_error() < 1e-14);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Svd {
    centring: Centring,
    rank: RankSelection,
    noise: PixelNoise,
}

impl Svd {
    /// Mean-centred, with rank `auto` and estimated noise.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets whether there is a mean stamp.
    #[must_use]
    pub fn with_centring(self, centring: Centring) -> Self {
        Self { centring, ..self }
    }

    /// Sets the selection of the number of components.
    #[must_use]
    pub fn with_rank(self, rank: RankSelection) -> Self {
        Self { rank, ..self }
    }

    /// Sets the noise in the samples' pixels: given or estimated.
    #[must_use]
    pub fn with_noise(self, noise: PixelNoise) -> Self {
        Self { noise, ..self }
    }

    /// Fits a basis to the samples and to more training stamps `[stamp, y, x]`, such as the
    /// samples' PSFs at sub-pixel shifts. The mean and the components are computed from all stamps,
    /// the coefficients and errors from the samples only. Takes the samples, because thousands of
    /// them need much memory.
    ///
    /// # Errors
    /// [`BasisError`] when shapes differ, the rank is not available, the noise level is not valid
    /// or the decomposition fails.
    pub fn fit_augmented(
        &self,
        samples: PsfSamples,
        training: ArrayView3<'_, f64>,
    ) -> Result<BasisFit, BasisError> {
        self.fit_for_field(samples, training, &|_| RankSelection::AUTO_ERROR)
    }

    /// As [`fit_augmented`](Self::fit_augmented), with a smaller truncation error for the rank `auto`.
    ///
    /// `smaller_error` receives the samples' coefficients of the components that the rank `auto` usually
    /// keeps. It returns the largest truncation error that suits their interpolation, which replaces
    /// [`RankSelection::AUTO_ERROR`] if it is smaller. It is called once, and not for other ranks.
    ///
    /// # Errors
    /// As for [`fit_augmented`](Self::fit_augmented).
    pub fn fit_for_field(
        &self,
        samples: PsfSamples,
        training: ArrayView3<'_, f64>,
        smaller_error: &dyn Fn(&SampleCoefficients) -> f64,
    ) -> Result<BasisFit, BasisError> {
        let (grid, positions) = (samples.grid(), samples.positions().clone());
        let (ny, nx) = grid.dim();
        let (expected, got) = ((ny, nx), (training.dim().1, training.dim().2));
        if expected != got {
            return Err(BasisError::TrainingShape { expected, got });
        }
        let sizes = Sizes::new(rows_of(samples.stamps()));
        let circles = Circles::new(grid);
        let mut stack = samples.into_stamps();
        stack.append(Axis(0), training).expect("equal shapes");

        let (count, pixels) = (stack.dim().0, grid.pixel_count());
        let mut rows = stack.into_shape_with_order((count, pixels)).expect("row-major");
        let frobenius = rows.iter().map(|v| v * v).sum::<f64>().sqrt();
        let mean = match self.centring {
            Centring::Mean => {
                let mean = rows.mean_axis(Axis(0)).expect("at least one sample");
                rows -= &mean;
                Some(mean)
            }
            Centring::None => None,
        };
        let freedom = count - usize::from(mean.is_some());
        let rounding = ROUNDING_UNITS * f64::EPSILON * frobenius;
        let smaller_error = |coefficients: ArrayView2<'_, f64>| {
            let coefficients = SampleCoefficients::new(coefficients.to_owned(), positions.clone())?;
            Ok(smaller_error(&coefficients))
        };
        let (found, mut spectrum, rank) = self.decide(
            rows.view(),
            (&sizes, &circles),
            (freedom, rounding),
            &smaller_error,
        )?;
        // The samples come first in the stack.
        let count = sizes.norms.len();
        let of_samples = rows.slice(ndarray::s![..count, ..]);
        let coefficients = found.coefficients.slice(ndarray::s![..count, ..rank]);
        let mut coefficients = coefficients.to_owned();
        let mut components = rows_of_columns(found.vectors.as_ref(), rank);
        let is_limited_by_noise = self.rank == RankSelection::Auto && rank == spectrum.significant;
        if is_limited_by_noise && spectrum.noise_sigma.is_some() && rank < pixels {
            let variances = match self.noise {
                PixelNoise::Known(sigma) => vec![sigma * sigma; count],
                PixelNoise::Estimate => variances_after(&found, pixels, rank)[..count].to_vec(),
            };
            let known = found.vectors.subcols(0, rank);
            let more = smooth_components(of_samples, &positions, known, &variances)?;
            spectrum.smooth = more.ncols();
            let more = rows_of_columns(more.as_ref(), spectrum.smooth);
            coefficients = concatenate![Axis(1), coefficients, of_samples.dot(&more.t())];
            components = concatenate![Axis(0), components, more];
        }
        drop(found);
        let rank = components.nrows();
        if rank == 0 && mean.is_none() {
            return Err(BasisError::RankZero);
        }
        fix_signs(&mut components, &mut coefficients);

        let mean = mean.map(|m| m.into_shape_with_order((ny, nx)).expect("row-major"));
        let basis = PsfBasis::new(mean, stamps_of(components, grid), grid)?;
        let coefficients = SampleCoefficients::new(coefficients, positions)?;
        let rows = (of_samples, true);
        let fit = BasisFit::measured(rows, (&sizes, &circles), basis, coefficients, Some(spectrum));
        let noise = fit.noise_of_residuals(&sizes.norms);
        Ok(fit.with_noise(noise))
    }

    /// Computes the components of rows `[sample, pixel]` and selects the rank. Of a large matrix,
    /// only leading components are computed, as many as the selection needs. If these are too many,
    /// all are computed. `sizes` are those of the samples, which come first in the rows.
    /// `smaller_error` is that of [`fit_for_field`](Self::fit_for_field).
    fn decide(
        &self,
        rows: ArrayView2<'_, f64>,
        (sizes, circles): (&Sizes, &Circles),
        (freedom, rounding): (usize, f64),
        smaller_error: &dyn Fn(ArrayView2<'_, f64>) -> Result<f64, BasisError>,
    ) -> Result<(Components, Spectrum, usize), BasisError> {
        let noise = NoiseSearch::new(self.noise, rows, freedom)?;
        let of_samples = rows.slice(ndarray::s![..sizes.norms.len(), ..]);
        let sums = (self.rank == RankSelection::Auto).then(|| circles.sums_of_rows(of_samples));
        let mut error_of_field = None;
        let mut select = |found: &Components| -> Result<Option<(Spectrum, usize)>, BasisError> {
            let floor = noise.floor(found, rows.ncols(), freedom);
            let values = found.values.clone();
            let Some(spectrum) = Spectrum::new(values, &found.rest, rounding, floor) else {
                return Ok(None);
            };
            let of_stamps = max_errors_by_rank(&sizes.norms, found);
            let rank_within = |limit: f64| {
                let mut errors = of_stamps.clone();
                if let Some(sums) = &sums {
                    let limits = (limit, spectrum.significant);
                    circles.raise_errors(&mut errors, limits, sums.view(), &sizes.fluxes, found);
                }
                self.rank.select(&spectrum, &found.rest, &errors, limit)
            };
            let mut rank = rank_within(RankSelection::AUTO_ERROR)?;
            if let (RankSelection::Auto, Some(usual)) = (self.rank, rank) {
                let limit = if let Some(limit) = error_of_field {
                    limit
                } else {
                    let of_samples = ndarray::s![..sizes.norms.len(), ..usual];
                    smaller_error(found.coefficients.slice(of_samples))?
                };
                error_of_field = Some(limit);
                if limit < RankSelection::AUTO_ERROR {
                    rank = rank_within(limit)?;
                }
            }
            Ok(rank.map(|rank| (spectrum, rank)))
        };
        if is_large(rows) && self.rank != RankSelection::Full {
            let mut space = Krylov::new(rows);
            while let Some(found) = space.enlarged()? {
                if let Some((spectrum, rank)) = select(&found)? {
                    return Ok((found, spectrum, rank));
                }
            }
        }
        let found = Components::all(rows)?;
        let (spectrum, rank) = select(&found)?.expect("nothing is unknown");
        Ok((found, spectrum, rank))
    }
}

impl BasisMethod for Svd {
    fn fit(&self, samples: &PsfSamples) -> Result<BasisFit, BasisError> {
        let (ny, nx) = samples.grid().dim();
        self.fit_augmented(
            samples.clone(),
            ArrayView3::from_shape((0, ny, nx), &[]).expect("no stamps"),
        )
    }
}

/// The largest relative truncation error over the samples with 0, 1, ... components.
///
/// The squares of the omitted coefficients are added, from the last component to the first, so
/// nothing cancels.
fn max_errors_by_rank(norms: &[f64], found: &Components) -> Vec<f64> {
    let count = found.values.len();
    let mut largest = vec![0.0f64; count + 1];
    let rows = found.coefficients.outer_iter().zip(&found.unexplained);
    for (norm, (a, &unexplained)) in norms.iter().zip(rows) {
        let mut rest = unexplained;
        largest[count] = largest[count].max(rest.sqrt() / norm);
        for k in (0..count).rev() {
            rest += a[k] * a[k];
            largest[k] = largest[k].max(rest.sqrt() / norm);
        }
    }
    largest
}
