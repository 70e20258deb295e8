//! PSF samples from the stars of a real frame.
//!
//! [`StarSampling`] takes an image and returns [`StarSamples`]. They contain PSF stamps of unit
//! flux at the positions of stars ([`psf_types::PsfSamples`]), a table of all [`Source`]s with the
//! reasons why some were rejected, and a [`CoverageMap`] of the field. The steps and their
//! settings:
//!
//! | step | settings | purpose |
//! |---|---|---|
//! | background | [`BackgroundMesh`] | mode and noise of clipped cells, as in SExtractor |
//! | detection | [`Detection`] | separate peaks of the matched-filtered significance |
//! | measurement | [`Camera`] | centre and shape by Gaussian fit, signal-to-noise ratio, saturation |
//! | selection | [`Selection`] | cuts. Shapes are compared with the *local* PSF |
//! | registration | [`Registration`] | an oversampled PSF over the field for undersampled stars, else the stars' own pixels |
//! | coverage | [`CoverageMap`] | samples per cell, gaps, corners, convex hull |
//!
//! Arrays are `[y, x]`. Positions are 0-based pixels of the frame, and an integer is the centre of
//! a pixel. The samples include the pixel response.

mod background;
mod band_matrix;
mod camera;
mod coverage;
mod detection;
mod epsf;
mod epsf_prior;
mod epsf_solver;
mod error;
mod frame;
mod registration;
mod selection;
mod source;
mod star_sampling;
mod surface;

pub use {ndarray, psf_types};

pub use background::{Background, BackgroundMesh};
pub use camera::{Camera, Saturation, SaturationOrigin};
pub use coverage::{CoverageMap, CoverageReport};
pub use detection::{Detection, Peak};
pub use error::StarError;
pub use registration::{Registration, RegistrationMethod, RegistrationReport};
pub use selection::Selection;
pub use source::{Rejection, Rejections, SOURCE_COLUMNS, Source};
pub use star_sampling::{Fold, StarSamples, StarSampling};
