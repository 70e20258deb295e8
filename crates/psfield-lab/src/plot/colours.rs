//! Colours that colour-blind readers can tell apart, and the bar that explains them.

use std::ops::Range;

use image::{Rgb, RgbImage};
use plotters::chart::ChartBuilder;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::style::RGBColor;

use crate::plot::axes::{
    LABEL_ROOM_X, MARGIN, TEXT, TITLE, asinh_ticks, even_ticks, logarithmic_ticks, number,
};
use crate::plot::canvas::Overlay;
use crate::plot::figure::{Area, PlotError};

/// Colours of lines, in the order of use (Okabe and Ito 2008).
pub const SERIES: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(0, 0, 0),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
];

/// A map from values to colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ColourMap {
    /// Dark violet to yellow in even steps of lightness, for positive values.
    Viridis,
    /// Blue below, white in the middle, red above, for differences.
    BlueWhiteRed,
    /// Black to white, for images of the sky.
    Grey,
}

/// `RdBu` with 9 classes (C. Brewer, colorbrewer2.org), from blue to red. The middle is changed to
/// pure white, so that a difference of 0 is invisible.
const BLUE_WHITE_RED: [[u8; 3]; 9] = [
    [33, 102, 172],
    [67, 147, 195],
    [146, 197, 222],
    [209, 229, 240],
    [255, 255, 255],
    [253, 219, 199],
    [244, 165, 130],
    [214, 96, 77],
    [178, 24, 43],
];

impl ColourMap {
    /// Returns the colour of a value from 0 to 1. Values outside get the colour of the nearer end.
    pub(super) fn at(self, value: f64) -> [u8; 3] {
        let value = value.clamp(0.0, 1.0);
        match self {
            Self::Grey => [(value * 255.0).round() as u8; 3],
            Self::Viridis => colorous::VIRIDIS.eval_continuous(value).into_array(),
            Self::BlueWhiteRed => between(&BLUE_WHITE_RED, value),
        }
    }
}

/// Returns the colour at `value`, from 0 to 1, interpolated between evenly spaced colours.
fn between(stops: &[[u8; 3]], value: f64) -> [u8; 3] {
    let along = value * (stops.len() - 1) as f64;
    let first = (along as usize).min(stops.len() - 2);
    let part = along - first as f64;
    std::array::from_fn(|c| {
        let (a, b) = (f64::from(stops[first][c]), f64::from(stops[first + 1][c]));
        (a + part * (b - a)).round() as u8
    })
}

/// Width of the area of a colour bar, including its numbers and its name.
pub(super) const BAR_AREA: u32 = 150;
/// Width of the bar itself.
const BAR: u32 = 18;
/// Width of the numbers and the name of the bar.
const NUMBERS: u32 = 78;

/// Assigns colours to values. Pictures and maps that are compared should have equal scales.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// Black at 0 to white at `high`, by `asinh(v / soft)`: linear below about `soft`, logarithmic
    /// above.
    Asinh {
        /// The value at which the scale turns from linear to logarithmic.
        soft: f64,
        /// The value shown white.
        high: f64,
    },
    /// Blue at `-most`, white at 0, red at `most`, with linear steps between them.
    Difference {
        /// The absolute value that gets the darkest blue or red.
        most: f64,
    },
    /// Viridis from `low` to `high`, both above 0, logarithmic.
    Logarithmic {
        /// The value shown dark violet.
        low: f64,
        /// The value shown yellow.
        high: f64,
    },
}

impl Scale {
    /// The values at the ends of the bar. Values outside get the colour of the nearer end.
    fn range(self) -> (f64, f64) {
        match self {
            Self::Asinh { high, .. } => (0.0, high),
            Self::Difference { most } => (-most, most),
            Self::Logarithmic { low, high } => (low, high),
        }
    }

    /// The position of a value along the bar, up to an offset and a factor.
    fn along(self, value: f64) -> f64 {
        match self {
            Self::Asinh { soft, .. } => (value / soft).asinh(),
            Self::Difference { .. } => value,
            Self::Logarithmic { .. } => value.max(f64::MIN_POSITIVE).log10(),
        }
    }

    /// The values that have a number at the bar.
    fn ticks(self) -> Vec<f64> {
        match self {
            Self::Asinh { soft, high } => asinh_ticks(soft, high),
            Self::Difference { most } => even_ticks(-most, most),
            Self::Logarithmic { low, high } => logarithmic_ticks(low, high),
        }
    }

    /// The colour at a fraction of the bar's length, from 0 to 1.
    fn at(self, part: f64) -> [u8; 3] {
        match self {
            Self::Asinh { .. } => ColourMap::Grey.at(part),
            Self::Difference { .. } => ColourMap::BlueWhiteRed.at(part),
            Self::Logarithmic { .. } => ColourMap::Viridis.at(part),
        }
    }

    /// The colour of a value.
    pub(super) fn colour(self, value: f64) -> [u8; 3] {
        let (low, high) = (self.along(self.range().0), self.along(self.range().1));
        self.at((self.along(value) - low) / (high - low).max(f64::MIN_POSITIVE))
    }

    /// Draws the numbers and the name of a colour bar at the left of `area`, and returns the
    /// colours as an overlay. `area` must be as high as the area of the plot next to the bar.
    /// `name` is the quantity with its unit.
    pub(super) fn draw_bar(self, name: &str, area: &Area<'_>) -> Result<Overlay, PlotError> {
        let (low, high) = self.range();
        let ticks = self.ticks();
        let places: Vec<f64> = ticks.iter().map(|&v| self.along(v)).collect();
        let shown = |place: &f64| {
            let tick = places.iter().position(|p| p == place);
            // Without a space, the mark of the tick looks like a decimal point before the number.
            // SVG drops plain spaces, so this is a no-break space.
            tick.map_or_else(String::new, |k| {
                format!("\u{a0}{}", number(ticks[k], (low, high)))
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
                    range: self.along(low)..self.along(high),
                    places: places.clone(),
                },
            );
        chart
            .configure_secondary_axes()
            .y_desc(name)
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
                Rgb(self.at(1.0 - f64::from(row) / f64::from(height.max(2) - 1)))
            }),
        })
    }
}

/// The axis of a colour bar, with numbers at given places. The crate plotters would otherwise
/// choose the places.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn lightness([r, g, b]: [u8; 3]) -> f64 {
        0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
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

    #[test]
    fn values_get_lighter_and_differences_darken_both_ways() {
        let steps: Vec<f64> = (0..=100).map(|k| f64::from(k) / 100.0).collect();
        let viridis: Vec<f64> = steps
            .iter()
            .map(|&v| lightness(ColourMap::Viridis.at(v)))
            .collect();
        assert!(viridis.windows(2).all(|w| w[1] >= w[0]), "{viridis:?}");
        let map = ColourMap::BlueWhiteRed;
        assert_eq!(map.at(0.5), [255, 255, 255]);
        for &v in &steps[..50] {
            assert!(lightness(map.at(v)) < lightness(map.at(v + 0.01)) + 1.0);
            assert!(map.at(v)[2] > map.at(v)[0] && map.at(1.0 - v)[0] > map.at(1.0 - v)[2]);
        }
        assert_eq!(map.at(-3.0), map.at(0.0));
    }
}
