//! `psfield observe`.

use std::collections::{HashMap, HashSet};
use std::path::PathBuf;
use std::sync::Arc;

use psf_types::Progress;
use psfield::survey::{FrameStatus, Observer, Survey, SurveyFile};
use psfield::{ErrorKind, PsfieldError};

use crate::UsageError;
use crate::context::{Context, with_overwrite};
use crate::files::FileUses;
use crate::json_lines::{LineWriter, failures};

/// Simulate the frames of a camera from a catalogue of the sky
///
/// The survey file names a catalogue with right ascensions and declinations, a camera (detectors
/// with their world coordinates, PSFs and settings), and pointings (where the camera looks, when,
/// in which band, for how long). Each detector gives a frame for each pointing and dither: the
/// sources near it, at their place and size on its pixels at that date, through its PSF, with sky
/// and noise. Relative paths refer to the folder of the file that names them.
///
/// For each frame, one line of JSON is printed on standard output. With --quiet, only the lines of
/// failed frames are printed. With --quiet --json, the lines of all frames are printed. A frame
/// that fails does not stop the others, and the exit status is then 1. A warning that several
/// frames share is printed once, and stands in the line of each.
///
/// A survey that is run again continues where it was interrupted: frames whose files exist are
/// skipped, as are frames on which another run works. If settings of a frame have changed since
/// its files were written, the frame fails unless --overwrite is given. Changes in the content of
/// input files are not detected.
#[derive(Debug, clap::Args)]
#[command(after_long_help = SAMPLE)]
pub(crate) struct ObserveArgs {
    /// Survey file (TOML)
    #[arg(value_name = "SURVEY.toml")]
    survey: PathBuf,
    /// Make all frames again and replace files that exist
    #[arg(long)]
    overwrite: bool,
    /// Also append the lines of all frames to this file
    // Not an `OutputFile`, because a log may exist already.
    #[arg(long, value_name = "LOG.jsonl")]
    log: Option<PathBuf>,
}

/// The end of the long help.
const SAMPLE: &str = r#"A survey file:

  catalog = "sky.csv"              # ra, dec, r_mag; galaxies: re_arcsec, n, q, pa_deg
  epoch = 2016.0                   # of ra and dec, for pmra, pmdec, parallax
  output = "raw/{exposure}.fits"   # one extension per detector
  truth_table = "raw/{exposure}_{detector}_sources.fits"
  frames = "raw/frames.csv"        # list of all frames
  seed = 1

  [simulate]                       # settings of psfield simulate
  tolerance = 1e-3

  [band.r]
  zero_point = 27.1                # magnitude of flux 1 per second
  mag = "r_mag"                    # column of the catalogue
  sky_e_per_s = 0.7                # per pixel

  [[detector]]
  name = "N1"
  shape = [2048, 2048]             # columns, rows
  wcs = "N1.head"                  # world coordinates relative to the boresight (0, 0)
  psf = "N1_{band}.fits"
  settings = "ccd.toml"            # as --detector of psfield simulate

  [[detector]]
  name = "N2"
  shape = [2048, 2048]
  psf = "N2_{band}.fits"
  settings = "ccd.toml"
  [detector.geometry]              # in place of wcs
  pixel_scale_arcsec = 0.2
  centre_arcsec = [450, 0]         # of the detector, towards east and north
  rotation_deg = 180

  [[pointing]]
  ra = 150.1
  dec = 2.2
  rotation_deg = 30                # of the camera, from north towards east
  date = "2031-05-17T04:00:00"
  band = "r"
  exposure_s = 100
  dithers_arcsec = [[0, 0], [30, -15]]

camera = "camera.toml" in place of [[detector]] names a file with these tables. pointings = "pointings.csv" in place of
[[pointing]] names a table with these keys as columns. docs/observe.md explains all keys."#;

impl ObserveArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let survey = SurveyFile::read(&self.survey)
            .and_then(Survey::new)
            .map_err(as_usage)?;
        self.check_files(&survey)?;
        let survey = Arc::new(survey);
        let mut observer = Observer::new(Arc::clone(&survey));
        let mut lines = LineWriter::new(self.log.as_deref(), context)?;
        let count = survey.frames().len();
        // The frames of each exposure that are still to come.
        let mut left: HashMap<&str, usize> = HashMap::new();
        for frame in survey.frames() {
            *left.entry(&frame.exposure).or_default() += 1;
        }
        let (mut failed, mut warned) = (Vec::new(), HashSet::new());
        let bar = context.bar("frames");
        bar.start(count as u64);
        for (number, frame) in survey.frames().iter().enumerate() {
            let mut report = observer.observe(number, self.overwrite, &psf_types::NoProgress);
            report.error = report.error.as_deref().map(with_overwrite);
            let name = format!("{}, {}", report.exposure, report.detector);
            for warning in &report.warnings {
                // Most warnings are those of all frames, with other numbers.
                let kind = warning
                    .split(|c: char| c.is_ascii_digit())
                    .next()
                    .unwrap_or_default();
                if warned.insert(kind.to_owned()) {
                    context.for_part(&format!("frame {name}")).warn(warning);
                }
            }
            let has_failed = report.status == FrameStatus::Failed;
            bar.aside(|| lines.write(&report, has_failed))?;
            if has_failed {
                failed.push(name);
            }
            let left = left.get_mut(frame.exposure.as_str()).expect("counted above");
            *left -= 1;
            if *left == 0
                && let Err(error) = survey.join(&frame.exposure)
            {
                let why = with_overwrite(&psfield::error::error_text(&error));
                context.warn(&format!("exposure {}: {why}", frame.exposure));
                failed.push(frame.exposure.clone());
            }
            bar.advance(1);
        }
        drop(bar);
        survey.write_list(self.overwrite)?;
        failures("frames", &failed, count)
    }

    /// Checks that the log and the files of the survey do not replace each other.
    fn check_files(&self, survey: &Survey) -> Result<(), UsageError> {
        let mut uses = FileUses::default();
        uses.read(&self.survey, "the survey file");
        for input in survey.inputs() {
            uses.read(input, "an input of the survey");
        }
        let mut outputs: Vec<_> = survey.outputs().collect();
        outputs.sort();
        outputs.dedup();
        for output in outputs {
            uses.write(output, "another output of the survey")
                .map_err(UsageError)?;
        }
        match &self.log {
            Some(log) => uses
                .write(log, "the log")
                .map_err(|what| UsageError(format!("--log: {what}"))),
            None => Ok(()),
        }
    }
}

/// Turns errors about the survey itself into usage errors.
fn as_usage(error: PsfieldError) -> anyhow::Error {
    match error.kind() {
        ErrorKind::Data | ErrorKind::Setting => UsageError(psfield::error::error_text(&error)).into(),
        _ => error.into(),
    }
}
