//! What the tiles of a block share.

use std::borrow::Cow;

use psf_types::FieldError;

use super::block::{Block, Table};
use super::coefficient_table::CoefficientTable;
use super::plan::Plan;
use super::tile_engine::{LocalTile, TileEngine, TilePart};
use super::workspace::Workspace;
use crate::ConvReal;
use crate::simd::Lanes;

/// Coefficients, stamps and spectra of a block, made when the first of them needs it.
pub(crate) struct Prepared<'a, T: ConvReal> {
    plan: &'a Plan<T>,
    block: &'a Block<T>,
    table: Option<Table<'a, T>>,
    stamps: Option<Cow<'a, [T]>>,
    transformed: bool,
}

impl<'a, T: ConvReal> Prepared<'a, T> {
    pub(crate) fn new(plan: &'a Plan<T>, block: &'a Block<T>) -> Self {
        Self {
            plan,
            block,
            table: None,
            stamps: None,
            transformed: false,
        }
    }

    /// For the block at a column and a row.
    #[cfg(feature = "gpu")]
    pub(crate) fn of_block(plan: &'a Plan<T>, (column, row): (usize, usize)) -> Self {
        Self::new(plan, plan.block(column, row))
    }

    /// The block's coefficients and stamps.
    pub(crate) fn table_and_stamps(&mut self) -> (&CoefficientTable<T>, &[T]) {
        let (block, plan) = (self.block, self.plan);
        (
            self.table.get_or_insert_with(|| block.table(&plan.model)),
            self.stamps.get_or_insert_with(|| block.stamps(&plan.whole.space)),
        )
    }

    fn table(&mut self) -> &CoefficientTable<T> {
        let (block, model) = (self.block, &self.plan.model);
        self.table.get_or_insert_with(|| block.table(model))
    }

    /// What there is for a tile.
    pub(crate) fn local(&mut self, part: TilePart) -> LocalTile<'_, T> {
        let (table, stamps) = self.table_and_stamps();
        LocalTile { part, table, stamps }
    }

    fn stamps(&mut self) -> &[T] {
        let (block, plan) = (self.block, self.plan);
        self.stamps.get_or_insert_with(|| block.stamps(&plan.whole.space))
    }

    /// Modes, and the reference where there is one.
    pub(crate) fn kernel_count(&self) -> usize {
        self.block.kernel_count()
    }

    /// The error of the first pixel of a tile that has no PSF and needs one: `needed(column, row)` counts from the tile's first
    /// pixel.
    pub(crate) fn check(
        &mut self,
        part: TilePart,
        needed: impl Fn(usize, usize) -> bool,
    ) -> Result<(), FieldError> {
        let model = &self.plan.model;
        let table = self.table();
        if !table.has_undefined() {
            return Ok(());
        }
        table.check(model, |row, column| {
            let (row, column) = (
                row.wrapping_sub(part.corner.1),
                column.wrapping_sub(part.corner.0),
            );
            row < part.size.1 && column < part.size.0 && needed(column, row)
        })
    }

    /// Sees to the kernels' spectra in the workspace.
    pub(crate) fn kernels<S: Lanes<T>>(
        &mut self,
        simd: S,
        engine: &TileEngine<'_, T>,
        workspace: &mut Workspace<T>,
    ) {
        if !self.transformed {
            let stamps = self.stamps();
            simd.vectorized(
                #[inline(always)]
                || engine.transform_kernels(simd, stamps, workspace),
            );
            self.transformed = true;
        }
    }
}
