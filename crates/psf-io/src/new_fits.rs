//! A FITS file that is being written.

use std::path::Path;

use psf_types::Real;

use crate::cfitsio::Fits;
use crate::pending_file::{PendingFile, write_failed};
use crate::{Card, HeaderCards, IoError};

/// A FITS file under a temporary name: [`finish`](Self::finish) gives it its own, dropping it removes it.
#[derive(Debug)]
pub(crate) struct NewFits {
    // Closed before it is removed: fields are dropped in this order.
    fits: Fits,
    file: PendingFile,
}

impl NewFits {
    pub(crate) fn create(path: &Path, overwrite: bool) -> Result<Self, IoError> {
        let (file, fits) = PendingFile::create_with(path, overwrite, |temporary| {
            // CFITSIO creates the file itself.
            std::fs::remove_file(temporary).map_err(|source| write_failed(path, source))?;
            Fits::create(temporary, path)
        })?;
        Ok(Self { fits, file })
    }

    pub(crate) fn fits(&mut self) -> &mut Fits {
        &mut self.fits
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
    write(file.fits())?;
    file.finish()
}

/// Adds the header of an image HDU, ahead of the pixels, so that CFITSIO need not move them.
pub(crate) fn write_image_header<T: Real>(
    fits: &mut Fits,
    shape: &[usize],
    cards: &HeaderCards,
) -> Result<(), IoError> {
    fits.create_image::<T>(shape)?;
    cards
        .iter()
        .flat_map(Card::records)
        .try_for_each(|record| fits.write_record(record))
}

/// Adds an image HDU with all its pixels.
pub(crate) fn write_image_hdu<T: Real>(
    fits: &mut Fits,
    shape: &[usize],
    pixels: &[T],
    cards: &HeaderCards,
) -> Result<(), IoError> {
    write_image_header::<T>(fits, shape, cards)?;
    fits.write_pixels(0, pixels)
}
