//! Rows of pixels.

use psf_types::Position;

use crate::geometry::Point;

/// Neighbouring pixels of one row; columns count from its start.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    x: i64,
    y: i64,
    length: usize,
}

impl Row {
    pub(crate) fn new((x, y): (i64, i64), length: usize) -> Self {
        Self { x, y, length }
    }

    pub(crate) fn length(self) -> usize {
        self.length
    }

    pub(crate) fn y(self) -> f64 {
        self.y as f64
    }

    pub(crate) fn x(self, column: usize) -> f64 {
        (self.x + column as i64) as f64
    }

    pub(crate) fn position(self, column: usize) -> Position {
        Position::of_pixel(self.x + column as i64, self.y)
    }

    /// A whole number is never out of the range of coordinates.
    pub(crate) fn point(self, column: usize) -> Point {
        [self.x(column), self.y()]
    }

    /// The first column after `column` whose x is not below `bound`, or the row's end.
    pub(crate) fn first_from(self, bound: f64, column: usize) -> usize {
        // A float to integer cast saturates.
        let ahead = (bound.ceil() - self.x(column)) as usize;
        column.saturating_add(ahead.max(1)).min(self.length)
    }

    /// The column whose x is `x`.
    pub(crate) fn column_at(self, x: f64) -> Option<usize> {
        let column = x - self.x(0);
        (column.fract() == 0.0 && (0.0..self.length as f64).contains(&column)).then_some(column as usize)
    }
}

/// A column in `start..end` that `holds`, the last of all where those that do follow `start` without a gap: by doubling
/// steps, then bisection. That `start` does is taken for granted.
pub(crate) fn last_where(start: usize, end: usize, mut holds: impl FnMut(usize) -> bool) -> usize {
    let (mut low, mut high, mut step) = (start, end, 1);
    while high - low > 1 {
        let tried = if step < high - low {
            low + step
        } else {
            usize::midpoint(low, high)
        };
        if holds(tried) {
            low = tried;
            step = step.saturating_mul(2);
        } else {
            // From here on the rest is halved.
            (high, step) = (tried, usize::MAX);
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_column_is_found_wherever_it_is_in_few_steps() {
        for start in [0, 3] {
            for length in [1, 2, 3, 10, 1000] {
                for last in start..start + length {
                    let mut asked = 0;
                    let found = last_where(start, start + length, |column| {
                        assert!(column > start && column < start + length);
                        asked += 1;
                        column <= last
                    });
                    assert_eq!(found, last, "{start} {length}");
                    assert!(asked <= 20, "{asked} of {length}");
                }
            }
        }
    }

    #[test]
    fn bounds_become_columns() {
        let row = Row::new((-5, 2), 10);
        for (bound, column, expected) in [
            (-2.5, 0, 3),
            (-2.0, 0, 3),
            (-1.999, 0, 4),
            (-7.0, 4, 5),
            (f64::INFINITY, 4, 10),
            (f64::NEG_INFINITY, 9, 10),
            (1e300, 9, 10),
        ] {
            assert_eq!(row.first_from(bound, column), expected, "{bound}");
        }
        assert_eq!(row.column_at(4.0), Some(9));
        for x in [5.0, -6.0, 0.5] {
            assert_eq!(row.column_at(x), None);
        }
    }
}
