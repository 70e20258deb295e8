//! A PSF in another form: samples at other positions, a PSFEx model, a gridded library.
//!
//! What a form cannot hold is an error
//! ([`ErrorKind::Format`](crate::ErrorKind::Format)) or, where the PSFs stay what
//! they are, a note.

mod gridded;
mod psfex;
mod samples;
mod write;

pub use gridded::{GriddedConversion, is_on_grid, to_gridded};
pub use psfex::{PsfexConversion, to_psfex};
pub use samples::{SamplesAt, to_samples};
pub use write::{PsfFormat, Written};
