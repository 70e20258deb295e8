//! Properties of weights over random samples, many of them degenerate.

mod common;

use coeff_field::{FieldInterpolation, WeightList, interpolation};
use common::{at, magnitude};
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

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn weights_sum_to_one(
        positions in positions(),
        picks in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>(), -0.5..1.5), 8),
    ) {
        let probes: Vec<Position> = picks
            .iter()
            .map(|(a, b, t)| {
                let (a, b) = (positions[a.index(positions.len())], positions[b.index(positions.len())]);
                at(a.x() + t * (b.x() - a.x()), a.y() + t * (b.y() - a.y()))
            })
            .collect();
        let checked = SamplePositions::new(positions.clone(), None).unwrap();
        for name in ["delaunay", "natural-neighbour", "idw", "idw=9", "nearest", "auto"] {
            let method = interpolation(name.parse().unwrap()).unwrap();
            check(name, method.as_ref(), &checked, &probes)?;
        }
    }
}

fn check(
    name: &str,
    method: &dyn FieldInterpolation,
    positions: &SamplePositions,
    probes: &[Position],
) -> Result<(), TestCaseError> {
    let mut weights = WeightList::new();
    for outside in [
        OutsidePolicy::Nearest,
        OutsidePolicy::Extend,
        OutsidePolicy::Error,
    ] {
        let weights_of = method.prepare(positions, outside).unwrap();
        for &p in probes {
            if weights_of.weights_into(p, &mut weights).is_err() {
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
        for (sample, &p) in positions.as_slice().iter().enumerate() {
            weights_of.weights_into(p, &mut weights).unwrap();
            prop_assert_eq!(&weights, &vec![(sample, 1.0)], "{} {}", name, outside);
        }
    }
    Ok(())
}
