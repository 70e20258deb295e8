//! PSFs in files, with one module for each format.

pub(crate) mod detect;
pub(crate) mod gridded;
pub(crate) mod gridded_out;
pub mod model;
pub(crate) mod position_table;
pub mod psfex;
pub mod samples;
pub mod scopesim;
pub(crate) mod stamp_cube;
pub mod stdpsf;
pub mod stpsf;
