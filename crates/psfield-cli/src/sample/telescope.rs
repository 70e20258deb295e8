//! `psfield sample` of a telescope.

use std::path::Path;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use psf_optics::{OpticsError, Telescope};
use psf_sample::{
    Criterion, DifferenceMeasure, Refinement, SampleError, Sampling, SamplingOptions, SamplingOutcome,
    Verification, hold_out,
};
use psf_types::{Position, PsfSamples, PsfSource, StateKind};

use super::SampleArgs;
use crate::UsageError;
use crate::context::{Context, object};
use crate::values::{above_zero, pair};

/// The parser of `--method`.
fn method() -> impl TypedValueParser<Value = Refinement> {
    let values = [
        PossibleValue::new("kriging").help("Where kriging expects the largest error"),
        PossibleValue::new("mesh").help("A grid, refined where the quantity of --criterion is too large"),
    ];
    PossibleValuesParser::new(values).try_map(|text| text.parse::<Refinement>())
}

/// The parser of `--criterion`.
fn criterion() -> impl TypedValueParser<Value = Criterion> {
    let values = [
        PossibleValue::new("interpolation").help("Error of interpolating between samples"),
        PossibleValue::new("neighbours")
            .help("Difference of neighbouring samples, as in Bai, Jia et al. (needs many more samples)"),
    ];
    PossibleValuesParser::new(values).try_map(|text| text.parse::<Criterion>())
}

/// The parser of `--measure`.
fn measure() -> impl TypedValueParser<Value = DifferenceMeasure> {
    PossibleValuesParser::new(["l1", "l2"]).try_map(|text| text.parse::<DifferenceMeasure>())
}

/// Options that apply only to telescopes.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Only for a telescope")]
pub(super) struct TelescopeArgs {
    /// Use a built-in telescope instead of a file
    #[arg(long, value_enum, conflicts_with = "input")]
    preset: Option<Preset>,
    /// Way to choose positions [default: {method}, or mesh with --criterion or --start]
    #[arg(long, value_parser = method())]
    method: Option<Refinement>,
    /// Largest error of a predicted PSF, as a fraction of its norm [default: {threshold}]
    #[arg(long, value_name = "X", value_parser = above_zero)]
    pub(super) threshold: Option<f64>,
    /// Norm in which PSFs are compared [default: {measure}]
    #[arg(long, value_parser = measure(), hide_short_help = true)]
    measure: Option<DifferenceMeasure>,
    /// PSFs drawn at random at the end, to verify the threshold (0: none) [default: {verify}]
    #[arg(long, value_name = "N")]
    verify: Option<u16>,
    /// For the method mesh: quantity that must not exceed --threshold [default: {criterion}]
    #[arg(long, value_parser = criterion(), hide_short_help = true)]
    criterion: Option<Criterion>,
    /// For the method mesh: coarse grid from which refinement starts [default: {start},{start}]
    #[arg(long, value_name = "NX,NY", value_parser = pair, allow_hyphen_values = true, hide_short_help = true)]
    start: Option<(usize, usize)>,
    /// Stop with an error if more PSFs must be drawn [default: {max_draws}]
    #[arg(long, value_name = "N")]
    max_draws: Option<usize>,
    /// If --threshold is not met, write the samples drawn so far, with a warning
    #[arg(long, hide_short_help = true)]
    accept_cap: bool,
    /// Sample a regular grid of NX x NY positions, without --threshold
    #[arg(
        long,
        value_name = "NX,NY",
        value_parser = pair,
        conflicts_with_all = ["method", "criterion", "threshold", "verify", "start", "max_draws", "accept_cap"]
    )]
    uniform: Option<(usize, usize)>,
    /// Draw the PSF at these wavelengths, two or more (micrometres)
    ///
    /// Diffraction and seeing depend on the wavelength. The positions are chosen at the telescope's own
    /// wavelength. A scene in colour then needs --bandpass in `psfield simulate`.
    #[arg(long, value_name = "UM,UM,...", value_parser = above_zero, value_delimiter = ',', conflicts_with = "hold_out")]
    wavelengths: Vec<f64>,
}

