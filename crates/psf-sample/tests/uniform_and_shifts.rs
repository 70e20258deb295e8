//! Uniform sampling, sub-pixel shifts and progress.

mod common;

use std::sync::atomic::{AtomicU64, Ordering};

use common::{Blob, on_threads};
use ndarray::{Array2, ArrayViewMut2, Axis};
use psf_sample::{
    AdaptiveSampling, DifferenceMeasure, SampleError, SamplingMethod, ShiftAugmentation, UniformSampling,
    hold_out,
};
use psf_types::{FrameShape, NoProgress, Position, Progress, PsfSource, SourceError, StampGrid};

#[test]
fn the_grid_reaches_the_corners_whatever_its_size() {
    for (n, pixels) in [(2, 9232), (71, 9232), (7, 1000), (49, 4096)] {
        let positions = UniformSampling::new(n, n)
            .unwrap()
            .positions(FrameShape::new(pixels, 77).unwrap())
            .unwrap();
        let last = positions[n * n - 1];
        assert_eq!((positions[0].x(), positions[0].y()), (0.0, 0.0));
        assert_eq!((last.x(), last.y()), ((pixels - 1) as f64, 76.0));
        assert_eq!(positions.len(), n * n);
    }
    let line = UniformSampling::new(4, 1)
        .unwrap()
        .positions(FrameShape::new(10, 1).unwrap())
        .unwrap();
    assert_eq!((line[3].x(), line[3].y()), (9.0, 0.0));
    assert!(UniformSampling::new(0, 3).is_err());
    let refused = |nx, ny, field: (usize, usize)| {
        UniformSampling::new(nx, ny)
            .unwrap()
            .positions(FrameShape::new(field.0, field.1).unwrap())
            .is_err()
    };
    assert!(refused(1, 2, (10, 10)) && refused(2, 1, (10, 10)) && refused(2, 2, (10, 1)));
}

#[test]
fn uniform_samples_and_their_worst_neighbours() {
    let source = Blob::new(100, 60, |x, y| 1.5 + 0.4 * x + 0.1 * y);
    let method = UniformSampling::new(5, 4)
        .unwrap()
        .with_measure(DifferenceMeasure::L1);
    let sampling = method.sample(&source, &NoProgress).unwrap();
    assert_eq!((sampling.samples.len(), source.distinct_draws()), (20, 20));
    assert_eq!(sampling.samples.stamp(7), source.at(99.0 * 2.0 / 4.0, 59.0 / 3.0));
    // The PSF changes fastest where it is smallest, and more along x.
    let expected = DifferenceMeasure::L1.between(source.at(0.0, 0.0).view(), source.at(24.75, 0.0).view());
    assert!((sampling.report.worst - expected).abs() < 1e-15);
    assert_eq!(sampling.report.threshold, None);
}

#[test]
fn shifts_are_seeded_bounded_and_independent_of_threads() {
    let source = Blob::new(100, 60, |x, _| 1.5 + 0.4 * x);
    let samples = UniformSampling::new(3, 3)
        .unwrap()
        .sample(&source, &NoProgress)
        .unwrap()
        .samples;
    let draw = |seed| {
        let augmentation = ShiftAugmentation::new(40, 0.3, seed).unwrap();
        augmentation
            .draw(&source, samples.positions(), &NoProgress)
            .unwrap()
    };
    let runs = on_threads(|| draw(5));
    assert!(runs[0] == runs[1] && runs[0] == runs[2]);
    assert_ne!(runs[0], draw(6));
    let shifted = &runs[0];
    assert_eq!((shifted.stamps.dim(), shifted.shifts.len()), ((360, 13, 13), 360));
    for (i, &(sample, (dx, dy))) in shifted.shifts.iter().enumerate() {
        assert_eq!(sample, i / 40);
        assert!(dx.abs() <= 0.3 && dy.abs() <= 0.3);
    }
    // 720 uniform numbers: mean 0 +- 0.0065, mean square 0.03 +- 0.001.
    let all: Vec<f64> = shifted
        .shifts
        .iter()
        .flat_map(|(_, (dx, dy))| [*dx, *dy])
        .collect();
    let mean = |f: fn(f64) -> f64| all.iter().map(|&v| f(v)).sum::<f64>() / all.len() as f64;
    assert!(mean(|v| v).abs() < 0.03 && (mean(|v| v * v) - 0.03).abs() < 0.005);
    let distinct: std::collections::HashSet<u64> = all.iter().map(|v| v.to_bits()).collect();
    assert_eq!(distinct.len(), all.len(), "every stream differs");
    // The stamp belongs to its shift: its centroid moves by the same amount.
    let (_, (dx, _)) = shifted.shifts[0];
    let stamp = shifted.stamps.index_axis(Axis(0), 0);
    let centroid: f64 = stamp
        .indexed_iter()
        .map(|((_, x), v)| v * (x as f64 - 6.0))
        .sum::<f64>()
        / stamp.sum();
    assert!((centroid - dx).abs() < 1e-3, "{centroid} {dx}");
    // The shifts of a sample do not depend on the number of other samples.
    let few = psf_types::SamplePositions::new(samples.positions().as_slice()[..2].to_vec(), None).unwrap();
    let part = ShiftAugmentation::new(40, 0.3, 5)
        .unwrap()
        .draw(&source, &few, &NoProgress)
        .unwrap();
    assert_eq!(part.shifts[..], shifted.shifts[..80]);
}

struct NoShift;

