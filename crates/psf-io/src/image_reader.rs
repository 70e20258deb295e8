//! An image read by bands of rows.

use std::ops::Range;
use std::path::{Path, PathBuf};

use ndarray::{Array1, Array2, ArrayViewMut2};
use psf_types::{FrameShape, Real};

use crate::error::invalid;
use crate::image::squeezed;
use crate::pixels::Pixels;
use crate::structure::FitsStructure;
use crate::{HduChoice, HeaderCards, IoError};

/// An image open for reading a band of rows at a time: what is larger than memory can be worked on in parts.
///
/// Files, axes and pixels are those of [`read_image`](crate::read_image), as are the errors; the bands put together are the
/// image it returns, bit by bit. Rows may be read in any order and any number of times. Memory: the band, nothing else. A
/// reader stays in its thread; several may be open on one file.
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
    path: PathBuf,
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

    /// Opens the image chosen; without a choice that of the primary HDU, or the only one there is. Every header is read and checked against
    /// the length of the file, no pixel is read.
    ///
    /// # Errors
    /// [`IoError::SeveralHdus`] with a list where a choice is needed, [`IoError::NoSuchHdu`], [`IoError::Axes`] for a cube, and the
    /// errors of any FITS file.
    pub fn open_hdu(path: impl AsRef<Path>, choice: Option<&HduChoice>) -> Result<Self, IoError> {
        let path = path.as_ref();
        let structure = FitsStructure::scan(path)?;
        let hdu = structure.image(choice)?;
        let &[ny, nx] = squeezed(hdu).as_slice() else {
            return Err(hdu.axes_error("a single image [y, x] (a cube of PSF stamps is not a scene)"));
        };
        Ok(Self {
            path: path.to_owned(),
            pixels: Pixels::open(path, hdu)?,
            origin: 0,
            shape: FrameShape::new(nx, ny).map_err(invalid(path))?,
            header: structure.cards(hdu),
        })
    }

    /// Opens one plane, counted from 0, of a cube `[plane, y, x]`; an image is a cube of one plane.
    ///
    /// # Errors
    /// As [`open_hdu`](Self::open_hdu); [`IoError::Axes`] for more than three axes, [`IoError::Plane`] for a plane that the cube does not
    /// have.
    pub fn open_plane(
        path: impl AsRef<Path>,
        choice: Option<&HduChoice>,
        plane: usize,
    ) -> Result<Self, IoError> {
        let path = path.as_ref();
        let structure = FitsStructure::scan(path)?;
        let hdu = structure.image(choice)?;
        let (planes, ny, nx) = match squeezed(hdu)[..] {
            [ny, nx] => (1, ny, nx),
            [planes, ny, nx] => (planes, ny, nx),
            _ => return Err(hdu.axes_error("an image [y, x] or a cube [plane, y, x]")),
        };
        if plane >= planes {
            return Err(IoError::Plane {
                path: path.to_owned(),
                plane,
                planes,
            });
        }
        Ok(Self {
            path: path.to_owned(),
            pixels: Pixels::open(path, hdu)?,
            origin: plane * ny * nx,
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

    /// The header cards, without a copy.
    pub(crate) fn into_header(self) -> HeaderCards {
        self.header
    }

    /// Reads rows as an array `[y, x]`, row-major, whose first row is row `rows.start` (0-based) of the image.
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

    /// Reads as many rows as `band` `[y, x]` has, from row `first_row` (0-based) of the image on. After an error the contents of
    /// `band` are not defined.
    ///
    /// # Errors
    /// [`IoError::Rows`] for rows that the image does not have, [`IoError::BandWidth`], [`IoError::NonFinitePixels`] with the place
    /// in the whole image and the number of such pixels in these rows, [`IoError::Overflow`] when a value of a
    /// double-precision file is too large for f32, and what CFITSIO reports.
    pub fn read_rows_into<T: Real>(
        &mut self,
        first_row: usize,
        mut band: ArrayViewMut2<'_, T>,
    ) -> Result<(), IoError> {
        let (ny, nx) = band.dim();
        self.check_rows(&(first_row..first_row.saturating_add(ny)))?;
        if nx != self.shape.nx() {
            return Err(IoError::BandWidth {
                path: self.path.clone(),
                expected: self.shape.nx(),
                got: nx,
            });
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

    /// Reads rows as [`read_rows`](Self::read_rows) does, with what is not a number: NaN and infinities as they stand in the file, `BLANK`
    /// pixels as NaN. For looking at an image; nothing may be computed from what this returns as if every pixel were measured.
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
            path: self.path.clone(),
            rows: rows.clone(),
            ny: self.shape.ny(),
        })
    }
}
