//! Correlation of light with images: the derivatives with respect to the PSFs of samples.

use std::slice::from_ref;

use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, s};
use psf_types::{ImageView, Progress};
use rayon::prelude::*;

use super::processor::Processor;
use super::tile_engine::{TileEngine, Workspace};
use crate::plan::SampleWeights;
use crate::plan::axis_cuts::longest;
use crate::plan::function_rows::FunctionRows;
use crate::plan::geometry::{Direction, PlacedTile};
use crate::plan::sample_weights::{BlockWeights, Functions};
use crate::simd::{Lanes, WithIsa, sum_of_products, vectorized};
use crate::transform::X_STEP;
use crate::{ConvError, ConvReal};

/// Light, and an image with which it is correlated: the derivative of a number with respect to the image of
/// this light.
#[derive(Debug)]
pub struct LightAndImage<'a, T: ConvReal> {
    /// `[y, x]`.
    pub light: ImageView<'a, T>,
    /// `[y, x]`.
    pub image: ImageView<'a, T>,
    /// The result of the plan on the side that PSFs belong to, for [`Correlations::products`]: the adjoint of
    /// `image` (source-anchored), or the image of `light` (output-anchored).
    pub result: Option<ImageView<'a, T>>,
}

/// The derivative of `sum_y g(y) F(y)` with respect to the PSFs of samples, for light `f` with the image `F`
/// and an image `g`, from a part of the pixels. The derivative is the sum over all parts.
///
/// Let `h(u; x) = sum_j w_j(x) h_j(u) / s(x)` with the weights `w_j` of samples, their PSFs `h_j`, and the flux
/// `s(x)` of the sum, or 1 if PSFs are not scaled to unit flux. In a part, `w_j(x) = sum_m f_m(x) s_mj`. Without
/// the change of `s`, the derivative with respect to `h_j(u)` is `sum_m s_mj M_m(u)` with the correlations
///
/// ```text
/// M_m(u) = sum_x f_m(x) f(x) / s(x) g(x + u)    (source-anchored)
/// M_m(u) = sum_y f_m(y) g(y) / s(y) f(y - u)    (output-anchored)
/// ```
///
/// The change of `s` adds `-sum_m s_mj Q_m` times the derivative of the flux of `h_j`, with the products
/// `Q_m = sum_x f_m(x) f(x) / s(x) (A^T g)(x)` or `Q_m = sum_y f_m(y) g(y) / s(y) F(y)`.
#[derive(Debug)]
pub struct Correlations {
    /// The shares `s` `[function, sample]`.
    pub shares: Array2<f64>,
    /// The correlations `M` `[function, stamp pixel]`.
    pub correlations: Array2<f64>,
    /// The products `Q` `[function]`. Zeros without [`LightAndImage::result`].
    pub products: Array1<f64>,
}

/// The number of parts that are computed together.
const PARTS_AT_ONCE: usize = 16;

/// Correlates pairs of light and image, block by block.
pub(crate) struct Correlate<'a, T: ConvReal> {
    pub(crate) processor: &'a Processor<T>,
    pub(crate) weights: &'a SampleWeights<T>,
    pub(crate) pairs: Vec<Pair<'a, T>>,
    /// The fluxes of the samples' PSFs, if PSFs are scaled to unit flux.
    pub(crate) fluxes: Option<ArrayView1<'a, f64>>,
    pub(crate) progress: &'a dyn Progress,
    pub(crate) take: &'a mut dyn FnMut(Correlations),
}

/// Light and image, as the side that PSFs belong to and the other one. All arrays hold whole rows of
/// pixels.
pub(crate) struct Pair<'a, T> {
    pub(crate) weighted: ArrayView2<'a, T>,
    pub(crate) other: ArrayView2<'a, T>,
    /// On the weighted side.
    pub(crate) result: Option<ArrayView2<'a, T>>,
}

impl<T: ConvReal> WithIsa<T> for Correlate<'_, T> {
    type Output = Result<(), ConvError>;

    fn run<S: Lanes<T>>(self, simd: S) -> Self::Output {
        let plan = &self.processor.plan;
        let blocks = plan.blocks.len();
        // The work of a frame with few blocks is divided by its pairs, too.
        let groups = (PARTS_AT_ONCE / blocks).clamp(1, self.pairs.len().max(1));
        let groups: Vec<_> = self
            .pairs
            .chunks(self.pairs.len().div_ceil(groups).max(1))
            .collect();
        let parts: Vec<(usize, &[Pair<'_, T>])> = (0..blocks)
            .flat_map(|block| groups.iter().map(move |&pairs| (block, pairs)))
            .collect();
        self.progress.start(parts.len() as u64);
        for some in parts.chunks(PARTS_AT_ONCE) {
            let made = some.par_iter().with_max_len(1).map(|&(block, pairs)| {
                let part = Part {
                    processor: self.processor,
                    weights: &self.weights.blocks[block],
                    place: (
                        block % plan.tiling.columns.len(),
                        block / plan.tiling.columns.len(),
                    ),
                    fluxes: self.fluxes,
                };
                let made = self
                    .processor
                    .with_workspace(|workspace| part.correlations(simd, pairs, self.progress, workspace));
                self.progress.advance(1);
                made
            });
            // The order of the parts does not depend on threads.
            for made in made.collect::<Result<Vec<_>, ConvError>>()?.into_iter().flatten() {
                (self.take)(made);
            }
        }
        Ok(())
    }
}

/// A block and its functions.
struct Part<'a, T: ConvReal> {
    processor: &'a Processor<T>,
    weights: &'a BlockWeights<T>,
    /// The column and the row of the block.
    place: (usize, usize),
    fluxes: Option<ArrayView1<'a, f64>>,
}

