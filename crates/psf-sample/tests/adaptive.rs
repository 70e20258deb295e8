//! Adaptive sampling: the criterion holds, corners and edges are covered, and the report states
//! every outcome.

mod common;

use std::collections::HashMap;
use std::sync::Arc;

use common::{Blob, on_threads};
use psf_sample::{
    AdaptiveSampling, DifferenceMeasure, InterpolationError, NeighbourDifference, SampleError, Sampling,
    SamplingMethod, SamplingOutcome,
};
use psf_types::{NoProgress, PsfSource};

fn neighbours(threshold: f64) -> AdaptiveSampling {
    AdaptiveSampling::new(Arc::new(
        NeighbourDifference::new(threshold, DifferenceMeasure::L2).unwrap(),
    ))
}

fn interpolation(threshold: f64) -> AdaptiveSampling {
    AdaptiveSampling::new(Arc::new(
        InterpolationError::new(threshold, DifferenceMeasure::L2).unwrap(),
    ))
}

fn sample(method: &AdaptiveSampling, source: &dyn PsfSource) -> Sampling {
    method.sample(source, &NoProgress).unwrap()
}

fn positions(sampling: &Sampling) -> Vec<(f64, f64)> {
    sampling
        .samples
        .positions()
        .as_slice()
        .iter()
        .map(|p| (p.x(), p.y()))
        .collect()
}

/// Varies mostly in the corner (1, 1).
fn corner(x: f64, y: f64) -> f64 {
    1.5 + (-((x - 1.0).powi(2) + (y - 1.0).powi(2)) / 0.02).exp()
}

#[test]
fn a_constant_field_needs_only_the_starting_grid() {
    let source = Blob::new(500, 300, |_, _| 2.0);
    let sampling = sample(&AdaptiveSampling::default(), &source);
    assert_eq!(
        (
            sampling.samples.len(),
            sampling.report.draws,
            source.distinct_draws()
        ),
        // The samples, and the middles of 16 cells and 40 edges.
        (25, 81, 81)
    );
    assert_eq!(
        (sampling.report.outcome, sampling.report.worst),
        (SamplingOutcome::Met, 0.0)
    );
    let small = AdaptiveSampling::default().with_start(2, 3).unwrap();
    let expected = [
        (0.0, 0.0),
        (499.0, 0.0),
        (0.0, 149.5),
        (499.0, 149.5),
        (0.0, 299.0),
        (499.0, 299.0),
    ];
    assert_eq!(positions(&sample(&small, &source)), expected);
}

#[test]
fn neighbours_differ_little_and_corners_and_edges_are_sampled() {
    for measure in [DifferenceMeasure::L1, DifferenceMeasure::L2] {
        let source = Blob::new(1000, 800, corner);
        let criterion = NeighbourDifference::new(0.03, measure).unwrap();
        let sampling = sample(&AdaptiveSampling::new(Arc::new(criterion)), &source);
        assert_eq!(sampling.report.outcome, SamplingOutcome::Met);
        assert_eq!(sampling.report.draws, source.distinct_draws());
        let at = positions(&sampling);
        assert!(
            at.windows(2).all(|w| (w[0].1, w[0].0) < (w[1].1, w[1].0)),
            "ordered by y, then x, no duplicates"
        );
        for c in [(0.0, 0.0), (999.0, 0.0), (0.0, 799.0), (999.0, 799.0)] {
            assert!(at.contains(&c), "corner {c:?}");
        }
        // Checked independently of the mesh: neighbouring samples of each row and each column
        // differ little. The exception is a coarse cell's edge beyond a region of finer rows, whose
        // ends are not neighbours.
        let mut rows: HashMap<u64, Vec<usize>> = HashMap::new();
        for (i, p) in at.iter().enumerate() {
            rows.entry(p.1.to_bits()).or_default().push(i);
        }
        let mut worst = 0f64;
        for ends in rows.values() {
            for pair in ends.windows(2) {
                let [a, b] = [pair[0], pair[1]];
                let between = |other: &(f64, f64)| {
                    (other.1 - at[a].1).abs() < 0.6 * (at[b].0 - at[a].0)
                        && other.0 > at[a].0 + 1e-9
                        && other.0 < at[b].0 - 1e-9
                        && other.1 != at[a].1
                };
                if !at.iter().any(between) {
                    worst = worst.max(measure.between(sampling.samples.stamp(a), sampling.samples.stamp(b)));
                }
            }
        }
        assert!(worst > 0.01 && worst <= 0.03, "{measure:?}: {worst}");
        assert!(sampling.report.worst <= 0.03 && sampling.report.worst >= worst - 1e-12);
    }
}

#[test]
fn samples_gather_where_the_psf_varies() {
    let source = Blob::new(1000, 1000, corner);
    let sampling = sample(&neighbours(0.02), &source);
    let near = positions(&sampling)
        .iter()
        .filter(|p| p.0 > 500.0 && p.1 > 500.0)
        .count();
    assert!(
        near > 9 * (sampling.samples.len() - near),
        "{near} of {} in the quarter",
        sampling.samples.len()
    );
}

