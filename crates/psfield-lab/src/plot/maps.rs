//! Positions over the field, and a value at each of them.

use image::{Rgb, RgbImage};
use plotters::prelude::{Circle, RGBColor};
use plotters::style::{BLACK, Color};
use psf_types::{FrameShape, Position};

use crate::plot::axes::{LABEL_ROOM_X, LABEL_ROOM_Y, MARGIN, even_chart, title_room, under_title};
use crate::plot::canvas::Overlay;
use crate::plot::colours::{BAR_AREA, Scale};
use crate::plot::figure::{Figure, PlotError};

const PANEL: u32 = 560;

/// Draws positions over the field in panels next to each other, each with a heading.
///
/// # Errors
/// [`PlotError`] when the drawing fails.
pub fn positions_figure(panels: &[(String, &[Position])], frame: FrameShape) -> Result<Figure, PlotError> {
    let (nx, ny) = (frame.nx() as f64, frame.ny() as f64);
    let plot = f64::from(PANEL - LABEL_ROOM_Y - 2 * MARGIN);
    let height = (plot * (ny / nx).clamp(0.3, 2.0)) as u32 + LABEL_ROOM_X + 2 * MARGIN;
    let head = panels
        .iter()
        .map(|(title, _)| title_room(title))
        .max()
        .unwrap_or(0);
    let count = panels.len().max(1);
    Figure::draw((PANEL * count as u32, head + height), |root| {
        for ((title, positions), area) in panels.iter().zip(root.split_evenly((1, count))) {
            // Room for dots on the edges of the frame.
            let axes = [
                ("x (pixels)", -0.02 * nx..1.02 * nx),
                ("y (pixels)", -0.02 * ny..1.02 * ny),
            ];
            let area = under_title(&area, title)?;
            let mut chart = even_chart(&area, axes)?;
            let spacing = plot / (positions.len().max(1) as f64).sqrt();
            let radius = if spacing > 9.0 { 2 } else { 1 };
            chart.draw_series(
                positions
                    .iter()
                    .map(|p| Circle::new((p.x(), p.y()), radius, BLACK.filled())),
            )?;
        }
        Ok(Vec::new())
    })
}

/// Values at positions of a field, shown as colours.
#[derive(Debug, Clone)]
pub struct FieldMap<'a> {
    /// The heading.
    pub title: &'a str,
    /// The quantity with its unit, shown next to the colour bar.
    pub quantity: &'a str,
    /// The field.
    pub frame: FrameShape,
    /// Positions and values. A position without a value is grey.
    pub values: &'a [(Position, Option<f64>)],
    /// Number of columns if the positions form a regular grid over the field, ordered by y, then x.
    /// None: values are shown as dots.
    pub grid_columns: Option<usize>,
    /// The colours of the values.
    pub scale: Scale,
}

/// Width of a map. Two maps fit next to each other on the page of a report.
const WIDTH: u32 = 550;
const MISSING: RGBColor = RGBColor(128, 128, 128);

