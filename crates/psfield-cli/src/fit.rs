//! `psfield fit`.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Context as _;
use psf_io::FileKind;
use psfield::fit::{FitReport, InterpolationErrors};
use psfield::{FitOptions, Psf};

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
    ///
    /// Several files get one basis. If their samples have no wavelength, time or frame, each file is
    /// a frame, numbered from 0 in the given order: `--psf-frame N` then chooses one.
    #[arg(value_name = "SAMPLES.fits", required = true)]
    samples: Vec<PathBuf>,
    /// Model to write
    #[arg(short, long, value_name = "MODEL.fits")]
    output: OutputFile,
    /// Replace the output if it exists
    #[arg(long)]
    overwrite: bool,
    /// Also compare all interpolations: predict every sample from the others with each of them
    ///
    /// A table of the errors is printed, the best first. The model does not depend on it.
    #[arg(long, conflicts_with = "basis")]
    compare: bool,
    #[command(flatten)]
    fit: PsfArgs,
    /// Noise per pixel of the samples (standard deviation) [default: estimated]
    ///
    /// SIGMA has the unit of the samples after --normalise has scaled them. --rank auto and elbow
    /// leave out what may be this noise. 0: no noise.
    #[arg(long, value_name = "SIGMA", value_parser = at_least_zero, help_heading = FIT_HEADING)]
    sample_noise: Option<f64>,
    /// Compute the basis also from N copies of each sample, shifted by up to half a pixel [default: 0]
    ///
    /// Such a basis also represents stars between pixels, as in the paper. psfield itself does not
    /// need it: it shifts stamps when it draws stars.
    #[arg(long, value_name = "N", help_heading = FIT_HEADING)]
    shift_augment: Option<usize>,
    /// Keep the basis of this model, and find only the coefficients of the samples
    ///
    /// The mean and the components are unchanged, so that models of many frames share them. The
    /// stamps of the samples must have the pixels of the model's stamps.
    #[arg(
        long,
        value_name = "MODEL.fits",
        conflicts_with_all = ["rank", "centring", "sample_noise", "shift_augment"],
        help_heading = FIT_HEADING
    )]
    basis: Option<PathBuf>,
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
        self.fit.fit.shift_copies = self.shift_augment;
        let spinner = context.spinner("fitting");
        let psf = self.open(context)?;
        let in_file = || match &self.samples[..] {
            [file] => format!("in {}", file.display()),
            files => format!("in {} and {} more files", files[0].display(), files.len() - 1),
        };
        let (samples, options) = psf.samples().expect("PSF samples were opened");
        let own_fit;
        let fitted = match &self.basis {
            None => psf.fit().with_context(in_file)?.expect("samples have a fit"),
            Some(model) => {
                let model = Psf::open(model)?;
                own_fit = psfield::fit::fit_in_basis(samples.clone(), model.record()?.basis(), options)
                    .with_context(in_file)?;
                &own_fit
            }
        };
        let report = fitted.report().with_context(in_file)?;
        fitted.write(&self.output, &signature(), self.overwrite)?;
        let compared = if self.compare {
            psfield::fit::compare_interpolations(samples.clone(), options).with_context(in_file)?
        } else {
            Vec::new()
        };
        drop(spinner);
        if report.rank == 0 && report.max_error > WORTH_A_COMPONENT {
            context.warn(&format!(
                "the model keeps no component, so its PSF is the same everywhere, but the samples differ from it by up to {:.1e} \
                 (relative L2): check --sample-noise and --rank",
                report.max_error
            ));
        }
        report.warnings.iter().for_each(|warning| context.warn(warning));
        let report = Compared { report, compared };
        context.report(&report, || {
            text(&report.report, &self.output.display().to_string()) + &table(&report.compared)
        })
    }

    /// Opens the samples of all files.
    fn open(&self, context: &Context) -> anyhow::Result<Psf> {
        let mut opened = Vec::with_capacity(self.samples.len());
        for path in &self.samples {
            let psf = self.fit.open(path, context)?;
            if psf.samples().is_none() {
                match psf.kind() {
                    Some(kind) if kind != FileKind::PsfModel => anyhow::bail!(
                        "{} holds {kind}, which needs no fit: give it directly to simulate or evaluate, or convert it to a model file \
                         (psfield convert --to psf-model)",
                        path.display()
                    ),
                    _ => anyhow::bail!(
                        "{} is a fitted model already: give it to simulate or evaluate, or fit its samples again",
                        path.display()
                    ),
                }
            }
            opened.push(psf);
        }
        if let [_] = &opened[..] {
            return Ok(opened.remove(0));
        }
        let (samples, options): (Vec<_>, Vec<&FitOptions>) = opened.iter().filter_map(Psf::samples).unzip();
        let names: Vec<_> = self
            .samples
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        Ok(Psf::new(
            psfield::psf::join_samples(&samples, &names)?,
            *options[0],
        ))
    }
}

/// The report of a fit with that of --compare.
#[derive(serde::Serialize)]
struct Compared {
    #[serde(flatten)]
    report: FitReport,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    compared: Vec<InterpolationErrors>,
}

/// The table of --compare. Empty if nothing was compared.
fn table(compared: &[InterpolationErrors]) -> String {
    let mut table = String::new();
    if !compared.is_empty() {
        table.push_str("\nerrors of predicting samples from the others (relative L2):\n    median   largest  interpolation\n");
    }
    for errors in compared {
        let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |v| format!("{v:.2e}"));
        let left_out = &errors.leave_one_out;
        let (median, max) = (number(left_out.median), number(left_out.max));
        // Writing to a string does not fail.
        let _ = writeln!(table, "    {median:<8} {max:<8} {}", errors.interpolation);
    }
    table
}

fn text(report: &FitReport, output: &str) -> String {
    let left_out = &report.leave_one_out;
    let noise = match report.noise_sigma {
        _ if report.singular_values.is_empty() => "not estimated (given basis)".to_owned(),
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
    let of_states = match (&report.depends_on, &report.states[..]) {
        (Some(kind), [first, .., last]) => {
            format!(
                " at {} values of the {kind} ({first} to {last})",
                report.states.len()
            )
        }
        _ => String::new(),
    };
    let reason = match report.interpolation_reason.as_str() {
        "" => String::new(),
        reason => format!("interpolation:  {reason}\n"),
    };
    let expected = report.expected_error.map_or_else(String::new, |error| {
        format!("expected:       {error:.2e} (relative L2, r.m.s. over the field, as kriging predicts)\n")
    });
    let wings = report.wings.as_ref().map_or_else(String::new, |wings| {
        let [least, most] = wings.flux.map(|part| 100.0 * part);
        format!(
            "wings:          {} stamps around a core of {} pixels hold {least:.2} to {most:.2} % of the flux, error {:.1e} (relative \
             to the light at the same distance, r.m.s.)\n",
            wings.modes, wings.core_size, wings.error
        )
    });
    format!(
        "{output}: {} samples{of_states}, {} components (elbow at {}), {} interpolation\n\
         {reason}{wings}\
         noise:          {noise}\n\
         fit error:      largest {:.2e}, r.m.s. {:.2e} (relative L2 of a sample), in circles {} of the flux\n\
         leave-one-out:  {interpolation_error} (relative L2; each sample is predicted from the others, over about twice the spacing)\n\
         {expected}",
        report.samples,
        report.rank,
        report.elbow.map_or_else(|| "-".to_owned(), |e| e.to_string()),
        report.interpolation,
        report.max_error,
        report.rms_error,
        report
            .circle_error
            .map_or_else(|| "-".to_owned(), |error| format!("{error:.2e}")),
    )
}
