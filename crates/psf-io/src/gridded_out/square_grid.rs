//! A grid with the same values in x and in y.

use ndarray::Array2;
use psf_types::{Position, PsfSamples};

use crate::GriddedError;

/// The most planes that are written: readers look at a card for each.
const MAX_PLANES: usize = 10_000;

/// The crossings of lines with the same values in x and in y, and what each of them is made of.
#[derive(Debug)]
pub(super) struct SquareGrid {
    /// x and y of the samples, ascending.
    xs: Vec<f64>,
    ys: Vec<f64>,
    /// The sample at each crossing of `ys` and `xs`, x fastest.
    sample_at: Vec<usize>,
    /// The values of both, ascending.
    lines: Vec<f64>,
    /// A single sample stays one, wherever it lies.
    single: Option<Position>,
}

/// A line between two of an axis: their indices and the weight of the second.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Between {
    below: usize,
    above: usize,
    weight: f64,
}

impl SquareGrid {
    pub(super) fn of(samples: &PsfSamples) -> Result<Self, GriddedError> {
        let positions = samples.positions().as_slice();
        let xs = ascending(positions.iter().map(|p| p.x()));
        let ys = ascending(positions.iter().map(|p| p.y()));
        if xs.len().checked_mul(ys.len()) != Some(positions.len()) {
            return Err(GriddedError::NotAGrid {
                samples: positions.len(),
                columns: xs.len(),
                rows: ys.len(),
            });
        }
        // Positions are distinct: as many as there are crossings fill them all.
        let mut sample_at = vec![0; positions.len()];
        let index = |lines: &[f64], v: f64| lines.partition_point(|&line| line < v);
        for (sample, position) in positions.iter().enumerate() {
            sample_at[index(&ys, position.y()) * xs.len() + index(&xs, position.x())] = sample;
        }
        let lines = ascending(xs.iter().chain(&ys).copied());
        let grid = Self {
            single: (positions.len() == 1).then(|| positions[0]),
            xs,
            ys,
            sample_at,
            lines,
        };
        match grid.planes() {
            planes if planes > MAX_PLANES && grid.is_refined() => Err(GriddedError::TooManyPlanes {
                planes,
                limit: MAX_PLANES,
            }),
            _ => Ok(grid),
        }
    }

    /// Number of planes: one for each crossing.
    pub(super) fn planes(&self) -> usize {
        match self.single {
            Some(_) => 1,
            None => self.lines.len() * self.lines.len(),
        }
    }

    /// Whether there are crossings without a sample.
    pub(super) fn is_refined(&self) -> bool {
        self.planes() != self.sample_at.len()
    }

    /// Number of different x of the samples.
    pub(super) fn columns(&self) -> usize {
        self.xs.len()
    }

    /// Number of different y of the samples.
    pub(super) fn rows(&self) -> usize {
        self.ys.len()
    }

    /// (x, y) of a plane; x is fastest.
    pub(super) fn position(&self, plane: usize) -> (f64, f64) {
        match self.single {
            Some(position) => (position.x(), position.y()),
            None => (
                self.lines[plane % self.lines.len()],
                self.lines[plane / self.lines.len()],
            ),
        }
    }

    /// The planes in the order in which their cards stand in the header: in the place of plane (x, y) the card of plane (y, x).
    pub(super) fn card_order(&self) -> impl Iterator<Item = usize> {
        let side = match self.single {
            Some(_) => 1,
            None => self.lines.len(),
        };
        (0..self.planes()).map(move |place| place % side * side + place / side)
    }

    /// The stamp `[y, x]` of a plane.
    pub(super) fn stamp(&self, samples: &PsfSamples, plane: usize) -> Array2<f64> {
        let mut stamp = Array2::zeros(samples.grid().dim());
        let (x, y) = self.position(plane);
        let (x, y) = (between(&self.xs, x), between(&self.ys, y));
        let corners = [
            (x.below, y.below, (1.0 - x.weight) * (1.0 - y.weight)),
            (x.above, y.below, x.weight * (1.0 - y.weight)),
            (x.below, y.above, (1.0 - x.weight) * y.weight),
            (x.above, y.above, x.weight * y.weight),
        ];
        for (i, j, weight) in corners {
            // A sample itself stays as it is, bit by bit.
            if weight != 0.0 {
                let sample = self.sample_at[j * self.xs.len() + i];
                stamp.scaled_add(weight, &samples.stamp(sample));
            }
        }
        stamp
    }
}

/// The different values, ascending.
fn ascending(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}

/// Where a value lies among lines; outside, on the nearest.
fn between(lines: &[f64], value: f64) -> Between {
    let above = lines.partition_point(|&line| line < value).min(lines.len() - 1);
    let below = above.saturating_sub(1);
    let weight = if above == below || value >= lines[above] {
        1.0
    } else {
        (value - lines[below]) / (lines[above] - lines[below])
    };
    Between { below, above, weight }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_lies_on_a_line_between_two_or_on_the_nearest_outside() {
        let lines = [1.0, 2.0, 6.0];
        let found = |value| {
            let b = between(&lines, value);
            lines[b.below] * (1.0 - b.weight) + lines[b.above] * b.weight
        };
        for (value, expected) in [
            (-3.0, 1.0),
            (1.0, 1.0),
            (1.25, 1.25),
            (2.0, 2.0),
            (5.0, 5.0),
            (6.0, 6.0),
            (9.0, 6.0),
        ] {
            assert!(
                (found(value) - expected).abs() < 1e-15,
                "{value}: {}",
                found(value)
            );
        }
        let exact = between(&lines, 2.0);
        assert_eq!((exact.above, exact.weight), (1, 1.0));
        assert_eq!(between(&[4.0], 7.0).weight, 1.0);
    }
}
