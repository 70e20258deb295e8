//! Where a Gaussian fit starts.

use ndarray::{Array2, s};

use crate::gaussian_model::Start;
use crate::window::Cutout;

const SMALLEST_SIGMA_PX: f64 = 0.4;
const SIGMA_RATIO: f64 = 1.5;

/// The best round Gaussian of a coarse search, `None` where none has a positive amplitude.
///
/// Centres: the brightest pixel, and the brightest box mean for boxes of 3 pixels and of a quarter of the window (these
/// see wide PSFs under noise). Sigmas: a geometric series from 0.4 pixels to the window. For each pair the amplitude and
/// the background follow from linear least squares; the pair that leaves the smallest sum of squares wins.
pub(crate) fn coarse_search(cutout: &Cutout, background: bool) -> Option<Start> {
    let (rows, columns) = cutout.values.dim();
    let mut centres = Vec::new();
    for half in [0, 1, rows.min(columns) / 8] {
        let centre = brightest_box(&cutout.values, half);
        if !centres.contains(&centre) {
            centres.push(centre);
        }
    }
    let mut best: Option<(f64, Start)> = None;
    for (row, column) in centres {
        let mut sigma = SMALLEST_SIGMA_PX;
        while sigma <= rows.max(columns) as f64 {
            if let Some((gain, start)) = linear_fit(cutout, column as f64, row as f64, sigma, background)
                && best.is_none_or(|(most, _)| gain > most)
            {
                best = Some((gain, start));
            }
            sigma *= SIGMA_RATIO;
        }
    }
    best.map(|(_, start)| start)
}

/// Amplitude (and background) of a given round Gaussian, with the sum of squares that it explains; `None` unless positive.
fn linear_fit(cutout: &Cutout, x: f64, y: f64, sigma: f64, background: bool) -> Option<(f64, Start)> {
    let (rows, columns) = cutout.values.dim();
    let profile = |n: usize, centre: f64| -> Vec<f64> {
        (0..n)
            .map(|i| (-0.5 * ((i as f64 - centre) / sigma).powi(2)).exp())
            .collect()
    };
    let (along_x, along_y) = (profile(columns, x), profile(rows, y));
    let (mut gg, mut gd, mut g, mut d) = (0.0, 0.0, 0.0, 0.0);
    for (row, wy) in cutout.values.rows().into_iter().zip(&along_y) {
        for (value, wx) in row.iter().zip(&along_x) {
            let w = wx * wy;
            gg += w * w;
            gd += w * value;
            g += w;
            d += value;
        }
    }
    let n = cutout.values.len() as f64;
    let (power, product) = if background {
        (gg - g * g / n, gd - g * d / n)
    } else {
        (gg, gd)
    };
    let amplitude = product / power;
    (amplitude > 0.0 && amplitude.is_finite()).then(|| {
        let start = Start {
            amplitude,
            x,
            y,
            sigma,
            background: if background { (d - amplitude * g) / n } else { 0.0 },
        };
        (amplitude * product, start)
    })
}

/// Row and column of the largest mean over the boxes of `2 half + 1` pixels that lie on the array.
fn brightest_box(values: &Array2<f64>, half: usize) -> (usize, usize) {
    let side = 2 * half + 1;
    let along_x = running_sums(values, side);
    let sums = running_sums(&along_x.t().to_owned(), side);
    let mut best = (f64::NEG_INFINITY, (half, half));
    for ((column, row), &sum) in sums.indexed_iter() {
        if sum > best.0 {
            best = (sum, (row + half, column + half));
        }
    }
    best.1
}

/// Sums over `side` neighbours along the last axis.
fn running_sums(values: &Array2<f64>, side: usize) -> Array2<f64> {
    let (rows, columns) = values.dim();
    Array2::from_shape_fn((rows, columns + 1 - side), |(i, j)| {
        values.slice(s![i, j..j + side]).sum()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_brightest_box_is_found() {
        let mut values = Array2::zeros((8, 11));
        values[[1, 2]] = 5.0;
        values.slice_mut(s![4..7, 6..9]).fill(1.0);
        assert_eq!(brightest_box(&values, 0), (1, 2));
        assert_eq!(brightest_box(&values, 1), (5, 7));
    }
}
