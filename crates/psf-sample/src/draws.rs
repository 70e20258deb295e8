//! Drawing of many PSFs: at any positions, on a regular grid, and at sub-pixel shifts.

use std::collections::{HashMap, HashSet};

use ndarray::{Array2, Array3, ArrayView2, Axis};
use psf_types::{FrameShape, Position, Progress, PsfSamples, PsfSource, SamplePositions, Stamp, StateKind};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;

use crate::criteria::DifferenceMeasure;
use crate::sampling::{SampleError, Sampling, SamplingMethod, SamplingReport};

/// Draws a PSF and checks that its values are finite and its flux is positive.
fn draw(source: &dyn PsfSource, position: Position, shift: (f64, f64)) -> Result<Array2<f64>, SampleError> {
    let grid = source.grid();
    let mut values = Array2::zeros(grid.dim());
    let drawn = if shift == (0.0, 0.0) {
        source.draw_into(position, values.view_mut())
    } else {
        source.draw_shifted_into(position, shift, values.view_mut())
    };
    drawn.map_err(|source| SampleError::Draw { position, source })?;
    let stamp = Stamp::new(values, grid).map_err(|source| SampleError::Stamp { position, source })?;
    let flux = stamp.flux();
    if flux > 0.0 {
        Ok(stamp.into_values())
    } else {
        Err(SampleError::NoLight { position, flux })
    }
}

/// Draws the PSFs at `positions` in parallel. If several fail, returns the error of the first
/// position that failed, whatever the number of threads.
fn draw_all(
    source: &dyn PsfSource,
    positions: &[Position],
    progress: &dyn Progress,
) -> Result<Vec<Array2<f64>>, SampleError> {
    let drawn: Vec<_> = positions
        .par_iter()
        .map(|&position| {
            progress.check_cancelled()?;
            let stamp = draw(source, position, (0.0, 0.0));
            progress.advance(1);
            stamp
        })
        .collect();
    drawn.into_iter().collect()
}

/// Draws the PSFs of several sources at the same positions: one source for each state, such as a
/// wavelength. The samples of the first state come first.
///
/// # Errors
/// [`SampleError::Draw`] when a source cannot draw. [`SampleError::Stamp`] or
/// [`SampleError::NoLight`] when a drawn stamp is not a valid PSF. [`SampleError::Cancelled`] if
/// `progress` cancels the work. [`SampleError::Data`] for states that are not valid.
///
/// # Panics
/// When there are no sources, or not one for each state.
pub fn draw_states(
    sources: &[&dyn PsfSource],
    (kind, values): (StateKind, &[f64]),
    positions: &[Position],
    progress: &dyn Progress,
) -> Result<PsfSamples, SampleError> {
    assert_eq!(sources.len(), values.len(), "one source for each state");
    let (first, count) = (sources[0], positions.len());
    progress.start((sources.len() * count) as u64);
    let (ny, nx) = first.grid().dim();
    let mut stamps = Array3::zeros((sources.len() * count, ny, nx));
    for (source, mut block) in sources.iter().zip(stamps.axis_chunks_iter_mut(Axis(0), count)) {
        for (mut to, stamp) in block
            .outer_iter_mut()
            .zip(draw_all(*source, positions, progress)?)
        {
            to.assign(&stamp);
        }
    }
    let positions = SamplePositions::in_every_state(positions, Some(first.field()), kind, values)?;
    Ok(PsfSamples::new(stamps, positions, first.grid())?)
}

/// All PSFs drawn so far, each position once.
#[derive(Debug, Default)]
pub(crate) struct DrawnStamps {
    stamps: HashMap<[u64; 2], (Position, Array2<f64>)>,
    announced: u64,
}

impl DrawnStamps {
    /// The PSF at a position where one was drawn.
    pub(crate) fn get(&self, position: Position) -> ArrayView2<'_, f64> {
        self.stamps[&position.bits()].1.view()
    }

    pub(crate) fn contains(&self, position: Position) -> bool {
        self.stamps.contains_key(&position.bits())
    }

    /// The number of PSFs drawn.
    pub(crate) fn count(&self) -> usize {
        self.stamps.len()
    }

    /// Draws the PSFs at those positions where none has been drawn yet.
    pub(crate) fn add(
        &mut self,
        source: &dyn PsfSource,
        positions: &[Position],
        progress: &dyn Progress,
    ) -> Result<(), SampleError> {
        let mut new = HashSet::new();
        let missing: Vec<Position> = positions
            .iter()
            .copied()
            .filter(|p| !self.contains(*p) && new.insert(p.bits()))
            .collect();
        if missing.is_empty() {
            return Ok(());
        }
        self.announced += missing.len() as u64;
        progress.start(self.announced);
        let drawn = draw_all(source, &missing, progress)?;
        let keyed = missing.into_iter().zip(drawn);
        self.stamps
            .extend(keyed.map(|(position, stamp)| (position.bits(), (position, stamp))));
        Ok(())
    }

    /// The samples at some of the positions, ordered by y, then x.
    pub(crate) fn into_samples(
        mut self,
        source: &dyn PsfSource,
        mut positions: Vec<Position>,
    ) -> Result<PsfSamples, SampleError> {
        positions.sort_by(|a, b| a.y().total_cmp(&b.y()).then(a.x().total_cmp(&b.x())));
        let mut take = |p: &Position| self.stamps.remove(&p.bits()).expect("every sample was drawn").1;
        let taken = positions.iter().map(&mut take).collect();
        drop(self);
        into_samples(source, positions, taken)
    }

    /// All PSFs as samples, ordered by y, then x.
    pub(crate) fn into_all_samples(self, source: &dyn PsfSource) -> Result<PsfSamples, SampleError> {
        let positions = self.stamps.values().map(|(position, _)| *position).collect();
        self.into_samples(source, positions)
    }
}

