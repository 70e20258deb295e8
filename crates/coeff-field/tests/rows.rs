//! Runs of linear weights along rows, for every interpolator and for difficult layouts of samples.

mod common;

use std::sync::Arc;

use std::mem::discriminant;

use coeff_field::{
    Bicubic, Bilinear, CoeffFieldError, Delaunay, FieldInterpolation, FieldWeights, InterpolatedField,
    Nearest, Polynomial, WeightList,
};
use common::{Extent, at, field, grid, layouts, methods, rng, samples_of, scattered, suits};
use psf_types::{
    CoefficientField, FieldError, OutsidePolicy, Position, RowRun, SampleCoefficients, SamplePositions,
    WeightedNodes,
};
use rand::RngExt;

/// Rounding of an expanded run, relative to the largest node value times the sum of the weights'
/// magnitudes.
const ROUNDING: f64 = 1e-11;

const POLICIES: [OutsidePolicy; 3] = [
    OutsidePolicy::Nearest,
    OutsidePolicy::Extend,
    OutsidePolicy::Error,
];

/// The weights at each pixel of a run.
fn expand(run: RowRun<'_>) -> Vec<WeightList> {
    let part = |i: usize| i as f64 / (run.length - 1).max(1) as f64;
    (0..run.length)
        .map(|i| {
            let scaled =
                |list: &[(usize, f64)], s: f64| list.iter().map(|&(n, w)| (n, s * w)).collect::<Vec<_>>();
            [scaled(run.first, 1.0 - part(i)), scaled(run.last, part(i))].concat()
        })
        .collect()
}

/// Compares a row with its pixels and returns the number of runs.
fn check(field: &Arc<dyn CoefficientField>, (x, y): (i64, i64), length: usize) -> Result<usize, String> {
    let weighted = field.weighted_nodes().expect("a method with few weights");
    let nodes = weighted.node_values();
    let largest = nodes.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let (mut runs, mut wrong) = (0, Vec::new());
    let mut pixels: Vec<WeightList> = Vec::new();
    let end = weighted.weights_along_row((x, y), length, &mut |run| {
        runs += 1;
        for list in [run.first, run.last] {
            let mut named: Vec<usize> = list.iter().map(|&(node, _)| node).collect();
            named.sort_unstable();
            named.dedup();
            if run.length == 0 || named.len() < list.len() || list.iter().any(|(n, _)| *n >= nodes.nrows()) {
                wrong.push(format!("{run:?}"));
            }
        }
        pixels.extend(expand(run));
    });
    if !wrong.is_empty() {
        return Err(format!("runs {wrong:?}"));
    }
    let mut expected = vec![f64::NAN; field.component_count()];
    for (column, weights) in pixels.iter().enumerate() {
        let position = Position::of_pixel(x + column as i64, y);
        field
            .evaluate_into(position, &mut expected)
            .map_err(|error| format!("{position} was visited: {error}"))?;
        let magnitude = weights.iter().map(|(_, w)| w.abs()).sum::<f64>().max(1.0);
        for (k, value) in expected.iter().enumerate() {
            let got: f64 = weights.iter().map(|&(node, w)| w * nodes[[node, k]]).sum();
            let error = (got - value).abs() / (largest * magnitude);
            // The negated test also rejects NaN.
            if error.partial_cmp(&ROUNDING) != Some(std::cmp::Ordering::Less) {
                return Err(format!("{position}: {got} in place of {value}, {error:e} off"));
            }
        }
    }
    let next = Position::of_pixel(x + pixels.len() as i64, y);
    match end {
        Ok(()) if pixels.len() == length => Ok(runs),
        Ok(()) => Err(format!("{} of {length} pixels", pixels.len())),
        Err(got) => match field.evaluate_into(next, &mut expected) {
            Err(expected) if discriminant(&got) == discriminant(&expected) => match got {
                FieldError::OutsideSamples { position } if position != next => {
                    Err(format!("{position} blamed for {next}"))
                }
                _ => Ok(runs),
            },
            other => Err(format!("{got}, but {other:?} at {next}")),
        },
    }
}

