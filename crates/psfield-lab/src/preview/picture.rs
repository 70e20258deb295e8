//! Turns an image into a picture: brightness, colours, PNG.

use std::io::Cursor;

use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, Pixel, Rgb};
use ndarray::ArrayView2;
use psf_types::named;

use crate::preview::{Limits, PreviewError};

/// The largest number of pixels along an axis. A square grey picture of this size takes 1 GB of
/// memory.
const LARGEST: usize = 32_768;

/// A picture of 8 bits per channel, with row 0 of the image at the bottom. It has one grey channel
/// if the colour map is grey and every pixel is finite, else red, green and blue.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture(DynamicImage);

impl Picture {
    /// Makes the picture of an image `[y, x]`. The colour of a pixel is
    /// `colormap(stretch(limits(value)))`. Pixels that are NaN or infinite get the
    /// [`undefined_colour`](Colormap::undefined_colour) of the colour map.
    ///
    /// # Errors
    /// [`PreviewError::Size`] for an image that is empty or has more than 32768 pixels along an
    /// axis.
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
        let colour = |value: f64| {
            if value.is_finite() {
                colormap.colour(stretch.brightness(limits.fraction(value)))
            } else {
                colormap.undefined_colour()
            }
        };
        let grey = colormap == Colormap::Grey && image.iter().all(|value| value.is_finite());
        Ok(if grey {
            Self(pixels(image, |value| Luma([colour(value)[0]])).into())
        } else {
            Self::coloured(image, colour)
        })
    }

    /// Makes the picture of an image `[y, x]` that is not empty, with a colour for each value.
    pub(crate) fn coloured(image: ArrayView2<'_, f64>, colour: impl Fn(f64) -> [u8; 3]) -> Self {
        Self(pixels(image, |value| Rgb(colour(value))).into())
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.0.width() as usize
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.0.height() as usize
    }

    /// Returns the bytes of a PNG file. Equal pictures give equal bytes.
    pub fn png(&self) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        self.0
            .write_to(&mut bytes, ImageFormat::Png)
            .expect("pictures of 8 bits and a checked size can be written to memory");
        bytes.into_inner()
    }
}

/// The pixels of a picture, with the last row of the image at the top.
fn pixels<P: Pixel<Subpixel = u8>>(
    image: ArrayView2<'_, f64>,
    colour: impl Fn(f64) -> P,
) -> ImageBuffer<P, Vec<u8>> {
    let (ny, nx) = image.dim();
    ImageBuffer::from_fn(nx as u32, ny as u32, |x, row| {
        colour(image[[ny - 1 - row as usize, x as usize]])
    })
}

/// The formula that turns a value into a brightness from 0 to 1, as in `astropy.visualization` by
/// default. `x` is the position of the value between the limits, from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stretch {
    /// `x`.
    Linear,
    /// `sqrt(x)`.
    Sqrt,
    /// `ln(1000 x + 1) / ln(1001)`.
    Log,
    /// `asinh(10 x) / asinh(10)`: linear below a tenth of the range, logarithmic above.
    Asinh,
}

impl Stretch {
    /// The brightness (0 to 1) at a fraction (0 to 1) of the range between the limits. NaN stays
    /// NaN.
    pub fn brightness(self, fraction: f64) -> f64 {
        const LOG: f64 = 1000.0;
        const ASINH: f64 = 0.1;
        match self {
            Self::Linear => fraction,
            Self::Sqrt => fraction.sqrt(),
            Self::Log => (LOG * fraction).ln_1p() / LOG.ln_1p(),
            Self::Asinh => (fraction / ASINH).asinh() / ASINH.recip().asinh(),
        }
    }
}

named!(
    Stretch, PreviewError, |text| refused("linear, sqrt, log or asinh", text),
    "linear" => Linear, "sqrt" => Sqrt, "log" => Log, "asinh" => Asinh
);

/// Grey, and five colour maps of matplotlib. The lightness of every map increases all the way from
/// dark to bright, so that colour-blind readers can tell the colours apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Colormap {
    /// Black to white.
    Grey,
    /// Violet, green, yellow.
    Viridis,
    /// Blue, grey, yellow. It looks almost the same to colour-blind readers and to others.
    Cividis,
    /// Black, red, pale yellow.
    Inferno,
    /// Black, pink, pale yellow.
    Magma,
    /// Blue, pink, yellow.
    Plasma,
}

impl Colormap {
    /// Red, green and blue of a brightness from 0 to 1. NaN gets the
    /// [`undefined_colour`](Self::undefined_colour).
    pub fn colour(self, brightness: f64) -> [u8; 3] {
        let gradient = match self {
            _ if brightness.is_nan() => return self.undefined_colour(),
            Self::Grey => return [(255.0 * brightness).round() as u8; 3],
            Self::Viridis => colorous::VIRIDIS,
            Self::Cividis => colorous::CIVIDIS,
            Self::Inferno => colorous::INFERNO,
            Self::Magma => colorous::MAGMA,
            Self::Plasma => colorous::PLASMA,
        };
        gradient.eval_continuous(brightness.clamp(0.0, 1.0)).into_array()
    }

    /// The colour of pixels that are NaN or infinite: magenta if no colour of the map is similar to
    /// magenta, else cyan.
    pub fn undefined_colour(self) -> [u8; 3] {
        match self {
            Self::Grey | Self::Viridis | Self::Cividis => [255, 0, 255],
            Self::Inferno | Self::Magma | Self::Plasma => [0, 255, 255],
        }
    }
}

