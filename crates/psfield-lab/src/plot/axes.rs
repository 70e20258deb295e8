//! The axes of all figures, and the positions of numbers along them.

use std::ops::Range;

use plotters::chart::{ChartBuilder, ChartContext, SeriesLabelPosition};
use plotters::coord::ranged1d::{Ranged, ValueFormatter};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::{Cartesian2d, IntoFont, RGBColor, Text, TextStyle, WHITE};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{BLACK, Color};
use psfield::readable;

use crate::plot::canvas::Canvas;
use crate::plot::figure::{Area, PlotError};

/// Sizes of text in pixels. It is readable if a panel 560 pixels wide takes half the width of a
/// page.
pub(super) const TITLE: i32 = 17;
pub(super) const TEXT: i32 = 15;
pub(super) const SMALL: i32 = 12;
/// Height of the room below a plot for the numbers and the name of the x axis.
pub(super) const LABEL_ROOM_X: u32 = 50;
/// Width of the room to the left of a plot for the numbers and the name of the y axis.
pub(super) const LABEL_ROOM_Y: u32 = 84;
/// Margin around a plot, outside the numbers and names of the axes.
pub(super) const MARGIN: u32 = 14;

/// An axis of the crate plotters that has a range of `f64` and formats its numbers.
pub(super) trait Counting: Ranged<ValueType = f64> + ValueFormatter<f64> {}
impl<R: Ranged<ValueType = f64> + ValueFormatter<f64>> Counting for R {}

pub(super) type Chart<'a, 'b, X, Y> = ChartContext<'a, Canvas<'b>, Cartesian2d<X, Y>>;
/// A chart whose two axes are linear.
pub(super) type EvenChart<'a, 'b> = Chart<'a, 'b, RangedCoordf64, RangedCoordf64>;

/// Makes a chart with linear axes that fills an area, and draws the axes.
pub(super) fn even_chart<'a, 'b>(
    area: &'a Area<'b>,
    [(x_name, x), (y_name, y)]: [(&str, Range<f64>); 2],
) -> Result<EvenChart<'a, 'b>, PlotError> {
    let mut chart = ChartBuilder::on(area)
        .margin(MARGIN)
        .x_label_area_size(LABEL_ROOM_X)
        .y_label_area_size(LABEL_ROOM_Y)
        .build_cartesian_2d(x, y)?;
    draw_axes(&mut chart, x_name, y_name)?;
    Ok(chart)
}

/// Draws the grid, the numbers and the names of the axes.
pub(super) fn draw_axes<'a, 'b: 'a, X: Counting, Y: Counting>(
    chart: &mut Chart<'a, 'b, X, Y>,
    x_name: &str,
    y_name: &str,
) -> Result<(), PlotError> {
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

/// Draws the legend, over the plot.
pub(super) fn draw_legend<'a, 'b: 'a, X: Counting, Y: Counting>(
    chart: &mut Chart<'a, 'b, X, Y>,
    at: SeriesLabelPosition,
) -> Result<(), PlotError> {
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

/// Returns the height of a heading and of the margin above it.
pub(super) fn title_room(title: &str) -> u32 {
    (MARGIN as usize + title.lines().count() * (TITLE as usize + 5)) as u32
}

/// Writes a heading above the plot, and returns the rest of the area.
pub(super) fn under_title<'a>(area: &Area<'a>, title: &str) -> Result<Area<'a>, PlotError> {
    let (head, rest) = area.split_vertically(title_room(title));
    // The heading is centred over the plot. `area` also holds the room for numbers to the left.
    let middle = (area.dim_in_pixel().0 + LABEL_ROOM_Y) as i32 / 2;
    let style = text_style(TITLE).pos(Pos::new(HPos::Center, VPos::Top));
    for (row, line) in title.lines().enumerate() {
        let y = MARGIN as i32 + row as i32 * (TITLE + 5);
        head.draw(&Text::new(line.to_owned(), (middle, y), style.clone()))?;
    }
    Ok(rest)
}

/// Formats the number at a tick of an axis. A value that is 0 up to rounding is shown as 0.
pub(super) fn number(value: f64, (low, high): (f64, f64)) -> String {
    const FIGURES: usize = 4;
    let is_rounding = value.abs() < 1e-9 * (high - low).abs() && low <= 0.0;
    readable(if is_rounding { 0.0 } else { value }, FIGURES)
}

/// Returns the smallest and the largest of the finite values, or `(infinity, -infinity)` if there
/// are none.
pub(super) fn bounds(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let finite = values.filter(|v| v.is_finite());
    finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    })
}

/// Returns the range of the values, with a margin at both ends.
pub(super) fn extent(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = bounds(values);
    if low > high {
        return 0.0..1.0;
    }
    let room = 0.04 * (high - low).max(1e-6 * high.abs()).max(1e-12);
    low - room..high + room
}

/// Returns the smallest range between whole powers of ten that holds all positive values.
pub(super) fn decades(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = bounds(values.filter(|v| *v > 0.0));
    if low > high {
        return 1e-1..1.0;
    }
    let (low, high) = (low.log10().floor(), high.log10().ceil());
    10f64.powf(low)..10f64.powf(high.max(low + 1.0))
}

/// A logarithmic axis with at most this number of powers of ten has a tick at each of them.
const DECADES: i32 = 7;
/// Approximate number of steps between ticks on a linear axis.
const STEPS: f64 = 5.0;
/// Smallest distance between the ticks of a colour bar with an asinh scale ([`asinh_ticks`]), as a
/// fraction of the bar's length.
const SPACING: f64 = 0.09;
/// [`asinh_ticks`] seeks ticks in at most this number of decades below the bar's upper end.
const MOST_DECADES: i32 = 40;

