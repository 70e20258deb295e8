//! Makes the frames of a survey.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use conv_core::ConvReal;
use detector::Detector;
use psf_io::{Card, Catalog, CatalogOptions, FileKind, OutputLock, SkyCatalog, SkyCoordinates};
use psf_optics::Telescope;
use psf_sample::SamplingOptions;
use psf_types::{NoProgress, Progress};
use serde::Serialize;

use super::file::{Precision, ShootBelowEntry, refused};
use super::frames::{Survey, SurveyFrame};
use super::galaxy_reach::Reaches;
use crate::colours::open_bandpass;
use crate::error::PsfieldError;
use crate::exposure_files::ExposureFiles;
use crate::fit::FitOptions;
use crate::image_cards::{JOB_KEYWORD, PSF_FILE_KEYWORD, check_made_by, provenance_cards};
use crate::psf::{FitChoices, Psf, PsfFileOptions};
use crate::scene_light::SceneLight;
use crate::simulator::{ExposeOptions, ShootBelow, Simulator};
use crate::truth_table::TruthTable;

/// Makes frames of a survey one after the other, and keeps the catalogue, the PSF and the plan of the last one for the
/// next.
///
/// Galaxies are found as far from a frame as a hundredth of the tolerance of their flux reaches. What a frame shows does
/// not depend on the frames before it.
#[derive(Debug)]
pub struct Observer {
    survey: Arc<Survey>,
    /// The catalogue with the magnitudes of a column.
    catalog: Option<(Option<String>, bool, SkyCatalog)>,
    psf: Option<(PathBuf, Psf)>,
    /// The simulator, and all on which it depends.
    simulator: Option<(String, Box<dyn Any + Send>)>,
}

/// The result of a frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FrameReport {
    /// The exposure.
    pub exposure: String,
    /// The detector.
    pub detector: String,
    /// The file of the frame.
    pub output: PathBuf,
    /// Whether it was made.
    pub status: FrameStatus,
    /// Of a skipped frame: `exists`, or `in progress` if another process works on it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<&'static str>,
    /// The cause of a failure.
    pub error: Option<String>,
    /// Warnings about the frame.
    pub warnings: Vec<String>,
    /// The stars and galaxies whose light may reach the frame.
    pub sources: usize,
    /// The sources on its pixels.
    pub in_frame: usize,
    /// Rows near the frame that are no sources, and were skipped.
    pub invalid_rows: usize,
    /// Whether model and plan were made for an earlier frame.
    pub reused: bool,
    /// The time that it took.
    pub seconds: f64,
}

/// Whether a frame was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum FrameStatus {
    /// It was made.
    Done,
    /// It exists already, or another process makes it.
    Skipped,
    /// It could not be made.
    Failed,
}

/// The message after a panic.
const PANIC: &str = "this frame met an error in psfield, which standard error shows: please report it";
/// A galaxy is found up to a distance beyond which this part of the tolerance of its flux lies.
const LEFT_OUT: f64 = 1e-2;
/// The least fraction of the flux that is left out.
const LEAST_LEFT_OUT: f64 = 1e-6;

impl Observer {
    /// Observes a survey. Its catalogue is read when the first frame needs it.
    pub fn new(survey: Arc<Survey>) -> Self {
        Self {
            survey,
            catalog: None,
            psf: None,
            simulator: None,
        }
    }

    /// The survey.
    pub fn survey(&self) -> &Survey {
        &self.survey
    }

    /// Makes a frame and its files, unless they exist. `number` counts [`Survey::frames`]. An error, also a panic, is that
    /// of this frame alone, and stands in the report.
    pub fn observe(&mut self, number: usize, overwrite: bool, progress: &dyn Progress) -> FrameReport {
        let clock = Instant::now();
        let survey = Arc::clone(&self.survey);
        let frame = &survey.frames()[number];
        let mut report = FrameReport {
            exposure: frame.exposure.clone(),
            detector: survey.name_of(frame).to_owned(),
            output: frame.output.clone(),
            status: FrameStatus::Failed,
            reason: None,
            error: None,
            warnings: Vec::new(),
            sources: 0,
            in_frame: 0,
            invalid_rows: 0,
            reused: false,
            seconds: 0.0,
        };
        let made = catch_unwind(AssertUnwindSafe(|| {
            self.observe_into(frame, overwrite, progress, &mut report)
        }));
        report.error = if let Ok(made) = made {
            made.err().map(|error| crate::error::error_text(&error))
        } else {
            // Parts that were left half made are not used again.
            *self = Self::new(Arc::clone(&survey));
            report.status = FrameStatus::Failed;
            Some(PANIC.to_owned())
        };
        report.seconds = clock.elapsed().as_secs_f64();
        report
    }

