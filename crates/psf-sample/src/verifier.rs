//! Random tests when a sampling is done.

use psf_types::{FrameShape, Position};

use crate::draws::test_positions;
use crate::sampling::SampleError;
use crate::verification::Verification;

/// Chooses the positions of random tests, and records their errors.
#[derive(Debug)]
pub(crate) struct Verifier {
    field: FrameShape,
    /// The number of tests each time.
    count: usize,
    seed: u64,
    rounds: u64,
    draws: usize,
    pub(crate) last: Option<Verification>,
}

impl Verifier {
    pub(crate) fn new(field: FrameShape, count: usize, seed: u64) -> Self {
        Self {
            field,
            count,
            seed,
            rounds: 0,
            draws: 0,
            last: None,
        }
    }

    /// The positions of the next tests. Each time, they are others.
    pub(crate) fn positions(&self) -> Result<Vec<Position>, SampleError> {
        test_positions(self.field, (self.count, self.seed), self.rounds)
    }

    /// Records the errors of the tests. Returns whether all are at most the threshold.
    pub(crate) fn record(&mut self, tests: impl Iterator<Item = (Position, f64)>, threshold: f64) -> bool {
        let tests: Vec<_> = tests.collect();
        let Some(&(worst_at, worst)) = tests.iter().max_by(|a, b| a.1.total_cmp(&b.1)) else {
            return true;
        };
        self.rounds += 1;
        self.draws += tests.len();
        let above = tests.iter().filter(|(_, error)| *error > threshold).count();
        self.last = Some(Verification {
            tests: tests.len(),
            above,
            worst,
            worst_at,
            draws: self.draws,
        });
        above == 0
    }
}
