//! The basis of singular vectors.

use std::str::FromStr;

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::matmul::matmul;
use faer::linalg::svd::{ComputeSvdVectors, SvdParams, svd, svd_scratch};
use faer::{Accum, Mat, MatMut, MatRef, Par, Spec};
use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis, concatenate};
use psf_types::{PsfBasis, PsfSamples};

use crate::noise::noise_floor;
use crate::uneven_noise::{by_sample, uneven_floor};
use crate::{BasisError, BasisFit, BasisMethod, PixelNoise, RankSelection, Spectrum};

/// Whether the mean stamp is taken out before the decomposition.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Centring {
    /// The mean of the samples is a stamp of its own. Samples of unit flux then have components of zero flux, so that
    /// every truncation keeps the flux.
    #[default]
    Mean,
    /// No mean stamp, as in the method's paper.
    None,
}

impl std::fmt::Display for Centring {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Mean => "mean",
            Self::None => "none",
        })
    }
}

impl FromStr for Centring {
    type Err = BasisError;
    fn from_str(text: &str) -> Result<Self, BasisError> {
        match text {
            "mean" => Ok(Self::Mean),
            "none" => Ok(Self::None),
            _ => Err(BasisError::BadCentring { got: text.to_owned() }),
        }
    }
}

/// The leading left singular vectors of the matrix whose columns are the samples, `X - mean = U S V^T`, `B_k = U_k`: of
/// all bases of `K` components the one with the smallest total squared truncation error (Eckart and Young 1936).
///
/// A thin SVD in f64. The signs are fixed (the value of largest magnitude in each component is positive), and the result
/// does not depend on the number of threads.
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

/// faer splits its work by this number and not by the threads at hand: the result is the same on any number of threads.
const SPLIT: usize = 8;

/// Work (the product of both dimensions and the smaller one) below which splitting it costs more than it gains, many times so where the
/// threads are wanted elsewhere.
const WORTH_SPLITTING: usize = 1 << 22;

/// Singular values below this many units of rounding of the samples' Frobenius norm are zero to rounding.
pub(crate) const ROUNDING_UNITS: f64 = 16.0;

/// The squares of the singular values add up to those of the samples, but for rounding.
const SQUARES_AGREE: f64 = 1e-10;

impl Svd {
    /// Mean-centred, rank `auto`, noise estimated.
    pub fn new() -> Self {
        Self::default()
    }

    /// With or without a mean stamp.
    #[must_use]
    pub fn with_centring(self, centring: Centring) -> Self {
        Self { centring, ..self }
    }

    /// How many components are kept.
    #[must_use]
    pub fn with_rank(self, rank: RankSelection) -> Self {
        Self { rank, ..self }
    }

    /// What is known of the noise in the samples' pixels.
    #[must_use]
    pub fn with_noise(self, noise: PixelNoise) -> Self {
        Self { noise, ..self }
    }

    /// Like [`BasisMethod::fit`], with more training stamps `[stamp, y, x]` beside the samples, such as the samples' PSFs
    /// at sub-pixel shifts. The mean and the components come from all of them, coefficients and errors from the samples.
    ///
    /// # Errors
    /// [`BasisError`] when shapes differ, the rank is not available or the decomposition fails.
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

/// Singular values in descending order, and vectors `[pixel, k]` on the pixels' side, of samples `[sample, pixel]`.
///
/// faer loses singular values of some matrices whose rows repeat, without a word. Then the same is tried with a QR decomposition
/// first, and then without divide and conquer.
pub(crate) fn decompose(rows: ArrayView2<'_, f64>) -> Result<(Vec<f64>, Mat<f64>), BasisError> {
    let usual: SvdParams = *Spec::<SvdParams, f64>::default();
    let qr_first = SvdParams {
        qr_ratio_threshold: 0.0,
        ..usual
    };
    let undivided = SvdParams {
        recursion_threshold: usize::MAX,
        ..qr_first
    };
    let whole: f64 = rows.iter().map(|v| v * v).sum();
    [usual, qr_first, undivided]
        .into_iter()
        .filter_map(|params| decompose_by(rows, params))
        .find(|(values, _)| {
            let held: f64 = values.iter().map(|s| s * s).sum();
            (held - whole).abs() <= SQUARES_AGREE * whole
        })
        .map(|(values, vectors)| descending(values, vectors))
        .ok_or(BasisError::NoConvergence {
            samples: rows.nrows(),
            pixels: rows.ncols(),
        })
}

fn decompose_by(rows: ArrayView2<'_, f64>, params: SvdParams) -> Option<(Vec<f64>, Mat<f64>)> {
    let (samples, pixels) = rows.dim();
    let size = samples.min(pixels);
    // Rows of samples are columns of the pixels x samples matrix in faer's column-major order.
    let matrix = MatRef::from_column_major_slice(rows.as_slice().expect("row-major"), pixels, samples);
    let work = samples.saturating_mul(pixels).saturating_mul(size);
    let par = if work < WORTH_SPLITTING {
        Par::Seq
    } else {
        Par::rayon(SPLIT)
    };
    let scratch = svd_scratch::<f64>(
        pixels,
        samples,
        ComputeSvdVectors::Thin,
        ComputeSvdVectors::No,
        par,
        params.into(),
    );
    let mut memory = MemBuffer::try_new(scratch).ok()?;
    let mut values = Diag::<f64>::zeros(size);
    let mut vectors = Mat::<f64>::zeros(pixels, size);
    svd(
        matrix,
        values.as_mut(),
        Some(vectors.as_mut()),
        None,
        par,
        MemStack::new(&mut memory),
        params.into(),
    )
    .ok()?;
    Some((values.column_vector().iter().copied().collect(), vectors))
}

/// faer promises descending order, but does not keep it where samples repeat: there, the second singular value may stand behind
/// hundreds of zeros.
fn descending(values: Vec<f64>, vectors: Mat<f64>) -> (Vec<f64>, Mat<f64>) {
    if values.is_sorted_by(|a, b| a >= b) {
        return (values, vectors);
    }
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[b].total_cmp(&values[a]));
    let sorted = Mat::from_fn(vectors.nrows(), order.len(), |u, k| vectors[(u, order[k])]);
    (order.iter().map(|&k| values[k]).collect(), sorted)
}

