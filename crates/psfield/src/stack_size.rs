//! The largest stack of stamps.

use psf_types::StampGrid;

use crate::error::{ErrorKind, PsfieldError};

/// The largest stack of stamps that is allowed: 16 GiB.
pub const MAX_STACK_BYTES: usize = 16 << 30;

/// Checks that a stack of stamps is not larger than 16 GiB.
///
/// # Errors
/// [`ErrorKind::TooLarge`].
pub fn check_stack(stamps: usize, grid: StampGrid) -> Result<(), PsfieldError> {
    let bytes = stamps
        .saturating_mul(grid.pixel_count())
        .saturating_mul(size_of::<f64>());
    if bytes > MAX_STACK_BYTES {
        let message = format!(
            "PSF stamps ({stamps} of {} x {} pixels) would fill more than {} GiB: ask for fewer or smaller stamps",
            grid.nx(),
            grid.ny(),
            MAX_STACK_BYTES >> 30
        );
        return Err(PsfieldError::new(ErrorKind::TooLarge, message));
    }
    Ok(())
}
