//! Axes as all figures have them.

use std::ops::Range;

use plotters::chart::ChartContext;
use plotters::coord::ranged1d::{Ranged, ValueFormatter};
use plotters::prelude::{Cartesian2d, IntoFont, RGBColor, SVGBackend, TextStyle, WHITE};
use plotters::style::{BLACK, Color};

use super::figure::PlotError;

/// Sizes of text, readable where a panel of 560 pixels takes half a page.
pub(super) const TITLE: i32 = 17;
pub(super) const TEXT: i32 = 15;
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
        .x_label_formatter(&|v| number(*v))
        .y_label_formatter(&|v| number(*v))
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

/// A number without needless digits.
pub(super) fn number(value: f64) -> String {
    let size = value.abs();
    if size < 1e-12 {
        "0".to_owned()
    } else if (1e-3..1e5).contains(&size) {
        let decimals = (3 - size.log10().floor() as i32).clamp(0, 6) as usize;
        let text = format!("{value:.decimals$}");
        if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        } else {
            text
        }
    } else {
        let text = format!("{value:.1e}");
        text.replace(".0e", "e")
    }
}

/// To two digits: a stretched bar has its ticks at odd values.
pub(super) fn rounded(value: f64) -> f64 {
    if value == 0.0 {
        return 0.0;
    }
    let unit = 10f64.powf(value.abs().log10().floor() - 1.0);
    (value / unit).round() * unit
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
    fn numbers_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (0.1, "0.1"),
            (1.5, "1.5"),
            (0.001, "0.001"),
            (1e-4, "1e-4"),
            (2.5e-7, "2.5e-7"),
            (9216.0, "9216"),
            (-0.05, "-0.05"),
            (1e6, "1e6"),
        ] {
            assert_eq!(number(value), text);
        }
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
