//! Ascending lines across one coordinate.

use crate::geometry::Outside;

/// The lines of a grid along one axis.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Axis {
    /// Ascending.
    pub(crate) lines: Vec<f64>,
    /// How far a sample lies off its line at most.
    pub(crate) scatter: f64,
}

/// Lines with less scatter than this part of a cell move no weight by more than rounding.
const HARMLESS: f64 = 1e-13;

impl Axis {
    /// The lines, and each coordinate's line.
    pub(crate) fn new(coordinates: Vec<f64>, tolerance: f64) -> (Self, Vec<usize>) {
        let mut order: Vec<usize> = (0..coordinates.len()).collect();
        order.sort_by(|&a, &b| coordinates[a].total_cmp(&coordinates[b]));
        let mut axis = Self {
            lines: Vec::new(),
            scatter: 0.0,
        };
        let mut line_of = vec![0; coordinates.len()];
        for group in order.chunk_by(|&a, &b| coordinates[b] - coordinates[a] <= tolerance) {
            let (first, last) = (coordinates[group[0]], coordinates[group[group.len() - 1]]);
            let line = if first == last {
                first
            } else {
                // A mean of differences keeps the digits of large coordinates.
                let mean = group.iter().map(|&i| coordinates[i] - first).sum::<f64>() / group.len() as f64;
                first + mean
            };
            for &i in group {
                line_of[i] = axis.lines.len();
            }
            axis.scatter = axis.scatter.max(line - first).max(last - line);
            axis.lines.push(line);
        }
        (axis, line_of)
    }

    /// The cell around a coordinate, its lower line, and the part of the upper one: `v = (1 - t) lower + t upper`. Cell 0
    /// and part 0 where there is one line only.
    pub(crate) fn locate(&self, v: f64) -> (usize, f64) {
        let last = self.lines.len() - 1;
        if last == 0 {
            return (0, 0.0);
        }
        let cell = self.cell(v);
        let (a, b) = (self.lines[cell], self.lines[cell + 1]);
        // Samples that scatter about their line still get their own value.
        if (v - a).abs() <= self.scatter {
            (cell, 0.0)
        } else if (v - b).abs() <= self.scatter {
            (cell, 1.0)
        } else {
            (cell, (v - a) / (b - a))
        }
    }

    /// The cell around a coordinate, or the one next to it; there are at least two lines.
    fn cell(&self, v: f64) -> usize {
        let last = self.lines.len() - 1;
        self.lines.partition_point(|&line| line <= v).clamp(1, last) - 1
    }

    /// Where the parts that [`Self::locate`] gives stop to be linear: they are for the whole numbers from `v` on that
    /// are below the result, and for `v` alone where that is not above it. With `clamped` coordinates are first clamped.
    pub(crate) fn linear_until(&self, v: f64, clamped: bool) -> f64 {
        let (last, low) = (self.lines.len() - 1, self.lines[0]);
        if last == 0 {
            return f64::INFINITY;
        }
        if clamped && v < low {
            return low;
        }
        if clamped && v > self.lines[last] {
            return f64::INFINITY;
        }
        let cell = self.cell(v);
        let (a, b) = (self.lines[cell], self.lines[cell + 1]);
        let mut until = match (cell + 1 == last, clamped) {
            (false, _) => b,
            (true, true) => b.floor() + 1.0,
            (true, false) => f64::INFINITY,
        };
        if self.scatter > HARMLESS * (b - a) {
            let is_moved = |v: f64, line: f64| (v - line).abs() <= self.scatter;
            if is_moved(v, a) || is_moved(v, b) {
                return v;
            }
            for line in [a, b] {
                if v < line {
                    until = until.min((line - self.scatter).ceil());
                    // The bound itself is rounded.
                    while until > v && is_moved(until - 1.0, line) {
                        until -= 1.0;
                    }
                }
            }
        }
        until
    }

    /// Whether weights are linear from line to line but for rounding.
    pub(crate) fn scatter_is_harmless(&self) -> bool {
        let cells = self.lines.windows(2).map(|line| line[1] - line[0]);
        self.scatter <= HARMLESS * cells.fold(f64::INFINITY, f64::min)
    }

    /// Where a coordinate is looked up: the nearest that the lines cover, or itself where they are extended.
    pub(crate) fn place(&self, v: f64, outside: Outside) -> f64 {
        if outside == Outside::Extend {
            v
        } else {
            self.clamp(v)
        }
    }

    /// The nearest coordinate that the lines cover.
    pub(crate) fn clamp(&self, v: f64) -> f64 {
        v.clamp(self.lines[0], self.lines[self.lines.len() - 1])
    }
}
