//! The detector of `psfield simulate`.

use std::path::{Path, PathBuf};

use detector::{Detector, ExposureReport};
use psf_io::{Card, HeaderCards};
use psf_types::{Image, Real};
use psfield::ExposureFiles;

use super::super::context::Context;
use super::super::expose::check_detector;

/// A detector that exposes the image.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Detector")]
pub(super) struct ExposureArgs {
    /// Write detector counts instead of flux, and the noise-free image as IMAGE_truth.fits
    ///
    /// Sky, photon noise, dark current, read noise, gain, digitisation: psfield expose --help lists
    /// the keys of the file. --seed is the seed of the noise. --no-truth leaves the second file
    /// out.
    #[arg(long, value_name = "DETECTOR.toml")]
    pub(super) detector: Option<PathBuf>,
    /// Noise-free image to write with --detector [default: IMAGE_truth.fits next to the image]
    ///
    /// This image has the unit of the detector's counts. It includes sky, dark charge and bias.
    #[arg(
        long,
        value_name = "TRUTH.fits",
        requires = "detector",
        hide_short_help = true
    )]
    truth: Option<PathBuf>,
    /// Do not write the noise-free image
    #[arg(long, requires = "detector", conflicts_with = "truth", hide_short_help = true)]
    no_truth: bool,
    /// Also write flags of each pixel: sums of 1 dead, 2 hot, 4 bad column, 8 saturated
    #[arg(
        long,
        value_name = "QUALITY.fits",
        requires = "detector",
        hide_short_help = true
    )]
    quality: Option<PathBuf>,
}

/// A detector and its output files.
pub(super) struct Exposing {
    detector: Detector,
    files: ExposureFiles,
    seed: u64,
}

impl ExposureArgs {
    /// The file of the noise-free image, if one is written. By default it is next to `output`.
    pub(crate) fn truth(&self, output: &Path) -> Option<PathBuf> {
        if self.detector.is_none() || self.no_truth {
            return None;
        }
        Some(self.truth.clone().unwrap_or_else(|| {
            let stem = output.file_stem().unwrap_or_default().to_string_lossy();
            output.with_file_name(format!("{stem}_truth.fits"))
        }))
    }

    /// Returns the detector to apply, if any. Checks all that can be checked before the work.
    pub(super) fn exposing(
        &self,
        output: &Path,
        overwrite: bool,
        seed: u64,
        inputs: &[Option<&PathBuf>],
        context: &Context,
    ) -> anyhow::Result<Option<Exposing>> {
        let files = ExposureFiles {
            raw: output.to_owned(),
            truth: self.truth(output),
            quality: self.quality.clone(),
            overwrite,
        };
        let inputs = inputs.iter().copied().chain([self.detector.as_ref()]);
        let inputs: Vec<&Path> = inputs.flatten().map(PathBuf::as_path).collect();
        files.check(&inputs)?;
        let Some(path) = &self.detector else {
            return Ok(None);
        };
        let detector = Detector::from_toml_file(path)?;
        check_detector(&detector, true, context)?;
        Ok(Some(Exposing {
            detector,
            files,
            seed,
        }))
    }
}

impl Exposing {
    /// Exposes an image and writes all files.
    pub(super) fn write<T: Real>(
        &self,
        image: &Image<T>,
        header: &HeaderCards,
        cards: &[Card],
    ) -> anyhow::Result<ExposureReport> {
        let exposure = self.detector.expose(image, self.seed)?;
        self.files
            .write(&exposure, image, &self.detector, header, cards)?;
        Ok(exposure.report().clone())
    }
}
