//! Drawing of many stars together.
//!
//! If the oversampling is a whole number `s`, a star uses the same sub-pixel phases of an
//! oversampled stamp in all its pixels: the kernel's weights apply to every `s`-th coefficient. So
//! coefficients are stored by residues modulo `s`. A row of a star is then a linear combination of
//! contiguous values, and one sum runs over kernels and rows of taps. In each block of the field,
//! the few PSFs of a local basis replace the model's components, as in [`crate::Plan`].

mod draw;
mod painter;
mod phases;
mod star_block;
mod star_plan;

pub use painter::StarPainter;
pub use star_plan::StarPlan;
