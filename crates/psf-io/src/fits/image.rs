//! Images: scenes and results.
//!
//! # Layout
//!
//! | part | read | written |
//! |---|---|---|
//! | HDU | the primary when it has pixels; else the only image extension; or the one chosen ([`HduChoice`]) | the primary |
//! | axes | `NAXIS = 2`, or more with further axes of length 1 | `NAXIS = 2` |
//! | pixels | any `BITPIX`; `BSCALE` and `BZERO` are applied; NaN, infinities and `BLANK` pixels are refused | `BITPIX` -32 (f32) or -64 (f64) |
//! | header | every card but those about the file's structure; an extension inherits those of an empty primary HDU, unless `INHERIT = F` | the same, then the caller's |
//!
//! `NAXIS1` is x. The pixel at array index `[y, x]`, 0-based, is FITS pixel `(x + 1, y + 1)`; world
//! coordinates, which count in FITS pixels, go over as they are. Files compressed by gzip or fpack
//! are read as they are.
//!
//! An image that does not fit into memory is read and written by bands of rows: [`ImageReader`] and
//! [`ImageWriter`](crate::ImageWriter).
//!
//! A scene from Python:
//!
//! ```python
//! import numpy as np
//! from astropy.io import fits
//! scene = np.zeros((1024, 1024), np.float32)          # [y, x], flux per pixel
//! scene[300, 500] = 1e5                               # a star at x = 500, y = 300
//! fits.PrimaryHDU(scene).writeto("scene.fits")
//! ```

use std::ops::Range;
use std::path::{Path, PathBuf};

use ndarray::{Array1, Array2, Array3, ArrayViewMut2};
use psf_types::{FrameShape, Image, Real};

use crate::error::{IoError, invalid, request};
use crate::fits::cfitsio::Fits;
use crate::fits::hdu::{Hdu, HduChoice};
use crate::fits::header_cards::HeaderCards;
use crate::fits::structure::FitsStructure;
use crate::fits::tiles;

/// The axes of an image that may be a stack.
const STACK: &str = "an image [y, x] or a cube [plane, y, x]";

/// An image with the header cards that go with it.
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

    /// Both, without a copy.
    pub fn into_parts(self) -> (Image<T>, HeaderCards) {
        (self.image, self.header)
    }
}

/// Reads the image of a FITS file, whatever its BITPIX, in the precision asked for:
/// [`read_image_hdu`] without a choice.
///
/// # Errors
/// As [`read_image_hdu`].
pub fn read_image<T: Real>(path: impl AsRef<Path>) -> Result<FitsImage<T>, IoError> {
    read_image_hdu(path, None)
}

/// Reads the image chosen; without a choice that of the primary HDU, or the only one there is.
///
/// # Errors
/// [`IoError::SeveralHdus`] with a list where a choice is needed, [`IoError::NoSuchHdu`],
/// [`IoError::Axes`] for a cube, [`IoError::NonFinitePixels`], [`IoError::Overflow`] when a value
/// of a double-precision file is too large for f32, and the errors of any FITS file.
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

/// Reads the image of a FITS file as a stack `[plane, y, x]`: a cube, or an image as a stack of
/// one.
///
/// For stamps that need not be PSF samples, such as a reference to compare with.
///
/// # Errors
/// As [`read_cube_hdu`].
pub fn read_cube<T: Real>(path: impl AsRef<Path>) -> Result<Array3<T>, IoError> {
    read_cube_hdu(path, None)
}

/// Reads the image chosen as a stack `[plane, y, x]`.
///
/// # Errors
/// As [`read_image_hdu`]; [`IoError::Axes`] for more than three axes.
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
/// As [`read_header_hdu`].
pub fn read_header(path: impl AsRef<Path>) -> Result<HeaderCards, IoError> {
    read_header_hdu(path, None)
}

/// Reads the header cards of the image chosen, without those about the structure of the file.
///
/// # Errors
/// As [`read_image_hdu`]; the pixels are not read.
pub fn read_header_hdu(path: impl AsRef<Path>, choice: Option<&HduChoice>) -> Result<HeaderCards, IoError> {
    let structure = FitsStructure::scan(path.as_ref())?;
    Ok(structure.cards(structure.image(choice)?))
}

