//! Fits a basis to samples. There are two methods: [`Svd`] computes the basis from the samples, and
//! [`GivenStamps`] uses stamps from elsewhere.

use ndarray::{Array2, Array3, ArrayView1, ArrayView2, ArrayView3, Axis, concatenate};
use psf_types::{DataError, PsfBasis, PsfSamples, SampleCoefficients, named};

use crate::decomposition::{BasisError, ROUNDING_UNITS, decompose, fix_signs, project};
use crate::noise::{PixelNoise, by_sample, noise_floor, uneven_floor};
use crate::rank::{RankSelection, Spectrum};

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
}

impl BasisFit {
    /// Combines the parts of a fit and measures the truncation error of every sample,
    /// `||h_j - B_0 - sum_k a_jk B_k||_2 / ||h_j||_2`.
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
        if basis.grid() != samples.grid() {
            let (expected, got) = (samples.grid().dim(), basis.grid().dim());
            return Err(DataError::StampShape { expected, got }.into());
        }
        let errors = truncation_errors(samples, &basis, coefficients.values());
        Ok(Self {
            basis,
            coefficients,
            spectrum,
            errors,
        })
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

/// Samples are processed in blocks of this size, so that the residuals of thousands of samples need
/// little memory.
const BLOCK: usize = 64;

/// Returns stamps `[stamp, y, x]`, which must be in row-major order, as `[stamp, pixel]`.
fn rows_of(stamps: ArrayView3<'_, f64>) -> ArrayView2<'_, f64> {
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

fn truncation_errors(samples: &PsfSamples, basis: &PsfBasis, coefficients: ArrayView2<'_, f64>) -> Vec<f64> {
    let (stamps, components) = (rows_of(samples.stamps()), rows_of(basis.components()));
    let mean = mean_of(basis);
    let mut errors = Vec::with_capacity(samples.len());
    for (block, weights) in stamps
        .axis_chunks_iter(Axis(0), BLOCK)
        .zip(coefficients.axis_chunks_iter(Axis(0), BLOCK))
    {
        let mut residual = &block - &weights.dot(&components);
        if let Some(mean) = mean {
            residual -= &mean;
        }
        for (stamp, rest) in block.outer_iter().zip(residual.outer_iter()) {
            errors.push((rest.dot(&rest) / stamp.dot(&stamp)).sqrt());
        }
    }
    errors
}

/// A basis of given, mutually orthogonal stamps, with an optional mean stamp. It is for bases from
/// elsewhere, such as analytic modes or the principal components of another instrument.
///
/// The stamps are scaled to unit norm. The coefficients are inner products,
/// `a_jk = <h_j - B_0, B_k>`, which is the least-squares solution for an orthonormal basis.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenStamps {
    mean: Option<Array2<f64>>,
    stamps: Array3<f64>,
}

impl GivenStamps {
    /// Stamps `[component, y, x]`, mutually orthogonal, of any norm except 0.
    ///
    /// # Errors
    /// [`BasisError::ZeroStamp`] for a stamp that is zero everywhere. [`fit`](BasisMethod::fit)
    /// checks that the stamps are orthogonal.
    pub fn new(mut stamps: Array3<f64>, mean: Option<Array2<f64>>) -> Result<Self, BasisError> {
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
        let basis = PsfBasis::new(self.mean.clone(), self.stamps.clone(), samples.grid())?;
        let mut rows = rows_of(samples.stamps()).to_owned();
        if let Some(mean) = mean_of(&basis) {
            rows -= &mean;
        }
        let coefficients = rows.dot(&rows_of(basis.components()).t());
        BasisFit::new(samples, basis, coefficients, None)
    }
}

/// The choice whether to subtract the mean stamp before the decomposition.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
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

/// The leading left singular vectors of the matrix whose columns are the samples,
/// `X - mean = U S V^T`, `B_k = U_k`. Of all bases of `K` components this one has the smallest sum
/// of squared residuals over all samples (Eckart and Young 1936).
///
/// The decomposition is a thin SVD in f64. The value of largest magnitude in each component is
/// positive, which fixes the signs. The result does not depend on the number of threads.
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
    /// the coefficients and errors from the samples only.
    ///
    /// # Errors
    /// [`BasisError`] when shapes differ, the rank is not available, the noise level is not valid
    /// or the decomposition fails.
    pub fn fit_augmented(
        &self,
        samples: &PsfSamples,
        training: ArrayView3<'_, f64>,
    ) -> Result<BasisFit, BasisError> {
        let (count, ny, nx) = training.dim();
        if (ny, nx) != samples.grid().dim() {
            return Err(BasisError::TrainingShape {
                expected: samples.grid().dim(),
                got: (ny, nx),
            });
        }
        let all = if count == 0 {
            samples.stamps().to_owned()
        } else {
            concatenate(Axis(0), &[samples.stamps(), training]).expect("equal shapes")
        };
        self.fit_stack(samples, all)
    }

    fn fit_stack(&self, samples: &PsfSamples, stack: Array3<f64>) -> Result<BasisFit, BasisError> {
        let grid = samples.grid();
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
        let (singular_values, vectors) = decompose(rows.view())?;
        let freedom = count - usize::from(mean.is_some());
        let rounding = ROUNDING_UNITS * f64::EPSILON * frobenius;
        let mut floor = noise_floor(self.noise, &singular_values, pixels, freedom)?;
        if self.noise == PixelNoise::Estimate {
            floor = match floor {
                Some(even) => Some(by_sample(rows.view(), &vectors, &singular_values, even)),
                None => uneven_floor(rows.view(), &vectors, &singular_values, freedom),
            };
        }
        let spectrum = Spectrum::new(singular_values, rounding, floor);

        // The samples come first in the stack.
        let rows = rows.slice_move(ndarray::s![..samples.len(), ..]);
        let coefficients = project(rows.view(), &vectors, spectrum.numerical_rank);
        let max_errors = max_errors_by_rank(samples, rows.view(), coefficients.view());
        drop(rows);
        let rank = self.rank.select(&spectrum, &max_errors)?;
        if rank == 0 && mean.is_none() {
            return Err(BasisError::RankZero);
        }
        let mut coefficients = coefficients.slice_move(ndarray::s![.., ..rank]);
        let mut components = Array2::from_shape_fn((rank, pixels), |(k, u)| vectors[(u, k)]);
        fix_signs(&mut components, &mut coefficients);

        let (ny, nx) = grid.dim();
        let components = components
            .into_shape_with_order((rank, ny, nx))
            .expect("row-major");
        let mean = mean.map(|m| m.into_shape_with_order((ny, nx)).expect("row-major"));
        let basis = PsfBasis::new(mean, components, grid)?;
        BasisFit::new(
            samples,
            basis,
            coefficients.as_standard_layout().into_owned(),
            Some(spectrum),
        )
    }
}

impl BasisMethod for Svd {
    fn fit(&self, samples: &PsfSamples) -> Result<BasisFit, BasisError> {
        self.fit_stack(samples, samples.stamps().to_owned())
    }
}

/// Rounding of the difference of two equal sums of squares, relative to either.
const PYTHAGORAS_ROUNDING: f64 = 1e-12;

/// The largest relative truncation error over the samples with 0, 1, ... components.
///
/// The squares of the omitted coefficients are added, from the last component to the first, so
/// nothing cancels.
fn max_errors_by_rank(
    samples: &PsfSamples,
    centred: ArrayView2<'_, f64>,
    coefficients: ArrayView2<'_, f64>,
) -> Vec<f64> {
    let count = coefficients.ncols();
    let mut largest = vec![0.0f64; count + 1];
    for (j, (row, a)) in centred.outer_iter().zip(coefficients.outer_iter()).enumerate() {
        let stamp = samples.stamp(j);
        let norm2: f64 = stamp.iter().map(|v| v * v).sum();
        // The squared norm of the sample after all components are subtracted, by Pythagoras. The
        // rounding of this difference is relative to `whole`. The samples took part in the
        // decomposition, so the true value is about 0.
        let whole = row.dot(&row);
        let outside = whole - a.dot(&a);
        let mut rest = if outside > PYTHAGORAS_ROUNDING * whole {
            outside
        } else {
            0.0
        };
        largest[count] = largest[count].max((rest / norm2).sqrt());
        for k in (0..count).rev() {
            rest += a[k] * a[k];
            largest[k] = largest[k].max((rest / norm2).sqrt());
        }
    }
    largest
}
