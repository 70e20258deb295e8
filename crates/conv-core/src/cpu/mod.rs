//! The fast engine on the processor.
//!
//! An execution goes through a plan's blocks in an order that does not depend on the number of
//! threads ([`scatter`], [`gather`]), looks at the light of each tile ([`treatment`]) and convolves
//! it by transforms, directly, stamp by stamp or not at all ([`tile_engine`]).

pub(crate) mod gather;
pub(crate) mod processor;
pub(crate) mod scatter;
mod tile_draw;
mod tile_engine;
pub(crate) mod treatment;
