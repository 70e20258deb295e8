//! The cubic spline between the nodes of an oversampled PSF.

use ndarray::Array2;
use psf_types::maths::{spline_slopes, spline_weights};

use crate::registration::FineGrid;

/// Number of rows and columns of B-spline coefficients before the grid.
const TAPS_BEFORE: usize = 1;
/// Number of rows and columns of B-spline coefficients after the grid. The second one always has
/// weight 0.
const TAPS_AFTER: usize = 2;

/// Weights of the coefficients before, at and after a node for the value of a cubic B-spline there.
const NODE: [f64; 3] = [1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0];

/// The layout of the B-spline coefficients of a PSF on a grid, row by row, with a border.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfaceGrid {
    pub(crate) grid: FineGrid,
}

/// The coefficients that determine the PSF at one point: the first of 4 x 4 coefficients, their
/// weights along x and y, and their weights in the derivatives.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    pub(crate) first: usize,
    pub(crate) weights: [[f64; 4]; 2],
    slopes: [[f64; 4]; 2],
}

impl SurfaceGrid {
    pub(crate) fn new(grid: FineGrid) -> Self {
        Self { grid }
    }

    pub(crate) fn side(self) -> usize {
        self.grid.side() + TAPS_BEFORE + TAPS_AFTER
    }

    pub(crate) fn len(self) -> usize {
        self.side() * self.side()
    }

    /// Returns the coefficients and weights for the point at the offset `(dx, dy)` from the star in
    /// pixels of the frame, if it is on the grid.
    pub(crate) fn place(self, dx: f64, dy: f64) -> Option<Place> {
        let (scale, middle) = (self.grid.scale as f64, self.grid.middle() as f64);
        let (tx, ty) = (middle + scale * dx, middle + scale * dy);
        let last = 2.0 * middle;
        ((0.0..=last).contains(&tx) && (0.0..=last).contains(&ty)).then(|| {
            // The coefficient before the one of the node at or below `t`.
            let first = |t: f64| t.floor() as usize + TAPS_BEFORE - 1;
            let within = [tx - tx.floor(), ty - ty.floor()];
            Place {
                first: first(ty) * self.side() + first(tx),
                weights: within.map(spline_weights),
                slopes: within.map(spline_slopes),
            }
        })
    }

    /// The offset of every coefficient from the star in pixels of the frame, in the order of the
    /// coefficients.
    pub(crate) fn offsets(self) -> impl Iterator<Item = (f64, f64)> {
        let (side, middle, scale) = (self.side(), self.grid.middle() as f64, self.grid.scale as f64);
        let offset = move |k: usize| (k as f64 - TAPS_BEFORE as f64 - middle) / scale;
        (0..side * side).map(move |k| (offset(k % side), offset(k / side)))
    }

    pub(crate) fn value(self, coefficients: &[f64], place: &Place) -> f64 {
        self.weighted(coefficients, place.first, place.weights)
    }

    /// The derivatives with respect to the offset, in values per pixel of the frame.
    pub(crate) fn slopes(self, coefficients: &[f64], place: &Place) -> (f64, f64) {
        let scale = self.grid.scale as f64;
        (
            scale * self.weighted(coefficients, place.first, [place.slopes[0], place.weights[1]]),
            scale * self.weighted(coefficients, place.first, [place.weights[0], place.slopes[1]]),
        )
    }

    fn weighted(self, coefficients: &[f64], first: usize, [wx, wy]: [[f64; 4]; 2]) -> f64 {
        let side = self.side();
        let line = |j: usize| -> f64 {
            let at = first + j * side;
            coefficients[at..at + 4].iter().zip(&wx).map(|(c, w)| c * w).sum()
        };
        wy.iter().enumerate().map(|(j, w)| w * line(j)).sum()
    }

    /// The values at the nodes `[y, x]`.
    pub(crate) fn at_nodes(self, coefficients: &[f64]) -> Array2<f64> {
        let (n, side) = (self.grid.side(), self.side());
        Array2::from_shape_fn((n, n), |(j, i)| {
            let mut sum = 0.0;
            for (dj, wy) in NODE.iter().enumerate() {
                for (di, wx) in NODE.iter().enumerate() {
                    sum += wx * wy * coefficients[(j + dj) * side + i + di];
                }
            }
            sum
        })
    }

    /// The largest coefficient, about the PSF's peak.
    pub(crate) fn peak(coefficients: &[f64]) -> f64 {
        coefficients.iter().copied().fold(0.0, f64::max)
    }

    /// The flux of a PSF: the sum over its nodes divided by the number of nodes per pixel.
    pub(crate) fn flux(self, coefficients: &[f64]) -> f64 {
        self.at_nodes(coefficients).sum() / (self.grid.scale * self.grid.scale) as f64
    }

    /// For each pixel phase of the grid along one axis, the weights of the coefficients in the sum
    /// over the nodes with this phase. The two outermost nodes lie on opposite edges of the stamp
    /// and count half.
    pub(crate) fn phase_weights(self) -> Vec<Vec<f64>> {
        let (scale, last) = (self.grid.scale, self.grid.side() - 1);
        let mut weights = vec![vec![0.0; self.side()]; scale];
        for node in 0..=last {
            let part = if node == 0 || node == last { 0.5 } else { 1.0 };
            for (before, weight) in NODE.iter().enumerate() {
                weights[node % scale][node + before] += part * weight;
            }
        }
        weights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> SurfaceGrid {
        SurfaceGrid::new(FineGrid { reach: 3, scale: 2 })
    }

    fn bumpy() -> Vec<f64> {
        (0..grid().len()).map(|k| ((k * 29) % 31) as f64 - 11.0).collect()
    }

    #[test]
    fn nodes_slopes_and_the_transpose_agree_with_values() {
        let (surface, c) = (grid(), bumpy());
        let nodes = surface.at_nodes(&c);
        for (j, i) in [(0, 0), (12, 12), (3, 7)] {
            let at = |k: usize| (k as f64 - 6.0) / 2.0;
            let place = surface.place(at(i), at(j)).unwrap();
            assert!((surface.value(&c, &place) - nodes[[j, i]]).abs() < 1e-12);
        }
        let step = 1e-6;
        let value = |x: f64, y: f64| surface.value(&c, &surface.place(x, y).unwrap());
        let (x, y) = (0.31, -1.77);
        let place = surface.place(x, y).unwrap();
        let (sx, sy) = surface.slopes(&c, &place);
        assert!((sx - (value(x + step, y) - value(x - step, y)) / (2.0 * step)).abs() < 1e-6);
        assert!((sy - (value(x, y + step) - value(x, y - step)) / (2.0 * step)).abs() < 1e-6);
        assert!(surface.place(3.01, 0.0).is_none());
    }
}
