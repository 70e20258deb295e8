//! Plans: everything about a convolution that depends neither on the light nor on the device that
//! executes it.
//!
//! PSFs belong to the pixels of one side: the light (source-anchored) or the image
//! (output-anchored). A plan divides this side into tiles and groups neighbouring tiles into blocks
//! ([`tiling`]). For each block it finds the modes: a few stamps whose linear combinations
//! represent every PSF of the block within the tolerance ([`local_modes`]). At each pixel, the
//! coefficient field of the PSF model is a weighted sum over nodes, such as PSF samples. The plan
//! computes the modes from these weights in the block ([`region_cells`]). It keeps the stamps and
//! coefficients of the modes ([`coefficient_table`]).

mod allowed_errors;
mod arrays;
pub(crate) mod axis_cuts;
pub(crate) mod block;
#[cfg(test)]
mod certificate;
mod checked_cells;
pub(crate) mod coefficient_table;
pub(crate) mod cost_model;
pub(crate) mod function_rows;
pub(crate) mod geometry;
mod growth_curves;
pub(crate) mod local_modes;
mod node_functions;
pub(crate) mod norm;
mod options;
mod polynomials;
pub(crate) mod psf_space;
pub(crate) mod region_cells;
pub(crate) mod sample_weights;
mod smooth_table;
mod span;
mod summary;
mod tiling;

use std::ops::Range;
use std::sync::Arc;

use ndarray::Array2;
use psf_types::{Anchor, FrameShape, NoProgress, PixelRegion, Progress, PsfModel};
use rayon::prelude::*;

pub use arrays::{BlockArrays, PlanArrays};
use axis_cuts::{Stretch, longest};
use block::{Block, stamps_of};
use cost_model::CostModel;
use geometry::{Direction, Geometry};
pub use options::{Paths, PlanOptions};
pub use sample_weights::SampleWeights;
pub use summary::PlanSummary;
use tiling::{Tiling, WholeFrame};

use crate::image_memory::zeros;
use crate::view::{self, View, in_words};
use crate::{ConvError, ConvReal};

/// Returns whether models have the same stamps and the same scaling to unit flux.
pub(crate) fn share_stamps(a: &PsfModel, b: &PsfModel) -> bool {
    let of_wings = match (a.wings(), b.wings()) {
        (Some(a), Some(b)) => a.has_stamps_of(b),
        (a, b) => a.is_none() && b.is_none(),
    };
    of_wings && a.has_basis_of(b) && a.needs_flux_scaling() == b.needs_flux_scaling()
}

/// Checks that models can be layers of one plan.
pub(crate) fn check_layers(models: &[PsfModel]) -> Result<(), ConvError> {
    match models {
        [] => Err(ConvError::Layers("at least one model is needed")),
        [first, others @ ..] if !others.iter().all(|other| share_stamps(first, other)) => {
            Err(ConvError::Layers(
                "the models must have the same stamps and the same scaling to unit flux: fit one basis to all samples",
            ))
        }
        _ => Ok(()),
    }
}

/// The number of blocks planned in parallel.
const BLOCKS_AT_ONCE: usize = 64;

/// A planned convolution of light of one shape with one model: tiles, the modes of each tile, their
/// stamps and coefficients.
///
/// A plan is data. An [`Engine`](crate::Engine) executes it, any number of times. A plan describes
/// a linear operator, because the modes of a tile depend on the model and the tolerance, never on
/// the light.
///
/// In a tile the PSFs are `h(x) = flux(x) reference + sum_j c_j(x) mode_j`. The reference is a PSF
/// of unit flux. A tile has as few modes as can represent each of its PSFs within the tolerance.
/// The modes hold no flux, so PSFs of unit flux keep it at any tolerance. Where PSFs have fluxes of
/// their own and coefficients are not bilinear in cells, cells change the flux a little. With a
/// tolerance on apertures, this change is at most half of the tolerance. A tolerance on L2 does not
/// bound it. If the PSFs of a tile hold too little flux for a reference, a single mode carries all
/// flux and is always kept.
#[derive(Debug)]
pub struct Plan<T: ConvReal> {
    pub(crate) whole: Arc<WholeFrame>,
    pub(crate) geometry: Geometry,
    options: PlanOptions,
    pub(crate) tiling: Tiling,
    pub(crate) cost: CostModel,
    /// The blocks, row by row.
    pub(crate) blocks: Vec<Block<T>>,
    /// The part of the frame that the plan computes, in pixels of the frame.
    region: PixelRegion,
    /// Columns and rows of the scene that reach the region.
    pub(crate) light: [Range<usize>; 2],
}

