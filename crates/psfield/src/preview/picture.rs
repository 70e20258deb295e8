//! An image as a picture.

use std::io::Cursor;

use image::{DynamicImage, GrayImage, ImageFormat, Luma, Rgb, RgbImage};
use ndarray::ArrayView2;

use super::{Colormap, Limits, PreviewError, Stretch};

/// The most pixels along an axis: those of a picture of 1 GB in grey.
const LARGEST: usize = 32_768;

/// A picture of 8 bits a channel, with row 0 of the image at the bottom. It is grey where the colour map is and every pixel has a value,
/// else in colours.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture(DynamicImage);

impl Picture {
    /// The picture of an image `[y, x]`: `colormap(stretch(limits(value)))` of each pixel. NaN and infinities have no value and get the
    /// colour map's [`undefined_colour`](Colormap::undefined_colour).
    ///
    /// # Errors
    /// [`PreviewError::Size`] for an image without pixels or of more than 32768 along an axis.
    pub fn new(
        image: ArrayView2<'_, f64>,
        limits: Limits,
        stretch: Stretch,
        colormap: Colormap,
    ) -> Result<Self, PreviewError> {
        let (ny, nx) = image.dim();
        if ![nx, ny].iter().all(|n| (1..=LARGEST).contains(n)) {
            return Err(PreviewError::Size {
                nx,
                ny,
                limit: LARGEST,
            });
        }
        let colour = |x: u32, row: u32| {
            let value = image[[ny - 1 - row as usize, x as usize]];
            if value.is_finite() {
                colormap.colour(stretch.brightness(limits.fraction(value)))
            } else {
                colormap.undefined_colour()
            }
        };
        let (width, height) = (nx as u32, ny as u32);
        let grey = colormap == Colormap::Grey && image.iter().all(|value| value.is_finite());
        Ok(Self(if grey {
            GrayImage::from_fn(width, height, |x, row| Luma([colour(x, row)[0]])).into()
        } else {
            RgbImage::from_fn(width, height, |x, row| Rgb(colour(x, row))).into()
        }))
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.0.width() as usize
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.0.height() as usize
    }

    /// Whether it has a grey channel alone.
    pub fn is_grey(&self) -> bool {
        self.0.as_luma8().is_some()
    }

    /// Red, green and blue of the pixel that shows `[y, x]` of the image; none outside.
    pub fn colour_at(&self, [y, x]: [usize; 2]) -> Option<[u8; 3]> {
        let row = self.height().checked_sub(1 + y)?;
        match &self.0 {
            DynamicImage::ImageLuma8(grey) => Some([grey.get_pixel_checked(x as u32, row as u32)?[0]; 3]),
            DynamicImage::ImageRgb8(colours) => Some(colours.get_pixel_checked(x as u32, row as u32)?.0),
            _ => None,
        }
    }

    /// The bytes of a PNG file. The same picture gives the same bytes.
    pub fn png(&self) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        self.0
            .write_to(&mut bytes, ImageFormat::Png)
            .expect("pictures of 8 bits and a checked size can be written to memory");
        bytes.into_inner()
    }
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;

    fn shown(image: ArrayView2<'_, f64>, colormap: Colormap) -> Picture {
        Picture::new(image, Limits::new(0.0, 10.0).unwrap(), Stretch::Linear, colormap).unwrap()
    }

    #[test]
    fn row_0_is_at_the_bottom() {
        let picture = shown(
            array![[0.0, 10.0], [5.0, -3.0], [99.0, 2.0]].view(),
            Colormap::Grey,
        );
        assert!(picture.is_grey());
        let png = image::load_from_memory(&picture.png()).unwrap();
        assert_eq!(png.as_luma8().unwrap().as_raw(), &[255, 51, 128, 0, 0, 255]);
        assert_eq!(picture.colour_at([2, 1]), Some([51; 3]));
        assert_eq!(
            (picture.colour_at([3, 0]), picture.colour_at([0, 2])),
            (None, None)
        );
    }

    #[test]
    fn what_has_no_value_is_not_zero() {
        let picture = shown(
            array![[0.0, f64::NAN, f64::NEG_INFINITY, f64::INFINITY]].view(),
            Colormap::Grey,
        );
        let marked = Colormap::Grey.undefined_colour();
        assert_eq!(picture.colour_at([0, 0]), Some([0; 3]));
        for x in 1..4 {
            assert_eq!(picture.colour_at([0, x]), Some(marked));
        }
        let png = image::load_from_memory(&picture.png()).unwrap();
        assert_eq!(png.as_rgb8().unwrap().get_pixel(1, 0).0, marked);
    }

    #[test]
    fn pictures_have_pixels() {
        let empty = ndarray::Array2::zeros((0, 3));
        let limits = Limits::new(0.0, 1.0).unwrap();
        let refused = Picture::new(empty.view(), limits, Stretch::Sqrt, Colormap::Magma);
        assert!(matches!(refused, Err(PreviewError::Size { nx: 3, ny: 0, .. })));
    }
}