named!(
    Colormap, PreviewError, |text| refused("grey, viridis, cividis, inferno, magma or plasma", text),
    "grey" => Grey, "viridis" => Viridis, "cividis" => Cividis, "inferno" => Inferno, "magma" => Magma,
    "plasma" => Plasma
);

fn refused(known: &str, got: &str) -> PreviewError {
    PreviewError::Setting(format!("{got:?} is not {known}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    fn shown(image: ArrayView2<'_, f64>, colormap: Colormap) -> Picture {
        Picture::new(image, Limits::new(0.0, 10.0).unwrap(), Stretch::Linear, colormap).unwrap()
    }

    #[test]
    fn row_0_is_at_the_bottom() {
        let picture = shown(
            array![[0.0, 10.0], [5.0, -3.0], [99.0, 2.0]].view(),
            Colormap::Grey,
        );
        let png = image::load_from_memory(&picture.png()).unwrap();
        assert_eq!(png.as_luma8().unwrap().as_raw(), &[255, 51, 128, 0, 0, 255]);
    }

    #[test]
    fn what_has_no_value_is_not_zero() {
        let picture = shown(
            array![[0.0, f64::NAN, f64::NEG_INFINITY, f64::INFINITY]].view(),
            Colormap::Grey,
        );
        let png = image::load_from_memory(&picture.png()).unwrap().into_rgb8();
        let marked = Colormap::Grey.undefined_colour();
        let colours: Vec<[u8; 3]> = png.pixels().map(|pixel| pixel.0).collect();
        assert_eq!(colours, [[0; 3], marked, marked, marked]);
    }

    #[test]
    fn pictures_have_pixels() {
        let empty = ndarray::Array2::zeros((0, 3));
        let limits = Limits::new(0.0, 1.0).unwrap();
        let refused = Picture::new(empty.view(), limits, Stretch::Sqrt, Colormap::Magma);
        assert!(matches!(refused, Err(PreviewError::Size { nx: 3, ny: 0, .. })));
    }

    /// Brightness is compared with reference values of 12 digits.
    const DIGITS: f64 = 1e-11;

    // From astropy 8.0.2:
    // ```python
    // from astropy.visualization import *
    // x = np.array([0.0, 0.01, 0.3, 1.0])
    // for s in LinearStretch(), SqrtStretch(), LogStretch(), AsinhStretch(): print(s(x))
    // ```
    #[test]
    fn stretches_are_those_of_astropy() {
        for (stretch, expected) in [
            (Stretch::Linear, [0.0, 0.01, 0.3, 1.0]),
            (Stretch::Sqrt, [0.0, 0.1, 0.547_722_557_505, 1.0]),
            (Stretch::Log, [0.0, 0.347_080_675_085, 0.826_069_305_837, 1.0]),
            (Stretch::Asinh, [0.0, 0.033_297_750_218_8, 0.606_508_084_748, 1.0]),
        ] {
            let got = [0.0, 0.01, 0.3, 1.0].map(|x| stretch.brightness(x));
            let near = got
                .iter()
                .zip(&expected)
                .all(|(a, b): (&f64, &f64)| (a - b).abs() <= DIGITS);
            assert!(near, "{stretch:?}: {got:?}");
            assert_eq!(stretch.to_string().parse(), Ok(stretch));
        }
        assert!(Stretch::Log.brightness(f64::NAN).is_nan());
        assert!("power".parse::<Stretch>().is_err());
    }

    const MAPS: [Colormap; 6] = [
        Colormap::Grey,
        Colormap::Viridis,
        Colormap::Cividis,
        Colormap::Inferno,
        Colormap::Magma,
        Colormap::Plasma,
    ];

    /// Colours closer than this distance in red, green and blue could be confused. Two greys at
    /// this distance differ by 27 % of the range from black to white.
    const MIN_COLOUR_DISTANCE: f64 = 120.0;

    fn distance(a: [u8; 3], b: [u8; 3]) -> f64 {
        let squares = a
            .iter()
            .zip(b)
            .map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2));
        squares.sum::<f64>().sqrt()
    }

    #[test]
    fn pixels_without_a_value_stand_out() {
        for map in MAPS {
            let nearest = (0..=255)
                .map(|level| distance(map.colour(f64::from(level) / 255.0), map.undefined_colour()))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest > MIN_COLOUR_DISTANCE, "{map:?}: {nearest}");
            assert_eq!(map.colour(f64::NAN), map.undefined_colour());
            assert_eq!(map.to_string().parse(), Ok(map));
        }
        assert!("jet".parse::<Colormap>().is_err());
    }

    #[test]
    fn lightness_grows_all_along() {
        // Luma of Rec. 709 on linear light.
        let lightness = |[r, g, b]: [u8; 3]| {
            let linear = |c: u8| (f64::from(c) / 255.0).powf(2.2);
            0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b)
        };
        for map in MAPS {
            let steps: Vec<f64> = (0..=16)
                .map(|n| lightness(map.colour(f64::from(n) / 16.0)))
                .collect();
            assert!(steps.is_sorted_by(|a, b| a < b), "{map:?}: {steps:?}");
        }
    }

    // matplotlib.colormaps["viridis"](x, bytes=True) at x = 0 and 1.
    #[test]
    fn viridis_is_matplotlibs() {
        assert_eq!(Colormap::Viridis.colour(0.0), [68, 1, 84]);
        assert_eq!(Colormap::Viridis.colour(1.0), [253, 231, 37]);
    }
}