/// Builds samples from stamps and positions of a source.
fn into_samples(
    source: &dyn PsfSource,
    positions: Vec<Position>,
    stamps: Vec<Array2<f64>>,
) -> Result<PsfSamples, SampleError> {
    let (ny, nx) = source.grid().dim();
    let mut stack = Array3::zeros((stamps.len(), ny, nx));
    // Each stamp is freed after it is copied, which limits the memory used in addition to the
    // stack.
    for (mut plane, stamp) in stack.axis_iter_mut(Axis(0)).zip(stamps) {
        plane.assign(&stamp);
    }
    let positions = SamplePositions::new(positions, Some(source.field()))?;
    Ok(PsfSamples::new(stack, positions, source.grid())?)
}

/// Samples on a regular grid. Its corners are the centres of the field's corner pixels: along an
/// axis of `n` pixels, the positions extend from 0 to `n - 1`.
///
/// ```
/// use psf_sample::UniformSampling;
/// use psf_types::FrameShape;
/// let positions = UniformSampling::new(3, 2)?.positions(FrameShape::new(101, 51)?)?;
/// assert_eq!((positions[4].x(), positions[4].y()), (50.0, 50.0));
/// # Ok::<(), psf_sample::SampleError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UniformSampling {
    nx: usize,
    ny: usize,
    measure: DifferenceMeasure,
}

impl UniformSampling {
    /// A grid of `nx` by `ny` samples.
    ///
    /// # Errors
    /// [`SampleError::Setting`] when `nx` or `ny` is 0.
    pub fn new(nx: usize, ny: usize) -> Result<Self, SampleError> {
        for n in [nx, ny] {
            SampleError::check(n > 0, "the number of samples along an axis", "at least 1", n)?;
        }
        Ok(Self {
            nx,
            ny,
            measure: DifferenceMeasure::default(),
        })
    }

    /// Sets the measure in which the report states the largest difference of neighbours.
    #[must_use]
    pub fn with_measure(self, measure: DifferenceMeasure) -> Self {
        Self { measure, ..self }
    }

    /// The positions of the samples on a field, ordered by y, then x.
    ///
    /// # Errors
    /// [`SampleError::Setting`] when an axis of several pixels has only one sample, or when an axis
    /// of one pixel has several samples.
    pub fn positions(&self, field: FrameShape) -> Result<Vec<Position>, SampleError> {
        let axis = |name, samples: usize, pixels: usize| {
            let allowed = "1 for an axis of one pixel, and at least 2 otherwise";
            let got = format_args!("{samples} for {pixels} pixels");
            SampleError::check((samples == 1) == (pixels == 1), name, allowed, got)?;
            let last = (samples - 1).max(1) as f64;
            // Multiplying before dividing makes the last value exactly `pixels - 1`.
            Ok::<_, SampleError>((0..samples).map(move |i| (pixels - 1) as f64 * i as f64 / last))
        };
        let xs = axis("the number of samples along x", self.nx, field.nx())?;
        let ys = axis("the number of samples along y", self.ny, field.ny())?;
        let grid = ys.flat_map(|y| xs.clone().map(move |x| Position::new(x, y)));
        Ok(grid.collect::<Result<_, _>>()?)
    }

    fn worst_neighbours(&self, stamps: &[Array2<f64>]) -> f64 {
        let at = |x: usize, y: usize| stamps[y * self.nx + x].view();
        let mut worst = 0f64;
        for y in 0..self.ny {
            for x in 0..self.nx {
                if x + 1 < self.nx {
                    worst = worst.max(self.measure.between(at(x, y), at(x + 1, y)));
                }
                if y + 1 < self.ny {
                    worst = worst.max(self.measure.between(at(x, y), at(x, y + 1)));
                }
            }
        }
        worst
    }
}

