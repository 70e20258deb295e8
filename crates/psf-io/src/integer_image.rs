//! Images of whole numbers: digitised counts, masks.

use std::path::Path;

use ndarray::ArrayView2;
use psf_types::FrameShape;

use crate::card::Card;
use crate::error::invalid;
use crate::new_fits::NewFits;
use crate::{HeaderCards, IoError};

/// How whole numbers are stored.
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
    /// The smallest kind for the counts of a converter of so many bits, 31 at most.
    pub fn of_bits(bits: u32) -> Self {
        match bits {
            0..=8 => Self::Unsigned8,
            9..=16 => Self::Unsigned16,
            _ => Self::Signed32,
        }
    }

    /// The lowest and the highest number it holds.
    pub fn range(self) -> (i32, i32) {
        match self {
            Self::Unsigned8 => (0, i32::from(u8::MAX)),
            Self::Unsigned16 => (0, i32::from(u16::MAX)),
            Self::Signed32 => (i32::MIN, i32::MAX),
        }
    }
}

/// Writes an image `[y, x]` of whole numbers, held in any type.
///
/// Cards and file are as [`write_image`](crate::write_image) has them.
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
/// [`IoError::NotWhole`] for the first value that is no whole number in the kind's range, else as
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
    let fits = file.fits();
    fits.create_integer_image(&[shape.ny(), shape.nx()], kind)?;
    cards
        .iter()
        .flat_map(Card::records)
        .try_for_each(|record| fits.write_record(record))?;
    let (lowest, highest) = kind.range();
    let mut row = Vec::with_capacity(nx);
    for (y, values) in pixels.outer_iter().enumerate() {
        row.clear();
        for (x, &value) in values.iter().enumerate() {
            let value: f64 = value.into();
            if !(f64::from(lowest)..=f64::from(highest)).contains(&value) || value.fract() != 0.0 {
                return Err(IoError::NotWhole {
                    path: path.to_owned(),
                    index: [y, x],
                    value,
                    lowest,
                    highest,
                });
            }
            row.push(value as i32);
        }
        fits.write_integers(y * nx, &row)?;
    }
    file.finish()
}