    fn observe_into(
        &mut self,
        frame: &SurveyFrame,
        overwrite: bool,
        progress: &dyn Progress,
        report: &mut FrameReport,
    ) -> Result<(), PsfieldError> {
        let survey = Arc::clone(&self.survey);
        let skipped = |report: &mut FrameReport, reason| {
            (report.status, report.reason) = (FrameStatus::Skipped, Some(reason));
        };
        if !overwrite && survey.is_done(frame)? {
            skipped(report, "exists");
            return Ok(());
        }
        let files = frame.files(&survey);
        for file in &files {
            if let Some(folder) = file.parent().filter(|folder| !folder.as_os_str().is_empty()) {
                std::fs::create_dir_all(folder).map_err(|error| {
                    refused(format!("cannot make the folder {}", folder.display())).because(error)
                })?;
            }
            psf_io::check_output(file, true)?;
        }
        let Some(_lock) = OutputLock::acquire(frame.image(&survey))? else {
            skipped(report, "in progress");
            return Ok(());
        };
        // Another process may have made it while this one waited.
        if !overwrite && survey.is_done(frame)? {
            skipped(report, "exists");
            return Ok(());
        }
        match survey.file.precision {
            Precision::F32 => self.make::<f32>(frame, progress, report),
            Precision::F64 => self.make::<f64>(frame, progress, report),
        }?;
        if frame.is_extension && frame.output.exists() {
            // A joined file that is to be made again must not look finished. One that is valid holds the frame
            // already: only another file of the frame was missing.
            let spare = if overwrite {
                frame.output.clone()
            } else {
                frame.image(&survey)
            };
            std::fs::remove_file(&spare)
                .map_err(|error| refused(format!("cannot remove {}", spare.display())).because(error))?;
        }
        report.status = FrameStatus::Done;
        Ok(())
    }

    fn make<T: ConvReal>(
        &mut self,
        frame: &SurveyFrame,
        progress: &dyn Progress,
        report: &mut FrameReport,
    ) -> Result<(), PsfieldError> {
        let survey = Arc::clone(&self.survey);
        let psf = self.psf_of(frame)?;
        let header = survey.header(frame)?;
        let sky = SkyCoordinates::from_header(&header).map_err(|error| refused(error.to_string()))?;
        let detector = survey.detector_of(frame)?;

        let catalog = self.catalog_near(frame, &sky, &psf, &mut report.warnings)?;
        report.sources = catalog.rows().len();
        report.invalid_rows = catalog.invalid_rows();
        report.warnings.extend(catalog.ignored_warning());
        if report.sources == 0 {
            report
                .warnings
                .push("no source of the catalogue reaches this frame".to_owned());
        }
        let light = survey.light_of::<T>(frame, catalog)?;
        let (simulator, reused) = self.simulator_of::<T>(frame, &psf, &light)?;
        report.reused = reused;
        let table = TruthTable::new(light.catalog(), simulator.shown_region(), Some(&sky));
        report.in_frame = table.count_in_frame();
        let scene = light.into_scene()?;
        let made = simulator.prepare(&scene, progress)?;
        let noise = detector
            .as_ref()
            .map(Detector::noise)
            .filter(|noise| *noise > 0.0);
        let warnings = simulator.warnings(&scene, noise);
        report.warnings.extend(warnings.iter().map(ToString::to_string));

        let mut cards = provenance_cards(&format!(
            "psfield observe: exposure {}, detector {}",
            frame.exposure,
            survey.name_of(frame)
        ));
        cards.push(Card::new(
            JOB_KEYWORD,
            survey.digest(frame),
            "digest of the options of the frame",
        )?);
        let psf_name = frame.psf.file_name().unwrap_or_default().to_string_lossy();
        cards.push(Card::new(PSF_FILE_KEYWORD, psf_name.as_ref(), "file of the PSF")?);
        cards.extend(simulator.cards(&made)?);
        cards.extend(simulator.dropped_cards(simulator.dropped_light(&scene)?.as_ref())?);
        let image = frame.image(&survey);
        let Some(detector) = detector else {
            let light = simulator.simulate(&scene)?;
            return psf_io::write_together(|| {
                if let Some(path) = &frame.truth_table {
                    table.write(path, &cards, true)?;
                }
                Ok(psf_io::write_image(&image, &light, &header, &cards, true)?)
            });
        };
        let options = ExposeOptions {
            detector: &detector,
            seed: frame.seed,
            shoot_below: survey.shoot_below()?,
            bad_pixels: None,
        };
        let exposure = simulator.expose(&scene, options, progress)?;
        let light = match &frame.noise_free {
            Some(_) => simulator.simulate(&scene)?,
            None => psf_types::Image::zeros(simulator.image_shape()),
        };
        let files = ExposureFiles {
            raw: image,
            truth: frame.noise_free.clone(),
            quality: frame.quality.clone(),
            overwrite: true,
        };
        psf_io::write_together(|| {
            if let Some(path) = &frame.truth_table {
                table.with_flags(exposure.flags()).write(path, &cards, true)?;
            }
            files.write(&exposure, &light, &detector, &header, &cards)
        })
    }

