//! `psfield validate`.

mod round_trip;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use psf_io::FileKind;
use psfield::Psf;
use psfield_lab::report::{Software, Spread, Validation};

use crate::UsageError;
use crate::context::{Context, command_text, object, with_window_hint, without_option};
use crate::psf_args::{PsfArgs, PsfFileArgs, notes_of};
use crate::report_folder::{self, ReportFolder};
use crate::reproduce::targets_text;
use crate::star_args::{MaskArgs, StarArgs};

/// Compare a PSF with known PSFs or with the stars of a frame
///
/// With --reference, measures FWHM, eccentricity, mean absolute error (MAE) and mean squared error
/// (MSE) at the positions of the reference, and draws the same figures as psfield reproduce.
/// If the reference holds PSFs, psfield also compares the errors with its own accuracy targets,
/// which are meant for PSFs without noise. The exit status does not depend on these targets.
///
/// The reference should not contain the PSFs from which the model was made: psfield sample
/// --hold-out writes PSFs for this purpose. A warning counts the PSFs or stars of the reference
/// that lie closer than half a pixel to a sample of the model. For a PSFEx file there is no
/// warning, because the file does not hold the positions of its samples.
///
/// If the reference is a frame, psfield selects its stars as psfield sample does. With the model,
/// it draws each star at the measured position and with the measured flux. It compares the drawn
/// star with the star in the frame.
///
/// Without --reference, the input is an image with stars, and psfield makes a round trip: it makes
/// PSF samples from the stars, fits a model, and simulates the frame with all sources found, at
/// their measured positions and fluxes, on the measured background. Then it compares the stars in
/// the frame with the simulated stars.
///
/// A round trip simulates the frame several times (--realisations), each time with other noise,
/// because noise widens the distributions of FWHM and eccentricity. The noise is that of the
/// background, and with --gain also the photon noise of the stars. The simulated distributions
/// contain the stars of all simulated frames.
///
/// A round trip also compares the light of isolated stars: the ratio of fluxes simulated / frame
/// within 2.5 FWHM (at least 4 pixels), and the reduced chi-square of frame minus simulation,
/// without noise in the simulation. A star is isolated if no other source lies within 2.5 times
/// that radius. All comparisons are made twice. First, one model made from all stars draws them.
/// Then the stars are divided into five groups, and each group is drawn by a model made from the
/// other four. This second comparison is called left_out, because each model leaves out the stars
/// that it draws.
///
/// The folder of a round trip has tables, the samples, the model, the first simulated frame, the
/// residual, and summary.json in place of a report. Among the keys of summary.json are stars (stars
/// that became PSF samples), measured (stars measured in both the frame and the first simulated
/// frame), drawn (sources drawn into each simulated frame), flux_ratio, reduced_chi_square,
/// left_out (the figures of the second comparison), and residual_over_noise (r.m.s. of the frame
/// minus the first simulated frame, divided by the background noise).
///
/// Examples:
///
/// psfield validate model.fits --reference samples_holdout.fits --report validation
///
/// psfield validate frame.fits --report round_trip
#[derive(Debug, clap::Args)]
pub(crate) struct ValidateArgs {
    /// PSF: a model, samples (which are fitted), or any PSF file that convert reads. Without
    /// --reference: an image with stars
    #[arg(value_name = "PSF|FRAME.fits")]
    input: PathBuf,
    /// Known PSFs (samples or a gridded library), or an image with stars
    #[arg(long, value_name = "SAMPLES|FRAME.fits")]
    reference: Option<PathBuf>,
    #[command(flatten)]
    folder: ReportFolder,
    /// Measure stars in N x N pixels [default: four FWHM, at least 7]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(5..))]
    window: Option<u16>,
    #[command(flatten)]
    trip: round_trip::RoundTripArgs,
    #[command(flatten)]
    stars: StarArgs,
    #[command(flatten)]
    mask: MaskArgs,
    #[command(flatten)]
    psf: PsfArgs,
}

