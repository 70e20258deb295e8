//! Sampling by kriging: smooth fields need few PSFs, the mesh takes over elsewhere, and nothing that was
//! drawn is lost.

mod common;

use std::sync::Arc;

use common::{Blob, on_threads, relative_l2};
use psf_sample::{
    AdaptiveSampling, DifferenceMeasure, InterpolationError, KrigingSampling, Refinement, SampleError,
    Sampling, SamplingMethod, SamplingOutcome,
};
use psf_types::{NoProgress, Position, PsfSource};

fn kriging(threshold: f64) -> KrigingSampling {
    KrigingSampling::new(threshold, DifferenceMeasure::L2).unwrap()
}

fn mesh(threshold: f64) -> AdaptiveSampling {
    let criterion = InterpolationError::new(threshold, DifferenceMeasure::L2).unwrap();
    AdaptiveSampling::new(Arc::new(criterion))
}

/// Every PSF drawn is a sample, once.
fn assert_nothing_is_lost(sampling: &Sampling, source: &Blob) {
    let mut drawn = source.drawn.lock().unwrap().clone();
    let at = sampling.samples.positions().as_slice().iter();
    let mut kept: Vec<(f64, f64)> = at.map(|p| (p.x(), p.y())).collect();
    assert_eq!(sampling.report.draws, drawn.len());
    for list in [&mut drawn, &mut kept] {
        list.sort_by(|a, b| a.partial_cmp(b).unwrap());
    }
    assert!(drawn == kept, "{} drawn, {} kept", drawn.len(), kept.len());
    for (k, &(x, y)) in kept.iter().enumerate().step_by(17) {
        let samples = &sampling.samples;
        let place = samples
            .positions()
            .as_slice()
            .iter()
            .position(|p| (p.x(), p.y()) == (x, y));
        let stamp = samples.stamp(place.expect("a sample"));
        assert_eq!(relative_l2(stamp, source.at(x, y).view()), 0.0, "sample {k}");
    }
}

fn smooth(x: f64, y: f64) -> f64 {
    1.8 + 0.3 * (3.0 * x).sin() * (2.0 * y).cos() + 0.2 * x * x
}

fn step(x: f64, y: f64) -> f64 {
    smooth(x, y) * if x + 0.4 * y < 0.5 { 1.0 } else { 1.1 }
}

fn kink(x: f64, y: f64) -> f64 {
    smooth(x, y) + 0.8 * (x + 0.5 * y - 0.7).abs()
}

/// A hot spot that covers a part of the field.
fn spot(x: f64, y: f64, at: (f64, f64), part: f64) -> f64 {
    let square = ((x - at.0).powi(2) + (y - at.1).powi(2)) * std::f64::consts::PI / part;
    smooth(x, y) * (1.0 + 0.2 * (1.0 - square).max(0.0).powi(2))
}

fn spot_of_5_percent(x: f64, y: f64) -> f64 {
    spot(x, y, (0.31, 0.62), 0.05)
}

fn spot_of_1_percent(x: f64, y: f64) -> f64 {
    spot(x, y, (0.72, 0.17), 0.01)
}

#[test]
fn a_smooth_field_needs_few_psfs() {
    for threshold in [1e-2, 1e-3, 1e-4] {
        let source = Blob::new(1000, 800, smooth);
        let sampling = kriging(threshold).sample(&source, &NoProgress).unwrap();
        let report = &sampling.report;
        assert_eq!(
            (report.refinement, report.outcome),
            (Some(Refinement::Kriging), SamplingOutcome::Met)
        );
        assert!(report.draws <= 110, "{threshold}: {} draws", report.draws);
        assert!(report.worst <= threshold && report.expected.unwrap() <= threshold);
        let random = report.verification.unwrap();
        assert_eq!((random.tests, random.above), (16, 0));
        assert!(random.worst <= threshold && random.draws >= 16);
        assert!((random.fraction_limit() - 0.1707).abs() < 1e-4);
        assert_nothing_is_lost(&sampling, &source);
        let at = sampling.samples.positions().as_slice();
        for (x, y) in [(0, 0), (999, 0), (0, 799), (999, 799)] {
            assert!(at.contains(&Position::of_pixel(x, y)), "corner ({x}, {y})");
        }
    }
}

#[test]
fn a_constant_field_is_still_looked_at_everywhere() {
    let source = Blob::new(500, 300, |_, _| 2.0);
    let sampling = kriging(0.01)
        .with_verify(0, 1)
        .sample(&source, &NoProgress)
        .unwrap();
    assert_eq!(sampling.report.verification, None);
    let at = sampling.samples.positions().as_slice();
    // No circle of 4 % of the field is empty.
    for i in 0..=40 {
        for j in 0..=40 {
            let (x, y) = (f64::from(i) / 40.0, f64::from(j) / 40.0);
            let far = |p: &Position| (p.x() / 499.0 - x).hypot(p.y() / 299.0 - y);
            let gap = at.iter().map(far).fold(f64::INFINITY, f64::min);
            assert!(gap < 0.13, "({x}, {y}): {gap}");
        }
    }
    assert!(at.len() <= 64, "{}", at.len());
}