impl<T: ConvReal> Plan<T> {
    /// Plans the convolution of light of a given shape. `frame` is the region of the light that the
    /// image shows.
    ///
    /// # Errors
    /// [`ConvError`] if the model's stamps do not suit an image, or the frame reaches beyond the
    /// light. A missing PSF is no error here. An execution fails if its light needs that PSF.
    pub fn new(
        model: &PsfModel,
        shape: FrameShape,
        frame: PixelRegion,
        options: PlanOptions,
    ) -> Result<Self, ConvError> {
        Self::for_region(model, shape, frame, frame.shape().region(), options, &NoProgress)
    }

    /// Plans a region of the frame, in pixels of the frame, so that many machines can share a
    /// frame. The plan uses the tiles and modes of the whole frame, and keeps only the tiles that
    /// reach the region. The images of regions, put together, equal the image of the whole plan up
    /// to rounding, at any tolerance. So the edges of regions are not visible.
    ///
    /// Executions accept the whole light or only its part in [`light_region`](Self::light_region).
    /// Their image covers only the region. `progress` is polled and may cancel the planning. No
    /// steps are reported to it.
    ///
    /// Each call chooses the tiles of the whole frame, which takes long. To plan many regions of a
    /// frame, make one plan in this way and the others by
    /// [`for_other_region`](Self::for_other_region), which reuses the tiles.
    ///
    /// ```
    /// use std::sync::Arc;
    ///
    /// use conv_core::{Engine, Operation, Plan, PlanOptions};
    /// use ndarray::{Array2, Array3, s};
    /// use psf_types::{
    ///     CoefficientField, FieldError, FrameShape, ImageView, NoProgress, Normalisation,
    ///     PixelRegion, Position, PsfBasis, PsfModel, StampGrid,
    /// };
    ///
    /// /// No component at all: the mean stamp everywhere.
    /// #[derive(Debug)]
    /// struct Constant;
    /// impl CoefficientField for Constant {
    ///     fn component_count(&self) -> usize {
    ///         0
    ///     }
    ///     fn evaluate_into(&self, _: Position, _: &mut [f64]) -> Result<(), FieldError> {
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let mean = Array2::from_elem((5, 5), 0.04);
    /// let basis = PsfBasis::new(Some(mean), Array3::zeros((0, 5, 5)), StampGrid::new(5, 5)?)?;
    /// let model = PsfModel::new(&basis, Arc::new(Constant), Normalisation::Unit, None)?;
    /// let light = Array2::from_shape_fn((60, 80), |(y, x)| ((7 * x + 3 * y) % 11) as f64);
    /// let (shape, options) = (FrameShape::new(80, 60)?, PlanOptions::new(1e-3)?);
    /// let engine = Engine::new(Plan::new(&model, shape, shape.region(), options)?);
    /// let mut whole = engine.plan().zeros();
    /// let all = ImageView::new(light.view())?;
    /// engine.execute(Operation::Convolve, &[all], vec![whole.view_mut()], &NoProgress)?;
    ///
    /// let region = PixelRegion::new(32, 20, FrameShape::new(16, 20)?);
    /// let plan = Plan::for_region(&model, shape, shape.region(), region, options, &NoProgress)?;
    /// let engine = Engine::new(plan);
    /// let part = engine.plan().light_region();
    /// assert_eq!((part.x0(), part.y0(), part.shape()), (30, 18, FrameShape::new(20, 24)?));
    /// let light = ImageView::new(light.slice(s![18..42, 30..50]))?;
    /// let mut image = Array2::zeros((20, 16));
    /// engine.execute(Operation::Convolve, &[light], vec![image.view_mut()], &NoProgress)?;
    /// let difference = &image - &whole.slice(s![20..40, 32..48]);
    /// assert!(difference.iter().all(|d: &f64| d.abs() < 1e-12));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`ConvError`] as for [`Self::new`], [`ConvError::RegionOutsideFrame`] or
    /// [`ConvError::Cancelled`].
    #[inline(never)]
    pub fn for_region(
        model: &PsfModel,
        shape: FrameShape,
        frame: PixelRegion,
        region: PixelRegion,
        options: PlanOptions,
        progress: &dyn Progress,
    ) -> Result<Self, ConvError> {
        let models = std::slice::from_ref(model);
        Self::of_layers(models, shape, frame, region, options, progress)
    }

