//! The image of a galaxy in single pixels, by integration on the sky.
//!
//! The value of a pixel at the offset `d` from the galaxy is the integral of `I(d - u) h(u)` over
//! the interpolated stamp `h`. Nothing here is shared with the drawing of galaxies: there are no
//! windows, transforms or moments, and the light is not cut off.
//!
//! The stamp is divided into blocks of *cells*, which lie between its pixels. The light on a block far
//! from the galaxy's centre is a polynomial through 8 x 8 points, whose integrals with the stamp are
//! exact. Nearer blocks are divided, down to parts of a cell. A cell that holds the centre is the sum
//! of four triangles between the centre and its edges, with signs if the centre lies just outside.

use std::collections::BTreeSet;
use std::sync::OnceLock;

use ndarray::{Array2, ArrayView2, s};
use psf_types::maths::gauss_legendre;
use psf_types::{FieldError, LightProfile, Position, PsfModel, StampGrid};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::cells::{Cell, integrals, product};
use super::extent::truncate;
use crate::kept::get_or_make;
use crate::stamp_interpolator::{Kernel, MOST_REACH};

/// Number of nodes along each axis of a block.
const NODES: usize = 8;
/// The nodes and weights of a block.
const GAUSS: [(f64, f64); NODES] = gauss_legendre();
/// The nodes and weights of the whole stamp far from a galaxy.
const GAUSS_4: [(f64, f64); 4] = gauss_legendre();
/// A block is at least this multiple of its own radius away from the centre of the galaxy, as the
/// isophotes measure it. Then the error of the polynomial is below 1e-7 of the light on the block.
const AWAY: f64 = 3.0;
/// Half of the difference of the logarithm of the light on a block is at most this.
const STEEPEST: f64 = 0.75;
/// A block in which less than this fraction of the galaxy's peak is at stake need not be divided. It
/// is small against the least error that an image may have, 3e-8 of the peak.
const NEGLIGIBLE: f64 = 1e-11;
/// A cell at most this far from the centre, in cells, is divided into triangles.
const NEAR_CELL: f64 = 0.25;
/// Panels of a radius in a triangle, each with [`NODES`] nodes.
const RADIAL_PANELS: usize = 4;
/// Of the flux, this fraction beyond a radius does not count in a triangle.
const DARK: f64 = 1e-11;
/// A triangle lower than this multiple of its edge holds no light that counts.
const LEAST_HEIGHT: f64 = 1e-9;
/// Pixels that one task computes.
const PIXELS_PER_TASK: usize = 16;

/// The cells of a model's interpolated stamps, and the integrals of the interpolation kernel times
/// polynomials.
#[derive(Debug)]
pub(super) struct Integrator<'a> {
    model: &'a PsfModel,
    size: Option<usize>,
    kernel: Kernel,
    /// Cells along x and y.
    cells: [usize; 2],
    /// For each length of a block in cells: the integrals of each node's Lagrange polynomial times
    /// each coefficient's kernel, `[node, coefficient]`, in cells.
    integrals: FxHashMap<usize, Array2<f64>>,
    /// The weights of the whole stamp for each component, `[component, node]`: those of [`GAUSS`],
    /// then those of [`GAUSS_4`].
    whole: Array2<f64>,
}

/// A block of whole cells: first column and row, columns and rows.
type Block = [usize; 4];

/// The PSF of a source at some position, on the cells.
pub(super) struct CellPsf<'a> {
    integrator: &'a Integrator<'a>,
    position: Position,
    /// The weights of the nodes of the whole stamp, as in [`Integrator`].
    whole: Vec<f64>,
    /// The coefficients of interpolation. Computed when first needed.
    coefficients: OnceLock<Result<Array2<f64>, FieldError>>,
}

/// The light of a galaxy of flux 1, and the radii that decide how it is integrated.
pub(super) struct Sky<'a> {
    light: &'a (dyn LightProfile + Sync),
    /// Light farther out does not count in a triangle.
    dark: f64,
    /// Pixels that only see light farther out are dark.
    farthest: f64,
    /// About the brightness of the galaxy's image at its peak.
    peak: f64,
    /// Errors may be as large as this fraction of the flux, divided by the area of the ellipse through
    /// a pixel.
    accuracy: f64,
}