/// Ticks of a linear axis. The step between ticks is 1, 2 or 5 times a power of ten.
pub(super) fn even_ticks(low: f64, high: f64) -> Vec<f64> {
    let span = high - low;
    if !(span > 0.0 && span.is_finite()) {
        return vec![low];
    }
    let rough = span / STEPS;
    let unit = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|m| m * unit)
        .find(|&step| step >= rough * (1.0 - ROUNDING))
        .unwrap_or(10.0 * unit);
    let (first, last) = (
        (low / step - ROUNDING).ceil() as i64,
        (high / step + ROUNDING).floor() as i64,
    );
    (first..=last).map(|k| k as f64 * step).collect()
}

/// Ticks of a logarithmic axis. A range of at least two decades has ticks at powers of ten (if
/// there are more than [`DECADES`], only at every second, third, and so on). A shorter range has
/// ticks at 1, 2 and 5 times powers of ten. If fewer than two of these lie in the range, it has
/// the ticks of a linear axis.
pub(super) fn logarithmic_ticks(low: f64, high: f64) -> Vec<f64> {
    let low = low.max(f64::MIN_POSITIVE);
    let first = (low.log10() - ROUNDING).ceil() as i32;
    let last = (high.log10() + ROUNDING).floor() as i32;
    if (high / low).log10() >= 2.0 - ROUNDING {
        let stride = (last - first) / DECADES + 1;
        return (first..=last)
            .step_by(stride as usize)
            .map(|k| 10f64.powi(k))
            .collect();
    }
    let within = one_two_five(first - 1, last, low, high);
    if within.len() > 1 {
        within
    } else {
        even_ticks(low, high)
    }
}

/// Ticks of a colour bar from 0 to `high` with the scale `asinh(v / soft)`, which is linear up to
/// about `soft` and logarithmic above. The ticks are 0, and 1, 2 and 5 times powers of ten. A tick
/// that would be closer than [`SPACING`] to another is left out.
pub(super) fn asinh_ticks(soft: f64, high: f64) -> Vec<f64> {
    let along = |v: f64| (v / soft).asinh() / (high / soft).asinh();
    let last = high.log10().floor() as i32;
    let first = ((soft / 10.0).log10().floor() as i32).max(last.saturating_sub(MOST_DECADES));
    let mut ticks = vec![0.0];
    // Powers of ten come first, so that no other tick displaces them.
    let mut candidates = one_two_five(first, last, 0.0, high);
    candidates.sort_by_key(|&v| (v.log10() - v.log10().round()).abs() > ROUNDING);
    for value in candidates {
        if ticks.iter().all(|&t| (along(value) - along(t)).abs() >= SPACING) {
            ticks.push(value);
        }
    }
    ticks.sort_by(f64::total_cmp);
    ticks
}

/// A tick may lie beyond the end of its axis by this fraction of a step or of the value at the end.
const ROUNDING: f64 = 1e-9;

fn one_two_five(first: i32, last: i32, low: f64, high: f64) -> Vec<f64> {
    (first..=last)
        .flat_map(|k| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(k)))
        .filter(|v| (low * (1.0 - ROUNDING)..=high * (1.0 + ROUNDING)).contains(v))
        .collect()
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

    fn shown(ticks: &[f64]) -> Vec<String> {
        ticks.iter().map(|&v| readable(v, 4)).collect()
    }

    #[test]
    fn decades_are_whole() {
        assert_eq!(shown(&logarithmic_ticks(3e-12, 2e-9)), ["1e-11", "1e-10", "1e-9"]);
        assert_eq!(
            shown(&logarithmic_ticks(1e-4, 1e-1)),
            ["1e-4", "0.001", "0.01", "0.1"]
        );
        assert_eq!(shown(&logarithmic_ticks(1e-30, 1e30)).len(), 7);
        // Fewer than two whole decades.
        assert_eq!(
            shown(&logarithmic_ticks(3e-12, 4e-11)),
            ["5e-12", "1e-11", "2e-11"]
        );
        assert_eq!(shown(&logarithmic_ticks(2.0, 5.0)), ["2", "5"]);
        assert_eq!(
            shown(&logarithmic_ticks(2.1, 2.5)),
            ["2.1", "2.2", "2.3", "2.4", "2.5"]
        );
    }

    #[test]
    fn even_steps_are_round_and_hold_the_ends() {
        assert_eq!(shown(&even_ticks(-1.0, 1.0)), ["-1", "-0.5", "0", "0.5", "1"]);
        assert_eq!(shown(&even_ticks(0.0, 0.3)), ["0", "0.1", "0.2", "0.3"]);
        assert_eq!(even_ticks(3.0, 3.0), [3.0]);
    }

    #[test]
    fn a_stretched_bar_has_round_numbers_apart() {
        for (soft, high) in [(30.0, 3000.0), (0.02, 1.0), (1e-12, 1e-3), (1.0, 1.5)] {
            let ticks = asinh_ticks(soft, high);
            let along = |v: f64| (v / soft).asinh() / (high / soft).asinh();
            assert!(ticks.len() >= 3, "{ticks:?}");
            assert!(
                ticks.windows(2).all(|w| along(w[1]) - along(w[0]) >= SPACING),
                "{ticks:?}"
            );
        }
        assert_eq!(shown(&asinh_ticks(30.0, 3000.0))[..2], ["0", "20"]);
    }
}
