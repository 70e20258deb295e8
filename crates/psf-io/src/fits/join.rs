//! Joins images to one file with an extension for each.

use std::path::{Path, PathBuf};

use crate::error::{IoError, IoErrorKind, bad_card};
use crate::fits::card::Card;
use crate::fits::cfitsio::Fits;
use crate::fits::hdu::FitsSource;
use crate::fits::header_cards::HeaderCards;
use crate::fits::image_out::{write_cards, write_fits};

/// Writes a FITS file whose primary HDU has `cards` and no pixels, and whose extensions are the primary images of
/// files, with their headers. Each extension has a name (`EXTNAME`). The file appears complete or not at all.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let at = |name: &str| directory.path().join(name);
/// use psf_io::{HeaderCards, join_images, read_image_hdu, write_image};
/// use psf_types::{FrameShape, Image};
/// let image = Image::<f32>::zeros(FrameShape::new(30, 20)?);
/// write_image(at("a.fits"), &image, &HeaderCards::new(), &[], false)?;
/// join_images(at("all.fits"), &[("A", at("a.fits")), ("B", at("a.fits"))], &[], false)?;
/// let second = read_image_hdu::<f32>(at("all.fits"), Some(&"B".parse()?))?;
/// assert_eq!(second.image(), &image);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoErrorKind::NotFound`] and the other errors of files for an image that cannot be read, and the errors of
/// [`write_image`](crate::write_image).
pub fn join_images(
    path: impl AsRef<Path>,
    images: &[(&str, PathBuf)],
    cards: &[Card],
    overwrite: bool,
) -> Result<(), IoError> {
    let path = path.as_ref();
    if images.is_empty() {
        return Err(IoError::new(
            path,
            IoErrorKind::Request,
            "there is no image to join",
        ));
    }
    write_fits(path, overwrite, |fits| {
        fits.create_image(&[], 8)?;
        write_cards(fits, &HeaderCards::new().with(cards))?;
        for (name, image) in images {
            let name = Card::new("EXTNAME", *name, "name of this extension").map_err(bad_card(path))?;
            let mut from = Fits::open(&FitsSource::new(image, None))?;
            fits.copy_hdu(&mut from)?;
            fits.write_card(&name)?;
        }
        Ok(())
    })
}
