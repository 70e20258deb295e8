//! Sampling where kriging expects the largest error.

use psf_types::{Position, Progress, PsfSource};

use crate::adaptive::AdaptiveSampling;
use crate::adaptive_run::AdaptiveRun;
use crate::criteria::{DifferenceMeasure, InterpolationError, check_threshold};
use crate::draws::DrawnStamps;
use crate::learner::Learner;
use crate::mesh::Mesh;
use crate::sampling::{Refinement, SampleError, Sampling, SamplingMethod, SamplingOutcome, SamplingReport};
use crate::spread::Spread;
use crate::verifier::Verifier;

/// The number of PSFs drawn before the first prediction.
const START: usize = 16;
/// The number of PSFs drawn at a time.
const ROUND: usize = 4;
/// Sampling ends when this many rounds in a row pass.
const PASSING_ROUNDS: usize = 2;
/// The expected error is multiplied by the largest ratio of measured and expected error in this many tests.
const CALIBRATING: usize = 32;
/// Errors may be this many times as large as expected, in smooth fields and in others.
const SAFETY: f64 = 2.0;
const SAFETY_IF_ROUGH: f64 = 4.0;
/// Expected errors below this part of the threshold count as this large in that ratio.
const NEGLIGIBLE: f64 = 0.01;
/// Every circle of this radius holds a PSF. (The unit is the field's extent.) It covers 4 % of the field.
const LARGEST_GAP: f64 = 0.113;
/// From this number of draws on, the expected error must have been halved by the last [`HALVED_IN`] draws, or
/// by the last third of all draws if these are more. Else the field is not smooth.
const PATIENCE: usize = 128;
const HALVED_IN: usize = 64;
/// The equations of kriging for more PSFs cost much time.
const MOST_DRAWS: usize = 600;
/// Candidates lie on a lattice with at least this many intervals along each axis.
const INTERVALS: u64 = 32;
/// The lattice has at least this many candidates for each PSF drawn.
const CANDIDATES: usize = 4;

/// Samples where kriging expects the largest error, and tests each prediction before it learns from it.
///
/// 1. 16 PSFs are drawn, spread over the field, its corners among them.
/// 2. Kriging ([`coeff_field::Kriging`]) is fitted to all PSFs so far, to every pixel with common
///    parameters. Its expected error is known before a PSF is drawn. The next PSFs are four at a time, at
///    the places where it is largest, each given those before it. This is a sequential design (J. Sacks,
///    W. Welch, T. Mitchell and H. Wynn 1989, Statistical Science 4, 409).
/// 3. Each new PSF is first a test: it is compared with its prediction from the PSFs so far.
/// 4. Sampling ends if two rounds of four in a row have errors of at most the threshold, and the largest
///    expected error is at most half of it (a quarter if the PSFs suit another kernel than the Gaussian
///    better, because the field is not smooth). This error is calibrated: it is multiplied by the largest
///    ratio of measured and expected error in the last 32 tests, which is large if the field is not
///    smooth. Besides, no circle of 4 % of the field may be without a PSF: the farthest places are drawn,
///    as further tests.
/// 5. Random PSFs verify the result ([`with_verify`](Self::with_verify)). If one of them fails, sampling
///    goes on, and others verify it later.
///
/// A smooth field needs 50 to 150 PSFs. Kriging needs many in fields with steps, kinks or small
/// spots. If it makes little progress after 128 PSFs, or needs more than 600, the mesh of
/// [`AdaptiveSampling`] with its default settings takes over. It also refines cells that contain a PSF
/// drawn before which it would predict worse than the threshold.
///
/// Every PSF drawn becomes a sample.
///
/// ```
/// use ndarray::ArrayViewMut2;
/// use psf_sample::{DifferenceMeasure, KrigingSampling, SamplingMethod};
/// use psf_types::{FrameShape, NoProgress, Position, PsfSource, SourceError, StampGrid};
///
/// /// A PSF whose flux partly moves to the next stamp pixel.
/// struct Drift;
/// impl PsfSource for Drift {
///     fn grid(&self) -> StampGrid { StampGrid::new(3, 1).unwrap() }
///     fn field(&self) -> FrameShape { FrameShape::new(1000, 1000).unwrap() }
///     fn draw_into(
///         &self,
///         at: Position,
///         mut stamp: ArrayViewMut2<'_, f64>,
///     ) -> Result<(), SourceError> {
///         let part = 0.3 * (1.0 + (at.x() / 300.0).sin() * (at.y() / 400.0).cos());
///         stamp.assign(&ndarray::array![[0.0, 1.0 - part, part]]);
///         Ok(())
///     }
/// }
/// let method = KrigingSampling::new(1e-3, DifferenceMeasure::L2)?;
/// let sampling = method.sample(&Drift, &NoProgress)?;
/// assert!(sampling.samples.len() < 120);
/// assert_eq!(sampling.report.verification.unwrap().above, 0);
/// # Ok::<(), psf_sample::SampleError>(())
/// ```
#[derive(Debug, Clone)]
pub struct KrigingSampling {
    threshold: f64,
    measure: DifferenceMeasure,
    max_draws: usize,
    verify: usize,
    seed: u64,
}

