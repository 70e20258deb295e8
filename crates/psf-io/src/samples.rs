//! PSF samples: the `psf-samples` layout.
//!
//! # Layout
//!
//! | HDU | what |
//! |---|---|
//! | 0, primary | float cube `[sample, y, x]` (`NAXIS1` = x, `NAXIS3` = samples), any `BITPIX`; an image `[y, x]` is one sample |
//! | `POSITIONS`, binary table | columns `X`, `Y`: one row per sample, doubles; 0-based pixels of the frame, an integer is the centre of a pixel |
//!
//! | keyword of HDU 0 | meaning | default |
//! |---|---|---|
//! | `OVERSAMP` | stamp pixels per frame pixel, a number above 0 | 1 |
//! | `CENX`, `CENY` | stamp index of the PSF's reference point, 0-based, may be fractional | `n / 2`, integer division: 32 of 64 |
//! | `PIXCONV` | `T` when the response of a frame pixel is in the stamps | `T` |
//! | `STAMPINT` | how values continue between the stamps' pixels: `cubic-spline` or `lanczos3` | `cubic-spline` |
//! | `FIELDNX`, `FIELDNY` | the frame's size in pixels; both or none | not known |
//!
//! A value is the fraction of a source's flux in a *frame* pixel centred there: a stamp with `OVERSAMP = s` holds unit flux when
//! its sum is `s^2`. Every value is finite, every stamp has positive flux, no two positions are equal, and all lie on the
//! frame where its size is given. Single-precision and integer columns are read too; other columns, HDUs and keywords
//! are ignored.
//!
//! Six lines of astropy write it:
//!
//! ```python
//! from astropy.io import fits
//! primary = fits.PrimaryHDU(stamps)                    # stamps[sample, y, x], each of sum OVERSAMP**2
//! primary.header["OVERSAMP"] = 1.0
//! primary.header["FIELDNX"], primary.header["FIELDNY"] = 1024, 1024
//! columns = [fits.Column("X", "D", array=x), fits.Column("Y", "D", array=y)]   # 0-based pixels
//! fits.HDUList([primary, fits.BinTableHDU.from_columns(columns, name="POSITIONS")]).writeto("samples.fits")
//! ```

use std::path::Path;

use ndarray::Array3;
use psf_types::{DataError, Position, PsfSamples, SamplePositions};

use crate::cfitsio::Fits;
use crate::columns::Table;
use crate::error::invalid;
use crate::hdu::grid_cards;
use crate::image::squeezed;
use crate::new_fits::{write_fits, write_image_hdu};
use crate::pixels::read_pixels;
use crate::structure::FitsStructure;
use crate::{Card, HeaderCards, IoError};

/// The table that makes a cube PSF samples.
const POSITIONS: &str = "POSITIONS";

/// The precision of floats in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Precision {
    /// 4 bytes, `BITPIX` -32.
    #[default]
    Single,
    /// 8 bytes, `BITPIX` -64.
    Double,
}

/// Whether a file has the layout: a cube, or a single stamp, and a table of positions.
pub(crate) fn is_samples(structure: &FitsStructure) -> bool {
    let (Ok(image), Some(table)) = (structure.first_image(), structure.table(POSITIONS)) else {
        return false;
    };
    match squeezed(image).len() {
        3 => true,
        2 => table.axes.get(1) == Some(&1),
        _ => false,
    }
}

