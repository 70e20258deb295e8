//! Reading images: scenes and results.
//!
//! # Layout
//!
//! | part | read | written |
//! |---|---|---|
//! | HDU | the primary if it has pixels, else the only image extension, or the one chosen ([`HduChoice`]) | the primary |
//! | axes | `NAXIS = 2`, or more if the further axes have length 1 | `NAXIS = 2` |
//! | pixels | any `BITPIX`; `BSCALE` and `BZERO` are applied; NaN, infinities and `BLANK` pixels are refused | `BITPIX` -32 (f32) or -64 (f64), or whole numbers ([`IntegerKind`](crate::IntegerKind)) |
//! | header | all cards except those about the structure of the file; an extension inherits the cards of an empty primary HDU, unless `INHERIT = F` | the cards of the input, then the cards that the caller adds |
//!
//! `NAXIS1` is x. The pixel at array index `[y, x]`, 0-based, is FITS pixel `(x + 1, y + 1)`. World
//! coordinates, which count in FITS pixels, are copied without a change. Files compressed by gzip
//! or fpack are read directly.
//!
//! An image that does not fit into memory is read and written by bands of rows, with
//! [`ImageReader`] and [`ImageWriter`](crate::ImageWriter).
//!
//! A scene made in Python:
//!
//! ```python
//! import numpy as np
//! from astropy.io import fits
//! scene = np.zeros((1024, 1024), np.float32)          # [y, x], flux per pixel
//! scene[300, 500] = 1e5                               # a star at x = 500, y = 300
//! fits.PrimaryHDU(scene).writeto("scene.fits")
//! ```

use std::ops::Range;
use std::path::Path;

use ndarray::{Array1, Array2, Array3, ArrayViewMut2};
use psf_types::maths::unravel;
use psf_types::{FrameShape, Image, Real};

use crate::error::{IoError, IoErrorKind, Place, beyond_single, invalid};
use crate::fits::cfitsio::Fits;
use crate::fits::hdu::{Hdu, HduChoice};
use crate::fits::header_cards::HeaderCards;
use crate::fits::structure::FitsStructure;
use crate::fits::tiles;

/// The expected axes of an image that may be a cube, for errors.
const STACK: &str = "an image [y, x] or a cube [plane, y, x]";

/// An image with its header cards.
#[derive(Debug, Clone, PartialEq)]
pub struct FitsImage<T = f64> {
    image: Image<T>,
    header: HeaderCards,
}

impl<T: Real> FitsImage<T> {
    /// The image.
    pub fn image(&self) -> &Image<T> {
        &self.image
    }

    /// The header cards, without those about the structure of the file.
    pub fn header(&self) -> &HeaderCards {
        &self.header
    }

    /// Returns the image and the header cards without a copy.
    pub fn into_parts(self) -> (Image<T>, HeaderCards) {
        (self.image, self.header)
    }
}

/// Reads the image of a FITS file in the precision of `T`. The file may have any BITPIX. This is
/// [`read_image_hdu`] without a choice.
///
/// # Errors
/// The errors of [`read_image_hdu`].
pub fn read_image<T: Real>(path: impl AsRef<Path>) -> Result<FitsImage<T>, IoError> {
    read_image_hdu(path, None)
}

/// Reads the chosen image. Without a choice it reads the image of the primary HDU, or else the only
/// image.
///
/// # Errors
/// [`IoErrorKind::Setting`] if a choice is needed or wrong (the message lists the HDUs),
/// [`IoErrorKind::Axes`] for a cube, [`IoErrorKind::Data`] for a pixel that is not finite,
/// [`IoErrorKind::Limit`] if `T` is f32 and a value is too large for it, and the
/// [errors of any FITS file](crate#bad-files).
pub fn read_image_hdu<T: Real>(
    path: impl AsRef<Path>,
    choice: Option<&HduChoice>,
) -> Result<FitsImage<T>, IoError> {
    let path = path.as_ref();
    let mut reader = ImageReader::open_hdu(path, choice)?;
    let pixels = reader.read_rows(0..reader.shape().ny())?;
    Ok(FitsImage {
        image: Image::new(pixels).map_err(invalid(path))?,
        header: reader.header,
    })
}

