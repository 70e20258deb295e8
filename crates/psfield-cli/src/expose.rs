//! `psfield expose`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use detector::{Detector, DetectorError, DetectorParams};
use psf_io::HduChoice;
use psf_types::Real;
use psfield::exposure_files::{ExposureFiles, read_bad_pixel_mask};

use super::UsageError;
use super::context::{Context, object, signature};
use super::files::OutputFile;
use super::values::{Precision, above_zero, at_least_zero};

/// Add sky, noise and other effects of a detector to a noise-free image
///
/// Sky, pixel response non-uniformity, dark current, bad pixels, photon noise, full well, read
/// noise, gain, bias and digitisation: each step is applied only if the detector file or an option
/// asks for it.
///
/// The flux of the image times electrons_per_flux (default 1) is the number of electrons in the
/// exposure. Counts are in ADU if gain, bias or bits are given, else in electrons. Where the charge
/// expected from light, sky and dark current is negative, photon noise is minus a Poisson number of
/// its size. Only the digitisation clips at 0. The image itself is never changed.
#[derive(Debug, clap::Args)]
pub(crate) struct ExposeArgs {
    /// Noise-free image
    #[arg(value_name = "IMAGE.fits")]
    image: PathBuf,
    /// HDU of the image: its number (0: primary), NAME or NAME,VERSION [default: the primary image,
    /// else the only one]
    #[arg(long, value_name = "N|NAME")]
    extension: Option<HduChoice>,
    /// Exposure to write (whole numbers if it is digitised)
    #[arg(short, long, value_name = "RAW.fits")]
    output: OutputFile,
    /// Also write the noise-free image with sky, dark charge and bias, in the unit of the exposure
    #[arg(long, value_name = "TRUTH.fits")]
    truth: Option<OutputFile>,
    /// Also write flags of each pixel: sums of 1 dead, 2 hot, 4 bad column, 8 saturated
    #[arg(long, value_name = "QUALITY.fits", hide_short_help = true)]
    quality: Option<OutputFile>,
    /// Replace outputs that exist
    #[arg(long)]
    overwrite: bool,
    /// Detector file (TOML)
    ///
    /// The options below name its keys in square brackets. More keys: response_rms (r.m.s. of the
    /// pixel response, relative to its mean), sky_gradient_e_per_px = { x, y } (change of the sky
    /// from one pixel to the next, in electrons per pixel), pattern_seed (seed of the pixel
    /// response and the bad pixels), and the table bad_pixels with dead_fraction, hot_fraction,
    /// hot_dark_e_per_s, bad_column_fraction.
    ///
    /// An example, one key per line in the file: photon_noise = true, exposure_s = 100.0, sky_e =
    /// 200.0, dark_e_per_s = 0.02, read_noise_e = 5.0, gain_e_per_adu = 1.5, bias_adu = 300.0, bits
    /// = 16.
    #[arg(long, value_name = "DETECTOR.toml")]
    detector: Option<PathBuf>,
    /// Image of bad pixels, in addition to the bad pixels of the detector file
    ///
    /// Each pixel is 0 (good) or a sum of 1 dead, 2 hot, 4 bad column.
    #[arg(long, value_name = "MASK.fits", hide_short_help = true)]
    mask: Option<PathBuf>,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Precision in which the image is read, and in which an exposure without digitisation is
    /// written
    #[arg(long, default_value_t, value_enum, hide_short_help = true)]
    precision: Precision,
    /// Add photon noise and nothing else
    #[arg(long, conflicts_with_all = ["detector", "mask", "Settings"])]
    photons_only: bool,
    #[command(flatten)]
    settings: Settings,
}

/// Settings of the detector that can be given without a file. They override the file.
#[derive(Debug, clap::Args)]
#[group(id = "Settings", multiple = true)]
#[command(next_help_heading = "Detector (options override the file, [key] is the key in the file)")]
struct Settings {
    /// Add photon noise: the charge is Poisson distributed [photon_noise]
    #[arg(long)]
    photon_noise: bool,
    /// Electrons in the exposure per unit of the image's flux [electrons_per_flux]
    #[arg(long, value_name = "E", value_parser = above_zero)]
    electrons_per_flux: Option<f64>,
    /// Sky in the whole exposure (electrons per pixel) [sky_e]
    #[arg(long, value_name = "E", value_parser = at_least_zero)]
    sky: Option<f64>,
    /// Exposure time (s), for the dark current [exposure_s]
    #[arg(long, value_name = "S", value_parser = at_least_zero)]
    exposure: Option<f64>,
    /// Dark current (electrons per pixel and second), needs an exposure time [dark_e_per_s]
    #[arg(long, value_name = "E_PER_S", value_parser = at_least_zero)]
    dark: Option<f64>,
    /// Full well: the largest charge of a pixel (electrons) [full_well_e]
    #[arg(long, value_name = "E", value_parser = above_zero, hide_short_help = true)]
    full_well: Option<f64>,
    /// Read noise, r.m.s. (electrons) [read_noise_e]
    #[arg(long, value_name = "E", value_parser = at_least_zero)]
    read_noise: Option<f64>,
    /// Gain (electrons per ADU) [gain_e_per_adu]
    #[arg(long, value_name = "E_PER_ADU", value_parser = above_zero)]
    gain: Option<f64>,
    /// Level of a pixel without charge (ADU) [bias_adu]
    #[arg(long, value_name = "ADU")]
    bias: Option<f64>,
    /// Digitise to whole numbers from 0 to 2^N - 1, N at most 24 [bits]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=24))]
    bits: Option<u32>,
}

/// Keys in the detector file with their options, for messages.
const OPTIONS: [(&str, &str); 3] = [
    ("bias_adu", "--bias"),
    ("dark_e_per_s", "--dark"),
    ("exposure_s", "--exposure"),
];

