//! Opens PSF files of every format.

use std::path::Path;

use psf_basis::{Centring, PixelNoise, RankSelection};
use psf_io::{FileKind, HduChoice, PlaneOrder, ScopesimOptions, StampCubeOptions};
use psf_types::{
    Interpolation, Normalisation, OutsidePolicy, Position, PsfBasis, PsfSamples, SamplePositions, StateKind,
    WingsRecord,
};
use serde::{Deserialize, Serialize};

use super::format_records::{record_of_psfex, record_of_scopesim};
use super::{Note, Origin, Psf, SourceFile, WingsSource};
use crate::error::{ErrorKind, PsfieldError};
use crate::fit::FitOptions;

/// Settings that a PSF file does not state, or leaves to the user. Each setting applies to some
/// formats. It is an error to give a setting for a file of another format.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PsfFileOptions {
    /// Chooses one of several models in a file (PSFEx; of a table of models, a row by its `CCDNAME` or its
    /// number from 0), or one of several images (STPSF, STDPSF, a cube or a single stamp).
    pub extension: Option<HduChoice>,
    /// The values of quantities on which the PSF depends besides the position, by their names (PSFEx).
    pub contexts: Vec<(String, f64)>,
    /// Chooses one of several detectors (STDPSF).
    pub detector: Option<usize>,
    /// The order of the planes, which determines the position of each plane (STPSF).
    pub plane_order: Option<PlaneOrder>,
    /// Leaves out planes without positive flux. Without this setting they are an error (STPSF,
    /// STDPSF). If the other planes do not form a regular grid, the default interpolation is that
    /// of scattered positions.
    pub skip_invalid: bool,
    /// Chooses a wavelength, in micrometres. In PSF samples and models, it may lie between those of
    /// the samples. In a file of ScopeSim, the nearest is taken.
    pub wavelength_um: Option<f64>,
    /// Chooses a time, in seconds (PSF samples and models with times).
    pub time_s: Option<f64>,
    /// Chooses a frame (PSF samples and models with frames).
    pub frame_number: Option<f64>,
    /// The size of a frame pixel in arcseconds (ScopeSim).
    pub pixel_scale_arcsec: Option<f64>,
    /// The position of the centre of the field on the frame (ScopeSim).
    pub field_centre: Option<Position>,
    /// The positions of the planes of a cube.
    pub positions: Option<Vec<Position>>,
    /// Stamp pixels per frame pixel (a cube or a single stamp).
    pub oversampling: Option<f64>,
    /// The centre of the stamps, a 0-based index that may be fractional (a cube or a single stamp).
    pub centre: Option<Position>,
    /// States whether the stamps include the pixel response. This overrides the file.
    pub pixel_response_included: Option<bool>,
    /// Wings that are joined to the PSF ([`Psf::joined_to`]).
    pub wings: Option<WingsSource>,
}

impl PsfFileOptions {
    /// The chosen state, and the name of the setting that chose it.
    fn state(&self) -> Result<Option<(StateKind, f64, &'static str)>, PsfieldError> {
        let all = [
            (StateKind::Wavelength, self.wavelength_um, "wavelength_um"),
            (StateKind::Time, self.time_s, "time_s"),
            (StateKind::Frame, self.frame_number, "frame_number"),
        ];
        let given = all.into_iter();
        let mut given = given.filter_map(|(kind, value, setting)| value.map(|value| (kind, value, setting)));
        let first = given.next();
        match (first, given.next()) {
            (Some((first, ..)), Some((second, _, setting))) => {
                let message =
                    format!("a PSF depends on the {first} or on the {second}, not on both: choose one");
                Err(PsfieldError::of_setting(setting, message))
            }
            _ => Ok(first),
        }
    }