    /// Plans the convolution of several arrays of light, the *layers*, each with the PSFs of its own
    /// model, into one image: `F = sum_l sum_x f_l(x) h_l(x)`. For example, each layer is the light of
    /// one spectrum. The models share their stamps.
    ///
    /// The modes of a block represent the PSFs of all layers. So an execution
    /// ([`Engine::execute`](crate::Engine::execute)) first adds the weighted layers,
    /// mode by mode, and transforms the sums: layers cost no transforms of their own. The tolerance
    /// holds for every layer at every position.
    ///
    /// # Errors
    /// As for [`for_region`](Self::for_region), and [`ConvError::Layers`] without models, or if their
    /// stamps or their scaling to unit flux differ.
    pub fn of_layers(
        models: &[PsfModel],
        shape: FrameShape,
        frame: PixelRegion,
        region: PixelRegion,
        options: PlanOptions,
        progress: &dyn Progress,
    ) -> Result<Self, ConvError> {
        check_layers(models)?;
        let view = View::new(shape, frame)?;
        let whole = WholeFrame::new::<T>(models, view, options, progress)?;
        Self::of_whole(Arc::new(whole), region, options, progress)
    }

    /// Plans another region of the same frame, or all of it, with the tiles chosen for this plan.
    /// This is much faster than choosing tiles again.
    ///
    /// # Errors
    /// [`ConvError::RegionOutsideFrame`] or [`ConvError::Cancelled`].
    pub fn for_other_region(&self, region: PixelRegion, progress: &dyn Progress) -> Result<Self, ConvError> {
        let whole = Arc::clone(&self.whole);
        Self::of_whole(whole, region, self.options, progress)
    }

    /// Plans the same frame for other models, such as other coefficients of the same basis. Keeps the
    /// tiles chosen for this plan, and finds the modes of each block anew, so that the tolerance holds.
    /// This is much faster than a new plan, which may choose other tiles. `memory_bytes` is the limit of
    /// [`PlanOptions::with_memory`]. There is one model for each layer ([`of_layers`](Self::of_layers)).
    /// `None` if the shape or the centre of the stamps differs.
    ///
    /// # Errors
    /// [`ConvError`] as for [`Self::of_layers`], or [`ConvError::Cancelled`].
    pub fn for_other_fields(
        &self,
        models: &[PsfModel],
        memory_bytes: usize,
        progress: &dyn Progress,
    ) -> Result<Option<Self>, ConvError> {
        check_layers(models)?;
        let options = self.options.with_memory(memory_bytes);
        let Some(whole) = self.whole.for_other_models::<T>(models, options)? else {
            return Ok(None);
        };
        Self::of_whole(Arc::new(whole), self.region, options, progress).map(Some)
    }

    #[inline(never)]
    pub(crate) fn of_whole(
        whole: Arc<WholeFrame>,
        region: PixelRegion,
        options: PlanOptions,
        progress: &dyn Progress,
    ) -> Result<Self, ConvError> {
        let part = whole.part(region)?;
        let mut plan = Self {
            light: part.light,
            region,
            geometry: part.geometry,
            options,
            tiling: part.tiling,
            cost: CostModel::of::<T>(),
            blocks: Vec::new(),
            whole,
        };
        let left = plan.add_blocks(&part.blocks, progress)?;
        plan.keep_stamps(left);
        Ok(plan)
    }