/// Refuses a detector that adds nothing to an image, if it is `alone` (without a mask of bad
/// pixels). Warns if there is no photon noise. `file`: the detector file, for the message.
pub(crate) fn check_detector(
    detector: &Detector,
    file: Option<&Path>,
    alone: bool,
    context: &Context,
) -> anyhow::Result<()> {
    if detector.is_perfect() && alone {
        let file = file.map_or_else(String::new, |file| format!("{}: ", file.display()));
        let what = format!(
            "{file}there is nothing to add: the detector has no settings. Set some in the file of --detector DETECTOR.toml. The command \
             psfield expose also has options for them, such as --photon-noise --sky 100 --read-noise 5, or --photons-only"
        );
        return Err(UsageError(what).into());
    }
    if !detector.params().photon_noise {
        context.warn("the exposure has no photon noise: set photon_noise = true in the detector file (or use the option --photon-noise of psfield expose)");
    }
    Ok(())
}

impl ExposeArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let detector = self.detector()?;
        check_detector(&detector, self.detector.as_deref(), self.mask.is_none(), context)?;
        match self.precision {
            Precision::F32 => self.run_in::<f32>(&detector, context),
            Precision::F64 => self.run_in::<f64>(&detector, context),
        }
    }

    fn run_in<T: Real>(self, detector: &Detector, context: &Context) -> anyhow::Result<()> {
        let files = ExposureFiles {
            raw: self.output.to_path_buf(),
            truth: self.truth.as_deref().cloned(),
            quality: self.quality.as_deref().cloned(),
            overwrite: self.overwrite,
        };
        let spinner = context.spinner("exposing");
        let clock = Instant::now();
        let (light, header) = psf_io::read_image_hdu::<T>(&self.image, self.extension.as_ref())?.into_parts();
        let mask = self.mask.as_ref().map(read_bad_pixel_mask).transpose()?;
        let read = clock.elapsed().as_secs_f64();

        let clock = Instant::now();
        let mut exposer = detector.exposer(light.shape(), self.seed)?;
        if let Some(mask) = &mask {
            exposer = exposer.with_mask(mask)?;
        }
        let exposure = exposer.expose(&light)?;
        let expose = clock.elapsed().as_secs_f64();

        let clock = Instant::now();
        files.write(&exposure, &light, detector, &header, &signature())?;
        let write = clock.elapsed().as_secs_f64();
        drop(spinner);

        let (nx, ny) = (light.shape().nx(), light.shape().ny());
        let (e, params) = (exposure.report(), detector.params());
        let report = object! {
            output: &files.raw,
            truth: files.truth.as_deref(),
            quality: files.quality.as_deref(),
            shape: [nx, ny],
            precision: T::NAME,
            unit: detector.unit(),
            // The value of saturated pixels, in `unit`.
            saturation: detector.saturation(),
            detector: params,
            #[serde(flatten)]
            exposure: e,
            seconds: object! { read, expose, write },
        };
        context.report(&report, || {
            let noise = match (params.photon_noise, params.read_noise_e) {
                (true, 0.0) => "photon noise".to_owned(),
                (true, read) => format!("photon noise, read noise {read} e"),
                (false, read) => format!("no photon noise, read noise {read} e"),
            };
            let negative = if e.negative_pixels > 0 {
                format!(" (lowest {:.3e} e)", e.lowest_expected_e)
            } else {
                String::new()
            };
            format!(
                "{}: {nx} x {ny} pixels in {}, seed {}\nsky {} e, dark {} e, {noise}\n\
                 pixels: {} saturated, {} bad, {} below 0 before noise{negative}, {} clipped at 0 by the digitisation\n\
                 seconds: read {read:.3}, expose {expose:.3}, write {write:.3}",
                files.raw.display(),
                report.unit,
                e.seed,
                e.mean_sky_e,
                e.dark_e,
                e.saturated_pixels,
                e.bad_pixels,
                e.negative_pixels,
                e.below_zero_pixels,
            )
        })
    }

    /// Returns the detector of the file. Options override its keys.
    fn detector(&self) -> anyhow::Result<Detector> {
        let mut params = match &self.detector {
            Some(path) => Detector::from_toml_file(path)?.params().clone(),
            None => DetectorParams::default(),
        };
        let set = &self.settings;
        params.photon_noise |= set.photon_noise || self.photons_only;
        for (key, option) in [
            (&mut params.electrons_per_flux, set.electrons_per_flux),
            (&mut params.sky_e, set.sky),
            (&mut params.dark_e_per_s, set.dark),
            (&mut params.read_noise_e, set.read_noise),
        ] {
            *key = option.unwrap_or(*key);
        }
        for (key, option) in [
            (&mut params.exposure_s, set.exposure),
            (&mut params.full_well_e, set.full_well),
            (&mut params.gain_e_per_adu, set.gain),
            (&mut params.bias_adu, set.bias),
        ] {
            *key = option.or(*key);
        }
        params.bits = set.bits.or(params.bits);
        // The file was checked when it was read, so an error here comes from the options.
        Detector::new(params).map_err(|error| {
            let option = |key| {
                OPTIONS
                    .iter()
                    .find(|known| known.0 == key)
                    .map_or(key, |known| known.1)
            };
            let text = match error {
                DetectorError::Needs { key, other } => {
                    let (key, other) = (option(key), option(other));
                    format!("{key} needs {other}: give {other}, or leave {key} out")
                }
                DetectorError::Setting { key, allowed, got } => {
                    format!("{} must be {allowed}, got {got}", option(key))
                }
                other => other.to_string(),
            };
            UsageError(text).into()
        })
    }
}
