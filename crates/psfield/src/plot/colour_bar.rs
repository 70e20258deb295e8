//! The bar that says which colour means what.

use image::{Rgb, RgbImage};
use plotters::chart::ChartBuilder;

use super::axes::{MARGIN, TEXT, TITLE, number};
use super::colours::ColourMap;
use super::figure::{Area, Overlay, PlotError};

/// Width of the area that a bar takes, its numbers and name included.
pub(super) const BAR_AREA: u32 = 150;
const BAR: u32 = 18;

/// Draws a bar at the left of `area`, between `top` and `bottom`, for values from `low` to `high`. `shown` makes a number of the axis
/// the text beside it.
pub(super) fn colour_bar(
    area: &Area<'_>,
    (top, bottom): (u32, u32),
    map: ColourMap,
    (low, high): (f64, f64),
    name: &str,
    shown: &dyn Fn(f64) -> String,
) -> Result<Overlay, PlotError> {
    let right = area.dim_in_pixel().0.saturating_sub(BAR + MARGIN + 78);
    let mut chart = ChartBuilder::on(area)
        .margin_top(top)
        .margin_bottom(bottom)
        .margin_right(right)
        .margin_left(MARGIN)
        .right_y_label_area_size(78)
        .build_cartesian_2d(0.0..1.0, 0.0..1.0)?
        .set_secondary_coord(0.0..1.0, low..high);
    chart
        .configure_secondary_axes()
        .y_labels(6)
        .y_desc(name)
        .label_style(("sans-serif", TEXT))
        .axis_desc_style(("sans-serif", TITLE))
        .y_label_formatter(&|v| shown(*v))
        .draw()?;
    let (x, y) = chart.plotting_area().get_pixel_range();
    let height = (y.end - y.start).max(1) as u32;
    Ok(Overlay {
        left: x.start,
        top: y.start,
        width: (x.end - x.start).max(1) as u32,
        height,
        pixels: RgbImage::from_fn(1, height, |_, row| {
            Rgb(map.at(1.0 - f64::from(row) / f64::from(height.max(2) - 1)))
        }),
    })
}

/// Plain numbers beside a bar.
pub(super) fn plain(value: f64) -> String {
    number(value)
}