/// Reads the image of a FITS file as a stack `[plane, y, x]`. A 2-D image is a stack of one plane.
///
/// Use it for stamps that need not be PSF samples, such as a reference to compare with.
///
/// # Errors
/// The errors of [`read_cube_hdu`].
pub fn read_cube<T: Real>(path: impl AsRef<Path>) -> Result<Array3<T>, IoError> {
    read_cube_hdu(path, None)
}

/// Reads the chosen image as a stack `[plane, y, x]`.
///
/// # Errors
/// The errors of [`read_image_hdu`], except that a cube is accepted: [`IoErrorKind::Axes`] unless
/// there are two or three axes.
pub fn read_cube_hdu<T: Real>(
    path: impl AsRef<Path>,
    choice: Option<&HduChoice>,
) -> Result<Array3<T>, IoError> {
    let structure = FitsStructure::scan(path.as_ref())?;
    let hdu = structure.image(choice)?;
    read_stack(hdu, stack_shape(hdu, STACK)?)
}

/// Reads the header cards of the image of a FITS file, without those about the structure of the
/// file.
///
/// # Errors
/// The errors of [`read_header_hdu`].
pub fn read_header(path: impl AsRef<Path>) -> Result<HeaderCards, IoError> {
    read_header_hdu(path, None)
}

/// Reads the header cards of the chosen image, without those about the structure of the file.
///
/// # Errors
/// [`IoErrorKind::Setting`] if a choice is needed or wrong, and the
/// [errors of any FITS file](crate#bad-files). Axes and pixels are not checked.
pub fn read_header_hdu(path: impl AsRef<Path>, choice: Option<&HduChoice>) -> Result<HeaderCards, IoError> {
    let structure = FitsStructure::scan(path.as_ref())?;
    Ok(structure.cards(structure.image(choice)?))
}

/// Reads the header cards that describe a frame, such as its world coordinates, from an HDU that
/// need not have pixels.
///
/// Without a choice, these are the cards of the image, as in [`read_header_hdu`]. If the file has
/// no pixels, they are the cards of the first image HDU with world coordinates (`CTYPE1`), or else
/// of the primary HDU.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("frame.fits");
/// let mut header = String::new();
/// for card in ["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 0", "CTYPE1  = 'RA---TAN'", "END"] {
///     header.push_str(&format!("{card:<80}"));
/// }
/// std::fs::write(&path, format!("{header:<2880}"))?;
/// let cards = psf_io::read_cards(&path, None)?;
/// assert_eq!(cards.get("CTYPE1").and_then(|card| card.value()), Some("RA---TAN".into()));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoErrorKind::Setting`] if a choice is needed, or if no image HDU matches the choice, and the
/// [errors of any FITS file](crate#bad-files).
pub fn read_cards(path: impl AsRef<Path>, choice: Option<&HduChoice>) -> Result<HeaderCards, IoError> {
    let structure = FitsStructure::scan(path.as_ref())?;
    Ok(structure.cards(structure.header_of_frame(choice)?))
}

/// Returns the shape in array order. If there are more than two axes, leading axes of length 1 (the
/// last ones in FITS) are left out.
pub(crate) fn squeezed(hdu: &Hdu) -> Vec<usize> {
    let shape = hdu.shape();
    let extra = shape.len().saturating_sub(2);
    let ones = shape[..extra].iter().take_while(|&&n| n == 1).count();
    shape[ones..].to_vec()
}

/// The shape `(planes, ny, nx)` of a cube. An image is a cube of one plane.
pub(crate) fn stack_shape(hdu: &Hdu, expected: &'static str) -> Result<(usize, usize, usize), IoError> {
    match squeezed(hdu)[..] {
        [ny, nx] => Ok((1, ny, nx)),
        [planes, ny, nx] => Ok((planes, ny, nx)),
        _ => Err(hdu.axes_error(expected)),
    }
}

