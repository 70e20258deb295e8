//! `psfield sample`: samples the PSF of a telescope, or makes samples from the stars of a frame.

mod frame;
mod telescope;

use std::path::{Path, PathBuf};

use psf_io::FileKind;
use psf_sample::SamplingOptions;
use psf_types::PsfSamples;

use crate::UsageError;
use crate::context::{Context, write_samples};
use crate::files::OutputFile;
use crate::old_names;
use crate::star_args::{MaskArgs, StarArgs};

use frame::FrameArgs;
use telescope::TelescopeArgs;

pub(crate) use frame::{warn_of, write_coverage};
pub(crate) use telescope::Preset;

/// Sample the PSF of a telescope over its field, or of the stars in a real frame
///
/// A telescope file (TOML) is sampled where kriging (Gaussian process regression) expects the largest
/// error. Each PSF is predicted before it is drawn, until errors are at most --threshold. Then random PSFs
/// verify the result (--verify). Where the PSF is not smooth, a mesh takes over, which is refined until
/// its criterion holds. Samples always cover the corners of the frame.
///
/// A frame (FITS) is sampled at its own stars: psfield subtracts the background, detects and
/// selects stars, and registers them to sub-pixel precision. The content of the file decides
/// whether it is a telescope file or a frame.
///
/// psfield demo writes an example of a telescope file (telescope.toml).
///
/// Examples:
///
/// psfield sample --preset survey-2m -o samples.fits
///
/// psfield sample frame.fits -o samples.fits --gain 1.5 --sources sources.csv
///
/// psfield sample telescope.toml -o samples.fits --hold-out 200
#[derive(Debug, clap::Args)]
pub(crate) struct SampleArgs {
    /// Telescope file (aperture, wavefront over the field, seeing, detector), or image with stars
    #[arg(value_name = "TELESCOPE.toml|FRAME.fits", required_unless_present = "preset")]
    input: Option<PathBuf>,
    /// Samples to write
    #[arg(short, long, value_name = "SAMPLES.fits")]
    output: OutputFile,
    /// Replace outputs that exist
    #[arg(long)]
    overwrite: bool,
    /// Also write N PSFs that are not samples to SAMPLES_holdout.fits, for psfield validate
    ///
    /// Telescope: PSFs at random positions between the samples. Frame: N of the stars, with their
    /// noise. These stars are left out of the samples. Undersampled stars of the method epsf
    /// (--registration) cannot be held out.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    hold_out: Option<u16>,
    /// Seed that chooses the PSFs of --hold-out and --verify [default: {seed}]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    #[command(flatten)]
    telescope: TelescopeArgs,
    #[command(flatten)]
    frame: FrameArgs,
    #[command(flatten)]
    stars: StarArgs,
    #[command(flatten)]
    mask: MaskArgs,
}

impl SampleArgs {
    pub(crate) fn run(mut self, context: &Context) -> anyhow::Result<()> {
        match self.input.clone() {
            Some(path) if is_frame(&path, self.stars.extension.is_some())? => {
                let mut given = context.given.of_group::<TelescopeArgs>();
                if let (Some(threshold), None) = (self.telescope.threshold, self.stars.detection_threshold) {
                    context.note(&old_names::note(
                        "--threshold of a frame",
                        "--detection-threshold",
                    ));
                    self.stars.detection_threshold = Some(threshold);
                    given.retain(|option| option != "--threshold");
                }
                refuse(&given, "a frame", "telescopes")?;
                self.frame.run(&path, &self, context)
            }
            _ => {
                let given = [
                    context.given.of_group::<FrameArgs>(),
                    context.given.of_group::<StarArgs>(),
                    context.given.of_group::<MaskArgs>(),
                ];
                refuse(&given.concat(), "a telescope", "frames")?;
                self.telescope.run(&self, context)
            }
        }
    }

    /// The seed, unless nothing is random (`what` says why).
    fn seed(&self, is_random: bool, what: &str) -> Result<u64, UsageError> {
        if self.seed.is_some() && !is_random && self.hold_out.is_none() {
            return Err(UsageError(format!(
                "--seed chooses the PSFs of --hold-out, which is not given, {what}"
            )));
        }
        Ok(self.seed.unwrap_or(SamplingOptions::default().seed))
    }

    /// The file of --hold-out, next to the output. `None` without this option.
    pub(crate) fn hold_out_file(&self) -> Option<PathBuf> {
        self.hold_out.map(|_| self.output.beside("holdout"))
    }

    /// Writes the samples, and the PSFs of --hold-out if there are any.
    fn write(&self, samples: &PsfSamples, held_out: Option<&PsfSamples>) -> anyhow::Result<()> {
        psf_io::write_together(|| -> anyhow::Result<()> {
            if let (Some(path), Some(held_out)) = (self.hold_out_file(), held_out) {
                write_samples(&path, held_out, self.overwrite)?;
            }
            Ok(write_samples(&self.output, samples, self.overwrite)?)
        })
    }

    /// A line of text about the PSFs of --hold-out. Empty if there are none.
    fn held_out_text(&self, held_out: Option<&PsfSamples>) -> String {
        self.hold_out_file()
            .zip(held_out)
            .map_or_else(String::new, |(path, held_out)| {
                let path = path.display();
                format!(
                    "\n{path}: {} PSFs that are not samples, for psfield validate --reference",
                    held_out.len()
                )
            })
    }
}

/// Returns whether a file is a frame with stars rather than a telescope file. If the user has
/// `chosen` an HDU, every FITS file counts as a frame. Otherwise, FITS files of other kinds are an
/// error.
fn is_frame(path: &Path, chosen: bool) -> anyhow::Result<bool> {
    match psf_io::detect(path) {
        Ok(FileKind::Image) => Ok(true),
        Ok(FileKind::NotFits) => Ok(false),
        Ok(_) if chosen => Ok(true),
        Ok(kind) => anyhow::bail!(
            "{} is {kind}: give a telescope file (TOML) or a frame with stars (a single image [y, x])",
            path.display()
        ),
        Err(error) => Err(error.into()),
    }
}

/// Refuses given options that apply only to inputs of another kind (`kind`).
fn refuse(given: &[String], input: &str, kind: &str) -> Result<(), UsageError> {
    match given.first() {
        None => Ok(()),
        Some(option) => Err(UsageError(format!(
            "{option} applies only to {kind}, but the input is {input}: leave this option out"
        ))),
    }
}
