//! Singular values and what they say.

use serde::{Deserialize, Serialize};

use crate::elbow::elbow;
use crate::noise::NoiseFloor;

/// The singular values of the training matrix, in descending order, and what was read from them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Spectrum {
    /// All singular values.
    pub singular_values: Vec<f64>,
    /// `c_k = sum_{i<=k} s_i / sum_i s_i` for k = 1 ... (all 1 when every singular value is 0).
    pub cumulative_weights: Vec<f64>,
    /// The number of components at the elbow of the cumulative weights, noise modes not counted; see the crate's page
    /// for the definition.
    pub elbow: usize,
    /// The number of components above rounding, and above the noise where there is any.
    pub significant: usize,
    /// The number of components above rounding: the rank of `full`.
    pub numerical_rank: usize,
    /// The standard deviation of the white noise in the pixels, where any was found or given.
    pub noise_sigma: Option<f64>,
    /// The largest singular value of that noise, `sigma (sqrt L + sqrt P)`.
    pub noise_edge: Option<f64>,
}

impl Spectrum {
    /// `rounding` is the level below which singular values are rounding errors of the decomposition.
    pub(crate) fn new(singular_values: Vec<f64>, rounding: f64, noise: Option<NoiseFloor>) -> Self {
        let total: f64 = singular_values.iter().sum();
        let mut sum = 0.0;
        let cumulative_weights = singular_values
            .iter()
            .map(|s| {
                sum += s;
                if total > 0.0 { sum / total } else { 1.0 }
            })
            .collect();
        let above = |level: f64| singular_values.iter().take_while(|&&s| s > level).count();
        let numerical_rank = above(rounding);
        let significant = noise.map_or(numerical_rank, |n| above(n.threshold.max(rounding)));
        Self {
            elbow: elbow(&singular_values).min(significant),
            significant,
            numerical_rank,
            noise_sigma: noise.map(|n| n.sigma),
            noise_edge: noise.map(|n| n.edge),
            cumulative_weights,
            singular_values,
        }
    }

    /// The smallest number of components that holds the fraction `energy` of `sum s_i^2`.
    pub(crate) fn rank_for_energy(&self, energy: f64) -> usize {
        let total: f64 = self.singular_values.iter().map(|s| s * s).sum();
        let mut sum = 0.0;
        let enough = self
            .singular_values
            .iter()
            .take(self.numerical_rank)
            .take_while(|&&s| {
                let short = sum < energy * total;
                sum += s * s;
                short
            });
        enough.count()
    }
}