    /// Plans some of the whole frame's blocks, row by row. `columns` and `rows` count blocks. Keeps
    /// the blocks' coefficients as long as memory is left. Returns the bytes of memory that remain.
    fn add_blocks(
        &mut self,
        [columns, rows]: &[Range<usize>; 2],
        progress: &dyn Progress,
    ) -> Result<usize, ConvError> {
        let tolerance = self.options.tolerance_in::<T>();
        let across = columns.len();
        let count = across * rows.len();
        let mut left = self.options.memory_bytes();
        let mut full = false;
        // Plans a few blocks at a time, because tables that will not be kept need memory too.
        for first in (0..count).step_by(BLOCKS_AT_ONCE) {
            let made: Vec<Block<T>> = (first..(first + BLOCKS_AT_ONCE).min(count))
                .into_par_iter()
                .with_max_len(1)
                .map(|i| {
                    progress.check_cancelled()?;
                    let whole = &self.whole;
                    let region = whole.block(columns.start + i % across, rows.start + i / across);
                    Ok(Block::new(&whole.space, region, tolerance, !full))
                })
                .collect::<Result<_, ConvError>>()?;
            for mut block in made {
                match left.checked_sub(block.table_bytes()) {
                    Some(rest) if !full => left = rest,
                    _ => {
                        full = true;
                        block.table = None;
                    }
                }
                self.blocks.push(block);
            }
        }
        Ok(left)
    }

    /// Computes and keeps the stamps of the first blocks, as far as the memory left allows.
    fn keep_stamps(&mut self, mut left: usize) {
        let stamp = self.geometry.stamp.0 * self.geometry.stamp.1 * size_of::<T>();
        let mut room = 0;
        while room < self.blocks.len() {
            match left.checked_sub(self.blocks[room].kernel_count() * stamp) {
                Some(rest) => left = rest,
                None => break,
            }
            room += 1;
        }
        if room == 0 {
            return;
        }
        let kept = &mut self.blocks[..room];
        let made = stamps_of(&self.whole.space, &kept.iter().collect::<Vec<_>>(), true);
        for (block, stamps) in kept.iter_mut().zip(made) {
            block.stamps = Some(stamps);
        }
    }

    /// The models of the layers, at least one ([`of_layers`](Self::of_layers)).
    pub fn models(&self) -> &[PsfModel] {
        &self.whole.space.models
    }

    /// The model of the first layer.
    pub fn model(&self) -> &PsfModel {
        self.whole.space.model()
    }

    /// The options of the plan.
    pub fn options(&self) -> PlanOptions {
        self.options
    }

    /// The shape of the light.
    pub fn scene_shape(&self) -> FrameShape {
        self.whole.view.shape
    }

    /// The frame, in pixels of the light.
    pub fn frame(&self) -> PixelRegion {
        self.whole.view.frame
    }

    /// The part of the frame that this plan computes, in pixels of the frame. It is the whole frame
    /// unless the plan was made [for a region](Self::for_region).
    pub fn region(&self) -> PixelRegion {
        self.region
    }

    /// The part of the light that reaches the plan's [region](Self::region), in pixels of the
    /// light.
    pub fn light_region(&self) -> PixelRegion {
        let [columns, rows] = &self.light;
        let (x0, y0) = (columns.start as i64, rows.start as i64);
        view::region(x0, y0, (columns.len(), rows.len()))
    }

    /// The blocks, row by row: the pixels of each, and its number of modes, the reference included.
    /// The pixels count from the first pixel of the light. The blocks cover the
    /// [light that reaches the region](Self::light_region) (source-anchored) or the
    /// [region](Self::region) (output-anchored), each pixel once.
    pub fn blocks(&self) -> impl ExactSizeIterator<Item = (PixelRegion, usize)> {
        let (across, frame) = (self.tiling.columns.len(), self.frame());
        self.blocks.iter().enumerate().map(move |(i, block)| {
            let region = self.tiling.region(&self.geometry, i % across, i / across);
            (region.shifted(frame.x0(), frame.y0()), block.kernel_count())
        })
    }

    /// An image `[y, x]` of zeros with the shape of the plan's [region](Self::region), for
    /// [`Engine::execute`](crate::Engine::execute). It is faster to add to this image than to
    /// another large array of zeros, because its memory pages have already been written to.
    pub fn zeros(&self) -> Array2<T> {
        zeros((self.region.shape().ny(), self.region.shape().nx()))
    }

    /// Returns the columns and rows of an array of light that reach the region. The array has the
    /// shape `got`: it holds the whole light, or only the part that reaches the region.
    pub(crate) fn light_part(&self, got: FrameShape) -> Result<[Range<usize>; 2], ConvError> {
        let (part, whole) = (self.light_region(), self.scene_shape());
        if got == part.shape() {
            Ok([0..got.nx(), 0..got.ny()])
        } else if got == whole {
            Ok(self.light.clone())
        } else {
            let part = in_words(part);
            let expected = format!("the whole scene of {whole} or its part of {part} that reaches the image");
            Err(ConvError::LightShape { expected, got })
        }
    }

