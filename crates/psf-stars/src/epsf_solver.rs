//! The linear step of the fit of an oversampled PSF: the fit of its spline coefficients to the stars'
//! pixels.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use crate::Camera;
use crate::band_matrix::{BandMatrix, add_to, product};
use crate::epsf_prior::{Prior, weight};
use crate::frame::{Star, StarPixel};
use crate::selection::FieldTerms;
use crate::surface::SurfaceGrid;

/// The iteration ends when the residual falls to this fraction of that of the prior. The
/// coefficients' own noise is larger than the error that this leaves.
const CONVERGED: f64 = 1e-3;
const MOST_ITERATIONS: usize = 300;
/// With more coefficients along each side, the preconditioner is the diagonal alone, which takes less
/// memory and more iterations.
const LARGEST_BAND: usize = 100;
/// The number of partial sums of the normal matrix.
const MATRICES: usize = 16;
/// Number of stars over which one task sums. These partial sums are added in a fixed order, so that
/// the result does not depend on the number of threads.
const PIECE: usize = 32;

/// Returns the sum of the planes `E_j`, each multiplied by its term `P_j`.
pub(crate) fn combined(planes: &[Vec<f64>], terms: &[f64]) -> Vec<f64> {
    let mut sum = vec![0.0; planes[0].len()];
    for (plane, term) in planes.iter().zip(terms) {
        add_to(&mut sum, *term, plane);
    }
    sum
}

/// The condition that the pixels around a star hold all its light wherever in a pixel it lies: the
/// sums of the PSF over the nodes of each pixel phase are equal. A cubic spline through nodes with
/// equal sums has this sum at every phase between them, too. Their common value is free. The stars'
/// fluxes, which are held while the PSF is fitted, determine it.
///
/// A PSF with the pixel's response fulfils it, because pixels tile the plane (apart from light that
/// leaves the stamp). The stars' pixels alone cannot tell: a larger sum at one phase and smaller
/// fluxes of all stars at this phase give the same pixels.
struct PhaseSums {
    /// For each phase but the last, the weights of the coefficients in its sum minus the mean sum.
    weights: Vec<Vec<f64>>,
}

impl PhaseSums {
    fn new(surface: SurfaceGrid) -> Self {
        let along = surface.phase_weights();
        let of = |wy: &[f64], wx: &[f64]| wy.iter().flat_map(|y| wx.iter().map(move |x| x * y)).collect();
        let weights = along.iter().flat_map(|wy| along.iter().map(move |wx| of(wy, wx)));
        let mut weights: Vec<Vec<f64>> = weights.collect();
        let mut mean = vec![0.0; surface.len()];
        for of_phase in &weights {
            add_to(&mut mean, (weights.len() as f64).recip(), of_phase);
        }
        // The differences of all phases add up to 0.
        weights.pop();
        for of_phase in &mut weights {
            add_to(of_phase, -1.0, &mean);
        }
        Self { weights }
    }

    /// The differences of the sums from their mean.
    fn of(&self, coefficients: &[f64]) -> DVector<f64> {
        DVector::from_iterator(
            self.weights.len(),
            self.weights.iter().map(|w| product(w, coefficients)),
        )
    }
}

/// The normal matrix of one plane alone, factorised. It serves as a preconditioner of all planes
/// together, whose terms are nearly orthogonal over the field.
struct PlaneSolver<'a> {
    matrix: BandMatrix,
    sums: &'a PhaseSums,
    /// For each difference of sums, the solution for its weights.
    responses: Vec<Vec<f64>>,
    /// The differences of sums of these solutions. None without a condition: with one phase.
    coupling: Option<Cholesky<f64, Dyn>>,
}

