//! The drawers of stars and galaxies share the PSFs, the blocks of the field with their local bases, and
//! the PSFs of single sources.

mod blocks;
mod psf_vectors;
mod source_psfs;

pub(crate) use blocks::{BlockKey, block_of, region_of};
pub(crate) use psf_vectors::PsfVectors;
pub(crate) use source_psfs::{SourcePsfs, check_stamps};
