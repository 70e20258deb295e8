//! PSF samples: the `psf-samples` layout.
//!
//! # Layout
//!
//! | HDU | content |
//! |---|---|
//! | 0, primary | float cube `[sample, y, x]` (`NAXIS1` = x, `NAXIS3` = samples), any `BITPIX`; an image `[y, x]` is one sample |
//! | `POSITIONS`, binary table | columns `X`, `Y`: one row per sample, doubles; 0-based pixels of the frame, where a whole number is the centre of a pixel. Optional: one of the columns `WAVELENGTH`, `TIME`, `FRAME` |
//!
//! | keyword of HDU 0 | meaning | default |
//! |---|---|---|
//! | `OVERSAMP` | stamp pixels per frame pixel, a number above 0 | 1 |
//! | `CENX`, `CENY` | stamp index of the PSF's reference point, 0-based, may be fractional | `n / 2`, integer division: 32 for 64 pixels |
//! | `PIXCONV` | `T` if the stamps include the response of a frame pixel | `T` |
//! | `STAMPINT` | interpolation between the pixels of a stamp: `cubic-spline` or `lanczos3` | `cubic-spline` |
//! | `FIELDNX`, `FIELDNY` | size of the frame in pixels; both or none | unknown |
//!
//! If the stamps include the pixel response, a value is the fraction of a source's flux in a
//! *frame* pixel centred on the stamp pixel. A stamp with `OVERSAMP = s` holds unit flux if its sum
//! is `s^2`.
//! Every value is finite, every stamp has positive flux, and no two positions are equal. If the
//! size of the frame is given, all positions are on the frame. Single-precision and integer columns
//! are read too. The cube and its keywords may also be in an extension, such as that of a
//! compressed image: the first image with pixels is read. Other columns, HDUs and keywords are
//! ignored.
//!
//! # Wavelengths, times and frames
//!
//! If the PSF also depends on a wavelength, a time or a frame, `POSITIONS` has one of these columns:
//!
//! | column | content | unit (`TUNITn`, required) |
//! |---|---|---|
//! | `WAVELENGTH` | wavelength of the light, above 0 | `um`, `nm`, `Angstrom`, `mm` or `m` |
//! | `TIME` | time since the series began | `s`, `min`, `h` or `d` |
//! | `FRAME` | number of the exposure | none |
//!
//! Rows may be in any order, and the positions may differ from one wavelength (time, frame) to the
//! next. No two rows of one wavelength have equal positions. Stamps are centred at every wavelength:
//! a shift of the PSF with the wavelength, such as that of atmospheric dispersion, is applied later.
//!
//! Such a file is written by six lines of astropy:
//!
//! ```python
//! from astropy.io import fits
//! primary = fits.PrimaryHDU(stamps)                    # stamps[sample, y, x], each of sum OVERSAMP**2
//! primary.header["OVERSAMP"] = 1.0
//! primary.header["FIELDNX"], primary.header["FIELDNY"] = 1024, 1024
//! columns = [fits.Column("X", "D", array=x), fits.Column("Y", "D", array=y)]   # 0-based pixels
//! # if the PSF depends on the wavelength:
//! # columns.append(fits.Column("WAVELENGTH", "D", unit="um", array=wavelength))
//! fits.HDUList([primary, fits.BinTableHDU.from_columns(columns, name="POSITIONS")]).writeto("samples.fits")
//! ```

use std::path::Path;

use psf_types::{DataError, FrameShape, PsfSamples, StampGrid};

use crate::error::{IoError, invalid};
use crate::fits::card::{Card, CardValue};
use crate::fits::columns::Table;
use crate::fits::hdu::Hdu;
use crate::fits::header_cards::HeaderCards;
use crate::fits::image::{read_stack, squeezed, stack_shape};
use crate::fits::image_out::{in_single_precision, write_fits, write_image_hdu};
use crate::fits::structure::FitsStructure;
use crate::psf::position_table::{position_columns, read_positions_of, write_positions_of};

/// The name of the table with the positions of the samples.
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

