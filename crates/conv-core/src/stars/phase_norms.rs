//! Norms of PSFs on the pixels of the frame. They depend on the sub-pixel phase of the star,
//! because a frame pixel sees only some of the pixels of an oversampled stamp.

use nalgebra::DMatrix;
use ndarray::{Array1, Array2, ArrayView1, s};
use psf_types::{DataError, StampGrid};
use rayon::prelude::*;

use crate::plan::local_modes::LocalModes;
use crate::plan::norm::{dot, norm, values};
use crate::simd::vectorized;
use crate::stamp_interpolator::StampInterpolator;

/// The largest number of tabulated phases in a frame pixel along each axis. There are two per pixel
/// of the stamp, if this is not more.
const MOST_PHASES: usize = 16;

/// Between tabulated phases, an error may be larger than at these phases, or a PSF's norm smaller.
/// So only this fraction of the tolerance is used.
const BETWEEN: f64 = 0.9;

/// The norms of a model's PSFs on the frame's pixels, at a table of phases.
#[derive(Debug)]
pub(super) struct PhaseNorms {
    /// Columns and rows of phases.
    axes: [PhaseTable; 2],
    /// `[phase]`, row by row. For each phase, the scalar products on the frame's pixels of the
    /// directions of [`PsfSpace`](crate::plan::psf_space::PsfSpace).
    products: Vec<Array2<f64>>,
    /// For each phase, the largest norm on the frame's pixels of a PSF of norm 1.
    largest: Vec<f64>,
}

/// The tabulated phases along an axis, as shifts of a star from the centre of its pixel.
#[derive(Debug, Clone, Copy)]
struct PhaseTable {
    first: f64,
    step: f64,
    count: usize,
}

impl PhaseTable {
    /// Phases that cover a frame pixel. Stars at these phases use pixels of the stamp without
    /// interpolation, or points half-way between them. `centre` is the stamp's centre.
    ///
    /// Without oversampling, there is one phase: half-way between two pixels. There interpolation
    /// smoothes PSFs the most, so their norms are smallest.
    fn new(oversampling: usize, centre: f64) -> Self {
        let phases = if oversampling == 1 {
            1
        } else {
            (2 * oversampling).min(MOST_PHASES)
        };
        let step = 1.0 / phases as f64;
        let on_pixel = (centre / oversampling as f64).rem_euclid(step);
        if phases == 1 {
            let (first, count) = (on_pixel - 0.5, 1);
            return Self { first, step, count };
        }
        let first = on_pixel - step * ((on_pixel + 0.5) / step).floor();
        let count = ((0.5 - first) / step).ceil() as usize + 1;
        Self { first, step, count }
    }

    /// The last phase at or below a shift, and the next phase.
    fn around(self, shift: f64) -> [usize; 2] {
        let last = self.count - 1;
        let below = (((shift - self.first) / self.step) as usize).min(last);
        [below, (below + 1).min(last)]
    }

    /// The number of steps in a pixel of the frame.
    fn steps(self) -> usize {
        (1.0 / self.step).round() as usize
    }
}

/// For each phase, the scalar products on the frame's pixels of a block's kernels with the block's
/// mean PSF, which is scaled to norm 1 on the frame's pixels `[phase, kernel]`.
pub(super) type AlongMean = Array2<f64>;

/// The mean PSF of a block on the frame's pixels.
pub(super) struct MeanOnPixels {
    /// Its scalar products with the directions, `[phase, direction]`.
    along: Array2<f64>,
    /// `[phase]`.
    norms: Array1<f64>,
}

impl MeanOnPixels {
    /// Tabulates the products of a block.
    pub(super) fn along(&self, modes: &LocalModes) -> AlongMean {
        let mut table = self.along.dot(&modes.kernels().t());
        for (mut row, &norm) in table.outer_iter_mut().zip(&self.norms) {
            if norm > 0.0 {
                row /= norm;
            } else {
                row.fill(0.0);
            }
        }
        table
    }
}