impl<'a> Sky<'a> {
    /// The light of a galaxy, for images of some accuracy. Pixels are dark if they only see light from
    /// beyond the radius that holds all flux but this fraction.
    pub(super) fn new(light: &'a (dyn LightProfile + Sync), accuracy: f64) -> Self {
        let half = light.radius_beyond(0.5);
        let area = std::f64::consts::PI * light.axis_ratio() * half * half;
        Self {
            light,
            dark: light.radius_beyond(DARK),
            farthest: light.radius_beyond(accuracy),
            accuracy,
            peak: (0.5 / area).min(1.0),
        }
    }
}

/// The largest radius in a rectangle around the centre of a galaxy, which is that of a corner.
pub(super) fn corner_radius(light: &dyn LightProfile, half_width: f64, half_height: f64) -> f64 {
    light
        .radius(half_width, half_height)
        .max(light.radius(half_width, -half_height))
}

impl<'a> Integrator<'a> {
    /// For the PSFs of a model, with stamps that are truncated to `size` frame pixels if it is given.
    pub(super) fn new(model: &'a PsfModel, size: Option<usize>) -> Self {
        let grid = model.grid();
        let kernel = Kernel::of(grid.interpolation(), MOST_REACH);
        let cells = [grid.nx(), grid.ny()].map(|pixels| pixels - 1 + 2 * kernel.reach() as usize);
        let mut lengths = BTreeSet::from(cells);
        let mut next: Vec<usize> = cells.to_vec();
        while let Some(length) = next.pop() {
            for part in [length / 2, length.div_ceil(2)] {
                if part > 0 && lengths.insert(part) {
                    next.push(part);
                }
            }
        }
        let of_length = |n| (n, integrals(kernel, n, &GAUSS));
        let few = cells.map(|n| integrals(kernel, n, &GAUSS_4));
        let mut integrator = Self {
            model,
            size,
            kernel,
            cells,
            integrals: lengths.into_iter().map(of_length).collect(),
            whole: Array2::zeros((0, NODES * NODES)),
        };
        let of_components: Vec<Vec<f64>> = (0..model.stamp_count())
            .into_par_iter()
            .map(|k| {
                let coefficients = integrator.coefficients(model.stamp(k));
                let mut weights = integrator.weights(&coefficients, integrator.block());
                weights.extend(few[1].dot(&coefficients).dot(&few[0].t()));
                weights
            })
            .collect();
        let count = NODES * NODES + GAUSS_4.len() * GAUSS_4.len();
        integrator.whole = Array2::from_shape_vec((model.stamp_count(), count), of_components.concat())
            .expect("a row for each component");
        integrator
    }

    fn grid(&self) -> StampGrid {
        self.model.grid()
    }

    /// The block of all cells.
    fn block(&self) -> Block {
        [0, 0, self.cells[0], self.cells[1]]
    }

    /// The coefficients of a stamp. Those from index `c` on contribute to cell `c`.
    fn coefficients(&self, stamp: ArrayView2<'_, f64>) -> Array2<f64> {
        let mut values = stamp.to_owned();
        if let Some(size) = self.size {
            let count = values.len();
            let flat = values.view_mut().into_shape_with_order(count);
            truncate(flat.expect("a new array is contiguous"), self.grid(), size);
        }
        let made = self.kernel.coefficients(values.view());
        let more = self.kernel.tap_count() - 1;
        let shape = [self.cells[1] + more, self.cells[0] + more];
        let margins = [0, 1].map(|axis| (shape[axis] - made.shape()[axis]) / 2);
        let mut padded = Array2::zeros(shape);
        padded
            .slice_mut(s![
                margins[0]..margins[0] + made.nrows(),
                margins[1]..margins[1] + made.ncols()
            ])
            .assign(&made);
        padded
    }