/// A telescope that comes with the program.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub(crate) enum Preset {
    /// 2 m off-axis survey telescope, 0.074 arcsec per pixel, 9232 x 9216
    #[value(name = "survey-2m")]
    Survey2m,
    /// Under-sampled wide-field lens, 11.7 arcsec per pixel, 4096 x 4096
    WideFieldLens,
}

impl Preset {
    pub(crate) fn telescope(self) -> Telescope {
        match self {
            Self::Survey2m => Telescope::survey_2m(),
            Self::WideFieldLens => Telescope::wide_field_lens(),
        }
    }
}

impl TelescopeArgs {
    pub(super) fn run(&self, asked: &SampleArgs, context: &Context) -> anyhow::Result<()> {
        let telescope = match (&asked.input, self.preset) {
            (Some(path), _) => {
                Telescope::from_toml_file(path).map_err(|error| not_a_telescope(path, error))?
            }
            (None, preset) => preset.unwrap_or(Preset::Survey2m).telescope(),
        };
        let named = |error: anyhow::Error| match &asked.input {
            Some(path) if error.is::<SampleError>() => {
                error.context(format!("with the telescope of {}", path.display()))
            }
            _ => error,
        };
        if let [_] = self.wavelengths[..] {
            const ONE: &str =
                "--wavelengths needs two or more wavelengths: for one, set wavelength_nm of the telescope";
            return Err(UsageError(ONE.to_owned()).into());
        }
        let options = self.options(asked)?;
        let mut sampling = self.draw(&telescope, &options, context).map_err(named)?;
        if !self.wavelengths.is_empty() {
            let at = sampling.samples.positions().as_slice().to_vec();
            sampling.samples = self.draw_wavelengths(&telescope, &at, context)?;
        }
        let positions = sampling.samples.positions();
        let held_out = asked.hold_out.map(|count| {
            let drawn = (usize::from(count), options.seed);
            hold_out(&telescope, positions, drawn, &context.bar("holding out"))
        });
        let held_out = held_out.transpose().map_err(|error| named(error.into()))?;
        let held_out = held_out.as_ref();
        asked.write(&sampling.samples, held_out)?;
        let found = &sampling.report;
        let place = |at: Position| [at.x(), at.y()];
        let report = object! {
            output: &asked.output,
            // The method that ended. A uniform grid has none.
            method: found.refinement.map(|method| method.to_string()),
            samples: sampling.samples.len(),
            hold_out: asked.hold_out_file(),
            held_out: held_out.map(PsfSamples::len),
            // PSFs drawn, random ones included. The mesh also draws PSFs that only its criterion uses.
            draws: if self.wavelengths.is_empty() { found.draws } else { found.draws + sampling.samples.len() },
            cells: found.cells,
            unmet_cells: found.unmet_cells,
            // The largest error measured last, and where.
            worst: found.worst,
            worst_at: found.worst_at.map(place),
            // The largest error that kriging expects.
            expected: found.expected,
            threshold: found.threshold,
            verification: found.verification.map(|random| object! {
                tests: random.tests,
                above: random.above,
                fraction_limit: random.fraction_limit(),
                worst: random.worst,
                worst_at: place(random.worst_at),
                draws: random.draws,
            }),
            outcome: match found.outcome {
                SamplingOutcome::Met => "met",
                SamplingOutcome::CellSizeReached => "cell-size-reached",
                SamplingOutcome::CapReached => "cap-reached",
                _ => "unknown",
            },
        };
        if report.unmet_cells > 0 && report.outcome == "cell-size-reached" && !self.accept_cap {
            context.warn(&format!(
                "the criterion does not hold in {} of {} cells (largest variation {:.2e}): these cells cannot be halved again: \
                 the PSF is probably discontinuous",
                report.unmet_cells, report.cells, report.worst
            ));
        }
        context.report(&report, || {
            let limit = report
                .threshold
                .map_or_else(String::new, |t| format!(" (threshold {t})"));
            format!(
                "{}: {} samples, {} PSFs drawn{}, largest error {:.2e}{limit}{}{}",
                report.output.display(),
                report.samples,
                report.draws,
                found
                    .refinement
                    .map_or_else(String::new, |method| format!(" (method {method})")),
                report.worst,
                found.verification.as_ref().map_or_else(String::new, verified),
                asked.held_out_text(held_out)
            )
        })
    }

