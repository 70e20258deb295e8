//! The fast engine: tiles, each with the few PSFs that its pixels need.
//!
//! A plan cuts the side to which PSFs belong into blocks ([`tiling`]), finds for each the few modes that make every PSF in it
//! within the tolerance ([`local_modes`], from the weights of the field's nodes along rows, [`region_cells`]), and keeps stamps and
//! coefficients ([`coefficient_table`]). An execution goes through the blocks in an order that does not depend on the number of
//! threads ([`scatter`], [`gather`]) and treats each tile by transforms, directly, stamp by stamp or not at all ([`tile_engine`]).

mod axis_cuts;
mod block;
mod blocks;
mod coefficient_table;
mod cost_model;
mod execution;
mod fresh;
mod gather;
mod geometry;
mod job;
mod light;
mod local_modes;
mod method;
#[cfg(feature = "gpu")]
mod on_gpu;
mod options;
#[cfg(feature = "gpu")]
mod packed_table;
mod plan;
#[cfg(feature = "gpu")]
mod plan_view;
mod planning;
mod prepared;
mod psf_space;
mod region_cells;
mod scatter;
mod split;
mod stream;
mod summary;
mod tile_direct;
mod tile_draw;
mod tile_engine;
mod tile_light;
mod tiling;
mod treatment;
mod whole_frame;
mod workspace;

pub use execution::TileCounts;
pub use method::LowRank;
pub use options::{Paths, PlanOptions};
pub use plan::Plan;
pub use stream::RowStream;
pub use summary::PlanSummary;

/// What the drawing of stars shares, and the benches time on its own.
pub(crate) mod internals {
    pub(crate) use super::coefficient_table::{CoefficientTable, FluxRole};
    pub(crate) use super::local_modes::LocalModes;
    pub(crate) use super::plan::rounding;
    pub(crate) use super::psf_space::PsfSpace;
    pub(crate) use super::region_cells::RegionCells;
    pub(crate) use super::workspace::Aligned;
}

/// What the engine on a GPU shares with the one on the processor.
#[cfg(feature = "gpu")]
pub(crate) mod shared {
    pub(crate) use super::job::Job;
    pub(crate) use super::plan_view::PlanView;
    pub(crate) use super::prepared::Prepared;
    pub(crate) use super::tile_light::{Direction, PlacedTile, treated};
    pub(crate) use super::treatment::{Treatment, Ways};
}
