//! Tests of theory: parabolas, symmetry, areas of Voronoi cells, even boundaries.

mod common;

use coeff_field::{Bicubic, Delaunay, FieldInterpolation, NaturalNeighbour, WeightList, leave_one_out};
use common::{SampleWeights, at, field, methods, probes, samples_of, scattered, value};
use psf_types::{OutsidePolicy, Position, SamplePositions};

/// Rounding of sums of values of up to 2e4.
const SUMS: f64 = 1e-10;

fn weights(method: &dyn FieldInterpolation, positions: &[Position], p: Position) -> WeightList {
    let mut weights = WeightList::new();
    let weights_of = SampleWeights::new(method, positions, OutsidePolicy::Nearest);
    weights_of.of_nodes(p, &mut weights).unwrap();
    weights.sort_unstable_by_key(|&(node, _)| node);
    weights
}

#[test]
fn parabolas_stay_within_the_bounds_of_theory() {
    let square = |p: Position, _: usize| p.x() * p.x() + p.y() * p.y();
    let error = |method: &dyn FieldInterpolation, n: usize| {
        let step = 100.0 / (n - 1) as f64;
        let positions = common::grid(n, n, step, 0.0, 0.0);
        let field = field(&samples_of(&positions, 1, square), method, OutsidePolicy::Nearest);
        (0..1000)
            .map(|i| at(f64::from(i * 37 % 1000) * 0.1, f64::from(i * 91 % 1000) * 0.1))
            .map(|p| (value(&field, p) - square(p, 0)).abs())
            .fold(0.0, f64::max)
    };
    let positions = SamplePositions::new(common::grid(5, 5, 1.0, 0.0, 0.0), None).unwrap();
    for (name, method) in methods(&positions) {
        let (coarse, fine) = (error(method.as_ref(), 11), error(method.as_ref(), 21));
        // (h^2 2 + h^2 2) / 8, or r^2 2 / 2 with the circumradius r = h / sqrt 2. Both are h^2 / 2.
        let bound = |step: f64| 0.5 * step * step;
        match name {
            // On a tree's cells of 0.625 times the spacing: 0.4 of the bound, and as much at corners
            // that were moved down for several samples.
            "natural-neighbour" => assert!(
                coarse <= 0.65 * bound(10.0) && fine <= 0.65 * bound(5.0),
                "{coarse} {fine}"
            ),
            "bilinear" | "bicubic" | "delaunay" => {
                // Cubics are linear within fifths of cells.
                let is_cubic = name == "bicubic";
                let bound = |step: f64| bound(if is_cubic { step / 5.0 } else { step });
                assert!(
                    coarse <= bound(10.0) + SUMS && fine <= bound(5.0) + SUMS,
                    "{name}: {coarse} {fine}"
                );
                // The error must also come close to the bound. A smaller one would mean that the
                // method is not linear between samples.
                assert!(coarse > 0.5 * bound(10.0), "{name}: {coarse}");
            }
            "polynomial=2" => assert!(coarse < 1e-8, "{coarse}"),
            // The bound is the largest slope, 283 at the far corner, times the radius of the
            // weights, sqrt 2 d_(6).
            "idw" | "idw=3.5" | "nearest" => {
                assert!(
                    coarse < 283.0 * 20.0 && fine < 0.6 * coarse,
                    "{name}: {coarse} {fine}"
                );
            }
            _ => {}
        }
    }
}

#[test]
fn gradients_make_natural_neighbours_exact_for_parabolas() {
    let square = |p: Position, _: usize| p.x() * p.x() - 0.5 * p.x() * p.y() + 2.0 * p.y() * p.y();
    let samples = samples_of(&scattered(300, 6, 0.0, 100.0), 1, square);
    let median = |method: &dyn FieldInterpolation| {
        let outcomes = leave_one_out(&samples, method, OutsidePolicy::Nearest).unwrap();
        let mut errors: Vec<f64> = outcomes.predicted().map(|(_, error)| error).collect();
        errors.sort_by(f64::total_cmp);
        errors[errors.len() / 2]
    };
    let (natural, linear) = (median(&NaturalNeighbour), median(&Delaunay));
    assert!(linear > 10.0 && natural < 0.01 * linear, "{natural} {linear}");
}

#[test]
fn cubics_stay_within_the_bound_of_theory() {
    // Second derivatives up to k^2, fourth derivatives up to k^4.
    let wave = |k: f64| move |p: Position, _: usize| (k * p.x()).sin() + (k * p.y() + 0.4).cos();
    for k in [0.05, 0.1] {
        let step = 10.0;
        let positions = common::grid(21, 21, step, 0.0, 0.0);
        let field = field(
            &samples_of(&positions, 1, wave(k)),
            &Bicubic,
            OutsidePolicy::Nearest,
        );
        // Positions away from the edges. At an edge, the lines of a polynomial lie on one side.
        let inner = common::Extent {
            low: (step, step),
            high: (19.0 * step, 19.0 * step),
        };
        let errors = inner
            .probes(20_000, 31, 0.0)
            .into_iter()
            .map(|p| (value(&field, p) - wave(k)(p, 0)).abs());
        let error = errors.fold(0.0, f64::max);
        let bound = 2.0 * ((step * k).powi(2) / 200.0 + 3.0 * (step * k).powi(4) / 128.0);
        assert!(error <= bound && error > 0.3 * bound, "{k}: {error:e} {bound:e}");
    }
}

