//! One door for every PSF file.

use std::path::Path;

use ndarray::Axis;
use psf_io::FileKind;
use psf_types::{Position, PsfBasis, PsfModelRecord, PsfSamples, SamplePositions, StampGrid};

use super::psfex_record::record_of_psfex;
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
    /// | cube without positions | unit | all of `choices`; `file.positions`, `file.oversampling` |
    /// | single stamp: the same PSF everywhere | unit | `file.oversampling` |
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
            Content::Samples(samples) => Self::Samples(samples, choices.or(defaults(kind))),
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
fn defaults(kind: FileKind) -> FitOptions {
    match kind {
        // One PSF for the whole field has no others to interpolate between.
        FileKind::Image => FitOptions {
            interpolation: psf_types::Interpolation::Nearest,
            ..FitOptions::default()
        },
        _ => FitOptions::default(),
    }
}

fn read(path: &Path, file: &PsfFileOptions) -> Result<(Content, FileKind, Vec<String>), PsfieldError> {
    let kind = psf_io::detect(path)?;
    if let Some((option, formats)) = file.unknown_to(kind) {
        return Err(PsfieldError::ForeignOption {
            path: path.to_owned(),
            kind,
            option,
            formats,
        });
    }
    let mut notes = Vec::new();
    let content = match kind {
        FileKind::PsfModel => Content::Model(psf_io::read_model(path)?),
        FileKind::Psfex => {
            let model = psf_io::read_psfex(path, file.extension.as_ref())?;
            Content::Model(record_of_psfex(&model)?)
        }
        FileKind::Cube | FileKind::Image => Content::Samples(plain(path, kind, file, &mut notes)?),
        // Whatever else it is, the reader of samples says best what is missing.
        _ => Content::Samples(psf_io::read_samples(path)?),
    };
    let content = match file.pixel_response_included {
        Some(included) => content.with_pixel_response_included(included)?,
        None => content,
    };
    Ok((content, kind, notes))
}

/// Stamps without a word about them.
fn plain(
    path: &Path,
    kind: FileKind,
    file: &PsfFileOptions,
    notes: &mut Vec<String>,
) -> Result<PsfSamples, PsfieldError> {
    let missing = |what, option| PsfieldError::MissingChoice {
        path: path.to_owned(),
        kind,
        what,
        option,
    };
    let stamps = match kind {
        FileKind::Cube => psf_io::read_cube::<f64>(path)?,
        _ => psf_io::read_image::<f64>(path)?
            .into_parts()
            .0
            .into_pixels()
            .insert_axis(Axis(0)),
    };
    let (count, ny, nx) = stamps.dim();
    let positions = match (&file.positions, count) {
        (Some(positions), _) => positions.clone(),
        (None, 1) => vec![Position::of_pixel(0, 0)],
        (None, _) => {
            return Err(missing(
                "a table POSITIONS that says where its planes belong",
                "--psf-positions POSITIONS.csv (columns x, y: 0-based pixels, one row a plane)",
            ));
        }
    };
    let oversampling = file.oversampling.ok_or_else(|| {
        missing(
            "a table POSITIONS, and does not say how fine its stamps are",
            "--psf-oversampling S (stamp pixels per frame pixel; 1 for the frame's own pixels)",
        )
    })?;
    if count == 1 {
        notes.push(format!(
            "{}: one stamp, taken as the PSF of the whole field",
            path.display()
        ));
    }
    let grid = StampGrid::new(nx, ny)?.with_oversampling(oversampling)?;
    Ok(PsfSamples::new(
        stamps,
        SamplePositions::new(positions, None)?,
        grid,
    )?)
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