    /// Returns the first given field that does not apply to a format, and the formats to which it
    /// applies.
    pub(crate) fn unknown_to(&self, kind: FileKind) -> Option<(&'static str, &'static str)> {
        use FileKind::{Cube, Image, PsfModel, PsfSamples, Psfex, Scopesim, Stdpsf, Stpsf};
        const SCOPESIM: &str = "PSFs of ScopeSim";
        const CHOSEN: &str = "PSFEx models, STPSF and STDPSF libraries, and plain stamps";
        const PLAIN: &str = "cubes and single stamps without a table POSITIONS";
        const CUBES: &str = "cubes without positions";
        const WITH_STATES: &str = "PSF samples and PSF models";
        const SEVERAL: &[FileKind] = &[Psfex, Stpsf, Stdpsf, Cube, Image];
        let stamps = &[Cube, Image][..];
        let table = [
            (self.extension.is_some(), SEVERAL, "extension", CHOSEN),
            (!self.contexts.is_empty(), &[Psfex], "contexts", "PSFEx models"),
            (self.detector.is_some(), &[Stdpsf], "detector", "STDPSF libraries"),
            (
                self.plane_order.is_some(),
                &[Stpsf],
                "plane_order",
                "STPSF libraries",
            ),
            (
                self.skip_invalid,
                &[Stpsf, Stdpsf],
                "skip_invalid",
                "STPSF and STDPSF libraries",
            ),
            (
                self.wavelength_um.is_some(),
                &[Scopesim, Cube, PsfSamples, PsfModel],
                "wavelength_um",
                "PSF samples, PSF models, cubes over wavelength and PSFs of ScopeSim",
            ),
            (
                self.time_s.is_some(),
                &[PsfSamples, PsfModel],
                "time_s",
                WITH_STATES,
            ),
            (
                self.frame_number.is_some(),
                &[PsfSamples, PsfModel],
                "frame_number",
                WITH_STATES,
            ),
            (
                self.pixel_scale_arcsec.is_some(),
                &[Scopesim],
                "pixel_scale_arcsec",
                SCOPESIM,
            ),
            (self.field_centre.is_some(), &[Scopesim], "field_centre", SCOPESIM),
            (self.positions.is_some(), &[Cube], "positions", CUBES),
            (self.centre.is_some(), stamps, "centre", PLAIN),
            (self.oversampling.is_some(), stamps, "oversampling", PLAIN),
        ];
        let mut foreign = table
            .into_iter()
            .filter(|(given, kinds, ..)| *given && !kinds.contains(&kind));
        foreign.next().map(|(_, _, setting, formats)| (setting, formats))
    }
}

/// The fit options that the user has chosen. None stands for the default of the file's format.
///
/// ```
/// use psfield::{FitChoices, FitOptions, psf_types::Normalisation};
/// let choices = FitChoices { normalisation: Some(Normalisation::Keep), ..FitChoices::default() };
/// let options = choices.or(FitOptions::default());
/// assert_eq!(options, FitOptions { normalisation: Normalisation::Keep, ..FitOptions::default() });
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitChoices {
    /// Number of components to keep.
    pub rank: Option<RankSelection>,
    /// The choice whether to subtract the mean stamp first.
    pub centring: Option<Centring>,
    /// The noise in the samples' pixels: estimated, or known.
    pub noise: Option<PixelNoise>,
    /// The interpolation of the coefficients over the field.
    pub interpolation: Option<Interpolation>,
    /// The policy for positions outside the area of the samples. This choice also applies to a
    /// stored model.
    pub outside: Option<OutsidePolicy>,
    /// The scaling of samples and PSFs: to unit flux, or none. This choice also applies to a stored
    /// model.
    #[serde(rename = "normalise")]
    pub normalisation: Option<Normalisation>,
    /// The number of shifted copies of each sample.
    pub shift_copies: Option<usize>,
}

impl FitChoices {
    /// Returns the chosen options, with the value of `defaults` for each option that is None.
    #[must_use]
    pub fn or(self, defaults: FitOptions) -> FitOptions {
        FitOptions {
            rank: self.rank.unwrap_or(defaults.rank),
            centring: self.centring.unwrap_or(defaults.centring),
            noise: self.noise.unwrap_or(defaults.noise),
            interpolation: self.interpolation.unwrap_or(defaults.interpolation),
            outside: self.outside.unwrap_or(defaults.outside),
            normalisation: self.normalisation.unwrap_or(defaults.normalisation),
            shift_copies: self.shift_copies.unwrap_or(defaults.shift_copies),
        }
    }

    /// Returns whether a choice applies only to a fit, not to a stored model.
    pub fn needs_fit(&self) -> bool {
        self.first_of_fit().is_some()
    }

    /// Returns the name of the first choice that applies only to a fit.
    fn first_of_fit(&self) -> Option<&'static str> {
        let given = [
            (self.rank.is_some(), "rank"),
            (self.centring.is_some(), "centring"),
            (self.noise.is_some(), "noise"),
            (self.interpolation.is_some(), "interpolation"),
            (self.shift_copies.is_some(), "shift_copies"),
        ];
        given
            .into_iter()
            .find_map(|(given, setting)| given.then_some(setting))
    }
}

