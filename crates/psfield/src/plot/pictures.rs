//! Images side by side, each with its colours explained.

use std::ops::Range;

use image::{Rgb, RgbImage};
use ndarray::ArrayView2;
use plotters::chart::ChartBuilder;

use super::axes::{LABEL_ROOM_X, LABEL_ROOM_Y, MARGIN, draw_axes, title_room, under_title};
use super::colour_bar::{BAR_AREA, ColourBar};
use super::colours::ColourMap;
use super::figure::{Area, Figure, Overlay, PlotError};
use super::ticks;

/// Which value gets which colour. Pictures that are compared get the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// Grey from 0 to `high`: linear below `soft`, logarithmic above (`asinh(v / soft)`).
    Asinh {
        /// Where the logarithm begins.
        soft: f64,
        /// White.
        high: f64,
    },
    /// Blue, white, red from `-most` to `most`.
    Difference {
        /// The darkest colours.
        most: f64,
    },
}

impl Scale {
    fn colours(self) -> ColourMap {
        match self {
            Self::Asinh { .. } => ColourMap::Grey,
            Self::Difference { .. } => ColourMap::BlueWhiteRed,
        }
    }

    /// Where a value is drawn on the bar.
    fn along(self, value: f64) -> f64 {
        match self {
            Self::Asinh { soft, .. } => (value / soft).asinh(),
            Self::Difference { .. } => value,
        }
    }

    fn range(self) -> (f64, f64) {
        match self {
            Self::Asinh { high, .. } => (0.0, high),
            Self::Difference { most } => (-most, most),
        }
    }

    fn ticks(self) -> Vec<f64> {
        match self {
            Self::Asinh { soft, high } => ticks::asinh(soft, high),
            Self::Difference { most } => ticks::even(-most, most),
        }
    }

    fn colour(self, value: f64) -> [u8; 3] {
        let (low, high) = (self.along(self.range().0), self.along(self.range().1));
        let part = (self.along(value) - low) / (high - low).max(f64::MIN_POSITIVE);
        self.colours().at(part)
    }
}

