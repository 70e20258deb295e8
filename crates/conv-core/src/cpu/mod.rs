//! The fast engine on the processor.
//!
//! Threads convolve blocks independently. Results are added to the image in an order that does not
//! depend on the number of threads ([`scatter`], [`ordered_image`], [`gather`]). An execution inspects
//! the light of each tile ([`treatment`]) and convolves this light by transforms, by the direct sum or
//! stamp by stamp ([`tile_engine`]). It skips dark tiles. The derivatives with respect to PSFs are
//! correlations of light with images ([`correlate`]).

pub(crate) mod correlate;
pub(crate) mod gather;
pub(crate) mod many;
mod ordered_image;
pub(crate) mod processor;
pub(crate) mod scatter;
mod tile_draw;
mod tile_engine;
pub(crate) mod treatment;
