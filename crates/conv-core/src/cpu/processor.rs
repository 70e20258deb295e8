//! A plan on the processor, the light of one execution, and the kernels of a block.

use std::cell::OnceCell;
use std::ops::Range;
use std::sync::Arc;

use ndarray::ArrayView2;
use psf_types::{FieldError, Progress};

use super::tile_engine::{TileEngine, Workspace};
use crate::ConvReal;
use crate::plan::Plan;
use crate::plan::block::{Block, Stamps};
use crate::plan::coefficient_table::CoefficientTable;
use crate::plan::geometry::{Direction, PlacedTile};
use crate::simd::{Lanes, vectorized};
use crate::transform::TileTransform;
use crate::workspaces::Workspaces;

/// A plan and the data with which threads of the processor execute it. A plan on a GPU needs these
/// data too, because threads of the processor inspect the light.
#[derive(Debug)]
pub(crate) struct Processor<T: ConvReal> {
    pub(crate) plan: Plan<T>,
    pub(crate) fft: TileTransform<T>,
    workspaces: Workspaces<Workspace<T>>,
}

impl<T: ConvReal> Processor<T> {
    pub(crate) fn new(plan: Plan<T>) -> Self {
        let (nx, ny) = plan.tiling.size;
        Self {
            fft: TileTransform::new(nx, ny),
            workspaces: Workspaces::default(),
            plan,
        }
    }

    /// Lends a workspace to `work`.
    pub(crate) fn with_workspace<R>(&self, work: impl FnOnce(&mut Workspace<T>) -> R) -> R {
        self.workspaces.lend(|| Workspace::new(&self.fft), work)
    }
}

/// One execution of some rows of a plan's blocks. It takes light from one side (the light or, in
/// the adjoint, the image), convolves it, and adds the result to rows of the other side.
#[derive(Clone)]
pub(crate) struct LightPass<'a, T: ConvReal> {
    pub(crate) processor: &'a Processor<T>,
    /// The rows of the plan's grid of blocks that are executed (not rows of pixels).
    pub(crate) rows: Range<usize>,
    /// The plan's layers of which this execution takes the light.
    pub(crate) layers: Range<usize>,
    /// For each of these layers, whole rows of the side that the light comes from.
    pub(crate) light: Vec<ArrayView2<'a, T>>,
    /// The index of the first of these rows.
    pub(crate) first_light: usize,
    /// The index of the first row of the output.
    pub(crate) first_output: usize,
    /// True if stamps are turned by 180 degrees, as in the adjoint.
    pub(crate) flip: bool,
    /// True if tiles may be convolved by the direct sum. False on a GPU, which has no direct sums.
    pub(crate) direct_sums: bool,
    pub(crate) progress: &'a dyn Progress,
}

impl<'a, T: ConvReal> LightPass<'a, T> {
    pub(crate) fn tile_engine(&self) -> TileEngine<'a, T> {
        TileEngine {
            fft: &self.processor.fft,
            geometry: self.processor.plan.geometry,
            flip: self.flip,
        }
    }

    /// The direction in which the light passes.
    pub(crate) fn direction(&self) -> Direction {
        self.processor.plan.direction(self.flip)
    }
}

/// Coefficients, stamps and spectra of a block. When a tile first needs one of them, it is taken
/// from the plan or computed.
pub(crate) struct BlockKernels<'a, T: ConvReal> {
    plan: &'a Plan<T>,
    pub(crate) block: &'a Block<T>,
    table: OnceCell<Arc<CoefficientTable<T>>>,
    stamps: OnceCell<Stamps<T>>,
    /// True if the kernels' spectra serve several arrays of light.
    pub(crate) are_shared: bool,
    transformed: bool,
}

impl<'a, T: ConvReal> BlockKernels<'a, T> {
    /// The kernels of the block at a column and a row.
    pub(crate) fn new(plan: &'a Plan<T>, (column, row): (usize, usize)) -> Self {
        Self {
            plan,
            block: plan.block(column, row),
            table: OnceCell::new(),
            stamps: OnceCell::new(),
            are_shared: false,
            transformed: false,
        }
    }

    pub(crate) fn table(&self) -> &CoefficientTable<T> {
        self.table
            .get_or_init(|| self.block.table_or_new(&self.plan.whole.space))
    }

    /// `[kernel, y, x]`.
    pub(crate) fn stamps(&self) -> &[T] {
        self.stamps
            .get_or_init(|| self.block.stamps_or_new(&self.plan.whole.space))
            .values()
    }

    /// Returns an error if a pixel of a tile needs a PSF of some layers but has none. The error names
    /// the first such pixel. `needed(layer, column, row)` counts from the first of these layers and
    /// from the tile's first pixel.
    pub(crate) fn check(
        &self,
        tile: PlacedTile,
        layers: &Range<usize>,
        needed: impl Fn(usize, usize, usize) -> bool,
    ) -> Result<(), FieldError> {
        let height = self.table().region.shape().ny();
        self.table().check(self.plan.models(), |row, column| {
            let (layer, row, column) = (
                (row / height).wrapping_sub(layers.start),
                (row % height).wrapping_sub(tile.corner.1),
                column.wrapping_sub(tile.corner.0),
            );
            layer < layers.len() && row < tile.size.1 && column < tile.size.0 && needed(layer, column, row)
        })
    }

    /// Ensures that the kernels' spectra are in the workspace.
    pub(crate) fn transform<S: Lanes<T>>(
        &mut self,
        simd: S,
        engine: &TileEngine<'_, T>,
        workspace: &mut Workspace<T>,
    ) {
        if !self.transformed {
            let stamps = self.stamps();
            vectorized!(simd, engine.transform_kernels(simd, stamps, workspace));
            self.transformed = true;
        }
    }
}
