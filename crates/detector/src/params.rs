//! The description of a detector as it stands in a TOML file: unchecked.

use serde::{Deserialize, Serialize};

/// Everything that describes a detector and an exposure, with the keys of the TOML file. Nothing is checked here:
/// [`Detector::new`](crate::Detector::new) does it, in one place, for files and for code alike.
///
/// All keys may be left out; unknown keys are errors. The default is a perfect detector, which counts electrons without noise.
/// The steps are in the [crate's table](crate#the-chain).
///
/// | key | unit, range | default |
/// |---|---|---|
/// | `name` | any text | empty |
/// | `electrons_per_flux` | electrons in the exposure per unit of the image's flux, above 0 | 1 |
/// | `exposure_s` | s, 0 and above | none |
/// | `photon_noise` | `true` or `false` | `false` |
/// | `sky_e` | electrons a pixel in the exposure, 0 and above | 0 |
/// | `sky_gradient_e_per_px` | [`SkyGradient`] | none |
/// | `dark_e_per_s` | electrons a pixel and second, 0 and above; needs `exposure_s` | 0 |
/// | `response_rms` | relative, 0 to below 1 | 0 |
/// | `full_well_e` | electrons, above 0 | none |
/// | `read_noise_e` | electrons, standard deviation, 0 and above | 0 |
/// | `gain_e_per_adu` | electrons per ADU, above 0 | 1 |
/// | `bias_adu` | ADU | 0 |
/// | `bits` | 1 to 24 | none: no digitisation |
/// | `pattern_seed` | of the response and the bad pixels | 0 |
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
    /// A name for people.
    pub name: String,
    /// Electrons that one unit of the image's flux gives in the exposure.
    pub electrons_per_flux: f64,
    /// Exposure time in s; it scales the dark current, not the light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure_s: Option<f64>,
    /// Whether charge is Poisson distributed about its expected value.
    pub photon_noise: bool,
    /// Sky in electrons a pixel, in the exposure; with a gradient: at the middle of the frame.
    pub sky_e: f64,
    /// How the sky changes over the frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sky_gradient_e_per_px: Option<SkyGradient>,
    /// Dark current in electrons a pixel and second.
    pub dark_e_per_s: f64,
    /// Standard deviation of the pixels' response to light about 1 (pixel-response non-uniformity).
    pub response_rms: f64,
    /// The largest charge of a pixel in electrons.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub full_well_e: Option<f64>,
    /// Standard deviation of the read noise in electrons.
    pub read_noise_e: f64,
    /// Electrons per ADU.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_e_per_adu: Option<f64>,
    /// The level of no charge in ADU.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bias_adu: Option<f64>,
    /// Bits of the converter: counts are whole numbers from 0 to `2^bits - 1`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bits: Option<u32>,
    /// Seed of what belongs to the sensor: its response and its bad pixels.
    pub pattern_seed: u64,
    /// Pixels that do not work as the others.
    pub bad_pixels: BadPixelParams,
}

/// The slope of the sky, in electrons a pixel per pixel, about the middle of the frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SkyGradient {
    /// Along a row.
    pub x: f64,
    /// Along a column.
    pub y: f64,
}

/// How many pixels do not work as the others. Which ones follows from `pattern_seed` and the shape of the frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BadPixelParams {
    /// Chance of a pixel to hold no charge ever, 0 to 1.
    pub dead_fraction: f64,
    /// Chance of a pixel to have a dark current of its own, 0 to 1; not more than 1 with `dead_fraction`.
    pub hot_fraction: f64,
    /// Dark current of hot pixels in electrons a second, on top of that of all pixels; needs `exposure_s`.
    pub hot_dark_e_per_s: f64,
    /// Chance of a column to hold no charge, 0 to 1.
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
