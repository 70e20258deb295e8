//! Transforms of tiles: many one-dimensional transforms side by side in the lanes of vectors.

mod butterfly;
mod stages;
mod tile;

pub(crate) use tile::{TileTransform, X_STEP, Y_STEP};
