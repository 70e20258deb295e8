//! Leave-one-out: the shortcuts agree with rebuilding without each sample.

mod common;

use std::sync::Arc;

use coeff_field::{
    CoeffFieldError, FieldInterpolation, LeaveOneOut, LeftOut, NaturalNeighbour, Polynomial, Unpredictable,
    leave_one_out,
};
use common::{Extent, layouts, methods, samples_of, scattered};
use psf_types::{CoefficientField, OutsidePolicy, Position, SampleCoefficients};

/// Rounding of predictions of order 1.
const ROUNDING: f64 = 1e-8;
/// Tolerance for an ill conditioned case: a quadratic fit to a strip 1e-5 wide.
const ILL_CONDITIONED: f64 = 1e-5;

/// Natural neighbours and inverse distances predict a sample from their own weights, not from those of
/// a tree without the sample.
const TREE: f64 = 0.3;

/// A method without its shortcut.
#[derive(Debug)]
struct Rebuilt<'a>(&'a dyn FieldInterpolation);

impl FieldInterpolation for Rebuilt<'_> {
    fn interpolate(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<Arc<dyn CoefficientField>, CoeffFieldError> {
        self.0.interpolate(samples, outside)
    }
}

fn bumps(positions: &[Position]) -> SampleCoefficients {
    let extent = Extent::of(positions);
    samples_of(positions, 3, |p, k| {
        let (x, y) = extent.relative(p);
        (5.0 * x + k as f64).sin() * (4.0 * y).cos()
    })
}

fn assert_same(fast: &LeaveOneOut, slow: &LeaveOneOut, tolerance: f64, what: &str) {
    assert_eq!(fast.outcomes().len(), slow.outcomes().len());
    for (sample, (a, b)) in fast.outcomes().iter().zip(slow.outcomes()).enumerate() {
        let same = match (a, b) {
            (LeftOut::Predicted { error: a }, LeftOut::Predicted { error: b })
            | (LeftOut::Extrapolated { error: a }, LeftOut::Extrapolated { error: b }) => {
                (a - b).abs() <= tolerance * (1.0 + a.abs())
            }
            (LeftOut::Unpredictable { .. }, LeftOut::Unpredictable { .. }) => true,
            _ => false,
        };
        assert!(same, "{what}, sample {sample}: {a:?} {b:?}");
    }
}

#[test]
fn shortcuts_agree_with_rebuilding() {
    // Layouts with many samples on one circle are omitted: their triangulation is ambiguous.
    let mut all: Vec<_> = layouts()
        .into_iter()
        .filter(|(layout, _)| !matches!(*layout, "grid" | "turned grid" | "l-shape" | "circle" | "fan"))
        .collect();
    all.push(("many", scattered(400, 31, 0.0, 1000.0)));
    all.push((
        "wide",
        scattered(150, 33, 0.0, 1.0)
            .iter()
            .map(|p| common::at(p.x() * 500.0, p.y() * 20.0))
            .collect(),
    ));
    for (layout, positions) in all {
        let samples = bumps(&positions);
        for (name, method) in methods(samples.positions()) {
            let on_tree = matches!(name, "natural-neighbour" | "idw" | "idw=3.5");
            // The cells of a tree do not follow a thin strip. Many trees of many samples take long.
            if on_tree && matches!(layout, "thin strip" | "many" | "wide") {
                continue;
            }
            for outside in [
                OutsidePolicy::Nearest,
                OutsidePolicy::Extend,
                OutsidePolicy::Error,
            ] {
                if on_tree && outside != OutsidePolicy::Nearest {
                    continue;
                }
                let fast = method.leave_one_out(&samples, outside).unwrap();
                let slow = Rebuilt(method.as_ref()).leave_one_out(&samples, outside).unwrap();
                let what = format!("{layout} {name} {outside}");
                let tolerance = match (layout, name) {
                    ("thin strip", "polynomial=2") => ILL_CONDITIONED,
                    _ if on_tree => f64::INFINITY,
                    _ => ROUNDING,
                };
                assert_same(&fast, &slow, tolerance, &what);
                if let (Some(a), Some(b)) = (fast.rms(), slow.rms()) {
                    assert!((a - b).abs() <= TREE * a, "{what}: {a} {b}");
                }
            }
        }
    }
}

