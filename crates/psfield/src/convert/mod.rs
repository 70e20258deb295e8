//! Converts a PSF to another form: samples at other positions, a PSFEx model, a gridded library.
//!
//! If a form cannot hold the stamps or the positions of the PSF, the conversion fails
//! ([`ErrorKind::Format`](crate::ErrorKind::Format)). If a form cannot hold another property, such
//! as the policy outside the samples, the conversion succeeds and a note reports the change.

mod gridded;
mod psfex;
mod samples;
mod write;

pub use gridded::{GriddedConversion, is_on_grid, to_gridded};
pub use psfex::{PsfexConversion, to_psfex};
pub use samples::{SamplesAt, to_samples};
pub use write::{PsfFormat, Written};