/// Reads the header cards that describe a frame, such as its world coordinates, from an HDU that
/// need not have pixels.
///
/// Without a choice they are those of the image, as in [`read_header_hdu`]; in a file without
/// pixels those of the first HDU with world coordinates (`CTYPE1`), or else of the primary.
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
/// [`IoError::SeveralHdus`] where a choice among images with pixels is needed,
/// [`IoError::NoSuchHdu`] for a choice that is no image, and the errors of any FITS file.
pub fn read_cards(path: impl AsRef<Path>, choice: Option<&HduChoice>) -> Result<HeaderCards, IoError> {
    let structure = FitsStructure::scan(path.as_ref())?;
    Ok(structure.cards(structure.header_of_frame(choice)?))
}

/// The shape in array order without the leading axes of length 1 (FITS' last ones) beyond two.
pub(crate) fn squeezed(hdu: &Hdu) -> Vec<usize> {
    let shape = hdu.shape();
    let extra = shape.len().saturating_sub(2);
    let ones = shape[..extra].iter().take_while(|&&n| n == 1).count();
    shape[ones..].to_vec()
}

/// The shape `(planes, ny, nx)` of a cube; an image is a cube of one plane.
pub(crate) fn stack_shape(hdu: &Hdu, expected: &'static str) -> Result<(usize, usize, usize), IoError> {
    match squeezed(hdu)[..] {
        [ny, nx] => Ok((1, ny, nx)),
        [planes, ny, nx] => Ok((planes, ny, nx)),
        _ => Err(hdu.axes_error(expected)),
    }
}

/// The error for a band of rows that is not as wide as the image.
pub(crate) fn band_width(path: &Path, expected: usize, got: usize) -> IoError {
    let problem = format!("a band of rows must be as wide as the image, {expected} columns, got {got}");
    request(path, problem)
}

/// An image open for reading a band of rows at a time: what is larger than memory can be worked on
/// in parts.
///
/// Files, axes and pixels are those of [`read_image`](crate::read_image), as are the errors; the
/// bands put together are the image it returns, bit by bit. Rows may be read in any order and any
/// number of times. Memory: the band, nothing else. A reader stays in its thread; several may be
/// open on one file.
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
    /// The number of the image's first pixel in its HDU, which may hold several images.
    origin: usize,
    shape: FrameShape,
    header: HeaderCards,
}

impl ImageReader {
    /// Opens the image of a FITS file: [`open_hdu`](Self::open_hdu) without a choice.
    ///
    /// # Errors
    /// As [`open_hdu`](Self::open_hdu).
    pub fn open(path: impl AsRef<Path>) -> Result<Self, IoError> {
        Self::open_hdu(path, None)
    }

    /// Opens the image chosen; without a choice that of the primary HDU, or the only one there is.
    /// Every header is read and checked against the length of the file, no pixel is read.
    ///
    /// # Errors
    /// [`IoError::SeveralHdus`] with a list where a choice is needed, [`IoError::NoSuchHdu`],
    /// [`IoError::Axes`] for a cube, and the errors of any FITS file.
    pub fn open_hdu(path: impl AsRef<Path>, choice: Option<&HduChoice>) -> Result<Self, IoError> {
        Self::open_part(path.as_ref(), choice, |hdu| match squeezed(hdu)[..] {
            [ny, nx] => Ok((0, ny, nx)),
            _ => Err(hdu.axes_error("a single image [y, x] (a cube of PSF stamps is not a scene)")),
        })
    }

