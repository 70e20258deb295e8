//! The frames of a survey: which detector looks where, when, and in which files its frame is written.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

use psf_io::{MemoryTable, ObservationDate, SkyPointing};

use super::camera::CameraDetector;
use super::file::{BandEntry, PointingEntry, SurveyFile, refused};
use crate::error::PsfieldError;

/// A checked survey and its frames.
///
/// ```
/// use psfield::survey::{Survey, SurveyFile};
/// let file = r#"{
///     "catalog": "sky.csv", "output": "{exposure}_{detector}.fits",
///     "detector": [{"name": "N", "shape": [100, 80], "psf": "psf.fits", "geometry": {"pixel_scale_arcsec": 0.5}}],
///     "pointing": [{"ra": 150.0, "dec": 2.0, "dithers_arcsec": [[0, 0], [10, 0]]}]
/// }"#;
/// let survey = Survey::new(SurveyFile::from_json(file, "night".as_ref())?)?;
/// let names: Vec<String> = survey.frames().iter().map(|frame| frame.output.display().to_string()).collect();
/// assert_eq!(names, ["night/001-1_N.fits", "night/001-2_N.fits"]);
/// # Ok::<(), psfield::PsfieldError>(())
/// ```
#[derive(Debug)]
pub struct Survey {
    pub(super) file: SurveyFile,
    /// A catalogue in memory, in place of its file, with a digest of its content.
    pub(super) table: Option<(MemoryTable, u64)>,
    detectors: Vec<CameraDetector>,
    frames: Vec<SurveyFrame>,
}

/// A frame: an exposure of one detector.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SurveyFrame {
    /// The name of the exposure.
    pub exposure: String,
    /// The number of the detector in the camera, counted from 0.
    pub detector: usize,
    /// Where the boresight points.
    pub pointing: SkyPointing,
    /// The name of the band.
    pub band: Option<String>,
    /// The date, as it was given.
    pub date: Option<String>,
    /// The exposure time in seconds.
    pub exposure_s: Option<f64>,
    /// The seed of the noise.
    pub seed: u64,
    /// The file of the frame.
    pub output: PathBuf,
    /// Whether the frame is an extension of that file, with the name of the detector.
    pub is_extension: bool,
    /// The table of its sources.
    pub truth_table: Option<PathBuf>,
    /// The noise-free image.
    pub noise_free: Option<PathBuf>,
    /// The flags of its pixels.
    pub quality: Option<PathBuf>,
    /// The PSF.
    pub psf: PathBuf,
}

impl SurveyFrame {
    /// The file to which the frame itself is written: its output, or for an extension a file that is joined with
    /// those of the other detectors when all of them exist.
    pub fn image(&self, survey: &Survey) -> PathBuf {
        if !self.is_extension {
            return self.output.clone();
        }
        parts_of(&self.output).join(format!("{}.fits", survey.name_of(self)))
    }
}

/// The folder of the images that become extensions of a file.
pub(super) fn parts_of(output: &Path) -> PathBuf {
    let mut name = output.as_os_str().to_owned();
    name.push(".parts");
    name.into()
}

impl Survey {
    /// Checks a survey, and lists its frames: those of equal PSFs and detectors follow each other, so that they can
    /// share plans.
    ///
    /// # Errors
    /// [`ErrorKind::Data`](crate::ErrorKind::Data) that names the detector, the pointing, the band or the file:
    /// for a detector or an exposure that appears twice, for files that would be written twice or are also read,
    /// for a band that does not exist, and for a value out of range.
    pub fn new(file: SurveyFile) -> Result<Self, PsfieldError> {
        Self::with_table(file, None)
    }

    /// Works like [`new`](Self::new), with a catalogue in memory in place of its file.
    ///
    /// # Errors
    /// The errors of [`new`](Self::new), also for two catalogues or none.
    pub fn with_table(file: SurveyFile, table: Option<MemoryTable>) -> Result<Self, PsfieldError> {
        match (&file.catalog, &table) {
            (None, None) => return Err(refused("catalog: a survey needs a catalogue of the sky")),
            (Some(_), Some(_)) => return Err(refused("catalog: give a file or a table, not both")),
            _ => {}
        }
        if file.detector.is_empty() || file.pointing.is_empty() {
            return Err(refused(
                "a survey needs at least one [[detector]] and one [[pointing]]",
            ));
        }
        if file.simulate.frame.is_some() || file.simulate.region.is_some() || file.simulate.oversample != 1 {
            return Err(refused(
                "[simulate]: frame, region and oversample cannot be set: frames have the shape of their detectors",
            ));
        }
        let mut names = HashSet::new();
        for detector in &file.detector {
            check_name("a detector", &detector.name)?;
            if !names.insert(detector.name.as_str()) {
                return Err(refused(format!(
                    "the detector {} appears twice: give each its own name",
                    detector.name
                )));
            }
        }
        for (key, name) in [("noise_free", &file.noise_free), ("quality", &file.quality)] {
            let plain = file.detector.iter().find(|detector| detector.settings.is_none());
            if let (Some(_), Some(detector)) = (name, plain) {
                let name = &detector.name;
                return Err(refused(format!(
                    "{key} needs settings for each detector, but the detector {name} has none"
                )));
            }
        }
        let detectors = file.detector.iter().cloned().map(CameraDetector::new);
        let detectors: Vec<_> = detectors.collect::<Result<_, _>>()?;
        let mut survey = Self {
            file,
            table: table.map(|table| {
                let digest = table.digest();
                (table, digest)
            }),
            detectors,
            frames: Vec::new(),
        };
        survey.frames = survey.listed()?;
        survey.check_files()?;
        Ok(survey)
    }