impl<'a> PlaneSolver<'a> {
    fn new(mut matrix: BandMatrix, sums: &'a PhaseSums) -> Self {
        matrix.factorise();
        let solved = |weights: &Vec<f64>| {
            let mut response = weights.clone();
            matrix.solve(&mut response);
            response
        };
        let responses: Vec<Vec<f64>> = sums.weights.iter().map(solved).collect();
        let columns: Vec<DVector<f64>> = responses.iter().map(|r| sums.of(r)).collect();
        let coupling = (!columns.is_empty()).then(|| {
            let coupling = DMatrix::from_columns(&columns).cholesky();
            coupling.expect("the sums are independent and the matrix is positive")
        });
        Self {
            matrix,
            sums,
            responses,
            coupling,
        }
    }

    /// Solves for coefficients whose sums have the differences `wanted`.
    fn with_sums(&self, mut right: Vec<f64>, wanted: &DVector<f64>) -> Vec<f64> {
        self.matrix.solve(&mut right);
        let Some(coupling) = &self.coupling else {
            return right;
        };
        let factors = coupling.solve(&(wanted - self.sums.of(&right)));
        for (response, factor) in self.responses.iter().zip(factors.iter()) {
            add_to(&mut right, *factor, response);
        }
        right
    }
}

/// The second difference of three neighbouring coefficients.
struct Bend {
    middle: usize,
    step: usize,
}

impl Bend {
    /// All second differences along x and y.
    fn all_of(surface: SurfaceGrid) -> Vec<Self> {
        let side = surface.side();
        let inner = |k: usize| (1..side - 1).contains(&k);
        let along_x = (0..side * side)
            .filter(move |k| inner(k % side))
            .map(|middle| Self { middle, step: 1 });
        let along_y = (0..side * side)
            .filter(move |k| inner(k / side))
            .map(|middle| Self { middle, step: side });
        along_x.chain(along_y).collect()
    }

    fn of(&self, values: &[f64]) -> f64 {
        values[self.middle - self.step] - 2.0 * values[self.middle] + values[self.middle + self.step]
    }

    /// The transpose of [`of`](Self::of).
    fn add_to(&self, values: &mut [f64], amount: f64) {
        values[self.middle - self.step] += amount;
        values[self.middle] -= 2.0 * amount;
        values[self.middle + self.step] += amount;
    }

    fn add_power(&self, matrix: &mut BandMatrix, weight: f64) {
        let terms = [
            (self.middle - self.step, 1.0),
            (self.middle, -2.0),
            (self.middle + self.step, 1.0),
        ];
        for (k, (row, a)) in terms.iter().enumerate() {
            for (column, b) in &terms[..=k] {
                matrix.add(*row, *column, weight * a * b);
            }
        }
    }
}