    /// The direction in which light passes in a convolution, or in the adjoint if `transposed` is
    /// true.
    pub(crate) fn direction(&self, transposed: bool) -> Direction {
        match (self.options.anchor(), transposed) {
            (Anchor::Output, false) | (Anchor::Source, true) => Direction::Gather,
            _ => Direction::Scatter,
        }
    }

    /// Predicted seconds for a fully lit tile, and whether the tile is convolved by the direct sum.
    pub(crate) fn whole_tile(&self, tile: (usize, usize), kernels: usize) -> (f64, bool) {
        let layers = self.models().len();
        let transforms = self.cost.tile(tile, self.tiling.size, kernels as f64, layers);
        let direct = self.cost.direct(tile, self.geometry.stamp, kernels);
        if direct < transforms && self.options.paths() == Paths::Cheapest {
            (direct, true)
        } else {
            (transforms, false)
        }
    }

    pub(crate) fn block(&self, column: usize, row: usize) -> &Block<T> {
        &self.blocks[row * self.tiling.columns.len() + column]
    }

    /// The blocks divide one side, the light or the image. For each column (axis 0) or row (axis 1)
    /// of blocks, returns the first pixel and the end of the range that it reaches on the other
    /// side.
    pub(crate) fn extents(&self, axis: usize) -> Vec<(usize, usize)> {
        let stretches = [&self.tiling.columns, &self.tiling.rows][axis].iter();
        let reached = stretches.map(|s| self.geometry.reached(axis, s.start()..s.end()));
        reached.map(|r| (r.start, r.end)).collect()
    }

    /// Summarises the plan in numbers.
    pub fn summary(&self) -> PlanSummary {
        let most = self.blocks.iter().map(Block::kernel_count).max().unwrap_or(0);
        let mut blocks_by_modes = vec![0; most + 1];
        for block in &self.blocks {
            blocks_by_modes[block.kernel_count()] += 1;
        }
        let kept_bytes = (
            self.blocks.iter().map(Block::table_bytes).sum(),
            self.blocks.iter().map(Block::stamp_bytes).sum(),
        );
        let made_anew = (
            self.blocks.iter().filter(|block| block.table.is_none()).count(),
            self.blocks.iter().filter(|block| block.stamps.is_none()).count(),
        );
        let kept_tables = self.blocks.len() - made_anew.0;
        let kernels: usize = self.blocks.iter().map(Block::kernel_count).sum();
        let stamp = self.geometry.stamp.0 * self.geometry.stamp.1 * size_of::<T>();
        let tiles = |stretches: &[Stretch]| stretches.iter().map(|s| s.tiles.len()).sum::<usize>();
        let tiling = &self.tiling;
        let tile = (longest(&tiling.columns), longest(&tiling.rows));
        let tiles = tiles(&tiling.columns) * tiles(&tiling.rows);
        let mean_modes = kernels as f64 / self.blocks.len().max(1) as f64;
        let (whole, direct) = self.whole_tile(tile, mean_modes.ceil() as usize);
        let (direction, shape) = (self.direction(false), self.geometry.stamp);
        let draw = self.cost.draw(direction, shape, mean_modes.ceil() as usize);
        let draws = self.options.paths() == Paths::Cheapest;
        PlanSummary {
            frame: self.frame().shape(),
            region: self.region,
            precision: T::NAME,
            tolerance: self.options.tolerance(),
            tolerance_on: self.options.tolerance_on(),
            anchor: self.options.anchor(),
            paths: self.options.paths(),
            tile,
            transform: tiling.size,
            tiles,
            blocks: self.blocks.len(),
            blocks_by_modes,
            drawn_up_to: usize::from(draws) * (whole / draw) as usize,
            direct,
            predicted_seconds: tiles as f64 * whole
                + self.blocks.len() as f64 * mean_modes * self.cost.kernel(tiling.size, shape),
            kept_bytes,
            made_anew,
            all_bytes: kernels * stamp + kept_bytes.0 * self.blocks.len() / kept_tables.max(1),
        }
    }
}
