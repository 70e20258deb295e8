//! Writes the files of an exposure: counts, noise-free truth, flags of the pixels.

use std::path::{Path, PathBuf};

use detector::{BadPixelMask, Detector, Exposure, ExposureReport};
use psf_io::{Card, CardError, HeaderCards, IntegerKind};
use psf_types::{Image, Real};

use crate::error::{ErrorKind, PsfieldError};

/// Keywords that describe an exposure. [`ExposureFiles::write`] does not copy their cards from the
/// header of the exposed image.
const KEYWORDS: [&str; 24] = [
    "DETNAME", "DETSEED", "DETPSEED", "DETTRUTH", "DETEPF", "DETPHOT", "DETSKY", "DETSKYX", "DETSKYY",
    "DETDARK", "DETRESP", "DETDEAD", "DETHOT", "DETHOTD", "DETBCOL", "DETFULL", "DETBIAS", "DETBITS",
    "DETNSAT", "DETNNEG", "DETNBAD", "RDNOISE", "GAIN", "SATURATE",
];

/// The paths of the files of an exposure.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let at = |name: &str| directory.path().join(name);
/// use psfield::exposure_files::ExposureFiles;
/// use psfield::detector::{Detector, DetectorParams};
/// use psfield::psf_io::{HeaderCards, read_image};
/// use psfield::psf_types::{FrameShape, Image};
/// let ccd = Detector::new(DetectorParams { photon_noise: true, sky_e: 30.0, bits: Some(16), ..Default::default() })?;
/// let image = Image::<f32>::zeros(FrameShape::new(50, 40)?);
/// let files = ExposureFiles { raw: at("raw.fits"), truth: Some(at("truth.fits")), quality: None, overwrite: false };
/// let exposure = ccd.expose(&image, 1)?;
/// files.write(&exposure, &image, &ccd, &HeaderCards::new(), &[])?;
/// assert_eq!(read_image::<f32>(at("truth.fits"))?.image().pixels()[[0, 0]], 30.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExposureFiles {
    /// The counts, with `BITPIX` 8, 16 (with `BZERO`) or 32 if they are digitised, else -32 or -64.
    pub raw: PathBuf,
    /// The noise-free image in the same unit ([`Detector::truth`]).
    pub truth: Option<PathBuf>,
    /// Sums of [`PixelFlags`](detector::PixelFlags), `BITPIX` 8.
    pub quality: Option<PathBuf>,
    /// If true, existing files may be replaced.
    pub overwrite: bool,
}

impl ExposureFiles {
    /// Writes the files of `exposure`, which `detector` made of the image `light`. Every header
    /// holds first `header` (the cards of `light`), then `added`, then cards that describe the
    /// file. For the counts these are [`exposure_cards`]. The counts appear last, when the other
    /// files are complete ([`write_together`](psf_io::write_together)).
    ///
    /// # Errors
    /// The errors of [`Detector::truth`], if the truth is written, and of
    /// [`write_image`](psf_io::write_image).
    pub fn write<T: Real>(
        &self,
        exposure: &Exposure<T>,
        light: &Image<T>,
        detector: &Detector,
        header: &HeaderCards,
        added: &[Card],
    ) -> Result<(), PsfieldError> {
        let mut header = header.clone();
        for keyword in KEYWORDS {
            header.remove(keyword);
        }
        psf_io::write_together(|| {
            if let Some(path) = &self.truth {
                let cards = [added, &truth_cards(detector)?].concat();
                psf_io::write_image(path, &detector.truth(light)?, &header, &cards, self.overwrite)?;
            }
            if let Some(path) = &self.quality {
                let mut header = header.clone();
                header.remove("BUNIT");
                let meaning = Card::comment("Sums of flags: 1 dead, 2 hot, 4 bad column, 8 saturated");
                let cards = [added, &[meaning]].concat();
                let kind = IntegerKind::Unsigned8;
                psf_io::write_integers(path, exposure.flags(), kind, &header, &cards, self.overwrite)?;
            }
            let cards = [added, &exposure_cards(detector, exposure.report())?].concat();
            let counts = exposure.counts();
            if let Some(bits) = detector.params().bits {
                let integers = counts.pixels().mapv(|count| count.as_f64() as i32);
                let kind = IntegerKind::of_bits(bits);
                psf_io::write_integers(&self.raw, integers.view(), kind, &header, &cards, self.overwrite)?;
            } else {
                psf_io::write_image(&self.raw, counts, &header, &cards, self.overwrite)?;
            }
            Ok(())
        })
    }
}

/// Reads a mask of bad pixels: an image of sums of [`PixelFlags`](detector::PixelFlags), 0 for good
/// pixels.
///
/// # Errors
/// The errors of [`read_image`](psf_io::read_image), and [`ErrorKind::Detector`] for an image with
/// other values.
pub fn read_bad_pixel_mask(path: impl AsRef<Path>) -> Result<BadPixelMask, PsfieldError> {
    let path = path.as_ref();
    let image = psf_io::read_image::<f32>(path)?;
    BadPixelMask::new(image.image().pixels()).map_err(|source| {
        let message = format!("{}: this is not a mask of bad pixels", path.display());
        PsfieldError::new(ErrorKind::Detector, message).because(source)
    })
}

