//! Pixels of an image HDU, read straight into the type wanted.

use std::path::Path;

use psf_types::Real;

use crate::IoError;
use crate::cfitsio::Fits;
use crate::hdu::Hdu;

/// Values looked at together in the search for NaN, few enough to stay in cache.
const CHUNK: usize = 4096;

/// Reads all pixels of an image HDU, BSCALE and BZERO applied, and refuses NaN, infinities and BLANK.
///
/// The HDU comes from a [`FitsStructure`](crate::structure::FitsStructure), which has checked that the file holds its data:
/// memory is bounded by the length of the file.
pub(crate) fn read_pixels<T: Real>(path: &Path, hdu: &Hdu) -> Result<Vec<T>, IoError> {
    let pixels: Vec<T> = read_unchecked(path, hdu)?;
    if let Err(error) = check_finite(path, hdu, &pixels) {
        // What is infinite in single precision may be a number in the file.
        check_finite::<f64>(path, hdu, &read_unchecked(path, hdu)?)?;
        return Err(match error {
            IoError::NonFinitePixels { path, .. } => IoError::Overflow { path },
            other => other,
        });
    }
    Ok(pixels)
}

fn read_unchecked<T: Real>(path: &Path, hdu: &Hdu) -> Result<Vec<T>, IoError> {
    let mut pixels = vec![T::zero(); hdu.axes.iter().product()];
    let mut fits = Fits::open(path)?;
    fits.move_to(hdu.index)?;
    // For floats CFITSIO must not look for undefined values: it would flush subnormal numbers to zero.
    let blank = hdu.bitpix > 0 && hdu.header.get("BLANK").is_some();
    fits.read_pixels(&mut pixels, blank)?;
    Ok(pixels)
}

fn check_finite<T: Real>(path: &Path, hdu: &Hdu, pixels: &[T]) -> Result<(), IoError> {
    let clean = |chunk: &[T]| chunk.iter().fold(true, |clean, value| clean & value.is_finite());
    if pixels.chunks(CHUNK).all(clean) {
        return Ok(());
    }
    let bad = || pixels.iter().enumerate().filter(|(_, value)| !value.is_finite());
    let shape = hdu.shape();
    let (mut flat, value) = bad().next().expect("one was found");
    let mut index = vec![0; shape.len()];
    for (place, &n) in index.iter_mut().zip(&shape).rev() {
        *place = flat % n;
        flat /= n;
    }
    Err(IoError::NonFinitePixels {
        path: path.to_owned(),
        hdu: hdu.index,
        index,
        value: value.as_f64(),
        count: bad().count(),
    })
}
