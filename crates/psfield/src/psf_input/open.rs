//! One door for every PSF file.

use std::path::Path;

use psf_io::{FileKind, ScopesimOptions, StampCubeOptions};
use psf_types::{PsfBasis, PsfModelRecord, PsfSamples, SamplePositions};

use super::psfex_record::record_of_psfex;
use super::scopesim_record::record_of_scopesim;
use crate::{FitChoices, FitOptions, PsfFileOptions, PsfInput, PsfieldError};

/// A PSF from a file.
#[derive(Debug, Clone)]
pub struct OpenedPsf {
    /// The PSF.
    pub input: PsfInput,
    /// The format of the file.
    pub kind: FileKind,
    /// What a user should know of how the file was read, in plain sentences.
    pub notes: Vec<String>,
}

/// What a file holds: PSFs that are to be fitted, or a model.
enum Content {
    Samples(PsfSamples),
    Model(PsfModelRecord),
}

impl PsfInput {
    /// Reads PSF samples, a model, or any other PSF file that [`psf_io`] knows; `options` apply to samples, a model keeps its
    /// own.
    ///
    /// # Errors
    /// As [`open_with`](Self::open_with).
    pub fn open(path: impl AsRef<Path>, options: FitOptions) -> Result<Self, PsfieldError> {
        let path = path.as_ref();
        let (content, ..) = read(path, &PsfFileOptions::default())?;
        Ok(match content {
            Content::Samples(samples) => Self::Samples(samples, options),
            Content::Model(record) => Self::Model(record),
        })
    }

    /// The same where the file's format asks for more to be said, with the defaults of the format for what is not chosen.
    ///
    /// | file | normalised | what is chosen |
    /// |---|---|---|
    /// | [PSF samples](psf_io::samples) | unit | all of `choices` |
    /// | [PSF model](psf_io::model) | as it says | `outside` and `normalisation` of `choices` |
    /// | [PSFEx model](psf_io::psfex) | unit | the same; `file.extension` |
    /// | [STPSF](psf_io::stpsf), [STDPSF](psf_io::stdpsf) library | as it is | all of `choices` (every component is kept, bilinear); `file.plane_order`, `file.detector`, `file.extension` |
    /// | [ScopeSim's field-varying PSF](psf_io::scopesim) | unit | `outside` and `normalisation`; `file.pixel_scale_arcsec`, `file.field_centre`, `file.wavelength_um` |
    /// | cube without positions | unit | all of `choices`; `file.positions`, `file.oversampling`, `file.centre`, `file.extension` |
    /// | single stamp: the same PSF everywhere | unit | `file.oversampling`, `file.centre`, `file.extension` |
    ///
    /// `file.pixel_response_included` applies to all.
    ///
    /// ```no_run
    /// use psfield::{FitChoices, PsfFileOptions, PsfInput};
    /// let file = PsfFileOptions { extension: Some("2".parse()?), ..PsfFileOptions::default() };
    /// let opened = PsfInput::open_with("field.psf", &file, &FitChoices::default())?;
    /// for note in &opened.notes {
    ///     eprintln!("{note}");
    /// }
    /// let model = opened.input.into_model()?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`PsfieldError::ForeignOption`] for an option that the format does not know, [`PsfieldError::FitOfModel`] for a choice
    /// that a model leaves no room for, [`PsfieldError::MissingChoice`] for a choice that is needed, and
    /// [`PsfieldError::Io`] when the file holds no PSF or is damaged.
    pub fn open_with(
        path: impl AsRef<Path>,
        file: &PsfFileOptions,
        choices: &FitChoices,
    ) -> Result<OpenedPsf, PsfieldError> {
        let path = path.as_ref();
        let (content, kind, notes) = read(path, file)?;
        let input = match content {
            Content::Samples(samples) => {
                let defaults = defaults(kind, samples.positions());
                Self::Samples(samples, choices.or(defaults))
            }
            Content::Model(_) if choices.needs_fit() => {
                return Err(PsfieldError::FitOfModel {
                    path: path.to_owned(),
                    kind,
                });
            }
            Content::Model(record) => Self::Model(PsfModelRecord::new(
                record.basis().clone(),
                record.coefficients().clone(),
                record.interpolation(),
                choices.outside.unwrap_or(record.outside()),
                choices.normalisation.unwrap_or(record.normalisation()),
            )?),
        };
        Ok(OpenedPsf { input, kind, notes })
    }
}

/// The fit options of samples of a format where nothing is chosen.
fn defaults(kind: FileKind, positions: &SamplePositions) -> FitOptions {
    match kind {
        FileKind::Stpsf | FileKind::Stdpsf => FitOptions::of_gridded_library(positions),
        FileKind::Image => FitOptions::of_single_stamp(),
        _ => FitOptions::default(),
    }
}