/// Header cards of an exposure: the settings that are needed to repeat it, and the cards that
/// readers of raw frames look for.
///
/// | keyword | value |
/// |---|---|
/// | `BUNIT` | `electron` or `adu` |
/// | `EXPTIME` | exposure time in s, if known |
/// | `GAIN`, `RDNOISE` | electrons per unit of the counts; read noise in electrons |
/// | `SATURATE` | count at which pixels saturate ([`Detector::saturation`]), if there is one |
/// | `DETSEED`, `DETPSEED` | seeds of the noise and of the sensor's pattern, as strings, because they may exceed signed 64-bit integers |
/// | `DETEPF`, `DETPHOT`, `DETSKY`, `DETSKYX`, `DETSKYY`, `DETDARK`, `DETRESP`, `DETFULL`, `DETBIAS`, `DETBITS`, `DETDEAD`, `DETHOT`, `DETHOTD`, `DETBCOL`, `DETNAME` | the settings of [`DetectorParams`](detector::DetectorParams) that are in use |
/// | `DETNSAT`, `DETNNEG`, `DETNBAD` | numbers of saturated pixels, of pixels whose expected charge was negative, of bad pixels |
///
/// # Errors
/// No error occurs. The type allows an error for a value that is not finite, which a checked
/// detector does not have.
pub fn exposure_cards(detector: &Detector, report: &ExposureReport) -> Result<Vec<Card>, CardError> {
    let params = detector.params();
    let mut cards = level_cards(detector)?;
    cards.extend([
        Card::new("DETSEED", report.seed.to_string(), "seed of the noise")?,
        Card::new("DETPHOT", params.photon_noise, "photon noise")?,
        Card::new("RDNOISE", params.read_noise_e, "[electron] read noise, r.m.s.")?,
    ]);
    if let Some(level) = detector.saturation() {
        cards.push(Card::new("SATURATE", level, "count at which pixels saturate")?);
    }
    if let Some(full) = params.full_well_e {
        cards.push(Card::new("DETFULL", full, "[electron] full well")?);
    }
    if let Some(bits) = params.bits {
        cards.push(Card::new("DETBITS", bits, "bits of the converter")?);
    }
    let bad = params.bad_pixels;
    let pattern = [
        ("DETRESP", params.response_rms, "r.m.s. scatter of pixel response"),
        ("DETDEAD", bad.dead_fraction, "probability of a dead pixel"),
        ("DETHOT", bad.hot_fraction, "probability of a hot pixel"),
        (
            "DETHOTD",
            bad.hot_dark_e_per_s,
            "[electron/s] dark current of hot pixels",
        ),
        ("DETBCOL", bad.bad_column_fraction, "probability of a bad column"),
    ];
    for (keyword, value, comment) in pattern.into_iter().filter(|p| p.1 > 0.0) {
        cards.push(Card::new(keyword, value, comment)?);
    }
    if pattern.iter().any(|p| p.1 > 0.0) {
        let seed = params.pattern_seed.to_string();
        cards.push(Card::new("DETPSEED", seed, "seed of response and bad pixels")?);
    }
    cards.extend([
        Card::new("DETNSAT", report.saturated_pixels, "saturated pixels")?,
        Card::new(
            "DETNNEG",
            report.negative_pixels,
            "pixels with negative expected charge",
        )?,
        Card::new("DETNBAD", report.bad_pixels, "bad pixels")?,
    ]);
    Ok(cards)
}

/// Cards of the noise-free image.
fn truth_cards(detector: &Detector) -> Result<Vec<Card>, CardError> {
    let mut cards = level_cards(detector)?;
    cards.push(Card::new(
        "DETTRUTH",
        true,
        "noise-free image: light, sky, dark and bias",
    )?);
    Ok(cards)
}

/// Cards of the settings that determine the expected counts.
fn level_cards(detector: &Detector) -> Result<Vec<Card>, CardError> {
    let params = detector.params();
    let mut cards = vec![
        Card::new("BUNIT", detector.unit().to_string(), "unit of the pixels")?,
        Card::new("GAIN", detector.gain(), "[electron] per unit of the pixels")?,
        Card::new(
            "DETEPF",
            params.electrons_per_flux,
            "[electron] per unit of the scene's flux",
        )?,
        Card::new("DETSKY", params.sky_e, "[electron] sky level per pixel")?,
    ];
    if !params.name.is_empty() {
        cards.push(Card::new("DETNAME", params.name.as_str(), "detector name")?);
    }
    if let Some(seconds) = params.exposure_s {
        cards.push(Card::new("EXPTIME", seconds, "[s] exposure time")?);
    }
    if let Some(slope) = params.sky_gradient_e_per_px {
        cards.push(Card::new(
            "DETSKYX",
            slope.x,
            "[electron/pixel] sky gradient along x",
        )?);
        cards.push(Card::new(
            "DETSKYY",
            slope.y,
            "[electron/pixel] sky gradient along y",
        )?);
    }
    if params.dark_e_per_s > 0.0 {
        cards.push(Card::new(
            "DETDARK",
            params.dark_e_per_s,
            "[electron/s] dark current",
        )?);
    }
    if let Some(bias) = params.bias_adu {
        cards.push(Card::new("DETBIAS", bias, "[adu] bias level")?);
    }
    Ok(cards)
}
