//! The parameters of a telescope as they stand in a TOML file, not yet checked.

use serde::{Deserialize, Serialize};

use crate::FieldTerm;

/// The full description of a telescope, with the keys of the TOML file. The values are not checked
/// here: [`Telescope::new`] checks descriptions from files and from code.
///
/// In a file, unknown keys are errors. Keys without a default are required.
///
/// | key | unit, range | default |
/// |---|---|---|
/// | `name` | any text | empty |
/// | `wavelength_nm` | nm, above 0 | |
/// | `pixel_scale_arcsec` | arcsec per frame pixel, above 0 | |
/// | `frame.nx`, `frame.ny` | pixels, 1 and above | |
/// | `stamp.nx`, `stamp.ny` | stamp pixels, 1 and above | |
/// | `stamp.oversampling` | stamp pixels per frame pixel, 1 to 64 | 1 |
/// | `stamp.padding` | least width of the computed focal plane / the stamp's larger side, 1 to 16 | 2 |
/// | `aperture.diameter_m` | m, above 0 | |
/// | `aperture.obscuration` | linear ratio of the central obscuration, `0 <= r < 1` | 0 |
/// | `aperture.spider` | [`SpiderParams`] | none |
/// | `wavefront.unit` | `"nm"` or `"waves"` (of `wavelength_nm`) | `"nm"` |
/// | `wavefront.modes` | list of [`ModeParams`] | empty |
/// | `seeing` | [`SeeingParams`] | none |
/// | `detector` | [`DetectorParams`] | pixel integration only |
///
/// [`Telescope::new`]: crate::Telescope::new
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TelescopeParams {
    /// A name for human readers.
    #[serde(default)]
    pub name: String,
    /// The wavelength in nm. The PSF is monochromatic.
    pub wavelength_nm: f64,
    /// Arcseconds per frame pixel.
    pub pixel_scale_arcsec: f64,
    /// The detector's frame.
    pub frame: FrameParams,
    /// The stamps that are drawn.
    pub stamp: StampParams,
    /// The pupil.
    pub aperture: ApertureParams,
    /// The aberrations.
    #[serde(default)]
    pub wavefront: WavefrontParams,
    /// Long-exposure atmospheric seeing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seeing: Option<SeeingParams>,
    /// Pixel integration and blur of the detector.
    #[serde(default)]
    pub detector: DetectorParams,
}

/// Frame size in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameParams {
    /// Columns.
    pub nx: usize,
    /// Rows.
    pub ny: usize,
}

/// Stamp size and sampling.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StampParams {
    /// Columns, in stamp pixels.
    pub nx: usize,
    /// Rows, in stamp pixels.
    pub ny: usize,
    /// Stamp pixels per frame pixel.
    #[serde(default = "one")]
    pub oversampling: usize,
    /// The least width of the computed focal plane, divided by the stamp's larger side. Light
    /// beyond the computed width reappears on the opposite side, so the padding bounds the error of
    /// the far wings and of the flux (see the crate's page).
    #[serde(default = "two")]
    pub padding: f64,
}

/// The pupil: a disc, its central obscuration and its spider.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApertureParams {
    /// Diameter in m.
    pub diameter_m: f64,
    /// Diameter of the central obscuration divided by the diameter of the aperture.
    #[serde(default)]
    pub obscuration: f64,
    /// The vanes that hold the secondary mirror.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spider: Option<SpiderParams>,
}

/// Vanes from the centre of the aperture to its edge, at equal angles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpiderParams {
    /// Number of vanes, 1 to 64.
    pub vanes: usize,
    /// Width of a vane in m, above 0 and below the diameter.
    pub width_m: f64,
    /// Direction of the first vane in degrees from the x axis towards the y axis, 0 by default.
    #[serde(default)]
    pub angle_deg: f64,
}

/// The wavefront error over the field.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WavefrontParams {
    /// The unit of the coefficients.
    #[serde(default)]
    pub unit: WavefrontUnit,
    /// The Zernike terms.
    #[serde(default)]
    pub modes: Vec<ModeParams>,
}

/// The unit of Zernike coefficients. A coefficient is the r.m.s. of its term over the unobscured
/// pupil.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WavefrontUnit {
    /// Nanometres.
    #[default]
    Nm,
    /// Multiples of the telescope's wavelength.
    Waves,
}

/// A Zernike term whose coefficient is a polynomial of the field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModeParams {
    /// Noll's index, 1 to 231, each at most once. Piston (1) is accepted and has no effect.
    pub noll: usize,
    /// The terms of the coefficient's [`FieldPolynomial`](crate::FieldPolynomial).
    pub terms: Vec<FieldTerm>,
}

/// Long-exposure seeing. Exactly one of `r0_m` and `fwhm_arcsec` must be given.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeeingParams {
    /// Fried's parameter in m at `at_wavelength_nm`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub r0_m: Option<f64>,
    /// FWHM of Kolmogorov seeing in arcsec at `at_wavelength_nm`, `0.97586 lambda / r0`. (A finite
    /// outer scale makes the actual FWHM smaller.)
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fwhm_arcsec: Option<f64>,
    /// The wavelength in nm at which `r0_m` or `fwhm_arcsec` is given, 500 by default. r0 is
    /// proportional to the wavelength to the power 6/5.
    #[serde(default = "reference_wavelength")]
    pub at_wavelength_nm: f64,
    /// The outer scale in m of von Karman turbulence. If it is absent, the turbulence is
    /// Kolmogorov.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outer_scale_m: Option<f64>,
}

/// Pixel integration and blur of the detector.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorParams {
    /// If true (the default), values are integrated over a frame pixel (a top hat). If false, they
    /// are the intensity at the pixel's centre times the area of a frame pixel.
    #[serde(default = "yes")]
    pub pixel_integration: bool,
    /// Standard deviation along each axis, in frame pixels, of a Gaussian blur (charge diffusion,
    /// jitter). The default 0 means no blur.
    #[serde(default)]
    pub blur_sigma_px: f64,
}

impl Default for DetectorParams {
    fn default() -> Self {
        Self {
            pixel_integration: true,
            blur_sigma_px: 0.0,
        }
    }
}

impl TelescopeParams {
    /// A perfect, unobscured telescope with square stamps, to start from in code.
    pub fn diffraction_limited(
        diameter_m: f64,
        wavelength_nm: f64,
        pixel_scale_arcsec: f64,
        frame: FrameParams,
        stamp_size: usize,
    ) -> Self {
        Self {
            name: String::new(),
            wavelength_nm,
            pixel_scale_arcsec,
            frame,
            stamp: StampParams {
                nx: stamp_size,
                ny: stamp_size,
                oversampling: one(),
                padding: two(),
            },
            aperture: ApertureParams {
                diameter_m,
                obscuration: 0.0,
                spider: None,
            },
            wavefront: WavefrontParams::default(),
            seeing: None,
            detector: DetectorParams::default(),
        }
    }
}

fn one() -> usize {
    1
}

fn two() -> f64 {
    2.0
}

fn yes() -> bool {
    true
}

fn reference_wavelength() -> f64 {
    500.0
}
