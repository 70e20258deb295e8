//! The detector.

use std::path::Path;

use psf_types::{FrameShape, Image, Real};

use crate::amplifier::Amplifier;
use crate::bad_pixels::BadPixels;
use crate::converter::Converter;
use crate::error::{above_zero, at_least_zero};
use crate::full_well::FullWell;
use crate::pixel_response::PixelResponse;
use crate::read_noise::ReadNoise;
use crate::sky::Sky;
use crate::{CountUnit, DetectorError, DetectorParams, Exposer, Exposure};

/// A detector that turns the light of an image into counts. See the [crate's page](crate) for the steps, their order and units.
///
/// ```
/// use detector::Detector;
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
/// assert!(Detector::from_toml_str("read_noise = 4.0").is_err()); // the key has its unit: read_noise_e
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Detector {
    params: DetectorParams,
    pub(crate) sky: Sky,
    pub(crate) response: Option<PixelResponse>,
    pub(crate) bad_pixels: BadPixels,
    pub(crate) full_well: Option<FullWell>,
    pub(crate) read_noise: Option<ReadNoise>,
    pub(crate) amplifier: Amplifier,
    pub(crate) converter: Option<Converter>,
}

impl Detector {
    /// A detector from its parameters. Checks all of them.
    ///
    /// # Errors
    /// [`DetectorError::Setting`] and [`DetectorError::Needs`], naming the key and what is allowed.
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
        Ok(Self {
            sky: Sky::new(&params)?,
            response: PixelResponse::new(&params)?,
            bad_pixels: BadPixels::new(&params)?,
            full_well: FullWell::new(&params)?,
            read_noise: ReadNoise::new(&params)?,
            amplifier: Amplifier::new(&params)?,
            converter: Converter::new(&params)?,
            params,
        })
    }

    /// A detector from TOML text with the keys of [`DetectorParams`].
    ///
    /// # Errors
    /// [`DetectorError::Toml`] with line, column and key for text that is not such a file; else as [`new`](Self::new).
    pub fn from_toml_str(text: &str) -> Result<Self, DetectorError> {
        Self::new(toml::from_str(text).map_err(|e| DetectorError::Toml(Box::new(e)))?)
    }

    /// A detector from a TOML file.
    ///
    /// # Errors
    /// [`DetectorError::Read`] or [`DetectorError::InFile`], which name the file.
    pub fn from_toml_file(path: impl AsRef<Path>) -> Result<Self, DetectorError> {
        let path = path.as_ref();
        let text = std::fs::read_to_string(path).map_err(|source| DetectorError::Read {
            path: path.to_owned(),
            source,
        })?;
        Self::from_toml_str(&text).map_err(|source| DetectorError::InFile {
            path: path.to_owned(),
            source: Box::new(source),
        })
    }

    /// The parameters it was made from; change a copy and call [`new`](Self::new) for another detector.
    pub fn params(&self) -> &DetectorParams {
        &self.params
    }

    /// The unit of its counts.
    pub fn unit(&self) -> CountUnit {
        let params = &self.params;
        if params.gain_e_per_adu.is_some() || params.bias_adu.is_some() || params.bits.is_some() {
            CountUnit::Adu
        } else {
            CountUnit::Electron
        }
    }

    /// Electrons per unit of its counts.
    pub fn gain(&self) -> f64 {
        self.amplifier.gain()
    }

    /// The count at which a pixel is saturated, without read noise: that of the full well, or the upper end of the converter if that is
    /// lower; none where nothing limits it.
    pub fn saturation(&self) -> Option<f64> {
        let full = self.full_well.map(|well| self.amplifier.counts(well.electrons));
        let highest = self.converter.map(|converter| converter.highest);
        match (full, highest) {
            (Some(full), Some(highest)) => Some(full.min(highest)),
            (full, highest) => full.or(highest),
        }
    }

    /// Dark charge of a good pixel in electrons, expected in the exposure.
    pub fn dark_e(&self) -> f64 {
        self.params.dark_e_per_s * self.params.exposure_s.unwrap_or(0.0)
    }

    /// Whether every step is off: the counts are the image.
    pub fn is_perfect(&self) -> bool {
        let on = DetectorParams {
            name: self.params.name.clone(),
            exposure_s: self.params.exposure_s,
            pattern_seed: self.params.pattern_seed,
            ..DetectorParams::default()
        };
        self.params == on
    }

    /// Made ready for a frame and a seed: for images that come by bands of rows, and for masks of bad pixels.
    ///
    /// # Errors
    /// [`DetectorError::NegativeSky`] for a sky that falls below 0 in this frame.
    pub fn exposer(&self, frame: FrameShape, seed: u64) -> Result<Exposer<'_>, DetectorError> {
        Exposer::new(self, frame, seed)
    }

    /// Exposes an image. The same seed gives the same counts, whatever the number of threads.
    ///
    /// # Errors
    /// [`DetectorError::NegativeSky`], [`DetectorError::NonFinite`] for charges beyond double precision, and
    /// [`DetectorError::TooLarge`] for counts that `T` cannot hold.
    pub fn expose<T: Real>(&self, light: &Image<T>, seed: u64) -> Result<Exposure<T>, DetectorError> {
        self.exposer(light.shape(), seed)?.expose(light)
    }

    /// The noise-free image in the unit of the counts: light, sky and dark charge as a detector would give them that had no noise,
    /// no limits and no bad pixels, whose pixels were all alike.
    ///
    /// `(c F + sky + D t) / g + b` with the letters of the [crate's page](crate#the-chain). Negative pixels stay.
    ///
    /// # Errors
    /// As [`expose`](Self::expose).
    pub fn truth<T: Real>(&self, light: &Image<T>) -> Result<Image<T>, DetectorError> {
        let exposer = self.exposer(light.shape(), 0)?;
        Ok(Image::new(exposer.truth_rows(0, light.pixels())?)?)
    }
}
