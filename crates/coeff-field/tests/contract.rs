//! Properties of every interpolator, for all of them and for difficult layouts of samples.

mod common;

use coeff_field::WeightList;
use common::{
    Extent, SampleWeights, at, each, field, is_polynomial, magnitude, probes, reproduces_slopes, rng,
    samples_of, smooth, value,
};
use ndarray::{Array1, Array3, s};
use psf_types::{FrameShape, OutsidePolicy, PixelRegion, Position};
use rand::RngExt;

/// Rounding of a sum of weights, relative to their magnitudes.
const UNITY: f64 = 1e-12;
/// Rounding of the weights at a sample.
const EXACT: f64 = 1e-14;
/// Rounding of an interpolated value of order 1 in well shaped cells.
const ROUNDING: f64 = 1e-11;
/// Rounding of slopes from samples 1e-9 of the extent apart, or with coordinates of 1e7.
const SLOPE: f64 = 1e-7;
/// Largest jump after bisection to 1e-12 of the extent. Smooth values with slopes of order 1 change
/// by far less. Thin triangles steepen them.
const JUMP: f64 = 1e-6;

#[test]
fn weights_are_finite_name_each_node_once_and_sum_to_one() {
    each(|layout, name, positions, method| {
        for outside in [OutsidePolicy::Nearest, OutsidePolicy::Extend] {
            let weights_of = SampleWeights::new(method, positions, outside);
            // The previous content of the list must not matter.
            let mut weights: WeightList = vec![(usize::MAX, f64::NAN); 9];
            for p in probes(positions) {
                weights_of.of_nodes(p, &mut weights).unwrap();
                let mut nodes: Vec<usize> = weights.iter().map(|&(node, _)| node).collect();
                nodes.sort_unstable();
                nodes.dedup();
                assert_eq!(nodes.len(), weights.len(), "{layout} {name} {p}: {weights:?}");
                assert!(nodes.iter().all(|&node| node < weights_of.node_count()));
                assert!(weights.iter().all(|(_, w)| w.is_finite()), "{layout} {name} {p}");
                if !is_polynomial(name) {
                    let sum: f64 = weights.iter().map(|(_, w)| w).sum();
                    let error = (sum - 1.0).abs() / magnitude(&weights);
                    assert!(error <= UNITY, "{layout} {name} {outside} {p}: {error:e}");
                }
            }
        }
    });
}

#[test]
fn constants_are_reproduced() {
    each(|layout, name, positions, method| {
        let samples = samples_of(positions, 1, |_, _| 2.5);
        let field = field(&samples, method, OutsidePolicy::Nearest);
        for p in probes(positions) {
            assert!((value(&field, p) - 2.5).abs() < ROUNDING, "{layout} {name} {p}");
        }
    });
}

#[test]
fn values_at_samples_are_exact() {
    each(|layout, name, positions, method| {
        if is_polynomial(name) {
            return;
        }
        for outside in [
            OutsidePolicy::Nearest,
            OutsidePolicy::Extend,
            OutsidePolicy::Error,
        ] {
            let weights = SampleWeights::new(method, positions, outside);
            for (sample, &p) in positions.iter().enumerate() {
                let mut only = Array1::zeros(positions.len());
                only[sample] = 1.0;
                let errors = weights.of_samples(p) - only;
                let error = errors.fold(0.0_f64, |most, e| most.max(e.abs()));
                assert!(error < EXACT, "{layout} {name} {outside} {p}: {error:e}");
            }
        }
    });
}

#[test]
fn slopes_are_reproduced_where_the_samples_surround_the_position() {
    each(|layout, name, positions, method| {
        // A line has no slope across, and outside the samples a strip thinner than 0.001 counts as
        // a line.
        let thin = layout == "thin strip" || layout.ends_with("line");
        if !reproduces_slopes(name) || positions.len() < 3 || thin {
            return;
        }
        let extent = Extent::of(positions);
        let slope = |p: Position, _: usize| {
            let (x, y) = extent.relative(p);
            1.0 + 2.0 * x - 3.0 * y
        };
        let field = field(&samples_of(positions, 1, slope), method, OutsidePolicy::Extend);
        // Under the policy extend, slopes are reproduced everywhere.
        for p in probes(positions) {
            let error = (value(&field, p) - slope(p, 0)).abs();
            assert!(error < SLOPE, "{layout} {name} {p}: {error:e}");
        }
    });
}

#[test]
fn values_exceed_those_of_the_samples_by_little() {
    each(|layout, name, positions, method| {
        if is_polynomial(name) {
            return;
        }
        let mut rng = rng(5);
        let noise: Vec<f64> = positions.iter().map(|_| rng.random()).collect();
        let at_sample = |p: Position, _: usize| noise[positions.iter().position(|q| *q == p).unwrap()];
        let field = field(
            &samples_of(positions, 1, at_sample),
            method,
            OutsidePolicy::Nearest,
        );
        let (low, high) = noise
            .iter()
            .fold((1.0_f64, 0.0_f64), |(a, b), &v| (a.min(v), b.max(v)));
        // In a dent of the hull, up to 0.001 of the spacing deep, the field is extrapolated over
        // that distance.
        let slack = match layout {
            "uneven grid" if name == "delaunay" => 5e-3,
            // Cubics overshoot: the magnitudes of weights sum to at most 1.63 in each coordinate.
            "grid" if matches!(name, "bicubic") => 0.5 * (1.63 * 1.63 - 1.0) * (high - low),
            // Values at a tree's corners are changed so that those at the samples are exact.
            _ if matches!(name, "natural-neighbour" | "idw" | "idw=3.5") => 0.3 * (high - low) + ROUNDING,
            _ => ROUNDING,
        };
        for p in probes(positions) {
            let v = value(&field, p);
            assert!(
                (low - slack..=high + slack).contains(&v),
                "{layout} {name} {p}: {v} not in {low} to {high}"
            );
        }
    });
}

