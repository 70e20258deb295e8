//! Curves of growth: the flux of a PSF in circles about the source, as a function of their radius.

use ndarray::{Array1, Array2, ArrayView1, ArrayView2};
use psf_types::StampGrid;

use super::norm::{dot, norm};

/// Bounds the flux of any vector of a [`PsfSpace`](super::psf_space::PsfSpace) in every circle
/// about the source.
///
/// The flux in a circle is linear in the vector. So each circle is a row of weights, one weight per
/// direction of the space, and the rows of all radii form a path from row to row. Only some rows of
/// this path are stored. Every other row lies close to the straight line between two stored
/// neighbours: at most `remainder` away. So the flux in its circle is at most the larger of the two
/// fluxes in the stored circles, plus `remainder` times the norm of the vector.
#[derive(Debug)]
pub(crate) struct GrowthCurves {
    /// The flux of each direction in the stored circles, `[circle, direction]`.
    pub(crate) circles: Array2<f64>,
    /// The largest distance of a row that is not stored from the line between its neighbours.
    pub(crate) remainder: f64,
    /// An upper bound of the flux of a vector of norm 1 in any circle.
    pub(crate) norm: f64,
}

/// Rows are stored until the remainder is at most this fraction of the flux of a typical PSF,
/// divided by its norm. The remainder then uses about this fraction of the tolerance.
const REMAINDER_SHARE: f64 = 0.1;
/// The largest number of stored rows. With fewer rows than wanted, the remainder is larger. The
/// bound holds all the same, but a plan may keep more modes than needed.
const MOST_CIRCLES: usize = 256;
/// Added to the remainder for its rounding, as a fraction of it.
const ROUNDING_SHARE: f64 = 1e-9;

/// The rows between two stored rows.
struct Gap {
    first: usize,
    last: usize,
    /// The row that is farthest from the line between the first and the last row.
    farthest: usize,
    distance: f64,
}

impl Gap {
    fn new(rows: &Array2<f64>, first: usize, last: usize) -> Self {
        let start = rows.row(first);
        let line = &rows.row(last) - &start;
        let length_squared = line.dot(&line).max(f64::MIN_POSITIVE);
        let mut gap = Self {
            first,
            last,
            farthest: first,
            distance: 0.0,
        };
        for row in first + 1..last {
            let mut from_start = &rows.row(row) - &start;
            let part = (from_start.dot(&line) / length_squared).clamp(0.0, 1.0);
            from_start.scaled_add(-part, &line);
            let distance = norm(from_start.view());
            if distance > gap.distance {
                (gap.farthest, gap.distance) = (row, distance);
            }
        }
        gap
    }
}

impl GrowthCurves {
    /// The curves of growth of orthonormal stamps `[direction, stamp pixel]`. `typical` is a vector
    /// like those of the model's PSFs. It only decides how many circles are stored.
    pub(crate) fn new(stamps: ArrayView2<'_, f64>, grid: StampGrid, typical: ArrayView1<'_, f64>) -> Self {
        let rows = flux_by_radius(stamps, grid);
        let flux = rows.row(rows.nrows() - 1).dot(&typical).abs();
        let wanted = REMAINDER_SHARE * flux / norm(typical).max(f64::MIN_POSITIVE);
        let mut gaps = vec![Gap::new(&rows, 0, rows.nrows() - 1)];
        let remainder = loop {
            let widest = (0..gaps.len()).max_by(|&a, &b| gaps[a].distance.total_cmp(&gaps[b].distance));
            let gap = &gaps[widest.expect("at least one gap")];
            if gap.distance <= wanted || gaps.len() == MOST_CIRCLES {
                break gap.distance * (1.0 + ROUNDING_SHARE);
            }
            let parts = [(gap.first, gap.farthest), (gap.farthest, gap.last)];
            let [before, after] = parts.map(|(first, last)| Gap::new(&rows, first, last));
            gaps[widest.expect("at least one gap")] = before;
            gaps.push(after);
        };
        // The first row, a circle without pixels, is not stored.
        let mut stored: Vec<usize> = gaps.iter().map(|gap| gap.last).collect();
        stored.sort_unstable();
        let circles = rows.select(ndarray::Axis(0), &stored);
        Self {
            norm: circles.outer_iter().map(norm).fold(0.0, f64::max) + remainder,
            circles,
            remainder,
        }
    }

    /// An upper bound of the flux of a vector in any circle. It is convex in the vector.
    pub(crate) fn largest_flux(&self, vector: ArrayView1<'_, f64>) -> f64 {
        let stored = self.circles.dot(&vector);
        largest(stored.view()) + self.remainder * norm(vector)
    }
}

