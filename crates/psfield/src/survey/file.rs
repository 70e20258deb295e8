//! The file of a survey.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::{ErrorKind, PsfieldError};
use crate::psf::FitChoices;
use crate::simulate_options::SimulateOptions;

/// The description of a survey: the keys of its TOML file. Paths are relative to the file.
///
/// | key | value | default |
/// |---|---|---|
/// | `catalog` | table of stars and galaxies with `ra` and `dec` | required |
/// | `columns`, `table`, `epoch`, `skip_invalid` | as `--columns`, `--table`, `--epoch`, `--skip-invalid` of `psfield simulate` | none |
/// | `output` | name of the frames' files, with `{exposure}`, `{detector}`, `{band}`. Without `{detector}`: one file for each exposure, with an extension for each detector | required |
/// | `truth_table`, `noise_free`, `quality` | names of further files for each frame | none |
/// | `frames` | list of all frames (CSV) | none |
/// | `seed` | seed of the first frame's noise. Each next frame has the next seed | 0 |
/// | `precision` | `"f32"` or `"f64"` | `"f32"` |
/// | `shoot_below` | expected photons, or `"auto"` ([`ShootBelow`](crate::ShootBelow)) | none |
/// | `[simulate]` | [`SimulateOptions`] | their defaults |
/// | `[fit]` | [`FitChoices`] | those of the PSF's format |
/// | `camera` | file with `[[detector]]` and `boresight`, in place of these keys here | none |
/// | `boresight` | right ascension, declination, rotation (degrees) to which the detectors' world coordinates refer | 0, 0, 0 |
/// | `[[detector]]` | [`DetectorEntry`] | one at least |
/// | `[band.NAME]` | [`BandEntry`] | none |
/// | `pointings` | CSV with the keys of `[[pointing]]` as columns, in place of these tables | none |
/// | `[[pointing]]` | [`PointingEntry`] | one at least |
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurveyFile {
    /// The catalogue. `None` if a program gives a table.
    pub catalog: Option<PathBuf>,
    /// Names of columns.
    pub columns: Option<String>,
    /// The table of a FITS file.
    pub table: Option<String>,
    /// Julian year at which positions hold.
    pub epoch: Option<f64>,
    /// Skip rows that are no sources.
    #[serde(default)]
    pub skip_invalid: bool,
    /// The name of the frames' files.
    pub output: String,
    /// The name of the tables of sources.
    pub truth_table: Option<String>,
    /// The name of the noise-free images of detectors.
    pub noise_free: Option<String>,
    /// The name of the images of flags.
    pub quality: Option<String>,
    /// The list of frames.
    pub frames: Option<PathBuf>,
    /// The seed of the first frame.
    #[serde(default)]
    pub seed: u64,
    /// `f32` or `f64`.
    #[serde(default)]
    pub precision: Precision,
    /// The sources that are drawn photon by photon.
    pub shoot_below: Option<ShootBelowEntry>,
    /// The settings of the simulation.
    #[serde(default)]
    pub simulate: SimulateOptions,
    /// The settings of fits.
    #[serde(default)]
    pub fit: FitChoices,
    /// The file of the camera.
    pub camera: Option<PathBuf>,
    /// Right ascension, declination and rotation to which world coordinates refer.
    pub boresight: Option<[f64; 3]>,
    /// The detectors.
    #[serde(default)]
    pub detector: Vec<DetectorEntry>,
    /// The bands by their names.
    #[serde(default)]
    pub band: BTreeMap<String, BandEntry>,
    /// The table of pointings.
    pub pointings: Option<PathBuf>,
    /// The pointings.
    #[serde(default)]
    pub pointing: Vec<PointingEntry>,
    /// The folder in which the relative paths of the file began.
    #[serde(skip)]
    pub(super) folder: PathBuf,
}

/// The working precision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Single precision.
    #[default]
    F32,
    /// Double precision.
    F64,
}

/// The value of `shoot_below`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ShootBelowEntry {
    /// Expected photons.
    Photons(f64),
    /// `"auto"`.
    Name(String),
}

/// The file of a camera: the keys `boresight` and `[[detector]]` of a [`SurveyFile`]. Paths are relative to it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraFile {
    boresight: Option<[f64; 3]>,
    #[serde(default)]
    detector: Vec<DetectorEntry>,
}

