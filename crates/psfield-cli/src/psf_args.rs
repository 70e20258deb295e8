//! Options for reading PSF files, and for fitting a model to samples.

use std::path::{Path, PathBuf};

use clap::builder::{PossibleValuesParser, TypedValueParser};
use psf_basis::{Centring, PixelNoise, RankSelection};
use psf_io::{HduChoice, PlaneOrder};
use psf_types::{Interpolation, Normalisation, OutsidePolicy, Position};
use psfield::{ErrorKind, FitChoices, FitOptions, Psf, PsfFileOptions, PsfieldError, WingsSource};

use crate::UsageError;
use crate::context::{Context, with_option, without_option};
use crate::values::{above_zero, number, numbers};

/// The heading of the fit options in help texts.
pub(crate) const FIT_HEADING: &str = "Fit options (if the PSF is a model: only --outside and --normalise)";

/// The settings of a fit. The short help hides them, except in `psfield fit`.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = FIT_HEADING)]
pub(crate) struct FitArgs {
    /// Components to keep: auto, elbow, full, a number, energy=F or error=E [default: auto]
    ///
    /// auto: up to the elbow of the singular values, then more until the fit error of every
    /// sample, and that of its flux in circles about the source, is at most 1e-4 and a quarter
    /// of the error of interpolation. Of components below the noise, only those that vary
    /// smoothly over the field.
    /// elbow: up to the elbow, and none below the noise.
    /// full: all. For thousands of samples this takes much more time and memory than the others.
    /// energy=F: enough for the fraction F of the sum of squared singular values (energy=0.999).
    /// error=E: enough for a fit error (relative L2) of at most E for every sample (error=1e-3).
    /// Default for STPSF and STDPSF: full.
    #[arg(long, value_name = "RANK", hide_short_help = true, verbatim_doc_comment)]
    rank: Option<RankSelection>,
    /// Subtract the mean stamp before the decomposition (mean) or not (none) [default: mean]
    #[arg(long, value_name = "mean|none", hide_short_help = true)]
    centring: Option<Centring>,
    /// The noise of the samples. Only `psfield fit` has an option for it.
    #[arg(skip)]
    pub(crate) sample_noise: Option<f64>,
    /// The number of shifted copies of each sample. Only `psfield fit` has an option for it.
    #[arg(skip)]
    pub(crate) shift_copies: Option<usize>,
    /// Interpolation of the coefficients over the field [default: auto]
    ///
    /// auto, kriging (Gaussian process regression), delaunay, natural-neighbour, idw, idw=POWER
    /// (inverse distance weighting), bilinear, bicubic, polynomial=D or nearest.
    /// auto: kriging or a local method (bicubic on a regular grid, else natural-neighbour),
    /// whichever predicts the samples better from each other. idw means idw=2.
    /// kriging=KERNEL,LENGTH_X,LENGTH_Y,TREND,NUGGET: with these parameters. Kernels: gaussian,
    /// matern52, matern32, thin-plate, cubic, quintic.
    /// bilinear and bicubic need samples on a regular grid. D: degree, at most 20.
    /// Default for STPSF and STDPSF: bilinear on a regular grid, else natural-neighbour.
    /// Default for a single stamp: nearest.
    #[arg(long, value_name = "METHOD", hide_short_help = true, verbatim_doc_comment)]
    interpolation: Option<Interpolation>,
    /// PSF outside the samples: nearest, extend or error [default: nearest]
    ///
    /// nearest: the PSF at the nearest point of the area that the samples cover. extend: continue
    /// the interpolation linearly (kriging, idw, polynomial and nearest continue by their own formulas).
    /// error: stop with an error.
    ///
    /// Default for models: as stored in the file. Default for PSFEx: extend.
    #[arg(long, value_name = "POLICY", hide_short_help = true)]
    outside: Option<OutsidePolicy>,
    /// Scale every PSF to unit flux (unit), or keep the values (keep) [default: unit]
    ///
    /// Default for models: as stored in the file. Default for STPSF and STDPSF: keep.
    #[arg(long, value_name = "unit|keep", hide_short_help = true)]
    normalise: Option<Normalisation>,
}

/// A PSF file: settings for reading it, and for fitting a model if it holds samples.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct PsfArgs {
    #[command(flatten)]
    pub(crate) fit: FitArgs,
    #[command(flatten)]
    pub(crate) file: PsfFileArgs,
}

