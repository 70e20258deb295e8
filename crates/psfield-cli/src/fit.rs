//! `psfield fit`.

use std::path::PathBuf;

use anyhow::Context as _;
use psf_io::FileKind;
use psfield::FitReport;
use psfield::convert::PsfFormat;

use super::context::{Context, signature};
use crate::files::OutputFile;
use crate::psf_args::{FIT_HEADING, PsfArgs};
use crate::values::at_least_zero;

/// Fit a PSF model (basis and coefficient fields) to samples
#[derive(Debug, clap::Args)]
#[command(mut_args(for_fit))]
pub(crate) struct FitCommandArgs {
    /// PSF samples, or another PSF file with stamps at positions
    ///
    /// PSF samples are a FITS file with a cube and a table POSITIONS. Files of STPSF and STDPSF
    /// also hold stamps at positions. For a plain cube, --psf-positions gives the positions.
    #[arg(value_name = "SAMPLES.fits")]
    samples: PathBuf,
    /// Model to write
    #[arg(short, long, value_name = "MODEL.fits")]
    output: OutputFile,
    /// Replace the output if it exists
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    fit: PsfArgs,
    /// Noise per pixel of the samples (standard deviation) [default: estimated]
    ///
    /// SIGMA has the unit of the samples after --normalise has scaled them. --rank auto and elbow
    /// drop components below this noise. 0: no noise.
    #[arg(long, value_name = "SIGMA", value_parser = at_least_zero, help_heading = FIT_HEADING)]
    sample_noise: Option<f64>,
}

/// Shows in the short help the options that this command needs most, and hides the options that it
/// does not use.
fn for_fit(arg: clap::Arg) -> clap::Arg {
    match arg.get_id().as_str() {
        // These apply only to files that need no fit.
        "psf_wavelength" | "pixel_scale" | "field_centre" => arg.hide(true),
        "psf_positions" | "psf_oversampling" => arg.hide_short_help(false),
        _ if arg.get_help_heading() == Some(FIT_HEADING) => arg.hide_short_help(false),
        _ => arg,
    }
}

/// The relative L2 error of a sample above which a model without components is suspicious.
const WORTH_A_COMPONENT: f64 = 1e-6;

impl FitCommandArgs {
    pub(crate) fn run(mut self, context: &Context) -> anyhow::Result<()> {
        self.fit.fit.sample_noise = self.sample_noise;
        let spinner = context.spinner("fitting");
        let psf = self.fit.open(&self.samples, context)?;
        let in_file = || format!("in {}", self.samples.display());
        let fitted = match (psf.fit().with_context(in_file)?, psf.kind()) {
            (Some(fitted), _) => fitted,
            (None, Some(kind)) if kind != FileKind::PsfModel => anyhow::bail!(
                "{} holds {kind}, which needs no fit: give it directly to simulate or evaluate, or convert it to a model file \
                 (psfield convert --to psf-model)",
                self.samples.display()
            ),
            (None, _) => anyhow::bail!(
                "{} is a fitted model already: give it to simulate or evaluate, or fit its samples again",
                self.samples.display()
            ),
        };
        let report = fitted.report().with_context(in_file)?;
        psf.write(&self.output, &PsfFormat::Model, &signature(), self.overwrite)?;
        drop(spinner);
        if report.rank == 0 && report.max_error > WORTH_A_COMPONENT {
            context.warn(&format!(
                "the model keeps no component, so its PSF is the same everywhere, but the samples differ from it by up to {:.1e} \
                 (relative L2): check --sample-noise and --rank",
                report.max_error
            ));
        }
        context.report(&report, || text(&report, &self.output.display().to_string()))
    }
}

fn text(report: &FitReport, output: &str) -> String {
    let left_out = &report.leave_one_out;
    let noise = match report.noise_sigma {
        Some(sigma) => format!("sigma {sigma:.3e} per pixel"),
        None => "none found".to_owned(),
    };
    let interpolation_error = match (left_out.median, left_out.max) {
        (Some(median), Some(max)) => format!(
            "median {median:.2e}, largest {max:.2e}, of {} samples",
            left_out.predicted
        ),
        _ => "not measured, because no sample lies between others".to_owned(),
    };
    format!(
        "{output}: {} samples, {} components (elbow at {}), {} interpolation\n\
         noise:          {noise}\n\
         fit error:      largest {:.2e}, r.m.s. {:.2e} (relative L2 of a sample)\n\
         leave-one-out:  {interpolation_error} (relative L2; each sample is left out and interpolated over about twice the spacing)\n",
        report.samples,
        report.rank,
        report.elbow.map_or_else(|| "-".to_owned(), |e| e.to_string()),
        report.interpolation,
        report.max_error,
        report.rms_error,
    )
}
