//! A PSF between its nodes, and how it varies over the field.

use ndarray::Array2;

use crate::registration::FineGrid;
use crate::spline::Taps;

/// Rows and columns of B-spline coefficients beyond the grid: one before, two after (the second with weight 0).
const BEFORE: usize = 1;
const AFTER: usize = 2;

/// A cubic B-spline at a node, from the coefficients before, at and after it.
const NODE: [f64; 3] = [1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0];

/// The B-spline coefficients of a PSF on a grid, row by row, with a border.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfaceGrid {
    grid: FineGrid,
}

/// The coefficients that a place needs: the first of 4 x 4, and their weights along x and y.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    first: usize,
    along_x: Taps,
    along_y: Taps,
}

impl SurfaceGrid {
    pub(crate) fn new(grid: FineGrid) -> Self {
        Self { grid }
    }

    pub(crate) fn grid(self) -> FineGrid {
        self.grid
    }

    pub(crate) fn side(self) -> usize {
        self.grid.side() + BEFORE + AFTER
    }

    pub(crate) fn len(self) -> usize {
        self.side() * self.side()
    }

    /// The place at the offset `(dx, dy)` from the star in pixels of the frame, if it is on the grid.
    pub(crate) fn place(self, dx: f64, dy: f64) -> Option<Place> {
        let (scale, middle) = (self.grid.scale as f64, self.grid.middle() as f64);
        let (tx, ty) = (middle + scale * dx, middle + scale * dy);
        let last = 2.0 * middle;
        ((0.0..=last).contains(&tx) && (0.0..=last).contains(&ty)).then(|| {
            let (along_x, along_y) = (Taps::at(tx), Taps::at(ty));
            let index = |taps: &Taps| (taps.first + BEFORE as i64) as usize;
            Place {
                first: index(&along_y) * self.side() + index(&along_x),
                along_x,
                along_y,
            }
        })
    }

    /// The offsets in pixels of the frame of every coefficient, in their order.
    pub(crate) fn offsets(self) -> impl Iterator<Item = (f64, f64)> {
        let (side, middle, scale) = (self.side(), self.grid.middle() as f64, self.grid.scale as f64);
        let offset = move |k: usize| (k as f64 - BEFORE as f64 - middle) / scale;
        (0..side * side).map(move |k| (offset(k % side), offset(k / side)))
    }

    pub(crate) fn value(self, coefficients: &[f64], place: &Place) -> f64 {
        self.weighted(coefficients, place, &place.along_x.weight, &place.along_y.weight)
    }

    /// The derivatives by the offset, in values per pixel of the frame.
    pub(crate) fn slopes(self, coefficients: &[f64], place: &Place) -> (f64, f64) {
        let scale = self.grid.scale as f64;
        (
            scale * self.weighted(coefficients, place, &place.along_x.slope, &place.along_y.weight),
            scale * self.weighted(coefficients, place, &place.along_x.weight, &place.along_y.slope),
        )
    }

    fn weighted(self, coefficients: &[f64], place: &Place, wx: &[f64; 4], wy: &[f64; 4]) -> f64 {
        let side = self.side();
        let line = |j: usize| -> f64 {
            let first = place.first + j * side;
            coefficients[first..first + 4]
                .iter()
                .zip(wx)
                .map(|(c, w)| c * w)
                .sum()
        };
        wy.iter().enumerate().map(|(j, w)| w * line(j)).sum()
    }

    /// The transpose of [`value`](Self::value): adds `amount` to the coefficients that a place sees, by their weights.
    pub(crate) fn spread(self, coefficients: &mut [f64], place: &Place, amount: f64) {
        let side = self.side();
        for (j, wy) in place.along_y.weight.iter().enumerate() {
            let first = place.first + j * side;
            for (c, wx) in coefficients[first..first + 4]
                .iter_mut()
                .zip(&place.along_x.weight)
            {
                *c += amount * wy * wx;
            }
        }
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

    /// The flux of a PSF: the sum over its nodes, over the nodes of a pixel.
    pub(crate) fn flux(self, coefficients: &[f64]) -> f64 {
        self.at_nodes(coefficients).sum() / (self.grid.scale * self.grid.scale) as f64
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
        let mut spread = vec![0.0; c.len()];
        surface.spread(&mut spread, &place, 2.5);
        let product: f64 = spread.iter().zip(&c).map(|(a, b)| a * b).sum();
        assert!((product - 2.5 * surface.value(&c, &place)).abs() < 1e-10);
        assert!(surface.place(3.01, 0.0).is_none());
    }
}
