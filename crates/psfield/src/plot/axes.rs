//! Axes as all figures have them.

use std::ops::Range;

use plotters::chart::ChartContext;
use plotters::coord::ranged1d::{Ranged, ValueFormatter};
use plotters::prelude::{Cartesian2d, IntoFont, RGBColor, SVGBackend, Text, TextStyle, WHITE};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{BLACK, Color};

use super::figure::{Area, PlotError};
use crate::readable::readable;

/// Sizes of text, readable where a panel of 560 pixels takes half a page.
pub(super) const TITLE: i32 = 17;
pub(super) const TEXT: i32 = 15;
pub(super) const SMALL: i32 = 12;
pub(super) const LABEL_ROOM_X: u32 = 50;
pub(super) const LABEL_ROOM_Y: u32 = 84;
pub(super) const MARGIN: u32 = 14;

type Chart<'a, 'b, X, Y> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<X, Y>>;

/// Grid, numbers and names of the axes.
pub(super) fn draw_axes<'a, 'b: 'a, X, Y>(
    chart: &mut Chart<'a, 'b, X, Y>,
    x_name: &str,
    y_name: &str,
) -> Result<(), PlotError>
where
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    let (x, y) = (chart.x_range(), chart.y_range());
    chart
        .configure_mesh()
        .x_labels(6)
        .y_labels(6)
        .max_light_lines(1)
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(222, 222, 222))
        .label_style(("sans-serif", TEXT))
        .axis_desc_style(("sans-serif", TITLE))
        .x_desc(x_name)
        .y_desc(y_name)
        .x_label_formatter(&|v| number(*v, (x.start, x.end)))
        .y_label_formatter(&|v| number(*v, (y.start, y.end)))
        .draw()?;
    Ok(())
}

/// The key to the lines, over the plot.
pub(super) fn draw_key<'a, 'b: 'a, X, Y>(
    chart: &mut Chart<'a, 'b, X, Y>,
    at: plotters::chart::SeriesLabelPosition,
) -> Result<(), PlotError>
where
    X: Ranged<ValueType = f64>,
    Y: Ranged<ValueType = f64>,
{
    chart
        .configure_series_labels()
        .position(at)
        .margin(8)
        .label_font(text_style(TEXT))
        .background_style(WHITE.mix(0.85))
        .border_style(RGBColor(200, 200, 200))
        .draw()?;
    Ok(())
}

pub(super) fn text_style(size: i32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&BLACK)
}

/// Room that a heading of so many lines takes.
pub(super) fn title_room(title: &str) -> u32 {
    (MARGIN as usize + title.lines().count() * (TITLE as usize + 5)) as u32
}

/// Writes a heading over the plot that the area is for, and gives what is left of the area.
pub(super) fn under_title<'a>(area: &Area<'a>, title: &str) -> Result<Area<'a>, PlotError> {
    let (head, rest) = area.split_vertically(title_room(title));
    // The middle of the plot, beside which are numbers.
    let middle = (area.dim_in_pixel().0 + LABEL_ROOM_Y) as i32 / 2;
    let style = text_style(TITLE).pos(Pos::new(HPos::Center, VPos::Top));
    for (row, line) in title.lines().enumerate() {
        let y = MARGIN as i32 + row as i32 * (TITLE + 5);
        head.draw(&Text::new(line.to_owned(), (middle, y), style.clone()))?;
    }
    Ok(rest)
}

/// The number at a tick of an axis. What is 0 but for rounding is 0.
pub(super) fn number(value: f64, (low, high): (f64, f64)) -> String {
    const FIGURES: usize = 4;
    let is_rounding = value.abs() < 1e-9 * (high - low).abs() && low <= 0.0;
    readable(if is_rounding { 0.0 } else { value }, FIGURES)
}

/// The range of some values with room at both ends.
pub(super) fn extent(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
    if low > high {
        return 0.0..1.0;
    }
    let room = 0.04 * (high - low).max(1e-6 * high.abs()).max(1e-12);
    low - room..high + room
}

/// The whole powers of ten about the positive values.
pub(super) fn decades(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values
        .filter(|v| v.is_finite() && *v > 0.0)
        .fold((f64::INFINITY, 0.0_f64), |(low, high), v| {
            (low.min(v), high.max(v))
        });
    if low > high {
        return 1e-1..1.0;
    }
    let (low, high) = (low.log10().floor(), high.log10().ceil());
    10f64.powf(low)..10f64.powf(high.max(low + 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_at_zero_is_not_shown() {
        assert_eq!(number(2e-17, (-1.0, 1.0)), "0");
        assert_eq!(number(2e-17, (-1e-16, 1e-16)), "2e-17");
        assert_eq!(number(1e-20, (1e-20, 1.0)), "1e-20");
    }

    #[test]
    fn ranges_hold_all_and_are_never_empty() {
        for values in [vec![], vec![3.0], vec![0.0], vec![-1.0, 5.0, f64::NAN]] {
            let range = extent(values.iter().copied());
            assert!(range.start < range.end);
            assert!(
                values.iter().all(|v| !v.is_finite() || range.contains(v)),
                "{values:?}"
            );
            let range = decades(values.iter().copied());
            assert!(range.start > 0.0 && range.start < range.end);
        }
        assert_eq!(decades([2e-3, 5e-2].into_iter()), 1e-3..1e-1);
    }
}