impl SamplingMethod for UniformSampling {
    /// The report's worst value is the largest difference of neighbours along x or y.
    fn sample(&self, source: &dyn PsfSource, progress: &dyn Progress) -> Result<Sampling, SampleError> {
        let positions = self.positions(source.field())?;
        progress.start(positions.len() as u64);
        let stamps = draw_all(source, &positions, progress)?;
        let report = SamplingReport {
            cells: (self.nx - 1).max(1) * (self.ny - 1).max(1),
            worst: self.worst_neighbours(&stamps),
            ..SamplingReport::of_fixed_positions(stamps.len())
        };
        let samples = into_samples(source, positions, stamps)?;
        Ok(Sampling { samples, report })
    }
}

/// A random number in [0, 1).
fn unit(rng: &mut ChaCha8Rng) -> f64 {
    // 53 random bits: every multiple of 2^-53 in [0, 1) is equally likely.
    (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// The positions of random tests. Each `round` has others. They are stratified: the field is divided into
/// as many parts of equal area, almost square, and each part holds one, at random. So they are seldom
/// close to each other.
pub(crate) fn test_positions(
    field: FrameShape,
    (count, seed): (usize, u64),
    round: u64,
) -> Result<Vec<Position>, SampleError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // Held-out PSFs use stream 0.
    rng.set_stream(round + 1);
    let (width, height) = ((field.nx() - 1) as f64, (field.ny() - 1) as f64);
    let rows = (count as f64).sqrt().floor().max(1.0) as usize;
    let mut positions = Vec::with_capacity(count);
    for row in 0..rows {
        let columns = count / rows + usize::from(row < count % rows);
        let (low, part) = (
            positions.len() as f64 / count as f64,
            columns as f64 / count as f64,
        );
        for column in 0..columns {
            let x = (column as f64 + unit(&mut rng)) / columns as f64;
            let y = low + part * unit(&mut rng);
            positions.push(Position::new(width * x, height * y)?);
        }
    }
    Ok(positions)
}

/// Smallest distance of a held-out PSF from the samples, as a fraction of their mean distance.
/// About 3 % of the field, or less, is closer to a sample.
const HOLD_OUT_DISTANCE: f64 = 0.1;
/// Number of tries per held-out PSF, after which the field counts as too small.
const HOLD_OUT_TRIES: usize = 100;

/// Draws `count` PSFs that are not samples, to check how well a model predicts the PSF between the
/// samples.
///
/// The positions are random and uniform over the field, but keep a distance from every sample: a
/// tenth of the samples' mean distance, which is the square root of the field's area per sample.
///
/// ```
/// use psf_sample::{SamplingMethod, UniformSampling, hold_out};
/// use psf_types::{NoProgress, PsfSamples, PsfSource};
///
/// fn samples_and_truth(psf: &dyn PsfSource) -> Result<[PsfSamples; 2], psf_sample::SampleError> {
///     let samples = UniformSampling::new(9, 9)?.sample(psf, &NoProgress)?.samples;
///     let truth = hold_out(psf, samples.positions(), (100, 1), &NoProgress)?;
///     Ok([samples, truth])
/// }
/// ```
///
/// # Errors
/// [`SampleError::Setting`] if `count` is 0 or the field has no room between the samples.
/// [`SampleError::Draw`] when the source cannot draw. [`SampleError::Stamp`] or
/// [`SampleError::NoLight`] when a drawn stamp is not a valid PSF. [`SampleError::Cancelled`] if
/// `progress` cancels the work.
pub fn hold_out(
    source: &dyn PsfSource,
    samples: &SamplePositions,
    (count, seed): (usize, u64),
    progress: &dyn Progress,
) -> Result<PsfSamples, SampleError> {
    let (nx, ny) = (source.field().nx() as f64, source.field().ny() as f64);
    let apart = HOLD_OUT_DISTANCE * (nx * ny / samples.len() as f64).sqrt();
    let far = |p: &Position| {
        let mut others = samples.as_slice().iter();
        others.all(|s| (s.x() - p.x()).hypot(s.y() - p.y()) > apart)
    };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let positions = (0..count.saturating_mul(HOLD_OUT_TRIES))
        .map(|_| Position::new(unit(&mut rng) * (nx - 1.0), unit(&mut rng) * (ny - 1.0)))
        .filter(|p| p.as_ref().map_or(true, far))
        .take(count)
        .collect::<Result<Vec<_>, _>>()?;
    let enough = count > 0 && positions.len() == count;
    let allowed = "from 1 to as many as fit between the samples of the field";
    SampleError::check(enough, "the number of held-out PSFs", allowed, count)?;
    progress.start(count as u64);
    let stamps = draw_all(source, &positions, progress)?;
    into_samples(source, positions, stamps)
}

/// Draws every sample again at random sub-pixel shifts, so that a basis learns to represent shifted
/// PSFs too.
///
/// Shifts are uniform over `-max_shift_px <= dx, dy < max_shift_px`. Each sample has its own
/// ChaCha stream, given by the seed and the sample's index. The result therefore depends neither on
/// threads nor on the other samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShiftAugmentation {
    copies_per_sample: usize,
    max_shift_px: f64,
    seed: u64,
}

