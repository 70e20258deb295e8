//! Reads and writes the FITS and table files of psfield: scenes, samples, models and catalogues.
//!
//! | file | layout | read | written |
//! |---|---|---|---|
//! | scene, image | [`image`] | [`read_image`] | [`write_image`] |
//! | large image, by bands of rows | [`image`] | [`ImageReader`] | [`ImageWriter`] |
//! | whole numbers: raw counts, masks | [`image`] | [`read_image`] | [`write_integers`] |
//! | PSF samples, stamps | [`samples`] | [`read_samples`] | [`write_samples`] |
//! | STPSF, WebbPSF library | [`stpsf`] | [`read_stpsf`] | [`write_gridded`] |
//! | STDPSF library | [`stdpsf`] | [`read_stdpsf`] | |
//! | ScopeSim's field-varying PSF | [`scopesim`] | [`read_scopesim`] | |
//! | stamps without a table of positions | a cube or an image | [`read_stamp_cube`] | |
//! | PSF model | [`model`] | [`read_model`] | [`write_model`] |
//! | PSFEx model | [`psfex`] | [`read_psfex`] | [`write_psfex`] |
//! | catalogue, positions | [`catalogue`] | [`read_catalog_with`], [`read_catalog`], [`read_positions`] | |
//! | any table of results | CSV with a line of names | [`read_columns`] | [`write_csv`] |
//! | any cube | | [`read_cube`] | [`write_cube`] |
//!
//! [`detect`] finds the kind of a file from its content.
//!
//! # Conventions
//! Arrays are `[y, x]`. Positions are 0-based, in the code and in the files of psfield. A whole
//! number is the centre of a pixel. If another format counts from 1, its reader and writer convert
//! the positions.
//!
//! # Bad files
//! A reader checks every header of a file and all data that it returns. If anything is wrong, it
//! returns an [`IoError`] that names the file, the place in it, and what to do. Headers are checked
//! against the length of the file before memory is allocated for the data. No content of a file
//! makes this crate panic. Nothing is repaired silently. For example, a NaN pixel is an error,
//! unless the caller chooses to replace NaN ([`ImageReader::with_nan_as`]) or to keep it
//! ([`ImageReader::read_rows_with_undefined`]).
//!
//! The errors of any FITS file are [`IoErrorKind::NotFound`], [`IoErrorKind::Read`],
//! [`IoErrorKind::Format`], [`IoErrorKind::Damaged`], [`IoErrorKind::Header`] and
//! [`IoErrorKind::Limit`]. If a gzip file cannot be unpacked into the temporary folder, for example
//! for lack of space, the error is [`IoErrorKind::Write`].
//!
//! # Compressed files
//! FITS files compressed by gzip (`.gz`) and images compressed in tiles (`.fz`: `RICE_1`, `GZIP_1`,
//! `GZIP_2`, `PLIO_1`, quantised floats) are read wherever uncompressed files are. They are
//! recognised by their content. A gzip file is unpacked to a temporary file, which is removed when
//! it is no longer needed. It may unpack to at most 1 GiB plus 100 times its own size. A tiled
//! image may unpack to at most 16 MiB plus 8192 times the bytes of the table that holds its tiles.
//! A file that would unpack to more is refused before it takes the disk space or the memory.
//!
//! # Outputs
//! Every file appears complete or not at all, even after a full disk, a killed process or a loss of
//! power ([`write_atomically`]). This holds also for files that are written by bands. An existing
//! file is replaced only on request. A program that handles signals should call
//! [`remove_unfinished`] before it ends.
//! Equal input gives equal bytes, because this crate writes no dates of its own.
//!
//! # CFITSIO
//! CFITSIO reads and writes pixels and columns. The build compiles it, so no system library is
//! needed. File names are taken literally: brackets, `+` or a leading `!` have no special meaning.
//! All functions may be called from several threads at once.
//!
//! # A new format
//! Add one file to `psf/` with the model, the reader, the writer and an `is_...` test, and one line
//! to the list of `psf/detect.rs`.

pub mod catalogue;
mod error;
mod fits;
mod output;
mod psf;
mod units;

pub use catalogue::columns::{CatalogColumns, CatalogOptions, NeededColumn};
pub use catalogue::curves::{is_wavelength_unit, read_curve};
pub use catalogue::memory_table::MemoryTable;
pub use catalogue::sky_catalog::SkyCatalog;
pub use catalogue::sky_coordinates::SkyCoordinates;
pub use catalogue::sky_motion::ObservationDate;
pub use catalogue::sky_pointing::SkyPointing;
pub use catalogue::table_file::{read_columns, write_csv};
pub use catalogue::world_header::WorldCoordinatesError;
pub use catalogue::{
    Catalog, SourceColours, catalog_of, read_catalog, read_catalog_with, read_positions, read_positions_with,
};
pub use error::{CardError, IoError, IoErrorKind, Place, Row};
pub use fits::card::{Card, CardValue};
pub use fits::edit::{StoredRow, edit_image};
pub use fits::hdu::HduChoice;
pub use fits::header_cards::HeaderCards;
pub use fits::image::{
    self, FitsImage, ImageReader, read_cards, read_cube, read_cube_hdu, read_header, read_header_hdu,
    read_image, read_image_hdu,
};
pub use fits::image_out::{ImageWriter, IntegerKind, write_cube, write_image, write_integers};
pub use fits::join::join_images;
pub use fits::table_out::{ColumnValues, TableColumn, write_table};
pub use output::temporary::remove_unfinished;
pub use output::{OutputLock, check_output, write_atomically, write_bytes, write_text, write_together};
pub use psf::detect::{FileKind, detect, detect_hdu, foreign_psf};
pub use psf::gridded::GriddedPsf;
pub use psf::gridded_out::write_gridded;
pub use psf::model::{self, ModelFile, read_model, read_model_file, write_model};
pub use psf::psfex::file::{read_psfex, read_psfex_at, write_psfex};
pub use psf::psfex::{self, PsfexAxis, PsfexFigures, PsfexModel, PsfexPolynomial};
pub use psf::samples::{self, Precision, read_samples, write_samples};
pub use psf::scopesim::{self, ScopesimOptions, ScopesimPsf, read_scopesim};
pub use psf::stamp_cube::{StampCubeOptions, read_stamp_cube, read_stamp_header};
pub use psf::stdpsf::{self, read_stdpsf, read_stdpsf_hdu};
pub use psf::stpsf::{self, PlaneOrder, read_stpsf, read_stpsf_hdu};
