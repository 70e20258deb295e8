//! The options that turn samples into a model.

use psf_basis::{Centring, PixelNoise, RankSelection};
use psf_types::{Interpolation, Normalisation, OutsidePolicy};
use psfield::{FitOptions, PsfInput};

use super::UsageError;
use super::values::at_least_zero;

/// How samples become a model.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Fit options (for samples)")]
pub(crate) struct FitArgs {
    /// Components to keep: auto, elbow, full, a number, energy=0.999 or error=1e-3. auto: at least the elbow, and as many
    /// more as a fit error of 1e-4 asks, but none below the noise [default: auto]
    #[arg(long, value_name = "RANK")]
    rank: Option<RankSelection>,
    /// Take out the mean stamp (mean) or not (none) [default: mean]
    #[arg(long, value_name = "mean|none")]
    centring: Option<Centring>,
    /// Standard deviation of the noise in the samples' pixels, after normalisation; 0 for none [default: estimated]
    #[arg(long, value_name = "SIGMA", value_parser = at_least_zero, allow_negative_numbers = true)]
    noise: Option<f64>,
    /// auto, delaunay, natural-neighbour, idw, idw=POWER, bilinear, polynomial=D or nearest. auto: bilinear on a regular grid,
    /// else natural neighbour [default: auto]
    #[arg(long, value_name = "METHOD")]
    interpolation: Option<Interpolation>,
    /// Outside the samples: nearest, extend or error [default: nearest]
    #[arg(long, value_name = "POLICY")]
    outside: Option<OutsidePolicy>,
    /// Scale every PSF to unit flux, or keep the values as they are [default: unit]
    #[arg(long, value_name = "unit|keep")]
    normalise: Option<Normalisation>,
}

impl FitArgs {
    pub(crate) fn options(&self) -> FitOptions {
        FitOptions {
            rank: self.rank.unwrap_or_default(),
            centring: self.centring.unwrap_or_default(),
            noise: self.noise.map_or(PixelNoise::Estimate, PixelNoise::Known),
            interpolation: self.interpolation.unwrap_or_default(),
            outside: self.outside.unwrap_or_default(),
            normalisation: self.normalise.unwrap_or_default(),
        }
    }

    /// Opens samples or a model; a model takes none of these options.
    pub(crate) fn open(&self, path: &std::path::Path) -> anyhow::Result<PsfInput> {
        let input = PsfInput::open(path, self.options())?;
        let given = self.rank.is_some()
            || self.centring.is_some()
            || self.noise.is_some()
            || self.interpolation.is_some()
            || self.outside.is_some()
            || self.normalise.is_some();
        if given && matches!(input, PsfInput::Model(_)) {
            let path = path.display();
            return Err(UsageError(format!(
                "{path} is a fitted model: fit options (--rank ... --normalise) apply to samples only; leave them out, or give the samples"
            ))
            .into());
        }
        Ok(input)
    }
}