    /// The PSF of a frame: kept from the frame before, or read.
    fn psf_of(&mut self, frame: &SurveyFrame) -> Result<Psf, PsfieldError> {
        let psf = match &self.psf {
            Some((path, psf)) if *path == frame.psf => psf.clone(),
            _ => opened(&frame.psf, &self.survey.file.fit)?,
        };
        let entry = &self.survey.detectors()[frame.detector].entry;
        // The field of a PSFEx model is a guess from its stars.
        if let Some(field) = psf.field_shape().filter(|_| psf.kind() != Some(FileKind::Psfex))
            && [field.nx(), field.ny()] != entry.shape
        {
            let [nx, ny] = entry.shape;
            return Err(refused(format!(
                "{}: this PSF is for frames of {field} pixels, but the detector {} has {nx} x {ny}",
                frame.psf.display(),
                entry.name
            )));
        }
        self.psf = Some((frame.psf.clone(), psf.clone()));
        Ok(psf)
    }

    /// The sources whose light may reach a frame, with the flux of its exposure.
    fn catalog_near(
        &mut self,
        frame: &SurveyFrame,
        sky: &SkyCoordinates,
        psf: &Psf,
        warnings: &mut Vec<String>,
    ) -> Result<Catalog, PsfieldError> {
        let survey = Arc::clone(&self.survey);
        let (file, band) = (&survey.file, survey.band(frame));
        let mut columns = file.columns.clone();
        if let Some(mag) = band.and_then(|band| band.mag.as_ref()) {
            let mag = format!("mag={mag}");
            columns = Some(columns.map_or(mag.clone(), |others| format!("{others},{mag}")));
        }
        let in_colour = band.is_some_and(|band| band.bandpass.is_some());
        let mut options = CatalogOptions::new()
            .with_invalid_skipped(file.skip_invalid)
            .with_colours(in_colour);
        if let Some(epoch) = file.epoch {
            options = options.with_epoch(epoch);
        }
        if let Some(columns) = &columns {
            options = options.with_columns(columns.parse()?);
        }
        if let Some(table) = &file.table {
            options = options.with_table(table.parse()?);
        }
        let is_kept =
            |(of, colours, _): &(Option<String>, bool, SkyCatalog)| (of, *colours) == (&columns, in_colour);
        if !self.catalog.as_ref().is_some_and(is_kept) {
            // The one before need not be in memory, too.
            self.catalog = None;
            let options = options.clone();
            let reach = Reaches::new((LEFT_OUT * file.simulate.tolerance).max(LEAST_LEFT_OUT))?;
            let all = match (&file.catalog, &survey.table) {
                (Some(path), _) => SkyCatalog::read(path, options, |n| reach.of(n))?,
                (None, Some((table, _))) => SkyCatalog::of_table(table, options, |n| reach.of(n))?,
                (None, None) => unreachable!("surveys have a catalogue"),
            };
            self.catalog = Some((columns, in_colour, all));
        }
        let (_, _, all) = self.catalog.as_ref().expect("it is kept now");
        let mut of_frame = options.with_sky(sky.clone());
        if let Some(date) = frame.observation_date()? {
            of_frame = of_frame.with_date(date);
        }
        let of_band = |problem: String| match &frame.band {
            Some(band) => refused(format!("band {band}: {problem}")),
            None => refused(problem),
        };
        let by_magnitude = all.roles().contains(&"mag");
        match band.and_then(|band| band.zero_point) {
            Some(zero_point) if by_magnitude => of_frame = of_frame.with_zero_point(zero_point)?,
            None if by_magnitude => {
                return Err(of_band(
                    "the catalogue holds magnitudes: give the band a zero_point, the magnitude of flux 1 per second".to_owned(),
                ));
            }
            _ => {}
        }
        let margin = psf.reach(file.simulate.stamp_size) as f64 + 2.0;
        let footprint = survey.footprint_on(sky, frame, margin)?;
        let near = all.within(&of_frame, footprint.centre_deg, footprint.radius_deg)?;
        let moves = ["pmra", "parallax"].iter().any(|role| all.roles().contains(role));
        if moves && frame.date.is_none() {
            const STILL: &str =
                "the pointing has no date, so the sources stay where they are at the epoch of the catalogue";
            warnings.push(STILL.to_owned());
        }
        Ok(match frame.exposure_s {
            Some(seconds) => near.with_flux_times(seconds)?,
            None => near,
        })
    }

