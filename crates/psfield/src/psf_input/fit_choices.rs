//! Fit options as far as the user has chosen them.

use psf_basis::{Centring, PixelNoise, RankSelection};
use psf_types::{Interpolation, Normalisation, OutsidePolicy};

use crate::FitOptions;

/// Fit options as far as the user has chosen them: what is none takes the default of the file's format.
///
/// ```
/// use psfield::{FitChoices, FitOptions, psf_types::Normalisation};
/// let choices = FitChoices { normalisation: Some(Normalisation::Keep), ..FitChoices::default() };
/// let options = choices.or(FitOptions::default());
/// assert_eq!(options, FitOptions { normalisation: Normalisation::Keep, ..FitOptions::default() });
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FitChoices {
    /// How many components are kept.
    pub rank: Option<RankSelection>,
    /// With or without a mean stamp.
    pub centring: Option<Centring>,
    /// What is known of the noise in the samples' pixels.
    pub noise: Option<PixelNoise>,
    /// How coefficients are carried over the field.
    pub interpolation: Option<Interpolation>,
    /// What happens outside the samples; also for a model.
    pub outside: Option<OutsidePolicy>,
    /// Whether samples and PSFs are scaled to unit flux; also for a model.
    pub normalisation: Option<Normalisation>,
}

impl FitChoices {
    /// The options, with these for what is not chosen.
    #[must_use]
    pub fn or(self, defaults: FitOptions) -> FitOptions {
        FitOptions {
            rank: self.rank.unwrap_or(defaults.rank),
            centring: self.centring.unwrap_or(defaults.centring),
            noise: self.noise.unwrap_or(defaults.noise),
            interpolation: self.interpolation.unwrap_or(defaults.interpolation),
            outside: self.outside.unwrap_or(defaults.outside),
            normalisation: self.normalisation.unwrap_or(defaults.normalisation),
        }
    }

    /// Whether something is chosen that only a fit can follow, not a model that is ready.
    pub fn needs_fit(&self) -> bool {
        self.rank.is_some() || self.centring.is_some() || self.noise.is_some() || self.interpolation.is_some()
    }
}

/// All of them chosen.
impl From<FitOptions> for FitChoices {
    fn from(options: FitOptions) -> Self {
        Self {
            rank: Some(options.rank),
            centring: Some(options.centring),
            noise: Some(options.noise),
            interpolation: Some(options.interpolation),
            outside: Some(options.outside),
            normalisation: Some(options.normalisation),
        }
    }
}