/// Up to `n` distinct pixels of a square.
fn pixels(n: usize, side: f64) -> Vec<Position> {
    let mut all: Vec<Position> = Vec::new();
    for p in scattered(n, 31, -side / 3.0, side) {
        let p = Position::of_pixel(p.x().round() as i64, p.y().round() as i64);
        if !all.contains(&p) {
            all.push(p);
        }
    }
    all
}

fn more_layouts() -> Vec<(&'static str, Vec<Position>)> {
    let mut all = layouts();
    let line =
        |x: fn(f64) -> f64, y: fn(f64) -> f64| (0..9).map(move |i| at(x(f64::from(i)), y(f64::from(i))));
    all.extend([
        // Each column or row is a mean of coordinates that scatter by more than rounding.
        ("loose grid", grid(8, 7, 20.0, 0.0, 2e-8)),
        ("crowded", scattered(900, 8, -6.0, 12.0)),
        (
            "negative",
            grid(6, 6, 9.0, 0.0, 0.0)
                .iter()
                .map(|p| at(p.x() - 80.0, p.y() - 60.0))
                .collect(),
        ),
        ("row", line(|i| 7.0 * i - 20.0, |_| 3.0).collect()),
        ("column", line(|_| 5.0, |i| 6.5 * i).collect()),
        (
            "loose column",
            line(|i| 5.0 + 1e-8 * (i * 2.3).sin(), |i| 6.0 * i).collect(),
        ),
        (
            "loose row",
            line(|i| 6.0 * i, |i| 5.0 + 1e-8 * (i * 2.3).sin().abs().round()).collect(),
        ),
        // Samples slightly off the line have their own values.
        (
            "loose slanted line",
            line(|i| 6.0 * i, |i| 4.0 * i + if i % 8.0 == 0.0 { 2e-8 } else { 0.0 }).collect(),
        ),
        (
            "slivers",
            line(|i| 20.0 * i, |i| 5.0 + 1e-6 * ((7.0 * i) % 5.0 - 2.0)).collect(),
        ),
        ("hardly turned grid", grid(7, 6, 12.0, 1e-15, 0.0)),
        // Covers a few pixels around itself.
        ("huge grid", grid(3, 3, 2e9, 0.0, 0.0)),
        ("one row of a grid", grid(5, 1, 11.0, 0.0, 0.0)),
        ("pixel", vec![at(12.0, -4.0)]),
        ("fine grid", grid(30, 30, 0.4, 0.0, 0.0)),
        ("pixels", pixels(50, 25.0)),
        (
            "some pixels of a lattice",
            pixels(40, 6.0)
                .iter()
                .map(|p| at(p.x() * 15.0, p.y() * 15.0))
                .collect(),
        ),
    ]);
    all
}

/// Rows over the whole layout if it is small, and rows through its samples and next to them.
fn rows(positions: &[Position]) -> Vec<((i64, i64), usize)> {
    let extent = Extent::of(positions);
    let mut rows = Vec::new();
    let (x, y) = (extent.low.0 as i64 - 25, extent.low.1 as i64 - 12);
    if extent.size() < 300.0 {
        let (nx, ny) = (
            (extent.high.0 - extent.low.0) as i64 + 50,
            (extent.high.1 - extent.low.1) as i64 + 24,
        );
        rows.extend(
            (0..ny)
                .step_by(1 + ny as usize / 50)
                .map(|row| ((x, y + row), nx as usize)),
        );
    }
    let mut rng = rng(17);
    for p in positions.iter().take(25) {
        let (x, y) = (p.x().round() as i64, p.y().round() as i64);
        for dy in [-1, 0, 1] {
            rows.push(((x - rng.random_range(0..150), y + dy), 160));
        }
        rows.push(((x, y), 1));
    }
    // Rows far away.
    rows.push(((x - 100_000, y), 400));
    rows.push(((x, y + 100_000), 400));
    rows.push(((x, y), 0));
    rows
}

