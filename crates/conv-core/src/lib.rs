//! Convolution of a scene with a PSF that varies over the field.
//!
//! A scene `f(x)` holds the flux that arrives at pixel `x`; the PSF at field position `x` is `h(u; x)`. There are two ways to
//! apply it ([`psf_types::Anchor`]):
//!
//! * **source-anchored**, `F(y) = sum_x f(x) h(y - x; x)`: each source spreads with the PSF of its own position, as light
//!   does;
//! * **output-anchored**, `F(y) = sum_x f(x) h(y - x; y)`: each pixel gathers with the PSF of its own position, the form in
//!   the paper of the method (Bai, Jia et al.).
//!
//! | method | what it is | cost | error |
//! |---|---|---|---|
//! | [`Plan`], [`Engine`], [`LowRank`] | the fast engine: in each tile the few modes that its PSFs need | that of 2 to 6 ordinary FFT convolutions | at most the tolerance, for the PSF of every pixel |
//! | [`Direct`] | the double sum, in f64 | each lit pixel times each stamp pixel times `K` | none but rounding; the reference |
//! | [`BasisConvolution`] | `K` whole-image FFT convolutions | `K` transforms of the image | rounding of the precision chosen |
//! | [`PatchConvolution`] | one PSF a patch | one transform of each lit patch | the PSF jumps from patch to patch |
//!
//! A [`Plan`] is data: tiles, the modes of each, their stamps and coefficients. An [`Engine`]
//! executes it on the processor or on a GPU, any number of times. The others are
//! [`ConvolutionMethod`]s, which take a [`psf_types::PsfModel`], light and a frame. The frame is
//! the region of the light that the image shows; its first pixel is the origin of field positions.
//! Outside the light's array there is none.
//!
//! Point sources come on top of extended light. [`StarPainter`] and [`StarPlan`] draw them with the
//! PSF of their own position, shifted to it by [`StampInterpolator`]: one by one from all
//! components, or many at once within a tolerance.
//!
//! # Normalisation
//! The image holds the light's flux times the flux of the PSFs, which the model decides
//! ([`psf_types::Normalisation`]); nothing else is scaled. Extended light needs stamps at the
//! frame's own scale, centred on a pixel ([`native_grid`], [`resample_samples`]); point sources
//! take any stamps.
//!
//! # Stopping
//! The progress object of a long call is polled every few milliseconds and may cancel it
//! ([`psf_types::Progress::cancelled`]); the call then ends with [`ConvError::Cancelled`].
//!
//! # Threads
//! Work is spread over rayon's current pool. Results are the same bytes on any number of threads.
//!
//! # On a GPU
//! With the feature `gpu` (off by default), `Engine::on_gpu` puts a plan on any GPU that Vulkan,
//! Metal, DirectX 12 or OpenGL drives, in f32: see the module `gpu`. Without it nothing of that is
//! compiled.
//!
//! # Modules
//! `plan` knows no device; `cpu` and `gpu` execute plans, and `engine` chooses between them;
//! `stars` draws point sources with the modes of `plan`; `reference` holds the methods that others
//! are compared with. `transform`, `simd`, `overlap`, `view` and the like lie below them all.

#![allow(
    clippy::inline_always,
    reason = "what runs inside `Isa::vectorized` must be inlined there, or it is compiled for the baseline instruction set"
)]

mod cpu;
mod engine;
mod error;
#[cfg(feature = "gpu")]
pub mod gpu;
mod image_memory;
mod overlap;
mod plan;
mod reference;
mod simd;
mod stamp_interpolator;
mod stars;
mod transform;
mod view;
mod working_range;

/// Pieces that the benchmarks time on their own: no part of this crate's interface.
#[doc(hidden)]
pub mod internals {
    pub use crate::plan::coefficient_table::{CoefficientTable, FluxRole};
    pub use crate::plan::local_modes::{LocalModes, PsfSpace};
    pub use crate::plan::region_cells::RegionCells;
    pub use crate::simd::{Aligned, Lanes, WithIsa};
    pub use crate::transform::TileTransform;
}

pub use engine::{Engine, LowRank, Operation, RowStream, TileCounts};
pub use error::ConvError;
pub use image_memory::zeros;
pub use plan::{Paths, Plan, PlanOptions, PlanSummary};
pub use reference::{BasisConvolution, ConvolutionMethod, Direct, PatchConvolution};
pub use simd::ConvReal;
pub use stamp_interpolator::{StampInterpolator, grid_with_pixel_response, native_grid, resample_samples};
pub use stars::{StarPainter, StarPlan};
