//! FITS and table files of psfield: scenes, samples, models and catalogues in, results out.
//!
//! | file | layout | in | out |
//! |---|---|---|---|
//! | scene, image | [`image`] | [`read_image`] | [`write_image`] |
//! | the same, by bands of rows | [`image`] | [`ImageReader`] | [`ImageWriter`] |
//! | whole numbers: raw counts, masks | [`image`] | [`read_image`] | [`write_integers`] |
//! | PSF samples, stamps | [`samples`] | [`read_samples`] | [`write_samples`] |
//! | STPSF, WebbPSF library | [`stpsf`] | [`read_stpsf`] | [`write_gridded`] |
//! | STDPSF library | [`stdpsf`] | [`read_stdpsf`] | |
//! | ScopeSim's field-varying PSF | [`scopesim`] | [`read_scopesim`] | |
//! | plain stamps | a cube or an image | [`read_stamp_cube`] | |
//! | PSF model | [`model`] | [`read_model`] | [`write_model`] |
//! | PSFEx model | [`psfex`] | [`read_psfex`] | [`write_psfex`] |
//! | catalogue, positions | [`points`] | [`read_catalog_with`], [`read_catalog`], [`read_positions`] | |
//! | any table of results | CSV with a line of names | [`read_columns`] | [`write_csv`] |
//! | any cube | | [`read_cube`] | [`write_cube`] |
//!
//! [`detect`] tells the kinds apart by content.
//!
//! # Conventions
//! Arrays are `[y, x]` and positions 0-based, an integer being the centre of a pixel, in the files as in the code. Where a
//! format counts from 1, its reader converts.
//!
//! # Bad files
//! A file, or the rows of it that are asked for, is read completely and checked, or refused with an [`IoError`] that names the
//! file, the HDU or row, and what to do. Headers are checked against the length of the file before memory is taken for the
//! data; no content of a file makes this crate panic. Nothing is repaired silently: a NaN pixel is an error.
//!
//! # Compressed files
//! FITS files compressed as a whole by gzip (`.gz`) and images compressed by tiles (`.fz`: `RICE_1`, `GZIP_1`, `GZIP_2`, `PLIO_1`,
//! quantised floats) are read wherever plain ones are, told by content. A gzip file is unpacked to a temporary file, which goes when
//! it is no longer needed; it may unpack to 1 GiB and 100 times its own size. An image in tiles may take 16 MiB and 4096 times the bytes of
//! its tiles. What claims or holds more is refused before it takes disk or memory.
//!
//! # Outputs
//! Every file appears whole or not at all, and replaces another only when told to ([`write_atomically`]), also one that is
//! written by bands. That holds for a full disk, a killed process and a loss of power; a program that handles signals calls
//! [`remove_unfinished`]. The same input gives the same bytes: no dates are written.
//!
//! # CFITSIO
//! Pixels and columns pass through CFITSIO, which the build compiles (no system library needed). File names are taken
//! literally: brackets, `+` or a leading `!` have no meaning. All functions may be called from several threads at once.
//!
//! # A new format
//! One file for the format with its reader and an `is_...` test; one line in the list of `detect.rs`.

mod atomic;
mod card;
mod card_text;
mod card_value;
mod catalog;
mod catalog_columns;
mod catalog_options;
mod cfitsio;
mod columns;
mod csv_out;
mod cube_out;
mod detect;
mod distortion;
mod error;
mod fits_source;
mod gridded_error;
mod gridded_out;
mod gridded_psf;
mod gzip;
mod hdu;
mod hdu_choice;
mod header_cards;
pub mod image;
mod image_reader;
mod image_writer;
mod integer_image;
mod leftovers;
mod library_cards;
pub mod model;
mod new_fits;
mod number_columns;
mod pending_file;
mod pixels;
mod plio;
pub mod points;
pub mod psfex;
mod rice;
mod row;
pub mod samples;
mod scanner;
pub mod scopesim;
mod sky_coordinates;
mod stamp_cube;
pub mod stdpsf;
pub mod stpsf;
mod structure;
mod table_file;
mod text_header;
mod text_table;
mod tiled;
mod tiles;
mod unfinished;

pub use atomic::{check_output, write_atomically, write_bytes, write_text};
pub use card::Card;
pub use card_value::{CardError, CardValue};
pub use catalog::{Catalog, read_catalog_with, read_positions_with};
pub use catalog_columns::CatalogColumns;
pub use catalog_options::CatalogOptions;
pub use csv_out::write_csv;
pub use cube_out::write_cube;
pub use detect::{FileKind, detect, detect_hdu};
pub use error::IoError;
pub use gridded_error::GriddedError;
pub use gridded_out::write_gridded;
pub use gridded_psf::GriddedPsf;
pub use hdu_choice::HduChoice;
pub use header_cards::HeaderCards;
pub use image::{
    FitsImage, read_cards, read_cube, read_cube_hdu, read_header, read_header_hdu, read_image,
    read_image_hdu, write_image,
};
pub use image_reader::ImageReader;
pub use image_writer::ImageWriter;
pub use integer_image::{IntegerKind, write_integers};
pub use model::{ModelFile, read_model, read_model_file, write_model};
pub use points::{read_catalog, read_columns, read_positions};
pub use psfex::{PsfexAxis, PsfexFigures, PsfexModel, PsfexPolynomial, read_psfex, write_psfex};
pub use row::Row;
pub use samples::{Precision, read_samples, write_samples};
pub use scopesim::{ScopesimOptions, ScopesimPsf, read_scopesim};
pub use sky_coordinates::{SkyCoordinates, WorldCoordinatesError};
pub use stamp_cube::{StampCubeOptions, read_stamp_cube, read_stamp_header};
pub use stdpsf::{read_stdpsf, read_stdpsf_hdu};
pub use stpsf::{PlaneOrder, read_stpsf, read_stpsf_hdu};
pub use unfinished::remove_unfinished;