/// Chooses every option.
impl From<FitOptions> for FitChoices {
    fn from(options: FitOptions) -> Self {
        Self {
            rank: Some(options.rank),
            centring: Some(options.centring),
            noise: Some(options.noise),
            interpolation: Some(options.interpolation),
            outside: Some(options.outside),
            normalisation: Some(options.normalisation),
            shift_copies: Some(options.shift_copies),
        }
    }
}

impl Psf {
    /// Reads PSF samples, a model, or any other PSF file that [`psf_io`] knows, with the defaults
    /// of its format.
    ///
    /// # Errors
    /// The errors of [`open_with`](Self::open_with).
    pub fn open(path: impl AsRef<Path>) -> Result<Self, PsfieldError> {
        Self::open_with(path, &PsfFileOptions::default(), &FitChoices::default())
    }

    /// Reads a PSF file with settings that its format needs. The defaults of the format apply to
    /// every choice that is None.
    ///
    /// | file | default scaling | settings that apply |
    /// |---|---|---|
    /// | [PSF samples](psf_io::samples) | unit flux | all of `choices` |
    /// | [PSF model](psf_io::model) | the file's own setting | `outside` and `normalisation` of `choices` |
    /// | [PSFEx model](psf_io::psfex) | unit flux | `outside` and `normalisation` of `choices`; `file.extension`, `file.contexts` |
    /// | [STPSF](psf_io::stpsf), [STDPSF](psf_io::stdpsf) library | none | all of `choices` (by default every component, interpolated bilinearly); `file.plane_order`, `file.detector`, `file.extension`, `file.skip_invalid` |
    /// | [PSF of ScopeSim](psf_io::scopesim) | unit flux | `outside` and `normalisation` of `choices`; `file.pixel_scale_arcsec`, `file.field_centre`, `file.wavelength_um` |
    /// | cube without positions | unit flux | all of `choices`; `file.positions`, `file.oversampling`, `file.centre`, `file.extension` |
    /// | single stamp: one PSF everywhere | unit flux | all of `choices` (by default nearest interpolation); `file.oversampling`, `file.centre`, `file.extension` |
    ///
    /// `file.pixel_response_included` applies to all formats. If PSF samples or a model depend on a
    /// wavelength, a time or a frame, `file.wavelength_um`, `file.time_s` or `file.frame_number`
    /// chooses one ([`at_state`](Self::at_state)). Without a choice, the PSF has all of them
    /// ([`states`](Self::states)).
    ///
    /// ```no_run
    /// use psfield::{FitChoices, Psf, PsfFileOptions};
    /// let file = PsfFileOptions { extension: Some("2".parse()?), ..PsfFileOptions::default() };
    /// let psf = Psf::open_with("field.psf", &file, &FitChoices::default())?;
    /// for note in psf.notes() {
    ///     eprintln!("{note}");
    /// }
    /// let model = psf.model()?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// - [`ErrorKind::Setting`] for a setting that does not apply to the format. If the file holds
    ///   a model, also for a choice that applies only to a fit.
    /// - [`ErrorKind::Format`] for a setting that is missing.
    /// - [`ErrorKind::Data`] for a PSFEx model without positive flux.
    /// - [`ErrorKind::Io`] when the file cannot be read, holds no PSF, or is damaged.
    pub fn open_with(
        path: impl AsRef<Path>,
        file: &PsfFileOptions,
        choices: &FitChoices,
    ) -> Result<Self, PsfieldError> {
        let path = path.as_ref();
        let (origin, kind, source) = read(path, file)?;
        let origin = match origin {
            Origin::Samples(samples, _) => {
                let defaults = defaults(kind, samples.positions());
                Origin::Samples(samples, choices.or(defaults))
            }
            Origin::Record(record) => {
                if let Some(setting) = choices.first_of_fit() {
                    let message = format!(
                        "{}: this file holds {kind}, which is not fitted: leave the setting {setting} out, or open the PSF \
                         samples instead. For a model, choose only the policy outside its samples or the scaling to unit flux",
                        path.display()
                    );
                    return Err(PsfieldError::of_setting(setting, message));
                }
                if record.wings().is_some() && choices.normalisation == Some(Normalisation::Unit) {
                    let message = format!(
                        "{}: the PSF has wings, which were scaled together with its core: leave the setting normalisation out",
                        path.display()
                    );
                    return Err(PsfieldError::of_setting("normalisation", message));
                }
                let outside = choices.outside.unwrap_or(record.outside());
                let normalisation = choices.normalisation.unwrap_or(record.normalisation());
                Origin::Record(record.with_policies(outside, normalisation))
            }
            model @ Origin::Model(..) => model,
        };
        let psf = Self::with_source(origin, source);
        let psf = match &file.wings {
            Some(wings) => psf
                .joined_to(wings)
                .map_err(|error| error.with_setting("wings"))?,
            None => psf,
        };
        match file.state()?.filter(|_| kind != FileKind::Scopesim) {
            Some((chosen, value, setting)) => psf.at_chosen_state(chosen, value, setting),
            None => Ok(psf),
        }
    }

