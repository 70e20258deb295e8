//! `psfield convert`.

use std::path::PathBuf;

use anyhow::Context as _;
use psfield::Psf;
use psfield::convert::{PsfFormat, SamplesAt, is_on_grid};

use super::UsageError;
use super::context::{Context, object, signature};
use super::files::OutputFile;
use super::values::{Precision, pair};
use crate::psf_args::{PsfArgs, notes_of};
use crate::table_args::TableArgs;

/// Convert a PSF file to another format
///
/// Reads psfield's own PSF samples and models, PSF files of PSFEx, STPSF, STDPSF and ScopeSim, and
/// plain stamps (an image or a cube).
///
/// Examples:
///
/// psfield convert model.fits -o model.psf --to psfex=8
///
/// psfield convert model.fits -o library.fits --to gridded --grid 21,21
#[derive(Debug, clap::Args)]
pub(crate) struct ConvertArgs {
    /// PSF to read
    #[arg(value_name = "PSF")]
    input: PathBuf,
    /// File to write
    #[arg(short, long, value_name = "OUTPUT")]
    output: OutputFile,
    /// Format: psf-samples, psf-model, psfex=DEGREE or gridded [default: psfex if OUTPUT ends in
    /// .psf, else required]
    ///
    /// psf-samples and psf-model are psfield's own FITS files. psfex=DEGREE is a PSFEx file, a
    /// polynomial in x and y of degree 0 to 10. psfex without DEGREE keeps the degree of a model
    /// that is a polynomial, and is an error for other PSFs. gridded is a FITS library of PSFs on a
    /// regular grid of positions, which photutils reads.
    #[arg(long, value_name = "FORMAT", value_parser = target)]
    to: Option<Target>,
    /// Replace the output if it exists
    #[arg(long)]
    overwrite: bool,
    /// For psf-samples and gridded: evaluate on NX x NY positions over the field [default: the
    /// PSF's own positions]
    ///
    /// For gridded, a PSF keeps its own positions only if it is interpolated between them on a
    /// regular grid (bilinear or bicubic). For other PSFs, the default is a square grid of at least
    /// 11 x 11 positions.
    #[arg(long, value_name = "NX,NY", value_parser = pair, conflicts_with = "at")]
    grid: Option<(usize, usize)>,
    /// For psf-samples and gridded: evaluate at the positions of this table
    ///
    /// CSV or FITS table with columns x, y (0-based pixels). gridded needs a regular grid.
    #[arg(long, value_name = "POSITIONS.csv")]
    at: Option<PathBuf>,
    #[command(flatten)]
    table: TableArgs,
    /// For psf-samples: precision of the stamps [default: f32]
    #[arg(long, value_enum)]
    precision: Option<Precision>,
    #[command(flatten)]
    fit: PsfArgs,
}

/// The format to write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Target {
    PsfSamples,
    PsfModel,
    /// A polynomial of this total degree. `None`: the degree of the PSF's own polynomial.
    Psfex(Option<usize>),
    Gridded,
}

/// Parses the format to write.
fn target(text: &str) -> Result<Target, String> {
    match text.split_once('=') {
        None if text == "psf-samples" => Ok(Target::PsfSamples),
        None if text == "psf-model" => Ok(Target::PsfModel),
        None if text == "psfex" => Ok(Target::Psfex(None)),
        None if text == "gridded" => Ok(Target::Gridded),
        Some(("psfex", degree)) => match degree.parse() {
            Ok(degree) if degree <= psf_io::PsfexPolynomial::MAX_DEGREE => Ok(Target::Psfex(Some(degree))),
            _ => Err("the degree of a PSFEx model must be 0 to 10".to_owned()),
        },
        _ => Err("psf-samples, psf-model, psfex=DEGREE or gridded is needed".to_owned()),
    }
}

impl Target {
    fn name(self) -> &'static str {
        match self {
            Self::PsfSamples => "psf-samples",
            Self::PsfModel => "psf-model",
            Self::Psfex(_) => "psfex",
            Self::Gridded => "gridded",
        }
    }

    /// The kind of planes that the written file holds, for messages.
    fn planes(self) -> &'static str {
        match self {
            Self::PsfSamples | Self::Gridded => "stamps",
            Self::PsfModel => "components",
            Self::Psfex(_) => "polynomial terms",
        }
    }
}

/// The largest number of positions of `--grid`. A larger number is probably a typing error, and
/// would take very long.
const MAX_POSITIONS: usize = 1 << 16;

