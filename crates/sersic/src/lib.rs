//! Galaxies with Sersic profiles, drawn as the flux that falls in each pixel.
//!
//! [`add_galaxies`] adds [`SersicSource`](psf_types::SersicSource)s to an image, before convolution
//! with the PSF. The profile is integrated over the area of every pixel, from the cusp of `n = 8`
//! to the faintest wings.
//!
//! ```
//! use ndarray::Array2;
//! use psf_types::{Position, SersicProfile, SersicSource};
//! // re in pixels, n, q, angle in degrees from +x towards +y
//! let profile = SersicProfile::new(3.0, 1.0, 0.5, 30.0)?;
//! let galaxy = SersicSource::new(Position::new(63.2, 64.0)?, 1000.0, profile)?;
//! let mut image = Array2::<f64>::zeros((128, 128)); // [y, x]
//! sersic::add_galaxies(image.view_mut(), (0, 0), &[galaxy]);
//! assert!((image.sum() - 1000.0).abs() < 0.01);
//! # Ok::<(), psf_types::DataError>(())
//! ```
//!
//! # Accuracy
//! Every pixel is within `1e-6` of the galaxy's total flux, and within `1e-5` of its own value plus
//! `1e-10` of the flux. The total light of an image is within `1e-5` (`tests/accuracy.rs`). Drawing
//! stops only at the radius outside which the fraction [`FLUX_LEFT_OUT`] of the total flux lies.
//!
//! # Method
//! A square is integrated by one rule if it is small compared with its distance from the galaxy's
//! centre, measured in units in which the profile is smooth. Within a pixel the rule is a
//! Gauss-Legendre product. For blocks of pixels far out it is a polynomial through 6 x 6 of their
//! values. All other squares are divided into four. The polynomials of all galaxies are added
//! before they are evaluated, so that far wings cost very little.

mod drawing;
mod profile;

pub use drawing::{add_galaxies, add_galaxies_with_progress};
pub use profile::FLUX_LEFT_OUT;