fn each_field(mut check: impl FnMut(&str, OutsidePolicy, &[Position], &Arc<dyn CoefficientField>)) {
    for (layout, positions) in more_layouts() {
        let checked = SamplePositions::new(positions.clone(), None).unwrap();
        let slope: Box<dyn FieldInterpolation> = Box::new(Polynomial::new(1).unwrap());
        let mut methods = methods(&checked);
        if suits(slope.as_ref(), &checked) {
            methods.push(("polynomial=1", slope));
        }
        let mut rng = rng(29);
        let noise: Vec<f64> = (0..2 * positions.len())
            .map(|_| rng.random_range(-1.0..1.0))
            .collect();
        let of = |p: Position, k: usize| noise[2 * positions.iter().position(|q| *q == p).unwrap() + k];
        let samples = samples_of(&positions, 2, of);
        for (name, method) in &methods {
            for outside in POLICIES {
                let field = field(&samples, method.as_ref(), outside);
                check(&format!("{layout} {name} {outside}"), outside, &positions, &field);
            }
        }
    }
}

#[test]
fn runs_expand_to_the_coefficients_of_every_pixel_and_end_where_those_do() {
    each_field(|label, _, positions, field| {
        for (start, length) in rows(positions) {
            if let Err(what) = check(field, start, length) {
                panic!("{label}: {length} pixels from {start:?}: {what}");
            }
        }
    });
}

/// Wrongly visits each row as one run.
#[derive(Debug)]
struct Straight(Arc<dyn CoefficientField>, usize);

impl Straight {
    fn weighted(&self) -> &dyn WeightedNodes {
        self.0.weighted_nodes().expect("a method with few weights")
    }
}

impl FieldWeights for Straight {
    fn sample_count(&self) -> usize {
        self.1
    }
    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        self.weighted().weights_into(position, weights)
    }
    fn weights_along_row(
        &self,
        (x, y): (i64, i64),
        length: usize,
        visit: &mut dyn FnMut(RowRun<'_>),
    ) -> Result<(), FieldError> {
        let (mut first, mut last) = (WeightList::new(), WeightList::new());
        self.weighted()
            .weights_into(Position::of_pixel(x, y), &mut first)?;
        self.weighted()
            .weights_into(Position::of_pixel(x + length as i64 - 1, y), &mut last)?;
        visit(RowRun {
            length,
            first: &first,
            last: &last,
        });
        Ok(())
    }
}

#[derive(Debug)]
struct StraightDelaunay;