/// A detector of a camera: `[[detector]]`.
///
/// | key | value |
/// |---|---|
/// | `name` | its name, which stands in names of files |
/// | `shape` | columns and rows |
/// | `wcs` | FITS file, or text file with a card in each line, whose world coordinates refer to the `boresight` of the camera |
/// | `wcs_extension` | the extension of the FITS file with these world coordinates |
/// | `cards` | text of such cards, 80 characters each, in place of `wcs` |
/// | `geometry` | [`GeometryEntry`](super::GeometryEntry), in place of `wcs` |
/// | `psf` | PSF file of any format, or the description of a telescope (`.toml`). `{detector}` and `{band}` are replaced |
/// | `settings` | TOML file of a detector ([`DetectorParams`](detector::DetectorParams)). Without it, the frame is an image of flux |
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorEntry {
    /// Its name.
    pub name: String,
    /// Columns and rows.
    pub shape: [usize; 2],
    /// The file with its world coordinates.
    pub wcs: Option<PathBuf>,
    /// The extension of that file.
    pub wcs_extension: Option<String>,
    /// Cards of a header, in place of the file.
    pub cards: Option<String>,
    /// Its place in the focal plane.
    pub geometry: Option<super::GeometryEntry>,
    /// Its PSF.
    pub psf: String,
    /// The file of its settings.
    pub settings: Option<PathBuf>,
}

/// A band: `[band.NAME]`.
///
/// | key | value |
/// |---|---|
/// | `zero_point` | magnitude of flux 1 per second (or of flux 1, for pointings without `exposure_s`) |
/// | `mag` | column of the band's magnitudes, in place of `mag` |
/// | `sky_e_per_s` | sky in electrons per second and pixel, in place of `sky_e` of the detector |
/// | `bandpass`, `sed` | as `--bandpass` and `--sed` of `psfield simulate` |
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BandEntry {
    /// The magnitude of flux 1 per second.
    pub zero_point: Option<f64>,
    /// The column of magnitudes.
    pub mag: Option<String>,
    /// The sky.
    pub sky_e_per_s: Option<f64>,
    /// The throughput.
    pub bandpass: Option<String>,
    /// The spectrum of sources without one.
    pub sed: Option<String>,
}

/// A pointing of the camera: `[[pointing]]`.
///
/// | key | value | default |
/// |---|---|---|
/// | `name` | name of the exposure | its number from 001 |
/// | `ra`, `dec` | boresight (degrees) | required |
/// | `rotation_deg` | position angle of the camera's north, from north towards east | 0 |
/// | `date` | as `--date` of `psfield simulate` | none: nothing moves |
/// | `band` | name of a band | none |
/// | `exposure_s` | exposure time (s) | that of the detector's settings, and fluxes are those of an exposure |
/// | `dithers_arcsec` | offsets of the boresight towards east and north. Each makes an exposure | `[[0, 0]]` |
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointingEntry {
    /// The name of the exposure.
    pub name: Option<String>,
    /// Right ascension in degrees.
    pub ra: f64,
    /// Declination in degrees.
    pub dec: f64,
    /// Position angle of the camera's north.
    #[serde(default)]
    pub rotation_deg: Option<f64>,
    /// The date.
    #[serde(default)]
    pub date: Option<DateEntry>,
    /// The name of its band.
    #[serde(default)]
    pub band: Option<String>,
    /// The exposure time.
    #[serde(default)]
    pub exposure_s: Option<f64>,
    /// Offsets of the boresight.
    #[serde(default)]
    pub dithers_arcsec: Option<Vec<[f64; 2]>>,
}

/// A date: a text, a number, or a date of TOML.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum DateEntry {
    /// A text, as in `2031-05-17`.
    Text(String),
    /// A Julian year or a modified Julian date.
    Number(f64),
    /// A date without quotes.
    Date(toml::value::Datetime),
}

impl DateEntry {
    /// The text that [`ObservationDate`](psf_io::ObservationDate) parses.
    pub(super) fn text(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Number(number) => number.to_string(),
            Self::Date(date) => date.to_string(),
        }
    }
}