/// The error for a band of rows that is not as wide as the image.
pub(crate) fn band_width(path: &Path, expected: usize, got: usize) -> IoError {
    let problem = format!("a band of rows must have the {expected} columns of the image, got {got}");
    IoError::new(path, IoErrorKind::Request, problem)
}

/// The error for rows that an image of `ny` rows does not have.
pub(crate) fn bad_rows(path: &Path, rows: &Range<usize>, ny: usize) -> IoError {
    let (first, end) = (rows.start, rows.end);
    let problem =
        format!("the image has {ny} row(s), got the range {first} to {end} (0-based, the end not included)");
    IoError::new(path, IoErrorKind::Request, problem)
}

/// An open image that is read one band of rows at a time, so that it may be larger than memory.
///
/// A reader accepts the files that [`read_image`](crate::read_image) accepts. The bands together
/// equal the image that [`read_image`](crate::read_image) returns, bit by bit. Rows may be read in
/// any order and any number of times. Only the current band takes memory. A reader cannot be sent
/// to another thread, but several readers may be open on one file.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("scene.fits");
/// use psf_io::{HeaderCards, ImageReader, write_image};
/// use psf_types::{FrameShape, Image};
/// let image = Image::<f32>::zeros(FrameShape::new(30, 20)?);
/// write_image(&path, &image, &HeaderCards::new(), &[], false)?;
///
/// let mut reader = ImageReader::open(&path)?;
/// assert_eq!(reader.shape(), image.shape());
/// for first in (0..20).step_by(8) {
///     let band = reader.read_rows::<f32>(first..20.min(first + 8))?; // [y, x]
///     assert_eq!(band.ncols(), 30);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct ImageReader {
    pixels: Pixels,
    /// The index of the first pixel of the image in its HDU. This is not 0 if the image is a later
    /// plane of a cube.
    origin: usize,
    shape: FrameShape,
    header: HeaderCards,
    /// The value that replaces NaN.
    nan_as: Option<f64>,
    /// Number of NaN pixels that were replaced, and the row up to which they were counted.
    replaced: (usize, usize),
}

impl ImageReader {
    /// Opens the image of a FITS file: [`open_hdu`](Self::open_hdu) without a choice.
    ///
    /// # Errors
    /// The errors of [`open_hdu`](Self::open_hdu).
    pub fn open(path: impl AsRef<Path>) -> Result<Self, IoError> {
        Self::open_hdu(path, None)
    }

    /// Opens the chosen image. Without a choice it opens the image of the primary HDU, or else the
    /// only image. Every header is read and checked against the length of the file. No pixel is
    /// read yet, but all tiles of a compressed image are checked.
    ///
    /// # Errors
    /// [`IoErrorKind::Setting`] if a choice is needed or wrong (the message lists the HDUs),
    /// [`IoErrorKind::Axes`] for a cube, and the [errors of any FITS file](crate#bad-files).
    pub fn open_hdu(path: impl AsRef<Path>, choice: Option<&HduChoice>) -> Result<Self, IoError> {
        Self::open_part(path.as_ref(), choice, |hdu| match squeezed(hdu)[..] {
            [ny, nx] => Ok((0, ny, nx)),
            _ => Err(hdu.axes_error("a single image with the axes [y, x]")),
        })
    }

    /// Opens one plane, counted from 0, of a cube `[plane, y, x]`. An image is a cube of one plane.
    ///
    /// # Errors
    /// The errors of [`open_hdu`](Self::open_hdu), except that a cube is accepted:
    /// [`IoErrorKind::Axes`] unless there are two or three axes. [`IoErrorKind::Request`] for a
    /// plane that the cube does not have.
    pub fn open_plane(
        path: impl AsRef<Path>,
        choice: Option<&HduChoice>,
        plane: usize,
    ) -> Result<Self, IoError> {
        Self::open_part(path.as_ref(), choice, |hdu| {
            let (planes, ny, nx) = stack_shape(hdu, STACK)?;
            if plane >= planes {
                let problem =
                    format!("there is no plane {plane}: the image has {planes} plane(s), counted from 0");
                return Err(hdu.error(IoErrorKind::Request, problem));
            }
            Ok((plane * ny * nx, ny, nx))
        })
    }

