//! Simulates images whose point spread function (PSF) varies over the field. This crate joins the
//! stages of the simulation:
//!
//! ```text
//! PSF source --psf_sample--> samples --psf_basis--> basis + coefficients --coeff_field--> model
//! scene + model --conv_core--> image --metrics--> measurements
//! ```
//!
//! Each stage is a crate of its own, re-exported here. Four types join them:
//!
//! | type | meaning |
//! |---|---|
//! | [`Psf`] | a PSF over a field, from samples, a model or a file. Samples are fitted on demand |
//! | [`Scene`] | the light before the PSF: an image (also finer than the frame), stars, galaxies |
//! | [`SimulateOptions`] | every setting, with its default |
//! | [`Simulator`] | makes images of scenes of one shape, with one PSF and one choice of settings |
//!
//! ```no_run
//! use psfield::prelude::*;
//! # let (ny, nx) = (80, 100);
//! # let pixels = ndarray::Array2::<f32>::zeros((ny, nx));
//! let light = Scene::new(pixels)?;                          // [y, x], flux per pixel
//! let psf = Psf::open("model.fits")?;                       // or Psf::from_samples(stamps, &positions)?
//! let image = psf.simulator((ny, nx)).tolerance(1e-3).build()?.simulate(&light)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The PSF may also be made from samples in memory:
//!
//! ```
//! use ndarray::{Array2, Array3};
//! use psfield::prelude::*;
//!
//! // Four samples of a PSF that widens to the right.
//! let corners = [(0.0, 0.0), (31.0, 0.0), (0.0, 31.0), (31.0, 31.0)];
//! let stamps = Array3::from_shape_fn((4, 17, 17), |(j, y, x)| {
//!     let sigma = if j % 2 == 0 { 1.2 } else { 1.8 };
//!     (-((y as f64 - 8.0).powi(2) + (x as f64 - 8.0).powi(2)) / (2.0 * sigma * sigma)).exp()
//! });
//! let psf = Psf::from_samples(stamps.view(), &corners)?;
//!
//! let mut pixels = Array2::<f64>::zeros((32, 32));
//! pixels[[16, 16]] = 100.0;
//! let image = psf.simulator((32, 32)).build()?.simulate(&Scene::new(pixels)?)?;
//! assert!((image.pixels().sum() - 100.0).abs() < 1e-10); // the flux is kept
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Features
//! `gpu` (off by default): plans can run on any GPU that Vulkan, Metal, DirectX 12 or OpenGL drives
//! ([`Device`]). Without this feature, everything runs on the processor, and no GPU library is
//! compiled.

pub mod colours;
pub mod convert;
pub mod device;
mod dispersion;
pub mod error;
pub mod evaluate;
pub mod exposure_files;
pub mod fit;
pub mod image_cards;
pub mod inject;
mod light_on_pixels;
pub mod measure;
pub mod psf;
mod readable;
mod scene;
mod scene_light;
pub mod series;
mod simulate_options;
mod simulator;
mod spot_check;
pub mod stack_size;
mod stamp_plane;
pub mod survey;
mod truth_table;

pub use {
    coeff_field, conv_core, detector, metrics, psf_basis, psf_io, psf_optics, psf_sample, psf_stars,
    psf_types, sersic, spectra,
};

pub use dispersion::Dispersion;
pub use error::{ErrorKind, PsfieldError};
pub use fit::FitOptions;
pub use light_on_pixels::light_on_pixels;
pub use psf::{Extrapolation, FitChoices, Motion, Psf, PsfFileOptions, PsfParameters, WingsSource};
pub use readable::readable;
pub use scene::{Layer, ProfileSource, Scene};
pub use scene_light::SceneLight;
pub use simulate_options::{Device, Method, ScenePixels, SimulateOptions};
pub use simulator::{
    ExposeOptions, GalaxyGradient, Gradients, Preparation, SamplingErrors, ShootBelow, SimulationWarning,
    Simulator, SimulatorBuilder, SourceGradients, WantedGradients,
};
pub use spot_check::SpotCheck;
pub use truth_table::TruthTable;

/// The names that most programs need.
pub mod prelude {
    pub use crate::{Psf, PsfieldError, Scene, SimulateOptions, Simulator};
}

/// Runs the Rust of the guide as a test of the documentation.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/guide.md")]
struct Guide;
