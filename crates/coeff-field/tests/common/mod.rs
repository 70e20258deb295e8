//! Layouts of samples and the interpolators that suit them.
#![allow(dead_code, reason = "each test file uses its part")]

use std::sync::Arc;

use coeff_field::{FieldInterpolation, WeightList, interpolation};
use ndarray::{Array1, Array2};
use psf_types::{CoefficientField, FieldError, OutsidePolicy, Position, SampleCoefficients, SamplePositions};
use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

pub(crate) fn at(x: f64, y: f64) -> Position {
    Position::new(x, y).unwrap()
}

pub(crate) fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// `n` positions in a square with this side and lower left corner.
pub(crate) fn scattered(n: usize, seed: u64, corner: f64, side: f64) -> Vec<Position> {
    let mut rng = rng(seed);
    (0..n)
        .map(|_| {
            at(
                corner + side * rng.random::<f64>(),
                corner + side * rng.random::<f64>(),
            )
        })
        .collect()
}

/// A grid of `nx` by `ny` with spacing `step`, rotated by `angle`. Each node is moved by up to
/// `jitter` in x and y.
pub(crate) fn grid(nx: usize, ny: usize, step: f64, angle: f64, jitter: f64) -> Vec<Position> {
    let mut rng = rng(7);
    let (s, c) = angle.sin_cos();
    let mut move_by = || {
        if jitter == 0.0 {
            0.0
        } else {
            rng.random_range(-jitter..jitter)
        }
    };
    (0..nx * ny)
        .map(|i| {
            let (x, y) = ((i % nx) as f64 * step, (i / nx) as f64 * step);
            at(x * c - y * s + move_by(), x * s + y * c + move_by())
        })
        .collect()
}

/// Layouts of samples that include every difficult case.
pub(crate) fn layouts() -> Vec<(&'static str, Vec<Position>)> {
    let circle = (0..24)
        .map(|i| {
            let (s, c) = (f64::from(i) * std::f64::consts::TAU / 24.0).sin_cos();
            at(50.0 + 40.0 * c, 50.0 + 40.0 * s)
        })
        .collect();
    let mut cluster = scattered(25, 3, 0.0, 100.0);
    cluster.extend((0..6).map(|i| at(40.0 + f64::from(i % 3) * 1e-9, 60.0 + f64::from(i * i) * 1e-9)));
    let line = |n: i32, off: f64| {
        (0..n)
            .map(|i| {
                at(
                    3.0 * f64::from(i) + off * f64::from(i * 7 % 5),
                    2.0 * f64::from(i) - off * f64::from(i * 3 % 7),
                )
            })
            .collect()
    };
    let l_shape = grid(7, 7, 10.0, 0.0, 0.0)
        .into_iter()
        .filter(|p| p.x() < 25.0 || p.y() < 25.0)
        .collect();
    let fan = (0..12)
        .map(|i| at(f64::from(i) * 10.0, 30.0))
        .chain([at(55.0, 0.0)])
        .collect();
    vec![
        ("grid", grid(7, 6, 12.0, 0.0, 0.0)),
        ("turned grid", grid(9, 8, 10.0, 0.6, 0.0)),
        ("uneven grid", grid(9, 8, 10.0, 0.0, 0.003)),
        ("scattered", scattered(60, 1, 0.0, 100.0)),
        ("far and wide", scattered(40, 2, 1e7, 1e7)),
        ("far and small", scattered(40, 5, 1e7, 30.0)),
        ("cluster", cluster),
        ("circle", circle),
        ("line", line(8, 0.0)),
        ("rounded line", line(8, 1e-13)),
        ("thin strip", line(12, 1e-4)),
        ("fan", fan),
        ("l-shape", l_shape),
        ("one", vec![at(31.25, 17.5)]),
        ("two", vec![at(10.0, 20.0), at(40.0, 35.0)]),
        ("three", vec![at(10.0, 20.0), at(60.0, 35.0), at(25.0, 70.0)]),
    ]
}

/// The provided methods with few weights at each position that accept these samples.
pub(crate) fn methods(positions: &SamplePositions) -> Vec<(&'static str, Box<dyn FieldInterpolation>)> {
    [
        "delaunay",
        "natural-neighbour",
        "idw",
        "idw=3.5",
        "bilinear",
        "bicubic",
        "polynomial=0",
        "polynomial=2",
        "nearest",
    ]
    .into_iter()
    .map(|name| (name, interpolation(name.parse().unwrap()).unwrap()))
    .filter(|(name, method)| {
        let fits = suits(method.as_ref(), positions);
        assert!(
            fits || matches!(*name, "bilinear" | "bicubic" | "polynomial=2"),
            "{name} must take any samples"
        );
        fits
    })
    .collect()
}

/// Returns whether a method accepts samples at these positions.
pub(crate) fn suits(method: &dyn FieldInterpolation, positions: &SamplePositions) -> bool {
    let zeros = SampleCoefficients::new(Array2::zeros((positions.len(), 1)), positions.clone()).unwrap();
    method.interpolate(&zeros, OutsidePolicy::Nearest).is_ok()
}

pub(crate) fn is_polynomial(name: &str) -> bool {
    name.starts_with("polynomial")
}

pub(crate) fn reproduces_slopes(name: &str) -> bool {
    matches!(name, "delaunay" | "natural-neighbour" | "bilinear" | "bicubic")
}

