//! FITS files: headers, images and tables. CFITSIO reads and writes them, and this module checks
//! what CFITSIO does not.

pub(crate) mod card;
pub(crate) mod cfitsio;
pub(crate) mod columns;
pub(crate) mod edit;
pub(crate) mod hdu;
pub(crate) mod header_cards;
pub mod image;
pub(crate) mod image_out;
pub(crate) mod join;
pub(crate) mod scan;
pub(crate) mod structure;
pub(crate) mod table_out;
pub(crate) mod tile_codes;
pub(crate) mod tiles;
