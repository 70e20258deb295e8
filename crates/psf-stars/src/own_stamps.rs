//! Each star's own pixels as its sample.

use ndarray::{Array2, ArrayView2, s};

use crate::background::median;
use crate::registration::FineGrid;
use crate::spline::Spline;
use crate::star::Star;

/// Pixels beyond the stamp that the spline sees, so that its end does not matter.
const MARGIN: usize = 3;

/// The star's pixels at the nodes of the grid, of unit flux, and its flux; nothing for a star without light.
///
/// Pixels that belong to a neighbour are replaced by those opposite the star. What the background map is off by is the median
/// along the stamp's edge. The spline passes through the pixels, so at the star's own place an oversampled stamp gives them back.
pub(crate) fn own_stamp(
    excess: ArrayView2<'_, f64>,
    star: &Star,
    trusted: impl Fn(usize, usize) -> bool,
    grid: FineGrid,
) -> Option<(Array2<f64>, f64)> {
    let (ny, nx) = excess.dim();
    let reach = (grid.reach + MARGIN) as i64;
    let (column, row) = (star.x.round() as i64, star.y.round() as i64);
    let on = |v: i64, n: usize| (0..n as i64).contains(&v);
    let value = |x: i64, y: i64| {
        let good = |x: i64, y: i64| on(x, nx) && on(y, ny) && trusted(x as usize, y as usize);
        if good(x, y) {
            return excess[[y as usize, x as usize]];
        }
        let opposite = |v: i64, centre: f64| (2.0 * centre - v as f64).round() as i64;
        let (x, y) = (opposite(x, star.x), opposite(y, star.y));
        if good(x, y) {
            excess[[y as usize, x as usize]]
        } else {
            0.0
        }
    };
    let side = (2 * reach + 1) as usize;
    let mut window = Array2::from_shape_fn((side, side), |(j, i)| {
        value(column + i as i64 - reach, row + j as i64 - reach)
    });
    let offset = edge_level(window.slice(s![MARGIN..side - MARGIN, MARGIN..side - MARGIN]));
    window.mapv_inplace(|v| v - offset);
    let spline = Spline::through(window.view());
    let middle = grid.middle() as f64;
    let at =
        |k: usize, centre: f64, first: i64| centre + (k as f64 - middle) / grid.scale as f64 - first as f64;
    let stamp = Array2::from_shape_fn((grid.side(), grid.side()), |(j, i)| {
        spline.at(at(i, star.x, column - reach), at(j, star.y, row - reach))
    });
    let flux = stamp.sum() / (grid.scale * grid.scale) as f64;
    (flux > 0.0).then(|| (stamp / flux, flux))
}

/// The median along the outermost pixels.
fn edge_level(stamp: ArrayView2<'_, f64>) -> f64 {
    let (ny, nx) = stamp.dim();
    let mut edge: Vec<f64> = stamp
        .indexed_iter()
        .filter(|((y, x), _)| *y == 0 || *x == 0 || *y == ny - 1 || *x == nx - 1)
        .map(|(_, v)| *v)
        .collect();
    median(&mut edge)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn star(x: f64, y: f64) -> Star {
        Star {
            source: 0,
            x,
            y,
            flux: 1.0,
            offset: 0.0,
            pixels: Vec::new(),
        }
    }

    fn frame(x: f64, y: f64, sigma: f64) -> Array2<f64> {
        Array2::from_shape_fn((41, 41), |(j, i)| {
            let r2 = (i as f64 - x).powi(2) + (j as f64 - y).powi(2);
            500.0 * (-0.5 * r2 / (sigma * sigma)).exp() + 3.0
        })
    }

    #[test]
    fn it_is_centred_of_unit_flux_and_holds_the_stars_pixels() {
        let (x, y, sigma) = (20.3, 19.6, 1.2);
        let grid = FineGrid { reach: 8, scale: 2 };
        let (stamp, flux) = own_stamp(frame(x, y, sigma).view(), &star(x, y), |_, _| true, grid).unwrap();
        assert!((stamp.sum() / 4.0 - 1.0).abs() < 1e-12);
        let truth = std::f64::consts::TAU * sigma * sigma * 500.0;
        // The pedestal of 3 is the level of the edge.
        assert!((flux / truth - 1.0).abs() < 1e-4, "{flux} against {truth}");
        let middle = grid.middle();
        let (mut mx, mut my) = (0.0, 0.0);
        for ((j, i), v) in stamp.indexed_iter() {
            mx += v / 4.0 * (i as f64 - middle as f64) / 2.0;
            my += v / 4.0 * (j as f64 - middle as f64) / 2.0;
        }
        // The spline's own error on a FWHM of 2.8 pixels.
        assert!(mx.abs() < 2e-3 && my.abs() < 2e-3, "{mx}, {my}");
    }

    #[test]
    fn a_neighbours_pixels_are_those_opposite() {
        let clean = frame(20.0, 20.0, 1.5);
        let mut with_neighbour = clean.clone();
        with_neighbour.slice_mut(s![24..27, 19..22]).fill(1e4);
        let grid = FineGrid { reach: 8, scale: 1 };
        let trusted = |x: usize, y: usize| !((19..22).contains(&x) && (24..27).contains(&y));
        let (a, _) = own_stamp(clean.view(), &star(20.0, 20.0), |_, _| true, grid).unwrap();
        let (b, _) = own_stamp(with_neighbour.view(), &star(20.0, 20.0), trusted, grid).unwrap();
        assert!((&a - &b).iter().all(|d| d.abs() < 1e-12));
    }
}