/// Fits the planes `E_j` to the stars' pixels, with the stars' positions and fluxes fixed. All
/// planes have equal [`PhaseSums`].
///
/// Minimises `sum w (d / F - E)^2 + |(E - prior) / spread|^2 + |D (E - prior) / bend|^2` by projected
/// conjugate gradients with a preconditioner that keeps the sums (Gould, Hribar and Nocedal 2001,
/// SIAM J. Sci. Comput. 23, 1376). Here `d` are the values of the pixels above the background around
/// their star, `F` is the star's flux, `w` are the weights of the pixels, and `D` takes second
/// differences ([`Prior::bend_certainty`]). The iteration begins with the planes `before` if they
/// belong to the same terms.
pub(crate) fn solve(
    stars: &[Star],
    prior: &Prior,
    surface: SurfaceGrid,
    terms: FieldTerms,
    camera: &Camera,
    before: &[Vec<f64>],
) -> Vec<Vec<f64>> {
    let (count, size) = (terms.count(), surface.len());
    let rows = stars
        .par_iter()
        .map(|star| StarRows::new(star, prior, surface, terms, camera));
    let equations = Equations {
        rows: rows.collect(),
        certainties: [&prior.spread, &prior.field_spread]
            .map(|spread| spread.iter().map(|s| s.powi(-2)).collect()),
        of_bends: [true, false].map(|is_constant| prior.bend_certainty(is_constant)),
        bends: Bend::all_of(surface),
        count,
        size,
    };
    let sums = PhaseSums::new(surface);
    let solvers = equations.solvers(surface, &sums);
    let none = DVector::zeros(sums.weights.len());
    let precondition = |right: &[Vec<f64>]| -> Vec<Vec<f64>> {
        let planes = right.par_iter().zip(&solvers);
        planes
            .map(|(right, solver)| solver.with_sums(right.clone(), &none))
            .collect()
    };

    // `found` is the difference from the prior.
    let mut found = vec![vec![0.0; size]; count];
    if before.len() == count {
        found.clone_from_slice(before);
        add_to(&mut found[0], -1.0, &prior.mean);
    }
    let of_prior = sums.of(&prior.mean);
    for (j, (plane, solver)) in found.iter_mut().zip(&solvers).enumerate() {
        let missing = match j {
            0 => -(&of_prior + sums.of(plane)),
            _ => -sums.of(plane),
        };
        add_to(plane, 1.0, &solver.with_sums(vec![0.0; size], &missing));
    }
    let mut residual = equations.summed(&StarRows::back);
    let first = dot(&residual, &precondition(&residual));
    add(&mut residual, -1.0, &equations.apply(&found));
    let mut step_of = precondition(&residual);
    let mut direction = step_of.clone();
    let mut power = dot(&residual, &step_of);
    for _ in 0..MOST_ITERATIONS {
        if power <= CONVERGED * CONVERGED * first || power <= 0.0 {
            break;
        }
        let image = equations.apply(&direction);
        let step = power / dot(&direction, &image);
        add(&mut found, step, &direction);
        add(&mut residual, -step, &image);
        step_of = precondition(&residual);
        let next = dot(&residual, &step_of);
        let ratio = next / power;
        power = next;
        for (d, r) in direction.iter_mut().zip(&step_of) {
            d.iter_mut().zip(r).for_each(|(d, r)| *d = r + ratio * *d);
        }
    }
    add_to(&mut found[0], 1.0, &prior.mean);
    found
}

/// The normal equations of all planes together.
struct Equations {
    rows: Vec<StarRows>,
    /// The inverse variances of the coefficients before the fit, of the constant term and of the others.
    certainties: [Vec<f64>; 2],
    /// The factors between these and the inverse variances of second differences.
    of_bends: [f64; 2],
    bends: Vec<Bend>,
    /// The number of planes.
    count: usize,
    /// The number of coefficients of a plane.
    size: usize,
}

impl Equations {
    /// The sum over the stars of `of(star)`, multiplied by each of the star's terms.
    fn summed(&self, of: &(dyn Fn(&StarRows) -> Vec<f64> + Sync)) -> Vec<Vec<f64>> {
        let pieces = self.rows.par_chunks(PIECE).map(|piece| {
            let mut sum = vec![vec![0.0; self.size]; self.count];
            for row in piece {
                let back = of(row);
                for (plane, term) in sum.iter_mut().zip(&row.terms) {
                    add_to(plane, *term, &back);
                }
            }
            sum
        });
        let pieces: Vec<Vec<Vec<f64>>> = pieces.collect();
        let mut total = vec![vec![0.0; self.size]; self.count];
        for piece in pieces {
            add(&mut total, 1.0, &piece);
        }
        total
    }

    /// The inverse variances of the coefficients of a plane before the fit, and those of its second
    /// differences that the prior limits.
    fn certainties(&self, plane: usize) -> (&[f64], impl Iterator<Item = (&Bend, f64)>) {
        let (certainties, factor) = (&self.certainties[plane.min(1)], self.of_bends[plane.min(1)]);
        let bends = self.bends.iter().filter(move |_| factor > 0.0);
        (
            certainties,
            bends.map(move |bend| (bend, factor * certainties[bend.middle])),
        )
    }

