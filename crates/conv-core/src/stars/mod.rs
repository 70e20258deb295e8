//! Drawing of many stars together.
//!
//! If the oversampling is a whole number `s`, a star uses the same sub-pixel phases of an
//! oversampled stamp in all its pixels: the kernel's weights apply to every `s`-th coefficient. So
//! coefficients are stored by residues modulo `s`. A star is then a combination of contiguous
//! values, with kernels and rows of taps in one sum. In a block of the field the few PSFs of a
//! local basis, as in [`crate::Plan`], represent all components.

mod draw;
mod painter;
mod phases;
mod star_block;
mod star_plan;

pub use painter::StarPainter;
pub use star_plan::StarPlan;
