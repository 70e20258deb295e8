//! Changes the pixels of an image, and nothing else of its file.

use std::fs::File;
use std::path::Path;

use crate::error::{IoError, IoErrorKind, unreadable, unwritable};
use crate::fits::card::Card;
use crate::fits::cfitsio::Fits;
use crate::fits::hdu::{Hdu, HduChoice};
use crate::fits::structure::FitsStructure;
use crate::output::PendingFile;

/// A row of an image as it is stored: numbers whose values are `zero + scale * number`.
#[derive(Debug)]
pub struct StoredRow<'a> {
    /// The row, counted from 0.
    pub y: usize,
    /// The numbers. An undefined pixel is NaN and stays as it is.
    pub numbers: &'a mut [f64],
    /// `BSCALE` and `BZERO`.
    pub scaling: (f64, f64),
    /// The lowest and the highest whole number that can be stored. `None` for floating-point numbers.
    pub whole: Option<(f64, f64)>,
}

/// Copies a FITS file and changes pixels of one of its images. All other bytes stay, such as other extensions and header
/// cards, except that `history` is added, and that checksums of the image are renewed if it has them. An image
/// that is compressed in tiles becomes an uncompressed one with the same values.
///
/// `change` sees each row in turn, and returns whether it has changed. Only those rows are written. Whole numbers stay
/// whole: it must leave numbers of this kind.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let at = |name: &str| directory.path().join(name);
/// use ndarray::array;
/// use psf_io::{HeaderCards, IntegerKind, edit_image, read_image, write_integers};
/// let counts = array![[1, 2], [3, 4]];
/// write_integers(at("raw.fits"), counts.view(), IntegerKind::Unsigned16, &HeaderCards::new(), &[], false)?;
/// edit_image(at("raw.fits"), None, at("new.fits"), "one more", false, |row| {
///     row.numbers[0] += 1.0;
///     Ok(row.y == 1)
/// })?;
/// assert_eq!(read_image::<f64>(at("new.fits"))?.image().pixels(), array![[1.0, 2.0], [4.0, 4.0]]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoErrorKind::Setting`] if a choice is needed or wrong, [`IoErrorKind::Request`] for whole numbers of 64 bits,
/// [`IoErrorKind::Data`] for an image that is not `[y, x]`, the
/// [errors of any FITS file](crate#bad-files), those of [`check_output`](crate::check_output), and any error of `change`.
pub fn edit_image(
    input: impl AsRef<Path>,
    choice: Option<&HduChoice>,
    output: impl AsRef<Path>,
    history: &str,
    overwrite: bool,
    mut change: impl FnMut(StoredRow<'_>) -> Result<bool, IoError>,
) -> Result<(), IoError> {
    let (input, output) = (input.as_ref(), output.as_ref());
    let structure = FitsStructure::scan(input)?;
    let hdu = structure.image(choice)?;
    let [ny, nx] = crate::fits::image::squeezed(hdu)[..] else {
        return Err(hdu.axes_error("a two-dimensional image"));
    };
    let bitpix = if hdu.is_tiled() {
        hdu.value("ZBITPIX").unwrap_or(hdu.bitpix)
    } else {
        hdu.bitpix
    };
    if bitpix == 64 {
        const WHOLE: &str =
            "images of 64-bit whole numbers cannot be changed exactly: store the image with 32 bits";
        return Err(hdu.error(IoErrorKind::Request, WHOLE));
    }
    let (file, index) = PendingFile::create(output, overwrite, |temporary| {
        if hdu.is_tiled() {
            std::fs::remove_file(temporary).map_err(unwritable(output))?;
            return with_uncompressed(&structure, hdu, temporary, output);
        }
        // Not `fs::copy`: the copy of a read-only file could not be changed.
        let mut from = File::open(hdu.source.file()).map_err(unreadable(input))?;
        let to = File::options().write(true).open(temporary);
        let copied = to.and_then(|mut to| std::io::copy(&mut from, &mut to));
        copied.map(|_| hdu.index).map_err(unwritable(output))
    })?;
    let number = |keyword: &str, default: f64| hdu.value::<f64>(keyword).unwrap_or(default);
    let scaling = (number("BSCALE", 1.0), number("BZERO", 0.0));
    let whole = match bitpix {
        8 => Some((0.0, 255.0)),
        bits @ (16 | 32) => Some((
            -(2.0_f64.powi(bits as i32 - 1)),
            2.0_f64.powi(bits as i32 - 1) - 1.0,
        )),
        _ => None,
    };
    let of_tiles: Option<f64> = hdu.is_tiled().then(|| hdu.value("ZBLANK")).flatten();
    let blank = of_tiles.or(hdu.value("BLANK")).filter(|_| whole.is_some());
    let mut fits = Fits::open_to_change(file.temporary(), output)?;
    fits.move_to(index)?;
    // Before the pixels, which cards that are added may move.
    fits.write_card(&Card::history(history))?;
    fits.set_scaling((1.0, 0.0))?;
    let mut numbers = vec![0.0; nx];
    for y in 0..ny {
        fits.read_pixels(y * nx, &mut numbers, false)?;
        let is_blank = |value: f64| Some(value) == blank;
        let before = numbers.clone();
        for value in &mut numbers {
            if is_blank(*value) {
                *value = f64::NAN;
            }
        }
        let row = StoredRow {
            y,
            numbers: &mut numbers,
            scaling,
            whole,
        };
        if change(row)? {
            for (value, &before) in numbers.iter_mut().zip(&before) {
                if !value.is_finite() {
                    *value = before;
                } else if is_blank(*value) {
                    // A defined pixel stays defined.
                    let lowest = whole.is_some_and(|(lowest, _)| *value == lowest);
                    *value += if lowest { 1.0 } else { -1.0 };
                }
            }
            fits.write_pixels(y * nx, &numbers)?;
        }
    }
    if ["CHECKSUM", "DATASUM"]
        .iter()
        .any(|keyword| hdu.header.get(keyword).is_some())
    {
        fits.renew_checksum()?;
    }
    fits.close()?;
    file.commit()
}

/// Copies a file, with one image uncompressed. Returns the place of that image.
fn with_uncompressed(
    structure: &FitsStructure,
    image: &Hdu,
    temporary: &Path,
    path: &Path,
) -> Result<usize, IoError> {
    let mut place = image.index;
    let mut from = Fits::open(&image.source)?;
    let mut to = Fits::create(temporary, path)?;
    for index in 0..structure.hdus.len() {
        from.move_to(index)?;
        if index == image.index {
            to.copy_uncompressed(&mut from)?;
            // An image that was compressed out of a primary HDU becomes the primary HDU again.
            place = to.current();
        } else {
            to.copy_hdu(&mut from)?;
        }
    }
    let closed = to.close().map_err(|error| match error.kind() {
        IoErrorKind::Write => error,
        _ => IoError::new(path, IoErrorKind::Write, "the image cannot be uncompressed").because(error),
    });
    closed.map(|()| place)
}
