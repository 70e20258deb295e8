//! Many stars at once.
//!
//! A star at a sub-pixel position takes the same phases of an oversampled stamp in all its pixels, where the oversampling is a whole
//! number `s`: in each of its pixels the kernel's weights fall on every `s`-th coefficient. So coefficients are kept by residues modulo
//! `s`, and drawing a star is a combination of contiguous values, kernels and rows of taps in one sum. In a block of the field the
//! few PSFs of a local basis ([`crate::Plan`] has the same) stand for all components.

mod draw;
mod painter;
mod phases;
mod star_block;
mod star_plan;

pub use painter::StarPainter;
pub use star_plan::StarPlan;