impl SurveyFile {
    /// Reads the TOML file of a survey, and the files of its camera and its pointings.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] that names the file, the line and the key.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, PsfieldError> {
        let path = path.as_ref();
        parsed_file::<Self>(path)?.completed(folder_of(path))
    }

    /// Takes the JSON of these keys. Relative paths refer to `folder`.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] that names the key.
    pub fn from_json(json: &str, folder: &Path) -> Result<Self, PsfieldError> {
        let parsed: Result<Self, _> = serde_json::from_str(json);
        let file =
            parsed.map_err(|error| PsfieldError::new(ErrorKind::Data, format!("the survey: {error}")))?;
        file.completed(folder)
    }

    /// The survey with all its parts in place, and paths that start in `folder`.
    fn completed(mut self, folder: &Path) -> Result<Self, PsfieldError> {
        folder.clone_into(&mut self.folder);
        let within = |path: &mut PathBuf| *path = folder.join(&*path);
        let named = |name: &mut String| *name = folder.join(&*name).to_string_lossy().into_owned();
        let paths = [
            &mut self.catalog,
            &mut self.frames,
            &mut self.camera,
            &mut self.pointings,
        ];
        paths.into_iter().flatten().for_each(within);
        named(&mut self.output);
        let names = [&mut self.truth_table, &mut self.noise_free, &mut self.quality];
        names.into_iter().flatten().for_each(named);
        for detector in &mut self.detector {
            detector.start_in(folder);
        }
        for band in self.band.values_mut() {
            if let Some(bandpass) = &mut band.bandpass {
                named(bandpass);
            }
            if let Some(sed) = &mut band.sed {
                *sed = crate::colours::spectrum_in(folder, sed);
            }
        }
        if let Some(path) = &self.camera {
            if !self.detector.is_empty() || self.boresight.is_some() {
                return Err(refused(
                    "camera names a file of detectors, so the survey has none of its own: remove camera, or boresight and [[detector]]",
                ));
            }
            let camera: CameraFile = parsed_file(path)?;
            (self.boresight, self.detector) = (camera.boresight, camera.detector);
            let folder = folder_of(path);
            self.detector
                .iter_mut()
                .for_each(|detector| detector.start_in(folder));
        }
        if let Some(path) = &self.pointings {
            if !self.pointing.is_empty() {
                return Err(refused(
                    "pointings names a table of pointings, so the survey has none of its own: remove pointings or [[pointing]]",
                ));
            }
            self.pointing = pointings_of(path)?;
        }
        Ok(self)
    }
}

impl DetectorEntry {
    fn start_in(&mut self, folder: &Path) {
        for path in [&mut self.wcs, &mut self.settings].into_iter().flatten() {
            *path = folder.join(&*path);
        }
        self.psf = folder.join(&self.psf).to_string_lossy().into_owned();
    }
}

pub(super) fn refused(problem: impl Into<String>) -> PsfieldError {
    PsfieldError::new(ErrorKind::Data, problem)
}

fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new(""))
}

pub(super) fn text_of(path: &Path) -> Result<String, PsfieldError> {
    psf_types::read_text_file(path).map_err(|error| {
        PsfieldError::new(ErrorKind::Io, format!("cannot read {}", path.display())).because(error)
    })
}

/// Reads a TOML file.
fn parsed_file<T: DeserializeOwned>(path: &Path) -> Result<T, PsfieldError> {
    let text = text_of(path)?;
    toml::from_str(&text).map_err(|error| {
        let line = error.span().map_or_else(String::new, |span| {
            format!(" (line {})", 1 + text[..span.start].matches('\n').count())
        });
        refused(format!("{}{line}: {}", path.display(), error.message()))
    })
}

/// Reads the pointings of a CSV file, whose columns are the keys of a [`PointingEntry`] without dithers.
fn pointings_of(path: &Path) -> Result<Vec<PointingEntry>, PsfieldError> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Row {
        #[serde(default)]
        name: Option<String>,
        ra: f64,
        dec: f64,
        #[serde(default)]
        rotation_deg: Option<f64>,
        #[serde(default)]
        date: Option<String>,
        #[serde(default)]
        band: Option<String>,
        #[serde(default)]
        exposure_s: Option<f64>,
    }
    let text = text_of(path)?;
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(text.as_bytes());
    let rows = reader.deserialize::<Row>();
    rows.map(|row| {
        let row = row.map_err(|error| refused(format!("{}: {error}", path.display())))?;
        Ok(PointingEntry {
            name: row.name,
            ra: row.ra,
            dec: row.dec,
            rotation_deg: row.rotation_deg,
            date: row.date.map(DateEntry::Text),
            band: row.band,
            exposure_s: row.exposure_s,
            dithers_arcsec: None,
        })
    })
    .collect()
}
