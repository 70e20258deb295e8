//! Histograms with bins of equal width, and charts that compare them.

use serde::Serialize;

use super::axis::bounds;
use super::{Axis, Chart, Curve};

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
        let (mut counts, mut outside) = (vec![0; bins], 0);
        for value in values {
            if (low..=high).contains(&value) {
                let bin = ((value - low) / (high - low) * bins as f64) as usize;
                counts[bin.min(bins - 1)] += 1;
            } else {
                outside += 1;
            }
        }
        Self {
            low,
            high,
            counts,
            outside,
        }
    }

    /// Makes a histogram of each list. All have equal bins, over the range of all lists together.
    pub fn of_all<const N: usize>(lists: [&[f64]; N], bins: usize) -> [Self; N] {
        let range = match bounds(lists.concat().into_iter()) {
            (low, high) if low < high => (low, high),
            (low, high) if low == high => (low - 0.5, high + 0.5),
            _ => (0.0, 1.0),
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

    /// The corners of the outline.
    fn outline(&self) -> Vec<(f64, f64)> {
        let tops = self.counts.iter().enumerate();
        let tops = tops.flat_map(|(bin, &count)| [bin, bin + 1].map(|edge| (self.edge(edge), count as f64)));
        std::iter::once((self.low, 0.0))
            .chain(tops)
            .chain([(self.high, 0.0)])
            .collect()
    }
}

impl Chart {
    /// A chart of histograms with equal bins, each with its name. The first histogram is filled and the
    /// others are lines, so that all of them are visible where they are equal. `quantity` has the unit.
    pub fn histograms(quantity: &str, histograms: &[(&str, &Histogram)]) -> Self {
        let curves = histograms.iter().enumerate().map(|(k, (name, histogram))| Curve {
            filled: k == 0,
            ..Curve::new(name, histogram.outline())
        });
        let (low, high) = histograms.first().map_or((0.0, 1.0), |(_, first)| first.range());
        let counts = histograms.iter().flat_map(|(_, histogram)| &histogram.counts);
        let most = counts.copied().max().unwrap_or(0).max(1) as f64;
        let y = Axis::linear("objects per bin").within(0.0, most * 1.05);
        Self::new("", Axis::linear(quantity).within(low, high), y, curves.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_counts_once() {
        let histogram = Histogram::new([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, -0.1, f64::NAN], (0.0, 2.0), 2);
        assert_eq!(histogram.counts, [2, 3]);
        assert_eq!(histogram.outside, 3);
        assert_eq!([0, 1, 2].map(|bin| histogram.edge(bin)), [0.0, 1.0, 2.0]);
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
