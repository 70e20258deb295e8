//! The flux of a Sersic profile in a rectangle, by a method that differs from the crate's.
//!
//! Consider a profile of flux 1 with circular isophotes. By Green's theorem,
//! `integral over A = 1 / (2 pi) * line integral around A of G(r) dtheta`. Here `G` is the flux
//! within a radius, `P(2n, b (r / re)^(1/n))`. An elliptical profile is circular in coordinates in
//! which the rectangle is a parallelogram.
#![allow(dead_code, reason = "each test file uses a part")]

use psf_types::{Position, SersicProfile, SersicSource};
use statrs::function::gamma::gamma_lr;

/// Accuracy of each edge's integral.
const EDGE_ERROR: f64 = 1e-12;

pub(crate) fn galaxy(at: (f64, f64), flux: f64, profile: SersicProfile) -> SersicSource {
    SersicSource::new(Position::new(at.0, at.1).unwrap(), flux, profile).unwrap()
}

/// The flux within a rectangle, with corners in pixels of the scene.
pub(crate) fn flux_within(galaxy: &SersicSource, low: (f64, f64), high: (f64, f64)) -> f64 {
    let shape = galaxy.profile();
    let n = shape.index();
    let b = half_light_constant(n);
    let within = |r: f64| gamma_lr(2.0 * n, b * (r / shape.half_light_radius_px()).powf(1.0 / n));
    let (sin, cos) = shape.angle_deg().to_radians().sin_cos();
    let turned = |x: f64, y: f64| {
        let (dx, dy) = (x - galaxy.position().x(), y - galaxy.position().y());
        (dx * cos + dy * sin, (dy * cos - dx * sin) / shape.axis_ratio())
    };
    let corners =
        [(low.0, low.1), (high.0, low.1), (high.0, high.1), (low.0, high.1)].map(|(x, y)| turned(x, y));
    let edges = (0..4).map(|i| edge(corners[i], corners[(i + 1) % 4], &within));
    galaxy.flux() * edges.sum::<f64>() / std::f64::consts::TAU
}

/// The flux in a pixel.
pub(crate) fn pixel(galaxy: &SersicSource, x: i64, y: i64) -> f64 {
    let (x, y) = (x as f64, y as f64);
    flux_within(galaxy, (x - 0.5, y - 0.5), (x + 0.5, y + 0.5))
}

/// The integral of G dtheta along a straight line.
fn edge(from: (f64, f64), to: (f64, f64), within: &dyn Fn(f64) -> f64) -> f64 {
    let along = (to.0 - from.0, to.1 - from.1);
    let length = along.0.hypot(along.1);
    // Signed distance of the line from the origin. It is positive when the origin lies to its left.
    let distance = (from.0 * along.1 - from.1 * along.0) / length;
    if distance == 0.0 {
        return 0.0;
    }
    let angle = |p: (f64, f64)| ((p.0 * along.0 + p.1 * along.1) / length).atan2(distance.abs());
    let value = |phi: f64| within(distance.abs() / phi.cos());
    let (start, end) = (angle(from), angle(to));
    distance.signum() * adaptive(&value, start, end, gauss_5(&value, start, end), 50)
}

fn gauss_5(f: &dyn Fn(f64) -> f64, a: f64, b: f64) -> f64 {
    // Gauss-Legendre nodes and weights.
    const NODES: [(f64, f64); 5] = [
        (0.0, 0.568_888_888_888_888_9),
        (0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
        (-0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
        (0.906_179_845_938_664, 0.236_926_885_056_189_1),
        (-0.906_179_845_938_664, 0.236_926_885_056_189_1),
    ];
    let (middle, half) = (f64::midpoint(a, b), 0.5 * (b - a));
    NODES.iter().map(|(x, w)| w * f(middle + half * x)).sum::<f64>() * half
}

fn adaptive(f: &dyn Fn(f64) -> f64, a: f64, b: f64, whole: f64, depth: u32) -> f64 {
    let middle = f64::midpoint(a, b);
    let (left, right) = (gauss_5(f, a, middle), gauss_5(f, middle, b));
    if depth == 0 || (left + right - whole).abs() < EDGE_ERROR {
        return left + right;
    }
    adaptive(f, a, middle, left, depth - 1) + adaptive(f, middle, b, right, depth - 1)
}

/// Returns `b` with `P(2n, b) = 1/2`.
fn half_light_constant(n: f64) -> f64 {
    let (mut low, mut high) = (0.0, 40.0);
    for _ in 0..200 {
        let middle = f64::midpoint(low, high);
        if gamma_lr(2.0 * n, middle) < 0.5 {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}
