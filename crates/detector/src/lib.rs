//! Photon and detector noise on a finished image: converts the flux from a telescope to counts.
//!
//! [`Detector`] is the whole chain, described by [`DetectorParams`] in code or in a TOML file.
//! [`PhotonNoise`] is only the step of photon noise. Every step is off unless it is requested.
//!
//! # The chain
//!
//! In pixel (x, y) of an image with flux `F`, the steps are, in this order:
//!
//! | step | operation | keys |
//! |---|---|---|
//! | light | `S = c F + sky(x, y)`, electrons expected | `electrons_per_flux`, `sky_e`, `sky_gradient_e_per_px` |
//! | response | `S r(x, y)`, `r` normal with mean 1, negative `r` become 0 | `response_rms` |
//! | dark current | `S + (D + D_hot(x, y)) t` | `dark_e_per_s`, `exposure_s`, `bad_pixels.hot_dark_e_per_s` |
//! | bad pixels | dead pixels and bad columns hold no charge | `bad_pixels` |
//! | photon noise | `N ~ Poisson(S)`, for negative `S` `-N ~ Poisson(-S)` | `photon_noise` |
//! | shot photons | each is detected with the probability `r / r_max` ([`Exposer::with_photons`]) | |
//! | full well | `min(N, W)` | `full_well_e` |
//! | read noise | `N + R`, `R ~ Normal(0, sigma^2)` | `read_noise_e` |
//! | amplifier | `N / g + b` in ADU | `gain_e_per_adu`, `bias_adu` |
//! | converter | to the nearest whole number in `0 ..= 2^bits - 1` | `bits` |
//!
//! This is the model of Janesick, *Scientific Charge-Coupled Devices* (2001), ch. 2, without
//! blooming, nonlinearity and charge transfer.
//!
//! # Units
//! Charge is in electrons. Each detected photon gives one electron. **The flux of the image times
//! `electrons_per_flux` is the number of electrons in the exposure.** The default of 1 is right for
//! an image in electrons. For an image in photons per second, set `electrons_per_flux` to the
//! quantum efficiency times the exposure time. `exposure_s` scales only the dark current. The
//! result is in ADU if gain, bias or bits are given, else in electrons ([`CountUnit`]).
//!
//! # Random numbers
//! The generator is ChaCha8, keyed by the seed (`seed_from_u64`). Each row of the image has its own
//! stream in each step, numbered `step * 2^56 + row`. The steps are photons 1, read noise 2,
//! response 3, bad pixels 4, bad columns 5, thinning of photons 6. The bad columns are drawn once, from the stream of row
//! 0. Numbers are drawn for the pixels of a row one after the other. The result therefore depends
//! only on the image, the parameters and the seeds, not on threads or bands of rows. Switching the
//! read noise on does not change the photon noise.
//!
//! The properties of the sensor (response and bad pixels) have their own seed, `pattern_seed`, so
//! exposures with different seeds share one sensor. The last bit of `exp` or `ln` may differ
//! between types of machines. Very rarely, this changes a drawn number.
//!
//! # Bad values
//! A pixel may have a negative expected charge, from rounding errors of a convolution or from a PSF
//! with negative lobes. It stays negative, as minus a Poisson number of its size if there is photon
//! noise: without it, the exposure would hold more light than the image. The converter sets negative
//! counts to 0. The [`ExposureReport`] counts both. NaN and infinities are refused.
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
//! let light = Image::<f32>::zeros(FrameShape::new(200, 100)?);
//! let raw = ccd.expose(&light, 42)?;
//! let mean = raw.counts().pixels().mean().unwrap();
//! assert!((mean - 50.0).abs() < 0.5); // 100 electrons of sky at 2 electrons per ADU
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bad_pixels;
mod detector;
mod error;
mod exposure;
mod levels;
mod noise;

pub use {ndarray, psf_types};

pub use bad_pixels::{BadPixelMask, PixelFlags};
pub use detector::{BadPixelParams, CountUnit, Detector, DetectorParams, SkyGradient};
pub use error::DetectorError;
pub use exposure::{ExposedRows, Exposer, Exposure, ExposureReport, PhotonNoise};
