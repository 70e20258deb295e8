//! The mesh that takes over where the PSF is not smooth.

use psf_types::{Position, Progress, PsfSource};

use crate::adaptive_run::AdaptiveRun;
use crate::criteria::{DifferenceMeasure, InterpolationError, RefinementCriterion};
use crate::draws::DrawnStamps;
use crate::mesh::Mesh;
use crate::sampling::{SampleError, Sampling, SamplingOutcome};
use crate::verifier::Verifier;

/// A sampling that began without a mesh.
pub(crate) struct Takeover<'a> {
    pub(crate) source: &'a dyn PsfSource,
    pub(crate) progress: &'a dyn Progress,
    pub(crate) criterion: InterpolationError,
    pub(crate) measure: DifferenceMeasure,
    pub(crate) max_draws: usize,
    pub(crate) mesh: Mesh,
    /// All PSFs drawn so far, and their positions.
    pub(crate) stamps: DrawnStamps,
    pub(crate) drawn: Vec<Position>,
    pub(crate) verifier: Verifier,
}

impl Takeover<'_> {
    /// Refines the mesh until the criterion, all PSFs drawn before and random tests agree. All PSFs drawn
    /// become samples.
    pub(crate) fn run(mut self) -> Result<Sampling, SampleError> {
        let threshold = self.criterion.threshold();
        let mut run = AdaptiveRun::new(&self.criterion, self.source, self.mesh, self.stamps);
        run.add_tests(&self.drawn, self.measure);
        let wanted = loop {
            if let Some(wanted) = run.refine(self.max_draws, self.progress)? {
                break Some(wanted);
            }
            let tests = self.verifier.positions()?;
            let wanted = run.stamps().count() + tests.len();
            if wanted > self.max_draws {
                run.end(SamplingOutcome::CapReached);
                break Some(wanted);
            }
            run.stamps().add(self.source, &tests, self.progress)?;
            let errors: Vec<f64> = tests.iter().map(|&at| run.error_at(at, self.measure)).collect();
            let passed = self.verifier.record(tests.iter().copied().zip(errors), threshold);
            if passed || !run.is_met() {
                break None;
            }
            run.add_tests(&tests, self.measure);
        };
        let is_met = wanted.is_none() && run.is_met();
        let mut sampling = run.all_samples()?;
        sampling.report.verification = self.verifier.last;
        if is_met {
            Ok(sampling)
        } else {
            Err(SampleError::not_met(self.max_draws, wanted, sampling))
        }
    }
}
