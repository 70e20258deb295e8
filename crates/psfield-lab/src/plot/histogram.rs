//! Histograms with bins of equal width, and figures that compare them.

use plotters::chart::SeriesLabelPosition;
use plotters::prelude::{AreaSeries, LineSeries, Rectangle};
use plotters::style::Color;
use serde::Serialize;

use crate::plot::axes::{bounds, draw_legend, even_chart};
use crate::plot::colours::SERIES;
use crate::plot::figure::{Figure, PlotError};

/// Counts of values in bins of equal width. A value on the edge between two bins counts in the
/// upper bin. A value at the upper end of the range counts in the last bin.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Histogram {
    low: f64,
    high: f64,
    /// Number of values in each bin.
    pub counts: Vec<usize>,
    /// Number of values that lie outside the range or are not finite.
    pub outside: usize,
}

impl Histogram {
    /// Counts `values` in `bins` bins (at least one) from `low` to `high`. Values that lie outside
    /// this range or are not finite are counted in [`outside`](Self::outside).
    pub fn new(values: impl IntoIterator<Item = f64>, (low, high): (f64, f64), bins: usize) -> Self {
        let bins = bins.max(1);
        let mut histogram = Self {
            low,
            high,
            counts: vec![0; bins],
            outside: 0,
        };
        for value in values {
            if value >= low && value <= high {
                let bin = ((value - low) / (high - low) * bins as f64) as usize;
                histogram.counts[bin.min(bins - 1)] += 1;
            } else {
                histogram.outside += 1;
            }
        }
        histogram
    }

    /// Makes a histogram of each list. All have equal bins, over the range of all lists together.
    pub fn of_all<const N: usize>(lists: [&[f64]; N], bins: usize) -> [Self; N] {
        let (low, high) = bounds(lists.iter().flat_map(|list| list.iter().copied()));
        let range = if low < high {
            (low, high)
        } else if low == high {
            (low - 0.5, high + 0.5)
        } else {
            (0.0, 1.0)
        };
        lists.map(|list| Self::new(list.iter().copied(), range, bins))
    }

    /// The lower edge of the first and the upper edge of the last bin.
    pub fn range(&self) -> (f64, f64) {
        (self.low, self.high)
    }

    /// The lower edge of a bin. For the index after the last bin: the upper edge of the last bin.
    pub fn edge(&self, bin: usize) -> f64 {
        self.low + (self.high - self.low) * bin as f64 / self.counts.len() as f64
    }
}

/// Histograms over one pair of axes, with equal bins.
#[derive(Debug, Clone)]
pub struct HistogramPanel<'a> {
    /// The quantity, with its unit.
    pub quantity: &'a str,
    /// Name and counts of each histogram.
    pub histograms: Vec<(&'a str, &'a Histogram)>,
}

const PANEL: (u32, u32) = (560, 420);

/// Draws panels, two per row.
///
/// # Errors
/// [`PlotError`] when the drawing fails.
pub fn histograms(panels: &[HistogramPanel<'_>]) -> Result<Figure, PlotError> {
    let across = panels.len().clamp(1, 2);
    let down = panels.len().div_ceil(across).max(1);
    let size = (across as u32 * PANEL.0, down as u32 * PANEL.1);
    Figure::draw(size, |root| {
        for (panel, area) in panels.iter().zip(root.split_evenly((down, across))) {
            let counts = panel.histograms.iter().flat_map(|(_, h)| &h.counts);
            let most = counts.copied().max().unwrap_or(0).max(1) as f64;
            let Some((_, first)) = panel.histograms.first() else {
                continue;
            };
            let (low, high) = first.range();
            // Room above the bars, so that the legend covers none of them.
            let axes = [(panel.quantity, low..high), ("objects per bin", 0.0..most * 1.25)];
            let mut chart = even_chart(&area, axes)?;
            for (n, ((name, histogram), colour)) in panel.histograms.iter().zip(SERIES).enumerate() {
                let steps = outline(histogram);
                // The first histogram is filled and the others are lines, so that all of them are
                // visible where they are equal.
                if n == 0 {
                    chart.draw_series(AreaSeries::new(steps.clone(), 0.0, colour.mix(0.3)))?;
                }
                let (width, half, part) = if n == 0 { (1, 6, 0.3) } else { (2, 1, 1.0) };
                let line = chart.draw_series(LineSeries::new(steps, colour.stroke_width(width)))?;
                if panel.histograms.len() > 1 {
                    line.label(*name).legend(move |(x, y)| {
                        Rectangle::new([(x, y - half), (x + 22, y + half)], colour.mix(part).filled())
                    });
                }
            }
            if panel.histograms.len() > 1 {
                draw_legend(&mut chart, SeriesLabelPosition::UpperRight)?;
            }
        }
        Ok(Vec::new())
    })
}

/// The corners of a histogram's outline.
fn outline(histogram: &Histogram) -> Vec<(f64, f64)> {
    let mut corners = vec![(histogram.range().0, 0.0)];
    for (bin, &count) in histogram.counts.iter().enumerate() {
        corners.extend([bin, bin + 1].map(|edge| (histogram.edge(edge), count as f64)));
    }
    corners.push((histogram.range().1, 0.0));
    corners
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_counts_once() {
        let histogram = Histogram::new([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, -0.1, f64::NAN], (0.0, 2.0), 2);
        assert_eq!(histogram.counts, [2, 3]);
        assert_eq!(histogram.outside, 3);
        assert_eq!(
            (histogram.edge(0), histogram.edge(1), histogram.edge(2)),
            (0.0, 1.0, 2.0)
        );
    }

    #[test]
    fn lists_share_their_bins() {
        let [a, b] = Histogram::of_all([&[1.0, 2.0], &[5.0]], 4);
        assert_eq!(a.range(), (1.0, 5.0));
        assert_eq!(a.range(), b.range());
        assert_eq!(b.counts, [0, 0, 0, 1]);
        let [one] = Histogram::of_all([&[3.0, 3.0]], 3);
        assert_eq!(one.counts.iter().sum::<usize>(), 2);
        let [none] = Histogram::of_all([&[]], 3);
        assert!(none.range().0 < none.range().1);
    }
}