impl FitArgs {
    /// The options that were given. The others take the default of the file's format.
    pub(crate) fn choices(&self) -> FitChoices {
        FitChoices {
            rank: self.rank,
            centring: self.centring,
            noise: self.sample_noise.map(PixelNoise::Known),
            interpolation: self.interpolation,
            outside: self.outside,
            normalisation: self.normalise,
            shift_copies: self.shift_copies,
        }
    }

    /// The options that were given, completed by the defaults for samples.
    pub(crate) fn options(&self) -> FitOptions {
        self.choices().or(FitOptions::default())
    }
}

impl PsfArgs {
    /// Opens any PSF file and prints notes on how it was read.
    pub(crate) fn open(&self, path: &Path, context: &Context) -> anyhow::Result<Psf> {
        let psf = Psf::open_with(path, &self.file.options()?, &self.fit.choices()).map_err(as_usage)?;
        for note in notes_of(&psf) {
            context.note(&format!("{}: {note}", path.display()));
        }
        Ok(psf)
    }
}

/// The notes on how a PSF was read. A note that reports a choice ends with the option that changes
/// it, if there is one.
pub(crate) fn notes_of(psf: &Psf) -> Vec<String> {
    let notes = psf.notes().iter();
    notes.map(|note| with_option(note, note.setting())).collect()
}

/// Turns errors about options that do not suit the file into usage errors.
fn as_usage(error: PsfieldError) -> anyhow::Error {
    match error.kind() {
        ErrorKind::Setting => UsageError(with_option(&error, error.setting())).into(),
        _ => error.into(),
    }
}

/// Facts that a PSF file does not state, and choices that it leaves open.
#[derive(Debug, Clone, Default, PartialEq, clap::Args)]
#[command(next_help_heading = "PSF file options")]
pub(crate) struct PsfFileArgs {
    /// HDU of the PSF: its number (0: primary, 1: first extension) or EXTNAME (required if
    /// several HDUs hold PSFs)
    ///
    /// PSFEx: one of several models (of a table with a model in each row, as of legacypipe: CCDNAME or
    /// the number of the row from 0). STPSF, STDPSF and plain stamps: one of several images.
    #[arg(long, value_name = "N|NAME", hide_short_help = true)]
    pub(crate) psf_extension: Option<HduChoice>,
    /// PSFEx: values of the quantities on which the PSF depends besides the position, as in
    /// MAG_AUTO=18
    #[arg(long, value_name = "NAME=VALUE,...", value_parser = context_value, value_delimiter = ',', hide_short_help = true)]
    psf_context: Vec<(String, f64)>,
    /// STDPSF: number of the detector, from 1 (required if the file has several detectors)
    #[arg(long, value_name = "N", value_parser = detector, hide_short_help = true)]
    psf_detector: Option<usize>,
    /// STPSF: order of the planes [default: auto]
    ///
    /// cards: each plane is at the position in its header card (DET_YXn).
    /// sorted: planes are sorted by y, then x, as STPSF writes them since 2023-12-11.
    /// auto: cards or sorted, as the header says (PLANEORD, else VERSION, else DATE).
    #[arg(
        long,
        value_name = "auto|cards|sorted",
        hide_short_help = true,
        verbatim_doc_comment
    )]
    psf_order: Option<PlaneOrder>,
    /// STPSF, STDPSF: leave out planes without positive flux [default: such a plane is an error]
    ///
    /// If the other planes do not form a regular grid, the default of --interpolation is
    /// natural-neighbour.
    #[arg(long, hide_short_help = true)]
    psf_skip_invalid: bool,
    /// Use the PSF at this wavelength (micrometres), if it depends on the wavelength
    ///
    /// PSF samples and models: between the wavelengths of the samples, the PSF is interpolated.
    /// ScopeSim: the nearest wavelength of the file is taken. Not with --bandpass, which needs all
    /// wavelengths.
    #[arg(long, value_name = "UM", value_parser = above_zero, hide_short_help = true)]
    psf_wavelength: Option<f64>,
    /// Use the PSF at this time (seconds), if it depends on the time
    #[arg(long, value_name = "S", allow_hyphen_values = true, hide_short_help = true)]
    psf_time: Option<f64>,
    /// Use the PSF of this frame (its number), if it depends on the frame
    ///
    /// `psfield fit` numbers its sample files from 0.
    #[arg(long, value_name = "N", hide_short_help = true)]
    psf_frame: Option<u32>,
    /// ScopeSim: size of a frame pixel (arcsec, required)
    #[arg(long, value_name = "ARCSEC", value_parser = above_zero, hide_short_help = true)]
    pixel_scale: Option<f64>,
    /// ScopeSim: where the centre of the PSF's field lies on the frame (0-based pixels, required)
    #[arg(long, value_name = "X,Y", value_parser = position, allow_hyphen_values = true, hide_short_help = true)]
    field_centre: Option<Position>,
    /// Cube without positions: table of the positions of its planes (required for several planes)
    ///
    /// CSV or FITS table with columns x, y (0-based pixels), one row per plane.
    #[arg(long, value_name = "POSITIONS.csv", hide_short_help = true)]
    psf_positions: Option<PathBuf>,
    /// Cube or single stamp without positions: stamp pixels per frame pixel, below 1 for stamps
    /// coarser than the frame [default: card OVERSAMP, else required]
    #[arg(long, value_name = "S", value_parser = above_zero, hide_short_help = true)]
    psf_oversampling: Option<f64>,
    /// Cube or single stamp without positions: centre of the PSF in a stamp (0-based stamp pixels)
    ///
    /// Default: CENX, CENY of the header, else NX / 2, NY / 2 rounded down.
    #[arg(long, value_name = "X,Y", value_parser = position, allow_hyphen_values = true, hide_short_help = true)]
    psf_centre: Option<Position>,
    /// Integration over the area of a frame pixel: included in the stamps, or missing from them
    /// [default: as the header or the format says]
    ///
    /// If it is missing, psfield integrates the PSF over each pixel.
    #[arg(long, value_name = "included|missing", value_parser = pixel_response(), hide_short_help = true)]
    pixel_response: Option<bool>,
    /// Join wings to the PSF: FILE, or power=EXPONENT,RADIUS (pixels of the frame)
    ///
    /// FILE: a PSF of any format, such as an image with a large stamp or an STPSF library with a large
    /// field of view, or a radial profile (.csv, .txt, .dat: radius in pixels, and the light there in any
    /// unit). The wings are scaled to the light of the PSF where both meet, and PSFs keep their flux.
    #[arg(long, value_name = "WINGS", hide_short_help = true)]
    wings: Option<WingsSource>,
}

