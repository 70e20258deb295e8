//! Convolution of a scene with a PSF that varies over the field.
//!
//! A scene `f(x)` holds the flux that arrives at pixel `x`. The PSF at field position `x` is
//! `h(u; x)`, where `u` is the offset from the source. There are two ways to compute the image
//! `F(y)` ([`psf_types::Anchor`]):
//!
//! - **source-anchored**, `F(y) = sum_x f(x) h(y - x; x)`: each source spreads with the PSF of its
//!   own position, as in a real instrument.
//! - **output-anchored**, `F(y) = sum_x f(x) h(y - x; y)`: each pixel gathers light with the PSF of
//!   the pixel's own position. This is the form in the paper of the method (Bai, Jia et al.).
//!
//! | method | description | cost | error |
//! |---|---|---|---|
//! | [`Plan`], [`Engine`], [`LowRank`] | the fast engine: a few modes per tile | 2 to 6 ordinary FFT convolutions | at most the tolerance, for the PSF of every pixel |
//! | [`Direct`] | the double sum, in f64 | each lit pixel times each stamp pixel times `K` | only rounding: the reference |
//! | [`BasisConvolution`] | `K` whole-image FFT convolutions | `K` transforms of the image | rounding of the precision chosen |
//! | [`PatchConvolution`] | one PSF per patch | one transform of each lit patch | the PSF jumps from patch to patch |
//!
//! `K` is the number of stamps of the model. The modes of a tile are a few stamps whose linear
//! combinations represent all PSFs of the tile.
//!
//! A [`Plan`] is data: tiles, the modes of each, their stamps and coefficients. An [`Engine`]
//! executes it on the processor or on a GPU, any number of times. The other types in the table are
//! [`ConvolutionMethod`]s, which take a [`psf_types::PsfModel`], light and a frame. The frame is
//! the region of the light that the image shows. The frame's first pixel is the origin of field
//! positions. Outside the given array of light, all light is taken as zero.
//!
//! Stars and galaxies are added to the image of extended light. A [`SourcePlan`] draws
//! each source at its sub-pixel position, many at once, within a tolerance. It interpolates the stamps as
//! [`StampInterpolator`] does. The anchor selects the PSF, as for extended light. [`StarPainter`] draws stars
//! one by one from all components of the model.
//!
//! # Normalisation
//! The image holds the light's flux times the flux of the PSFs. The model decides the flux of the
//! PSFs ([`psf_types::Normalisation`]), and nothing else is scaled. Extended light needs stamps at
//! the frame's own scale, centred on a pixel and with the pixel response included ([`native_grid`],
//! [`resample_samples`]). Point sources accept stamps of any scale and centre, but these stamps
//! must include the pixel response, too ([`grid_with_pixel_response`]).
//!
//! # Stopping
//! The progress object of a long call is polled every few milliseconds and may cancel the call
//! ([`psf_types::Progress::cancelled`]), which then returns [`ConvError::Cancelled`].
//!
//! # Threads
//! Work is spread over rayon's current pool. Results are the same, bit by bit, for any number of
//! threads.
//!
//! # On a GPU
//! With the feature `gpu` (off by default), `Engine::on_gpu` executes a plan in f32 on any GPU that
//! Vulkan, Metal, DirectX 12 or OpenGL drives: see the module `gpu`. Without the feature, no GPU
//! code is compiled.
//!
//! # Modules
//! `plan` does not depend on a device. `cpu` and `gpu` execute plans, and `engine` chooses between
//! them. `source_plan` draws sources with the modes of `plan`: `stars` and `galaxies` are its drawers, and
//! `sources` is what both share. `reference` holds the methods that
//! the others are compared with. The other modules are small tools, such as `transform` for FFTs of
//! tiles and `simd` for vector instructions.

#![allow(
    clippy::inline_always,
    reason = "what `vectorized!` does not inline is compiled for the baseline instruction set"
)]

mod both_precisions;
mod cpu;
mod dropped_light;
mod engine;
mod error;
mod fft2;
mod galaxies;
#[cfg(feature = "gpu")]
pub mod gpu;
mod image_memory;
mod kept;
mod overlap;
mod photons;
mod plan;
mod reference;
mod simd;
mod source_plan;
mod sources;
mod stamp_interpolator;
mod stars;
mod transform;
mod view;
mod working_range;
mod workspaces;

/// Parts that the benchmarks time separately. They do not belong to this crate's interface.
#[doc(hidden)]
pub mod internals {
    pub use crate::plan::coefficient_table::{CoefficientTable, FluxRole};
    pub use crate::plan::function_rows::FunctionRows;
    pub use crate::plan::local_modes::LocalModes;
    pub use crate::plan::psf_space::PsfSpace;
    pub use crate::plan::region_cells::RegionCells;
    pub use crate::simd::{Aligned, Inlined, Lanes, WithIsa};
    pub use crate::transform::TileTransform;
}

pub use {ndarray, psf_types};

pub use cpu::correlate::{Correlations, LightAndImage};
pub use dropped_light::DroppedLight;
pub use engine::{Engine, LowRank, Operation, RowStream, TileCounts};
pub use error::ConvError;
pub use galaxies::{ExtendedGradient, ExtendedSources, GalaxyErrors, Light, Variation, Variations};
pub use image_memory::zeros;
pub use photons::{ExpectedPhotons, PhotonReport, PhotonSources};
pub use plan::{BlockArrays, Paths, Plan, PlanArrays, PlanOptions, PlanSummary, SampleWeights};
pub use reference::{BasisConvolution, ConvolutionMethod, Direct, PatchConvolution};
pub use simd::{ConvReal, InstructionSet};
pub use source_plan::SourcePlan;
pub use sources::PointGradient;
pub use stamp_interpolator::{
    ScenePixelFilter, StampInterpolator, edge_reach, edge_reach_of, grid_with_pixel_response, native_grid,
    resample_samples,
};
pub use stars::StarPainter;