#[test]
fn fields_are_continuous_across_cells_and_the_hull() {
    each(|layout, name, positions, method| {
        if name == "nearest" {
            return;
        }
        let extent = Extent::of(positions);
        for outside in [OutsidePolicy::Nearest, OutsidePolicy::Extend] {
            if layout == "thin strip" && is_polynomial(name) && outside == OutsidePolicy::Extend {
                // The polynomial grows by 1e10 next to a strip 1e-5 wide.
                continue;
            }
            let field = field(&samples_of(positions, 1, smooth(extent)), method, outside);
            let ends = extent.probes(60, 23, 0.2);
            for (a, b) in ends.iter().zip(&ends[1..]) {
                let on_path = |t: f64| at(a.x() + t * (b.x() - a.x()), a.y() + t * (b.y() - a.y()));
                let f = |t: f64| value(&field, on_path(t));
                let jump = largest_jump(f);
                assert!(
                    jump < JUMP,
                    "{layout} {name} {outside} {a} to {b}: jump of {jump:e}"
                );
            }
        }
    });
}

/// The change that remains when the largest change along [0, 1] is bisected to 1e-12.
fn largest_jump(f: impl Fn(f64) -> f64) -> f64 {
    const STEPS: usize = 60;
    let values: Vec<f64> = (0..=STEPS).map(|i| f(i as f64 / STEPS as f64)).collect();
    let step = |i: &usize| (values[i + 1] - values[*i]).abs();
    let worst = (0..STEPS)
        .max_by(|a, b| step(a).total_cmp(&step(b)))
        .expect("there are steps");
    let (mut low, mut high) = (worst as f64 / STEPS as f64, (worst + 1) as f64 / STEPS as f64);
    let (mut at_low, mut at_high) = (values[worst], values[worst + 1]);
    while high - low > 1e-12 {
        let middle = f64::midpoint(low, high);
        let v = f(middle);
        if (v - at_low).abs() > (at_high - v).abs() {
            (high, at_high) = (middle, v);
        } else {
            (low, at_low) = (middle, v);
        }
    }
    (at_high - at_low).abs()
}

#[test]
fn the_search_for_jumps_finds_them() {
    assert!(largest_jump(f64::sin) < 1e-11);
    assert!(largest_jump(|t| if t < 0.123_45 { t } else { t + 0.05 }) > 0.049);
}

#[test]
fn a_region_holds_the_same_bits_as_its_points_for_any_range_and_thread() {
    each(|layout, name, positions, method| {
        let extent = Extent::of(positions);
        let samples = samples_of(positions, 5, smooth(extent));
        let field = field(&samples, method, OutsidePolicy::Extend);
        // A region across an edge of the samples, wider than the stretch that is gathered at once.
        let (x0, y0) = (extent.low.0 as i64 - 3, extent.low.1 as i64 - 2);
        let region = PixelRegion::new(x0, y0, FrameShape::new(71, 6).unwrap());
        let mut all = Array3::from_elem((5, 6, 71), f64::NAN);
        field.evaluate_region_into(region, 0..5, all.view_mut()).unwrap();
        let mut point = [f64::NAN; 5];
        for row in 0..6 {
            for column in 0..71 {
                field
                    .evaluate_into(region.position(column, row), &mut point)
                    .unwrap();
                for (k, v) in point.iter().enumerate() {
                    assert_eq!(
                        v.to_bits(),
                        all[[k, row, column]].to_bits(),
                        "{layout} {name} {k} {row} {column}"
                    );
                }
            }
        }
        std::thread::scope(|scope| {
            for range in [0..1, 1..4, 4..5, 2..2] {
                let (field, all) = (&field, &all);
                scope.spawn(move || {
                    // Evaluates a smaller region into a part of a larger array.
                    let part = PixelRegion::new(x0 + 2, y0 + 1, FrameShape::new(40, 3).unwrap());
                    let mut values = Array3::from_elem((range.len(), 5, 50), f64::NAN);
                    field
                        .evaluate_region_into(part, range.clone(), values.slice_mut(s![.., 1..4, 5..45]))
                        .unwrap();
                    assert_eq!(
                        values.slice(s![.., 1..4, 5..45]),
                        all.slice(s![range, 1..4, 2..42]),
                        "{layout} {name}"
                    );
                });
            }
        });
    });
}

#[test]
fn weights_do_not_depend_on_earlier_queries() {
    each(|layout, name, positions, method| {
        let [first, second] = [0, 1].map(|_| SampleWeights::new(method, positions, OutsidePolicy::Extend));
        let probes = probes(positions);
        let at = |weights_of: &SampleWeights, p: Position| {
            let mut weights = WeightList::new();
            weights_of.of_nodes(p, &mut weights).unwrap();
            weights
        };
        let forward: Vec<WeightList> = probes.iter().map(|&p| at(&first, p)).collect();
        for (&p, expected) in probes.iter().zip(&forward).rev() {
            let weights = at(&second, p);
            assert_eq!(&weights, expected, "{layout} {name} {p}");
        }
    });
}
