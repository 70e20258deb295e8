//! Galaxies with Sersic profiles: their surface brightness and its Fourier transform.
//!
//! [`SersicLight`] is the light of a [`SersicSource`](psf_types::SersicSource), as a function on the
//! sky. It implements [`LightProfile`](psf_types::LightProfile), which the drawing of galaxies
//! needs.
//!
//! ```
//! use psf_types::{LightProfile, Position, SersicProfile, SersicSource};
//! // re in pixels, n, q, angle in degrees from +x towards +y
//! let profile = SersicProfile::new(3.0, 1.0, 0.5, 0.0)?;
//! let galaxy = SersicSource::new(Position::new(63.2, 64.0)?, 1000.0, profile)?;
//! let light = sersic::SersicLight::new(&galaxy);
//!
//! // Half of the light lies within the ellipse of semi-major axis re.
//! assert!((light.flux_beyond(3.0) - 0.5).abs() < 1e-12);
//! // The transform at wavenumber 0 is the flux. The profile has unit flux.
//! let mut transform = [0.0];
//! light.transform_into(0.0, 0.0, 0.0, &mut transform);
//! assert_eq!(transform, [1.0]);
//! # Ok::<(), psf_types::DataError>(())
//! ```
//!
//! # Accuracy
//! The error of the transform is at most 3e-7 of the flux at every wavenumber, for all indices from
//! 0.3 to 8. In double precision, it is at most 1.5e-7. The brightness has a relative error of up to 4e-5, from rounding in single precision.

#![allow(
    clippy::inline_always,
    reason = "code that pulp dispatches must be inlined, otherwise it is compiled for the baseline instruction set"
)]

mod elementary;
mod half_light;
mod profile;
mod radii;
mod transform;

pub use profile::SersicLight;