#[test]
fn mirrored_samples_have_mirrored_weights() {
    let positions = scattered(50, 9, -1.0, 2.0);
    let mirrored: Vec<Position> = positions.iter().map(|p| at(-p.y(), p.x())).collect();
    for (name, method) in methods(&SamplePositions::new(positions.clone(), None).unwrap()) {
        if common::is_polynomial(name) {
            continue;
        }
        let weights = SampleWeights::new(method.as_ref(), &positions, OutsidePolicy::Nearest);
        let of_mirrored = SampleWeights::new(method.as_ref(), &mirrored, OutsidePolicy::Nearest);
        for p in probes(&positions).into_iter().take(300) {
            let a = weights.of_samples(p);
            let b = of_mirrored.of_samples(at(-p.y(), p.x()));
            let difference = &a - &b;
            assert!(difference.iter().all(|d| d.abs() < 1e-10), "{name} {p}: {a} {b}");
        }
    }
}

#[test]
fn delaunay_circles_are_empty() {
    // Three weights belong to a triangle whose circumcircle contains no other sample.
    let positions = scattered(80, 12, 0.0, 100.0);
    for p in (common::Extent {
        low: (20.0, 20.0),
        high: (80.0, 80.0),
    })
    .probes(200, 13, 0.0)
    {
        let triangle = weights(&Delaunay, &positions, p);
        assert_eq!(triangle.len(), 3);
        let [a, b, c] = [0, 1, 2].map(|i| positions[triangle[i].0]);
        let (bx, by, cx, cy) = (b.x() - a.x(), b.y() - a.y(), c.x() - a.x(), c.y() - a.y());
        let d = 2.0 * (bx * cy - by * cx);
        let (b2, c2) = (bx * bx + by * by, cx * cx + cy * cy);
        let centre = at(a.x() + (cy * b2 - by * c2) / d, a.y() + (bx * c2 - cx * b2) / d);
        let radius = centre.distance(a);
        assert!(
            positions
                .iter()
                .all(|q| centre.distance(*q) > radius * (1.0 - 1e-9)),
            "{p}"
        );
        assert!(triangle.iter().all(|(_, w)| *w > 0.0));
    }
}

#[test]
fn the_edge_of_an_uneven_grid_follows_its_samples() {
    // Rounding or a slight unevenness of the outermost samples must not give weight to distant
    // samples at the edge.
    let curve = |p: Position, _: usize| (p.x() * p.x() + p.y() * p.y()) * 1e-2;
    for (angle, jitter) in [(0.0, 0.0), (0.4, 0.0), (0.0, 1e-9), (0.0, 0.004), (0.9, 0.002)] {
        let positions = common::grid(21, 21, 10.0, angle, jitter);
        let (s, c) = angle.sin_cos();
        // The cells of natural neighbours' tree are up to 9 wide and do not follow a turned edge.
        for (method, bound) in [
            (&Delaunay as &dyn FieldInterpolation, 0.3),
            (&NaturalNeighbour, 0.9),
        ] {
            for outside in [OutsidePolicy::Nearest, OutsidePolicy::Extend] {
                let field = field(&samples_of(&positions, 1, curve), method, outside);
                // Along the first row: just outside, on it, and just inside.
                for i in 0..400 {
                    let along = f64::from(i) * 0.5;
                    for off in [-0.01, -1e-9, 0.0, 1e-9, 0.001, 0.01] {
                        let p = at(along * c - off * s, along * s + off * c);
                        let error = (value(&field, p) - curve(p, 0)).abs();
                        // 0.25 from linear interpolation between neighbours 10 apart with second
                        // derivative 0.02, and a slope of 4 over 0.01.
                        assert!(
                            error < bound,
                            "{method:?} {outside} {angle} {jitter} {p}: {error}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn extended_fields_continue_linearly() {
    let positions = scattered(60, 21, 0.0, 100.0);
    let bend = |p: Position, _: usize| (p.x() * 0.03).sin() + (p.y() * 0.02).cos();
    let extended = |method| field(&samples_of(&positions, 1, bend), method, OutsidePolicy::Extend);
    let linear = extended(&Delaunay);
    // For positions straight out from the hull, the foot stays the same.
    let f = |t: f64| value(&linear, at(120.0 + t, 120.0 + t));
    let corner_fan = (f(10.0) - 2.0 * f(20.0) + f(30.0)).abs();
    assert!(corner_fan < 1e-9, "{corner_fan}");
    // Outside the samples, natural neighbours have the same values at the corners of the tree.
    let natural = extended(&NaturalNeighbour);
    for t in [10.0, 20.0, 30.0] {
        let p = at(120.0 + t, 120.0 + t);
        let difference = (value(&natural, p) - value(&linear, p)).abs();
        // A fifth of the slope of 0.03 per pixel, over a cell of 19 pixels.
        assert!(difference < 0.115, "{t}: {difference}");
    }
    // Outside a grid, the slope is about that of the samples: second derivatives of 1e-3 over 5
    // pixels.
    let positions = common::grid(11, 11, 10.0, 0.0, 0.0);
    for method in [&Delaunay as &dyn FieldInterpolation, &NaturalNeighbour] {
        let field = field(&samples_of(&positions, 1, bend), method, OutsidePolicy::Extend);
        for p in [at(52.0, -5.0), at(-5.0, 33.0), at(104.0, -3.0)] {
            let error = (value(&field, p) - bend(p, 0)).abs();
            assert!(error < 0.1, "{method:?} {p}: {error}");
        }
    }
}
