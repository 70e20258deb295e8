//! Counts in bins of one width.

use serde::Serialize;

/// Counts of values in bins of one width. A value on an edge counts in the bin above, the upper end in the last bin.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Histogram {
    low: f64,
    high: f64,
    counts: Vec<usize>,
    outside: usize,
}

impl Histogram {
    /// Counts `values` in `bins` bins (at least one) from `low` to `high`; what is not finite or lies outside is counted apart.
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

    /// Histograms of several lists over their common range, with the same bins.
    pub fn of_all<const N: usize>(lists: [&[f64]; N], bins: usize) -> [Self; N] {
        let all = lists.iter().flat_map(|list| list.iter().copied());
        let (low, high) = all
            .filter(|v| v.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
                (l.min(v), h.max(v))
            });
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

    /// How many values are in each bin.
    pub fn counts(&self) -> &[usize] {
        &self.counts
    }

    /// How many values are in none.
    pub fn outside(&self) -> usize {
        self.outside
    }

    /// The lower edge of a bin; of one past the last, the upper end.
    pub fn edge(&self, bin: usize) -> f64 {
        self.low + (self.high - self.low) * bin as f64 / self.counts.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_counts_once() {
        let histogram = Histogram::new([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, -0.1, f64::NAN], (0.0, 2.0), 2);
        assert_eq!(histogram.counts(), [2, 3]);
        assert_eq!(histogram.outside(), 3);
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
        assert_eq!(b.counts(), [0, 0, 0, 1]);
        let [one] = Histogram::of_all([&[3.0, 3.0]], 3);
        assert_eq!(one.counts().iter().sum::<usize>(), 2);
        let [none] = Histogram::of_all([&[]], 3);
        assert!(none.range().0 < none.range().1);
    }
}