    /// Opens a part of the chosen HDU. `part` returns the index of the part's first pixel, its
    /// number of rows and its number of columns.
    fn open_part(
        path: &Path,
        choice: Option<&HduChoice>,
        part: impl FnOnce(&Hdu) -> Result<(usize, usize, usize), IoError>,
    ) -> Result<Self, IoError> {
        let structure = FitsStructure::scan(path)?;
        let hdu = structure.image(choice)?;
        let (origin, ny, nx) = part(hdu)?;
        Ok(Self {
            pixels: Pixels::open(hdu)?,
            origin,
            shape: FrameShape::new(nx, ny).map_err(invalid(path))?,
            header: structure.cards(hdu),
            nan_as: None,
            replaced: (0, 0),
        })
    }

    /// Sets a value that replaces each NaN and `BLANK` pixel that is read. With `None`, the
    /// default, such pixels are errors. Infinite pixels are always errors.
    #[must_use]
    pub fn with_nan_as(self, nan_as: Option<f64>) -> Self {
        Self { nan_as, ..self }
    }

    /// The value that replaces NaN and `BLANK` pixels ([`with_nan_as`](Self::with_nan_as)).
    pub fn nan_as(&self) -> Option<f64> {
        self.nan_as
    }

    /// The number of pixels replaced so far ([`with_nan_as`](Self::with_nan_as)). A row that is
    /// read again is not counted again, if the rows are first read in ascending order.
    pub fn nan_pixels(&self) -> usize {
        self.replaced.0
    }

    /// Columns and rows of the whole image.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }

    /// The header cards, without those about the structure of the file.
    pub fn header(&self) -> &HeaderCards {
        &self.header
    }

    /// Reads rows as a row-major array `[y, x]`. Its first row is row `rows.start` (0-based) of the
    /// image.
    ///
    /// # Errors
    /// The errors of [`read_rows_into`](Self::read_rows_into).
    pub fn read_rows<T: Real>(&mut self, rows: Range<usize>) -> Result<Array2<T>, IoError> {
        // This check comes before memory is allocated for the rows.
        self.check_rows(&rows)?;
        let mut band = Array2::zeros((rows.len(), self.shape.nx()));
        self.read_rows_into(rows.start, band.view_mut())?;
        Ok(band)
    }

    /// Fills `band` `[y, x]` with rows of the image, from row `first_row` (0-based) on. After an
    /// error the contents of `band` are undefined.
    ///
    /// # Errors
    /// [`IoErrorKind::Request`] for rows that the image does not have or a band of another width,
    /// [`IoErrorKind::Data`] if pixels are not finite, [`IoErrorKind::Limit`] if `T` is f32 and a
    /// value is too large for it, and [`IoErrorKind::Read`] for an error of CFITSIO. The
    /// [`IoErrorKind::Data`] error has the place of the first pixel that is not finite, and states
    /// how many such pixels these rows have.
    pub fn read_rows_into<T: Real>(
        &mut self,
        first_row: usize,
        mut band: ArrayViewMut2<'_, T>,
    ) -> Result<(), IoError> {
        let (ny, nx) = band.dim();
        self.check_rows(&(first_row..first_row.saturating_add(ny)))?;
        if nx != self.shape.nx() {
            return Err(band_width(self.pixels.fits.path(), self.shape.nx(), nx));
        }
        let first = self.origin + first_row * nx;
        let mut clean = match band.as_slice_mut() {
            Some(values) => self.pixels.load(first, values)?,
            None => self.load_scattered(first, band.view_mut())?,
        };
        if let (false, Some(value)) = (clean, self.nan_as) {
            let counted = self.replaced.1;
            for ((y, _), pixel) in band.indexed_iter_mut().filter(|(_, pixel)| pixel.is_nan()) {
                *pixel = T::nearest(value);
                self.replaced.0 += usize::from(first_row + y >= counted);
            }
            clean = band.iter().all(|pixel| pixel.is_finite());
        }
        self.replaced.1 = self.replaced.1.max(first_row + ny);
        if clean {
            Ok(())
        } else {
            let replaced = self.nan_as.is_some();
            let bad = |_, value: f64| !(replaced && value.is_nan());
            Err(self.pixels.defect(first, ny * nx, bad))
        }
    }