/// Returns whether a file has this layout: a cube or a single stamp, and a table of positions.
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
/// [`IoErrorKind::Data`](crate::IoErrorKind::Data) for samples that break a rule of the layout,
/// [`Axes`](crate::IoErrorKind::Axes) for an image with more than three axes,
/// [`Table`](crate::IoErrorKind::Table) for a column that is missing or has another format, and the
/// [errors of any FITS file](crate#bad-files).
pub fn read_samples(path: impl AsRef<Path>) -> Result<PsfSamples, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let hdu = structure.first_image()?;
    let needed = "binary table POSITIONS with the columns X and Y of the samples";
    let table = Table::new(structure.needed_table(POSITIONS, needed)?)?;
    let shape = stack_shape(hdu, "a cube of stamps [sample, y, x]")?;
    let what = "stamps in the cube, one per row of the table POSITIONS";
    DataError::check_count(what, table.rows, shape.0).map_err(invalid(path))?;
    let grid = stamp_grid(hdu, shape.2, shape.1)?;
    let positions = read_positions_of(&table, path, field(hdu)?)?;
    PsfSamples::new(read_stack(hdu, shape)?, positions, grid).map_err(invalid(path))
}

/// Writes PSF samples in the [`psf-samples` layout](self).
///
/// Positions are doubles and are read back exactly. Stamps are read back exactly only with
/// [`Precision::Double`]. `cards` are added to the primary header, before the cards of the layout.
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
/// [`IoErrorKind::Limit`](crate::IoErrorKind::Limit) for a value beyond single precision, and the
/// errors of [`write_image`](crate::write_image).
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
                write_image_hdu(fits, shape, &in_single_precision(path, values)?, &cards)?;
            }
        }
        fits.create_table(POSITIONS, samples.len(), &position_columns(positions))?;
        write_positions_of(fits, positions)
    })
}

/// The grid of stamps of `nx` by `ny` pixels, from `OVERSAMP`, `CENX`, `CENY`, `PIXCONV` and
/// `STAMPINT`.
pub(crate) fn stamp_grid(hdu: &Hdu, nx: usize, ny: usize) -> Result<StampGrid, IoError> {
    let mut grid = StampGrid::new(nx, ny).map_err(invalid(hdu.path()))?;
    let number = |keyword| {
        Ok::<_, IoError>(
            hdu.optional_real(keyword)?
                .map(|v| (v, hdu.invalid_keyword(keyword))),
        )
    };
    if let Some((x, wrong)) = number("CENX")? {
        grid = grid.with_centre(x, grid.centre_y()).map_err(wrong)?;
    }
    if let Some((y, wrong)) = number("CENY")? {
        grid = grid.with_centre(grid.centre_x(), y).map_err(wrong)?;
    }
    if let Some((oversampling, wrong)) = number("OVERSAMP")? {
        grid = grid.with_oversampling(oversampling).map_err(wrong)?;
    }
    let interpolation = hdu.optional_choice("STAMPINT", "cubic-spline or lanczos3")?;
    Ok(grid
        .with_pixel_response_included(hdu.optional_logical("PIXCONV")?.unwrap_or(true))
        .with_interpolation(interpolation.unwrap_or_default()))
}

/// The size of the frame from `FIELDNX` and `FIELDNY`. If one of them exists, both must exist.
pub(crate) fn field(hdu: &Hdu) -> Result<Option<FrameShape>, IoError> {
    const EXPECTED: &str = "the size of the frame in pixels, a whole number above 0";
    if ["FIELDNX", "FIELDNY"]
        .iter()
        .all(|keyword| hdu.header.get(keyword).is_none())
    {
        return Ok(None);
    }
    let count = |keyword| hdu.required_length(keyword, EXPECTED);
    FrameShape::new(count("FIELDNX")?, count("FIELDNY")?)
        .map(Some)
        .map_err(hdu.invalid_keyword("FIELDNX"))
}

/// The cards of a grid and of the size of the frame, for [`stamp_grid`] and [`field`] to read.
pub(crate) fn grid_cards(grid: StampGrid, field: Option<FrameShape>) -> Vec<Card> {
    const CENTRE: &str = "stamp index of the PSF reference point, 0-based";
    let card = |keyword, value: CardValue, comment| {
        Card::new(keyword, value, comment).expect("the keywords and values are valid")
    };
    let (oversampling, x, y) = (grid.oversampling(), grid.centre_x(), grid.centre_y());
    let (included, between) = (grid.pixel_response_included(), grid.interpolation().to_string());
    let mut cards = vec![
        card("OVERSAMP", oversampling.into(), "stamp pixels per frame pixel"),
        card("CENX", x.into(), CENTRE),
        card("CENY", y.into(), CENTRE),
        card("PIXCONV", included.into(), "the pixel response is in the stamps"),
        card("STAMPINT", between.into(), "interpolation between stamp pixels"),
    ];
    if let Some(field) = field {
        cards.push(card("FIELDNX", field.nx().into(), "columns of the frame"));
        cards.push(card("FIELDNY", field.ny().into(), "rows of the frame"));
    }
    cards
}
