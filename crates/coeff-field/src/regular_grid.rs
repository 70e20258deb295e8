//! Samples on a regular grid.

use std::collections::HashMap;

use psf_types::{Position, SamplePositions};

use crate::CoeffFieldError;
use crate::axis::Axis;
use crate::geometry::Points;

/// Columns and rows of samples: every x of a list with every y of another, each once, in any order.
///
/// The spacing may vary (a rectilinear grid); one row, one column and a single sample count. Coordinates that differ by at
/// most 1e-9 of the samples' extent are taken as the same column or row, at the mean of its samples' coordinates.
///
/// ```
/// use coeff_field::RegularGrid;
/// use psf_types::{Position, SamplePositions};
/// let nodes = [(0, 0), (0, 5), (9, 5), (2, 0), (9, 0), (2, 5)].map(|(x, y)| Position::of_pixel(x, y));
/// let grid = RegularGrid::detect(&SamplePositions::new(nodes.to_vec(), None)?)?;
/// assert_eq!((grid.xs(), grid.ys()), (&[0.0, 2.0, 9.0][..], &[0.0, 5.0][..]));
/// assert_eq!(grid.sample(2, 1), 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct RegularGrid {
    x: Axis,
    y: Axis,
    /// Row by row.
    samples: Vec<usize>,
    /// How far outside a position still counts as covered.
    covered: f64,
}

/// Coordinates closer than this are one line, relative to the samples' extent.
const SAME_LINE: f64 = 1e-9;

impl RegularGrid {
    /// Finds the columns and rows of samples.
    ///
    /// # Errors
    /// [`CoeffFieldError::NotRegular`] with the first node that has no sample, [`CoeffFieldError::SharedNode`] when one
    /// has two.
    pub fn detect(positions: &SamplePositions) -> Result<Self, CoeffFieldError> {
        let points = Points::new(positions)?;
        let tolerance = SAME_LINE * points.scale.extent;
        let (x, columns) = Axis::new(points.points.iter().map(|p| p[0]).collect(), tolerance);
        let (y, rows) = Axis::new(points.points.iter().map(|p| p[1]).collect(), tolerance);
        let width = x.lines.len();
        let mut nodes = HashMap::with_capacity(points.len());
        for (sample, (&column, &row)) in columns.iter().zip(&rows).enumerate() {
            if let Some(first) = nodes.insert(row * width + column, sample) {
                return Err(CoeffFieldError::SharedNode {
                    first,
                    second: sample,
                    column,
                    row,
                    position: positions.as_slice()[sample],
                });
            }
        }
        // No node is taken twice, so one is free unless their numbers agree. It comes early: samples.len() of them are taken.
        let mut samples = Vec::with_capacity(points.len());
        for node in 0..width * y.lines.len() {
            let (column, row) = (node % width, node / width);
            let sample = nodes.get(&node).ok_or_else(|| CoeffFieldError::NotRegular {
                samples: points.len(),
                columns: width,
                rows: y.lines.len(),
                column,
                row,
                position: Position::new(x.lines[column], y.lines[row])
                    .expect("samples have finite coordinates"),
            })?;
            samples.push(*sample);
        }
        Ok(Self {
            x,
            y,
            samples,
            covered: points.scale.covered,
        })
    }

    /// The x coordinates of the columns, ascending.
    pub fn xs(&self) -> &[f64] {
        &self.x.lines
    }

    /// The y coordinates of the rows, ascending.
    pub fn ys(&self) -> &[f64] {
        &self.y.lines
    }

    /// The sample at a node.
    ///
    /// # Panics
    /// When there is no such column or row.
    pub fn sample(&self, column: usize, row: usize) -> usize {
        assert!(
            column < self.x.lines.len(),
            "column {column} of {}",
            self.x.lines.len()
        );
        self.samples[row * self.x.lines.len() + column]
    }

    pub(crate) fn x(&self) -> &Axis {
        &self.x
    }

    pub(crate) fn y(&self) -> &Axis {
        &self.y
    }

    pub(crate) fn covered(&self) -> f64 {
        self.covered
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn positions(points: &[(f64, f64)]) -> SamplePositions {
        let positions = points.iter().map(|&(x, y)| Position::new(x, y).unwrap());
        SamplePositions::new(positions.collect(), None).unwrap()
    }

    #[test]
    fn the_missing_node_is_named() {
        let mut points: Vec<(f64, f64)> = (0..12)
            .map(|i| (f64::from(i % 4) * 10.0, f64::from(i / 4)))
            .collect();
        points.remove(6);
        let error = RegularGrid::detect(&positions(&points)).unwrap_err();
        match error {
            CoeffFieldError::NotRegular {
                samples: 11,
                columns: 4,
                rows: 3,
                column: 2,
                row: 1,
                position,
            } => assert_eq!((position.x(), position.y()), (20.0, 1.0)),
            other => panic!("{other}"),
        }
    }

    #[test]
    fn rounded_coordinates_make_one_line() {
        let noise = |i: i32| f64::from(i * 7 % 3 - 1) * 1e-13;
        let points: Vec<(f64, f64)> = (0..25)
            .map(|i| (f64::from(i % 5) + noise(i), f64::from(i / 5) - noise(i + 1)))
            .collect();
        let grid = RegularGrid::detect(&positions(&points)).unwrap();
        assert_eq!((grid.xs().len(), grid.ys().len()), (5, 5));
        assert!(grid.x().scatter > 0.0 && grid.x().scatter < 1e-12);
        assert_eq!(grid.sample(3, 2), 13);
    }

    #[test]
    fn two_samples_at_one_node_are_named() {
        let points = [(0.0, 0.0), (10.0, 0.0), (0.0, 10.0), (10.0, 10.0), (1e-9, 0.0)];
        assert!(matches!(
            RegularGrid::detect(&positions(&points)),
            Err(CoeffFieldError::SharedNode {
                first: 0,
                second: 4,
                column: 0,
                row: 0,
                ..
            })
        ));
    }

    #[test]
    fn rows_columns_and_points_are_grids() {
        for points in [
            &[(3.0, 1.0)][..],
            &[(0.0, 5.0), (9.0, 5.0), (4.0, 5.0)],
            &[(1.0, 2.0), (1.0, 0.0)],
        ] {
            assert!(RegularGrid::detect(&positions(points)).is_ok());
        }
        assert!(RegularGrid::detect(&positions(&[(0.0, 0.0), (1.0, 1.0)])).is_err());
    }
}