    /// The normal matrix times planes.
    fn apply(&self, planes: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let mut result = self.summed(&|row| row.normal(&combined(planes, &row.terms)));
        for (j, (result, plane)) in result.iter_mut().zip(planes).enumerate() {
            let (certainties, bends) = self.certainties(j);
            let prior = plane.iter().zip(certainties).map(|(v, c)| v * c);
            result.iter_mut().zip(prior).for_each(|(r, p)| *r += p);
            for (bend, certainty) in bends {
                bend.add_to(result, certainty * bend.of(plane));
            }
        }
        result
    }

    /// The solver of each plane alone.
    fn solvers<'s>(&self, surface: SurfaceGrid, sums: &'s PhaseSums) -> Vec<PlaneSolver<'s>> {
        let width = match surface.side() {
            side if side <= LARGEST_BAND => 3 * side + 4,
            _ => 1,
        };
        let empty = || BandMatrix::new(self.size, width);
        let pieces: Vec<BandMatrix> = self
            .rows
            .par_chunks(self.rows.len().div_ceil(MATRICES).max(1))
            .map(|piece| {
                let mut matrix = empty();
                for row in piece {
                    row.add_to(&mut matrix);
                }
                matrix
            })
            .collect();
        let mut normal = empty();
        for piece in pieces {
            add_to(&mut normal.values, 1.0, &piece.values);
        }
        let all: f64 = self.rows.iter().map(StarRows::importance).sum();
        let solver = |j: usize| {
            let power = |row: &StarRows| row.terms[j].powi(2) * row.importance();
            let mean = self.rows.iter().map(power).sum::<f64>() / all.max(f64::MIN_POSITIVE);
            let (certainties, bends) = self.certainties(j);
            let mut matrix = normal.clone();
            matrix.values.iter_mut().for_each(|v| *v *= mean);
            for (k, certainty) in certainties.iter().enumerate() {
                matrix.add(k, k, *certainty);
            }
            for (bend, certainty) in bends {
                bend.add_power(&mut matrix, certainty);
            }
            PlaneSolver::new(matrix, sums)
        };
        (0..self.count).into_par_iter().map(solver).collect()
    }
}

fn dot(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| product(a, b)).sum()
}

fn add(to: &mut [Vec<f64>], factor: f64, what: &[Vec<f64>]) {
    for (to, what) in to.iter_mut().zip(what) {
        add_to(to, factor, what);
    }
}

/// The equations of one star: the residuals of its usable pixels from the prior.
///
/// All pixels of a star have the same phase on the grid of nodes, because the number of nodes per
/// pixel is whole. So they have the same spline weights, and the PSF at the pixels is a convolution
/// along x and one along y.
struct StarRows {
    terms: Vec<f64>,
    surface: SurfaceGrid,
    /// The first coefficient along x and y of the first pixel.
    first: [usize; 2],
    /// The pixels along x and y.
    shape: [usize; 2],
    /// Spline weights along x and y.
    taps: [[f64; 4]; 2],
    /// Weight and residual of each pixel, row by row. The weight is 0 for an unusable pixel.
    pixels: Vec<(f64, f64)>,
}

impl StarRows {
    fn new(star: &Star, prior: &Prior, surface: SurfaceGrid, terms: FieldTerms, camera: &Camera) -> Self {
        let placed = star
            .pixels
            .iter()
            .filter_map(|p| Some((p, surface.place(p.x - star.x, p.y - star.y)?)));
        let placed: Vec<_> = placed.collect();
        let (Some((corner, place)), Some((last, _))) = (placed.first(), placed.last()) else {
            return Self {
                terms: terms.at(star.x, star.y),
                surface,
                first: [0; 2],
                shape: [0; 2],
                taps: [[0.0; 4]; 2],
                pixels: Vec::new(),
            };
        };
        let side = surface.side();
        let (first, taps) = ([place.first % side, place.first / side], place.weights);
        // The pixels are a rectangle, row by row.
        let index = |p: &StarPixel| [p.x - corner.x, p.y - corner.y].map(|v| v as usize);
        let shape = index(last).map(|v| v + 1);
        let peak = prior.peak();
        let mut pixels = vec![(0.0, 0.0); shape[0] * shape[1]];
        for (p, place) in placed.iter().filter(|(p, _)| p.trust > 0.0) {
            let expected = surface.value(&prior.mean, place);
            let w = p.trust * weight(star, expected, peak, p.rms, camera);
            let [i, j] = index(p);
            pixels[j * shape[0] + i] = (w, (p.value - star.offset) / star.flux - expected);
        }
        Self {
            terms: terms.at(star.x, star.y),
            surface,
            first,
            shape,
            taps,
            pixels,
        }
    }

