//! The bar that says which colour means what.

use std::ops::Range;

use image::{Rgb, RgbImage};
use plotters::chart::ChartBuilder;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};

use super::axes::{LABEL_ROOM_X, MARGIN, TEXT, TITLE, number};
use super::colours::ColourMap;
use super::figure::{Area, Overlay, PlotError};

/// Width of the area that a bar takes, its numbers and name included.
pub(super) const BAR_AREA: u32 = 150;
const BAR: u32 = 18;
const NUMBERS: u32 = 78;

/// What a bar explains.
pub(super) struct ColourBar<'a> {
    pub(super) map: ColourMap,
    /// The values at its ends.
    pub(super) range: (f64, f64),
    /// Values that are numbered.
    pub(super) ticks: Vec<f64>,
    /// Where a value lies along the bar, in any unit.
    pub(super) along: &'a dyn Fn(f64) -> f64,
    /// The quantity, with its unit.
    pub(super) name: &'a str,
}

impl ColourBar<'_> {
    /// Draws the bar at the left of `area`, which is as high as that of the plot beside it.
    pub(super) fn draw(&self, area: &Area<'_>) -> Result<Overlay, PlotError> {
        let (low, high) = self.range;
        let places: Vec<f64> = self.ticks.iter().map(|&v| (self.along)(v)).collect();
        let shown = |place: &f64| {
            let tick = places.iter().position(|p| p == place);
            // Apart from the tick, which would read as a point; SVG drops plain blanks.
            tick.map_or_else(String::new, |k| {
                format!("\u{a0}{}", number(self.ticks[k], (low, high)))
            })
        };
        let right = area.dim_in_pixel().0.saturating_sub(BAR + MARGIN + NUMBERS);
        let mut chart = ChartBuilder::on(area)
            .margin_top(MARGIN)
            .margin_bottom(LABEL_ROOM_X + MARGIN)
            .margin_right(right)
            .margin_left(MARGIN)
            .right_y_label_area_size(NUMBERS)
            .build_cartesian_2d(0.0..1.0, 0.0..1.0)?
            .set_secondary_coord(
                0.0..1.0,
                Length {
                    range: (self.along)(low)..(self.along)(high),
                    places: places.clone(),
                },
            );
        chart
            .configure_secondary_axes()
            .y_desc(self.name)
            .label_style(("sans-serif", TEXT))
            .axis_desc_style(("sans-serif", TITLE))
            .y_label_formatter(&shown)
            .draw()?;
        let (x, y) = chart.plotting_area().get_pixel_range();
        let height = (y.end - y.start).max(1) as u32;
        Ok(Overlay {
            left: x.start,
            top: y.start,
            width: (x.end - x.start).max(1) as u32,
            height,
            pixels: RgbImage::from_fn(1, height, |_, row| {
                Rgb(self.map.at(1.0 - f64::from(row) / f64::from(height.max(2) - 1)))
            }),
        })
    }
}

/// The length of a bar, with numbers at given places: plotters chooses its own on other axes.
struct Length {
    range: Range<f64>,
    places: Vec<f64>,
}

impl Ranged for Length {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let part = (value - self.range.start) / (self.range.end - self.range.start);
        limit.0 + (part * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() {
            Vec::new()
        } else {
            self.places.clone()
        }
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}