#[test]
fn variation_along_one_axis_is_sampled_along_it() {
    let source = Blob::new(1000, 1000, |x, _| 1.5 + x);
    let free = sample(&neighbours(0.02).with_max_aspect(1e6).unwrap(), &source);
    let rows = positions(&free).iter().filter(|p| p.0 == 0.0).count();
    assert_eq!(rows, 5, "no row is added for a field that varies only along x");
    assert!(
        free.samples.len().is_multiple_of(5) && free.samples.len() > 100,
        "{}",
        free.samples.len()
    );
    let bounded = sample(&neighbours(0.02), &source);
    let square = sample(&neighbours(0.02).with_max_aspect(1.0).unwrap(), &source);
    assert!(free.samples.len() < bounded.samples.len() && bounded.samples.len() < square.samples.len());
    assert!(square.report.worst <= 0.02 && bounded.report.worst <= 0.02 && free.report.worst <= 0.02);
}

#[test]
fn midpoints_meet_the_interpolation_error_and_become_samples() {
    let source = Blob::new(1000, 1000, corner);
    let sampling = sample(&interpolation(0.01), &source);
    assert_eq!(sampling.report.outcome, SamplingOutcome::Met);
    assert!(sampling.report.worst <= 0.01 && sampling.report.worst > 0.002);
    assert_eq!(sampling.report.draws, source.distinct_draws());
    assert!(sampling.report.draws > sampling.samples.len());
}

#[test]
fn the_cap_is_an_error_that_carries_the_samples() {
    let source = Blob::new(1000, 1000, corner);
    let needed = sample(&neighbours(0.01), &source).report.draws;
    let roomy = neighbours(0.01)
        .with_max_draws(needed)
        .sample(&source, &NoProgress)
        .unwrap();
    assert_eq!(roomy.report.outcome, SamplingOutcome::Met);
    for (method, fewest) in [(neighbours(0.01), 250), (interpolation(0.002), 250)] {
        let capped = method.with_max_draws(300);
        let SampleError::NotMet(found) = capped.sample(&source, &NoProgress).unwrap_err() else {
            panic!("the cap is reached");
        };
        let message = found.to_string();
        assert!(
            message.contains("with the 300 draws allowed") && message.contains("Raise the number of draws"),
            "{message}"
        );
        assert!(found.wanted().unwrap() > 300 && found.most_draws() == 300);
        let sampling = found.into_sampling();
        assert!(
            (fewest..=300).contains(&sampling.report.draws),
            "the draws nearly reach the cap: {}",
            sampling.report.draws
        );
        assert_eq!(sampling.report.outcome, SamplingOutcome::CapReached);
        assert!(sampling.report.unmet_cells > 0 && sampling.report.worst > 0.002);
    }
    let too_few = neighbours(0.01)
        .with_max_draws(24)
        .sample(&source, &NoProgress)
        .unwrap_err();
    assert!(
        too_few.to_string().contains("24 where the grid needs 25"),
        "{too_few}"
    );
}

#[test]
fn a_psf_that_jumps_ends_at_the_smallest_cell_and_is_reported() {
    let source = Blob::new(65, 65, |x, _| if x < 0.4 { 1.5 } else { 2.5 });
    let sampling = sample(&neighbours(0.01), &source);
    assert_eq!(sampling.report.outcome, SamplingOutcome::CellSizeReached);
    assert!(sampling.report.unmet_cells > 0 && sampling.report.worst > 0.3);
    let at = positions(&sampling);
    let narrowest = at
        .windows(2)
        .filter(|w| w[0].1 == w[1].1)
        .map(|w| w[1].0 - w[0].0)
        .fold(f64::MAX, f64::min);
    assert_eq!(narrowest, 1.0);
    let coarse = sample(&neighbours(0.01).with_min_cell_px(8.0).unwrap(), &source);
    assert_eq!(coarse.report.outcome, SamplingOutcome::CellSizeReached);
    assert!(coarse.samples.len() < sampling.samples.len());
}

#[test]
fn threads_change_nothing() {
    let runs = on_threads(|| sample(&interpolation(0.01), &Blob::new(700, 500, corner)));
    assert!(runs[0] == runs[1] && runs[0] == runs[2]);
    let capped = |cap: usize| {
        let error = neighbours(0.01)
            .with_max_draws(cap)
            .sample(&Blob::new(700, 500, corner), &NoProgress);
        match error {
            Err(SampleError::NotMet(reached)) => reached.into_sampling(),
            other => panic!("{other:?}"),
        }
    };
    let runs = on_threads(|| capped(200));
    assert!(runs[0] == runs[1] && runs[0] == runs[2]);
}

#[test]
fn frames_of_any_shape_are_covered() {
    for (nx, ny) in [(1, 1), (2, 1), (1, 7), (2, 2), (3, 5), (200, 3)] {
        let source = Blob::new(nx, ny, |x, y| 1.5 + 0.5 * x * y + 0.3 * x);
        for method in [neighbours(0.02), interpolation(0.02)] {
            let sampling = sample(&method, &source);
            let at = positions(&sampling);
            let (right, top) = ((nx - 1) as f64, (ny - 1) as f64);
            for c in [(0.0, 0.0), (right, 0.0), (0.0, top), (right, top)] {
                assert!(at.contains(&c), "{nx} x {ny}: {c:?}");
            }
            source.distinct_draws();
            source.drawn.lock().unwrap().clear();
        }
    }
}

#[test]
fn settings_are_checked() {
    assert!(NeighbourDifference::new(0.0, DifferenceMeasure::L1).is_err());
    assert!(InterpolationError::new(f64::INFINITY, DifferenceMeasure::L1).is_err());
    let method = AdaptiveSampling::default;
    assert!(method().with_start(1, 5).is_err() && method().with_start(5, 5000).is_err());
    assert!(method().with_min_cell_px(0.0).is_err() && method().with_max_aspect(0.5).is_err());
    assert!(method().with_max_aspect(f64::NAN).is_err());
}
