//! A detector: its description in a TOML file or in code, and the check of the description.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::DetectorError;
use crate::error::{above_zero, at_least_zero, require};
use crate::noise::largest_response;

/// The full description of a detector and an exposure, with the keys of the TOML file. Nothing is
/// checked here: [`Detector::new`] checks descriptions from files and from code.
///
/// Every key is optional, and unknown keys are errors. The default is a perfect detector, which
/// counts electrons without noise. The [crate's table](crate#the-chain) lists the steps.
///
/// | key | unit, range | default |
/// |---|---|---|
/// | `name` | any text | empty |
/// | `electrons_per_flux` | electrons in the exposure per unit of the image's flux, above 0 | 1 |
/// | `exposure_s` | s, 0 and above | none |
/// | `photon_noise` | `true` or `false` | `false` |
/// | `sky_e` | electrons per pixel in the exposure, 0 and above | 0 |
/// | `sky_gradient_e_per_px` | [`SkyGradient`] | none |
/// | `dark_e_per_s` | electrons per pixel and second, 0 and above. A value above 0 needs `exposure_s` | 0 |
/// | `response_rms` | standard deviation relative to the mean, 0 to below 1 | 0 |
/// | `full_well_e` | electrons, above 0 | none |
/// | `read_noise_e` | electrons, standard deviation, 0 and above | 0 |
/// | `gain_e_per_adu` | electrons per ADU, above 0 | 1 |
/// | `bias_adu` | ADU | 0 |
/// | `bits` | 1 to 24 | none: no digitisation |
/// | `pattern_seed` | seed of the response and the bad pixels | 0 |
/// | `bad_pixels` | [`BadPixelParams`] | none |
///
/// ```toml
/// name = "survey CCD"
/// exposure_s = 150.0
/// photon_noise = true
/// sky_e = 45.0
/// dark_e_per_s = 0.02
/// response_rms = 0.005
/// full_well_e = 90000.0
/// read_noise_e = 5.0
/// gain_e_per_adu = 1.5
/// bias_adu = 500.0
/// bits = 16
///
/// [bad_pixels]
/// dead_fraction = 1e-4
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DetectorParams {
    /// A name for human readers.
    pub name: String,
    /// Electrons that one unit of the image's flux gives in the exposure.
    pub electrons_per_flux: f64,
    /// Exposure time in s. It scales the dark current, but not the light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure_s: Option<f64>,
    /// If true, the charge is Poisson distributed about its expected value.
    pub photon_noise: bool,
    /// Sky in electrons per pixel in the exposure. With a gradient, it is the value at the middle
    /// of the frame.
    pub sky_e: f64,
    /// The gradient of the sky over the frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sky_gradient_e_per_px: Option<SkyGradient>,
    /// Dark current in electrons per pixel and second.
    pub dark_e_per_s: f64,
    /// Standard deviation of the pixels' response to light, whose mean is 1 (pixel-response
    /// non-uniformity).
    pub response_rms: f64,
    /// The largest charge of a pixel in electrons.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub full_well_e: Option<f64>,
    /// Standard deviation of the read noise in electrons.
    pub read_noise_e: f64,
    /// Electrons per ADU.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_e_per_adu: Option<f64>,
    /// The count in ADU for a charge of 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bias_adu: Option<f64>,
    /// Bits of the converter: counts are whole numbers from 0 to `2^bits - 1`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bits: Option<u32>,
    /// Seed of the sensor's properties: its response and its bad pixels.
    pub pattern_seed: u64,
    /// Fractions of bad pixels, and the dark current of hot pixels.
    pub bad_pixels: BadPixelParams,
}

/// The slope of the sky, in electrons per pixel for each pixel of distance from the middle of the
/// frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SkyGradient {
    /// Along a row.
    pub x: f64,
    /// Along a column.
    pub y: f64,
}

