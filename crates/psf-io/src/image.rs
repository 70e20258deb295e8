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
//! `NAXIS1` is x. The pixel at array index `[y, x]`, 0-based, is FITS pixel `(x + 1, y + 1)`; world coordinates, which count in
//! FITS pixels, go over as they are. Files compressed by gzip or fpack are read as they are.
//!
//! An image that does not fit into memory is read and written by bands of rows: [`ImageReader`] and [`ImageWriter`].
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

use std::path::Path;

use ndarray::Array3;
use psf_types::{Image, Real};

use crate::error::{bad_card, invalid};
use crate::hdu::Hdu;
use crate::pixels::read_pixels;
use crate::structure::FitsStructure;
use crate::{Card, HduChoice, HeaderCards, ImageReader, ImageWriter, IoError};

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

/// Reads the image of a FITS file, whatever its BITPIX, in the precision asked for: [`read_image_hdu`] without a choice.
///
/// # Errors
/// As [`read_image_hdu`].
pub fn read_image<T: Real>(path: impl AsRef<Path>) -> Result<FitsImage<T>, IoError> {
    read_image_hdu(path, None)
}

/// Reads the image chosen; without a choice that of the primary HDU, or the only one there is.
///
/// # Errors
/// [`IoError::SeveralHdus`] with a list where a choice is needed, [`IoError::NoSuchHdu`], [`IoError::Axes`] for a cube, [`IoError::NonFinitePixels`], [`IoError::Overflow`] when a value of a double-precision file is
/// too large for f32, and the errors of any FITS file.
pub fn read_image_hdu<T: Real>(
    path: impl AsRef<Path>,
    choice: Option<&HduChoice>,
) -> Result<FitsImage<T>, IoError> {
    let path = path.as_ref();
    let mut reader = ImageReader::open_hdu(path, choice)?;
    let pixels = reader.read_rows(0..reader.shape().ny())?;
    Ok(FitsImage {
        image: Image::new(pixels).map_err(invalid(path))?,
        header: reader.into_header(),
    })
}

/// Reads the image of a FITS file as a stack `[plane, y, x]`: a cube, or an image as a stack of one.
///
/// For stamps that need not be PSF samples, such as a reference to compare with.
///
/// # Errors
/// As [`read_cube_hdu`].
pub fn read_cube<T: Real>(path: impl AsRef<Path>) -> Result<Array3<T>, IoError> {
    read_cube_hdu(path, None)
}

/// The same of the image chosen.
///
/// # Errors
/// As [`read_image_hdu`]; [`IoError::Axes`] for more than three axes.
pub fn read_cube_hdu<T: Real>(
    path: impl AsRef<Path>,
    choice: Option<&HduChoice>,
) -> Result<Array3<T>, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let hdu = structure.image(choice)?;
    let shape = match squeezed(hdu)[..] {
        [ny, nx] => (1, ny, nx),
        [planes, ny, nx] => (planes, ny, nx),
        _ => return Err(hdu.axes_error("an image [y, x] or a cube [plane, y, x]")),
    };
    Ok(Array3::from_shape_vec(shape, read_pixels(path, hdu)?).expect("as many pixels as the axes say"))
}

/// Reads the header cards of the image of a FITS file, without those about the structure of the file.
///
/// # Errors
/// As [`read_header_hdu`].
pub fn read_header(path: impl AsRef<Path>) -> Result<HeaderCards, IoError> {
    read_header_hdu(path, None)
}

/// The same of the image chosen.
///
/// # Errors
/// As [`read_image_hdu`]; the pixels are not read.
pub fn read_header_hdu(path: impl AsRef<Path>, choice: Option<&HduChoice>) -> Result<HeaderCards, IoError> {
    let structure = FitsStructure::scan(path.as_ref())?;
    Ok(structure.cards(structure.image(choice)?))
}

/// Reads the header cards that describe a frame, such as its world coordinates, from an HDU that need not have pixels.
///
/// Without a choice they are those of the image, as in [`read_header_hdu`]; in a file without pixels those of the first HDU with world
/// coordinates (`CTYPE1`), or else of the primary.
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
/// [`IoError::SeveralHdus`] where a choice among images with pixels is needed, [`IoError::NoSuchHdu`] for a choice that is no image, and the errors of
/// any FITS file.
pub fn read_cards(path: impl AsRef<Path>, choice: Option<&HduChoice>) -> Result<HeaderCards, IoError> {
    let structure = FitsStructure::scan(path.as_ref())?;
    Ok(structure.cards(structure.header_of_frame(choice)?))
}

/// Writes an image: `BITPIX` -32 for f32, -64 for f64.
///
/// `header` are cards carried over from an input (cut frames: [`HeaderCards::shifted_origin`]); `added` follow, each in the place
/// of the cards of its keyword, texts (HISTORY, COMMENT) at the end. The file appears whole or not at all
/// ([`write_atomically`](crate::write_atomically)).
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("image.fits");
/// use psf_io::{Card, HeaderCards, read_image, write_image};
/// use psf_types::{FrameShape, Image};
/// let image = Image::<f32>::zeros(FrameShape::new(30, 20)?);
/// let cards = [Card::new("TELESCOP", "demo", "")?];
/// write_image(&path, &image, &HeaderCards::new(), &cards, false)?;
/// let back = read_image::<f32>(&path)?;
/// assert_eq!(back.image(), &image);
/// assert_eq!(back.header().get("TELESCOP"), Some(&cards[0]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoError::Exists`] unless `overwrite`, [`IoError::MissingDirectory`], or what the file system and CFITSIO report.
pub fn write_image<T: Real>(
    path: impl AsRef<Path>,
    image: &Image<T>,
    header: &HeaderCards,
    added: &[Card],
    overwrite: bool,
) -> Result<(), IoError> {
    let mut writer = ImageWriter::create(path, image.shape(), header, added, overwrite)?;
    writer.write_finite_rows(image.pixels())?;
    writer.finish()
}

/// The shape in array order without the leading axes of length 1 (FITS' last ones) beyond two.
pub(crate) fn squeezed(hdu: &Hdu) -> Vec<usize> {
    let shape = hdu.shape();
    let extra = shape.len().saturating_sub(2);
    let ones = shape[..extra].iter().take_while(|&&n| n == 1).count();
    shape[ones..].to_vec()
}

/// Cards from keyword, value and comment.
pub(crate) fn cards<const N: usize>(
    path: &Path,
    list: [(&str, crate::CardValue, &str); N],
) -> Result<Vec<Card>, IoError> {
    list.into_iter()
        .map(|(keyword, value, comment)| Card::new(keyword, value, comment).map_err(bad_card(path)))
        .collect()
}