    /// Returns this PSF with other options for the fit of its samples. A PSF that was not made from
    /// samples is returned unchanged.
    #[must_use]
    pub fn with_fit_options(&self, options: FitOptions) -> Self {
        match self.samples() {
            Some((samples, _)) => {
                let origin = Origin::Samples(samples.clone(), options);
                Self::with_source(origin, self.0.source.clone())
            }
            None => self.clone(),
        }
    }
}

/// The default fit options for samples of a format.
fn defaults(kind: FileKind, positions: &SamplePositions) -> FitOptions {
    match kind {
        FileKind::Stpsf | FileKind::Stdpsf => FitOptions::of_gridded_library(positions),
        FileKind::Cube | FileKind::Image if is_everywhere(positions) => FitOptions::of_single_stamp(),
        _ => FitOptions::default(),
    }
}

/// Returns whether all samples are at one position: there are no others for an interpolation.
fn is_everywhere(positions: &SamplePositions) -> bool {
    positions.as_slice().windows(2).all(|pair| pair[0] == pair[1])
}

fn read(path: &Path, file: &PsfFileOptions) -> Result<(Origin, FileKind, SourceFile), PsfieldError> {
    let choice = file.extension.as_ref();
    let kind = psf_io::detect_hdu(path, choice)?;
    if let Some((setting, formats)) = file.unknown_to(kind) {
        let message = format!(
            "{}: the setting {setting} applies to {formats}, not to this file ({kind}): leave it out",
            path.display()
        );
        return Err(PsfieldError::of_setting(setting, message));
    }
    let of_library = |library: psf_io::GriddedPsf| {
        let mut notes: Vec<Note> = library.notes().iter().map(plain_note).collect();
        let scattered = FitOptions::of_gridded_library(library.samples().positions()).interpolation;
        if !library.left_out().is_empty() && scattered != Interpolation::Bilinear {
            notes.push(plain_note(format!(
                "interpolation: without the planes left out, the positions form no regular grid, so that the default \
                 is {scattered}, not bilinear"
            )));
        }
        (unfitted(library.into_samples()), notes)
    };
    let mut psfex = None;
    let (origin, notes) = match kind {
        FileKind::PsfModel => (Origin::Record(psf_io::read_model(path)?), Vec::new()),
        FileKind::Psfex => {
            let model = psf_io::read_psfex_at(path, choice, &file.contexts)?;
            let record = record_of_psfex(&model)?;
            psfex = Some(model);
            (Origin::Record(record), Vec::new())
        }
        FileKind::Stpsf => of_library(psf_io::read_stpsf_hdu(
            path,
            choice,
            file.plane_order.unwrap_or_default(),
            file.skip_invalid,
        )?),
        FileKind::Stdpsf => of_library(psf_io::read_stdpsf_hdu(
            path,
            choice,
            file.detector,
            file.skip_invalid,
        )?),
        FileKind::Scopesim => {
            let psf = psf_io::read_scopesim(path, &scopesim_options(path, file)?)?;
            (
                Origin::Record(record_of_scopesim(&psf)?),
                psf.notes().iter().map(plain_note).collect(),
            )
        }
        FileKind::Cube | FileKind::Image => plain(path, kind, file)?,
        // Files without a PSF come here, too, because the error of this reader says best what they
        // lack.
        _ => {
            if kind == FileKind::OtherFits
                && let Some(what) = psf_io::foreign_psf(path)?
            {
                let message = format!("{}: this is {what}", path.display());
                return Err(PsfieldError::new(ErrorKind::Format, message));
            }
            (unfitted(psf_io::read_samples(path)?), Vec::new())
        }
    };
    let origin = match file.pixel_response_included {
        Some(included) => origin.with_pixel_response_included(included)?,
        None => origin,
    };
    let source = SourceFile {
        path: Some(path.to_owned()),
        kind: Some(kind),
        notes,
        psfex,
    };
    Ok((origin, kind, source))
}

fn missing(path: &Path, kind: FileKind, setting: &'static str, what: &str) -> PsfieldError {
    let message = format!("{}: this is {kind}, {what}", path.display());
    PsfieldError::new(ErrorKind::Format, message).with_setting(setting)
}