impl ValidateArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        if let Some(reference) = &self.reference {
            return self.compare(reference, context);
        }
        let input = self.input.display();
        let kind = psf_io::detect(&self.input)?;
        // The reader of frames reports files that are no FITS files.
        if !matches!(kind, FileKind::Image | FileKind::NotFits) && self.stars.extension.is_none() {
            let text = format!(
                "{input} is {kind}: without --reference, the input must be an image with stars. To check a PSF, give known PSFs or a frame (--reference)"
            );
            return Err(UsageError(text).into());
        }
        if self.psf.file != PsfFileArgs::default() {
            let text =
                format!("PSF file options need --reference: without it, {input} is an image with stars");
            return Err(UsageError(text).into());
        }
        self.trip.run(&self, context)
    }

    /// Compares the PSF with a reference.
    fn compare(&self, reference: &Path, context: &Context) -> anyhow::Result<()> {
        self.folder.check(&report_folder::FILES)?;
        let psf = self.psf.open(&self.input, context)?;
        let spinner = context.spinner("validating");
        let model = psf
            .model()
            .with_context(|| format!("with the PSF of {}", self.input.display()))?;
        let of_truth = || format!("against {}", reference.display());
        let measured = match psf_io::detect(reference)? {
            kind if kind == FileKind::Image || self.stars.extension.is_some() => {
                let (frame, _, sampling) = self.stars.open(reference, &self.mask)?;
                Validation::of_frame(model, frame, &sampling, self.window.map(usize::from))
                    .map_err(with_window_hint)
                    .with_context(of_truth)?
            }
            _ => match Psf::open(reference).map_err(without_option)?.samples() {
                Some((samples, _)) => {
                    let mut given = context.given.of_group::<MaskArgs>();
                    given.extend(context.given.of_group::<StarArgs>());
                    let window = self.window.map(|_| "--window".to_owned());
                    if let Some(option) = window.as_ref().or(given.first()) {
                        let text =
                            format!("{option} applies only to frames: PSFs are compared on all their pixels");
                        return Err(UsageError(text).into());
                    }
                    Validation::of_samples(model, samples).with_context(of_truth)?
                }
                None => anyhow::bail!(
                    "{} is a model, but the reference must be samples or a frame (psfield evaluate writes samples of a model)",
                    reference.display()
                ),
            },
        };
        // The sample positions of a PSFEx model are nodes of its polynomial, not the stars from
        // which it was made.
        let measured = match psf.record() {
            Ok(record) if psf.kind() != Some(FileKind::Psfex) => {
                measured.with_training(record.coefficients().positions().as_slice())
            }
            _ => measured,
        };
        if let Some(count @ 1..) = measured.at_samples {
            context.warn(&format!(
                "{count} of {} objects in {} lie within half a pixel of a sample of {}: errors there do not show how well the model interpolates \
                 between its samples (psfield sample --hold-out N also writes N PSFs that are not samples: use these as the reference)",
                measured.objects.summary.objects,
                reference.display(),
                self.input.display()
            ));
        }
        let inputs = vec![
            ("PSF model", self.input.display().to_string()),
            ("reference", reference.display().to_string()),
        ];
        let tables = [("objects.csv", measured.objects.rows.as_slice())];
        let document = measured.document(inputs, Software::of_command(command_text()));
        let files = self
            .folder
            .write(&tables, document, &measured, || measured.sections())?;
        drop(spinner);
        let report = object! {
            folder: self.folder.report.as_path(),
            files,
            notes: notes_of(&psf),
            #[serde(flatten)]
            measured: &measured,
        };
        context.report(&report, || {
            let summary = &measured.objects.summary;
            let lines = [
                (
                    "difference of eccentricity sqrt(1 - b^2/a^2)",
                    summary.eccentricity,
                ),
                ("difference of e1 (distortion)", summary.e1),
                ("difference of e2 (distortion)", summary.e2),
                ("difference of FWHM (pixels of the frame)", summary.fwhm_px),
                ("MAE / mean of the window", summary.mae_over_mean),
            ]
            .map(|(name, spread)| {
                let text =
                    |s: Spread| format!("{name}: 90 % below {:.1e}, largest {:.1e}\n", s.q90, s.largest);
                spread.map_or_else(String::new, text)
            });
            format!(
                "{} objects compared, {} could not be measured\n{}{}{}: open report.html first",
                summary.objects,
                summary.failed,
                lines.concat(),
                targets_text(&measured.targets),
                report.folder.display(),
            )
        })
    }
}