impl FieldMap<'_> {
    /// Draws the map.
    ///
    /// # Errors
    /// [`PlotError`] when the drawing fails.
    pub fn figure(&self) -> Result<Figure, PlotError> {
        let (nx, ny) = (self.frame.nx() as f64, self.frame.ny() as f64);
        let plot = f64::from(WIDTH - BAR_AREA - LABEL_ROOM_Y - 2 * MARGIN);
        let height = (plot * (ny / nx).clamp(0.3, 2.0)) as u32 + LABEL_ROOM_X + 2 * MARGIN;
        Figure::draw((WIDTH, height + title_room(self.title)), |root| {
            let (left, right) = root.split_horizontally(WIDTH - BAR_AREA);
            let left = under_title(&left, self.title)?;
            let (_, right) = right.split_vertically(title_room(self.title));
            // Room for dots on the edges of the frame.
            let room = if self.grid_columns.is_some() { 0.0 } else { 0.03 };
            let range = |n: f64| -room * n - 0.5..(1.0 + room) * n - 0.5;
            let mut chart = even_chart(&left, [("x (pixels)", range(nx)), ("y (pixels)", range(ny))])?;
            let mut overlays = Vec::new();
            if let Some(columns) = self.grid_columns.filter(|&c| c > 0) {
                overlays.push(Overlay::over(chart.plotting_area(), self.cells(columns)));
            } else {
                let (px, py) = chart.plotting_area().get_pixel_range();
                let area = f64::from((px.end - px.start) * (py.end - py.start));
                let radius = (0.35 * (area / self.values.len().max(1) as f64).sqrt()).clamp(2.0, 9.0) as i32;
                chart.draw_series(self.values.iter().map(|(at, value)| {
                    let colour = value.map_or(MISSING, |v| {
                        let [r, g, b] = self.scale.colour(v);
                        RGBColor(r, g, b)
                    });
                    Circle::new((at.x(), at.y()), radius, colour.filled())
                }))?;
                // Grey outlines, because white dots would be invisible on the white background.
                chart.draw_series(
                    self.values
                        .iter()
                        .map(|(at, _)| Circle::new((at.x(), at.y()), radius, MISSING.stroke_width(1))),
                )?;
            }
            overlays.push(self.scale.draw_bar(self.quantity, &right)?);
            Ok(overlays)
        })
    }

    /// Returns a picture with one pixel per value. The first row of values is at the bottom.
    fn cells(&self, columns: usize) -> RgbImage {
        let rows = self.values.len().div_ceil(columns);
        RgbImage::from_fn(columns as u32, rows as u32, |x, y| {
            let row = rows - 1 - y as usize;
            let value = self.values.get(row * columns + x as usize).and_then(|v| v.1);
            Rgb(value.map_or([128; 3], |v| self.scale.colour(v)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::colours::ColourMap;

    /// Values on a grid of 2 x 2.
    fn placed(values: [f64; 4]) -> Vec<(Position, Option<f64>)> {
        let places = (0..4).map(|k| Position::of_pixel(k % 2, k / 2));
        places.zip(values.map(Some)).collect()
    }

    fn map(values: &[(Position, Option<f64>)], scale: Scale) -> FieldMap<'_> {
        FieldMap {
            title: "t",
            quantity: "q",
            frame: FrameShape::new(2, 2).unwrap(),
            values,
            grid_columns: Some(2),
            scale,
        }
    }

    #[test]
    fn the_first_value_is_at_the_bottom_left_and_zero_is_white() {
        let values = placed([-1.0, 0.0, 1.0, 5.0]);
        let map = map(&values, Scale::Difference { most: 1.0 });
        let cells = map.cells(2);
        assert_eq!(cells.get_pixel(0, 1).0, ColourMap::BlueWhiteRed.at(0.0));
        assert_eq!(cells.get_pixel(1, 1).0, [255; 3]);
        assert_eq!(cells.get_pixel(1, 0).0, ColourMap::BlueWhiteRed.at(1.0));
        assert!(map.figure().unwrap().svg().contains("<image"));
        let dots = FieldMap {
            grid_columns: None,
            ..map
        };
        assert_eq!(dots.figure().unwrap().svg().matches("<circle").count(), 8);
    }

    #[test]
    fn a_logarithmic_bar_has_whole_decades() {
        let values = placed([2e-12, 4e-11, 3e-10, 7e-10]);
        let (low, high) = (2e-12, 7e-10);
        let map = map(&values, Scale::Logarithmic { low, high });
        let svg = map.figure().unwrap().svg().to_owned();
        assert!(
            svg.contains("\u{a0}1e-11\n") && svg.contains("\u{a0}1e-10\n"),
            "{svg}"
        );
        assert_eq!(svg.matches("e-1").count(), 2);
        assert_eq!(map.scale.colour(2e-12), ColourMap::Viridis.at(0.0));
    }
}