    /// Draws the PSF at every wavelength.
    fn draw_wavelengths(
        &self,
        telescope: &Telescope,
        positions: &[Position],
        context: &Context,
    ) -> anyhow::Result<PsfSamples> {
        psfield::stack_size::check_stack(positions.len() * self.wavelengths.len(), telescope.grid())?;
        let telescopes = self.wavelengths.iter().map(|&um| telescope.at_wavelength_um(um));
        let telescopes = telescopes.collect::<Result<Vec<_>, _>>()?;
        let sources: Vec<&dyn PsfSource> = telescopes.iter().map(|t| t as &dyn PsfSource).collect();
        let states = (StateKind::Wavelength, &self.wavelengths[..]);
        let bar = context.bar("drawing wavelengths");
        Ok(psf_sample::draw_states(&sources, states, positions, &bar)?)
    }

    fn options(&self, asked: &SampleArgs) -> Result<SamplingOptions, UsageError> {
        let defaults = SamplingOptions::default();
        let mut options = SamplingOptions {
            refinement: self.method,
            criterion: self.criterion,
            measure: self.measure.unwrap_or(defaults.measure),
            threshold: self.threshold.unwrap_or(defaults.threshold),
            start: self.start,
            max_draws: self.max_draws.unwrap_or(defaults.max_draws),
            verify: self.verify.map(usize::from),
            seed: defaults.seed,
            uniform: self.uniform,
        };
        let verifies = options.uniform.is_none() && options.refinement() == Refinement::Kriging;
        options.seed = asked.seed(verifies, "and of the method kriging, which is not used")?;
        Ok(options)
    }

    fn draw(
        &self,
        telescope: &Telescope,
        options: &SamplingOptions,
        context: &Context,
    ) -> anyhow::Result<Sampling> {
        if let Some((nx, ny)) = options.uniform {
            psfield::stack_size::check_stack(nx.saturating_mul(ny), telescope.grid())
                .map_err(|e| UsageError(format!("--uniform: {e}")))?;
        }
        let refused = |e: SampleError| match (&e, options.uniform) {
            (SampleError::Setting { name, .. }, None) => {
                UsageError(format!("{}: {e}", option_of(name))).into()
            }
            _ => anyhow::Error::from(e),
        };
        let sampling = options.method().map_err(refused)?;
        let bar = context.bar("sampling");
        match sampling.sample(telescope, &bar) {
            Err(SampleError::NotMet(found)) if self.accept_cap => {
                drop(bar);
                context.warn(&found.to_string());
                Ok(found.into_sampling())
            }
            Err(SampleError::NotMet(found)) => Err(anyhow::anyhow!(
                "{found} (options --max-draws, --threshold and --accept-cap)"
            )),
            other => other.map_err(refused),
        }
    }
}

/// The option that sets what a message of sampling names.
fn option_of(name: &str) -> &'static str {
    match name {
        "the criterion" => "--criterion",
        "the number of random tests" => "--verify",
        "the largest number of draws" => "--max-draws",
        _ => "--start",
    }
}

/// A line of text about random tests.
fn verified(random: &Verification) -> String {
    format!(
        "\nverified at random: {} of {} PSFs above the threshold, largest error {:.2e}: with 95 % confidence at most {:.1} % of the field",
        random.above,
        random.tests,
        random.worst,
        100.0 * random.fraction_limit()
    )
}

/// The error of reading a telescope file. If the file's name does not end in `.toml`, the user may
/// have meant a frame, so the message names both kinds.
fn not_a_telescope(path: &Path, error: OpticsError) -> anyhow::Error {
    match error {
        OpticsError::InFile { source, .. } if path.extension().is_none_or(|ending| ending != "toml") => {
            let what = format!(
                "{} is neither a FITS image nor a telescope file (TOML)",
                path.display()
            );
            anyhow::Error::from(*source).context(what)
        }
        error => error.into(),
    }
}
