//! Sources that draw the PSF at any position, and PSF samples: stamps at known positions.

use ndarray::{Array3, ArrayView2, ArrayView3, ArrayViewMut2, Axis};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::frame::{DataError, FrameShape, Position, Quantity, read_through_new};
use crate::image::row_major;
use crate::sample_positions::SamplePositions;
use crate::stamp::{Stamp, StampGrid};

/// A PSF that can be drawn at every position of a field, such as an optical model, an analytic
/// profile or a function of the caller.
///
/// Object-safe. Many threads may draw from one source at the same time. A source must always draw
/// the same stamp for a position.
pub trait PsfSource: Sync {
    /// The pixel grid of the stamps.
    fn grid(&self) -> StampGrid;

    /// The field (frame) over which the PSF is defined.
    fn field(&self) -> FrameShape;

    /// Draws the PSF of a star at `position`, centred on the grid's centre, into `stamp`
    /// `[y, x]`. `stamp` has the grid's shape, and its content is overwritten.
    ///
    /// # Errors
    /// [`SourceError`] when the source cannot draw a PSF at this position.
    fn draw_into(&self, position: Position, stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError>;

    /// Draws the PSF like [`draw_into`](Self::draw_into), but shifted from the grid's centre by
    /// `dx` frame pixels to the right and `dy` up.
    ///
    /// # Errors
    /// [`SourceError`] when the source cannot draw this PSF. The default implementation returns
    /// [`SourceError::ShiftUnsupported`] unless `dx` and `dy` are 0.
    fn draw_shifted_into(
        &self,
        position: Position,
        (dx, dy): (f64, f64),
        stamp: ArrayViewMut2<'_, f64>,
    ) -> Result<(), SourceError> {
        if dx == 0.0 && dy == 0.0 {
            self.draw_into(position, stamp)
        } else {
            Err(SourceError::ShiftUnsupported)
        }
    }

    /// Returns the PSF at `position` as a new stamp.
    ///
    /// # Errors
    /// [`SourceError`] when the source cannot draw a PSF at this position.
    fn draw(&self, position: Position) -> Result<Stamp, SourceError> {
        let mut values = ndarray::Array2::zeros(self.grid().dim());
        self.draw_into(position, values.view_mut())?;
        Stamp::new(values, self.grid()).map_err(|source| SourceError::Stamp { position, source })
    }
}

/// The reason why a source cannot draw a PSF.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The source can only draw centred PSFs.
    #[error("this PSF source cannot draw sub-pixel shifts")]
    ShiftUnsupported,
    /// The source drew an invalid stamp.
    #[error("the PSF drawn at {position} is not valid")]
    Stamp {
        /// The requested position.
        position: Position,
        /// The defect of the stamp.
        #[source]
        source: DataError,
    },
    /// An error of a source that another crate implements.
    #[error("the PSF at {position} could not be drawn")]
    External {
        /// The requested position.
        position: Position,
        /// The underlying error.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

/// PSF stamps `[sample, y, x]` on one grid, each with its position.
///
/// There is one stamp per position, or per position and state ([`SamplePositions`]). Every value is
/// finite and every stamp has positive, finite flux. Negative pixels are kept.
///
/// ```
/// use ndarray::Array3;
/// use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};
/// let positions = SamplePositions::new(vec![Position::new(0.0, 0.0)?, Position::new(9.0, 0.0)?], None)?;
/// let samples = PsfSamples::new(Array3::from_elem((2, 5, 5), 0.04), positions, StampGrid::new(5, 5)?)?;
/// assert!((samples.flux(1) - 1.0).abs() < 1e-12);
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawPsfSamples")]
pub struct PsfSamples {
    stamps: Array3<f64>,
    positions: SamplePositions,
    grid: StampGrid,
}

read_through_new!(RawPsfSamples => PsfSamples { stamps: Array3<f64>, positions: SamplePositions, grid: StampGrid });

impl PsfSamples {
    /// Samples from a stack of stamps `[sample, y, x]`.
    ///
    /// # Errors
    /// [`DataError::CountMismatch`], [`DataError::StampShape`], [`DataError::NonFinite`] or
    /// [`DataError::NonPositiveFlux`].
    pub fn new(stamps: Array3<f64>, positions: SamplePositions, grid: StampGrid) -> Result<Self, DataError> {
        let (count, ny, nx) = stamps.dim();
        let what = "stamps in the stack of samples, one for each position";
        DataError::check_count(what, positions.len(), count)?;
        grid.check_dim((ny, nx))?;
        DataError::check_finite(Quantity::SampleValue, stamps.view())?;
        for (sample, stamp) in stamps.axis_iter(Axis(0)).enumerate() {
            let flux = grid.flux_of_sum(stamp.sum());
            if !(flux > 0.0 && flux.is_finite()) {
                return Err(DataError::NonPositiveFlux { sample, flux });
            }
        }
        Ok(Self {
            stamps: row_major(stamps),
            positions,
            grid,
        })
    }

    /// One stamp `[y, x]`.
    ///
    /// # Panics
    /// When there is no such sample.
    pub fn stamp(&self, sample: usize) -> ArrayView2<'_, f64> {
        self.stamps.index_axis(Axis(0), sample)
    }

    /// The fraction of the source's light that a sample holds.
    ///
    /// # Panics
    /// When there is no such sample.
    pub fn flux(&self, sample: usize) -> f64 {
        self.grid.flux_of_sum(self.stamp(sample).sum())
    }

    /// The stamps `[sample, y, x]`, row-major.
    pub fn stamps(&self) -> ArrayView3<'_, f64> {
        self.stamps.view()
    }

    /// The positions of the samples.
    pub fn positions(&self) -> &SamplePositions {
        &self.positions
    }

    /// The pixel grid of all stamps.
    pub fn grid(&self) -> StampGrid {
        self.grid
    }

    /// Number of samples, at least 1.
    #[allow(clippy::len_without_is_empty, reason = "never empty")]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Returns the stamps `[sample, y, x]`, row-major, without copying them.
    pub fn into_stamps(self) -> Array3<f64> {
        self.stamps
    }

    /// Divides every stamp by its flux, so that each has unit flux.
    #[must_use]
    pub fn into_unit_flux(mut self) -> Self {
        for mut stamp in self.stamps.axis_iter_mut(Axis(0)) {
            let flux = self.grid.flux_of_sum(stamp.sum());
            stamp.mapv_inplace(|v| v / flux);
        }
        self
    }
}