impl FieldInterpolation for StraightDelaunay {
    fn interpolate(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<Arc<dyn CoefficientField>, CoeffFieldError> {
        let field = Delaunay.interpolate(samples, outside)?;
        let weights = Box::new(Straight(field, samples.positions().len()));
        Ok(Arc::new(InterpolatedField::new(samples, weights)?))
    }
}

#[test]
fn the_comparison_finds_runs_that_cross_an_edge_and_pixels_without_a_value() {
    let positions = grid(3, 3, 10.0, 0.1, 0.0);
    let samples = samples_of(&positions, 1, |p, _| p.x() * p.x());
    let wrong = |outside| field(&samples, &StraightDelaunay, outside);
    assert!(check(&wrong(OutsidePolicy::Nearest), (1, 10), 17).is_err());
    assert!(check(&wrong(OutsidePolicy::Error), (1, 10), 25).is_err());
    // In a row within one triangle, one run is correct.
    assert!(check(&wrong(OutsidePolicy::Nearest), (2, 10), 3).is_ok());
}

#[test]
fn bilinear_has_a_run_for_each_cell_and_each_side() {
    // The lines lie at 64 to 9024.
    let positions: Vec<Position> = grid(71, 71, 128.0, 0.0, 0.0)
        .iter()
        .map(|p| at(p.x() + 64.0, p.y() + 64.0))
        .collect();
    let samples = samples_of(&positions, 1, |p, _| (p.x() * 0.01).sin() + p.y());
    for (outside, y, x, length, expected) in [
        (OutsidePolicy::Nearest, 100, 0, 9216, 72),
        (OutsidePolicy::Nearest, -100, 0, 9216, 72),
        (OutsidePolicy::Nearest, 192, 64, 8961, 70),
        (OutsidePolicy::Nearest, 9025, -500, 564, 1),
        (OutsidePolicy::Nearest, 500, 9025, 1000, 1),
        (OutsidePolicy::Extend, 100, 0, 9216, 70),
        (OutsidePolicy::Extend, -100, 200, 200, 2),
        (OutsidePolicy::Error, 100, 64, 8961, 70),
        (OutsidePolicy::Error, 100, 70, 9000, 70),
    ] {
        let field = field(&samples, &Bilinear, outside);
        assert_eq!(check(&field, (x, y), length), Ok(expected), "{outside} {y}");
    }
    // Cubics are linear within fifths of cells.
    for (outside, expected) in [(OutsidePolicy::Nearest, 352), (OutsidePolicy::Extend, 350)] {
        let field = field(&samples, &Bicubic, outside);
        assert_eq!(check(&field, (0, 100), 9216), Ok(expected), "{outside}");
    }
}

#[test]
fn delaunay_has_no_more_runs_than_the_row_crosses_triangles() {
    let positions = scattered(400, 12, 0.0, 4000.0);
    let samples = samples_of(&positions, 1, |p, _| p.x() - p.y());
    let field = field(&samples, &Delaunay, OutsidePolicy::Nearest);
    let mut weights = WeightList::new();
    for y in (250..3750).step_by(350) {
        let nodes_at = |x: i64, weights: &mut WeightList| {
            field
                .weighted_nodes()
                .unwrap()
                .weights_into(Position::of_pixel(x, y), weights)
                .unwrap();
            let mut nodes: Vec<usize> = weights.iter().map(|&(node, _)| node).collect();
            nodes.sort_unstable();
            nodes
        };
        let nodes: Vec<Vec<usize>> = (200..3800).map(|x| nodes_at(x, &mut weights)).collect();
        let triangles = 1 + nodes.windows(2).filter(|pair| pair[0] != pair[1]).count();
        let runs = check(&field, (200, y), 3600).unwrap();
        assert!(runs <= triangles && triangles < 100, "{y}: {runs} of {triangles}");
    }
}

#[test]
fn a_single_sample_is_one_run() {
    let one = vec![at(3.0, 4.0)];
    for (positions, method, outside, expected) in [
        (
            &one,
            &Nearest as &dyn FieldInterpolation,
            OutsidePolicy::Nearest,
            1,
        ),
        (&one, &Delaunay, OutsidePolicy::Nearest, 1),
        (&one, &Bilinear, OutsidePolicy::Extend, 1),
    ] {
        let samples = samples_of(positions, 1, |p, _| p.x() + 0.5);
        let field = field(&samples, method, outside);
        assert_eq!(
            check(&field, (-300, 50), 900),
            Ok(expected),
            "{method:?} {outside}"
        );
    }
    // Rows at the sample and next to it.
    let samples = samples_of(&one, 1, |_, _| 2.0);
    let single = field(&samples, &Delaunay, OutsidePolicy::Nearest);
    assert!(check(&single, (-300, 4), 900).unwrap() <= 3);
}

#[test]
fn nearest_has_about_a_run_for_each_cell() {
    let positions = scattered(400, 12, 0.0, 4000.0);
    let samples = samples_of(&positions, 1, |p, _| p.x() - p.y());
    for outside in POLICIES {
        let field = field(&samples, &Nearest, outside);
        let runs = check(&field, (200, 2000), 3600).unwrap();
        assert!((15..40).contains(&runs), "{outside}: {runs}");
    }
}