impl<T: ConvReal> Part<'_, T> {
    /// Returns `None` if the block holds no light.
    fn correlations<S: Lanes<T>>(
        &self,
        simd: S,
        pairs: &[Pair<'_, T>],
        progress: &dyn Progress,
        workspace: &mut Workspace<T>,
    ) -> Result<Option<Correlations>, ConvError> {
        let plan = &self.processor.plan;
        let shares = &self.weights.shares;
        let length = self.processor.fft.spectrum_len();
        let (columns, rows) = (
            &plan.tiling.columns[self.place.0],
            &plan.tiling.rows[self.place.1],
        );
        let mut sums = Sums {
            engine: TileEngine {
                fft: &self.processor.fft,
                geometry: plan.geometry,
                flip: false,
            },
            functions: &self.weights.functions,
            fluxes: self.fluxes.map(|fluxes| shares.dot(&fluxes)),
            products: Array1::zeros(shares.nrows()),
            largest: (longest(from_ref(columns)), longest(from_ref(rows))),
            are_empty: true,
        };
        workspace.kernels.at_least(shares.nrows() * length);
        workspace.functions.resize_with(1, FunctionRows::default);
        for pair in pairs {
            for (y, height, below) in rows.placed() {
                for (x, width, left) in columns.placed() {
                    progress.check_cancelled()?;
                    let tile = PlacedTile {
                        first: (x, y),
                        corner: (left, below),
                        size: (width, height),
                    };
                    vectorized!(simd, sums.add(simd, pair, tile, workspace));
                }
            }
        }
        if sums.are_empty {
            return Ok(None);
        }
        let is_turned = plan.direction(false) == Direction::Scatter;
        let correlations = vectorized!(simd, sums.correlations(simd, is_turned, workspace));
        Ok(Some(Correlations {
            shares: shares.clone(),
            correlations,
            products: sums.products,
        }))
    }
}

/// The sums over the tiles of a block. The spectra of the correlations are in `workspace.kernels`.
struct Sums<'a, T: ConvReal> {
    engine: TileEngine<'a, T>,
    functions: &'a Functions<T>,
    /// The part of each function in the flux of the PSF.
    fluxes: Option<Array1<f64>>,
    products: Array1<f64>,
    /// Columns and rows of the block's largest tile.
    largest: (usize, usize),
    are_empty: bool,
}