    /// Makes an error about undefined pixels of the whole image, for callers that allow some of
    /// them. Only pixels for which `is_bad([y, x])` is true count, and at least one must exist. The
    /// error has the place of the first of these pixels, and states their number.
    pub fn undefined_error(&mut self, is_bad: impl Fn([usize; 2]) -> bool) -> IoError {
        let nx = self.shape.nx();
        let bad = |at: usize, _| is_bad([at / nx, at % nx]);
        self.pixels.defect(self.origin, self.shape.pixel_count(), bad)
    }

    /// Works like [`read_rows`](Self::read_rows), but keeps undefined pixels: NaN and infinities as
    /// stored, `BLANK` pixels as NaN. This is for looking at an image. Do not compute from these
    /// pixels without testing each of them.
    ///
    /// # Errors
    /// [`IoErrorKind::Request`] for rows that the image does not have, and [`IoErrorKind::Read`]
    /// for an error of CFITSIO.
    pub fn read_rows_with_undefined(&mut self, rows: Range<usize>) -> Result<Array2<f64>, IoError> {
        self.check_rows(&rows)?;
        let mut band = Array2::zeros((rows.len(), self.shape.nx()));
        let first = self.origin + rows.start * self.shape.nx();
        let values = band.as_slice_mut().expect("a new array is contiguous");
        // `load` also returns whether all values are finite, which does not matter here.
        self.pixels.load(first, values)?;
        Ok(band)
    }

    /// Reads into rows that are not contiguous in memory. Returns whether all pixels are finite.
    fn load_scattered<T: Real>(
        &mut self,
        first: usize,
        mut band: ArrayViewMut2<'_, T>,
    ) -> Result<bool, IoError> {
        let nx = self.shape.nx();
        let mut values = Array1::zeros(nx);
        let mut clean = true;
        for (y, mut row) in band.rows_mut().into_iter().enumerate() {
            let slice = values.as_slice_mut().expect("a new array is contiguous");
            clean &= self.pixels.load(first + y * nx, slice)?;
            row.assign(&values);
        }
        Ok(clean)
    }

    fn check_rows(&self, rows: &Range<usize>) -> Result<(), IoError> {
        if rows.start <= rows.end && rows.end <= self.shape.ny() {
            return Ok(());
        }
        Err(bad_rows(self.pixels.fits.path(), rows, self.shape.ny()))
    }
}

/// Number of values that are tested together for NaN, few enough to stay in cache.
const CHUNK: usize = 4096;

/// The allowed values of BSCALE and BZERO, as a text for error messages.
const FINITE: &str = "a finite number (BSCALE: other than 0)";

/// The pixels of an image HDU, open for reading.
#[derive(Debug)]
struct Pixels {
    fits: Fits,
    hdu: usize,
    /// In array order, x last.
    shape: Vec<usize>,
    /// True if CFITSIO must replace undefined pixels by NaN.
    blank: bool,
}

impl Pixels {
    /// Opens an HDU of a [`FitsStructure`](FitsStructure). The structure has checked that the file
    /// holds the data of the HDU.
    fn open(hdu: &Hdu) -> Result<Self, IoError> {
        tiles::check(hdu)?;
        for keyword in ["BSCALE", "BZERO", "BLANK"] {
            hdu.ensure_one_value(keyword)?;
        }
        // If BSCALE or BZERO is not a number, CFITSIO uses 1 or 0 without an error.
        for keyword in ["BSCALE", "BZERO"] {
            let value = hdu.optional::<f64>(keyword, FINITE)?;
            if !value.is_none_or(f64::is_finite) || (keyword == "BSCALE" && value == Some(0.0)) {
                return Err(hdu.keyword_error(keyword, FINITE));
            }
        }
        let mut fits = Fits::open(&hdu.source)?;
        fits.move_to(hdu.index)?;
        Ok(Self {
            fits,
            hdu: hdu.index,
            shape: hdu.shape(),
            // For floats CFITSIO must not search for undefined values, because the search would set
            // subnormal numbers to zero. In compressed images, however, only CFITSIO knows which
            // number stands for NaN, and without the search it would return that number as a value.
            blank: hdu.is_tiled() || (hdu.bitpix > 0 && hdu.header.get("BLANK").is_some()),
        })
    }

