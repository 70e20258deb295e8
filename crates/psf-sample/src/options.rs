//! The settings of a sampling that the command line and the Python package offer, with defaults.

use std::sync::Arc;

use crate::criteria::{DifferenceMeasure, InterpolationError, NeighbourDifference, RefinementCriterion};
use crate::{AdaptiveSampling, KrigingSampling, Refinement, SampleError, SamplingMethod, UniformSampling};

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
    /// The way to choose positions. By default kriging, or the mesh if one of its settings is given
    /// (`criterion`, `start`).
    pub refinement: Option<Refinement>,
    /// Only for the mesh: the quantity that is compared with the threshold.
    pub criterion: Option<Criterion>,
    /// The measure of the difference of two PSFs.
    pub measure: DifferenceMeasure,
    /// The largest error allowed: a relative difference of PSFs.
    pub threshold: f64,
    /// Only for the mesh: columns and rows of the starting grid ([`AdaptiveSampling::with_start`]).
    pub start: Option<(usize, usize)>,
    /// The number of PSFs that may be drawn, random tests included.
    pub max_draws: usize,
    /// Only for kriging: the number of random tests at the end ([`KrigingSampling::with_verify`]).
    pub verify: Option<usize>,
    /// The seed of the random tests.
    pub seed: u64,
    /// Columns and rows of a regular grid. If given, the samples are on this grid, without
    /// refinement.
    pub uniform: Option<(usize, usize)>,
}

impl Default for SamplingOptions {
    fn default() -> Self {
        Self {
            refinement: None,
            criterion: None,
            measure: DifferenceMeasure::default(),
            threshold: InterpolationError::DEFAULT_THRESHOLD,
            start: None,
            max_draws: AdaptiveSampling::DEFAULT_MAX_DRAWS,
            verify: None,
            seed: KrigingSampling::DEFAULT_SEED,
            uniform: None,
        }
    }
}

impl SamplingOptions {
    /// The way to choose positions, for these settings.
    pub fn refinement(&self) -> Refinement {
        self.refinement.unwrap_or(match (self.criterion, self.start) {
            (None, None) => Refinement::Kriging,
            _ => Refinement::Mesh,
        })
    }

    /// The sampling method with these settings.
    ///
    /// # Errors
    /// [`SampleError::Setting`] for a value out of range, or a setting of the other method.
    pub fn method(&self) -> Result<Box<dyn SamplingMethod>, SampleError> {
        if let Some((nx, ny)) = self.uniform {
            return Ok(Box::new(UniformSampling::new(nx, ny)?.with_measure(self.measure)));
        }
        match self.refinement() {
            Refinement::Kriging => self.kriging(),
            Refinement::Mesh => self.mesh(),
        }
    }

    fn kriging(&self) -> Result<Box<dyn SamplingMethod>, SampleError> {
        let alone = "left out with the method kriging: it is a setting of the method mesh";
        if let Some(criterion) = self.criterion {
            return Err(SampleError::refused("the criterion", alone, criterion));
        }
        if let Some((nx, ny)) = self.start {
            let got = format_args!("{nx},{ny}");
            return Err(SampleError::refused("the starting grid", alone, got));
        }
        let sampling = KrigingSampling::new(self.threshold, self.measure)?.with_max_draws(self.max_draws)?;
        let verify = self.verify.unwrap_or(KrigingSampling::DEFAULT_VERIFY);
        Ok(Box::new(sampling.with_verify(verify, self.seed)))
    }

    fn mesh(&self) -> Result<Box<dyn SamplingMethod>, SampleError> {
        if let Some(verify) = self.verify {
            let alone = "left out with the method mesh: it is a setting of the method kriging";
            return Err(SampleError::refused("the number of random tests", alone, verify));
        }
        let criterion: Arc<dyn RefinementCriterion> = match self.criterion.unwrap_or_default() {
            Criterion::Interpolation => Arc::new(InterpolationError::new(self.threshold, self.measure)?),
            Criterion::Neighbours => Arc::new(NeighbourDifference::new(self.threshold, self.measure)?),
        };
        let (nx, ny) = self
            .start
            .unwrap_or((AdaptiveSampling::DEFAULT_START, AdaptiveSampling::DEFAULT_START));
        let sampling = AdaptiveSampling::new(criterion).with_start(nx, ny)?;
        Ok(Box::new(sampling.with_max_draws(self.max_draws)))
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
        for text in ["kriging", "mesh"] {
            assert_eq!(text.parse::<Refinement>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn settings_of_the_mesh_select_it() {
        let given = SamplingOptions::default;
        let criterion = Some(Criterion::Interpolation);
        assert_eq!(given().refinement(), Refinement::Kriging);
        assert_eq!(
            SamplingOptions { criterion, ..given() }.refinement(),
            Refinement::Mesh
        );
        let start = Some((3, 3));
        assert_eq!(
            SamplingOptions { start, ..given() }.refinement(),
            Refinement::Mesh
        );
        let refused = |refinement, options: SamplingOptions| {
            let refinement = Some(refinement);
            let options = SamplingOptions {
                refinement,
                ..options
            };
            options.method().unwrap_err().to_string()
        };
        for options in [
            SamplingOptions { criterion, ..given() },
            SamplingOptions { start, ..given() },
        ] {
            let text = refused(Refinement::Kriging, options);
            assert!(text.contains("left out with the method kriging"), "{text}");
        }
        let verify = Some(0);
        let text = refused(Refinement::Mesh, SamplingOptions { verify, ..given() });
        assert!(text.contains("left out with the method mesh"), "{text}");
        let max_draws = 15;
        let text = refused(Refinement::Kriging, SamplingOptions { max_draws, ..given() });
        assert!(text.contains("at least 16, got 15"), "{text}");
    }
}
