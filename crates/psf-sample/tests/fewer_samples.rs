//! Adaptive sampling compared with uniform sampling at the same interpolation error.

mod common;

use std::sync::Arc;

use common::{Blob, relative_l2};
use ndarray::Array2;
use psf_sample::{
    AdaptiveSampling, DifferenceMeasure, InterpolationError, NeighbourDifference, RefinementCriterion,
    SamplingMethod, UniformSampling,
};
use psf_types::{NoProgress, PsfSamples};
use spade::{DelaunayTriangulation, FloatTriangulation, HasPosition, Point2, Triangulation};

struct Vertex {
    at: Point2<f64>,
    sample: usize,
}

impl HasPosition for Vertex {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        self.at
    }
}

/// Positions of a dense check, corners and edges included. 101 intervals share few points with
/// dyadic or coarse grids.
const CHECKS: usize = 102;

/// The largest relative L2 error of Delaunay-linear interpolation over the check positions.
fn largest_error(samples: &PsfSamples, source: &Blob) -> f64 {
    let mut triangles = DelaunayTriangulation::<Vertex>::new();
    for (sample, p) in samples.positions().as_slice().iter().enumerate() {
        triangles
            .insert(Vertex {
                at: Point2::new(p.x(), p.y()),
                sample,
            })
            .unwrap();
    }
    let interpolation = triangles.barycentric();
    let (mut weights, mut largest) = (Vec::new(), 0f64);
    let last = |n: usize| (n - 1) as f64;
    for i in 0..CHECKS {
        for j in 0..CHECKS {
            let x = last(source.field.nx()) * i as f64 / last(CHECKS);
            let y = last(source.field.ny()) * j as f64 / last(CHECKS);
            interpolation.get_weights(Point2::new(x, y), &mut weights);
            assert!(!weights.is_empty(), "({x}, {y}) lies within the samples");
            let mut stamp = Array2::zeros((13, 13));
            for &(vertex, weight) in &weights {
                stamp.scaled_add(weight, &samples.stamp(triangles.vertex(vertex).data().sample));
            }
            largest = largest.max(relative_l2(stamp.view(), source.at(x, y).view()));
        }
    }
    largest
}

/// The smallest n x n grid with at most the given error, and its error. The error does not fall
/// strictly with n, so every n is tried.
fn smallest_uniform(source: &Blob, error: f64, at_most: usize) -> Option<(usize, f64)> {
    (2..=at_most).find_map(|n| {
        let grid = UniformSampling::new(n, n)
            .unwrap()
            .sample(source, &NoProgress)
            .unwrap();
        let reached = largest_error(&grid.samples, source);
        (reached <= error).then_some((n, reached))
    })
}

fn compare(name: &str, source: &Blob, criterion: Arc<dyn RefinementCriterion>) -> (f64, f64) {
    let threshold = criterion.threshold();
    let adaptive = AdaptiveSampling::new(criterion)
        .sample(source, &NoProgress)
        .unwrap();
    let error = largest_error(&adaptive.samples, source);
    let count = adaptive.samples.len();
    let (n, reached) = smallest_uniform(source, error, 80).expect("a uniform grid reaches the error");
    println!(
        "{name}: {count} samples ({} draws), error {error:.2e}; uniform {n} x {n} = {} samples, error {reached:.2e}",
        adaptive.report.draws,
        n * n
    );
    ((n * n) as f64 / count as f64, error / threshold)
}

/// The required gain: half the samples.
const AT_LEAST: f64 = 2.0;
/// The criterion bounds the error for either diagonal. Measured: 0.5 to 0.9.
const DELAUNAY_OVER_THRESHOLD: f64 = 1.0;

fn interpolation_error() -> Arc<dyn RefinementCriterion> {
    Arc::new(InterpolationError::new(0.01, DifferenceMeasure::L2).unwrap())
}

#[test]
fn a_field_that_varies_in_a_corner_needs_at_most_half_the_samples() {
    type Shape = fn(f64, f64) -> f64;
    let fields: [(&str, Shape); 3] = [
        ("Gaussian rise", |x, y| {
            1.5 + (-((x - 1.0).powi(2) + (y - 1.0).powi(2)) / 0.02).exp()
        }),
        ("soft exponential rise", |x, y| {
            1.5 + (-((1.0 - x).hypot(1.0 - y).hypot(0.1)) / 0.2).exp()
        }),
        ("20th power", |x, y| 1.5 + (0.5 * (x + y)).powi(20)),
    ];
    for (name, shape) in fields {
        let source = Blob::new(1000, 1000, shape);
        let (gain, excess) = compare(
            &format!("{name}, interpolation error"),
            &source,
            interpolation_error(),
        );
        assert!(gain >= AT_LEAST, "{name}: {gain}");
        assert!(
            excess <= DELAUNAY_OVER_THRESHOLD,
            "{name}: the error is {excess} times the threshold"
        );
        let neighbours = NeighbourDifference::new(0.08, DifferenceMeasure::L2).unwrap();
        let (gain, _) = compare(
            &format!("{name}, neighbour difference"),
            &source,
            Arc::new(neighbours),
        );
        assert!(gain >= AT_LEAST, "{name}: {gain}");
    }
}

#[test]
fn a_field_that_varies_over_half_the_frame_gains_too() {
    let source = Blob::new(1000, 900, |x, y| 1.5 + (0.5 * (x + y)).powi(8));
    let (gain, excess) = compare("8th power, interpolation error", &source, interpolation_error());
    assert!(gain > 1.5 && excess <= DELAUNAY_OVER_THRESHOLD, "{gain} {excess}");
}

#[test]
fn the_check_detects_a_field_that_is_not_sampled_where_it_varies() {
    let source = Blob::new(1000, 1000, |x, y| 1.5 + (0.5 * (x + y)).powi(20));
    let grid = UniformSampling::new(5, 5)
        .unwrap()
        .sample(&source, &NoProgress)
        .unwrap();
    assert!(largest_error(&grid.samples, &source) > 0.05);
}
