//! Transforms of tiles: many one-dimensional transforms side by side in the lanes of vectors.

mod butterfly;
mod stages;
mod tile;

pub use tile::TileTransform;
pub(crate) use tile::{X_STEP, Y_STEP};
