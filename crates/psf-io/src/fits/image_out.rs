//! Writes images: whole images, images by bands of rows, whole numbers, and cubes.

use std::marker::PhantomData;
use std::path::Path;

use ndarray::{ArrayView1, ArrayView2, ArrayView3};
use psf_types::{DataError, FrameShape, Image, Quantity, Real};

use crate::error::{IoError, IoErrorKind, bad_card, beyond_single, invalid, unwritable};
use crate::fits::card::{Card, CardValue, Record};
use crate::fits::cfitsio::Fits;
use crate::fits::header_cards::HeaderCards;
use crate::fits::image::{bad_rows, band_width};
use crate::output::PendingFile;

/// Writes an image: `BITPIX` -32 for f32, -64 for f64.
///
/// `header` holds cards copied from an input. If the image is cut out of this input, change these
/// cards first by [`HeaderCards::shifted_origin`]. Each card of `added` replaces the cards with its
/// keyword, or is appended if there are none. Text cards (HISTORY, COMMENT) are always appended.
/// The file appears complete or not at all ([`write_atomically`](crate::write_atomically)). An
/// existing file is replaced only if `overwrite` is true.
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
/// The errors of [`check_output`](crate::check_output), [`IoErrorKind::Limit`] for a path that is
/// too long for CFITSIO, and [`IoErrorKind::Write`] for an error of the file system or of CFITSIO.
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

/// Writes an image one band of rows at a time, from row 0 on. The whole image need never be in
/// memory.
///
/// The file is equal byte by byte to the file that [`write_image`](crate::write_image) would write,
/// unless [`create_reserving`](Self::create_reserving) reserved room that stays unused. The file
/// gets its final name when [`finish`](Self::finish) succeeds. A writer that is dropped before
/// that leaves nothing behind, and an old file at the path stays untouched. Besides the caller's
/// band, the writer needs buffers of some 100 kB. A writer cannot be sent to another thread.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("image.fits");
/// use ndarray::Array2;
/// use psf_io::{Card, HeaderCards, ImageWriter, read_image};
/// use psf_types::FrameShape;
/// let shape = FrameShape::new(30, 20)?;
/// let mut writer = ImageWriter::<f32>::create(&path, shape, &HeaderCards::new(), &[], false)?;
/// for _ in 0..4 {
///     writer.write_rows(Array2::from_elem((5, 30), 0.5).view())?;
/// }
/// writer.finish_with(&[Card::new("MEANFLUX", 0.5, "known only now")?])?;
/// let back = read_image::<f32>(&path)?;
/// assert_eq!(back.image().pixels().sum(), 300.0);
/// assert!(back.header().get("MEANFLUX").is_some());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct ImageWriter<T> {
    file: NewFits,
    shape: FrameShape,
    /// The cards as they are in the file.
    cards: HeaderCards,
    rows_written: usize,
    pixels: PhantomData<T>,
}

impl<T: Real> ImageWriter<T> {
    /// Starts an image of `shape`: `BITPIX` -32 for f32, -64 for f64. `header` and `added` have the
    /// same meaning as in [`write_image`](crate::write_image).
    ///
    /// # Errors
    /// The errors of [`write_image`](crate::write_image).
    pub fn create(
        path: impl AsRef<Path>,
        shape: FrameShape,
        header: &HeaderCards,
        added: &[Card],
        overwrite: bool,
    ) -> Result<Self, IoError> {
        Self::create_reserving(path, shape, header, added, 0, overwrite)
    }

    /// Works like [`create`](Self::create), and reserves room in the header for the `late` records
    /// that [`finish_with`](Self::finish_with) will add.
    ///
    /// A card is one record of 80 characters. A string of more than 68 characters, or a text of
    /// HISTORY or COMMENT of more than 72, needs more records. Unused room is filled with blank
    /// records, which FITS allows at the end of a header. At most 100 000 records (8 MB) are
    /// reserved.
    ///
    /// # Errors
    /// The errors of [`create`](Self::create).
    pub fn create_reserving(
        path: impl AsRef<Path>,
        shape: FrameShape,
        header: &HeaderCards,
        added: &[Card],
        late: usize,
        overwrite: bool,
    ) -> Result<Self, IoError> {
        let path = path.as_ref();
        let cards = header.with(added);
        let mut file = NewFits::create(path, overwrite)?;
        write_image_header(&mut file.fits, &[shape.ny(), shape.nx()], bitpix::<T>(), &cards)?;
        if late > 0 {
            file.fits.reserve_records(late)?;
        }
        Ok(Self {
            file,
            shape,
            cards,
            rows_written: 0,
            pixels: PhantomData,
        })
    }