/// Fractions of bad pixels, and the dark current of hot pixels. `pattern_seed` and the fractions
/// determine which pixels are bad.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BadPixelParams {
    /// Probability that a pixel never holds charge, 0 to 1.
    pub dead_fraction: f64,
    /// Probability that a pixel is hot, 0 to 1: its dark current is higher by `hot_dark_e_per_s`.
    /// The sum with `dead_fraction` is at most 1. A value above 0 needs `hot_dark_e_per_s`.
    pub hot_fraction: f64,
    /// Dark current of a hot pixel in electrons per second, in addition to `dark_e_per_s`. A value
    /// above 0 needs `exposure_s`.
    pub hot_dark_e_per_s: f64,
    /// Probability that a column holds no charge, 0 to 1.
    pub bad_column_fraction: f64,
}

impl Default for DetectorParams {
    fn default() -> Self {
        Self {
            name: String::new(),
            electrons_per_flux: 1.0,
            exposure_s: None,
            photon_noise: false,
            sky_e: 0.0,
            sky_gradient_e_per_px: None,
            dark_e_per_s: 0.0,
            response_rms: 0.0,
            full_well_e: None,
            read_noise_e: 0.0,
            gain_e_per_adu: None,
            bias_adu: None,
            bits: None,
            pattern_seed: 0,
            bad_pixels: BadPixelParams::default(),
        }
    }
}

impl DetectorParams {
    /// Reads the keys of a TOML file, without a check of their values.
    ///
    /// # Errors
    /// [`DetectorError::Read`], and [`DetectorError::InFile`] for text that is not TOML with these keys.
    pub fn from_toml_file(path: impl AsRef<Path>) -> Result<Self, DetectorError> {
        let path = path.as_ref();
        let text = psf_types::read_text_file(path).map_err(|source| DetectorError::Read {
            path: path.to_owned(),
            source,
        })?;
        let parsed = toml::from_str(&text).map_err(|error| DetectorError::Toml(Box::new(error)));
        parsed.map_err(in_file(path))
    }
}

/// Adds the name of a file to an error.
fn in_file(path: &Path) -> impl Fn(DetectorError) -> DetectorError + '_ {
    |source| DetectorError::InFile {
        path: path.to_owned(),
        source: Box::new(source),
    }
}

/// The unit of counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CountUnit {
    /// Electrons, if no gain, bias or bits are given.
    Electron,
    /// Analogue-to-digital units, if a gain, a bias or bits are given.
    Adu,
}

impl std::fmt::Display for CountUnit {
    /// Writes the unit as in FITS: `electron` or `adu`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Electron => "electron",
            Self::Adu => "adu",
        })
    }
}

/// A detector that converts the light of an image to counts. The [crate's page](crate) explains the
/// steps, their order and units.
///
/// ```
/// use psf_detector::Detector;
/// use psf_types::{FrameShape, Image};
/// let ccd = Detector::from_toml_str("
///     photon_noise = true
///     exposure_s = 100.0
///     dark_e_per_s = 0.5
///     full_well_e = 60000.0
///     read_noise_e = 4.0
/// ")?;
/// let light = Image::<f64>::zeros(FrameShape::new(64, 64)?);
/// assert_eq!(ccd.truth(&light)?.pixels()[[0, 0]], 50.0); // 100 s of dark current
/// assert_eq!(ccd.saturation(), Some(60000.0));
/// assert_eq!(ccd.expose(&light, 1)?, ccd.expose(&light, 1)?);
/// assert!(Detector::from_toml_str("read_noise = 4.0").is_err()); // the key is read_noise_e
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Detector {
    /// Checked parameters. Every step takes its settings from here.
    params: DetectorParams,
}

impl Detector {
    /// The largest number of bits at which every count is exact in single precision.
    const MAX_BITS: u32 = f32::MANTISSA_DIGITS;

