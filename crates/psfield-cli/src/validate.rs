//! `psfield validate`.

use std::path::PathBuf;

use anyhow::Context as _;
use psf_io::FileKind;
use psfield::Psf;
use psfield_lab::report::{Software, Validation};

use super::UsageError;
use super::context::{Context, command_text, with_window_hint};
use super::report_folder::ReportFolder;
use super::reproduce::targets_text;
use super::star_args::{MaskArgs, StarArgs};
use crate::psf_args::{PsfArgs, notes_of};

/// Compare a PSF model with known PSFs, or with the stars of a frame
///
/// Measures FWHM, eccentricity, mean absolute error (MAE) and mean squared error (MSE) at the
/// positions of the true PSFs, and draws the same figures as psfield reproduce.
///
/// The truth should not contain the PSFs from which the model was made: psfield sample --hold-out
/// writes PSFs for this purpose. A warning counts the PSFs of the truth that lie closer than half a
/// pixel to a sample of the model. A PSFEx file does not contain the positions of its samples, so
/// it gives no warning.
///
/// For a frame, psfield selects stars as psfield sample does by default. With the model, it draws
/// each star at the measured position and with the measured flux. It compares the drawn star with
/// the star in the frame.
#[derive(Debug, clap::Args)]
pub(crate) struct ValidateArgs {
    /// PSF: a model, samples (which are fitted), or any PSF file that convert reads
    #[arg(value_name = "MODEL")]
    model: PathBuf,
    /// Truth: PSF samples (or a gridded library), or an image with stars
    #[arg(long, value_name = "SAMPLES|FRAME")]
    truth: PathBuf,
    #[command(flatten)]
    folder: ReportFolder,
    /// For a frame: measure stars in N x N pixels [default: four FWHM, at least 7]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(5..))]
    window: Option<u16>,
    #[command(flatten)]
    mask: MaskArgs,
    #[command(flatten)]
    fit: PsfArgs,
}

impl ValidateArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        self.folder.check()?;
        let psf = self.fit.open(&self.model, context)?;
        let spinner = context.spinner("validating");
        let model = psf
            .model()
            .with_context(|| format!("with the PSF of {}", self.model.display()))?;
        let of_truth = || format!("against {}", self.truth.display());
        let measured = match psf_io::detect(&self.truth)? {
            FileKind::Image => {
                let (frame, sampling) = StarArgs::default().open_masked(&self.truth, None, &self.mask)?;
                Validation::of_frame(model, frame, &sampling, self.window.map(usize::from))
                    .map_err(with_window_hint)
                    .with_context(of_truth)?
            }
            _ => match Psf::open(&self.truth)?.samples() {
                Some((samples, _)) => {
                    if let Some(option) = self.window.map(|_| "--window").or(self.mask.given()) {
                        let text =
                            format!("{option} applies only to frames: PSFs are compared on all their pixels");
                        return Err(UsageError(text).into());
                    }
                    Validation::of_samples(model, samples).with_context(of_truth)?
                }
                None => anyhow::bail!(
                    "{} is a model, but the truth must be samples or a frame (psfield evaluate writes samples of a model)",
                    self.truth.display()
                ),
            },
        };
        // The nodes of a PSFEx model are not the stars from which it was made.
        let measured = match psf.record() {
            Ok(record) if psf.kind() != Some(FileKind::Psfex) => {
                measured.with_training(record.coefficients().positions().as_slice())
            }
            _ => measured,
        };
        if measured.at_samples > 0 {
            context.warn(&format!(
                "{} of {} objects of {} lie at positions of the samples from which {} was made: their errors do not show the error between \
                 the samples (psfield sample --hold-out N writes PSFs that are not samples)",
                measured.at_samples,
                measured.objects.summary.objects,
                self.truth.display(),
                self.model.display()
            ));
        }
        let inputs = vec![
            ("PSF model", self.model.display().to_string()),
            ("truth", self.truth.display().to_string()),
        ];
        let document = measured.document(inputs, Software::of_command(command_text()))?;
        let tables = [("objects.csv", measured.objects.rows.as_slice())];
        let of_psf = (&measured, Some(notes_of(&psf)));
        let speaking = (context, spinner);
        self.folder
            .publish(&document, of_psf, &tables, speaking, |folder| {
                let summary = &measured.objects.summary;
                let line = |name: &str, spread: Option<psfield_lab::report::Spread>| {
                    spread.map_or_else(String::new, |s| {
                        format!("{name}: 90 % below {:.1e}, largest {:.1e}\n", s.q90, s.largest)
                    })
                };
                format!(
                    "{} objects compared, {} could not be measured\n{}{}{}{}{}{}{folder}: open report.html first",
                    summary.objects,
                    summary.failed,
                    line("difference of eccentricity sqrt(1 - b^2/a^2)", summary.eccentricity),
                    line("difference of e1 (distortion)", summary.e1),
                    line("difference of e2 (distortion)", summary.e2),
                    line("difference of FWHM (pixels of the frame)", summary.fwhm_px),
                    line("MAE / mean of the window", summary.mae_over_mean),
                    targets_text(&measured.targets),
                )
            })
    }
}