    /// Opens one plane, counted from 0, of a cube `[plane, y, x]`; an image is a cube of one plane.
    ///
    /// # Errors
    /// As [`open_hdu`](Self::open_hdu); [`IoError::Axes`] for more than three axes,
    /// [`IoError::Request`] for a plane that the cube does not have.
    pub fn open_plane(
        path: impl AsRef<Path>,
        choice: Option<&HduChoice>,
        plane: usize,
    ) -> Result<Self, IoError> {
        Self::open_part(path.as_ref(), choice, |hdu| {
            let (planes, ny, nx) = stack_shape(hdu, STACK)?;
            if plane >= planes {
                let problem = format!("there is no plane {plane}: the image has {planes}, counted from 0");
                return Err(request(hdu.path(), problem));
            }
            Ok((plane * ny * nx, ny, nx))
        })
    }

    /// Opens the pixels of the chosen HDU from the first on that `part` names, with the rows and
    /// columns that it names.
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
        })
    }

    /// Columns and rows of the whole image.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }

    /// The header cards, without those about the structure of the file.
    pub fn header(&self) -> &HeaderCards {
        &self.header
    }

    /// Reads rows as an array `[y, x]`, row-major, whose first row is row `rows.start` (0-based) of
    /// the image.
    ///
    /// # Errors
    /// As [`read_rows_into`](Self::read_rows_into).
    pub fn read_rows<T: Real>(&mut self, rows: Range<usize>) -> Result<Array2<T>, IoError> {
        // Before memory is taken.
        self.check_rows(&rows)?;
        let mut band = Array2::zeros((rows.len(), self.shape.nx()));
        self.read_rows_into(rows.start, band.view_mut())?;
        Ok(band)
    }

    /// Reads as many rows as `band` `[y, x]` has, from row `first_row` (0-based) of the image on.
    /// After an error the contents of `band` are not defined.
    ///
    /// # Errors
    /// [`IoError::Rows`] for rows that the image does not have, [`IoError::Request`] for a band of
    /// another width, [`IoError::NonFinitePixels`] with the place in the whole image and the number
    /// of such pixels in these rows, [`IoError::Overflow`] when a value of a double-precision file
    /// is too large for f32, and what CFITSIO reports.
    pub fn read_rows_into<T: Real>(
        &mut self,
        first_row: usize,
        mut band: ArrayViewMut2<'_, T>,
    ) -> Result<(), IoError> {
        let (ny, nx) = band.dim();
        self.check_rows(&(first_row..first_row.saturating_add(ny)))?;
        if nx != self.shape.nx() {
            return Err(band_width(&self.pixels.path, self.shape.nx(), nx));
        }
        let first = self.origin + first_row * nx;
        let clean = match band.as_slice_mut() {
            Some(values) => self.pixels.load(first, values)?,
            None => self.load_scattered(first, band)?,
        };
        if clean {
            Ok(())
        } else {
            Err(self.pixels.defect(first, ny * nx))
        }
    }

    /// Reads rows as [`read_rows`](Self::read_rows) does, with what is not a number: NaN and
    /// infinities as they stand in the file, `BLANK` pixels as NaN. For looking at an image;
    /// nothing may be computed from what this returns as if every pixel were measured.
    ///
    /// # Errors
    /// [`IoError::Rows`] for rows that the image does not have, and what CFITSIO reports.
    pub fn read_rows_with_undefined(&mut self, rows: Range<usize>) -> Result<Array2<f64>, IoError> {
        self.check_rows(&rows)?;
        let mut band = Array2::zeros((rows.len(), self.shape.nx()));
        let first = self.origin + rows.start * self.shape.nx();
        let values = band.as_slice_mut().expect("a new array is contiguous");
        // Whether all are finite does not matter.
        self.pixels.load(first, values)?;
        Ok(band)
    }

    /// Reads into rows that are not one piece of memory.
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
        Err(IoError::Rows {
            path: self.pixels.path.clone(),
            rows: rows.clone(),
            ny: self.shape.ny(),
        })
    }
}

/// Values looked at together in the search for NaN, few enough to stay in cache.
const CHUNK: usize = 4096;

/// The pixels of an image HDU, open for reading.
#[derive(Debug)]
struct Pixels {
    fits: Fits,
    path: PathBuf,
    hdu: usize,
    /// In array order, x last.
    shape: Vec<usize>,
    /// Whether undefined pixels have a number of their own.
    blank: bool,
}