    /// Checks the parameters and makes a detector from them.
    ///
    /// # Errors
    /// [`DetectorError::Setting`] and [`DetectorError::Needs`], which name the key and the
    /// requirement.
    pub fn new(params: DetectorParams) -> Result<Self, DetectorError> {
        above_zero("electrons_per_flux", params.electrons_per_flux)?;
        if let Some(seconds) = params.exposure_s {
            at_least_zero("exposure_s", seconds)?;
        }
        if at_least_zero("dark_e_per_s", params.dark_e_per_s)? > 0.0 && params.exposure_s.is_none() {
            return Err(DetectorError::Needs {
                key: "dark_e_per_s",
                other: "exposure_s",
            });
        }
        let finite = |key, value| require(key, "a finite number", value, |_| true);
        let gradient = params.sky_gradient_e_per_px.unwrap_or_default();
        finite("sky_gradient_e_per_px.x", gradient.x)?;
        finite("sky_gradient_e_per_px.y", gradient.y)?;
        at_least_zero("sky_e", params.sky_e)?;
        require(
            "response_rms",
            "a number from 0 to below 1",
            params.response_rms,
            |v| (0.0..1.0).contains(&v),
        )?;
        Self::check_bad_pixels(&params)?;
        if let Some(electrons) = params.full_well_e {
            above_zero("full_well_e", electrons)?;
        }
        at_least_zero("read_noise_e", params.read_noise_e)?;
        above_zero("gain_e_per_adu", params.gain_e_per_adu.unwrap_or(1.0))?;
        finite("bias_adu", params.bias_adu.unwrap_or(0.0))?;
        match params.bits {
            Some(bits) if !(1..=Self::MAX_BITS).contains(&bits) => Err(DetectorError::Setting {
                key: "bits",
                allowed: "a whole number from 1 to 24",
                got: f64::from(bits),
            }),
            _ => Ok(Self { params }),
        }
    }

    fn check_bad_pixels(params: &DetectorParams) -> Result<(), DetectorError> {
        let bad = params.bad_pixels;
        let fraction = |key, value| require(key, "a number from 0 to 1", value, |v| (0.0..=1.0).contains(&v));
        let dead = fraction("bad_pixels.dead_fraction", bad.dead_fraction)?;
        let hot = fraction("bad_pixels.hot_fraction", bad.hot_fraction)?;
        require(
            "bad_pixels.hot_fraction",
            "at most 1 minus bad_pixels.dead_fraction",
            hot,
            |hot| dead + hot <= 1.0,
        )?;
        let hot_dark = at_least_zero("bad_pixels.hot_dark_e_per_s", bad.hot_dark_e_per_s)?;
        if hot > 0.0 && hot_dark == 0.0 {
            return Err(DetectorError::Needs {
                key: "bad_pixels.hot_fraction",
                other: "bad_pixels.hot_dark_e_per_s",
            });
        }
        if hot_dark > 0.0 && params.exposure_s.is_none() {
            return Err(DetectorError::Needs {
                key: "bad_pixels.hot_dark_e_per_s",
                other: "exposure_s",
            });
        }
        fraction("bad_pixels.bad_column_fraction", bad.bad_column_fraction)?;
        Ok(())
    }

    /// Makes a detector from TOML text with the keys of [`DetectorParams`].
    ///
    /// # Errors
    /// [`DetectorError::Toml`], with line, column and key, for text that is not TOML with these
    /// keys. Otherwise the errors of [`new`](Self::new).
    pub fn from_toml_str(text: &str) -> Result<Self, DetectorError> {
        Self::new(toml::from_str(text).map_err(|e| DetectorError::Toml(Box::new(e)))?)
    }

    /// Makes a detector from a TOML file.
    ///
    /// # Errors
    /// [`DetectorError::Read`] or [`DetectorError::InFile`], which name the file.
    pub fn from_toml_file(path: impl AsRef<Path>) -> Result<Self, DetectorError> {
        let path = path.as_ref();
        Self::new(DetectorParams::from_toml_file(path)?).map_err(in_file(path))
    }

    /// The parameters that the detector was made from. To make another detector, change a copy and
    /// call [`new`](Self::new).
    pub fn params(&self) -> &DetectorParams {
        &self.params
    }

