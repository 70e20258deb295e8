//! A figure as SVG and PNG.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageError};
use plotters::coord::Shift;
use plotters::prelude::{DrawingArea, DrawingAreaErrorKind, IntoDrawingArea, WHITE};
use thiserror::Error;
use tiny_skia::Pixmap;

use crate::plot::canvas::{Canvas, Overlay, PNG_SCALE};

/// A rectangle of a figure in which a part of the figure is drawn.
pub(super) type Area<'a> = DrawingArea<Canvas<'a>, Shift>;

/// The error of a figure that could not be made.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PlotError {
    /// The drawing failed.
    #[error("a figure could not be drawn: {0}")]
    Drawing(#[from] DrawingAreaErrorKind<std::io::Error>),
    /// The figure has no pixels, or too many for a PNG.
    #[error("a PNG of {width} x {height} pixels cannot be made: it is empty or too large")]
    TooLarge {
        /// Columns of the PNG.
        width: u32,
        /// Rows of the PNG.
        height: u32,
    },
    /// The pixels could not be written as PNG.
    #[error("a PNG could not be encoded: {0}")]
    Encoding(#[from] ImageError),
}

/// A figure as SVG and as pixels. The background is white. The font of the text is DejaVu Sans in
/// the pixels, and the reader's `sans-serif` font in the SVG.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    svg: String,
    pixels: Pixmap,
    size: (u32, u32),
}

impl Figure {
    /// Draws a figure of this `size` (width, height) in pixels. `draw` returns overlays, which are
    /// drawn last, over the rest of the figure.
    pub(super) fn draw(
        size: (u32, u32),
        draw: impl FnOnce(&Area<'_>) -> Result<Vec<Overlay>, PlotError>,
    ) -> Result<Self, PlotError> {
        let scaled = |n: u32| (n as f32 * PNG_SCALE).round() as u32;
        let (width, height) = (scaled(size.0), scaled(size.1));
        let mut pixels = Pixmap::new(width, height).ok_or(PlotError::TooLarge { width, height })?;
        let mut svg = String::new();
        let root = Canvas::new(&mut svg, &mut pixels, size).into_drawing_area();
        root.fill(&WHITE)?;
        let overlays = draw(&root)?;
        root.present()?;
        drop(root);
        let end = svg.rfind("</svg>").unwrap_or(svg.len());
        let mut images = String::new();
        for overlay in overlays {
            images.push_str(&overlay.element()?);
            overlay.lay_over(&mut pixels);
        }
        svg.insert_str(end, &images);
        Ok(Self { svg, pixels, size })
    }

    /// The SVG.
    pub fn svg(&self) -> &str {
        &self.svg
    }

    /// Width and height of the SVG in pixels.
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// Returns the figure as PNG, with twice as many pixels along each axis as
    /// [`size`](Self::size).
    ///
    /// # Errors
    /// [`PlotError::Encoding`] if the pixels cannot be written as PNG.
    pub fn png(&self) -> Result<Vec<u8>, PlotError> {
        let (width, height) = (self.pixels.width(), self.pixels.height());
        let mut png = Vec::new();
        PngEncoder::new(&mut png).write_image(self.pixels.data(), width, height, ExtendedColorType::Rgba8)?;
        Ok(png)
    }

    /// Returns the SVG as a `data:` URI, for self-contained pages.
    pub fn data_uri(&self) -> String {
        format!("data:image/svg+xml;base64,{}", BASE64_STANDARD.encode(&self.svg))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};
    use plotters::prelude::{IntoFont, Text};

    #[test]
    fn text_and_overlays_reach_the_png() {
        let figure = Figure::draw((80, 40), |root| {
            root.draw(&Text::new("MMM", (4, 4), ("sans-serif", 20).into_font()))?;
            Ok(vec![Overlay {
                left: 60,
                top: 10,
                width: 20,
                height: 20,
                pixels: RgbImage::from_pixel(2, 2, Rgb([255, 0, 0])),
            }])
        })
        .unwrap();
        let png = image::load_from_memory(&figure.png().unwrap()).unwrap().to_rgb8();
        assert_eq!(png.dimensions(), (160, 80));
        assert_eq!(png.get_pixel(140, 40), &Rgb([255, 0, 0]));
        let dark = png.enumerate_pixels().filter(|(x, _, p)| *x < 110 && p[0] < 100);
        assert!(dark.count() > 50, "the text is not there");
    }
}
