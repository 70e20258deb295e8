//! Photon and detector noise on a finished image: what a sensor makes of the light that a telescope sends.
//!
//! [`Detector`] is the whole chain, described by [`DetectorParams`] in code or in a TOML file; [`PhotonNoise`] is its photon step
//! alone. Every step is off unless it is asked for.
//!
//! # The chain
//!
//! In pixel (x, y), with the image's flux `F`, in this order:
//!
//! | step | what happens | keys |
//! |---|---|---|
//! | light | `S = c F + sky(x, y)`, electrons expected | `electrons_per_flux`, `sky_e`, `sky_gradient_e_per_px` |
//! | response | `S r(x, y)`, `r` normal about 1, never below 0 | `response_rms` |
//! | dark current | `S + (D + D_hot(x, y)) t` | `dark_e_per_s`, `exposure_s`, `bad_pixels.hot_dark_e_per_s` |
//! | bad pixels | dead pixels and bad columns hold no charge | `bad_pixels` |
//! | photon noise | `N ~ Poisson(S)` | `photon_noise` |
//! | full well | `min(N, W)` | `full_well_e` |
//! | read noise | `N + R`, `R ~ Normal(0, sigma^2)` | `read_noise_e` |
//! | amplifier | `N / g + b` in ADU | `gain_e_per_adu`, `bias_adu` |
//! | converter | to the nearest whole number in `0 ..= 2^bits - 1` | `bits` |
//!
//! It is the model of Janesick, *Scientific Charge-Coupled Devices* (2001), ch. 2, without blooming, nonlinearity and charge transfer.
//!
//! # Units
//! Charge is in electrons, of which each detected photon gives one. **Flux of the image times `electrons_per_flux` is
//! electrons in the exposure.** Its default of 1 means an image in electrons; an image in photons a second needs quantum efficiency
//! times exposure time. `exposure_s` scales the dark current alone. The result is in ADU when gain, bias or bits are given, else in
//! electrons ([`CountUnit`]).
//!
//! # Random numbers
//! ChaCha8 keyed by the seed (`seed_from_u64`). Each row of the image has a stream of its own in each step, numbered `step * 2^56 + row`
//! with the steps photons 1, read noise 2, response 3, bad pixels 4, bad columns 5; a row's pixels draw one after the other. So a result
//! depends on the image and the seed alone, not on threads or bands of rows, and switching read noise on changes no photon. What
//! belongs to the sensor, response and bad pixels, has a seed of its own, `pattern_seed`: exposures with different seeds share it.
//! Across types of machines the last bit of `exp` or `ln` may differ, and with it, very rarely, a draw.
//!
//! # Bad values
//! A pixel that expects less than no charge (rounding of a convolution, PSFs with negative lobes) holds none; such pixels are counted
//! in the [`ExposureReport`]. NaN and infinities are refused.
//!
//! ```
//! use psf_detector::{Detector, DetectorParams};
//! use psf_types::{FrameShape, Image};
//! let ccd = Detector::new(DetectorParams {
//!     photon_noise: true,
//!     sky_e: 100.0,
//!     read_noise_e: 5.0,
//!     gain_e_per_adu: Some(2.0),
//!     bits: Some(16),
//!     ..DetectorParams::default()
//! })?;
//! let dark_sky = Image::<f32>::zeros(FrameShape::new(200, 100)?);
//! let raw = ccd.expose(&dark_sky, 42)?;
//! let mean = raw.counts().pixels().mean().unwrap();
//! assert!((mean - 50.0).abs() < 0.5); // 100 electrons at 2 electrons per ADU
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bad_pixels;
mod detector;
mod error;
mod exposure;
mod levels;
mod noise;

pub use bad_pixels::{BadPixelMask, PixelFlags};
pub use detector::{BadPixelParams, CountUnit, Detector, DetectorParams, SkyGradient};
pub use error::DetectorError;
pub use exposure::{ExposedRows, Exposer, Exposure, ExposureReport, PhotonNoise};
