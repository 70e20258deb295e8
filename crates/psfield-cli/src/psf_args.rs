//! The options of PSF files: how they are read, and how samples become a model.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use psf_basis::{Centring, PixelNoise, RankSelection};
use psf_io::{HduChoice, PlaneOrder};
use psf_types::{Interpolation, Normalisation, OutsidePolicy, Position};
use psfield::{FitChoices, FitOptions, Psf, PsfFileOptions, PsfieldError};

use crate::UsageError;
use crate::context::Context;
use crate::values::{above_zero, at_least_zero, number, numbers};

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
    pub(crate) fit: FitArgs,
    #[command(flatten)]
    pub(crate) file: PsfFileArgs,
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
    /// The files that are read for the PSF of a file.
    pub(crate) fn files<'a>(&'a self, psf: &'a Path) -> Vec<&'a Path> {
        std::iter::once(psf)
            .chain(self.file.psf_positions.as_deref())
            .collect()
    }

    /// Opens any PSF file and tells how it was read.
    pub(crate) fn open(&self, path: &Path, context: &Context) -> anyhow::Result<Psf> {
        let psf = Psf::open_with(path, &self.file.options()?, &self.fit.choices()).map_err(as_usage)?;
        for note in psf.notes() {
            context.note(&format!("{}: {note}", path.display()));
        }
        Ok(psf)
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

/// What a PSF file does not say of itself, or leaves to be chosen.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "PSF file options")]
pub(crate) struct PsfFileArgs {
    /// PSFEx: which of several models; STPSF, STDPSF and plain stamps: which of several images; by the number of the HDU (0 for the
    /// primary, 1 for the first extension) or its EXTNAME
    #[arg(long, value_name = "N|NAME")]
    pub(crate) psf_extension: Option<HduChoice>,
    /// STDPSF: which of several detectors
    #[arg(long, value_name = "N", value_parser = detector)]
    psf_detector: Option<usize>,
    /// STPSF: planes lie where their cards say (cards), or are sorted by y, then x, as since 2023-12-11 (sorted); auto: by the
    /// file's version or date [default: auto]
    #[arg(long, value_name = "auto|cards|sorted")]
    psf_order: Option<PlaneOrder>,
    /// ScopeSim: the PSFs for the wavelength nearest to this one, in micrometres
    #[arg(long, value_name = "UM", value_parser = above_zero, allow_negative_numbers = true)]
    psf_wavelength: Option<f64>,
    /// ScopeSim: the size of a frame pixel
    #[arg(long, value_name = "ARCSEC", value_parser = above_zero, allow_negative_numbers = true)]
    pixel_scale: Option<f64>,
    /// ScopeSim: where the centre of the PSF's field lies on the frame, 0-based
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    field_centre: Option<Point>,
    /// Cube without positions: where its planes belong, CSV or FITS table with columns x, y (0-based pixels), one row a plane
    #[arg(long, value_name = "POSITIONS.csv")]
    psf_positions: Option<PathBuf>,
    /// Cube or single stamp without positions: stamp pixels per frame pixel
    #[arg(long, value_name = "S", value_parser = above_zero, allow_negative_numbers = true)]
    psf_oversampling: Option<f64>,
    /// Cube or single stamp without positions: the pixel of a stamp where the PSF's centre lies, 0-based [default: as the file says
    /// (CENX, CENY), or NX / 2, NY / 2 rounded down]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    psf_centre: Option<Point>,
    /// Whether the response of a frame pixel is in the stamps [default: as the file says, or its format]
    #[arg(long, value_name = "included|missing", value_enum)]
    pixel_response: Option<PixelResponse>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum PixelResponse {
    Included,
    Missing,
}

/// `X,Y`, finite.
#[derive(Debug, Clone, Copy)]
struct Point(Position);

impl FromStr for Point {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        match numbers::<f64>(text).as_deref() {
            Some(&[x, y]) => Position::new(x, y).map(Self).map_err(|e| e.to_string()),
            _ => Err("two numbers are needed, as in 2047.5,2047.5".to_owned()),
        }
    }
}

fn detector(text: &str) -> Result<usize, String> {
    number(text, |&detector| detector > 0, "a whole number above 0")
}

impl PsfFileArgs {
    /// Reads the positions where there are any.
    fn options(&self) -> anyhow::Result<PsfFileOptions> {
        Ok(PsfFileOptions {
            extension: self.psf_extension.clone(),
            detector: self.psf_detector,
            plane_order: self.psf_order,
            wavelength_um: self.psf_wavelength,
            pixel_scale_arcsec: self.pixel_scale,
            field_centre: self.field_centre.map(|point| point.0),
            positions: self
                .psf_positions
                .as_ref()
                .map(psf_io::read_positions)
                .transpose()?,
            oversampling: self.psf_oversampling,
            centre: self.psf_centre.map(|point| point.0),
            pixel_response_included: self
                .pixel_response
                .map(|response| matches!(response, PixelResponse::Included)),
        })
    }
}
