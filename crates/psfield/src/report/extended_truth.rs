//! The true image of a small galaxy under a PSF that varies.

use ndarray::{Array2, ArrayView2, Zip, s};
use psf_types::{Position, PsfSource};

use crate::PsfieldError;

/// Where the PSF is drawn about an object, in halves of the galaxy's side: between these nine positions it is a polynomial of degree 2 in x
/// and in y, whose error is far below what is measured (the nodes are some 10 pixels apart, samples some 100).
const NODES: [f64; 3] = [-1.0, 0.0, 1.0];

/// The PSF at a position, scaled to unit flux, as drawn by its source.
///
/// # Errors
/// [`PsfieldError::Source`] where it cannot be drawn.
pub(super) fn true_psf(source: &dyn PsfSource, at: Position) -> Result<Array2<f64>, PsfieldError> {
    let stamp = source.draw(at)?;
    let flux = stamp.flux();
    Ok(stamp.into_values() / flux)
}

/// The image of `galaxy` `[y, x]`, whose pixel `n / 2` along each axis is at `(x, y)`, in a window as large as the PSF's stamps and
/// centred as they are: each pixel of the galaxy with the PSF of its own position.
///
/// # Errors
/// [`PsfieldError::Source`].
pub(super) fn true_galaxy(
    source: &dyn PsfSource,
    (x, y): (usize, usize),
    galaxy: ArrayView2<'_, f64>,
) -> Result<Array2<f64>, PsfieldError> {
    let (rows, columns) = galaxy.dim();
    let half = rows.max(columns) as f64 / 2.0;
    let mut nodes = Vec::with_capacity(9);
    for dy in NODES {
        for dx in NODES {
            let at = Position::new(x as f64 + dx * half, y as f64 + dy * half)?;
            nodes.push(true_psf(source, at)?);
        }
    }
    let mut window = Array2::zeros(nodes[0].dim());
    let (ny, nx) = window.dim();
    let mut of_row: [Array2<f64>; 3] = std::array::from_fn(|_| Array2::zeros((ny, nx)));
    let mut psf = Array2::<f64>::zeros((ny, nx));
    for (j, line) in galaxy.outer_iter().enumerate() {
        let dy = j as i64 - (rows / 2) as i64;
        let wy = lagrange(dy as f64 / half);
        for (column, sum) in of_row.iter_mut().enumerate() {
            sum.fill(0.0);
            for (row, w) in wy.iter().enumerate() {
                sum.scaled_add(*w, &nodes[row * 3 + column]);
            }
        }
        for (i, &light) in line.iter().enumerate() {
            if light == 0.0 {
                continue;
            }
            let dx = i as i64 - (columns / 2) as i64;
            let [a, b, c] = lagrange(dx as f64 / half).map(|w| w * light);
            Zip::from(&mut psf)
                .and(&of_row[0])
                .and(&of_row[1])
                .and(&of_row[2])
                .for_each(|p, &l, &m, &r| *p = a * l + b * m + c * r);
            let ((y0, y1), (v0, v1)) = overlap(dy, ny);
            let ((x0, x1), (u0, u1)) = overlap(dx, nx);
            let mut part = window.slice_mut(s![y0..y1, x0..x1]);
            part += &psf.slice(s![v0..v1, u0..u1]);
        }
    }
    Ok(window)
}

/// The three polynomials of degree 2 that are 1 at one of the nodes and 0 at the others.
fn lagrange(t: f64) -> [f64; 3] {
    [0.5 * t * (t - 1.0), (1.0 - t) * (1.0 + t), 0.5 * t * (t + 1.0)]
}

/// The parts of a window and of a stamp of `n` pixels, moved by `shift`, that lie over each other.
fn overlap(shift: i64, n: usize) -> ((usize, usize), (usize, usize)) {
    let moved = shift.unsigned_abs().min(n as u64) as usize;
    if shift >= 0 {
        ((moved, n), (0, n - moved))
    } else {
        ((0, n - moved), (moved, n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::ArrayViewMut2;
    use psf_types::{FrameShape, SourceError, StampGrid};

    /// A PSF whose part `x^2 / 1e4 + y / 1e3` of the light lies one pixel to the right.
    #[derive(Debug)]
    struct Leaning;
    fn part(x: f64, y: f64) -> f64 {
        x * x / 1e4 + y / 1e3
    }
    impl PsfSource for Leaning {
        fn grid(&self) -> StampGrid {
            StampGrid::new(16, 16).unwrap()
        }
        fn field(&self) -> FrameShape {
            FrameShape::new(100, 100).unwrap()
        }
        fn draw_into(&self, at: Position, mut stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
            stamp.fill(0.0);
            stamp[[8, 8]] = 1.0 - part(at.x(), at.y());
            stamp[[8, 9]] = part(at.x(), at.y());
            Ok(())
        }
    }

    #[test]
    fn each_pixel_has_the_psf_of_its_own_position() {
        let galaxy = Array2::from_shape_fn((5, 5), |(y, x)| (1 + y * 5 + x) as f64);
        let window = true_galaxy(&Leaning, (40, 30), galaxy.view()).unwrap();
        let mut expected = Array2::<f64>::zeros((16, 16));
        for ((j, i), light) in galaxy.indexed_iter() {
            let (x, y) = (40.0 + i as f64 - 2.0, 30.0 + j as f64 - 2.0);
            expected[[8 + j - 2, 8 + i - 2]] += light * (1.0 - part(x, y));
            expected[[8 + j - 2, 9 + i - 2]] += light * part(x, y);
        }
        let largest = (&window - &expected).iter().fold(0.0f64, |m, v| m.max(v.abs()));
        // Rounding alone: the PSF is of degree 2 in x and in y.
        assert!(largest < 1e-12, "{largest}");
    }
}
