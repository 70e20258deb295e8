//! What the drawers of stars and galaxies share: the PSFs, their blocks of the field, and the PSFs of single
//! sources.

mod blocks;
mod psf_vectors;
mod source_psfs;

pub(crate) use blocks::{BlockKey, block_of, region_of};
pub(crate) use psf_vectors::PsfVectors;
pub(crate) use source_psfs::{SourcePsfs, check_stamps};
