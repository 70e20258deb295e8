//! Pixels of an image HDU, read straight into the type wanted.

use std::path::{Path, PathBuf};

use psf_types::Real;

use crate::IoError;
use crate::cfitsio::Fits;
use crate::hdu::Hdu;
use crate::tiles;

/// Values looked at together in the search for NaN, few enough to stay in cache.
const CHUNK: usize = 4096;

/// The pixels of an image HDU, open for reading.
#[derive(Debug)]
pub(crate) struct Pixels {
    fits: Fits,
    path: PathBuf,
    hdu: usize,
    /// In array order, x last.
    shape: Vec<usize>,
    /// Whether undefined pixels have a number of their own.
    blank: bool,
}

impl Pixels {
    /// The HDU comes from a [`FitsStructure`](crate::structure::FitsStructure), which has checked that the file holds its data.
    pub(crate) fn open(path: &Path, hdu: &Hdu) -> Result<Self, IoError> {
        tiles::check(hdu)?;
        let mut fits = Fits::open(hdu.source())?;
        fits.move_to(hdu.index)?;
        Ok(Self {
            fits,
            path: path.to_owned(),
            hdu: hdu.index,
            shape: hdu.shape(),
            // For floats CFITSIO must not look for undefined values: it would flush subnormal numbers to zero. But in compressed
            // images NaN may be a number that only CFITSIO knows, and would else return as if it were a value.
            blank: hdu.is_tiled() || (hdu.bitpix > 0 && hdu.header.get("BLANK").is_some()),
        })
    }

    /// Reads pixels from number `first` (0-based, rows one after the other) on, BSCALE and BZERO applied; false when one is not
    /// finite, for which [`defect`](Self::defect) then has the error.
    pub(crate) fn load<T: Real>(&mut self, first: usize, pixels: &mut [T]) -> Result<bool, IoError> {
        self.fits.read_pixels(first, pixels, self.blank)?;
        let clean = |chunk: &[T]| chunk.iter().fold(true, |clean, value| clean & value.is_finite());
        Ok(pixels.chunks(CHUNK).all(clean))
    }

    /// What is wrong with pixels that are not all finite in the type asked for.
    pub(crate) fn defect(&mut self, first: usize, count: usize) -> IoError {
        match self.non_finite(first, count) {
            Ok(Some((flat, value, count))) => IoError::NonFinitePixels {
                path: self.path.clone(),
                hdu: self.hdu,
                index: self.index(flat),
                value,
                count,
            },
            // What is infinite in single precision may be a number in the file.
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

/// Reads all pixels of an image HDU, BSCALE and BZERO applied, and refuses NaN, infinities and BLANK.
///
/// The HDU comes from a [`FitsStructure`](crate::structure::FitsStructure), which has checked that the file holds its data:
/// memory is bounded by the length of the file.
pub(crate) fn read_pixels<T: Real>(path: &Path, hdu: &Hdu) -> Result<Vec<T>, IoError> {
    // Opening checks tiles, before memory is taken for what they claim to hold.
    let mut pixels = Pixels::open(path, hdu)?;
    let mut values = vec![T::zero(); hdu.axes.iter().product()];
    if pixels.load(0, &mut values)? {
        Ok(values)
    } else {
        Err(pixels.defect(0, values.len()))
    }
}
