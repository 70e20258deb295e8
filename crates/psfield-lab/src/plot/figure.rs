//! A figure: charts next to each other, as SVG.

use std::fmt::{Arguments, Write};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;

use super::chart::{Chart, Curve};
use crate::preview::Picture;

/// A figure as SVG. The background is white. Text has the reader's font `sans-serif`.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    shapes: String,
    width: f64,
    height: f64,
}

/// Size of text in pixels.
pub(super) const TEXT: f64 = 14.0;
/// Height of a line of a heading, and of the strip with the legend.
pub(super) const LINE: f64 = 22.0;
/// Length of a line in the legend.
const SAMPLE: f64 = 28.0;
const MARGIN: f64 = 12.0;

/// About the width of a text in pixels. The font of the reader is not known.
pub(super) fn text_width(text: &str) -> f64 {
    0.58 * TEXT * text.chars().count() as f64
}

impl Figure {
    /// Draws charts, two per row if there are several, each in a cell of `width` pixels. If the charts have at
    /// least two curves of different names, a legend above them shows each name once, so curves of equal names
    /// should have equal colours and markers.
    pub fn new(charts: &[Chart], width: f64) -> Self {
        let across = charts.len().clamp(1, 2);
        // Cells have equal heights, so that axes are in line.
        let height = charts.iter().map(|chart| chart.height(width)).fold(0.0, f64::max);
        let mut names: Vec<(usize, &Curve)> = Vec::new();
        for (place, curve) in charts.iter().flat_map(|chart| chart.curves.iter().enumerate()) {
            if !curve.name.is_empty() && names.iter().all(|(_, known)| known.name != curve.name) {
                names.push((place, curve));
            }
        }
        let legend = if names.len() > 1 { 2.0 * LINE } else { 0.0 };
        let mut figure = Self {
            shapes: String::new(),
            width: width * across as f64,
            height: legend + height * charts.len().div_ceil(across) as f64,
        };
        if legend > 0.0 {
            let mut left = 2.0 * MARGIN;
            for (place, curve) in names {
                curve.draw_sample(&mut figure, (left, LINE), SAMPLE, place);
                figure.text((left + SAMPLE + 6.0, LINE + 5.0), "", &curve.name);
                left += SAMPLE + text_width(&curve.name) + 2.0 * MARGIN;
            }
            figure.width = figure.width.max(left);
        }
        for (k, chart) in charts.iter().enumerate() {
            let corner = ((k % across) as f64 * width, legend + (k / across) as f64 * height);
            chart.draw(&mut figure, corner, (width, height));
        }
        figure
    }

    /// The SVG, as the content of a file.
    pub fn svg(&self) -> String {
        self.element("xmlns=\"http://www.w3.org/2000/svg\"")
    }

    /// The width in pixels.
    pub(crate) fn width(&self) -> f64 {
        self.width
    }

    /// The SVG as a part of an HTML page, with a text for readers who cannot see it.
    pub(crate) fn in_page(&self, text: &str) -> String {
        self.element(&format!("role=\"img\" aria-label=\"{}\"", escaped(text)))
    }

    fn element(&self, attributes: &str) -> String {
        let Self {
            shapes,
            width,
            height,
        } = self;
        format!(
            "<svg {attributes} width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} {height:.0}\" \
             font-family=\"sans-serif\" font-size=\"{TEXT}\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n{shapes}</svg>\n"
        )
    }

    /// Adds an element, given as its name and attributes.
    pub(super) fn shape(&mut self, element: Arguments<'_>) {
        // Writing to a string does not fail.
        let _ = writeln!(self.shapes, "<{element}/>");
    }

    /// Adds a text at a position, by default the left end of its baseline. `style` has attributes.
    pub(super) fn text(&mut self, (x, y): (f64, f64), style: &str, text: &str) {
        let text = escaped(text);
        let _ = writeln!(
            self.shapes,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" {style}>{text}</text>"
        );
    }

    /// Adds a picture in a rectangle, with a grey edge.
    pub(super) fn picture(&mut self, (x, y): (f64, f64), (width, height): (f64, f64), picture: &Picture) {
        let place = format!("x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\"");
        // Pixels that are larger than those of the screen keep sharp edges.
        let sharp = if (picture.width() as f64) < width {
            "optimizeSpeed"
        } else {
            "auto"
        };
        let png = BASE64_STANDARD.encode(picture.png());
        self.shape(format_args!(
            "image {place} preserveAspectRatio=\"none\" image-rendering=\"{sharp}\" href=\"data:image/png;base64,{png}\""
        ));
        self.shape(format_args!("rect {place} fill=\"none\" stroke=\"#808080\""));
    }
}

/// The text with the characters of markup replaced.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