#[test]
fn the_mesh_takes_over_where_the_psf_is_not_smooth() {
    for (name, shape, verify) in [
        ("kink", kink as fn(f64, f64) -> f64, 16),
        ("hot spot of 5 %", spot_of_5_percent, 16),
        ("hot spot of 1 %", spot_of_1_percent, 300),
    ] {
        let source = Blob::new(1000, 1000, shape);
        let of_mesh = mesh(0.01).sample(&source, &NoProgress).unwrap().report.draws;
        source.drawn.lock().unwrap().clear();
        let sampling = kriging(0.01)
            .with_verify(verify, 3)
            .sample(&source, &NoProgress)
            .unwrap();
        let report = &sampling.report;
        assert_eq!(
            (report.refinement, report.outcome),
            (Some(Refinement::Mesh), SamplingOutcome::Met),
            "{name}"
        );
        let random = report.verification.unwrap();
        assert_eq!((random.tests, random.above), (verify, 0), "{name}");
        assert!(
            report.draws - random.draws <= of_mesh + 150,
            "{name}: {} draws, {of_mesh} of the mesh alone",
            report.draws - random.draws
        );
        assert_nothing_is_lost(&sampling, &source);
    }
}

#[test]
fn a_step_is_an_error_that_says_where_and_carries_the_samples() {
    let source = Blob::new(100, 100, step);
    let error = kriging(0.01).sample(&source, &NoProgress).unwrap_err();
    let SampleError::NotMet(found) = error else {
        panic!("{error}")
    };
    let text = found.to_string();
    assert!(
        text.contains("cells between samples cannot be smaller") && text.contains("random tests"),
        "{text}"
    );
    assert_eq!(found.wanted(), None);
    let sampling = found.into_sampling();
    assert_eq!(sampling.report.outcome, SamplingOutcome::CellSizeReached);
    let worst = sampling.report.worst_at.unwrap();
    let beside = (worst.x() / 99.0 + 0.4 * worst.y() / 99.0 - 0.5).abs();
    assert!(sampling.report.worst > 0.05 && beside < 0.02, "{worst}");
    assert!(
        text.contains(&format!("({:.1}, {:.1})", worst.x(), worst.y())),
        "{text}"
    );
    assert_nothing_is_lost(&sampling, &source);
}

#[test]
fn the_budget_is_an_error_that_carries_the_samples() {
    // Before kriging is sure, in its verification, before the mesh begins, and in it.
    for (shape, most) in [
        (smooth as fn(f64, f64) -> f64, 37),
        (smooth, 70),
        (kink, 140),
        (kink, 300),
    ] {
        let source = Blob::new(1000, 1000, shape);
        let method = kriging(1e-3).with_max_draws(most).unwrap();
        let error = method.sample(&source, &NoProgress).unwrap_err();
        let SampleError::NotMet(found) = error else {
            panic!("{error}")
        };
        assert!(
            found.to_string().contains(&format!("{most} draws allowed")),
            "{found}"
        );
        assert!(found.wanted().unwrap() > most);
        let sampling = found.into_sampling();
        assert_eq!(sampling.report.outcome, SamplingOutcome::CapReached);
        assert!(sampling.samples.len() <= most && 2 * sampling.samples.len() > most);
        assert_nothing_is_lost(&sampling, &source);
    }
}

#[test]
fn threads_change_nothing_and_seeds_only_the_random_tests() {
    for shape in [smooth as fn(f64, f64) -> f64, spot_of_5_percent] {
        let runs = on_threads(|| {
            let source = Blob::new(700, 500, shape);
            kriging(0.01).sample(&source, &NoProgress).unwrap()
        });
        assert!(runs[0] == runs[1] && runs[0] == runs[2]);
        let source = Blob::new(700, 500, shape);
        let other = kriging(0.01)
            .with_verify(16, 2)
            .sample(&source, &NoProgress)
            .unwrap();
        assert_ne!(other.samples, runs[0].samples);
    }
}

#[test]
fn frames_of_any_shape_are_covered() {
    for (nx, ny) in [(1, 1), (2, 1), (1, 7), (2, 2), (3, 5), (200, 3), (3000, 1)] {
        let source = Blob::new(nx, ny, |x, y| 1.5 + 0.5 * x * y + 0.3 * x);
        let sampling = kriging(0.02).sample(&source, &NoProgress).unwrap();
        assert_eq!(sampling.report.outcome, SamplingOutcome::Met, "{nx} x {ny}");
        let at = sampling.samples.positions().as_slice();
        for (x, y) in [(0, 0), (nx - 1, 0), (0, ny - 1), (nx - 1, ny - 1)] {
            let corner = Position::of_pixel(x as i64, y as i64);
            assert!(at.contains(&corner), "{nx} x {ny}: {corner}");
        }
        let field = source.field();
        assert!(
            at.iter()
                .all(|p| p.x() <= (field.nx() - 1) as f64 && p.y() <= (field.ny() - 1) as f64)
        );
    }
}

#[test]
fn the_measure_of_errors_is_kept() {
    let source = Blob::new(1000, 800, smooth);
    for measure in [DifferenceMeasure::L1, DifferenceMeasure::L2] {
        let method = KrigingSampling::new(1e-3, measure).unwrap();
        let sampling = method.sample(&source, &NoProgress).unwrap();
        assert!(
            sampling.report.draws <= 120 && sampling.report.worst <= 1e-3,
            "{measure:?}"
        );
    }
    assert!(KrigingSampling::new(0.0, DifferenceMeasure::L2).is_err());
    assert!(kriging(0.01).with_max_draws(15).is_err());
}
