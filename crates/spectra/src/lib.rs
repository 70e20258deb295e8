//! Bandpasses, spectra of sources, and the dispersion of the atmosphere.
//!
//! A PSF that depends on the wavelength appears in an image as its mean over the detected photons:
//! `h = int h(lambda) w(lambda) d lambda`, with `w` proportional to `f_lambda lambda T`. Here `f_lambda`
//! is the flux density per wavelength ([`Spectrum`]) and `T` the throughput ([`Bandpass`]).
//! [`photons`] returns this integral as a list of wavelengths and weights.
//!
//! ```
//! use spectra::{Bandpass, Curve, Spectrum, photons};
//! let bandpass = Bandpass::new(Curve::new(vec![0.5, 0.55, 0.65, 0.7], vec![0.0, 0.8, 0.8, 0.0])?);
//! let red: Spectrum = "blackbody:3000".parse()?;
//! let total: f64 = photons(&bandpass, &red, &[])?.iter().map(|p| p.weight).sum();
//! assert!((total - 1.0).abs() < 1e-12);
//! # Ok::<(), spectra::SpectraError>(())
//! ```
//!
//! # Conventions
//! Wavelengths are in micrometres, in vacuum or in air as the caller's samples are. The scale of a
//! spectrum and of a bandpass does not matter: only shapes do.

mod atmosphere;
mod curve;
mod error;
mod photons;
mod spectrum;

pub use atmosphere::Atmosphere;
pub use curve::{Bandpass, Curve};
pub use error::SpectraError;
pub use photons::{PhotonFraction, photons};
pub use spectrum::{FluxDensity, Spectrum};