    /// Returns `A^T W A` applied to coefficients. `A` evaluates the PSF at the star's pixels, and
    /// `W` contains their weights.
    fn normal(&self, coefficients: &[f64]) -> Vec<f64> {
        let mut values = self.values(coefficients);
        values
            .iter_mut()
            .zip(&self.pixels)
            .for_each(|(v, (w, _))| *v *= w);
        self.spread(&values)
    }

    /// Returns `A^T W d`, where `d` are the residuals of the pixels from the prior.
    fn back(&self) -> Vec<f64> {
        let values: Vec<f64> = self.pixels.iter().map(|(w, left)| w * left).collect();
        self.spread(&values)
    }

    /// The sum of the weights: the star's part in the normal matrix.
    fn importance(&self) -> f64 {
        self.pixels.iter().map(|(w, _)| w).sum()
    }

    /// Adds `A^T W A` to a matrix.
    fn add_to(&self, matrix: &mut BandMatrix) {
        let (scale, side) = (self.surface.grid.scale, self.surface.side());
        let taps: Vec<(usize, f64)> = (0..16)
            .map(|t| (t / 4 * side + t % 4, self.taps[1][t / 4] * self.taps[0][t % 4]))
            .collect();
        for (k, (w, _)) in self.pixels.iter().enumerate() {
            let (j, i) = (k / self.shape[0], k % self.shape[0]);
            let first = (self.first[1] + j * scale) * side + self.first[0] + i * scale;
            for (number, (row, weight)) in taps.iter().enumerate() {
                for (column, other) in &taps[..=number] {
                    matrix.add(first + row, first + column, w * weight * other);
                }
            }
        }
    }

    /// The PSF at the star's pixels, row by row.
    fn values(&self, coefficients: &[f64]) -> Vec<f64> {
        let ([nx, ny], scale, side) = (self.shape, self.surface.grid.scale, self.surface.side());
        let mut values = vec![0.0; nx * ny];
        let mut line = vec![0.0; side];
        for (j, row) in values.chunks_exact_mut(nx.max(1)).enumerate() {
            line.fill(0.0);
            for (t, weight) in self.taps[1].iter().enumerate() {
                let from = (self.first[1] + j * scale + t) * side;
                add_to(&mut line, *weight, &coefficients[from..from + side]);
            }
            for (t, weight) in self.taps[0].iter().enumerate() {
                let taken = line[self.first[0] + t..].iter().step_by(scale);
                row.iter_mut().zip(taken).for_each(|(v, c)| *v += weight * c);
            }
        }
        values
    }

    /// The transpose of [`values`](Self::values).
    fn spread(&self, amounts: &[f64]) -> Vec<f64> {
        let (nx, scale, side) = (self.shape[0], self.surface.grid.scale, self.surface.side());
        let mut back = vec![0.0; self.surface.len()];
        let mut line = vec![0.0; side];
        for (j, row) in amounts.chunks_exact(nx.max(1)).enumerate() {
            line.fill(0.0);
            for (t, weight) in self.taps[0].iter().enumerate() {
                let taken = line[self.first[0] + t..].iter_mut().step_by(scale);
                taken.zip(row).for_each(|(c, v)| *c += weight * v);
            }
            for (t, weight) in self.taps[1].iter().enumerate() {
                let from = (self.first[1] + j * scale + t) * side;
                add_to(&mut back[from..from + side], *weight, &line);
            }
        }
        back
    }
}