impl ConvertArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        let target = self.target()?;
        self.check_usage(target)?;
        TableArgs::check(self.at.as_deref(), &context.given)?;
        let at = match (self.grid, &self.at) {
            (Some((nx, ny)), _) => {
                if nx.saturating_mul(ny) > MAX_POSITIONS {
                    let what = format!("--grid {nx},{ny}: at most {MAX_POSITIONS} positions are possible");
                    return Err(UsageError(what).into());
                }
                SamplesAt::Grid { nx, ny }
            }
            (None, Some(path)) => {
                SamplesAt::Positions(psf_io::read_positions_with(path, &self.table.options())?)
            }
            (None, None) => SamplesAt::Own,
        };
        let psf = self.fit.open(&self.input, context)?;
        self.check_fit_options(target, &at, &psf)?;
        let spinner = context.spinner("converting");
        let mut notes = notes_of(&psf);
        let format = match target {
            Target::PsfSamples => PsfFormat::Samples {
                at,
                precision: self.precision.unwrap_or_default().into(),
            },
            Target::PsfModel => PsfFormat::Model,
            Target::Psfex(degree) => PsfFormat::Psfex { degree },
            Target::Gridded => PsfFormat::Gridded { at },
        };
        let written = psf
            .write(&self.output, &format, &signature(), self.overwrite)
            .with_context(|| match &self.at {
                Some(at) => format!("{} at the positions of {}", self.input.display(), at.display()),
                None => format!("with the PSF of {}", self.input.display()),
            })?;
        drop(spinner);
        for note in &written.notes {
            context.note(&format!("{}: {note}", self.output.display()));
        }
        notes.extend(written.notes);
        let mut max_error = written.max_error;
        if let (Target::PsfModel, Some(fit)) = (target, psf.fit()?) {
            max_error = Some(fit.report()?.max_error);
        }
        let (planes, what, grid) = (written.planes, target.planes(), written.grid);
        let (nx, ny) = (grid.nx(), grid.ny());
        let report = object! {
            output: self.output,
            format: target.name(),
            planes,
            shape: [nx, ny],
            oversampling: grid.oversampling(),
            max_error,
            notes,
        };
        context.report(&report, || {
            let error = match max_error {
                Some(error) => format!("\nlargest error:  {error:.2e} (relative L2, against the input)"),
                None => String::new(),
            };
            format!(
                "{}: {}, {planes} {what} of {nx} x {ny} pixels, {:.6} pixels per frame pixel{error}",
                report.output.display(),
                report.format,
                report.oversampling,
            )
        })
    }

    fn target(&self) -> anyhow::Result<Target> {
        let says_psfex = || {
            let extension = self.output.extension()?.to_str()?;
            extension
                .eq_ignore_ascii_case("psf")
                .then_some(Target::Psfex(None))
        };
        self.to.or_else(says_psfex).ok_or_else(|| {
            let what =
                "the output format is missing: give --to psf-samples, psf-model, psfex=DEGREE or gridded";
            UsageError(what.to_owned()).into()
        })
    }

    /// Refuses options that the target format does not use.
    fn check_usage(&self, target: Target) -> Result<(), UsageError> {
        let takes_positions = matches!(target, Target::PsfSamples | Target::Gridded);
        let what = if !takes_positions && (self.grid.is_some() || self.at.is_some()) {
            "--grid and --at apply only to psf-samples and gridded: models hold no PSFs at positions"
        } else if target != Target::PsfSamples && self.precision.is_some() {
            "--precision applies only to psf-samples: psf-model and gridded are written in f64, psfex in f32"
        } else {
            return Ok(());
        };
        Err(UsageError(what.to_owned()))
    }

    /// Refuses fit options that this conversion does not use.
    fn check_fit_options(&self, target: Target, at: &SamplesAt, psf: &Psf) -> Result<(), UsageError> {
        let choices = self.fit.fit.choices();
        let given = choices.needs_fit() || choices.outside.is_some();
        let is_model = psf.samples().is_none();
        let what = match target {
            Target::Gridded if given && *at == SamplesAt::Own && !is_model && is_on_grid(psf) => {
                "without --grid or --at, samples on a regular grid are copied and not fitted: of the fit options only \
                 --normalise applies"
            }
            Target::PsfSamples if given && *at == SamplesAt::Own && !is_model => {
                "without --grid or --at, the samples are copied and not fitted: of the fit options only --normalise applies"
            }
            Target::Psfex(_) if is_model && (given || choices.normalisation.is_some()) => {
                "a PSFEx file cannot store --outside or --normalise: its polynomial extends outside the samples, and its readers scale the PSF to unit flux"
            }
            Target::Psfex(_) if given => {
                "the polynomial of a PSFEx file is fitted to the samples directly: of the fit options only --normalise applies"
            }
            _ => return Ok(()),
        };
        Err(UsageError(what.to_owned()))
    }
}
