//! The settings of a sampling that the command line and the Python package offer, with defaults.

use std::sync::Arc;

use crate::criteria::{DifferenceMeasure, InterpolationError, NeighbourDifference, RefinementCriterion};
use crate::{AdaptiveSampling, SampleError, SamplingMethod, UniformSampling};

/// The quantity that must not exceed the threshold in any cell. Written as `interpolation` or
/// `neighbours`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Criterion {
    /// The error of interpolation between the samples ([`InterpolationError`]).
    #[default]
    Interpolation,
    /// The difference of neighbouring samples ([`NeighbourDifference`]), as in the paper that
    /// describes psfield's method (Bai, Jia et al. 2025).
    Neighbours,
}

psf_types::named!(
    Criterion,
    SampleError,
    |text| SampleError::refused("the criterion", "interpolation or neighbours", text),
    "interpolation" => Interpolation,
    "neighbours" => Neighbours
);
psf_types::named!(
    DifferenceMeasure,
    SampleError,
    |text| SampleError::refused("the measure", "l1 or l2", text),
    "l1" => L1,
    "l2" => L2
);

/// The settings of a sampling that the command line and the Python package offer. Both take their
/// defaults from here. [`AdaptiveSampling`] has further settings.
///
/// ```
/// use psf_sample::SamplingOptions;
/// let options = SamplingOptions { threshold: 0.02, ..SamplingOptions::default() };
/// assert!(options.method().is_ok());
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SamplingOptions {
    /// The quantity that is compared with the threshold.
    pub criterion: Criterion,
    /// The measure of the difference of two PSFs.
    pub measure: DifferenceMeasure,
    /// The threshold of the criterion, a relative difference of PSFs.
    pub threshold: f64,
    /// Columns and rows of the starting grid ([`AdaptiveSampling::with_start`]).
    pub start: (usize, usize),
    /// The cap on the number of samples ([`AdaptiveSampling::with_max_samples`]).
    pub max_samples: usize,
    /// Columns and rows of a regular grid. If given, the samples are on this grid, without
    /// refinement.
    pub uniform: Option<(usize, usize)>,
}

impl Default for SamplingOptions {
    fn default() -> Self {
        Self {
            criterion: Criterion::default(),
            measure: DifferenceMeasure::default(),
            threshold: InterpolationError::DEFAULT_THRESHOLD,
            start: (AdaptiveSampling::DEFAULT_START, AdaptiveSampling::DEFAULT_START),
            max_samples: AdaptiveSampling::DEFAULT_MAX_SAMPLES,
            uniform: None,
        }
    }
}

impl SamplingOptions {
    /// The sampling method with these settings.
    ///
    /// # Errors
    /// [`SampleError::Setting`] for a value out of range.
    pub fn method(&self) -> Result<Box<dyn SamplingMethod>, SampleError> {
        if let Some((nx, ny)) = self.uniform {
            return Ok(Box::new(UniformSampling::new(nx, ny)?.with_measure(self.measure)));
        }
        let criterion: Arc<dyn RefinementCriterion> = match self.criterion {
            Criterion::Interpolation => Arc::new(InterpolationError::new(self.threshold, self.measure)?),
            Criterion::Neighbours => Arc::new(NeighbourDifference::new(self.threshold, self.measure)?),
        };
        let (nx, ny) = self.start;
        let sampling = AdaptiveSampling::new(criterion).with_start(nx, ny)?;
        Ok(Box::new(sampling.with_max_samples(self.max_samples)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_forms_round_trip() {
        for text in ["interpolation", "neighbours"] {
            assert_eq!(text.parse::<Criterion>().unwrap().to_string(), text);
        }
        for text in ["l1", "l2"] {
            assert_eq!(text.parse::<DifferenceMeasure>().unwrap().to_string(), text);
        }
        assert!("L3".parse::<DifferenceMeasure>().is_err());
    }
}