impl<T: ConvReal> Sums<'_, T> {
    /// Adds a tile. The other side is turned by 180 degrees, so that the product of spectra is that of a
    /// correlation.
    #[inline(always)]
    fn add<S: Lanes<T>>(
        &mut self,
        simd: S,
        pair: &Pair<'_, T>,
        tile: PlacedTile,
        workspace: &mut Workspace<T>,
    ) {
        let (engine, w) = (self.engine, workspace);
        let (pitch, length) = (engine.fft.pitch(), engine.fft.spectrum_len());
        let (x, y) = tile.first;
        let mut is_lit = false;
        engine.load(
            pair.weighted,
            (x as i64, y as i64),
            tile.size,
            w.light.get_mut(),
            #[inline(always)]
            |row| is_lit |= row.iter().any(|v| !v.is_zero()),
        );
        if !is_lit {
            return;
        }
        let mut function = PlacedFunctions::new(self.functions, tile, &mut w.functions[0]);
        let size = tile.size;
        if let Some(fluxes) = &self.fluxes {
            let sum = w.weighted.get_mut();
            for (kernel, &flux) in fluxes.iter().enumerate() {
                function.set(kernel);
                w.other_row.fill(T::nearest(flux));
                for (y, into) in sum.chunks_exact_mut(pitch).take(size.1).enumerate() {
                    let row = &mut w.row[..size.0];
                    function.multiply(y, &w.other_row[..size.0], row);
                    for (into, &value) in into.iter_mut().zip(&*row) {
                        *into = if kernel == 0 { value } else { *into + value };
                    }
                }
            }
            let light = w.light.get_mut().chunks_exact_mut(pitch);
            for (light, flux) in light.zip(sum.chunks_exact(pitch)).take(size.1) {
                for (light, &flux) in light[..size.0].iter_mut().zip(flux) {
                    *light /= flux;
                }
            }
        }
        let (wide, high) = engine.geometry.around(self.largest);
        let corner = engine.geometry.reach_from(x, y);
        let other = w.weighted.get_mut();
        engine.load(pair.other, corner, (wide, high), other, |_| {});
        turn(other, pitch, (wide, high));
        let (spectrum, column) = (w.sum.get_mut(), w.column.get_mut());
        engine.fft.forward(simd, other, (high, wide), spectrum, column);
        let sums = w.kernels.get_mut().chunks_exact_mut(length);
        let padded = size.0.next_multiple_of(X_STEP);
        let result = pair.result.map(|result| result.slice_move(s![y.., x..]));
        for (kernel, (sum, product)) in sums.zip(&mut self.products).enumerate() {
            function.set(kernel);
            let products = w.weighted.get_mut().chunks_exact_mut(pitch);
            let rows = products.zip(w.light.get().chunks_exact(pitch)).take(size.1);
            for (y, (products, light)) in rows.enumerate() {
                function.multiply(y, &light[..size.0], &mut products[..size.0]);
                products[size.0..padded].fill(T::zero());
                if let Some(result) = &result {
                    let result = result.row(y).to_slice().expect("images are row-major");
                    *product += sum_of_products(&products[..size.0], &result[..size.0]);
                }
            }
            let products = engine.fft.plane(w.weighted.get());
            let (factor, add) = ((w.sum.get(), None), !self.are_empty);
            let (spectrum, column) = (w.spectrum.get_mut(), w.column.get_mut());
            let size = (size.1, size.0);
            engine
                .fft
                .forward_multiply_swapped(simd, products, size, factor, sum, add, spectrum, column);
        }
        self.are_empty = false;
    }

    /// The correlations `[function, stamp pixel]`. `is_turned` if the sums are correlations turned by 180
    /// degrees.
    #[inline(always)]
    fn correlations<S: Lanes<T>>(
        &self,
        simd: S,
        is_turned: bool,
        workspace: &mut Workspace<T>,
    ) -> Array2<f64> {
        let (engine, w) = (self.engine, workspace);
        let (sx, sy) = engine.geometry.stamp;
        let (pitch, length) = (engine.fft.pitch(), engine.fft.spectrum_len());
        let (wide, high) = engine.geometry.around(self.largest);
        let first = (self.largest.0 - 1, self.largest.1 - 1);
        let mut all = Array2::zeros((self.products.len(), sx * sy));
        let sums = w.kernels.get_mut().chunks_exact_mut(length);
        for (sum, mut values) in sums.zip(all.outer_iter_mut()) {
            let (plane, column) = (w.weighted.get_mut(), w.column.get_mut());
            engine
                .fft
                .inverse_of_swapped(simd, sum, (high, wide), plane, column);
            let values = values.as_slice_mut().expect("row-major");
            for (from, to) in plane
                .chunks_exact(pitch)
                .skip(first.1)
                .zip(values.chunks_exact_mut(sx))
            {
                for (&from, to) in from[first.0..].iter().zip(to) {
                    *to = from.as_f64();
                }
            }
        }
        if is_turned {
            all.invert_axis(Axis(1));
        }
        all
    }
}

/// The functions of a block in a tile.
struct PlacedFunctions<'a, T> {
    functions: &'a Functions<T>,
    /// The first column and row of the tile, counted from its block's first pixel.
    first_column: usize,
    first_row: usize,
    /// The function of a table that is chosen.
    rows: &'a mut FunctionRows<T>,
    /// The polynomial that is chosen.
    chosen: usize,
}

impl<'a, T: ConvReal> PlacedFunctions<'a, T> {
    #[inline(always)]
    fn new(functions: &'a Functions<T>, tile: PlacedTile, rows: &'a mut FunctionRows<T>) -> Self {
        let (first_column, first_row) = tile.corner;
        if let Functions::Table(table) = functions {
            let columns = first_column..first_column + tile.size.0;
            rows.place(table, columns, first_row..first_row + tile.size.1);
        }
        Self {
            functions,
            first_column,
            first_row,
            rows,
            chosen: 0,
        }
    }

    /// Chooses a function.
    #[inline(always)]
    fn set(&mut self, function: usize) {
        self.chosen = function;
        if let Functions::Table(table) = self.functions {
            self.rows.set(table, table.role.function_of(function));
        }
    }

    /// Multiplies the values of a row's pixels by the function.
    #[inline(always)]
    fn multiply(&self, row: usize, values: &[T], products: &mut [T]) {
        match self.functions {
            Functions::Table(_) => self.rows.multiply(row, values, products),
            Functions::Polynomials(polynomials) => {
                let row = self.first_row + row;
                polynomials.along_row(self.chosen, row, self.first_column, products);
                for (product, &value) in products.iter_mut().zip(values) {
                    *product *= value;
                }
            }
        }
    }
}

/// Turns the first columns and rows of a plane by 180 degrees.
#[inline(always)]
fn turn<T: ConvReal>(plane: &mut [T], pitch: usize, (columns, rows): (usize, usize)) {
    for row in plane.chunks_exact_mut(pitch).take(rows) {
        row[..columns].reverse();
    }
    let (mut low, mut high) = (0, rows - 1);
    while low < high {
        let (first, second) = plane.split_at_mut(high * pitch);
        first[low * pitch..][..columns].swap_with_slice(&mut second[..columns]);
        (low, high) = (low + 1, high - 1);
    }
}
