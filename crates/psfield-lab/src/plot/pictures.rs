//! Images next to each other, each with a bar that shows the values of its colours.

use std::ops::Range;

use image::{Rgb, RgbImage};
use ndarray::ArrayView2;

use crate::plot::axes::{LABEL_ROOM_X, LABEL_ROOM_Y, MARGIN, even_chart, title_room, under_title};
use crate::plot::canvas::Overlay;
use crate::plot::colours::{BAR_AREA, Scale};
use crate::plot::figure::{Area, Figure, PlotError};

/// The units along the axes of a picture.
#[derive(Debug, Clone, PartialEq)]
pub enum PictureAxes<'a> {
    /// Pixels of the image.
    Pixels,
    /// Other units, for x, then y: the name with the unit, and the values at the outer edges of the
    /// first and the last pixel.
    Of([(&'a str, Range<f64>); 2]),
}

/// An image with a heading.
#[derive(Debug, Clone)]
pub struct Picture<'a> {
    /// The heading.
    pub title: &'a str,
    /// The image `[y, x]`.
    pub pixels: ArrayView2<'a, f64>,
    /// The colours of the pixels.
    pub scale: Scale,
    /// The quantity shown by the colours, with its unit.
    pub quantity: &'a str,
    /// The units along the axes.
    pub axes: PictureAxes<'a>,
}

/// Width of a single picture, without its axes. The PNG has twice as many pixels along each axis,
/// so that an image of 1024 columns has one PNG pixel per image pixel.
const SINGLE_WIDTH: u32 = 512;
/// Width of each of several pictures, without its axes.
const PAIR_WIDTH: u32 = 298;
/// Total width of the axes, margins and bar next to a picture.
const SURROUNDINGS: u32 = LABEL_ROOM_Y + 2 * MARGIN + BAR_AREA;

/// Draws pictures, two per row. Row 0 of an image is at the bottom, as in FITS viewers.
///
/// # Errors
/// [`PlotError`] when the drawing fails.
pub fn pictures(pictures: &[Picture<'_>]) -> Result<Figure, PlotError> {
    let across = pictures.len().clamp(1, 2);
    let down = pictures.len().div_ceil(across).max(1);
    let plot = if across > 1 { PAIR_WIDTH } else { SINGLE_WIDTH };
    let aspect = pictures
        .iter()
        .map(|p| p.pixels.nrows() as f64 / p.pixels.ncols().max(1) as f64)
        .fold(0.3, f64::max)
        .min(2.0);
    let head = pictures.iter().map(|p| title_room(p.title)).max().unwrap_or(0);
    let height = head + (f64::from(plot) * aspect).round() as u32 + LABEL_ROOM_X + 2 * MARGIN;
    let width = plot + SURROUNDINGS;
    Figure::draw((across as u32 * width, down as u32 * height), |root| {
        let mut overlays = Vec::new();
        for (picture, area) in pictures.iter().zip(root.split_evenly((down, across))) {
            let (left, right) = area.split_horizontally(width - BAR_AREA);
            let (_, right) = right.split_vertically(title_room(picture.title));
            overlays.push(picture.draw(&under_title(&left, picture.title)?)?);
            overlays.push(picture.scale.draw_bar(picture.quantity, &right)?);
        }
        Ok(overlays)
    })
}

impl Picture<'_> {
    fn draw(&self, area: &Area<'_>) -> Result<Overlay, PlotError> {
        let (ny, nx) = self.pixels.dim();
        let axes = match &self.axes {
            PictureAxes::Pixels => [
                ("x (pixels)", -0.5..nx as f64 - 0.5),
                ("y (pixels)", -0.5..ny as f64 - 0.5),
            ],
            PictureAxes::Of(axes) => axes.clone(),
        };
        let pixels = RgbImage::from_fn(nx as u32, ny as u32, |x, row| {
            Rgb(self
                .scale
                .colour(self.pixels[[ny - 1 - row as usize, x as usize]]))
        });
        Ok(Overlay::over(even_chart(area, axes)?.plotting_area(), pixels))
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
        // Figures have half as many pixels along each axis as their PNG.
        assert!(figure.svg().contains("width=\"512\" height=\"256\""));
        for text in ["x, mm", "y, mm", "two rows", "of heading"] {
            assert!(figure.svg().contains(text), "{text}");
        }
    }
}
