//! Images side by side, each with its colours explained.

use image::{Rgb, RgbImage};
use ndarray::ArrayView2;
use plotters::chart::ChartBuilder;

use super::axes::{LABEL_ROOM_X, LABEL_ROOM_Y, MARGIN, TITLE, draw_axes, rounded};
use super::colour_bar::{BAR_AREA, colour_bar, plain};
use super::colours::ColourMap;
use super::figure::{Figure, Overlay, PlotError};

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

    fn back(self, along: f64) -> f64 {
        match self {
            Self::Asinh { soft, .. } => along.sinh() * soft,
            Self::Difference { .. } => along,
        }
    }

    fn range(self) -> (f64, f64) {
        match self {
            Self::Asinh { high, .. } => (0.0, self.along(high)),
            Self::Difference { most } => (-most, most),
        }
    }
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
}

const WIDTH: u32 = 560;
const TITLE_ROOM: u32 = 34;

/// Draws pictures, two in a row. Row 0 is at the bottom, as FITS viewers show it.
///
/// # Errors
/// [`PlotError`] when the drawing fails.
pub fn pictures(pictures: &[Picture<'_>]) -> Result<Figure, PlotError> {
    let across = pictures.len().clamp(1, 2);
    let down = pictures.len().div_ceil(across).max(1);
    let plot = WIDTH - BAR_AREA - LABEL_ROOM_Y - 2 * MARGIN;
    let aspect = pictures
        .iter()
        .map(|p| p.pixels.nrows() as f64 / p.pixels.ncols().max(1) as f64)
        .fold(0.3, f64::max)
        .min(2.0);
    let height = (f64::from(plot) * aspect) as u32 + LABEL_ROOM_X + 2 * MARGIN + TITLE_ROOM;
    Figure::draw((across as u32 * WIDTH, down as u32 * height), |root| {
        let mut overlays = Vec::new();
        for (picture, area) in pictures.iter().zip(root.split_evenly((down, across))) {
            let (left, right) = area.split_horizontally(WIDTH - BAR_AREA);
            let (ny, nx) = picture.pixels.dim();
            let mut chart = ChartBuilder::on(&left)
                .margin(MARGIN)
                .caption(picture.title, ("sans-serif", TITLE))
                .x_label_area_size(LABEL_ROOM_X)
                .y_label_area_size(LABEL_ROOM_Y)
                .build_cartesian_2d(-0.5..nx as f64 - 0.5, -0.5..ny as f64 - 0.5)?;
            draw_axes(&mut chart, "x, pixels", "y, pixels")?;
            let (px, py) = chart.plotting_area().get_pixel_range();
            let (low, high) = picture.scale.range();
            overlays.push(Overlay {
                left: px.start,
                top: py.start,
                width: (px.end - px.start) as u32,
                height: (py.end - py.start) as u32,
                pixels: RgbImage::from_fn(nx as u32, ny as u32, |x, y| {
                    let value = picture.pixels[[ny - 1 - y as usize, x as usize]];
                    let along = (picture.scale.along(value) - low) / (high - low).max(f64::MIN_POSITIVE);
                    Rgb(picture.scale.colours().at(along))
                }),
            });
            let area_top = area.get_pixel_range().1.start;
            let bar = colour_bar(
                &right,
                ((py.start - area_top) as u32, LABEL_ROOM_X + MARGIN),
                picture.scale.colours(),
                (low, high),
                picture.quantity,
                &|v| plain(rounded(picture.scale.back(v))),
            )?;
            overlays.push(bar);
        }
        Ok(overlays)
    })
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
    fn a_stretch_goes_there_and_back() {
        let scale = Scale::Asinh {
            soft: 0.1,
            high: 50.0,
        };
        for v in [0.0, 0.03, 1.0, 50.0] {
            assert!((scale.back(scale.along(v)) - v).abs() < 1e-12 * (1.0 + v));
        }
        assert!((rounded(0.012_345) - 0.012).abs() < 1e-15 && rounded(0.0) == 0.0);
    }
}