    /// The simulator for a frame's light: kept from the frame before, or made. Returns whether it was kept.
    fn simulator_of<T: ConvReal>(
        &mut self,
        frame: &SurveyFrame,
        psf: &Psf,
        light: &SceneLight<T>,
    ) -> Result<(Arc<Simulator<T>>, bool), PsfieldError> {
        let survey = Arc::clone(&self.survey);
        let [nx, ny] = survey.detectors()[frame.detector].entry.shape;
        let band = survey.band(frame);
        let bandpass = band.and_then(|band| band.bandpass.as_ref());
        let key = format!("{:?}", (&frame.psf, nx, ny, bandpass, light.spectra()));
        if let Some((of, kept)) = &self.simulator
            && *of == key
            && let Some(simulator) = kept.downcast_ref::<Arc<Simulator<T>>>()
        {
            return Ok((Arc::clone(simulator), true));
        }
        let psf = match bandpass {
            Some(bandpass) if !light.spectra().is_empty() => {
                light.psf_of(psf, &open_bandpass(bandpass)?, None)?
            }
            _ => psf.clone(),
        };
        let made = psf
            .simulator((ny, nx))
            .options(survey.file.simulate.clone())
            .build::<T>()?;
        let simulator = Arc::new(made);
        self.simulator = Some((key, Box::new(Arc::clone(&simulator))));
        Ok((simulator, false))
    }
}

/// Opens a PSF file, or samples the PSF of the telescope that a TOML file describes.
fn opened(path: &Path, fit: &FitChoices) -> Result<Psf, PsfieldError> {
    if path.extension().is_none_or(|ending| ending != "toml") {
        return Psf::open_with(path, &PsfFileOptions::default(), fit);
    }
    let telescope = Telescope::from_toml_file(path)?;
    let method = SamplingOptions::default().method()?;
    let (psf, _) = Psf::from_source(&telescope, &*method, fit.or(FitOptions::default()), &NoProgress)?;
    Ok(psf)
}

impl SurveyFrame {
    /// All files that are written for the frame itself.
    fn files(&self, survey: &Survey) -> Vec<PathBuf> {
        let others = [&self.truth_table, &self.noise_free, &self.quality]
            .into_iter()
            .flatten()
            .cloned();
        std::iter::once(self.image(survey)).chain(others).collect()
    }
}

impl Survey {
    /// Returns whether the files of a frame exist.
    ///
    /// # Errors
    /// [`ErrorKind::Data`](crate::ErrorKind::Data) for a file that this frame did not make.
    fn is_done(&self, frame: &SurveyFrame) -> Result<bool, PsfieldError> {
        let exists = |path: &Path| path.symlink_metadata().is_ok();
        let check = |path: &Path, digest: &str| check_made_by(path, digest).map_err(refused);
        let joined = frame.is_extension && exists(&frame.output);
        if joined {
            check(
                &frame.output,
                &self.digest_of_exposure(&self.frames_of(&frame.exposure)),
            )?;
        }
        let digest = self.digest(frame);
        let mut done = true;
        for (number, file) in frame.files(self).iter().enumerate() {
            if exists(file) {
                check(file, &digest)?;
            } else if number > 0 || !joined {
                done = false;
            }
        }
        Ok(done)
    }

    /// The sources that are drawn photon by photon.
    fn shoot_below(&self) -> Result<Option<ShootBelow>, PsfieldError> {
        match &self.file.shoot_below {
            None => Ok(None),
            Some(ShootBelowEntry::Photons(photons)) if photons.is_finite() && *photons > 0.0 => {
                Ok(Some(ShootBelow::Photons(*photons)))
            }
            Some(ShootBelowEntry::Name(name)) if name == "auto" => Ok(Some(ShootBelow::Auto)),
            Some(_) => Err(PsfieldError::of_setting(
                "shoot_below",
                "shoot_below must be a number above 0, or \"auto\"",
            )),
        }
    }

    /// The light of a frame's sources.
    fn light_of<T: ConvReal>(
        &self,
        frame: &SurveyFrame,
        catalog: Catalog,
    ) -> Result<SceneLight<T>, PsfieldError> {
        let mut light = SceneLight::new();
        let band = self.band(frame);
        if band.is_none_or(|band| band.bandpass.is_none()) {
            light.set_catalog(catalog);
            return Ok(light);
        }
        let folder = self
            .file
            .catalog
            .as_deref()
            .and_then(Path::parent)
            .unwrap_or(Path::new(""));
        let default = band.and_then(|band| band.sed.as_deref());
        light.set_catalog_with_spectra(catalog, default, folder)?;
        light.sort_spectra();
        Ok(light)
    }
}