impl KrigingSampling {
    /// Default number of random tests at the end.
    pub const DEFAULT_VERIFY: usize = 16;
    /// Default seed of the random tests.
    pub const DEFAULT_SEED: u64 = 1;

    /// Sampling until predictions of PSFs have errors of at most `threshold`.
    ///
    /// # Errors
    /// [`SampleError::Setting`] unless the threshold is finite and above 0.
    pub fn new(threshold: f64, measure: DifferenceMeasure) -> Result<Self, SampleError> {
        check_threshold(threshold)?;
        Ok(Self {
            threshold,
            measure,
            max_draws: AdaptiveSampling::DEFAULT_MAX_DRAWS,
            verify: Self::DEFAULT_VERIFY,
            seed: Self::DEFAULT_SEED,
        })
    }

    /// Sets the number of PSFs that may be drawn, random tests included. If more are needed, sampling ends
    /// with [`SampleError::NotMet`].
    ///
    /// # Errors
    /// [`SampleError::Setting`] for less than 16.
    pub fn with_max_draws(self, max_draws: usize) -> Result<Self, SampleError> {
        let (name, allowed) = ("the largest number of draws", "at least 16");
        SampleError::check(max_draws >= START, name, allowed, max_draws)?;
        Ok(Self { max_draws, ..self })
    }

    /// Sets the number of random tests at the end, and the seed of their positions. 0 tests switch the
    /// verification off.
    ///
    /// If no test of `n` fails, errors exceed the threshold in at most the fraction `1 - 0.05^(1/n)` of the
    /// field, with 95 % confidence ([`fraction_limit`](crate::fraction_limit)): 17 % for 16 tests, 1 % for
    /// 300.
    #[must_use]
    pub fn with_verify(self, tests: usize, seed: u64) -> Self {
        Self {
            verify: tests,
            seed,
            ..self
        }
    }
}

impl SamplingMethod for KrigingSampling {
    /// # Errors
    /// [`SampleError::NotMet`] with all samples if the threshold is not met: more draws are needed than
    /// allowed, or cells of the mesh have reached their smallest size.
    fn sample(&self, source: &dyn PsfSource, progress: &dyn Progress) -> Result<Sampling, SampleError> {
        let start = [AdaptiveSampling::DEFAULT_START; 2];
        let (cell, aspect) = (
            AdaptiveSampling::DEFAULT_MIN_CELL_PX,
            AdaptiveSampling::DEFAULT_MAX_ASPECT,
        );
        let mut run = Run {
            options: self,
            source,
            progress,
            mesh: Mesh::new(source.field(), start, cell, aspect),
            stamps: DrawnStamps::default(),
            drawn: Vec::new(),
            learner: Learner::default(),
            tests: Vec::new(),
            bounds: Vec::new(),
            verifier: Verifier::new(source.field(), self.verify, self.seed),
        };
        match run.learn()? {
            End::Met => run.finish(SamplingOutcome::Met),
            End::Capped(wanted) => run.capped(wanted),
            End::NotSmooth => run.refine_mesh(),
        }
    }
}