    /// Reads pixels from index `first` (0-based, row by row) on, with BSCALE and BZERO applied.
    /// Returns whether all of them are finite. If not, [`defect`](Self::defect) makes the error.
    fn load<T: Real>(&mut self, first: usize, pixels: &mut [T]) -> Result<bool, IoError> {
        self.fits.read_pixels(first, pixels, self.blank)?;
        let clean = |chunk: &[T]| chunk.iter().fold(true, |clean, value| clean & value.is_finite());
        Ok(pixels.chunks(CHUNK).all(clean))
    }

    /// The error for pixels that are not all finite in the requested type. Only pixels for which
    /// `is_bad` is true count. It takes the index of a pixel that is not finite, counted from
    /// `first`, and the pixel's value.
    fn defect(&mut self, first: usize, count: usize, is_bad: impl Fn(usize, f64) -> bool) -> IoError {
        match self.non_finite(first, count, is_bad) {
            Ok(Some((flat, value, count))) => {
                let problem = format!(
                    "the value is {value}. Among the pixels read, {count} pixel(s) are NaN, infinite or BLANK: replace them by numbers"
                );
                let (hdu, index) = (self.hdu, unravel(flat, &self.shape));
                IoError::new(self.fits.path(), IoErrorKind::Data, problem).at(Place::Pixel { hdu, index })
            }
            // A value that is infinite in single precision may be finite in the file.
            Ok(None) => beyond_single(self.fits.path()),
            Err(error) => error,
        }
    }

    /// Searches for pixels that are not finite in double precision and for which `is_bad` is true.
    /// Returns the index of the first one, its value, and their number.
    fn non_finite(
        &mut self,
        first: usize,
        count: usize,
        is_bad: impl Fn(usize, f64) -> bool,
    ) -> Result<Option<(usize, f64, usize)>, IoError> {
        let mut found = None;
        // This reads in chunks, because a second copy of the pixels might not fit into memory.
        let mut values = vec![0.0_f64; CHUNK];
        for start in (first..first + count).step_by(CHUNK) {
            let chunk = &mut values[..CHUNK.min(first + count - start)];
            if self.load(start, chunk)? {
                continue;
            }
            for (i, &value) in chunk.iter().enumerate() {
                if !value.is_finite() && is_bad(start + i - first, value) {
                    found.get_or_insert((start + i, value, 0)).2 += 1;
                }
            }
        }
        Ok(found)
    }
}

/// Reads all pixels of an image HDU, with BSCALE and BZERO applied. NaN, infinities and BLANK
/// pixels are errors.
///
/// The HDU is part of a [`FitsStructure`], which has checked that the file holds the data of the
/// HDU. So the length of the file limits the memory. A compressed image may take more bytes than
/// its file, but no more than a constant and a fixed multiple of its table.
fn read_pixels<T: Real>(hdu: &Hdu) -> Result<Vec<T>, IoError> {
    // `open` checks the tiles before memory is allocated for the size that the header claims.
    let mut pixels = Pixels::open(hdu)?;
    let mut values = vec![T::zero(); hdu.axes.iter().product()];
    if pixels.load(0, &mut values)? {
        Ok(values)
    } else {
        Err(pixels.defect(0, values.len(), |_, _| true))
    }
}

/// Reads all pixels of an image HDU as a stack of this shape.
pub(crate) fn read_stack<T: Real>(hdu: &Hdu, shape: (usize, usize, usize)) -> Result<Array3<T>, IoError> {
    Ok(Array3::from_shape_vec(shape, read_pixels(hdu)?).expect("the pixels fill the axes"))
}
