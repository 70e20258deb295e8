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
//! | [`LowRank`], [`Plan`] | the fast engine: in each tile the few modes that its PSFs need | that of 2 to 6 ordinary FFT convolutions | at most the tolerance, for the PSF of every pixel |
//! | [`Direct`] | the double sum, in f64 | each lit pixel times each stamp pixel times `K` | none but rounding; the reference |
//! | [`BasisConvolution`] | `K` whole-image FFT convolutions | `K` transforms of the image | rounding of the precision chosen |
//! | [`PatchConvolution`] | one PSF a patch | one transform of each lit patch | the PSF jumps from patch to patch |
//!
//! All but [`Plan`] are [`ConvolutionMethod`]s over a [`psf_types::PsfModel`] and a [`psf_types::Scene`]. Outside the scene there is no
//! light. Point sources are drawn with the PSF of their own position, shifted to it by [`StampInterpolator`]: one by one from all
//! components ([`StarPainter`]), or many at once within a tolerance ([`StarPlan`], as plans do).
//!
//! # Normalisation
//! The image holds the scene's flux times the flux of the PSFs, which the model decides ([`psf_types::Normalisation`]); nothing
//! else is scaled. An image scene needs stamps at the frame's own scale, centred on a pixel ([`native_grid`],
//! [`resample_samples`]); point sources take any stamps.
//!
//! # Stopping
//! Whoever is told of the progress of a long call is also asked whether it is still wanted ([`psf_types::Progress::cancelled`]), every few
//! milliseconds; where it is not, the call ends with [`ConvError::Cancelled`].
//!
//! # Threads
//! Work is spread over rayon's current pool. Results are the same bytes on any number of threads.
//!
//! # On a GPU
//! With the feature `gpu` (off by default), `Plan::use_gpu` runs a plan's executions on any GPU that Vulkan, Metal, DirectX 12 or OpenGL drives, in f32: see the
//! module `gpu`. Without it nothing of that is compiled.

#![allow(
    clippy::inline_always,
    reason = "what runs inside `Isa::vectorized` must be inlined there, or it is compiled for the baseline instruction set"
)]

mod basis_convolution;
#[doc(hidden)]
pub mod bench_support;
mod crop;
mod direct;
mod error;
mod fft2;
#[cfg(feature = "gpu")]
pub mod gpu;
mod image_memory;
mod kernel;
mod lowrank;
mod method;
mod overlap;
mod patch;
mod planes;
mod point_sources;
mod simd;
mod stamp_interpolator;
mod stars;
mod transform;
mod working_range;

pub use basis_convolution::BasisConvolution;
pub use direct::Direct;
pub use error::ConvError;
pub use lowrank::{LowRank, Paths, Plan, PlanOptions, PlanSummary, RowStream, TileCounts};
pub use method::{ConvReal, ConvolutionMethod};
pub use patch::PatchConvolution;
pub use point_sources::{StarPainter, add_point_sources};
pub use stamp_interpolator::{StampInterpolator, grid_with_pixel_response, native_grid, resample_samples};
pub use stars::StarPlan;
