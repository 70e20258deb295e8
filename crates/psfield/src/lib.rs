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

mod colour_scene;
mod colours;
pub mod convert;
mod device;
mod dispersion;
mod error;
mod evaluate;
mod exposure_files;
mod fit;
mod image_cards;
mod light_on_pixels;
mod measure;
mod psf;
mod readable;
mod scene;
mod series;
mod simulate_options;
mod simulator;
mod spot_check;
mod stack_size;
mod stamp_plane;

pub use {
    coeff_field, conv_core, detector, metrics, psf_basis, psf_io, psf_optics, psf_sample, psf_stars,
    psf_types, sersic, spectra,
};

pub use colour_scene::ColourScene;
pub use colours::{bandpass_file, open_bandpass, open_spectrum, spectrum_file, spectrum_in};
pub use device::{
    CpuReason, GpuSeconds, MIN_SECONDS_FOR_GPU, Placement, PredictedSeconds, forget_gpus, open_gpu,
};
pub use dispersion::Dispersion;
pub use error::{ErrorKind, PsfieldError, error_text, in_plain_words};
pub use evaluate::{
    EvaluateOptions, OutputGrid, check_frame_on_field, check_on_field, evaluate, evaluate_stamps,
};
pub use exposure_files::{ExposureFiles, exposure_cards, read_bad_pixel_mask};
pub use fit::{
    Fit, FitOptions, FitReport, InterpolationErrors, LeaveOneOutReport, OwnInterpolation,
    compare_interpolations, fit, fit_by, fit_in_basis, fit_trained, fit_weighted, fit_with, model_of,
};
pub use image_cards::{
    JOB_KEYWORD, PSF_FILE_KEYWORD, exposure_time_cards, parse_utc, provenance_cards, utc_now,
};
pub use light_on_pixels::light_on_pixels;
pub use measure::{MEASUREMENT_COLUMNS, MeasureOptions, Measurement};
pub use psf::{Extrapolation, FitChoices, Motion, Note, Psf, PsfFileOptions, join_samples, record_of_psfex};
pub use readable::readable;
pub use scene::Scene;
pub use series::{
    Exposures, LightCurves, Pointing, PointingPath, Series, SeriesExposure, SeriesSimulator, SourceInExposure,
};
pub use simulate_options::{Device, Method, ScenePixels, SimulateOptions};
pub use simulator::{
    ColourSimulator, OwnMethodBuilder, Preparation, SamplingErrors, SimulationWarning, Simulator,
    SimulatorBuilder,
};
pub use spot_check::{PickedPixel, PixelPicker, SpotCheck};
pub use stack_size::{MAX_STACK_BYTES, check_stack};

/// The names that most programs need.
pub mod prelude {
    pub use crate::{Psf, PsfieldError, Scene, SimulateOptions, Simulator};
}

/// Runs the Rust of the guide as a test of the documentation.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/guide.md")]
struct Guide;