fn read(path: &Path, file: &PsfFileOptions) -> Result<(Content, FileKind, Vec<String>), PsfieldError> {
    let choice = file.extension.as_ref();
    let kind = psf_io::detect_hdu(path, choice)?;
    if let Some((option, formats)) = file.unknown_to(kind) {
        return Err(PsfieldError::ForeignOption {
            path: path.to_owned(),
            kind,
            option,
            formats,
        });
    }
    let of_library = |library: psf_io::GriddedPsf| {
        let notes = library.notes().to_vec();
        (Content::Samples(library.into_samples()), notes)
    };
    let (content, notes) = match kind {
        FileKind::PsfModel => (Content::Model(psf_io::read_model(path)?), Vec::new()),
        FileKind::Psfex => {
            let model = psf_io::read_psfex(path, choice)?;
            (Content::Model(record_of_psfex(&model)?), Vec::new())
        }
        FileKind::Stpsf => of_library(psf_io::read_stpsf_hdu(
            path,
            choice,
            file.plane_order.unwrap_or_default(),
        )?),
        FileKind::Stdpsf => of_library(psf_io::read_stdpsf_hdu(path, choice, file.detector)?),
        FileKind::Scopesim => {
            let psf = psf_io::read_scopesim(path, &scopesim_options(path, file)?)?;
            (Content::Model(record_of_scopesim(&psf)?), psf.notes().to_vec())
        }
        FileKind::Cube | FileKind::Image => plain(path, kind, file)?,
        // Whatever else it is, the reader of samples says best what is missing.
        _ => (Content::Samples(psf_io::read_samples(path)?), Vec::new()),
    };
    let content = match file.pixel_response_included {
        Some(included) => content.with_pixel_response_included(included)?,
        None => content,
    };
    Ok((content, kind, notes))
}

fn missing(path: &Path, kind: FileKind, what: &'static str, option: &'static str) -> PsfieldError {
    PsfieldError::MissingChoice {
        path: path.to_owned(),
        kind,
        what,
        option,
    }
}

fn scopesim_options(path: &Path, file: &PsfFileOptions) -> Result<ScopesimOptions, PsfieldError> {
    let lacks = |what, option| missing(path, FileKind::Scopesim, what, option);
    let scale = file.pixel_scale_arcsec.ok_or_else(|| {
        lacks(
            "a word on the frame's pixels",
            "--pixel-scale ARCSEC (the size of a frame pixel)",
        )
    })?;
    let centre = file.field_centre.ok_or_else(|| {
        lacks(
            "a word on where its field lies on the frame",
            "--field-centre X,Y (the centre of the field in 0-based pixels)",
        )
    })?;
    let options = ScopesimOptions::new(scale, centre)?;
    Ok(match file.wavelength_um {
        Some(wavelength) => options.with_wavelength_um(wavelength)?,
        None => options,
    })
}

/// Stamps without a word about them.
fn plain(path: &Path, kind: FileKind, file: &PsfFileOptions) -> Result<(Content, Vec<String>), PsfieldError> {
    // An image may as well be a scene that was given by mistake: someone must say that it is a PSF.
    let header = psf_io::read_stamp_header(path, file.extension.as_ref())?;
    if file.oversampling.is_none() && header.get("OVERSAMP").is_none() {
        return Err(missing(
            path,
            kind,
            "a table POSITIONS, as PSF samples have, nor a word on how fine its stamps are",
            "--psf-oversampling S to take it as PSF stamps (S stamp pixels per frame pixel; 1 for the frame's own pixels)",
        ));
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
        notes.push(format!(
            "stamps of {} x {} pixels have no middle pixel: ({}, {}) is taken as their centre (0-based; --psf-centre X,Y for another)",
            grid.nx(),
            grid.ny(),
            grid.centre_x(),
            grid.centre_y()
        ));
    }
    if samples.len() == 1 {
        notes.push("one stamp, taken as the PSF of the whole field".to_owned());
    }
    Ok((Content::Samples(samples), notes))
}

impl Content {
    /// The same PSFs, told whether the pixel response is in them.
    fn with_pixel_response_included(self, included: bool) -> Result<Self, PsfieldError> {
        Ok(match self {
            Self::Samples(samples) => {
                let grid = samples.grid().with_pixel_response_included(included);
                Self::Samples(PsfSamples::new(
                    samples.stamps().to_owned(),
                    samples.positions().clone(),
                    grid,
                )?)
            }
            Self::Model(record) => {
                let basis = record.basis();
                let grid = basis.grid().with_pixel_response_included(included);
                let mean = basis.mean().map(|mean| mean.to_owned());
                Self::Model(PsfModelRecord::new(
                    PsfBasis::new(mean, basis.components().to_owned(), grid)?,
                    record.coefficients().clone(),
                    record.interpolation(),
                    record.outside(),
                    record.normalisation(),
                )?)
            }
        })
    }
}
