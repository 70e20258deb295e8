//! `psfield validate`.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use psf_io::FileKind;
use psfield::PsfInput;
use psfield::report::{Software, Validation};
use serde::Serialize;

use super::UsageError;
use super::context::{Context, command_text};
use super::fit_args::PsfArgs;
use super::report_folder::ReportFolder;
use super::reproduce::targets_text;
use super::star_args::StarArgs;

/// Compare a PSF model with PSFs that are known, or with the stars of a frame
///
/// FWHM, ellipticity, MAE and MSE of the model at the positions of the true PSFs, with the same figures as `reproduce`. Of a frame, every
/// star that is good enough is compared with the model's, drawn at its measured position with its measured flux.
#[derive(Debug, clap::Args)]
pub(crate) struct ValidateArgs {
    /// A model, samples to be fitted, or any other PSF file (PSFEx, STPSF, STDPSF, ScopeSim, plain stamps)
    #[arg(value_name = "MODEL")]
    model: PathBuf,
    /// What is true: PSF samples (or a gridded library), or an image with stars
    #[arg(long, value_name = "SAMPLES|FRAME")]
    truth: PathBuf,
    #[command(flatten)]
    folder: ReportFolder,
    /// Of a frame: measure stars in N x N pixels [default: four FWHM, at least 7]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(5..))]
    window: Option<u16>,
    #[command(flatten)]
    fit: PsfArgs,
}

#[derive(Debug, Serialize)]
struct Report<'a> {
    folder: &'a Path,
    files: Vec<String>,
    /// How the PSF was read.
    notes: Vec<String>,
    #[serde(flatten)]
    measured: &'a Validation,
}

impl ValidateArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        self.folder.check()?;
        let opened = self.fit.opened(&self.model, context)?;
        let spinner = context.spinner("validating");
        let model = opened
            .input
            .into_model()
            .with_context(|| format!("with the PSF of {}", self.model.display()))?;
        let of_truth = || format!("against {}", self.truth.display());
        let measured = match psf_io::detect(&self.truth)? {
            FileKind::Image => {
                let (frame, _, sampling) = StarArgs::default().open(&self.truth, None)?;
                Validation::of_frame(&model, &frame, &sampling, self.window.map(usize::from))
                    .with_context(of_truth)?
            }
            _ => match PsfInput::open(&self.truth, psfield::FitOptions::default())? {
                PsfInput::Samples(samples, _) => {
                    if self.window.is_some() {
                        let text = "--window is for frames: PSFs are compared on all their pixels";
                        return Err(UsageError(text.to_owned()).into());
                    }
                    Validation::of_samples(&model, &samples).with_context(of_truth)?
                }
                PsfInput::Model(_) => anyhow::bail!(
                    "{}: this is a model; give true PSFs as samples (psfield evaluate writes those of a model)",
                    self.truth.display()
                ),
            },
        };
        let inputs = vec![
            ("PSF model".to_owned(), self.model.display().to_string()),
            ("truth".to_owned(), self.truth.display().to_string()),
        ];
        let document = measured.document(inputs, Software::of_command(command_text()))?;
        let tables = [("objects.csv", measured.objects.rows.as_slice())];
        let files = self.folder.write(&document, &measured, &tables)?;
        drop(spinner);
        let folder = self.folder.path();
        let report = Report {
            folder,
            files,
            notes: opened.notes,
            measured: &measured,
        };
        context.report(&report, || {
            let summary = &measured.objects.summary;
            let line = |name: &str, spread: Option<psfield::report::Spread>| {
                spread.map_or_else(String::new, |s| {
                    format!("{name}: 90 % below {:.1e}, largest {:.1e}\n", s.q90, s.largest)
                })
            };
            format!(
                "{} objects compared, {} failed\n{}{}{}{}{}: begin with report.html",
                summary.objects,
                summary.failed,
                line("difference of ellipticity", summary.ellipticity),
                line("difference of FWHM, pixels", summary.fwhm_px),
                line("MAE / mean", summary.mae_over_mean),
                targets_text(&measured.targets),
                folder.display()
            )
        })
    }
}