/// Reads PSF samples in the [`psf-samples` layout](self).
///
/// # Errors
/// [`IoError::Data`] for samples that break a rule of the layout, [`IoError::NonFinitePixels`], [`IoError::MissingHdu`],
/// [`IoError::Keyword`], and the errors of any FITS file.
pub fn read_samples(path: impl AsRef<Path>) -> Result<PsfSamples, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let hdu = structure.first_image()?;
    let table = structure
        .table(POSITIONS)
        .ok_or_else(|| structure.missing("binary table POSITIONS with the columns X and Y of the samples"))?;
    let table = Table::new(&structure, table)?;
    let shape = match squeezed(hdu)[..] {
        [ny, nx] => (1, ny, nx),
        [count, ny, nx] => (count, ny, nx),
        _ => return Err(hdu.axes_error("a cube of stamps [sample, y, x]")),
    };
    if table.rows() != shape.0 {
        return Err(invalid(path)(DataError::CountMismatch {
            what: "stamps in the cube, one for each row of the table POSITIONS",
            expected: table.rows(),
            got: shape.0,
        }));
    }
    let grid = hdu.stamp_grid(shape.2, shape.1)?;
    let positions =
        SamplePositions::new(read_positions_of(&table, path)?, hdu.field()?).map_err(invalid(path))?;
    let stamps =
        Array3::from_shape_vec(shape, read_pixels(path, hdu)?).expect("as many pixels as the axes say");
    PsfSamples::new(stamps, positions, grid).map_err(invalid(path))
}

/// Writes PSF samples in the [`psf-samples` layout](self).
///
/// Positions are doubles and come back exactly, as do the stamps under [`Precision::Double`]. `cards` are added to the primary
/// header, ahead of the layout's own.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("samples.fits");
/// use ndarray::Array3;
/// use psf_io::{Precision, read_samples, write_samples};
/// use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};
/// let positions = SamplePositions::new(vec![Position::new(0.0, 0.5)?, Position::new(9.0, 0.0)?], None)?;
/// let grid = StampGrid::new(5, 5)?.with_oversampling(2.0)?;
/// let samples = PsfSamples::new(Array3::from_elem((2, 5, 5), 0.16), positions, grid)?;
/// write_samples(&path, &samples, &[], Precision::Double, false)?;
/// assert_eq!(read_samples(&path)?, samples);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoError::Overflow`] for a value beyond single precision, [`IoError::Exists`] unless `overwrite`,
/// [`IoError::MissingDirectory`], or what the file system and CFITSIO report.
pub fn write_samples(
    path: impl AsRef<Path>,
    samples: &PsfSamples,
    cards: &[Card],
    precision: Precision,
    overwrite: bool,
) -> Result<(), IoError> {
    let path = path.as_ref();
    let positions = samples.positions();
    let cards = HeaderCards::new()
        .with(cards)
        .with(&grid_cards(samples.grid(), positions.field()));
    let stamps = samples.stamps();
    let values = stamps.as_slice().expect("samples are row-major");
    let shape = stamps.shape();
    write_fits(path, overwrite, |fits| {
        match precision {
            Precision::Double => write_image_hdu(fits, shape, values, &cards)?,
            Precision::Single => {
                let values: Vec<f32> = values.iter().map(|&v| v as f32).collect();
                if values.iter().any(|v| v.is_infinite()) {
                    return Err(IoError::Overflow {
                        path: path.to_owned(),
                    });
                }
                write_image_hdu(fits, shape, &values, &cards)?;
            }
        }
        fits.create_table(POSITIONS, samples.len(), &[("X", "D".into()), ("Y", "D".into())])?;
        write_positions_of(fits, positions)
    })
}

/// The columns X and Y.
pub(crate) fn read_positions_of(table: &Table<'_>, path: &Path) -> Result<Vec<Position>, IoError> {
    let (x, y) = (table.read("X", 1)?, table.read("Y", 1)?);
    x.into_iter()
        .zip(y)
        .map(|(x, y)| Position::new(x, y).map_err(invalid(path)))
        .collect()
}

/// X and Y as the first two columns of the table just created.
pub(crate) fn write_positions_of(fits: &mut Fits, positions: &SamplePositions) -> Result<(), IoError> {
    let coordinate =
        |of: fn(Position) -> f64| positions.as_slice().iter().map(|&p| of(p)).collect::<Vec<_>>();
    fits.write_column(1, &coordinate(Position::x))?;
    fits.write_column(2, &coordinate(Position::y))
}