    /// The weights of the nodes of a block, rows first.
    fn weights(&self, coefficients: &Array2<f64>, [x, y, nx, ny]: Block) -> Vec<f64> {
        let more = self.kernel.tap_count() - 1;
        let part = coefficients.slice(s![y..y + ny + more, x..x + nx + more]);
        let weights = self.integrals[&ny].dot(&part).dot(&self.integrals[&nx].t());
        weights.into_iter().collect()
    }

    /// Whether a pixel at an offset from a galaxy's centre is not dark.
    pub(super) fn reaches(&self, sky: &Sky<'_>, (dx, dy): (f64, f64)) -> bool {
        let grid = self.grid();
        let s = grid.oversampling();
        let half = |axis: usize| 0.5 * self.cells[axis] as f64 / s;
        // The offset of the middle of the stamp.
        let middle = |axis: usize, centre: f64| half(axis) - (centre + self.kernel.reach()) / s;
        let (x, y) = (dx - middle(0, grid.centre_x()), dy - middle(1, grid.centre_y()));
        sky.light.radius(x, y) - corner_radius(sky.light, half(0), half(1)) <= sky.farthest
    }

    /// The PSF at a position, in pixels of the frame.
    pub(super) fn psf(&'a self, position: Position) -> Result<CellPsf<'a>, FieldError> {
        let mut components = vec![0.0; self.model.stamp_count()];
        self.model.scaled_coefficients_into(position, &mut components)?;
        let mut whole = vec![0.0; self.whole.ncols()];
        for (&a, weights) in components.iter().zip(self.whole.outer_iter()) {
            for (sum, weight) in whole.iter_mut().zip(weights) {
                *sum += a * weight;
            }
        }
        Ok(CellPsf {
            integrator: self,
            position,
            whole,
            coefficients: OnceLock::new(),
        })
    }
}

impl CellPsf<'_> {
    /// The image of a galaxy of flux 1 in pixels, which are given by their offsets from its centre.
    pub(super) fn images(&self, sky: &Sky<'_>, offsets: &[(f64, f64)]) -> Result<Vec<f64>, FieldError> {
        let images: Vec<Vec<f64>> = offsets
            .par_chunks(PIXELS_PER_TASK)
            .map(|offsets| {
                let mut known = FxHashMap::default();
                let each = offsets.iter().map(|&offset| {
                    let mut pixel = PixelIntegral::new(self, sky, offset, &mut known);
                    pixel.add_block(self.integrator.block())?;
                    Ok(pixel.sum)
                });
                each.collect()
            })
            .collect::<Result<_, FieldError>>()?;
        Ok(images.concat())
    }

    fn coefficients(&self) -> Result<&Array2<f64>, FieldError> {
        let make = || {
            let psf = self.integrator.model.core_at(self.position)?;
            Ok(self.integrator.coefficients(psf.values()))
        };
        match get_or_make(&self.coefficients, make) {
            Ok(coefficients) => Ok(coefficients),
            // Errors are not copied. The error occurs again.
            Err(_) => Err(make().expect_err("the PSF had no value")),
        }
    }
}

/// The variation of the light on a rectangle.
enum Variation {
    Dark,
    /// A polynomial through 4 points along each axis is enough.
    Even,
    Smooth,
    Rough,
}

/// The integral for one pixel.
struct PixelIntegral<'a> {
    psf: &'a CellPsf<'a>,
    sky: &'a Sky<'a>,
    /// The centre of the galaxy, in cells. The light of a cell is nearer to it the nearer the cell is.
    centre: [f64; 2],
    /// Cells per pixel.
    per_pixel: f64,
    /// The weights of blocks, for all pixels.
    known: &'a mut FxHashMap<Block, Vec<f64>>,
    sum: f64,
}