/// What the axes of a picture count.
#[derive(Debug, Clone, PartialEq)]
pub enum PictureAxes<'a> {
    /// Pixels of the image.
    Pixels,
    /// Something else: name, with the unit, and the values at the outer edges of the first and the last pixel; x, then y.
    Of([(&'a str, Range<f64>); 2]),
}

/// An image with a heading.
#[derive(Debug, Clone)]
pub struct Picture<'a> {
    /// The heading.
    pub title: &'a str,
    /// The image `[y, x]`.
    pub pixels: ArrayView2<'a, f64>,
    /// Its colours.
    pub scale: Scale,
    /// What the colours mean, with the unit.
    pub quantity: &'a str,
    /// What its axes count.
    pub axes: PictureAxes<'a>,
}

/// Width of a picture that stands alone: in a PNG, an image of 1024 columns has a pixel of the picture for each of its own.
const ALONE: u32 = 512;
/// Width of each of several.
const BESIDE: u32 = 298;
/// What stands about a picture, across.
const ABOUT: u32 = LABEL_ROOM_Y + 2 * MARGIN + BAR_AREA;

/// Draws pictures, two in a row. Row 0 is at the bottom, as FITS viewers show it.
///
/// # Errors
/// [`PlotError`] when the drawing fails.
pub fn pictures(pictures: &[Picture<'_>]) -> Result<Figure, PlotError> {
    let across = pictures.len().clamp(1, 2);
    let down = pictures.len().div_ceil(across).max(1);
    let plot = if pictures.len() > 1 { BESIDE } else { ALONE };
    let aspect = pictures
        .iter()
        .map(|p| p.pixels.nrows() as f64 / p.pixels.ncols().max(1) as f64)
        .fold(0.3, f64::max)
        .min(2.0);
    let head = pictures.iter().map(|p| title_room(p.title)).max().unwrap_or(0);
    let height = head + (f64::from(plot) * aspect).round() as u32 + LABEL_ROOM_X + 2 * MARGIN;
    let width = plot + ABOUT;
    Figure::draw((across as u32 * width, down as u32 * height), |root| {
        let mut overlays = Vec::new();
        for (picture, area) in pictures.iter().zip(root.split_evenly((down, across))) {
            let (left, right) = area.split_horizontally(width - BAR_AREA);
            let (_, right) = right.split_vertically(title_room(picture.title));
            overlays.push(picture.draw(&under_title(&left, picture.title)?)?);
            let bar = ColourBar {
                map: picture.scale.colours(),
                range: picture.scale.range(),
                ticks: picture.scale.ticks(),
                along: &|value| picture.scale.along(value),
                name: picture.quantity,
            };
            overlays.push(bar.draw(&right)?);
        }
        Ok(overlays)
    })
}

impl Picture<'_> {
    fn draw(&self, area: &Area<'_>) -> Result<Overlay, PlotError> {
        let (ny, nx) = self.pixels.dim();
        let [(x_name, x), (y_name, y)] = match &self.axes {
            PictureAxes::Pixels => [
                ("x, pixels", -0.5..nx as f64 - 0.5),
                ("y, pixels", -0.5..ny as f64 - 0.5),
            ],
            PictureAxes::Of(axes) => axes.clone(),
        };
        let mut chart = ChartBuilder::on(area)
            .margin(MARGIN)
            .x_label_area_size(LABEL_ROOM_X)
            .y_label_area_size(LABEL_ROOM_Y)
            .build_cartesian_2d(x, y)?;
        draw_axes(&mut chart, x_name, y_name)?;
        let (px, py) = chart.plotting_area().get_pixel_range();
        Ok(Overlay {
            left: px.start,
            top: py.start,
            width: (px.end - px.start) as u32,
            height: (py.end - py.start) as u32,
            pixels: RgbImage::from_fn(nx as u32, ny as u32, |x, row| {
                Rgb(self
                    .scale
                    .colour(self.pixels[[ny - 1 - row as usize, x as usize]]))
            }),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn every_picture_has_its_colours_and_its_bar() {
        let image = array![[0.0, 1.0], [2.0, 3.0]];
        let picture = |title, scale| Picture {
            title,
            pixels: image.view(),
            scale,
            quantity: "counts",
            axes: PictureAxes::Pixels,
        };
        let figure = pictures(&[
            picture("sky", Scale::Asinh { soft: 0.1, high: 3.0 }),
            picture("difference", Scale::Difference { most: 3.0 }),
        ])
        .unwrap();
        assert_eq!(figure.svg().matches("<image").count(), 4);
        assert!(figure.svg().contains("sky") && figure.svg().contains("difference"));
    }

    #[test]
    fn one_picture_alone_shows_every_pixel_of_1024() {
        let image = ndarray::Array2::from_elem((512, 1024), 1.0);
        let figure = pictures(&[Picture {
            title: "two rows\nof heading",
            pixels: image.view(),
            scale: Scale::Asinh { soft: 0.1, high: 3.0 },
            quantity: "counts",
            axes: PictureAxes::Of([("x, mm", 0.0..20.0), ("y, mm", 0.0..10.0)]),
        }])
        .unwrap();
        // Half of what PNGs have.
        assert!(figure.svg().contains("width=\"512\" height=\"256\""));
        for text in ["x, mm", "y, mm", "two rows", "of heading"] {
            assert!(figure.svg().contains(text), "{text}");
        }
    }

    #[test]
    fn scales_end_in_their_end_colours() {
        let sky = Scale::Asinh {
            soft: 0.1,
            high: 50.0,
        };
        assert_eq!(
            [0.0, 50.0, 90.0].map(|v| sky.colour(v)),
            [[0; 3], [255; 3], [255; 3]]
        );
        let difference = Scale::Difference { most: 2.0 };
        assert_eq!(difference.colour(0.0), [255; 3]);
        assert_eq!(difference.colour(-2.0), ColourMap::BlueWhiteRed.at(0.0));
    }
}