#[test]
fn natural_neighbours_on_a_grid_have_no_ties() {
    let samples = bumps(&common::grid(9, 8, 10.0, 0.0, 0.0));
    let fast = leave_one_out(&samples, &NaturalNeighbour, OutsidePolicy::Nearest).unwrap();
    let slow = Rebuilt(&NaturalNeighbour)
        .leave_one_out(&samples, OutsidePolicy::Nearest)
        .unwrap();
    assert_same(&fast, &slow, 0.4 * TREE, "grid");
    // Only the corners are extrapolated.
    let extrapolated = fast
        .outcomes()
        .iter()
        .filter(|o| matches!(o, LeftOut::Extrapolated { .. }))
        .count();
    assert_eq!((extrapolated, fast.predicted().count()), (4, 68));
}

#[test]
fn linear_values_are_predicted_exactly_and_one_outlier_is_found() {
    let positions = scattered(80, 41, 0.0, 100.0);
    let outlier = positions[17];
    let samples = samples_of(&positions, 2, |p, k| {
        0.1 * p.x() - 0.2 * p.y() + f64::from(u8::from(p == outlier && k == 1))
    });
    for name in ["delaunay", "natural-neighbour", "polynomial=2"] {
        let method = coeff_field::interpolation(name.parse().unwrap()).unwrap();
        let errors = leave_one_out(&samples, method.as_ref(), OutsidePolicy::Error).unwrap();
        let (sample, error) = errors.worst().unwrap();
        assert_eq!(sample, 17, "{name}");
        assert!((error - 1.0).abs() < 1e-9, "{name}: {error}");
        assert!(errors.rms().unwrap() < 0.3);
        let refused = errors
            .outcomes()
            .iter()
            .filter(|o| {
                matches!(
                    o,
                    LeftOut::Unpredictable {
                        reason: Unpredictable::OutsideSamples
                    }
                )
            })
            .count();
        assert!(refused > 3 && refused < 25, "{name}: {refused} corners");
        assert_eq!(refused + errors.predicted().count(), 80);
    }
}

#[test]
fn indispensable_samples_are_unpredictable() {
    // There are as many samples as terms, so each sample is needed.
    let positions = scattered(6, 43, 0.0, 10.0);
    let errors = leave_one_out(
        &bumps(&positions),
        &Polynomial::new(2).unwrap(),
        OutsidePolicy::Extend,
    )
    .unwrap();
    assert!(errors.outcomes().iter().all(|o| matches!(
        o,
        LeftOut::Unpredictable {
            reason: Unpredictable::Undetermined
        }
    )));
    assert!(errors.worst().is_none() && errors.rms().is_none());
    let alone = bumps(&positions[..1]);
    for (name, method) in methods(alone.positions()) {
        let errors = method.leave_one_out(&alone, OutsidePolicy::Nearest).unwrap();
        assert!(
            matches!(errors.outcomes(), [LeftOut::Unpredictable { .. }]),
            "{name}"
        );
    }
}

#[test]
fn leave_one_out_of_thousands_of_samples_is_fast() {
    let samples = bumps(&scattered(5000, 47, 0.0, 9000.0));
    let start = std::time::Instant::now();
    for name in ["delaunay", "natural-neighbour", "idw", "polynomial=6", "nearest"] {
        let method = coeff_field::interpolation(name.parse().unwrap()).unwrap();
        let errors = leave_one_out(&samples, method.as_ref(), OutsidePolicy::Extend).unwrap();
        assert!(errors.predicted().count() > 4950, "{name}");
    }
    // Rebuilding 5000 triangulations would take about half a minute per method in an optimised
    // build.
    let limit = if cfg!(debug_assertions) { 300 } else { 20 };
    assert!(start.elapsed().as_secs() < limit, "{:?}", start.elapsed());
}
