//! Drawing of galaxies.
//!
//! A galaxy is light on the sky, and its image is that light convolved with the interpolated PSF of
//! the galaxy's position, at the centres of the frame's pixels. The PSF holds the response of a
//! pixel, so it is applied once.
//!
//! Near its centre, a galaxy is drawn on a square window: the product of the transforms of light
//! ([`psf_types::LightProfile`]) and PSF ([`spectrum`]), folded into the wavenumbers of the
//! window's pixels, is transformed back ([`window`]). Wavenumbers without light are left out
//! ([`power_spectrum`]). The PSF is a combination of the few stamps of
//! a block of the field ([`kernels`]), as for stars. Outside the window, the light is nearly the
//! image ([`far_field`]). The window is as small as the tolerance ([`extent`]) and the floor ([`floor`])
//! allow. Galaxies beyond the tolerance use all components ([`all_components`]). The spot check computes single pixels
//! by integration on the sky ([`real_space`]).
//!
//! Derivatives ([`gradients`]) are products of an image with the light on the window ([`window_products`]) and
//! outside it ([`far_products`]).

mod all_components;
mod cells;
mod extent;
mod far_field;
mod far_products;
mod floor;
mod galaxy_drawer;
mod gradients;
mod isophotes;
mod kernels;
mod power_spectrum;
mod real_space;
mod spectrum;
mod window;
mod window_products;

pub use all_components::GalaxyErrors;
pub(crate) use extent::truncate;
pub use galaxy_drawer::{ExtendedSources, Light};
pub(crate) use galaxy_drawer::{ExtendedToDraw, GalaxyDrawer};
pub use gradients::{ExtendedGradient, Variation, Variations};
pub(crate) use isophotes::{Isophotes, representative_points};