impl PsfSource for NoShift {
    fn grid(&self) -> StampGrid {
        StampGrid::new(3, 3).unwrap()
    }
    fn field(&self) -> FrameShape {
        FrameShape::new(10, 10).unwrap()
    }
    fn draw_into(&self, _: Position, mut stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
        stamp.assign(&Array2::ones((3, 3)));
        Ok(())
    }
}

#[test]
fn sources_that_cannot_shift_and_bad_settings_are_refused() {
    let samples = UniformSampling::new(2, 2)
        .unwrap()
        .sample(&NoShift, &NoProgress)
        .unwrap()
        .samples;
    let error = ShiftAugmentation::new(1, 0.5, 0)
        .unwrap()
        .draw(&NoShift, samples.positions(), &NoProgress);
    assert!(matches!(
        error,
        Err(SampleError::Draw {
            source: SourceError::ShiftUnsupported,
            ..
        })
    ));
    for (copies, shift) in [(0, 0.5), (1, 0.0), (1, 0.51), (1, f64::NAN)] {
        assert!(ShiftAugmentation::new(copies, shift, 0).is_err());
    }
}

#[derive(Default)]
struct Count {
    total: AtomicU64,
    done: AtomicU64,
}

impl Progress for Count {
    fn start(&self, total: u64) {
        assert!(
            total >= self.total.swap(total, Ordering::SeqCst),
            "the total only grows"
        );
    }
    fn advance(&self, steps: u64) {
        self.done.fetch_add(steps, Ordering::SeqCst);
    }
}

#[test]
fn progress_ends_at_its_total() {
    let methods: [Box<dyn SamplingMethod>; 2] = [
        Box::new(AdaptiveSampling::default()),
        Box::new(UniformSampling::new(6, 5).unwrap()),
    ];
    for method in methods {
        let (source, count) = (Blob::new(300, 300, |x, y| 1.5 + 0.3 * x * y), Count::default());
        let sampling = method.sample(&source, &count).unwrap();
        assert_eq!(count.total.into_inner(), sampling.report.draws as u64);
        assert_eq!(count.done.into_inner(), sampling.report.draws as u64);
    }
}

/// Cancels the work after some steps.
struct Cancelling(AtomicU64);

impl Progress for Cancelling {
    fn start(&self, _: u64) {}
    fn advance(&self, steps: u64) {
        self.0.fetch_sub(steps, Ordering::SeqCst);
    }
    fn cancelled(&self) -> bool {
        self.0.load(Ordering::SeqCst) as i64 <= 0
    }
}

/// Work that returns its error.
type Work<'a> = &'a dyn Fn(&dyn Progress) -> Option<SampleError>;

#[test]
fn a_cancelled_sampling_stops() {
    let source = Blob::new(300, 300, |x, y| 1.5 + 0.3 * x * y);
    let uniform = UniformSampling::new(40, 40).unwrap();
    let samples = UniformSampling::new(4, 4).unwrap();
    let samples = samples.sample(&source, &NoProgress).unwrap().samples;
    let shifts = ShiftAugmentation::new(100, 0.5, 1).unwrap();
    let works: [Work<'_>; 4] = [
        &|progress| uniform.sample(&source, progress).err(),
        &|progress| AdaptiveSampling::default().sample(&source, progress).err(),
        &|progress| hold_out(&source, samples.positions(), (1000, 1), progress).err(),
        &|progress| shifts.draw(&source, samples.positions(), progress).err(),
    ];
    for work in works {
        let progress = Cancelling(AtomicU64::new(3));
        assert!(matches!(work(&progress), Some(SampleError::Cancelled(_))));
        // Each thread may have drawn one PSF more.
        let more = -(progress.0.into_inner() as i64);
        assert!(more <= rayon::current_num_threads() as i64, "{more} more");
    }
}

#[test]
fn held_out_psfs_lie_between_the_samples() {
    const COUNT: usize = 400;
    let source = Blob::new(201, 101, |u, v| 1.0 + u + v);
    let samples = UniformSampling::new(9, 5).unwrap();
    let samples = samples.sample(&source, &NoProgress).unwrap().samples;
    let drawn = |seed| hold_out(&source, samples.positions(), (COUNT, seed), &NoProgress).unwrap();
    let found = drawn(3);
    assert_eq!((found.len(), found.grid()), (COUNT, source.grid()));
    let (mut x, mut y) = (0.0, 0.0);
    for (k, at) in found.positions().as_slice().iter().enumerate() {
        assert_eq!(found.stamp(k), source.at(at.x(), at.y()).view());
        // A tenth of the mean distance, about 21 pixels.
        for sample in samples.positions().as_slice() {
            assert!((sample.x() - at.x()).hypot(sample.y() - at.y()) > 2.1);
        }
        (x, y) = (x + at.x() / COUNT as f64, y + at.y() / COUNT as f64);
    }
    // The mean of uniform positions, with four times its standard error.
    assert!(
        (x - 100.0).abs() < 4.0 * 200.0 / (12.0 * COUNT as f64).sqrt(),
        "{x}"
    );
    assert!(
        (y - 50.0).abs() < 4.0 * 100.0 / (12.0 * COUNT as f64).sqrt(),
        "{y}"
    );
    assert!(drawn(3) == found && drawn(4) != found);

    // A field of one pixel has no room.
    let point = Blob::new(1, 1, |_, _| 1.0);
    let sample = UniformSampling::new(1, 1).unwrap();
    let sample = sample.sample(&point, &NoProgress).unwrap().samples;
    for (source, samples, count) in [(&point, &sample, 1), (&source, &samples, 0)] {
        let refused = hold_out(source, samples.positions(), (count, 1), &NoProgress).unwrap_err();
        assert!(refused.to_string().contains("held-out PSFs"), "{refused}");
    }
}