fn scopesim_options(path: &Path, file: &PsfFileOptions) -> Result<ScopesimOptions, PsfieldError> {
    const SCALE: &str = "which does not state the size of a frame pixel: give it in arcseconds";
    let lacks = |setting, what| missing(path, FileKind::Scopesim, setting, what);
    let scale = file
        .pixel_scale_arcsec
        .ok_or_else(|| lacks("pixel_scale_arcsec", SCALE))?;
    let mut options = ScopesimOptions::new(scale)?;
    if let Some(centre) = file.field_centre {
        options = options.with_field_centre(centre);
    }
    if let Some(wavelength) = file.wavelength_um {
        options = options.with_wavelength_um(wavelength)?;
    }
    Ok(options)
}

/// Reads a cube or a single stamp that has no table of positions.
fn plain(path: &Path, kind: FileKind, file: &PsfFileOptions) -> Result<(Origin, Vec<Note>), PsfieldError> {
    // The image may be a scene that was given by mistake. An oversampling, from the user or in the
    // header, states that it is a PSF.
    let header = psf_io::read_stamp_header(path, file.extension.as_ref())?;
    if file.oversampling.is_none() && header.get("OVERSAMP").is_none() {
        const PLAIN: &str = "which has neither a table POSITIONS (as PSF samples have) nor the keyword OVERSAMP. To \
                             read it as PSF stamps, give the oversampling: stamp pixels per frame pixel, 1 for the \
                             frame's own pixels";
        return Err(missing(path, kind, "oversampling", PLAIN));
    }
    let mut options = StampCubeOptions::default();
    if let Some(positions) = &file.positions {
        options = options.with_positions(positions.clone());
    }
    if let Some(oversampling) = file.oversampling {
        options = options.with_oversampling(oversampling);
    }
    if let Some(centre) = file.centre {
        options = options.with_centre(centre.x(), centre.y());
    }
    if let Some(extension) = &file.extension {
        options = options.with_extension(extension.clone());
    }
    let samples = psf_io::read_stamp_cube(path, &options)?;
    let mut notes = Vec::new();
    let grid = samples.grid();
    let says_centre = file.centre.is_some() || ["CENX", "CENY"].iter().all(|card| header.get(card).is_some());
    if !says_centre && (grid.nx() % 2 == 0 || grid.ny() % 2 == 0) {
        let (nx, ny, x, y) = (grid.nx(), grid.ny(), grid.centre_x(), grid.centre_y());
        let text = format!(
            "stamps of {nx} x {ny} pixels have no middle pixel: ({x}, {y}) is taken as their centre (0-based). Give \
             another centre if this is wrong"
        );
        let setting = Some("centre");
        notes.push(Note { text, setting });
    }
    if is_everywhere(samples.positions()) {
        notes.push(plain_note(match samples.len() {
            1 => "one stamp: it is the PSF of the whole field",
            _ => "one stamp for each wavelength: it is the PSF of the whole field",
        }));
    }
    Ok((unfitted(samples), notes))
}

/// Makes a note on a choice that no setting changes.
fn plain_note(text: impl Into<String>) -> Note {
    let (text, setting) = (text.into(), None);
    Note { text, setting }
}

fn unfitted(samples: PsfSamples) -> Origin {
    Origin::Samples(samples, FitOptions::default())
}

impl Origin {
    /// Sets whether the stamps include the pixel response.
    fn with_pixel_response_included(self, included: bool) -> Result<Self, PsfieldError> {
        Ok(match self {
            Self::Samples(samples, options) => {
                let grid = samples.grid().with_pixel_response_included(included);
                let (stamps, positions) = (samples.stamps().to_owned(), samples.positions().clone());
                Self::Samples(PsfSamples::new(stamps, positions, grid)?, options)
            }
            Self::Record(record) => {
                let basis = record.basis();
                let grid = basis.grid().with_pixel_response_included(included);
                let mean = basis.mean().map(|mean| mean.to_owned());
                let basis = PsfBasis::new(mean, basis.components().to_owned(), grid)?;
                let changed = record.with_parts(basis, record.coefficients().clone())?;
                let changed = changed.with_circle_error(record.circle_error());
                let wings = record.wings().map(|wings| {
                    let grid = wings.grid().with_pixel_response_included(included);
                    WingsRecord::new(wings.stamps().to_owned(), wings.coefficients().clone(), grid)
                });
                Self::Record(changed.with_wings(wings.transpose()?)?)
            }
            model @ Self::Model(..) => model,
        })
    }
}