impl PhaseNorms {
    /// `stamps` are those of the directions of [`PsfSpace`](crate::plan::psf_space::PsfSpace).
    /// `target` holds the frame's pixels that a star may light.
    pub(super) fn new(
        stamps: &[StampInterpolator],
        grid: StampGrid,
        target: StampGrid,
    ) -> Result<Self, DataError> {
        let oversampling = grid.oversampling() as usize;
        let axes = [grid.centre_x(), grid.centre_y()].map(|centre| PhaseTable::new(oversampling, centre));
        // All phases together see the stamp at these fine pixels. Pixel `j` of a star at phase `i`
        // is the fine pixel `centre + steps j - i`.
        let steps = axes[0].steps();
        let centre = [target.centre_x(), target.centre_y()].map(|centre| centre as usize * steps);
        let centre = [centre[0] + axes[0].count - 1, centre[1] + axes[1].count - 1];
        let fine = StampGrid::new(
            target.nx() * steps + axes[0].count,
            target.ny() * steps + axes[1].count,
        )?
        .with_oversampling(steps as f64)?
        .with_centre(centre[0] as f64, centre[1] as f64)?;
        let stamps: Vec<Array2<f64>> = stamps
            .par_iter()
            .map(|stamp| stamp.resample((axes[0].first, axes[1].first), fine))
            .collect();
        let products: Vec<Array2<f64>> = (0..axes[0].count * axes[1].count)
            .into_par_iter()
            .map(|phase| {
                let first = |axis: usize, i: usize| axes[axis].count - 1 - i;
                let x = first(0, phase % axes[0].count);
                let y = first(1, phase / axes[0].count);
                let mut drawn = Array2::zeros((stamps.len(), target.pixel_count()));
                for (row, stamp) in drawn.outer_iter_mut().zip(&stamps) {
                    let seen = stamp.slice(s![y..;steps, x..;steps]);
                    let seen = seen.slice_move(s![..target.ny(), ..target.nx()]);
                    row.into_shape_with_order(target.dim())
                        .expect("row-major")
                        .assign(&seen);
                }
                drawn.dot(&drawn.t())
            })
            .collect();
        let largest = products
            .par_iter()
            .map(|products| {
                if oversampling == 1 || 2 * oversampling > MOST_PHASES {
                    // Interpolated values do not have a larger norm than the stamp.
                    return 1.0;
                }
                let n = products.nrows();
                let values = DMatrix::from_fn(n, n, |i, j| products[[i, j]]).symmetric_eigenvalues();
                values.iter().fold(0.0_f64, |m, v| m.max(*v)).sqrt()
            })
            .collect();
        Ok(Self {
            axes,
            products,
            largest,
        })
    }

    /// The mean PSF of a block on the frame's pixels.
    pub(super) fn of_mean(&self, mean: &Array1<f64>) -> MeanOnPixels {
        let mut along = Array2::zeros((self.products.len(), mean.len()));
        vectorized!(
            for (mut along, products) in along.outer_iter_mut().zip(&self.products) {
                for (to, row) in along.iter_mut().zip(products.outer_iter()) {
                    *to = dot(row.to_slice().expect("row-major"), values(mean));
                }
            }
        );
        let norms = along.dot(mean).mapv(|square| square.max(0.0).sqrt());
        MeanOnPixels { along, norms }
    }

    /// The part of the tolerance that a block's modes may use, for a block with this mean PSF: the
    /// smallest ratio of the norm of the mean to the largest norm of an error, if both have norm 1
    /// in the stamp. At most 1.
    pub(super) fn share(&self, mean: &Array1<f64>, on_pixels: &MeanOnPixels) -> f64 {
        let whole = norm(mean.view());
        let norms = on_pixels.norms.iter().zip(&self.largest);
        norms
            .map(|(norm, largest)| norm / (whole * largest))
            // Ignores NaN: a mean of norm 0, or a phase at which no pixel is lit.
            .fold(1.0, f64::min)
    }

    /// Returns whether an error of the given norm is within the tolerance on the frame's pixels,
    /// for a star with these coefficients of its block's kernels. It may return false for an error
    /// that is within the tolerance ([`is_within`](Self::is_within)).
    pub(super) fn is_surely_within(
        &self,
        tolerance: f64,
        shift: (f64, f64),
        error: f64,
        coefficients: &[f64],
        table: &AlongMean,
    ) -> bool {
        let (mut largest, mut least) = (0.0_f64, f64::INFINITY);
        for phase in self.around(shift) {
            largest = largest.max(self.largest[phase]);
            // The projection of the PSF that is drawn on the mean. It is at most the PSF's norm.
            let sum: f64 = coefficients
                .iter()
                .zip(table.row(phase))
                .map(|(c, a)| c * a)
                .sum();
            least = least.min(sum);
        }
        // The exact PSF is the drawn one plus the error.
        let largest = largest * error;
        largest <= BETWEEN * tolerance * (least - largest)
    }

    /// Returns whether the error of a PSF is within the tolerance on the frame's pixels.
    pub(super) fn is_within(
        &self,
        tolerance: f64,
        shift: (f64, f64),
        error: ArrayView1<'_, f64>,
        psf: ArrayView1<'_, f64>,
    ) -> bool {
        let (mut largest, mut least) = (0.0_f64, f64::INFINITY);
        for phase in self.around(shift) {
            let seen = if self.axes[0].count == 1 {
                error.dot(&error).sqrt()
            } else {
                norm_by(&self.products[phase], error)
            };
            largest = largest.max(seen);
            least = least.min(norm_by(&self.products[phase], psf));
        }
        largest <= BETWEEN * tolerance * least
    }

    /// The four phases around a shift.
    fn around(&self, (x, y): (f64, f64)) -> [usize; 4] {
        let ([x0, x1], [y0, y1]) = (self.axes[0].around(x), self.axes[1].around(y));
        let count = self.axes[0].count;
        [y0 * count + x0, y0 * count + x1, y1 * count + x0, y1 * count + x1]
    }
}

/// The norm on the frame's pixels.
fn norm_by(products: &Array2<f64>, vector: ArrayView1<'_, f64>) -> f64 {
    let along: Array1<f64> = products.dot(&vector);
    along.dot(&vector).max(0.0).sqrt()
}
