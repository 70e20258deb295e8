//! The drawers of stars and galaxies share the PSFs, the blocks of the field with their local bases, and
//! the PSFs of single sources.

mod blocks;
mod point_gradient;
mod psf_vectors;
mod slopes;
mod source_psfs;

pub(crate) use blocks::{BlockKey, block_of, region_of};
pub use point_gradient::PointGradient;
pub(crate) use point_gradient::with_unit_flux;
pub(crate) use psf_vectors::PsfVectors;
pub(crate) use slopes::with_slopes;
pub(crate) use source_psfs::{SourcePsfs, check_stamps};
