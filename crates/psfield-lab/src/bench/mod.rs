//! Run time against measured error, for every method, in one run.
//!
//! A [`BenchCase`] is a model and a scene. [`run()`] plans each [`Contender`] and runs all of them
//! in turn (A B C, A B C, ...), so that a machine that slows down affects all of them. It compares
//! each image with the direct sum in double precision at random pixels, which are the same for all
//! contenders. [`BenchRow::ratio_to_single`] compares each run time with the run time of one
//! convolution with a single PSF ([`Contender::Single`]), which is always among the rows.
//! [`BenchOptions::device`] chooses a GPU for the fast engine ([`Contender::LowRank`] and
//! [`Contender::Auto`]).
//!
//! [`run_real_cases`] measures real work instead of methods: how the cost of [`Contender::Auto`]
//! grows with pixels, light, stars, galaxies, frames, PSF fields and spectra ([`RealGroup`]).
//!
//! [`measure_model`] measures the whole model: PSFs drawn and seconds against the error of PSFs that are
//! not samples.
//!
//! ```
//! use psfield_lab::bench::{BenchCase, BenchOptions, Contender, lit_scene, run, stretched};
//! # use ndarray::Array3;
//! # use psfield::psf_types::{FrameShape, NoProgress, Position, PsfSamples, SamplePositions, StampGrid};
//! # let positions = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| Position::of_pixel(x, y)).to_vec();
//! # let stamps = Array3::from_shape_fn((4, 9, 9), |(j, y, x)| {
//! #     (-((y as f64 - 4.0).powi(2) + (x as f64 - 4.0).powi(2)) / (2.0 + j as f64)).exp()
//! # });
//! # let samples = PsfSamples::new(stamps, SamplePositions::new(positions, None)?, StampGrid::new(9, 9)?)?;
//! let frame = FrameShape::new(48, 40)?;
//! let fitted = psfield::fit::fit(samples, &Default::default())?;
//! let case = BenchCase::new(stretched(fitted.record(), frame)?, lit_scene::<f32>(frame, 1)?);
//! let outcome = run(&case, &[Contender::LowRank { tolerance: 1e-4 }], &BenchOptions::default(), &NoProgress)?;
//! assert_eq!(outcome.rows.len(), 2); // the single PSF comes first
//! assert!(outcome.rows[1].relative_l2 < Some(1e-4));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod case;
mod contender;
mod real;
mod real_case;
mod real_colours;
mod real_scenes;
mod real_series;
mod real_wings;
mod run;
mod whole_model;

pub use case::{BenchCase, lit_scene, stretched};
pub(crate) use case::{interpolated_by, random_position};
pub use contender::Contender;
pub use real::{REAL_TOLERANCE, RealRow, run_real_cases};
pub use real_case::{RealCase, RealGroup, RealPsf};
pub use real_colours::of_black_bodies;
pub(crate) use real_colours::{bandpass, psf_of_wavelengths};
pub use run::{BenchOptions, BenchOutcome, BenchRow, Skipped, run};
pub use whole_model::{ModelRow, ModelSampling, measure_model, model_errors};
