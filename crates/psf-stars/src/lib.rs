//! PSF samples from the stars of a real frame.
//!
//! [`StarSampling`] takes an image and gives [`StarSamples`]: PSF stamps of unit flux at the positions of stars
//! ([`psf_types::PsfSamples`]), a table of all [`Source`]s with the reasons for which others were rejected, and a [`CoverageMap`] of the
//! field. Its steps and their settings:
//!
//! | step | settings | what it does |
//! |---|---|---|
//! | background | [`BackgroundMesh`] | mode and noise of clipped cells, as SExtractor |
//! | detection | [`Detection`] | separate peaks of the matched-filtered significance |
//! | measurement | [`Camera`] | centre and shape by Gaussian fit, signal-to-noise ratio, saturation |
//! | selection | [`Selection`] | cuts; shapes against the *local* PSF |
//! | registration | [`Registration`] | an oversampled PSF over the field for undersampled stars, else the stars' own pixels |
//! | coverage | [`CoverageMap`] | samples by cells, gaps, corners, convex hull |
//!
//! Arrays are `[y, x]`, positions 0-based pixels of the frame, an integer being the centre of a pixel. The pixel response is in
//! the samples.

mod background;
mod camera;
mod coverage;
mod detection;
mod epsf;
mod epsf_solver;
mod error;
mod frame;
mod registration;
mod selection;
mod source;
mod star_sampling;

pub use background::{Background, BackgroundMesh};
pub use camera::{Camera, Saturation, SaturationOrigin};
pub use coverage::{CoverageMap, CoverageReport};
pub use detection::{Detection, Peak};
pub use error::StarError;
pub use registration::{Registration, RegistrationMethod, RegistrationReport};
pub use selection::Selection;
pub use source::{Rejection, Rejections, SOURCE_COLUMNS, Source};
pub use star_sampling::{StarSamples, StarSampling};
