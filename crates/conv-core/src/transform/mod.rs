//! Transforms of tiles. Each lane of a vector computes its own one-dimensional transform.

mod butterfly;
mod stages;
mod tile;

pub use tile::TileTransform;
pub(crate) use tile::{Plane, StoredPlane, X_STEP, Y_STEP, load, put_twisted};