    /// Columns and rows of the whole image.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }

    /// The number of rows written so far: the next band starts at this row.
    pub fn rows_written(&self) -> usize {
        self.rows_written
    }

    /// Writes the next rows `[y, x]`, of any memory layout. A band that is refused for its values
    /// or its shape leaves the file as it was, and another band may be written in its place.
    ///
    /// # Errors
    /// [`IoErrorKind::Request`] for more rows than the image has or a band of another width,
    /// [`IoErrorKind::Data`] for a pixel that is NaN or infinite, and [`IoErrorKind::Write`] for an
    /// error of the file system or of CFITSIO. The source of the [`IoErrorKind::Data`] error is
    /// [`DataError::NonFinite`] with the index `[y, x]` of the first such pixel, counted from row 0
    /// of the whole image.
    pub fn write_rows(&mut self, rows: ArrayView2<'_, T>) -> Result<(), IoError> {
        let clean = |row: ArrayView1<'_, T>| row.fold(true, |clean, value| clean & value.is_finite());
        self.check_shape(rows)?;
        if !rows.rows().into_iter().all(clean) {
            let bad = rows.indexed_iter().find(|(_, value)| !value.is_finite());
            let ((y, x), value) = bad.expect("a row is not finite");
            return Err(invalid(self.file.fits.path())(DataError::NonFinite {
                quantity: Quantity::Pixel,
                index: vec![self.rows_written + y, x],
                value: value.as_f64(),
            }));
        }
        self.write_finite_rows(rows)
    }

    /// Writes rows that are known to be finite.
    pub(crate) fn write_finite_rows(&mut self, rows: ArrayView2<'_, T>) -> Result<(), IoError> {
        self.check_shape(rows)?;
        let nx = self.shape.nx();
        let first = self.rows_written * nx;
        let fits = &mut self.file.fits;
        if let Some(values) = rows.as_slice() {
            fits.write_pixels(first, values)?;
        } else {
            for (y, row) in rows.rows().into_iter().enumerate() {
                // `as_standard_layout` copies the row only if its pixels are not contiguous.
                let row = row.as_standard_layout();
                fits.write_pixels(first + y * nx, row.as_slice().expect("the layout is standard"))?;
            }
        }
        self.rows_written += rows.nrows();
        Ok(())
    }

    fn check_shape(&self, rows: ArrayView2<'_, T>) -> Result<(), IoError> {
        let (count, width) = rows.dim();
        let (nx, ny) = (self.shape.nx(), self.shape.ny());
        if width != nx {
            return Err(band_width(self.file.fits.path(), nx, width));
        }
        if count > ny - self.rows_written {
            let rows = self.rows_written..self.rows_written.saturating_add(count);
            return Err(bad_rows(self.file.fits.path(), &rows, ny));
        }
        Ok(())
    }

    /// Completes the file and gives it its final name.
    ///
    /// # Errors
    /// [`IoErrorKind::Request`] unless all rows were written, [`IoErrorKind::Exists`] if a file
    /// that may not be replaced has appeared at the path, and [`IoErrorKind::Write`] for an error
    /// of the file system or of CFITSIO. After an error the unfinished file is removed.
    pub fn finish(self) -> Result<(), IoError> {
        self.finish_with(&[])
    }

    /// Works like [`finish`](Self::finish), and adds cards whose values depend on the pixels. Each
    /// card replaces the cards with its keyword, as in [`create`](Self::create).
    ///
    /// If the header has no room left for these cards, CFITSIO moves all pixels by a block of 2880
    /// bytes, once for every 36 records. Each move reads and writes the whole file, but needs
    /// little memory. [`create_reserving`](Self::create_reserving) avoids this.
    ///
    /// # Errors
    /// The errors of [`finish`](Self::finish).
    pub fn finish_with(mut self, added: &[Card]) -> Result<(), IoError> {
        if self.rows_written < self.shape.ny() {
            let (expected, got) = (self.shape.ny(), self.rows_written);
            let problem =
                format!("the image has {expected} rows, but only {got} were written: write the rest first");
            return Err(IoError::new(self.file.fits.path(), IoErrorKind::Request, problem));
        }
        let cards = self.cards.with(added);
        let (old, new) = (records(&self.cards), records(&cards));
        let same = old.iter().zip(&new).take_while(|(old, new)| old == new).count();
        let fits = &mut self.file.fits;
        fits.remove_records(old.len() - same)?;
        new[same..]
            .iter()
            .try_for_each(|record| fits.write_record(record))?;
        self.file.finish()
    }
}