/// The parser of `--pixel-response`. True if it is included.
fn pixel_response() -> impl TypedValueParser<Value = bool> {
    PossibleValuesParser::new(["included", "missing"]).map(|response| response == "included")
}

/// Parses a position `X,Y` of finite numbers.
fn position(text: &str) -> Result<Position, String> {
    match numbers::<f64>(text).as_deref() {
        Some(&[x, y]) => Position::new(x, y).map_err(|e| e.to_string()),
        _ => Err("two numbers are needed, as in 2047.5,2047.5".to_owned()),
    }
}

/// Parses the name and the value of a quantity on which a PSF depends.
fn context_value(text: &str) -> Result<(String, f64), String> {
    let parts = text.split_once('=');
    let value = parts.and_then(|(name, value)| Some((name.trim(), value.trim().parse::<f64>().ok()?)));
    match value {
        Some((name, value)) if !name.is_empty() && value.is_finite() => Ok((name.to_owned(), value)),
        _ => Err("a name and a number are needed, as in MAG_AUTO=18".to_owned()),
    }
}

fn detector(text: &str) -> Result<usize, String> {
    number(text, |&detector| detector > 0, "a whole number above 0")
}

impl PsfFileArgs {
    /// Builds the options, and reads the table of positions if one is given.
    fn options(&self) -> anyhow::Result<PsfFileOptions> {
        Ok(PsfFileOptions {
            extension: self.psf_extension.clone(),
            contexts: self.psf_context.clone(),
            detector: self.psf_detector,
            plane_order: self.psf_order,
            skip_invalid: self.psf_skip_invalid,
            wavelength_um: self.psf_wavelength,
            time_s: self.psf_time,
            frame_number: self.psf_frame.map(f64::from),
            pixel_scale_arcsec: self.pixel_scale,
            field_centre: self.field_centre,
            positions: self
                .psf_positions
                .as_ref()
                .map(psf_io::read_positions)
                .transpose()
                .map_err(without_option)?,
            oversampling: self.psf_oversampling,
            centre: self.psf_centre,
            pixel_response_included: self.pixel_response,
            wings: self.wings.clone(),
        })
    }
}
