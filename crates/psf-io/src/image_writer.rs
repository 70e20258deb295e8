//! An image written by bands of rows.

use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use ndarray::{ArrayView1, ArrayView2};
use psf_types::{DataError, FrameShape, Quantity, Real};

use crate::card::Record;
use crate::error::invalid;
use crate::new_fits::{NewFits, write_image_header};
use crate::{Card, HeaderCards, IoError};

/// An image written a band of rows at a time, from row 0 on: the whole of it need never be in memory.
///
/// The file is the one that [`write_image`](crate::write_image) would write, byte by byte. It appears under its name when
/// [`finish`](Self::finish) has succeeded, whole; a writer that is dropped before leaves nothing behind, and what stood at the path
/// before is untouched. Memory: the caller's band and buffers of some 100 kB. A writer stays in its thread.
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
    path: PathBuf,
    shape: FrameShape,
    /// As they stand in the file.
    cards: HeaderCards,
    rows_written: usize,
    pixels: PhantomData<T>,
}

impl<T: Real> ImageWriter<T> {
    /// Starts an image of `shape`: `BITPIX` -32 for f32, -64 for f64, with the cards of [`write_image`](crate::write_image).
    ///
    /// # Errors
    /// [`IoError::Exists`] unless `overwrite`, [`IoError::MissingDirectory`], or what the file system and CFITSIO report.
    pub fn create(
        path: impl AsRef<Path>,
        shape: FrameShape,
        header: &HeaderCards,
        added: &[Card],
        overwrite: bool,
    ) -> Result<Self, IoError> {
        Self::create_reserving(path, shape, header, added, 0, overwrite)
    }

    /// As [`create`](Self::create), with room in the header for the `late` records that [`finish_with`](Self::finish_with) will
    /// add.
    ///
    /// A card is one record of 80 characters; a text of more than 68 characters, or a line of HISTORY of more than 72, needs more.
    /// Room that stays empty is blank records, which FITS allows at the end of a header; 100 000 records (8 MB) are the most that
    /// is set aside.
    ///
    /// # Errors
    /// As [`create`](Self::create).
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
        write_image_header::<T>(file.fits(), &[shape.ny(), shape.nx()], &cards)?;
        if late > 0 {
            file.fits().reserve_records(late)?;
        }
        Ok(Self {
            file,
            path: path.to_owned(),
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

    /// Writes the next rows `[y, x]`, of any memory layout. A band that is refused for its values or its shape leaves the file as it
    /// was: another may follow in its place.
    ///
    /// # Errors
    /// [`IoError::Rows`] for more rows than the image has, [`IoError::BandWidth`], [`IoError::Data`] with
    /// [`DataError::NonFinite`] for the first pixel `[y, x]`, counted in the whole image, that is NaN or infinite, or what the file
    /// system and CFITSIO report.
    pub fn write_rows(&mut self, rows: ArrayView2<'_, T>) -> Result<(), IoError> {
        let clean = |row: ArrayView1<'_, T>| row.fold(true, |clean, value| clean & value.is_finite());
        self.check_shape(rows)?;
        if !rows.rows().into_iter().all(clean) {
            let bad = rows.indexed_iter().find(|(_, value)| !value.is_finite());
            let ((y, x), value) = bad.expect("one was found");
            return Err(invalid(&self.path)(DataError::NonFinite {
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
        let fits = self.file.fits();
        if let Some(values) = rows.as_slice() {
            fits.write_pixels(first, values)?;
        } else {
            for (y, row) in rows.rows().into_iter().enumerate() {
                // Copies a row at a time, and only where its pixels do not follow one another.
                let row = row.as_standard_layout();
                fits.write_pixels(first + y * nx, row.as_slice().expect("now they do"))?;
            }
        }
        self.rows_written += rows.nrows();
        Ok(())
    }

    fn check_shape(&self, rows: ArrayView2<'_, T>) -> Result<(), IoError> {
        let (count, width) = rows.dim();
        let (nx, ny) = (self.shape.nx(), self.shape.ny());
        if width != nx {
            return Err(IoError::BandWidth {
                path: self.path.clone(),
                expected: nx,
                got: width,
            });
        }
        if count > ny - self.rows_written {
            return Err(IoError::Rows {
                path: self.path.clone(),
                rows: self.rows_written..self.rows_written.saturating_add(count),
                ny,
            });
        }
        Ok(())
    }

    /// Completes the file and gives it its name.
    ///
    /// # Errors
    /// [`IoError::Incomplete`] unless all rows were written, [`IoError::Exists`] when a file has appeared at the path that may not
    /// be replaced, or what the file system and CFITSIO report. On an error the file is gone.
    pub fn finish(self) -> Result<(), IoError> {
        self.finish_with(&[])
    }

    /// As [`finish`](Self::finish), with cards whose values come out of the pixels. Each takes the place of the cards of its
    /// keyword, as those given to [`create`](Self::create) do.
    ///
    /// Cards that find no room in the header, neither in its last block of 36 records nor in what
    /// [`create_reserving`](Self::create_reserving) has left, are written all the same; CFITSIO then moves all pixels by a
    /// block of 2880 bytes, once for every 36 records: a pass over the file, in little memory.
    ///
    /// # Errors
    /// As [`finish`](Self::finish).
    pub fn finish_with(mut self, added: &[Card]) -> Result<(), IoError> {
        if self.rows_written < self.shape.ny() {
            return Err(IoError::Incomplete {
                path: self.path,
                expected: self.shape.ny(),
                got: self.rows_written,
            });
        }
        let cards = self.cards.with(added);
        let (old, new) = (records(&self.cards), records(&cards));
        let same = old.iter().zip(&new).take_while(|(old, new)| old == new).count();
        let fits = self.file.fits();
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
