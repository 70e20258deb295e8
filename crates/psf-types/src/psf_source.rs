//! PSFs at any position.

use ndarray::ArrayViewMut2;
use thiserror::Error;

use crate::{DataError, FrameShape, Position, Stamp, StampGrid};

/// Something that knows the PSF at every position of a field: an optical model, an analytic profile, a fitted model.
///
/// Object-safe; drawn from many threads at once, and a position always yields the same stamp.
pub trait PsfSource: Sync {
    /// The pixel grid of the stamps.
    fn grid(&self) -> StampGrid;

    /// The field (frame) over which the PSF is defined.
    fn field(&self) -> FrameShape;

    /// Draws the PSF of a source at `position`, centred on the grid's centre, into `stamp` `[y, x]`, which has the grid's
    /// shape and whose content is overwritten.
    ///
    /// # Errors
    /// [`SourceError`] when the PSF cannot be drawn there.
    fn draw_into(&self, position: Position, stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError>;

    /// Like [`draw_into`](Self::draw_into), with the source `dx`, `dy` frame pixels right of and above the grid's centre.
    ///
    /// # Errors
    /// The provided method refuses with [`SourceError::ShiftUnsupported`] unless both are 0.
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

    /// The PSF at `position` as a stamp of its own.
    ///
    /// # Errors
    /// [`SourceError`] when the PSF cannot be drawn there.
    fn draw(&self, position: Position) -> Result<Stamp, SourceError> {
        let mut values = ndarray::Array2::zeros(self.grid().dim());
        self.draw_into(position, values.view_mut())?;
        Stamp::new(values, self.grid()).map_err(|source| SourceError::Stamp { position, source })
    }
}

/// Why a source gives no PSF.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The source can only draw centred PSFs.
    #[error("this PSF source cannot draw sub-pixel shifts")]
    ShiftUnsupported,
    /// What was drawn is not a valid stamp.
    #[error("the PSF drawn at {position} is not valid")]
    Stamp {
        /// The position asked for.
        position: Position,
        /// What is wrong with it.
        #[source]
        source: DataError,
    },
    /// An error of a source implemented elsewhere.
    #[error("the PSF at {position} could not be drawn")]
    External {
        /// The position asked for.
        position: Position,
        /// What happened.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}