/// The bounding box of the samples.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extent {
    pub(crate) low: (f64, f64),
    pub(crate) high: (f64, f64),
}

impl Extent {
    pub(crate) fn of(positions: &[Position]) -> Self {
        let fold =
            |f: fn(f64, f64) -> f64, v: fn(&Position) -> f64| positions.iter().map(v).reduce(f).unwrap();
        Self {
            low: (fold(f64::min, |p| p.x()), fold(f64::min, |p| p.y())),
            high: (fold(f64::max, |p| p.x()), fold(f64::max, |p| p.y())),
        }
    }

    /// The larger side, at least one pixel.
    pub(crate) fn size(self) -> f64 {
        (self.high.0 - self.low.0).max(self.high.1 - self.low.1).max(1.0)
    }

    /// Coordinates relative to the box, of order 1.
    pub(crate) fn relative(self, p: Position) -> (f64, f64) {
        (
            (p.x() - self.low.0) / self.size(),
            (p.y() - self.low.1) / self.size(),
        )
    }

    /// Positions in the box, widened by `margin` of its size.
    pub(crate) fn probes(self, n: usize, seed: u64, margin: f64) -> Vec<Position> {
        let mut rng = rng(seed);
        let mut within = |low: f64, high: f64| {
            let m = margin * self.size();
            low - m + (high - low + 2.0 * m) * rng.random::<f64>()
        };
        (0..n)
            .map(|_| at(within(self.low.0, self.high.0), within(self.low.1, self.high.1)))
            .collect()
    }
}

/// Positions inside and outside: random ones, midpoints and thirds between samples (on edges), and
/// ones very close to samples.
pub(crate) fn probes(positions: &[Position]) -> Vec<Position> {
    let extent = Extent::of(positions);
    let mut probes = extent.probes(300, 11, 0.4);
    for (i, a) in positions.iter().enumerate() {
        let b = positions[(i + 1) % positions.len()];
        probes.push(a.midpoint(b));
        probes.push(at(a.x() + (b.x() - a.x()) / 3.0, a.y() + (b.y() - a.y()) / 3.0));
        for hair in [1e-15, 1e-12, 1e-6] {
            probes.push(at(a.x() + hair * extent.size(), a.y()));
            probes.push(at(a.x(), a.y() - hair * extent.size()));
        }
    }
    probes
}

pub(crate) fn samples_of(
    positions: &[Position],
    components: usize,
    f: impl Fn(Position, usize) -> f64,
) -> SampleCoefficients {
    let values = Array2::from_shape_fn((positions.len(), components), |(i, k)| f(positions[i], k));
    SampleCoefficients::new(values, SamplePositions::new(positions.to_vec(), None).unwrap()).unwrap()
}

pub(crate) fn field(
    samples: &SampleCoefficients,
    method: &dyn FieldInterpolation,
    outside: OutsidePolicy,
) -> Arc<dyn CoefficientField> {
    method.interpolate(samples, outside).unwrap()
}

pub(crate) fn value(field: &Arc<dyn CoefficientField>, p: Position) -> f64 {
    let mut all = vec![f64::NAN; field.component_count()];
    field.evaluate_into(p, &mut all).unwrap();
    all[0]
}

/// The weights of samples at any position: the coefficients if each sample is a component of its own.
pub(crate) struct SampleWeights(Arc<dyn CoefficientField>);

impl SampleWeights {
    pub(crate) fn new(
        method: &dyn FieldInterpolation,
        positions: &[Position],
        outside: OutsidePolicy,
    ) -> Self {
        let checked = SamplePositions::new(positions.to_vec(), None).unwrap();
        let units = SampleCoefficients::new(Array2::eye(positions.len()), checked).unwrap();
        Self(field(&units, method, outside))
    }

    /// The weights of nodes, which may be others than the samples.
    pub(crate) fn of_nodes(&self, p: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        let nodes = self.0.weighted_nodes().expect("a method with few weights");
        nodes.weights_into(p, weights)
    }

    pub(crate) fn node_count(&self) -> usize {
        let nodes = self.0.weighted_nodes().expect("a method with few weights");
        nodes.node_values().nrows()
    }

    pub(crate) fn of_samples(&self, p: Position) -> Array1<f64> {
        let mut weights = vec![0.0; self.0.component_count()];
        self.0.evaluate_into(p, &mut weights).unwrap();
        weights.into()
    }
}

pub(crate) fn magnitude(weights: &WeightList) -> f64 {
    weights.iter().map(|(_, w)| w.abs()).sum()
}

/// Every method on every layout.
pub(crate) fn each(mut check: impl FnMut(&str, &str, &[Position], &dyn FieldInterpolation)) {
    for (layout, positions) in layouts() {
        let checked = SamplePositions::new(positions.clone(), None).unwrap();
        for (name, method) in methods(&checked) {
            check(layout, name, &positions, method.as_ref());
        }
    }
}

/// A smooth field of order 1 whose slope over the layout is of order 1.
pub(crate) fn smooth(extent: Extent) -> impl Fn(Position, usize) -> f64 {
    move |p, k| {
        let (x, y) = extent.relative(p);
        (1.3 * x + 0.7 * k as f64).sin() + (1.1 * y - 0.4 * x * y).cos()
    }
}