    /// The unit of the counts.
    pub fn unit(&self) -> CountUnit {
        let params = &self.params;
        if params.gain_e_per_adu.is_some() || params.bias_adu.is_some() || params.bits.is_some() {
            CountUnit::Adu
        } else {
            CountUnit::Electron
        }
    }

    /// Electrons per unit of the counts, 1 if no gain is given.
    pub fn gain(&self) -> f64 {
        self.params.gain_e_per_adu.unwrap_or(1.0)
    }

    /// Converts charges to the counts of the amplifier, `electrons / gain + bias`.
    pub(crate) fn amplify(&self, electrons: &mut [f64]) {
        let (gain, bias) = (self.gain(), self.params.bias_adu.unwrap_or(0.0));
        if (gain, bias) != (1.0, 0.0) {
            for value in electrons {
                *value = *value / gain + bias;
            }
        }
    }

    /// The largest count of the converter.
    pub(crate) fn highest_count(&self) -> Option<f64> {
        self.params.bits.map(|bits| f64::from((1_u32 << bits) - 1))
    }

    /// The count of a saturated pixel, if there is no read noise. This is the count of the full
    /// well or the largest count of the converter, whichever is lower. `None` if there is no limit.
    pub fn saturation(&self) -> Option<f64> {
        let count = |mut electrons: f64| {
            self.amplify(std::slice::from_mut(&mut electrons));
            electrons
        };
        let full = self.params.full_well_e.map(count);
        match (full, self.highest_count()) {
            (Some(full), Some(highest)) => Some(full.min(highest)),
            (full, highest) => full.or(highest),
        }
    }

    /// Expected dark charge of a good pixel in the exposure, in electrons.
    pub fn dark_e(&self) -> f64 {
        self.params.dark_e_per_s * self.params.exposure_s.unwrap_or(0.0)
    }

    /// The noise of a dark pixel, in the unit of the image's flux: the standard deviation of sky (at the middle of
    /// the frame), dark charge and read noise, `sqrt(sky + D t + sigma^2) / c`. Sky and dark charge count only
    /// with photon noise.
    pub fn noise(&self) -> f64 {
        let DetectorParams {
            sky_e,
            read_noise_e,
            electrons_per_flux,
            photon_noise,
            ..
        } = self.params;
        let counted = if photon_noise { sky_e + self.dark_e() } else { 0.0 };
        (counted + read_noise_e * read_noise_e).sqrt() / electrons_per_flux
    }

    /// Checks that photons may be shot for an exposure ([`Exposer::with_photons`](crate::Exposer::with_photons)).
    ///
    /// # Errors
    /// [`DetectorError::Needs`] for a detector without photon noise.
    pub fn check_photon_noise(&self) -> Result<(), DetectorError> {
        if self.params.photon_noise {
            return Ok(());
        }
        Err(DetectorError::Needs {
            key: "shooting of photons",
            other: "photon_noise",
        })
    }

    /// Returns whether pixels without light have a charge: that of sky, or dark charge.
    pub fn has_background(&self) -> bool {
        self.params.sky_e > 0.0 || self.dark_e() > 0.0
    }

    /// The mean number of photons for a flux of 1 that are shot at an exposure
    /// ([`Exposer::with_photons`](crate::Exposer::with_photons)): `electrons_per_flux` times the largest response
    /// of a pixel.
    pub fn photons_per_flux(&self) -> f64 {
        self.params.electrons_per_flux * largest_response(self.params.response_rms)
    }

    /// Returns whether every step is off, so that the counts equal the image. (Negative pixels
    /// nevertheless become 0.)
    pub fn is_perfect(&self) -> bool {
        let perfect = DetectorParams {
            name: self.params.name.clone(),
            exposure_s: self.params.exposure_s,
            pattern_seed: self.params.pattern_seed,
            ..DetectorParams::default()
        };
        self.params == perfect
    }
}
