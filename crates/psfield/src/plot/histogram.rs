//! Histograms that are compared.

use plotters::chart::{ChartBuilder, SeriesLabelPosition};
use plotters::prelude::{AreaSeries, LineSeries, PathElement};
use plotters::style::Color;

use super::axes::{LABEL_ROOM_X, LABEL_ROOM_Y, MARGIN, draw_axes, draw_key};
use super::colours::SERIES;
use super::figure::{Figure, PlotError};
use crate::report::Histogram;

/// Histograms over one pair of axes, with the same bins.
#[derive(Debug, Clone)]
pub struct HistogramPanel<'a> {
    /// The quantity, with its unit.
    pub quantity: &'a str,
    /// Name and counts of each.
    pub histograms: Vec<(&'a str, &'a Histogram)>,
}

const PANEL: (u32, u32) = (560, 420);

/// Panels side by side, two in a row.
///
/// # Errors
/// [`PlotError`] when the drawing fails.
pub fn histograms(panels: &[HistogramPanel<'_>]) -> Result<Figure, PlotError> {
    let across = panels.len().clamp(1, 2);
    let down = panels.len().div_ceil(across).max(1);
    let size = (across as u32 * PANEL.0, down as u32 * PANEL.1);
    Figure::draw(size, |root| {
        for (panel, area) in panels.iter().zip(root.split_evenly((down, across))) {
            let most = panel
                .histograms
                .iter()
                .flat_map(|(_, h)| h.counts().iter().copied())
                .max()
                .unwrap_or(0)
                .max(1) as f64;
            let Some((_, first)) = panel.histograms.first() else {
                continue;
            };
            let (low, high) = first.range();
            let mut chart = ChartBuilder::on(&area)
                .margin(MARGIN)
                .x_label_area_size(LABEL_ROOM_X)
                .y_label_area_size(LABEL_ROOM_Y)
                .build_cartesian_2d(low..high, 0.0..most * 1.08)?;
            draw_axes(&mut chart, panel.quantity, "objects in a bin")?;
            for (n, ((name, histogram), colour)) in panel.histograms.iter().zip(SERIES).enumerate() {
                let steps = outline(histogram);
                // The first is filled, the others are lines, so that equal histograms both show.
                if n == 0 {
                    chart.draw_series(AreaSeries::new(steps.clone(), 0.0, colour.mix(0.3)))?;
                }
                let width = if n == 0 { 1 } else { 2 };
                let line = chart.draw_series(LineSeries::new(steps, colour.stroke_width(width)))?;
                if panel.histograms.len() > 1 {
                    line.label(*name).legend(move |(x, y)| {
                        PathElement::new(vec![(x, y), (x + 22, y)], colour.stroke_width(3))
                    });
                }
            }
            if panel.histograms.len() > 1 {
                draw_key(&mut chart, SeriesLabelPosition::UpperRight)?;
            }
        }
        Ok(Vec::new())
    })
}

/// The corners of a histogram.
fn outline(histogram: &Histogram) -> Vec<(f64, f64)> {
    let mut corners = vec![(histogram.range().0, 0.0)];
    for (bin, &count) in histogram.counts().iter().enumerate() {
        corners.extend([
            (histogram.edge(bin), count as f64),
            (histogram.edge(bin + 1), count as f64),
        ]);
    }
    corners.push((histogram.range().1, 0.0));
    corners
}
