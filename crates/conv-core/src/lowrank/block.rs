//! A region whose pixels share one local basis.

use std::borrow::Cow;

use ndarray::{Array2, ArrayView2, Axis, s};
use psf_types::{PixelRegion, PsfModel};

use super::coefficient_table::{CoefficientTable, FluxRole};
use super::local_modes::LocalModes;
use super::psf_space::PsfSpace;
use super::region_cells::RegionCells;
use crate::ConvReal;

/// The local basis of a block, and what a plan has room for.
#[derive(Debug)]
pub(crate) struct Block<T> {
    region: PixelRegion,
    modes: LocalModes,
    role: FluxRole,
    flux: f64,
    table: Option<CoefficientTable<T>>,
    /// `[kernel, y, x]`.
    stamps: Option<Vec<T>>,
}

/// A coefficient table, kept or made anew.
#[derive(Debug)]
pub(crate) enum Table<'a, T> {
    Kept(&'a CoefficientTable<T>),
    New(CoefficientTable<T>),
}

impl<T> std::ops::Deref for Table<'_, T> {
    type Target = CoefficientTable<T>;
    fn deref(&self) -> &CoefficientTable<T> {
        match self {
            Self::Kept(table) => table,
            Self::New(table) => table,
        }
    }
}

impl<T: ConvReal> Block<T> {
    /// The block, with its coefficients if they are to be kept.
    pub(crate) fn new(
        model: &PsfModel,
        space: &PsfSpace,
        region: PixelRegion,
        tolerance: f64,
        keep_table: bool,
    ) -> Self {
        let cells = RegionCells::new(model.field(), region);
        let modes = LocalModes::new(space, &cells, tolerance);
        let (role, flux) = FluxRole::of(model, &modes, &cells);
        let table = keep_table.then(|| CoefficientTable::new(region, role, &modes, &cells));
        Self {
            region,
            modes,
            role,
            flux,
            table,
            stamps: None,
        }
    }

    /// Modes, and the reference where there is one.
    pub(crate) fn kernel_count(&self) -> usize {
        self.modes.rank() + usize::from(self.modes.reference().is_some())
    }

    pub(crate) fn has_table(&self) -> bool {
        self.table.is_some()
    }

    pub(crate) fn has_stamps(&self) -> bool {
        self.stamps.is_some()
    }

    pub(crate) fn table_bytes(&self) -> usize {
        self.table.as_ref().map_or(0, CoefficientTable::bytes)
    }

    pub(crate) fn stamp_bytes(&self) -> usize {
        self.stamps.as_ref().map_or(0, |stamps| size_of_val(&stamps[..]))
    }

    pub(crate) fn forget_table(&mut self) {
        self.table = None;
    }

    pub(crate) fn keep_stamps(&mut self, stamps: Vec<T>) {
        self.stamps = Some(stamps);
    }

    pub(crate) fn table(&self, model: &PsfModel) -> Table<'_, T> {
        if let Some(table) = &self.table {
            return Table::Kept(table);
        }
        let cells = RegionCells::new(model.field(), self.region);
        Table::New(CoefficientTable::new(self.region, self.role, &self.modes, &cells))
    }

    pub(crate) fn stamps(&self, space: &PsfSpace) -> Cow<'_, [T]> {
        match &self.stamps {
            Some(stamps) => Cow::Borrowed(stamps),
            None => Cow::Owned(
                stamps_of(space.stamps(), &[self])
                    .pop()
                    .expect("one block's stamps"),
            ),
        }
    }

    /// The kernels as vectors `[kernel, direction]`.
    fn directions(&self) -> Array2<f64> {
        let modes = self.modes.modes();
        match self.modes.reference() {
            None => modes.to_owned(),
            Some(reference) => {
                let reference = (&reference * self.flux).insert_axis(Axis(0));
                ndarray::concatenate(Axis(0), &[reference.view(), modes]).expect("as many directions")
            }
        }
    }
}

/// The stamps of some blocks, by one product of matrices.
pub(crate) fn stamps_of<T: ConvReal>(stamps: ArrayView2<'_, f64>, blocks: &[&Block<T>]) -> Vec<Vec<T>> {
    let directions: Vec<Array2<f64>> = blocks.iter().map(|block| block.directions()).collect();
    let views: Vec<ArrayView2<'_, f64>> = directions.iter().map(|d| d.view()).collect();
    let all = ndarray::concatenate(Axis(0), &views)
        .expect("as many directions")
        .dot(&stamps);
    let mut first = 0;
    directions
        .iter()
        .map(|d| {
            let rows = all.slice(s![first..first + d.nrows(), ..]);
            first += d.nrows();
            rows.iter().map(|&v| T::nearest(v)).collect()
        })
        .collect()
}
