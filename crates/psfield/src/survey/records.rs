//! The records of a survey's frames: their digests, their list, and files that join them.

use std::hash::Hasher;
use std::path::{Path, PathBuf};

use psf_io::{Card, OutputLock};
use serde::Serialize;

use super::file::refused;
use super::frames::{Survey, SurveyFrame, parts_of};
use crate::error::PsfieldError;
use crate::image_cards::{JOB_KEYWORD, check_made_by, provenance_cards};

/// The columns of the list of frames.
const COLUMNS: [&str; 10] = [
    "exposure",
    "detector",
    "file",
    "extension",
    "ra",
    "dec",
    "rotation_deg",
    "date",
    "band",
    "exposure_s",
];

impl Survey {
    /// A digest of all settings on which a frame depends.
    pub(super) fn digest(&self, frame: &SurveyFrame) -> String {
        #[derive(Serialize)]
        struct Settings<'a> {
            file: (&'a Option<String>, &'a Option<String>, Option<f64>, bool),
            catalog: (Option<String>, Option<u64>),
            run: (super::file::Precision, &'a Option<super::file::ShootBelowEntry>),
            simulate: &'a crate::SimulateOptions,
            fit: &'a crate::FitChoices,
            boresight: Option<[f64; 3]>,
            shape: [usize; 2],
            geometry: Option<super::GeometryEntry>,
            cards: (&'a Option<String>, &'a Option<String>),
            names: Vec<String>,
            band: (&'a Option<String>, Option<f64>, Option<&'a String>, Option<f64>),
            pointing: [f64; 3],
            exposure: (&'a str, &'a Option<String>, Option<f64>, u64),
        }
        let (file, detector, band) = (
            &self.file,
            &self.detectors()[frame.detector].entry,
            self.band(frame),
        );
        // Names as the file has them, so that a survey can be moved to another folder.
        let name = |path: &Path| {
            let path = path.strip_prefix(&file.folder).unwrap_or(path);
            path.to_string_lossy().into_owned()
        };
        let used = [
            Some(&frame.psf),
            detector.wcs.as_ref(),
            detector.settings.as_ref(),
        ];
        let colour = band
            .into_iter()
            .flat_map(|band| [&band.bandpass, &band.sed])
            .flatten();
        let settings = Settings {
            file: (&file.columns, &file.table, file.epoch, file.skip_invalid),
            catalog: (
                file.catalog.as_deref().map(name),
                self.table.as_ref().map(|(_, digest)| *digest),
            ),
            run: (file.precision, &file.shoot_below),
            simulate: &file.simulate,
            fit: &file.fit,
            boresight: file.boresight,
            shape: detector.shape,
            geometry: detector.geometry,
            cards: (&detector.cards, &detector.wcs_extension),
            names: used
                .into_iter()
                .flatten()
                .map(|path| name(path))
                .chain(colour.map(|text| name(Path::new(text))))
                .collect(),
            band: (
                &frame.band,
                band.and_then(|b| b.zero_point),
                band.and_then(|b| b.mag.as_ref()),
                band.and_then(|b| b.sky_e_per_s),
            ),
            pointing: [
                frame.pointing.ra_deg,
                frame.pointing.dec_deg,
                frame.pointing.rotation_deg,
            ],
            exposure: (&frame.exposure, &frame.date, frame.exposure_s, frame.seed),
        };
        digest_of([serde_json::to_string(&settings).expect("settings are JSON")])
    }

    /// Writes the list of frames, if the survey names a file for it: a row for each frame. An older list is replaced.
    ///
    /// # Errors
    /// [`ErrorKind::Io`](crate::ErrorKind::Io) for another file of this name, unless `overwrite` is true, and the
    /// errors of [`write_csv`](psf_io::write_csv) and of [`footprint`](Self::footprint).
    pub fn write_list(&self, overwrite: bool) -> Result<(), PsfieldError> {
        let Some(path) = &self.file.frames else {
            return Ok(());
        };
        let is_list = |text: String| text.lines().next() == Some(COLUMNS.join(",").as_str());
        let replace = overwrite || psf_types::read_text_file(path).is_ok_and(is_list);
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut frames: Vec<&SurveyFrame> = self.frames().iter().collect();
        frames.sort_by_key(|frame| frame.seed.wrapping_sub(self.file.seed));
        let row = |frame: &&SurveyFrame| {
            let name = self.name_of(frame);
            let (ra, dec) = self.footprint(frame, 0.0)?.centre_deg;
            let output = frame.output.strip_prefix(folder).unwrap_or(&frame.output);
            Ok::<_, PsfieldError>((
                frame.exposure.clone(),
                name.to_owned(),
                output.display().to_string(),
                frame.is_extension.then(|| name.to_owned()),
                ra,
                dec,
                frame.pointing.rotation_deg,
                frame.date.clone(),
                frame.band.clone(),
                frame.exposure_s,
            ))
        };
        let rows: Vec<_> = frames.iter().map(row).collect::<Result<_, _>>()?;
        Ok(psf_io::write_csv(path, &COLUMNS, rows, replace)?)
    }

    /// Joins the frames of an exposure to one file, if they are extensions of it and all of them exist. Returns
    /// whether the file exists now.
    ///
    /// # Errors
    /// The errors of [`join_images`](psf_io::join_images), and [`ErrorKind::Data`](crate::ErrorKind::Data) for a file of
    /// this name that this survey did not make.
    pub fn join(&self, exposure: &str) -> Result<bool, PsfieldError> {
        let frames = self.frames_of(exposure);
        let Some(first) = frames.first().filter(|frame| frame.is_extension) else {
            return Ok(false);
        };
        // Another process may join them now.
        let Some(_lock) = OutputLock::acquire(&first.output)? else {
            return Ok(false);
        };
        let digest = self.digest_of_exposure(&frames);
        let images: Vec<(&str, PathBuf)> = frames
            .iter()
            .map(|frame| (self.name_of(frame), frame.image(self)))
            .collect();
        if first.output.symlink_metadata().is_ok() {
            check_made_by(&first.output, &digest).map_err(refused)?;
        } else if images.iter().all(|(_, image)| image.exists()) {
            let mut cards = provenance_cards("psfield observe");
            cards.push(Card::new("EXPNAME", exposure, "name of the exposure")?);
            cards.push(Card::new(
                JOB_KEYWORD,
                digest,
                "digest of the options of all frames",
            )?);
            psf_io::join_images(&first.output, &images, &cards, false)?;
        } else {
            return Ok(false);
        }
        // The parts are no longer needed. One that cannot be removed does no harm.
        for (_, image) in &images {
            let _ = std::fs::remove_file(image);
        }
        let _ = std::fs::remove_dir(parts_of(&first.output));
        Ok(true)
    }

    /// The frames of an exposure, in the order of the detectors.
    pub(super) fn frames_of(&self, exposure: &str) -> Vec<&SurveyFrame> {
        let mut frames: Vec<&SurveyFrame> = self
            .frames()
            .iter()
            .filter(|frame| frame.exposure == exposure)
            .collect();
        frames.sort_by_key(|frame| frame.detector);
        frames
    }

    /// The digest of a file whose extensions are these frames.
    pub(super) fn digest_of_exposure(&self, frames: &[&SurveyFrame]) -> String {
        digest_of(frames.iter().map(|frame| self.digest(frame)))
    }
}

/// The hash FNV-1a of texts, one after the other.
fn digest_of(texts: impl IntoIterator<Item = String>) -> String {
    let mut hasher = fnv::FnvHasher::default();
    texts.into_iter().for_each(|text| hasher.write(text.as_bytes()));
    format!("{:016x}", hasher.finish())
}