/// The shifted stamps of all samples.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ShiftedStamps {
    /// The stamps `[stamp, y, x]`: all copies of the first sample, then all copies of the next.
    pub stamps: Array3<f64>,
    /// For each stamp, the index of its sample and the shift (dx, dy) in frame pixels.
    pub shifts: Vec<(usize, (f64, f64))>,
}

impl ShiftAugmentation {
    /// An augmentation with `copies_per_sample` stamps of each sample, shifted by at most
    /// `max_shift_px` frame pixels along each axis.
    ///
    /// # Errors
    /// [`SampleError::Setting`] when `copies_per_sample` is 0, or when `max_shift_px` is not above
    /// 0 and at most 0.5.
    pub fn new(copies_per_sample: usize, max_shift_px: f64, seed: u64) -> Result<Self, SampleError> {
        let copies = copies_per_sample;
        SampleError::check(copies > 0, "copies per sample", "at least 1", copies)?;
        let (is_sound, allowed) = (
            max_shift_px > 0.0 && max_shift_px <= 0.5,
            "above 0 and at most 0.5 pixels",
        );
        SampleError::check(is_sound, "the largest shift", allowed, max_shift_px)?;
        Ok(Self {
            copies_per_sample,
            max_shift_px,
            seed,
        })
    }

    /// The shifts `(dx, dy)` of the copies of one sample, in frame pixels.
    pub fn shifts(self, sample: usize) -> impl Iterator<Item = (f64, f64)> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(sample as u64);
        let mut uniform = move || (2.0 * unit(&mut rng) - 1.0) * self.max_shift_px;
        (0..self.copies_per_sample).map(move |_| (uniform(), uniform()))
    }

    /// Draws the shifted stamps of the samples at `positions`, in parallel.
    ///
    /// # Errors
    /// [`SampleError::Draw`] when the source cannot draw, or cannot shift. [`SampleError::Stamp`]
    /// or [`SampleError::NoLight`] when a drawn stamp is not a valid PSF.
    /// [`SampleError::Cancelled`] if `progress` cancels the work.
    pub fn draw(
        &self,
        source: &dyn PsfSource,
        positions: &SamplePositions,
        progress: &dyn Progress,
    ) -> Result<ShiftedStamps, SampleError> {
        let shifts: Vec<_> = (0..positions.len())
            .flat_map(|sample| self.shifts(sample).map(move |shift| (sample, shift)))
            .collect();
        progress.start(shifts.len() as u64);
        let (ny, nx) = source.grid().dim();
        let mut stamps = Array3::zeros((shifts.len(), ny, nx));
        let planes: Vec<_> = stamps.axis_iter_mut(Axis(0)).collect();
        let done: Vec<_> = planes
            .into_par_iter()
            .zip(&shifts)
            .map(|(mut plane, &(sample, shift))| {
                progress.check_cancelled()?;
                let drawn = draw(source, positions.as_slice()[sample], shift);
                progress.advance(1);
                drawn.map(|stamp| plane.assign(&stamp))
            })
            .collect();
        done.into_iter().collect::<Result<(), _>>()?;
        Ok(ShiftedStamps { stamps, shifts })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_tests_are_spread_evenly() {
        let field = FrameShape::new(1001, 501).unwrap();
        for count in [0, 1, 2, 7, 16, 300] {
            let found = test_positions(field, (count, 3), 0).unwrap();
            assert_eq!(found.len(), count);
            assert!(found.iter().all(|p| p.x() <= 1000.0 && p.y() <= 500.0));
            // Every part of the field has its share, up to the parts that it cuts.
            let left = found.iter().filter(|p| p.x() < 500.0).count() as f64;
            let low = found.iter().filter(|p| p.y() < 250.0).count() as f64;
            let cut = (count as f64).sqrt() + 1.0;
            assert!((left - count as f64 / 2.0).abs() <= cut && (low - count as f64 / 2.0).abs() <= cut);
        }
        let first = test_positions(field, (16, 3), 0).unwrap();
        assert_eq!(test_positions(field, (16, 3), 0).unwrap(), first);
        assert_ne!(test_positions(field, (16, 3), 1).unwrap(), first);
        assert_ne!(test_positions(field, (16, 4), 0).unwrap(), first);
    }
}
