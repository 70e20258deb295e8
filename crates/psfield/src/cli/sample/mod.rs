//! `psfield sample`.

mod frame;
mod telescope;

use std::path::{Path, PathBuf};

use psf_io::FileKind;

use super::UsageError;
use super::context::Context;
use super::star_args::StarArgs;
use super::values::above_zero;
use frame::{FrameArgs, FrameSampling};
pub(crate) use frame::{warn_of, write_coverage};
use telescope::{TelescopeArgs, TelescopeSampling};

/// Sample a PSF: of a telescope over its field, or of the stars of a real frame
///
/// A telescope (TOML) is sampled non-uniformly by default: refined where the PSF varies, until the criterion holds everywhere; corners and
/// edges are always covered. A frame (FITS) gives samples at its own stars: background, detection, cuts, registration to sub-pixel
/// precision. What the file is, its content tells.
#[derive(Debug, clap::Args)]
pub(crate) struct SampleArgs {
    /// The telescope (aperture, wavefront over the field, seeing, detector), or an image with stars
    #[arg(value_name = "TELESCOPE.toml|FRAME.fits", required_unless_present = "preset")]
    input: Option<PathBuf>,
    /// The samples to write
    #[arg(short, long, value_name = "SAMPLES.fits")]
    output: PathBuf,
    /// Replace outputs that exist
    #[arg(long)]
    overwrite: bool,
    /// Telescopes: the criterion's threshold, relative [default: 0.01]. Frames: the detection threshold in sigma [default: 5]
    #[arg(long, value_name = "X", value_parser = above_zero, allow_negative_numbers = true)]
    threshold: Option<f64>,
    #[command(flatten)]
    telescope: TelescopeArgs,
    #[command(flatten)]
    frame: FrameArgs,
    #[command(flatten)]
    stars: StarArgs,
}

impl SampleArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        psf_io::check_output(&self.output, self.overwrite)?;
        match &self.input {
            Some(path) if is_frame(path, self.stars.chooses_extension())? => {
                refuse(self.telescope.given(), "a frame", "telescopes")?;
                let asked = FrameSampling {
                    path,
                    threshold: self.threshold,
                    output: &self.output,
                    overwrite: self.overwrite,
                };
                self.frame.run(&self.stars, asked, context)
            }
            _ => {
                refuse(self.frame.given().or(self.stars.given()), "a telescope", "frames")?;
                let asked = TelescopeSampling {
                    path: self.input.as_deref(),
                    threshold: self.threshold,
                    output: self.output,
                    overwrite: self.overwrite,
                };
                self.telescope.run(asked, context)
            }
        }
    }
}

/// Whether a file holds an image rather than text. Where an HDU was `chosen`, the others do not matter.
fn is_frame(path: &Path, chosen: bool) -> anyhow::Result<bool> {
    match psf_io::detect(path) {
        Ok(FileKind::Image) => Ok(true),
        // What cannot be read the reader of telescopes tells of, as it does of any text file.
        Ok(FileKind::NotFits) | Err(psf_io::IoError::Read { .. }) => Ok(false),
        Ok(_) if chosen => Ok(true),
        Ok(kind) => anyhow::bail!(
            "{} is {kind}: a frame is a single image [y, x] with stars",
            path.display()
        ),
        Err(error) => Err(error.into()),
    }
}

/// Options of the other kind of input are bad usage.
fn refuse(given: Option<&str>, input: &str, kind: &str) -> Result<(), UsageError> {
    match given {
        None => Ok(()),
        Some(option) => Err(UsageError(format!(
            "{option} is for {kind}, but the input is {input}: leave it out"
        ))),
    }
}