    /// The frames.
    pub fn frames(&self) -> &[SurveyFrame] {
        &self.frames
    }

    /// The description.
    pub fn file(&self) -> &SurveyFile {
        &self.file
    }

    /// The camera.
    pub fn detectors(&self) -> &[CameraDetector] {
        &self.detectors
    }

    /// The name of a frame's detector.
    pub(super) fn name_of(&self, frame: &SurveyFrame) -> &str {
        &self.detectors[frame.detector].entry.name
    }

    /// The band of a frame.
    pub(super) fn band(&self, frame: &SurveyFrame) -> Option<&BandEntry> {
        self.file.band.get(frame.band.as_ref()?)
    }

    fn listed(&self) -> Result<Vec<SurveyFrame>, PsfieldError> {
        let mut frames = Vec::new();
        let mut exposures = HashSet::new();
        for (number, pointing) in self.file.pointing.iter().enumerate() {
            let name = pointing
                .name
                .clone()
                .unwrap_or_else(|| format!("{:03}", number + 1));
            let of_pointing =
                |problem: String| refused(format!("pointing {} ({name}): {problem}", number + 1));
            check_pointing(pointing).map_err(of_pointing)?;
            if let Some(band) = &pointing.band
                && !self.file.band.is_empty()
                && !self.file.band.contains_key(band)
            {
                let known: Vec<&str> = self.file.band.keys().map(String::as_str).collect();
                let problem = format!("the band {band:?} is not among the bands {}", known.join(", "));
                return Err(of_pointing(problem));
            }
            let dithers = pointing.dithers_arcsec.clone().unwrap_or_else(|| vec![[0.0; 2]]);
            for (dither, &[east, north]) in dithers.iter().enumerate() {
                let exposure = match dithers.len() {
                    1 => name.clone(),
                    _ => format!("{name}-{}", dither + 1),
                };
                check_name("an exposure", &exposure)?;
                if !exposures.insert(exposure.clone()) {
                    return Err(of_pointing(format!(
                        "the exposure {exposure} appears twice: give each its own name"
                    )));
                }
                let boresight = SkyPointing {
                    ra_deg: pointing.ra,
                    dec_deg: pointing.dec,
                    rotation_deg: pointing.rotation_deg.unwrap_or(0.0),
                };
                for detector in 0..self.detectors.len() {
                    let seed = self.file.seed.wrapping_add(frames.len() as u64);
                    frames.push(self.frame(
                        (&exposure, detector),
                        pointing,
                        (boresight.moved_by_arcsec((east, north)), seed),
                    )?);
                }
            }
        }
        // Frames of equal plans come one after the other.
        frames.sort_by(|a, b| (&a.psf, a.detector, &a.band).cmp(&(&b.psf, b.detector, &b.band)));
        Ok(frames)
    }

    fn frame(
        &self,
        (exposure, detector): (&str, usize),
        pointing: &PointingEntry,
        (boresight, seed): (SkyPointing, u64),
    ) -> Result<SurveyFrame, PsfieldError> {
        let name = &self.detectors[detector].entry.name;
        let band = pointing.band.as_deref();
        let filled = |key: &str, template: &str| {
            let parts = [
                ("{exposure}", Some(exposure)),
                ("{detector}", Some(name.as_str())),
                ("{band}", band),
            ];
            let mut text = template.to_owned();
            for (place, value) in parts {
                match value {
                    Some(value) => text = text.replace(place, value),
                    None if text.contains(place) => {
                        return Err(refused(format!(
                            "{key}: {template:?} needs a band, but the exposure {exposure} has none"
                        )));
                    }
                    None => {}
                }
            }
            if text.contains(['{', '}']) {
                return Err(refused(format!(
                    "{key}: {template:?} may have {{exposure}}, {{detector}} and {{band}} between braces, and nothing else"
                )));
            }
            Ok(PathBuf::from(text))
        };
        let file = &self.file;
        let optional = |key: &str, template: &Option<String>| {
            template
                .as_ref()
                .map(|template| filled(key, template))
                .transpose()
        };
        Ok(SurveyFrame {
            exposure: exposure.to_owned(),
            detector,
            pointing: boresight,
            band: pointing.band.clone(),
            date: pointing.date.as_ref().map(super::file::DateEntry::text),
            exposure_s: pointing.exposure_s,
            seed,
            output: filled("output", &file.output)?,
            is_extension: !file.output.contains("{detector}"),
            truth_table: optional("truth_table", &file.truth_table)?,
            noise_free: optional("noise_free", &file.noise_free)?,
            quality: optional("quality", &file.quality)?,
            psf: filled("psf", &self.detectors[detector].entry.psf)?,
        })
    }