fn records(cards: &HeaderCards) -> Vec<&Record> {
    cards.iter().flat_map(Card::records).collect()
}

/// A new FITS file that still has a temporary name. [`finish`](Self::finish) gives it the final
/// name. A file that is dropped before that is removed.
#[derive(Debug)]
pub(crate) struct NewFits {
    // Rust drops fields in the order of their declaration, so the file is closed before it is
    // removed.
    fits: Fits,
    file: PendingFile,
}

impl NewFits {
    pub(crate) fn create(path: &Path, overwrite: bool) -> Result<Self, IoError> {
        let (file, fits) = PendingFile::create(path, overwrite, |temporary| {
            // CFITSIO creates the file itself, and refuses to if the file exists.
            std::fs::remove_file(temporary).map_err(unwritable(path))?;
            Fits::create(temporary, path)
        })?;
        Ok(Self { fits, file })
    }

    pub(crate) fn finish(self) -> Result<(), IoError> {
        self.fits.close()?;
        self.file.commit()
    }
}

/// Creates a FITS file under a temporary name, lets `write` fill it and renames it.
pub(crate) fn write_fits(
    path: &Path,
    overwrite: bool,
    write: impl FnOnce(&mut Fits) -> Result<(), IoError>,
) -> Result<(), IoError> {
    let mut file = NewFits::create(path, overwrite)?;
    write(&mut file.fits)?;
    file.finish()
}

/// The BITPIX of the float type `T`.
fn bitpix<T: Real>() -> i32 {
    -8 * size_of::<T>() as i32
}

/// Adds an image HDU and writes its whole header, but no pixels yet. If cards were added after the
/// pixels, CFITSIO might have to move the pixels.
pub(crate) fn write_image_header(
    fits: &mut Fits,
    shape: &[usize],
    bitpix: i32,
    cards: &HeaderCards,
) -> Result<(), IoError> {
    fits.create_image(shape, bitpix)?;
    write_cards(fits, cards)
}

/// Adds cards to the header of the current HDU.
pub(crate) fn write_cards(fits: &mut Fits, cards: &HeaderCards) -> Result<(), IoError> {
    cards.iter().try_for_each(|card| fits.write_card(card))
}

/// Adds an image HDU with all its pixels.
pub(crate) fn write_image_hdu<T: Real>(
    fits: &mut Fits,
    shape: &[usize],
    pixels: &[T],
    cards: &HeaderCards,
) -> Result<(), IoError> {
    write_image_header(fits, shape, bitpix::<T>(), cards)?;
    fits.write_pixels(0, pixels)
}

/// Converts values to single precision. Returns an error if a value is too large or NaN.
pub(crate) fn in_single_precision<'a>(
    path: &Path,
    values: impl IntoIterator<Item = &'a f64>,
) -> Result<Vec<f32>, IoError> {
    let values: Vec<f32> = values.into_iter().map(|&v| v as f32).collect();
    if values.iter().all(|v| v.is_finite()) {
        return Ok(values);
    }
    Err(beyond_single(path))
}

/// Makes cards from keywords, values and comments.
pub(crate) fn cards<'a, K: AsRef<str>>(
    path: &Path,
    list: impl IntoIterator<Item = (K, CardValue, &'a str)>,
) -> Result<Vec<Card>, IoError> {
    list.into_iter()
        .map(|(keyword, value, comment)| Card::new(keyword.as_ref(), value, comment).map_err(bad_card(path)))
        .collect()
}

/// The storage type of whole numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum IntegerKind {
    /// 0 to 255: `BITPIX` 8.
    Unsigned8,
    /// 0 to 65535: `BITPIX` 16 with `BZERO` 32768.
    Unsigned16,
    /// -2^31 to 2^31 - 1: `BITPIX` 32.
    Signed32,
}

