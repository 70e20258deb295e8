//! Images with a point spread function (PSF) that varies over the field: the stages joined.
//!
//! ```text
//! PSF source --psf_sample--> samples --psf_basis--> basis + coefficients --coeff_field--> model
//!                                                                                          |
//!                                 scene --conv_core--> image --metrics--> measurements <---+
//! ```
//!
//! Each stage is a crate of its own, re-exported here; this crate joins them ([`fit()`], [`Simulation`], [`evaluate()`],
//! [`MeasureOptions`]) and holds the command line `psfield`.
//!
//! ```
//! use ndarray::{Array2, Array3};
//! use psfield::psf_types::{Image, Position, PsfSamples, SamplePositions, Scene, StampGrid};
//! use psfield::{FitOptions, PsfInput, Simulation};
//!
//! // Four samples of a PSF that widens to the right.
//! let gauss = |sigma: f64| move |y: usize, x: usize| {
//!     (-((y as f64 - 8.0).powi(2) + (x as f64 - 8.0).powi(2)) / (2.0 * sigma * sigma)).exp()
//! };
//! let positions = [(0, 0), (31, 0), (0, 31), (31, 31)].map(|(x, y)| Position::of_pixel(x, y)).to_vec();
//! let stamps = Array3::from_shape_fn((4, 17, 17), |(j, y, x)| gauss(if j % 2 == 0 { 1.2 } else { 1.8 })(y, x));
//! let samples = PsfSamples::new(stamps, SamplePositions::new(positions, None)?, StampGrid::new(17, 17)?)?;
//!
//! let mut light = Array2::<f64>::zeros((32, 32));
//! light[[16, 16]] = 100.0;
//! let scene = Scene::from_image(Image::new(light)?);
//! let psf = PsfInput::Samples(samples, FitOptions::default());
//! let image = Simulation::new(psf, &scene, Default::default())?.run(&scene, Default::default(), Default::default())?;
//! assert!((image.pixels().sum() - 100.0).abs() < 1e-10); // the flux is kept
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Features
//! `gpu` (default): plans can be executed on any GPU that Vulkan, Metal, DirectX 12 or OpenGL drives ([`Gpus`]). Without it everything runs on the
//! processor, and no GPU library is compiled.

pub mod bench;
pub mod convert;
mod device;
mod error;
mod error_text;
mod evaluate;
mod exposure_files;
mod finer_scene;
mod fit;
mod fit_options;
mod image_cards;
mod measure;
mod method;
mod pixel_picker;
pub mod plot;
pub mod preview;
mod psf_input;
mod readable;
pub mod report;
mod round_trip;
mod same_file;
mod scene_layout;
mod scene_sources;
mod simulation;
mod simulation_options;
mod simulation_plan;
mod simulation_warning;
mod spot_check;
mod star_frame;
mod system_memory;

pub use {
    coeff_field, conv_core, detector, metrics, psf_basis, psf_io, psf_optics, psf_sample, psf_stars,
    psf_types, sersic,
};

pub use device::{CpuReason, Device, DeviceOptions, GpuSeconds, Gpus, Placement, PredictedSeconds};
pub use error::PsfieldError;
pub use error_text::error_text;
pub use evaluate::{EvaluateOptions, OutputGrid, evaluate, evaluate_stamps};
pub use exposure_files::{ExposureFiles, exposure_cards, read_bad_pixel_mask};
pub use fit::{Fit, FitReport, LeaveOneOutReport, fit, fit_trained, fit_with, model_of};
pub use fit_options::FitOptions;
pub use image_cards::{JOB_KEYWORD, provenance_cards, simulation_cards};
pub use measure::{MEASUREMENT_COLUMNS, MeasureOptions, Measurement};
pub use method::Method;
pub use pixel_picker::{PickedPixel, PixelPicker};
pub use psf_input::{FitChoices, OpenedPsf, PsfFileOptions, PsfInput, check_stack, record_of_psfex};
pub use round_trip::{
    Agreement, Distribution, ROUND_TRIP_COLUMNS, RoundTrip, RoundTripOptions, RoundTripReport, RoundTripRow,
};
pub use same_file::{check_outputs, resolved};
pub use scene_layout::SceneLayout;
pub use scene_sources::SceneSources;
pub use simulation::{SceneParts, Simulation};
pub use simulation_options::SimulationOptions;
pub use simulation_plan::SimulationPlan;
pub use simulation_warning::SimulationWarning;
pub use spot_check::SpotCheck;
pub use system_memory::{available_memory_bytes, peak_memory_bytes};