    /// The files that the survey reads.
    pub fn inputs(&self) -> impl Iterator<Item = &Path> {
        let inputs = [&self.file.catalog, &self.file.camera, &self.file.pointings]
            .into_iter()
            .flatten();
        let of_detectors = self
            .detectors
            .iter()
            .flat_map(|d| [&d.entry.wcs, &d.entry.settings])
            .flatten();
        let psfs = self.frames.iter().map(|frame| &frame.psf);
        inputs.chain(of_detectors).chain(psfs).map(PathBuf::as_path)
    }

    /// The files that the survey writes.
    pub fn outputs(&self) -> impl Iterator<Item = &Path> {
        let of_frames = self.frames.iter().flat_map(|frame| {
            [
                Some(&frame.output),
                frame.truth_table.as_ref(),
                frame.noise_free.as_ref(),
                frame.quality.as_ref(),
            ]
        });
        of_frames.flatten().chain(&self.file.frames).map(PathBuf::as_path)
    }

    /// Returns an error for a file that would be written twice or is also read.
    fn check_files(&self) -> Result<(), PsfieldError> {
        let mut uses: BTreeMap<PathBuf, String> = BTreeMap::new();
        let place = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let file = &self.file;
        for path in self.inputs() {
            uses.insert(place(path), "an input of the survey".to_owned());
        }
        let mut write = |path: &Path, whose: String| match uses.insert(place(path), whose.clone()) {
            Some(other) if other != whose => Err(refused(format!(
                "{} would be {whose} and {other}: put {{exposure}} and {{detector}} in the names of files",
                path.display()
            ))),
            _ => Ok(()),
        };
        if let Some(path) = &file.frames {
            write(path, "the list of frames".to_owned())?;
        }
        for frame in &self.frames {
            let detector = self.name_of(frame);
            let whose = |what: &str| format!("{what} of exposure {}, detector {detector}", frame.exposure);
            if frame.is_extension {
                write(&frame.output, format!("the file of exposure {}", frame.exposure))?;
            } else {
                write(&frame.output, whose("the frame"))?;
            }
            let others = [
                (&frame.truth_table, "the table"),
                (&frame.noise_free, "the noise-free image"),
                (&frame.quality, "the flags"),
            ];
            for (path, what) in others {
                if let Some(path) = path {
                    write(path, whose(what))?;
                }
            }
        }
        Ok(())
    }
}

fn check_name(what: &str, name: &str) -> Result<(), PsfieldError> {
    let is_valid = !name.is_empty() && !name.contains(['/', '\\', '{', '}']) && !name.starts_with('.');
    is_valid.then_some(()).ok_or_else(|| {
        refused(format!(
            "{what} is called {name:?}: its name stands in names of files, so it cannot be empty, begin with a dot or \
             hold slashes or braces"
        ))
    })
}

fn check_pointing(pointing: &PointingEntry) -> Result<(), String> {
    let finite = [("ra", Some(pointing.ra)), ("rotation_deg", pointing.rotation_deg)];
    for (key, value) in finite {
        if let Some(value) = value.filter(|value| !value.is_finite()) {
            return Err(format!("{key} must be a finite number, got {value}"));
        }
    }
    if !(-90.0..=90.0).contains(&pointing.dec) {
        return Err(format!("dec must be -90 to 90 degrees, got {}", pointing.dec));
    }
    if let Some(seconds) = pointing
        .exposure_s
        .filter(|seconds| !(*seconds > 0.0 && seconds.is_finite()))
    {
        return Err(format!("exposure_s must be above 0, got {seconds}"));
    }
    if pointing.dithers_arcsec.as_ref().is_some_and(Vec::is_empty) {
        return Err("dithers_arcsec has no offset: leave it out, or give one".to_owned());
    }
    if let Some(date) = &pointing.date {
        date.text()
            .parse::<ObservationDate>()
            .map_err(|problem| format!("date: {problem}"))?;
    }
    Ok(())
}
