//! The detector of `psfield simulate`.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use conv_core::{ConvReal, PhotonReport};
use detector::{Detector, DetectorParams, ExposureReport};
use ndarray::{Array2, ArrayView2};
use psf_io::{Card, HeaderCards, IoError};
use psf_types::{Image, Progress, Real};
use psfield::exposure_files::ExposureFiles;
use psfield::{PsfieldError, Scene, ShootBelow, Simulator};

use super::super::context::Context;
use super::super::expose::check_detector;
use super::super::files::{OutputFile, beside};
use super::super::values::shoot_below;

/// A detector that exposes the image.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Detector")]
pub(super) struct ExposureArgs {
    /// Write detector counts instead of flux, and the noise-free image as IMAGE_truth.fits
    ///
    /// The file sets sky, photon noise, dark current, read noise, gain, digitisation and more:
    /// psfield expose --help lists its keys. --seed is the seed of the noise. --no-truth leaves the
    /// noise-free image out.
    #[arg(long, value_name = "DETECTOR.toml")]
    pub(super) detector: Option<PathBuf>,
    /// Draw sources of fewer than N expected photons photon by photon
    ///
    /// Such a source takes 15 to 150 ns for each photon, most with sharp PSFs. Its photons are Poisson distributed, as
    /// those of light in the image, so the statistics of the counts do not change. auto: the sources for which
    /// it is predicted to be faster. Needs a detector with photon noise. --spot-check leaves these sources out.
    /// The noise-free image is then written only with --truth, because it costs the time that was saved.
    #[arg(long, value_name = "N|auto", requires = "detector", value_parser = shoot_below)]
    pub(super) shoot_below: Option<ShootBelow>,
    /// Noise-free image to write with --detector [default: IMAGE_truth.fits next to the image]
    ///
    /// This image has the unit of the detector's counts. It includes sky, dark charge and bias.
    #[arg(
        long,
        value_name = "TRUTH.fits",
        requires = "detector",
        hide_short_help = true
    )]
    truth: Option<OutputFile>,
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
    quality: Option<OutputFile>,
}

/// The light of a scene that is drawn, and its sources that are drawn photon by photon.
type Split<'a, T> = (Scene<'a, T>, Scene<'a, T>);

/// A detector and its output files.
pub(super) struct Exposing {
    detector: Detector,
    shoot_below: Option<ShootBelow>,
    pub(super) files: ExposureFiles,
    seed: u64,
}

impl ExposureArgs {
    /// The default name of the noise-free image, next to `output`. `None` if a name is given or no
    /// such image is written.
    pub(super) fn default_truth(&self, output: &OutputFile) -> Option<PathBuf> {
        let wanted =
            self.detector.is_some() && !self.no_truth && self.truth.is_none() && self.shoot_below.is_none();
        wanted.then(|| output.beside("truth"))
    }

    /// The files that are written besides `output`.
    pub(super) fn outputs(&self, output: &OutputFile) -> impl Iterator<Item = PathBuf> {
        let named = [&self.truth, &self.quality].map(|file| file.as_deref().cloned());
        named.into_iter().flatten().chain(self.default_truth(output))
    }

    /// Returns the detector to apply, if any. Checks all that can be checked before the work.
    pub(super) fn exposing(
        &self,
        output: &OutputFile,
        overwrite: bool,
        seed: u64,
        context: &Context,
    ) -> anyhow::Result<Option<Exposing>> {
        let files = ExposureFiles {
            raw: output.to_path_buf(),
            truth: self.truth.as_deref().cloned().or(self.default_truth(output)),
            quality: self.quality.as_deref().cloned(),
            overwrite,
        };
        let Some(path) = &self.detector else {
            return Ok(None);
        };
        let detector = Detector::from_toml_file(path)?;
        check_detector(&detector, Some(path), true, context)?;
        anyhow::ensure!(
            self.shoot_below.is_none() || detector.params().photon_noise,
            "{}: --shoot-below draws photons, so the detector needs photon_noise = true",
            path.display()
        );
        Ok(Some(Exposing {
            detector,
            shoot_below: self.shoot_below,
            files,
            seed,
        }))
    }
}

/// The noise of a dark pixel of a detector. The exposure time is that of a series, if it is given.
pub(super) fn noise_of(path: &Path, exposure_s: Option<f64>) -> anyhow::Result<f64> {
    let params = DetectorParams::from_toml_file(path)?;
    let exposure_s = exposure_s.or(params.exposure_s);
    Ok(Detector::new(DetectorParams { exposure_s, ..params })?.noise())
}

impl Exposing {
    /// The noise of a dark pixel, if there is noise.
    pub(super) fn noise(&self) -> Option<f64> {
        let noise = self.detector.noise();
        (noise > 0.0).then_some(noise)
    }

    /// The detector for one frame of a series, with the exposure time of the series.
    pub(super) fn for_frame(
        &self,
        raw: PathBuf,
        (seed, exposure_s): (u64, f64),
        overwrite: bool,
    ) -> anyhow::Result<Self> {
        let params = self.detector.params();
        if let Some(other) = params.exposure_s.filter(|&other| other != exposure_s) {
            anyhow::bail!(
                "the detector file states an exposure time of {other} s, but the exposures of the series last {exposure_s} s: \
                 remove it from the detector file"
            );
        }
        let params = DetectorParams {
            exposure_s: Some(exposure_s),
            ..params.clone()
        };
        let files = ExposureFiles {
            truth: self.files.truth.is_some().then(|| beside(&raw, "truth")),
            quality: None,
            raw,
            overwrite,
        };
        Ok(Self {
            detector: Detector::new(params)?,
            shoot_below: self.shoot_below,
            files,
            seed,
        })
    }

    /// Divides a scene into the light that is drawn and the sources that are drawn photon by photon. `None` if
    /// all is drawn as light.
    pub(super) fn split<'a, T: ConvReal>(
        &self,
        simulator: &Simulator<T>,
        scene: &Scene<'a, T>,
    ) -> Result<Option<Split<'a, T>>, PsfieldError> {
        let split = |below| simulator.split_faint(scene, below, &self.detector);
        self.shoot_below.map(split).transpose()
    }

    /// Draws the sources of a scene photon by photon.
    pub(super) fn shoot<T: ConvReal>(
        &self,
        simulator: &Simulator<T>,
        faint: &Scene<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(Array2<i32>, PhotonReport), PsfieldError> {
        simulator.shoot(faint, (self.detector.photons_per_flux(), self.seed), progress)
    }

    /// Exposes an image, with photons that were drawn one by one, and writes all files. `truth` makes the image of
    /// all light, if it is to be written. `table` writes a table of the sources, with the flags of the pixels.
    pub(super) fn write<T: Real>(
        &self,
        (image, photons): (&Image<T>, Option<ArrayView2<'_, i32>>),
        truth: impl FnOnce() -> Result<Image<T>, PsfieldError>,
        table: impl FnOnce(ArrayView2<'_, u8>) -> Result<(), IoError>,
        (header, cards): (&HeaderCards, &[Card]),
    ) -> anyhow::Result<ExposureReport> {
        let mut exposer = self.detector.exposer(image.shape(), self.seed)?;
        let mut light = Cow::Borrowed(image);
        if let Some(photons) = photons {
            exposer = exposer.with_photons(photons)?;
            if self.files.truth.is_some() {
                light = Cow::Owned(truth()?);
            }
        }
        let exposure = exposer.expose(image)?;
        psf_io::write_together(|| {
            table(exposure.flags())?;
            self.files.write(&exposure, &light, &self.detector, header, cards)
        })?;
        Ok(exposure.report().clone())
    }
}
