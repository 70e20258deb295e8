//! How samples become a model.

use psf_basis::{Centring, PixelNoise, RankSelection};
use psf_types::{Interpolation, Normalisation, OutsidePolicy, SamplePositions};

/// How samples become a model. The default is what the command line does: rank `auto`, mean-centred, interpolation
/// `auto`, nearest outside, unit flux.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FitOptions {
    /// How many components are kept.
    pub rank: RankSelection,
    /// With or without a mean stamp.
    pub centring: Centring,
    /// What is known of the noise in the samples' pixels, in units of the samples after normalisation.
    pub noise: PixelNoise,
    /// How coefficients are carried over the field.
    pub interpolation: Interpolation,
    /// What happens outside the samples.
    pub outside: OutsidePolicy,
    /// Whether samples and PSFs are scaled to unit flux.
    pub normalisation: Normalisation,
}

impl FitOptions {
    /// For a library of PSFs on a grid of positions (STPSF, STDPSF, photutils' `GriddedPSFModel`): every component is kept, and PSFs are
    /// as the library scales them, bilinear between its positions, as its other readers have them.
    pub fn of_gridded_library(positions: &SamplePositions) -> Self {
        Self {
            // Its few planes are to come back as they are.
            rank: RankSelection::Full,
            // The scale is part of its calibration.
            normalisation: Normalisation::Keep,
            interpolation: match coeff_field::resolve(Interpolation::Auto, positions) {
                Interpolation::Bicubic => Interpolation::Bilinear,
                other => other,
            },
            ..Self::default()
        }
    }

    /// For one stamp, the PSF of the whole field: it has no others to interpolate between.
    pub fn of_single_stamp() -> Self {
        Self {
            interpolation: Interpolation::Nearest,
            ..Self::default()
        }
    }
}