/// Coefficients `[sample, k]` of the first `count` components.
pub(crate) fn project(rows: ArrayView2<'_, f64>, vectors: &Mat<f64>, count: usize) -> Array2<f64> {
    let (samples, pixels) = rows.dim();
    let mut coefficients = Array2::zeros((samples, count));
    let left = MatRef::from_row_major_slice(rows.as_slice().expect("row-major"), samples, pixels);
    let into = MatMut::from_row_major_slice_mut(
        coefficients.as_slice_mut().expect("new arrays are row-major"),
        samples,
        count,
    );
    matmul(
        into,
        Accum::Replace,
        left,
        vectors.subcols(0, count),
        1.0,
        Par::rayon(SPLIT),
    );
    coefficients
}

/// Rounding of the difference of two sums of squares that are equal, relative to either.
const PYTHAGORAS_ROUNDING: f64 = 1e-12;

/// The largest relative truncation error over the samples with 0, 1, ... components.
///
/// The squares of the coefficients left out are added up from the smallest, so nothing cancels.
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
        // What no component spans, by Pythagoras; the difference is good to rounding of the whole, and samples that took
        // part in the decomposition have nothing outside.
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

/// The value of largest magnitude in each component becomes positive.
pub(crate) fn fix_signs(components: &mut Array2<f64>, coefficients: &mut Array2<f64>) {
    for (mut component, mut column) in components
        .outer_iter_mut()
        .zip(coefficients.axis_iter_mut(Axis(1)))
    {
        let peak = component
            .iter()
            .copied()
            .fold(0.0f64, |m, v| if v.abs() > m.abs() { v } else { m });
        if peak < 0.0 {
            component.mapv_inplace(|v| -v);
            column.mapv_inplace(|v| -v);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every way to decompose is right where its squares add up: its vectors are orthonormal and go with its values.
    #[test]
    fn repeated_rows_have_few_singular_values() {
        for (rows, columns) in [
            (300, 289),
            (440, 289),
            (500, 289),
            (289, 289),
            (289, 440),
            (200, 289),
        ] {
            for distinct in [1, 2, 3, 5, 9] {
                let matrix = Array2::from_shape_fn((rows, columns), |(j, u)| {
                    let width = 4.0 + 0.6 * (j % distinct) as f64;
                    (-((u as f64 - 140.0) / width).powi(2)).exp() / width
                });
                let (values, vectors) = decompose(matrix.view()).unwrap();
                let top = values[0];
                assert!(values.is_sorted_by(|a, b| a >= b));
                assert!(values[distinct..].iter().all(|s| *s < 1e-13 * top));
                let gram = vectors.transpose() * &vectors;
                let image = project(matrix.view(), &vectors, values.len());
                for (k, column) in image.axis_iter(Axis(1)).enumerate() {
                    let norm = column.dot(&column).sqrt();
                    assert!(
                        (norm - values[k]).abs() < 1e-12 * top,
                        "{rows}, {columns}, {distinct}: {k}"
                    );
                    for i in 0..values.len() {
                        let off = gram[(i, k)] - f64::from(u8::from(i == k));
                        assert!(off.abs() < 1e-12, "{rows}, {columns}, {distinct}: {i}, {k}");
                    }
                }
            }
        }
    }
}