fn largest(values: ArrayView1<'_, f64>) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

/// The flux of each stamp in circles of every radius at which the circle gets more pixels,
/// `[circle, direction]`. The first circle has no pixels, the last has all pixels.
fn flux_by_radius(stamps: ArrayView2<'_, f64>, grid: StampGrid) -> Array2<f64> {
    let squared_radius = |pixel: usize| {
        let (x, y) = ((pixel % grid.nx()) as f64, (pixel / grid.nx()) as f64);
        (x - grid.centre_x()).powi(2) + (y - grid.centre_y()).powi(2)
    };
    let mut order: Vec<(f64, usize)> = (0..stamps.ncols()).map(|i| (squared_radius(i), i)).collect();
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    // Pixels of equal distance enter a circle together.
    let rings: Vec<&[(f64, usize)]> = order.chunk_by(|a, b| a.0.total_cmp(&b.0).is_eq()).collect();
    let per_value = grid.flux_of_sum(1.0);
    let mut rows = Array2::zeros((rings.len() + 1, stamps.nrows()));
    let mut flux = Array1::zeros(rings.len());
    for (stamp, mut column) in stamps.outer_iter().zip(rows.columns_mut()) {
        let mut sum = 0.0;
        for (flux, ring) in flux.iter_mut().zip(&rings) {
            sum += ring.iter().map(|&(_, pixel)| stamp[pixel]).sum::<f64>();
            *flux = sum * per_value;
        }
        column.slice_mut(ndarray::s![1..]).assign(&flux);
    }
    rows
}

/// Decides how many leading coordinates of vectors to keep, so that the other coordinates have
/// little flux in every circle.
#[derive(Debug)]
pub(crate) struct TailGrowth {
    /// The flux of each coordinate in the stored circles, `[coordinate, circle]`.
    circles: Array2<f64>,
    /// For each coordinate, the largest of these fluxes.
    largest: Vec<f64>,
    remainder: f64,
    /// The flux in the stored circles, summed over some coordinates.
    sums: Vec<f64>,
}

impl TailGrowth {
    /// `circles` is [`GrowthCurves::circles`] in the coordinates of the vectors,
    /// `[coordinate, circle]`.
    pub(crate) fn new(circles: Array2<f64>, remainder: f64) -> Self {
        Self {
            largest: circles.outer_iter().map(|row| largest(row)).collect(),
            sums: vec![0.0; circles.ncols()],
            circles,
            remainder,
        }
    }

    /// Returns whether the flux of the coordinates from `first` on is at most `limit` in every
    /// circle. `tail` holds these coordinates. Their norm must be at least that of their vector.
    pub(crate) fn is_within(&mut self, first: usize, tail: &[f64], limit: f64) -> bool {
        let size = dot(tail, tail).sqrt();
        let limit = limit - self.remainder * size;
        // At most this much flux is in the coordinates that are not yet added to the sums.
        let mut left: f64 = tail
            .iter()
            .zip(&self.largest[first..])
            .map(|(v, l)| v.abs() * l)
            .sum();
        if left <= limit {
            return true;
        }
        self.sums.fill(0.0);
        for (i, &value) in tail.iter().enumerate() {
            let fluxes = self.circles.row(first + i);
            let fluxes = fluxes.as_slice().expect("row-major");
            let mut most: f64 = 0.0;
            for (sum, flux) in self.sums.iter_mut().zip(fluxes) {
                *sum += value * flux;
                most = most.max(sum.abs());
            }
            left -= value.abs() * self.largest[first + i];
            if most + left.max(0.0) <= limit {
                return true;
            }
            if most - left > limit {
                return false;
            }
        }
        // Only rounding is left.
        self.sums.iter().all(|sum| sum.abs() <= limit)
    }
}

#[cfg(test)]
mod tests {
    use super::super::certificate::circles;
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Rounding of sums over a stamp.
    const ROUNDING: f64 = 1e-12;

    fn noise(rows: usize, columns: usize, seed: u64) -> Array2<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        Array2::from_shape_simple_fn((rows, columns), || rng.random_range(-1.0..1.0))
    }

    /// The largest flux in any circle, from the definition.
    fn largest_flux_of(stamp: ArrayView1<'_, f64>, grid: StampGrid) -> f64 {
        let fluxes = circles(grid).dot(&stamp);
        fluxes.fold(0.0, |most, &sum| grid.flux_of_sum(sum).abs().max(most))
    }

    /// The bound holds for every vector. For a typical vector it is not much above the true value.
    #[test]
    fn the_bound_holds_for_every_circle() {
        for (n, (centre, oversampling)) in [((6.0, 5.0), 1.0), ((5.5, 5.5), 2.0), ((2.3137, 9.1741), 1.5)]
            .into_iter()
            .enumerate()
        {
            let grid = StampGrid::new(13, 12)
                .unwrap()
                .with_centre(centre.0, centre.1)
                .unwrap()
                .with_oversampling(oversampling)
                .unwrap();
            let stamps = noise(7, grid.pixel_count(), n as u64);
            let typical = Array1::from_elem(7, 0.3);
            let curves = GrowthCurves::new(stamps.view(), grid, typical.view());
            for vector in noise(50, 7, 9).outer_iter() {
                let exact = largest_flux_of(vector.dot(&stamps).view(), grid);
                let bound = curves.largest_flux(vector);
                let stored = bound - curves.remainder * norm(vector);
                assert!(exact <= bound + ROUNDING, "{exact} {bound}");
                assert!(stored <= exact + ROUNDING, "{exact} {stored}");
            }
        }
    }

    #[test]
    fn the_tail_is_tested_in_every_circle() {
        let circles = noise(9, 20, 1);
        let mut growth = TailGrowth::new(circles.clone(), 0.125);
        let mut outcomes = [0, 0];
        for vector in noise(200, 9, 2).outer_iter() {
            for first in 0..=9 {
                let tail = vector.slice(ndarray::s![first..]);
                let fluxes = tail.dot(&circles.slice(ndarray::s![first.., ..]));
                let exact = largest(fluxes.view()) + 0.125 * norm(tail);
                for limit in [0.2, 0.6, 1.0, 1.6] {
                    let within = growth.is_within(first, tail.to_vec().as_slice(), limit);
                    assert_eq!(within, exact <= limit, "{exact} {limit}");
                    outcomes[usize::from(within)] += 1;
                }
            }
        }
        assert!(outcomes[0] > 500 && outcomes[1] > 500, "{outcomes:?}");
    }
}