/// The end of kriging's rounds.
enum End {
    Met,
    /// More draws are needed than allowed.
    Capped(usize),
    NotSmooth,
}

/// A PSF that was predicted before it was drawn.
#[derive(Debug, Clone, Copy)]
struct Test {
    position: Position,
    error: f64,
    /// The measured error in units of the expected one.
    ratio: f64,
}

/// The state of a sampling.
struct Run<'a> {
    options: &'a KrigingSampling,
    source: &'a dyn PsfSource,
    progress: &'a dyn Progress,
    mesh: Mesh,
    stamps: DrawnStamps,
    /// The positions of all PSFs drawn, in their order.
    drawn: Vec<Position>,
    learner: Learner,
    /// Random tests are recorded by the verifier.
    tests: Vec<Test>,
    /// For each round, the number of PSFs before it, and the largest expected error.
    bounds: Vec<(usize, f64)>,
    verifier: Verifier,
}

impl Run<'_> {
    /// Draws PSFs in rounds until the tests pass.
    fn learn(&mut self) -> Result<End, SampleError> {
        let mut intervals = INTERVALS;
        let mut field = self.lattice(intervals);
        let start = field.take(START);
        self.stamps.add(self.source, &start, self.progress)?;
        self.learn_from(&start);
        let mut passing = 0;
        loop {
            if field.candidates().len() < CANDIDATES * self.drawn.len() {
                intervals = intervals.saturating_mul(2);
                field = self.lattice(intervals);
            }
            field.choose(&self.drawn);
            let Some(next) = self.least_known(&field.candidates()) else {
                return Ok(End::NotSmooth);
            };
            // On a small field, all candidates may have been drawn.
            let is_exhausted = next.is_empty();
            let safety = if self.learner.is_smooth() {
                SAFETY
            } else {
                SAFETY_IF_ROUGH
            };
            let is_passing = passing >= PASSING_ROUNDS && safety * self.expected() <= self.options.threshold;
            let is_known = is_passing || is_exhausted;
            if !is_known && self.is_not_smooth() {
                return Ok(End::NotSmooth);
            }
            let is_done = is_known && field.gap() <= LARGEST_GAP;
            let tests = match (is_known, is_done) {
                (_, true) => self.verifier.positions()?,
                (true, _) => field.take(ROUND),
                _ => next,
            };
            let wanted = self.stamps.count() + tests.len();
            if wanted > self.options.max_draws {
                return Ok(End::Capped(wanted));
            }
            let found = self.test(&tests)?;
            let mut passed = found.iter().all(|test| test.error <= self.options.threshold);
            if is_done {
                let errors = found.iter().map(|test| (test.position, test.error));
                passed = self.verifier.record(errors, self.options.threshold);
                if passed {
                    return Ok(End::Met);
                }
                if is_exhausted {
                    return Ok(End::NotSmooth);
                }
            }
            self.tests.extend(found);
            passing = if passed { passing + 1 } else { 0 };
        }
    }

    /// The candidates for draws.
    fn lattice(&self, intervals: u64) -> Spread {
        let nodes = self.mesh.lattice(intervals).into_iter();
        let candidates = nodes.map(|node| self.mesh.position(node)).collect();
        Spread::new(self.source.field(), candidates)
    }

    /// Fits kriging, and returns the candidates that it knows least. `None` if it cannot be fitted.
    fn least_known(&mut self, candidates: &[Position]) -> Option<Vec<Position>> {
        self.learner.fit().ok()?;
        let next = self.learner.least_known(candidates, ROUND).ok()?;
        let expected = next.first().map_or(0.0, |(_, expected)| *expected);
        let recent = &self.tests[self.tests.len().saturating_sub(CALIBRATING)..];
        let ratio = recent.iter().map(|test| test.ratio).fold(1.0, f64::max);
        self.bounds.push((self.drawn.len(), expected * ratio));
        Some(next.into_iter().map(|(position, _)| position).collect())
    }

    /// The largest expected error.
    fn expected(&self) -> f64 {
        self.bounds
            .last()
            .map_or(f64::INFINITY, |(_, expected)| *expected)
    }

    fn is_not_smooth(&self) -> bool {
        let drawn = self.drawn.len();
        let mut before = self.bounds.iter().rev();
        let before = before.find(|(of, _)| of + HALVED_IN.max(drawn / 3) <= drawn);
        let is_slow = before.is_some_and(|(_, before)| self.expected() > 0.5 * before);
        (drawn >= PATIENCE && is_slow) || drawn >= MOST_DRAWS
    }

    /// Draws PSFs, compares them with their predictions, and then learns from them.
    fn test(&mut self, positions: &[Position]) -> Result<Vec<Test>, SampleError> {
        self.stamps.add(self.source, positions, self.progress)?;
        let test = |&position: &Position| {
            let predicted = self.learner.predicted(position);
            let error = self
                .options
                .measure
                .between(predicted.view(), self.stamps.get(position));
            let expected = self
                .learner
                .expected(position)
                .max(NEGLIGIBLE * self.options.threshold);
            let ratio = error / expected;
            Test {
                position,
                error,
                ratio,
            }
        };
        let found = positions.iter().map(test).collect();
        self.learn_from(positions);
        Ok(found)
    }

    fn learn_from(&mut self, drawn: &[Position]) {
        for &position in drawn {
            self.learner.add(position, self.stamps.get(position));
        }
        self.drawn.extend(drawn);
    }

    fn report(&self, outcome: SamplingOutcome) -> SamplingReport {
        let last = &self.tests[self.tests.len().saturating_sub(PASSING_ROUNDS * ROUND)..];
        let worst = last.iter().max_by(|a, b| a.error.total_cmp(&b.error));
        SamplingReport {
            refinement: Some(Refinement::Kriging),
            outcome,
            worst: worst.map_or(0.0, |test| test.error),
            worst_at: worst.map(|test| test.position),
            expected: Some(self.expected()),
            verification: self.verifier.last,
            threshold: Some(self.options.threshold),
            ..SamplingReport::of_fixed_positions(self.stamps.count())
        }
    }

    fn finish(self, outcome: SamplingOutcome) -> Result<Sampling, SampleError> {
        let report = self.report(outcome);
        let samples = self.stamps.into_all_samples(self.source)?;
        Ok(Sampling { samples, report })
    }

    fn capped(self, wanted: usize) -> Result<Sampling, SampleError> {
        let most = self.options.max_draws;
        let sampling = self.finish(SamplingOutcome::CapReached)?;
        Err(SampleError::not_met(most, Some(wanted), sampling))
    }

    /// The mesh takes over, where the PSF is not smooth. It is refined until its criterion, all PSFs drawn
    /// before and random tests agree. All PSFs drawn become samples.
    fn refine_mesh(mut self) -> Result<Sampling, SampleError> {
        let KrigingSampling {
            threshold,
            measure,
            max_draws,
            ..
        } = *self.options;
        let criterion = InterpolationError::new(threshold, measure)?;
        let mut run = AdaptiveRun::new(&criterion, self.source, self.mesh, self.stamps);
        run.add_tests(&self.drawn, measure);
        let wanted = loop {
            if let Some(wanted) = run.refine(max_draws, self.progress)? {
                break Some(wanted);
            }
            let tests = self.verifier.positions()?;
            let wanted = run.stamps.count() + tests.len();
            if wanted > max_draws {
                run.outcome = SamplingOutcome::CapReached;
                break Some(wanted);
            }
            run.stamps.add(self.source, &tests, self.progress)?;
            let errors: Vec<f64> = tests.iter().map(|&at| run.error_at(at, measure)).collect();
            let passed = self.verifier.record(tests.iter().copied().zip(errors), threshold);
            if passed || run.outcome != SamplingOutcome::Met {
                break None;
            }
            run.add_tests(&tests, measure);
        };
        let is_met = wanted.is_none() && run.outcome == SamplingOutcome::Met;
        let mut sampling = run.all_samples()?;
        sampling.report.verification = self.verifier.last;
        if is_met {
            Ok(sampling)
        } else {
            Err(SampleError::not_met(max_draws, wanted, sampling))
        }
    }
}
