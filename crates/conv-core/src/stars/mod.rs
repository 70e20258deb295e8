//! Drawing of many stars together.
//!
//! In each block of the field, the few PSFs of a local basis (the *kernels* of the block) replace
//! the model's components, as in [`crate::Plan`].
//!
//! Each pixel of a star is interpolated from coefficients of the stamp: its values, or the
//! coefficients of its spline. The coefficients that contribute to a pixel are its *taps*. If the
//! oversampling of the stamp is a whole number `s`, the taps of neighbouring pixels are `s`
//! coefficients apart and have equal weights. So coefficients are stored by their *residue*, which
//! is their index modulo `s`. A row of a star is then a linear combination of contiguous values.
//! The sum runs over the block's kernels, the rows of coefficients that contribute to the row of
//! the star, and the taps along the row. Where stars are many, [`spread`] is faster.
//! Derivatives take the sums in the opposite order ([`gradients`]). Stars of a PSF with wings
//! are drawn in two parts, the core and the [`wings`].

mod draw;
mod draw_blocks;
mod gradients;
mod painter;
mod phase_norms;
mod phased_stamps;
mod phases;
mod reach;
mod row_layout;
mod spread;
mod star_block;
mod star_drawer;
mod wing_transform;
mod wings;

pub(crate) use draw_blocks::StarsToDraw;
pub use painter::StarPainter;
pub(crate) use star_drawer::StarDrawer;
pub(crate) use wings::{WingDrawer, wing_points};