impl Pixels {
    /// The HDU comes from a [`FitsStructure`](FitsStructure), which has checked that the file holds
    /// its data.
    fn open(hdu: &Hdu) -> Result<Self, IoError> {
        tiles::check(hdu)?;
        let mut fits = Fits::open(&hdu.source)?;
        fits.move_to(hdu.index)?;
        Ok(Self {
            fits,
            path: hdu.path().to_owned(),
            hdu: hdu.index,
            shape: hdu.shape(),
            // For floats CFITSIO must not look for undefined values: it would flush subnormal
            // numbers to zero. But in compressed images NaN may be a number that only CFITSIO
            // knows, and would else return as if it were a value.
            blank: hdu.is_tiled() || (hdu.bitpix > 0 && hdu.header.get("BLANK").is_some()),
        })
    }

    /// Reads pixels from number `first` (0-based, rows one after the other) on, BSCALE and BZERO
    /// applied; false when one is not finite, for which [`defect`](Self::defect) then has the
    /// error.
    fn load<T: Real>(&mut self, first: usize, pixels: &mut [T]) -> Result<bool, IoError> {
        self.fits.read_pixels(first, pixels, self.blank)?;
        let clean = |chunk: &[T]| chunk.iter().fold(true, |clean, value| clean & value.is_finite());
        Ok(pixels.chunks(CHUNK).all(clean))
    }

    /// The error for pixels that are not all finite in the type asked for.
    fn defect(&mut self, first: usize, count: usize) -> IoError {
        match self.non_finite(first, count) {
            Ok(Some((flat, value, count))) => IoError::NonFinitePixels {
                path: self.path.clone(),
                hdu: self.hdu,
                index: self.index(flat),
                value,
                count,
            },
            // A value that is infinite in single precision may be a number in the file.
            Ok(None) => IoError::Overflow {
                path: self.path.clone(),
            },
            Err(error) => error,
        }
    }

    /// The first pixel that is no number in double precision, its value, and how many there are.
    fn non_finite(&mut self, first: usize, count: usize) -> Result<Option<(usize, f64, usize)>, IoError> {
        let mut found = None;
        // By chunks: a second copy of the pixels might not fit into memory.
        let mut values = vec![0.0_f64; CHUNK];
        for start in (first..first + count).step_by(CHUNK) {
            let chunk = &mut values[..CHUNK.min(first + count - start)];
            if self.load(start, chunk)? {
                continue;
            }
            for (i, &value) in chunk.iter().enumerate().filter(|(_, value)| !value.is_finite()) {
                found.get_or_insert((start + i, value, 0)).2 += 1;
            }
        }
        Ok(found)
    }

    /// The place of a pixel along each axis.
    fn index(&self, mut flat: usize) -> Vec<usize> {
        let mut index = vec![0; self.shape.len()];
        for (place, &n) in index.iter_mut().zip(&self.shape).rev() {
            *place = flat % n;
            flat /= n;
        }
        index
    }
}

/// Reads all pixels of an image HDU, BSCALE and BZERO applied, and refuses NaN, infinities and
/// BLANK.
///
/// The HDU comes from a [`FitsStructure`](FitsStructure), which has checked that the file holds its
/// data: memory is bounded by the length of the file.
fn read_pixels<T: Real>(hdu: &Hdu) -> Result<Vec<T>, IoError> {
    // Opening checks tiles, before memory is taken for what they claim to hold.
    let mut pixels = Pixels::open(hdu)?;
    let mut values = vec![T::zero(); hdu.axes.iter().product()];
    if pixels.load(0, &mut values)? {
        Ok(values)
    } else {
        Err(pixels.defect(0, values.len()))
    }
}

/// Reads all pixels of an image HDU as a stack of this shape.
pub(crate) fn read_stack<T: Real>(hdu: &Hdu, shape: (usize, usize, usize)) -> Result<Array3<T>, IoError> {
    Ok(Array3::from_shape_vec(shape, read_pixels(hdu)?).expect("as many pixels as the axes say"))
}
