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
//! The error of a pixel is below `1e-6` of the galaxy's total flux. It is also below `1e-5` of the
//! pixel's value plus `1e-10` of the total flux. The error of the sum over an image is below `1e-5`
//! of the sum (`tests/accuracy.rs`). In addition, drawing stops at a radius outside which the
//! fraction [`FLUX_LEFT_OUT`] of the total flux lies.
//!
//! # Method
//! A square of the image is treated as a whole if it is small compared with the length over which
//! the profile changes there. Otherwise it is divided into four squares. For a pixel or a part of a
//! pixel, a Gauss-Legendre product rule integrates the profile. For a block of pixels far from the
//! centre, a polynomial interpolates the flux per pixel, which is computed at 6 x 6 points. The
//! polynomials of all galaxies are added before they are evaluated, so that far wings cost very
//! little.

mod drawing;
mod profile;

pub use drawing::{add_galaxies, add_galaxies_with_progress};
pub use profile::FLUX_LEFT_OUT;
