//! `psfield sample TELESCOPE.toml`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use psf_optics::Telescope;
use psf_sample::{
    AdaptiveSampling, DifferenceMeasure, InterpolationError, NeighbourDifference, RefinementCriterion,
    SampleError, Sampling, SamplingMethod, SamplingOutcome, UniformSampling,
};
use psf_types::PsfSource;
use serde::Serialize;

use crate::cli::UsageError;
use crate::cli::context::{Context, signature};
use crate::cli::values::Pair;

/// Options for telescopes.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Telescopes")]
pub(super) struct TelescopeArgs {
    /// A telescope that comes with the program
    #[arg(long, value_enum, conflicts_with = "input")]
    pub(super) preset: Option<Preset>,
    /// What must stay below the threshold: the difference of neighbouring samples, or the error of interpolating between them
    /// [default: neighbours]
    #[arg(long, value_enum)]
    criterion: Option<Criterion>,
    /// The norm in which PSFs are compared [default: l2]
    #[arg(long, value_enum)]
    measure: Option<Measure>,
    /// Samples along each axis of the coarse grid that refinement starts from [default: 5,5]
    #[arg(long, value_name = "NX,NY", allow_hyphen_values = true)]
    start: Option<Pair>,
    /// Stop with an error when the criterion needs more samples [default: 20000]
    #[arg(long, value_name = "N")]
    max_samples: Option<usize>,
    /// Write the samples drawn so far when that happens, with a warning
    #[arg(long)]
    accept_cap: bool,
    /// A uniform grid of NX by NY samples instead
    #[arg(long, value_name = "NX,NY", conflicts_with_all = ["criterion", "threshold", "start", "max_samples", "accept_cap"])]
    uniform: Option<Pair>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub(super) enum Preset {
    /// 2 m off-axis survey telescope, 0.074 arcsec per pixel, 9232 x 9216
    #[value(name = "survey-2m")]
    Survey2m,
    /// Under-sampled wide-field lens, 11.7 arcsec per pixel, 4096 x 4096
    WideFieldLens,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Criterion {
    Neighbours,
    Interpolation,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Measure {
    L1,
    L2,
}

#[derive(Debug, Serialize)]
struct Report {
    output: PathBuf,
    samples: usize,
    /// PSFs drawn: samples, and points at which only the criterion looked.
    draws: usize,
    cells: usize,
    unmet_cells: usize,
    worst: f64,
    threshold: Option<f64>,
    outcome: &'static str,
}

/// What is asked for.
pub(super) struct TelescopeSampling<'a> {
    /// None for a preset.
    pub(super) path: Option<&'a Path>,
    pub(super) threshold: Option<f64>,
    pub(super) output: PathBuf,
    pub(super) overwrite: bool,
}

impl TelescopeArgs {
    /// The first option given that only telescopes have.
    pub(super) fn given(&self) -> Option<&'static str> {
        [
            ("--preset", self.preset.is_some()),
            ("--criterion", self.criterion.is_some()),
            ("--measure", self.measure.is_some()),
            ("--start", self.start.is_some()),
            ("--max-samples", self.max_samples.is_some()),
            ("--accept-cap", self.accept_cap),
            ("--uniform", self.uniform.is_some()),
        ]
        .into_iter()
        .find_map(|(name, given)| given.then_some(name))
    }

    pub(super) fn run(&self, asked: TelescopeSampling<'_>, context: &Context) -> anyhow::Result<()> {
        let telescope = match (asked.path, self.preset) {
            (Some(path), _) => Telescope::from_toml_file(path)?,
            (None, Some(Preset::WideFieldLens)) => Telescope::wide_field_lens(),
            (None, _) => Telescope::survey_2m(),
        };
        let threshold = asked.threshold.unwrap_or(NeighbourDifference::DEFAULT_THRESHOLD);
        let sampling = self.draw(&telescope, threshold, context)?;
        let cards = signature();
        psf_io::write_samples(
            &asked.output,
            &sampling.samples,
            &cards,
            psf_io::Precision::Single,
            asked.overwrite,
        )?;
        let found = &sampling.report;
        let report = Report {
            output: asked.output,
            samples: sampling.samples.len(),
            draws: found.draws,
            cells: found.cells,
            unmet_cells: found.unmet_cells,
            worst: found.worst,
            threshold: found.threshold,
            outcome: match found.outcome {
                SamplingOutcome::Met => "met",
                SamplingOutcome::CellSizeReached => "cell-size-reached",
                SamplingOutcome::CapReached => "cap-reached",
                _ => "unknown",
            },
        };
        if report.unmet_cells > 0 {
            let why = match report.outcome {
                "cap-reached" => format!(": {} samples were drawn, the most allowed", report.samples),
                _ => String::new(),
            };
            context.warn(&format!(
                "the criterion does not hold in {} of {} cells (worst {:.2e}){why}",
                report.unmet_cells, report.cells, report.worst
            ));
        }
        context.report(&report, || {
            let limit = report
                .threshold
                .map_or_else(String::new, |t| format!(" (threshold {t})"));
            format!(
                "{}: {} samples, {} PSFs drawn, worst {:.2e}{limit}",
                report.output.display(),
                report.samples,
                report.draws,
                report.worst
            )
        })
    }

    fn draw(&self, telescope: &Telescope, threshold: f64, context: &Context) -> anyhow::Result<Sampling> {
        let measure = match self.measure {
            Some(Measure::L1) => DifferenceMeasure::L1,
            Some(Measure::L2) | None => DifferenceMeasure::L2,
        };
        let bar = context.bar("sampling");
        if let Some(Pair(nx, ny)) = self.uniform {
            psfield::check_stack(nx.saturating_mul(ny), telescope.grid())
                .map_err(|e| UsageError(format!("--uniform: {e}")))?;
            return Ok(UniformSampling::new(nx, ny)?
                .with_measure(measure)
                .sample(telescope, &bar)?);
        }
        let criterion: Arc<dyn RefinementCriterion> = match self.criterion {
            Some(Criterion::Neighbours) | None => Arc::new(NeighbourDifference::new(threshold, measure)?),
            Some(Criterion::Interpolation) => Arc::new(InterpolationError::new(threshold, measure)?),
        };
        let Pair(nx, ny) = self.start.unwrap_or(Pair(5, 5));
        let max_samples = self.max_samples.unwrap_or(AdaptiveSampling::DEFAULT_MAX_SAMPLES);
        let sampling = AdaptiveSampling::new(criterion)
            .with_start(nx, ny)
            .map_err(|e| UsageError(format!("--start: {e}")))?
            .with_max_samples(max_samples);
        if max_samples < nx * ny {
            let (max, start) = (max_samples, nx * ny);
            let what = format!(
                "--max-samples {max} is less than the {start} samples of the starting grid (--start {nx},{ny})"
            );
            return Err(UsageError(what).into());
        }
        match sampling.sample(telescope, &bar) {
            Err(SampleError::CapReached(cap)) if self.accept_cap => Ok(cap.into_sampling()),
            Err(SampleError::CapReached(cap)) => Err(anyhow::anyhow!(
                "{cap} (--max-samples, --threshold, --accept-cap)"
            )),
            other => Ok(other?),
        }
    }
}
