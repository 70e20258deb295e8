//! Properties of weights over random samples, many of them degenerate.

mod common;

use coeff_field::{FieldInterpolation, WeightList, interpolation};
use common::{Extent, SampleWeights, at, magnitude};
use ndarray::Array1;
use proptest::prelude::*;
use psf_types::{OutsidePolicy, Position, SamplePositions};

/// Rounding of a sum of weights, relative to their magnitudes.
const UNITY: f64 = 1e-12;
/// Largest excursion of weights from [0, 1] in a dent of the hull. A dent is at most 0.001 of its
/// width deep. The width is up to 7 units, and neighbours are 1 unit away.
const DENT: f64 = 0.05;

/// Coordinates on a coarse lattice (ties, lines, circles), sometimes very close to it, sometimes
/// far away.
fn positions() -> impl Strategy<Value = Vec<Position>> {
    let hair = prop_oneof![
        3 => Just(0.0),
        1 => -1e-9..1e-9,
        1 => -1e-13..1e-13,
        1 => -0.3..0.3,
    ];
    let coordinate = (0_i32..7, hair).prop_map(|(lattice, hair)| f64::from(lattice) + hair);
    let far = prop_oneof![3 => Just(0.0), 1 => -1e7..1e7, 1 => Just(1e15)];
    (
        prop::collection::vec((coordinate.clone(), coordinate), 1..40),
        far,
        prop_oneof![2 => Just(1.0), 1 => Just(1e-6), 1 => Just(1e20)],
    )
        .prop_map(|(points, far, scale)| {
            let mut kept: Vec<Position> = Vec::new();
            for (x, y) in points {
                let p = at((x + far) * scale, (y - far) * scale);
                if !kept.contains(&p) {
                    kept.push(p);
                }
            }
            kept
        })
}

/// Positions on and beyond the line through two samples.
type Picks = Vec<(prop::sample::Index, prop::sample::Index, f64)>;

fn picks() -> impl Strategy<Value = Picks> {
    prop::collection::vec(
        (
            any::<prop::sample::Index>(),
            any::<prop::sample::Index>(),
            -0.5..1.5,
        ),
        8,
    )
}

fn check_all(names: &[&str], positions: &[Position], picks: &Picks) -> Result<(), TestCaseError> {
    let probes: Vec<Position> = picks
        .iter()
        .map(|(a, b, t)| {
            let (a, b) = (
                positions[a.index(positions.len())],
                positions[b.index(positions.len())],
            );
            at(a.x() + t * (b.x() - a.x()), a.y() + t * (b.y() - a.y()))
        })
        .collect();
    let checked = SamplePositions::new(positions.to_vec(), None).unwrap();
    for name in names {
        let method = interpolation(name.parse().unwrap()).unwrap();
        check(name, method.as_ref(), &checked, &probes)?;
    }
    Ok(())
}

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(config(2000))]

    #[test]
    fn weights_sum_to_one(positions in positions(), picks in picks()) {
        check_all(&["delaunay", "nearest"], &positions, &picks)?;
    }
}

proptest! {
    // A tree takes some milliseconds.
    #![proptest_config(config(500))]

    #[test]
    fn weights_on_a_tree_sum_to_one(positions in positions(), picks in picks()) {
        check_all(&["natural-neighbour", "idw", "idw=9"], &positions, &picks)?;
    }
}

/// Four samples within 1e-9 of each other, far from two others. Slopes between the four are noise.
#[test]
fn a_tight_cluster_does_not_reach_far_samples() {
    let positions = [
        (0.0, 0.0),
        (1.0, 0.0),
        (6.000_000_000_537_027, 1.0),
        (6.0, 1.000_000_000_711_277_3),
        (6.0, 1.000_000_000_741_807_5),
        (6.0, 1.0),
    ]
    .map(|(x, y)| at(x, y));
    check_all(&["natural-neighbour"], &positions, &Picks::new()).unwrap();
}

fn check(
    name: &str,
    method: &dyn FieldInterpolation,
    positions: &SamplePositions,
    probes: &[Position],
) -> Result<(), TestCaseError> {
    let is_on_tree = !matches!(name, "delaunay" | "nearest");
    let mut weights = WeightList::new();
    for outside in [
        OutsidePolicy::Nearest,
        OutsidePolicy::Extend,
        OutsidePolicy::Error,
    ] {
        let of_samples = SampleWeights::new(method, positions.as_slice(), outside);
        for &p in probes {
            if of_samples.of_nodes(p, &mut weights).is_err() {
                prop_assert!(outside == OutsidePolicy::Error, "{} {}", name, p);
                continue;
            }
            let sum: f64 = weights.iter().map(|(_, w)| w).sum();
            prop_assert!(
                (sum - 1.0).abs() <= UNITY * magnitude(&weights),
                "{} {} {}: {:?}",
                name,
                outside,
                p,
                weights
            );
            if outside != OutsidePolicy::Extend {
                // Only a dent of the hull may have slightly negative weights.
                prop_assert!(
                    weights.iter().all(|(_, w)| (-DENT..=1.0 + DENT).contains(w)),
                    "{} {} {}: {:?}",
                    name,
                    outside,
                    p,
                    weights
                );
            }
        }
        let rounding = rounding(positions.as_slice());
        if rounding > COARSE {
            continue;
        }
        for (sample, &p) in positions.as_slice().iter().enumerate() {
            let mut only = Array1::zeros(positions.len());
            only[sample] = 1.0;
            let found = of_samples.of_samples(p);
            if is_on_tree {
                let off = (&found - &only).iter().fold(0.0_f64, |off, d| off.max(d.abs()));
                prop_assert!(off <= EXACT, "{} {}: {}", name, outside, found);
            } else {
                prop_assert_eq!(found, only, "{} {}", name, outside);
            }
        }
    }
    Ok(())
}

/// Above this [`rounding`], a tree cannot separate samples.
const COARSE: f64 = 1e-4;
/// Rounding of the weights at a sample, of which others may be 1e-9 of the extent away.
const EXACT: f64 = 1e-10;

/// The rounding of coordinates, as a multiple of the samples' extent.
fn rounding(positions: &[Position]) -> f64 {
    let extent = Extent::of(positions);
    let (x, y) = (extent.high.0 - extent.low.0, extent.high.1 - extent.low.1);
    let largest = [extent.low.0, extent.low.1, extent.high.0, extent.high.1]
        .iter()
        .fold(0.0_f64, |largest, v| largest.max(v.abs()));
    f64::EPSILON * largest / x.max(y)
}
