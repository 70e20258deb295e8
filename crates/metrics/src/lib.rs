//! Measurements of PSFs and images: Gaussian fits, adaptive moments, quadrupole moments, error
//! norms.
//!
//! | measurement | type |
//! |---|---|
//! | width and elongation of a PSF | [`GaussianFitter`]: least squares, with FWHM, axes, angle, background |
//! | size and shear as weak-lensing codes measure them | [`AdaptiveMomentFinder`]: HSM's adaptive moments |
//! | plain second moments | [`QuadrupoleMoments`] |
//! | difference between two images | [`Comparison`]: MAE, MSE, relative L2, largest error, SNR |
//! | statistics of many measurements | [`Summary`]: median, quantiles, maximum, mean, rms |
//!
//! No result is NaN, infinite or a sentinel value. A measurement that fails returns a
//! [`MetricsError`] with the reason.
//!
//! # Conventions
//! * Stamps are `[y, x]`, `f32` or `f64`. All arithmetic is f64.
//! * Centroids are 0-based stamp indices `(x, y)`, and an integer is the centre of a pixel. They
//!   refer to the whole stamp, even when a [`Window`] restricts the measurement to a part of it.
//! * Lengths are in pixels of the stamp. Divide them by the oversampling to get frame pixels.
//! * `FWHM = 2 sqrt(2 ln 2) sigma` ([`FWHM_PER_SIGMA`]).
//! * Angles run from +x towards +y.
//!
//! # Four measures of elongation
//! For an ellipse with axes `a >= b` and position angle `phi`:
//!
//! ```text
//! eccentricity   e   = sqrt(1 - b^2 / a^2)          Covariance::eccentricity, GaussianFit::eccentricity
//! ellipticity    |e| = (a^2 - b^2) / (a^2 + b^2)    AdaptiveMoments::ellipticity, Distortion::length
//! (components: the distortion)                      Distortion (e1, e2) = |e| (cos 2 phi, sin 2 phi)
//! reduced shear  |g| = (a - b) / (a + b)            ReducedShear (g1, g2) = |g| (cos 2 phi, sin 2 phi)
//! axis ratio     q   = b / a                        from the two widths
//! ```
//!
//! ```text
//! g = e / (1 + sqrt(1 - |e|^2))      e = 2 g / (1 + |g|^2)      (distortion <-> reduced shear)
//! ```
//!
//! # Gaussian fit or adaptive moments?
//! Both describe a PSF by one ellipse, and they agree for a Gaussian. For a real PSF with wings
//! they differ. The fit matches the core, because bright pixels dominate the sum of squares.
//! Adaptive moments are second moments under a Gaussian weight that has the PSF's own size and
//! shape.

mod adaptive_weight;
mod comparison;
mod ellipse;
mod error;
mod gaussian_fit;
mod gaussian_model;
mod gaussian_rows;
mod levenberg_marquardt;
mod moments;
mod window;

pub use {ndarray, psf_types};

pub use comparison::{Comparison, Summary};
pub use ellipse::{Covariance, Distortion, ReducedShear};
pub use error::MetricsError;
pub use gaussian_fit::{GaussianFit, GaussianFitter};
pub use moments::{AdaptiveMomentFinder, AdaptiveMoments, QuadrupoleMoments};
pub use psf_types::maths::FWHM_PER_SIGMA;
pub use window::Window;
