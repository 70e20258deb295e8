//! The options that turn samples into a model.

use std::path::Path;

use psf_basis::{Centring, PixelNoise, RankSelection};
use psf_io::HduChoice;
use psf_types::{Interpolation, Normalisation, OutsidePolicy};
use psfield::{FitChoices, FitOptions, OpenedPsf, PsfInput, PsfieldError};

use super::UsageError;
use super::context::Context;
use super::psf_file_args::PsfFileArgs;
use super::values::at_least_zero;

/// How samples become a model.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Fit options (models take --outside and --normalise alone)")]
pub(crate) struct FitArgs {
    /// Components to keep: auto, elbow, full, a number, energy=0.999 or error=1e-3. auto: at least the elbow, and as many
    /// more as a fit error of 1e-4 asks, but none below the noise [default: auto; STPSF and STDPSF: full]
    #[arg(long, value_name = "RANK")]
    rank: Option<RankSelection>,
    /// Take out the mean stamp (mean) or not (none) [default: mean]
    #[arg(long, value_name = "mean|none")]
    centring: Option<Centring>,
    /// Standard deviation of the noise in the samples' pixels, after normalisation; 0 for none [default: estimated]
    #[arg(long, value_name = "SIGMA", value_parser = at_least_zero, allow_negative_numbers = true)]
    noise: Option<f64>,
    /// auto, delaunay, natural-neighbour, idw, idw=POWER, bilinear, bicubic, polynomial=D or nearest. auto: bicubic on a regular
    /// grid, else natural neighbour [default: auto; STPSF and STDPSF: bilinear]
    #[arg(long, value_name = "METHOD")]
    interpolation: Option<Interpolation>,
    /// Outside the samples: nearest, extend or error [default: nearest; models as they say, PSFEx: extend]
    #[arg(long, value_name = "POLICY")]
    outside: Option<OutsidePolicy>,
    /// Scale every PSF to unit flux, or keep the values as they are [default: unit; models as they say, STPSF and STDPSF: keep]
    #[arg(long, value_name = "unit|keep")]
    normalise: Option<Normalisation>,
}

/// A PSF file: how it is read, and how it becomes a model where it holds samples.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct PsfArgs {
    #[command(flatten)]
    fit: FitArgs,
    #[command(flatten)]
    file: PsfFileArgs,
}

impl FitArgs {
    /// What is chosen; the rest takes the default of the file's format.
    pub(crate) fn choices(&self) -> FitChoices {
        FitChoices {
            rank: self.rank,
            centring: self.centring,
            noise: self.noise.map(PixelNoise::Known),
            interpolation: self.interpolation,
            outside: self.outside,
            normalisation: self.normalise,
        }
    }

    /// The same with the defaults of samples for the rest.
    pub(crate) fn options(&self) -> FitOptions {
        self.choices().or(FitOptions::default())
    }
}

impl PsfArgs {
    /// What is chosen of the fit.
    pub(crate) fn choices(&self) -> FitChoices {
        self.fit.choices()
    }

    /// Which of several models of a PSFEx file.
    pub(crate) fn extension(&self) -> Option<&HduChoice> {
        self.file.extension()
    }

    /// The files that are read for the PSF of a file.
    pub(crate) fn files<'a>(&'a self, psf: &'a Path) -> Vec<&'a Path> {
        std::iter::once(psf).chain(self.file.positions_file()).collect()
    }

    /// Opens any PSF file and tells how it was read.
    pub(crate) fn opened(&self, path: &Path, context: &Context) -> anyhow::Result<OpenedPsf> {
        let opened =
            PsfInput::open_with(path, &self.file.options()?, &self.fit.choices()).map_err(as_usage)?;
        for note in &opened.notes {
            context.note(&format!("{}: {note}", path.display()));
        }
        Ok(opened)
    }

    /// The same where the PSF alone is needed.
    pub(crate) fn open(&self, path: &Path, context: &Context) -> anyhow::Result<PsfInput> {
        Ok(self.opened(path, context)?.input)
    }
}

/// Options that do not suit the file are bad usage.
fn as_usage(error: PsfieldError) -> anyhow::Error {
    match error {
        PsfieldError::ForeignOption { .. } | PsfieldError::FitOfModel { .. } => {
            UsageError(error.to_string()).into()
        }
        other => other.into(),
    }
}