impl<'a> PixelIntegral<'a> {
    fn new(
        psf: &'a CellPsf<'a>,
        sky: &'a Sky<'a>,
        (dx, dy): (f64, f64),
        known: &'a mut FxHashMap<Block, Vec<f64>>,
    ) -> Self {
        let (grid, reach) = (psf.integrator.grid(), psf.integrator.kernel.reach());
        let s = grid.oversampling();
        Self {
            psf,
            sky,
            centre: [s * dx + grid.centre_x() + reach, s * dy + grid.centre_y() + reach],
            per_pixel: s,
            known,
            sum: 0.0,
        }
    }

    /// The offset from the galaxy's centre, in pixels, of the light that comes through a point of the
    /// stamp.
    fn offset(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            (self.centre[0] - x) / self.per_pixel,
            (self.centre[1] - y) / self.per_pixel,
        ]
    }

    /// The radius of the middle of a rectangle, and the largest difference from it, both along the
    /// major axis.
    fn radii(&self, [x, y]: [f64; 2], [width, height]: [f64; 2]) -> (f64, f64) {
        let light = self.sky.light;
        let [dx, dy] = self.offset([x + 0.5 * width, y + 0.5 * height]);
        let half = [0.5 * width / self.per_pixel, 0.5 * height / self.per_pixel];
        (light.radius(dx, dy), corner_radius(light, half[0], half[1]))
    }

    fn variation(&self, first: [f64; 2], size: [f64; 2]) -> Variation {
        let (radius, corner) = self.radii(first, size);
        let light = self.sky.light;
        if radius <= corner {
            return Variation::Rough;
        }
        let area = size[0] * size[1] / (self.per_pixel * self.per_pixel);
        let brightest = light.brightness(radius - corner);
        // At most about this part of the PSF lies on the rectangle.
        let most = brightest * area.min(1.0) / self.sky.peak;
        if most <= NEGLIGIBLE {
            return Variation::Dark;
        }
        let away = radius / corner;
        let steep = 0.5 * (brightest / light.brightness(radius + corner)).ln();
        // The errors of polynomials of degree 7 and 3, relative to the brightest light: because of the
        // centre, and of an exponential (Chebyshev's bound).
        let error = (2.0 * away).powi(-8) + steep.powi(8) / 5e6;
        let error_of_4 = (2.0 * away).powi(-4) + steep.powi(4) / 190.0;
        let ellipse = std::f64::consts::PI * light.axis_ratio() * radius * radius;
        let enough = NEGLIGIBLE.max(self.sky.accuracy / (ellipse * self.sky.peak));
        if away >= AWAY && error_of_4 * most <= enough {
            Variation::Even
        } else if (away >= AWAY && steep <= STEEPEST) || error * most <= enough {
            Variation::Smooth
        } else {
            Variation::Rough
        }
    }

    /// Adds the light that comes through a block.
    fn add_block(&mut self, block: Block) -> Result<(), FieldError> {
        let [x, y, nx, ny] = block;
        if nx == 1 && ny == 1 {
            let coefficients = self.psf.coefficients()?;
            let cell = Cell::new(self.psf.integrator.kernel, coefficients, [x, y]);
            let near =
                |axis: usize, at: usize| (self.centre[axis] - at as f64 - 0.5).abs() <= 0.5 + NEAR_CELL;
            if near(0, x) && near(1, y) {
                self.add_triangles(&cell);
            } else {
                self.add_part(&cell, [x as f64, y as f64], 1.0);
            }
            return Ok(());
        }
        match self.variation([x as f64, y as f64], [nx as f64, ny as f64]) {
            Variation::Dark => {}
            Variation::Even if block == self.psf.integrator.block() => {
                self.sum += self.product(block, &GAUSS_4, &self.psf.whole[NODES * NODES..]);
            }
            Variation::Even | Variation::Smooth => self.add_smooth(block)?,
            Variation::Rough => {
                let halves = |first: usize, count: usize, other: usize| {
                    // A block that is much narrower along this axis stays whole.
                    let is_narrow = 2 * count <= other || count == 1;
                    let middle = if is_narrow { count } else { count / 2 };
                    [(first, middle), (first + middle, count - middle)]
                };
                for (y, ny) in halves(y, ny, nx) {
                    for (x, nx) in halves(x, nx, block[3]) {
                        if nx > 0 && ny > 0 {
                            self.add_block([x, y, nx, ny])?;
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// Adds the light of a block, by the polynomial through its nodes.
    fn add_smooth(&mut self, block: Block) -> Result<(), FieldError> {
        let integrator = self.psf.integrator;
        let whole = block == integrator.block();
        if !whole && !self.known.contains_key(&block) {
            let weights = integrator.weights(self.psf.coefficients()?, block);
            self.known.insert(block, weights);
        }
        let weights = if whole {
            &self.psf.whole[..NODES * NODES]
        } else {
            self.known[&block].as_slice()
        };
        self.sum += self.product(block, &GAUSS, weights);
        Ok(())
    }

    /// The sum of the light at the nodes of a block, times their weights.
    fn product(&self, block: Block, rule: &[(f64, f64)], weights: &[f64]) -> f64 {
        let [x, y, nx, ny] = block.map(|v| v as f64);
        let mut sum = 0.0;
        for ((node_y, _), weights) in rule.iter().zip(weights.chunks_exact(rule.len())) {
            for ((node_x, _), weight) in rule.iter().zip(weights) {
                sum += weight * self.light_at([x + node_x * nx, y + node_y * ny]);
            }
        }
        sum / (self.per_pixel * self.per_pixel)
    }

    fn light_at(&self, point: [f64; 2]) -> f64 {
        let [dx, dy] = self.offset(point);
        self.sky.light.brightness(self.sky.light.radius(dx, dy))
    }

    /// Adds the light that comes through a square part of a cell.
    fn add_part(&mut self, cell: &Cell, [x, y]: [f64; 2], size: f64) {
        match self.variation([x, y], [size; 2]) {
            Variation::Dark => {}
            Variation::Even | Variation::Smooth => {
                let columns = GAUSS.map(|(node, _)| cell.kernel_weights(0, x + node * size));
                let mut sum = 0.0;
                for (node_y, weight_y) in GAUSS {
                    let line = cell.line(y + node_y * size);
                    for ((node_x, weight_x), column) in GAUSS.iter().zip(&columns) {
                        let light = self.light_at([x + node_x * size, y + node_y * size]);
                        sum += weight_x * weight_y * light * product(column, &line);
                    }
                }
                self.sum += sum * (size / self.per_pixel).powi(2);
            }
            Variation::Rough => {
                let half = 0.5 * size;
                for part in [[x, y], [x + half, y], [x, y + half], [x + half, y + half]] {
                    self.add_part(cell, part, half);
                }
            }
        }
    }

    /// Adds the light that comes through a cell which holds the galaxy's centre or lies close to it.
    fn add_triangles(&mut self, cell: &Cell) {
        let [x, y] = cell.first;
        let corners =
            [[x, y], [x + 1.0, y], [x + 1.0, y + 1.0], [x, y + 1.0]].map(|corner| self.offset(corner));
        for (k, &corner) in corners.iter().enumerate() {
            self.sum += self.triangle(cell, corner, corners[(k + 1) % 4]);
        }
    }

    /// The light of the triangle between the galaxy's centre and two offsets, with the sign of its
    /// area. With a point `P(t)` of the edge, it is `area * 2 * integral of r I(r P) h(r P) dr dt`.
    fn triangle(&self, cell: &Cell, from: [f64; 2], to: [f64; 2]) -> f64 {
        let light = self.sky.light;
        let cross = from[0] * to[1] - from[1] * to[0];
        let edge = [to[0] - from[0], to[1] - from[1]];
        let length = light.radius(edge[0], edge[1]);
        let [squared_from, squared_to] = [from, to].map(|p| light.radius(p[0], p[1]).powi(2));
        // The point of the edge that is nearest to the centre, and its radius.
        let foot = 0.5 + 0.5 * (squared_from - squared_to) / (length * length);
        let nearest = light.radius(from[0] + foot * edge[0], from[1] + foot * edge[1]);
        let scale = nearest / length;
        if scale < LEAST_HEIGHT {
            return 0.0;
        }
        // With t = foot + scale sinh(w), the integrand varies over lengths of about 1 in w.
        let (first, last) = ((-foot / scale).asinh(), ((1.0 - foot) / scale).asinh());
        let panels = (last - first).ceil();
        let width = (last - first) / panels;
        // With r = z^power, the light is a smooth function of z.
        let power = (2.0 * light.index()).max(1.0);
        let mut sum = 0.0;
        for panel in 0..panels as usize {
            for (node, weight) in GAUSS {
                let w = first + (panel as f64 + node) * width;
                let at = foot + scale * w.sinh();
                let point = [from[0] + at * edge[0], from[1] + at * edge[1]];
                let radius = nearest * w.cosh();
                let most = (self.sky.dark / radius).min(1.0);
                let mut along = 0.0;
                for panel in 0..RADIAL_PANELS {
                    for (node, weight) in GAUSS {
                        let z = (panel as f64 + node) / RADIAL_PANELS as f64;
                        let r = most * z.powf(power);
                        let psf = cell.at([
                            self.centre[0] - self.per_pixel * r * point[0],
                            self.centre[1] - self.per_pixel * r * point[1],
                        ]);
                        along += weight * power * r * r / z * light.brightness(r * radius) * psf;
                    }
                }
                sum += weight * width * scale * w.cosh() * along / RADIAL_PANELS as f64;
            }
        }
        cross * sum
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use ndarray::Array3;
    use psf_types::{
        CoefficientField, Normalisation, PsfBasis, SersicProfile, SersicSource, StampInterpolation,
    };
    use sersic::SersicLight;

    use super::*;

    #[derive(Debug)]
    struct Constant;
    impl CoefficientField for Constant {
        fn component_count(&self) -> usize {
            0
        }
        fn evaluate_into(&self, _: Position, _: &mut [f64]) -> Result<(), FieldError> {
            Ok(())
        }
    }

    fn model(grid: StampGrid, psf: impl Fn(f64, f64) -> f64) -> PsfModel {
        let s = grid.oversampling();
        let stamp = Array2::from_shape_fn(grid.dim(), |(y, x)| {
            psf((x as f64 - grid.centre_x()) / s, (y as f64 - grid.centre_y()) / s)
        });
        let basis = PsfBasis::new(Some(stamp), Array3::zeros((0, grid.ny(), grid.nx())), grid);
        PsfModel::new(&basis.unwrap(), Arc::new(Constant), Normalisation::Keep, None).unwrap()
    }

    fn light(re: f64, n: f64, q: f64, angle: f64) -> SersicLight {
        let profile = SersicProfile::new(re, n, q, angle).unwrap();
        SersicLight::new(&SersicSource::new(Position::of_pixel(0, 0), 1.0, profile).unwrap())
    }

    /// The integral in polar coordinates of the isophotes, on which the light is constant. The stamp is
    /// interpolated point by point.
    fn by_isophotes(model: &PsfModel, light: &SersicLight, angle: f64, (dx, dy): (f64, f64)) -> f64 {
        let grid = model.grid();
        let kernel = Kernel::of(grid.interpolation(), MOST_REACH);
        let integrator = Integrator::new(model, None);
        let coefficients = integrator.coefficients(model.stamp(0));
        let s = grid.oversampling();
        let (sin, cos) = angle.to_radians().sin_cos();
        let at = |x: f64, y: f64| {
            let (x, y) = (
                s * (dx - x) + grid.centre_x() + kernel.reach(),
                s * (dy - y) + grid.centre_y() + kernel.reach(),
            );
            let inside = |v: f64, count: usize| (0.0..count as f64).contains(&v);
            if !inside(x, integrator.cells[0]) || !inside(y, integrator.cells[1]) {
                return 0.0;
            }
            Cell::new(kernel, &coefficients, [x as usize, y as usize]).at([x, y])
        };
        let (steps, turns) = (1500, 700);
        // Equal steps of the logarithm of the radius.
        let (first, last) = (-14.0_f64, 7.0_f64);
        let step = (last - first) / f64::from(steps);
        let mut sum = 0.0;
        for i in 0..steps {
            let r = (first + (f64::from(i) + 0.5) * step).exp();
            let mean: f64 = (0..turns)
                .map(|k| {
                    let phase = std::f64::consts::TAU * (f64::from(k) + 0.5) / f64::from(turns);
                    let (u, v) = (r * phase.cos(), light.axis_ratio() * r * phase.sin());
                    at(u * cos - v * sin, u * sin + v * cos)
                })
                .sum::<f64>()
                / f64::from(turns);
            sum += light.brightness(r) * light.axis_ratio() * std::f64::consts::TAU * r * r * step * mean;
        }
        sum
    }

    /// Small against the least error that an image may have, 3e-8 of the peak. The sum over isophotes
    /// is as accurate.
    const TOLERANCE: f64 = 5e-8;

    #[test]
    fn pixels_are_integrals_over_isophotes() {
        use StampInterpolation::{CubicSpline, Lanczos3};
        for (side, s, interpolation) in [
            (25, 1.0, CubicSpline),
            (40, 2.0, CubicSpline),
            (31, 1.5, Lanczos3),
        ] {
            let grid = StampGrid::new(side, side - 1).and_then(|grid| grid.with_oversampling(s));
            let grid = grid.unwrap().with_interpolation(interpolation);
            let model = model(grid, |x, y| (-(x * x + 1.3 * y * y) / 3.4).exp() / 10.0);
            let integrator = Integrator::new(&model, None);
            for (re, n, q, angle) in [
                (0.3, 0.5, 0.6, 20.0),
                (3.0, 1.0, 0.7, 30.0),
                (10.0, 2.5, 0.5, 60.0),
                (2.0, 4.0, 0.8, 10.0),
                (10.0, 1.0, 0.1, 33.0),
            ] {
                let light = light(re, n, q, angle);
                let sky = Sky::new(&light, 1e-12);
                let psf = integrator.psf(Position::of_pixel(0, 0)).unwrap();
                let offsets = [(0.0, 0.0), (0.3, -0.4), (2.2, 1.1), (-8.0, 5.0), (-21.0, 30.0)];
                let values = psf.images(&sky, &offsets).unwrap();
                for (offset, value) in offsets.into_iter().zip(&values) {
                    let error = (value - by_isophotes(&model, &light, angle, offset)).abs() / values[0];
                    assert!(error < TOLERANCE, "{side} {light:?} {offset:?}: {error:e}");
                }
            }
        }
    }

    /// The integral over the stamp gives the flux of a galaxy whose light is all on it.
    #[test]
    fn a_point_is_the_stamp() {
        let grid = StampGrid::new(21, 23)
            .and_then(|grid| grid.with_oversampling(2.0))
            .unwrap();
        let model = model(grid, |x, y| (-(x * x + 1.3 * y * y) / 2.0).exp());
        let interpolated = crate::StampInterpolator::new(model.stamp(0), grid);
        let frame = StampGrid::new(9, 9).unwrap();
        let integrator = Integrator::new(&model, None);
        let psf = integrator.psf(Position::of_pixel(0, 0)).unwrap();
        for (re, n) in [(1e-9, 1.0), (1e-7, 4.0), (1e-5, 0.5)] {
            let light = light(re, n, 1.0, 0.0);
            let sky = Sky::new(&light, 1e-12);
            for shift in [(0.0, 0.0), (0.3, -0.2)] {
                let stars = interpolated.resample(shift, frame);
                let offset = |x: usize, y: usize| (x as f64 - 4.0 - shift.0, y as f64 - 4.0 - shift.1);
                let offsets: Vec<_> = (0..81).map(|i| offset(i % 9, i / 9)).collect();
                for (value, star) in psf.images(&sky, &offsets).unwrap().iter().zip(&stars) {
                    assert!((value - star).abs() < TOLERANCE, "{re} {n}: {value} {star}");
                }
            }
        }
    }
}