impl IntegerKind {
    /// CFITSIO's code of the image type. Code 20 stands for `BITPIX` 16 with `BZERO` 32768.
    fn bitpix(self) -> i32 {
        match self {
            Self::Unsigned8 => 8,
            Self::Unsigned16 => 20,
            Self::Signed32 => 32,
        }
    }

    /// The smallest kind that holds the counts of an analogue-to-digital converter with this many
    /// bits, at most 31.
    pub fn of_bits(bits: u32) -> Self {
        match bits {
            0..=8 => Self::Unsigned8,
            9..=16 => Self::Unsigned16,
            _ => Self::Signed32,
        }
    }

    /// The lowest and the highest number that the kind can store.
    pub fn range(self) -> (i32, i32) {
        match self {
            Self::Unsigned8 => (0, i32::from(u8::MAX)),
            Self::Unsigned16 => (0, i32::from(u16::MAX)),
            Self::Signed32 => (i32::MIN, i32::MAX),
        }
    }
}

/// Writes an image `[y, x]` of whole numbers. The elements of `pixels` may have any number type
/// that converts to f64.
///
/// `header`, `added` and `overwrite` have the same meaning as in
/// [`write_image`](crate::write_image).
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("raw.fits");
/// use ndarray::array;
/// use psf_io::{HeaderCards, IntegerKind, read_image, write_integers};
/// let counts = array![[0.0_f32, 65535.0], [312.0, 7.0]];
/// write_integers(&path, counts.view(), IntegerKind::Unsigned16, &HeaderCards::new(), &[], false)?;
/// assert_eq!(read_image::<f32>(&path)?.image().pixels(), counts);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoErrorKind::Request`] with the first value that is not a whole number in the range of `kind`,
/// [`IoErrorKind::Data`] for an image without pixels, and the errors of
/// [`write_image`](crate::write_image).
pub fn write_integers<V: Copy + Into<f64>>(
    path: impl AsRef<Path>,
    pixels: ArrayView2<'_, V>,
    kind: IntegerKind,
    header: &HeaderCards,
    added: &[Card],
    overwrite: bool,
) -> Result<(), IoError> {
    let path = path.as_ref();
    let (ny, nx) = pixels.dim();
    let shape = FrameShape::new(nx, ny).map_err(invalid(path))?;
    let cards = header.with(added);
    let mut file = NewFits::create(path, overwrite)?;
    let fits = &mut file.fits;
    write_image_header(fits, &[shape.ny(), shape.nx()], kind.bitpix(), &cards)?;
    let (lowest, highest) = kind.range();
    let mut row = Vec::with_capacity(nx);
    for (y, values) in pixels.outer_iter().enumerate() {
        row.clear();
        for (x, &value) in values.iter().enumerate() {
            let value: f64 = value.into();
            if !(f64::from(lowest)..=f64::from(highest)).contains(&value) || value.fract() != 0.0 {
                let problem = format!(
                    "the pixel {:?} ([y, x], 0-based) is {value}, but it must be a whole number from {lowest} to {highest}",
                    [y, x]
                );
                return Err(IoError::new(path, IoErrorKind::Request, problem));
            }
            row.push(value as i32);
        }
        fits.write_pixels(y * nx, &row)?;
    }
    file.finish()
}

/// Writes a stack `[plane, y, x]` in single precision, with `cards` in its header. The file appears
/// complete or not at all.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("cube.fits");
/// use ndarray::Array3;
/// let cube = Array3::from_elem((2, 3, 4), 1.5);
/// psf_io::write_cube(&path, cube.view(), &[], false)?;
/// assert_eq!(psf_io::read_cube::<f64>(&path)?, cube);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoErrorKind::Limit`] for a value that is not finite in single precision, and the errors of
/// [`write_image`](crate::write_image).
pub fn write_cube(
    path: impl AsRef<Path>,
    cube: ArrayView3<'_, f64>,
    cards: &[Card],
    overwrite: bool,
) -> Result<(), IoError> {
    let path = path.as_ref();
    let values = in_single_precision(path, cube)?;
    let cards = HeaderCards::new().with(cards);
    write_fits(path, overwrite, |fits| {
        write_image_hdu(fits, cube.shape(), &values, &cards)
    })
}
