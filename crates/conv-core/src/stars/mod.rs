//! Drawing of many stars together.
//!
//! In each block of the field, the few PSFs of a local basis (the *kernels* of the block) replace
//! the model's components, as in [`crate::Plan`].
//!
//! If the oversampling is a whole number `s`, a star uses the same sub-pixel phases of an
//! oversampled stamp in all its pixels: the interpolation weights apply to every `s`-th
//! coefficient. So coefficients are stored by residues modulo `s`. A row of a star is then a linear
//! combination of contiguous values. One sum runs over the block's kernels and over the rows of
//! coefficients that contribute to the row of the star (the *taps*).

mod draw;
mod painter;
mod phases;
mod star_block;
mod star_plan;

pub use painter::StarPainter;
pub use star_plan::StarPlan;
