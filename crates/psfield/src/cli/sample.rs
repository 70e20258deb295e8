//! `psfield sample`.

use std::path::PathBuf;
use std::sync::Arc;

use psf_optics::Telescope;
use psf_sample::{
    AdaptiveSampling, DifferenceMeasure, InterpolationError, NeighbourDifference, RefinementCriterion,
    SampleError, Sampling, SamplingMethod, SamplingOutcome, UniformSampling,
};
use psf_types::PsfSource;
use serde::Serialize;

use super::UsageError;
use super::context::{Context, signature};
use super::values::{Pair, above_zero};

/// Sample the PSF of a telescope over its field
///
/// Non-uniform by default: refined where the PSF varies, until the criterion holds everywhere. Corners and edges are always covered.
#[derive(Debug, clap::Args)]
pub(crate) struct SampleArgs {
    /// The telescope: aperture, wavefront over the field, seeing, detector
    #[arg(value_name = "TELESCOPE.toml", required_unless_present = "preset")]
    telescope: Option<PathBuf>,
    /// A telescope that comes with the program
    #[arg(long, value_enum, conflicts_with = "telescope")]
    preset: Option<Preset>,
    /// The samples to write
    #[arg(short, long, value_name = "SAMPLES.fits")]
    output: PathBuf,
    /// Replace the output if it exists
    #[arg(long)]
    overwrite: bool,
    /// What must stay below the threshold: the difference of neighbouring samples, or the error of interpolating between them
    #[arg(long, default_value = "neighbours", value_enum)]
    criterion: Criterion,
    /// The threshold, relative
    #[arg(long, value_name = "X", default_value_t = NeighbourDifference::DEFAULT_THRESHOLD, value_parser = above_zero, allow_negative_numbers = true)]
    threshold: f64,
    /// The norm in which PSFs are compared
    #[arg(long, default_value = "l2", value_enum)]
    measure: Measure,
    /// Samples along each axis of the coarse grid that refinement starts from
    #[arg(long, value_name = "NX,NY", default_value = "5,5", allow_hyphen_values = true)]
    start: Pair,
    /// Stop with an error when the criterion needs more samples
    #[arg(long, value_name = "N", default_value_t = AdaptiveSampling::DEFAULT_MAX_SAMPLES)]
    max_samples: usize,
    /// Write the samples drawn so far when that happens, with a warning
    #[arg(long)]
    accept_cap: bool,
    /// A uniform grid of NX by NY samples instead
    #[arg(long, value_name = "NX,NY", conflicts_with_all = ["criterion", "threshold", "start", "max_samples", "accept_cap"])]
    uniform: Option<Pair>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Preset {
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

impl SampleArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        psf_io::check_output(&self.output, self.overwrite)?;
        let telescope = match (&self.telescope, self.preset) {
            (Some(path), _) => Telescope::from_toml_file(path)?,
            (None, Some(Preset::WideFieldLens)) => Telescope::wide_field_lens(),
            (None, _) => Telescope::survey_2m(),
        };
        let sampling = self.draw(&telescope, context)?;
        let cards = signature();
        psf_io::write_samples(
            &self.output,
            &sampling.samples,
            &cards,
            psf_io::Precision::Single,
            self.overwrite,
        )?;
        let found = &sampling.report;
        let report = Report {
            output: self.output,
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

    fn draw(&self, telescope: &Telescope, context: &Context) -> anyhow::Result<Sampling> {
        let measure = match self.measure {
            Measure::L1 => DifferenceMeasure::L1,
            Measure::L2 => DifferenceMeasure::L2,
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
            Criterion::Neighbours => Arc::new(NeighbourDifference::new(self.threshold, measure)?),
            Criterion::Interpolation => Arc::new(InterpolationError::new(self.threshold, measure)?),
        };
        let Pair(nx, ny) = self.start;
        let sampling = AdaptiveSampling::new(criterion)
            .with_start(nx, ny)
            .map_err(|e| UsageError(format!("--start: {e}")))?
            .with_max_samples(self.max_samples);
        if self.max_samples < nx * ny {
            let (max, start) = (self.max_samples, nx * ny);
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
