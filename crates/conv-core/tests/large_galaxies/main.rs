//! Galaxies much larger than their PSF, compared with integrals in real space.

#[allow(dead_code, reason = "each test binary uses a part")]
#[path = "../common/mod.rs"]
mod common;
mod integral;

use std::f64::consts::PI;

use common::extended::extended;
use common::model_of_stamp;
use conv_core::{ConvReal, PlanOptions, SourcePlan};
use integral::{Cells, Shape, Truth};
use ndarray::Array2;
use psf_types::{FrameShape, NoProgress, Position, PsfModel, SersicProfile, SersicSource, StampGrid};
use rayon::prelude::*;

/// A PSF of unit flux: its model, and the same stamp for the integrals.
struct Psf {
    name: &'static str,
    model: PsfModel,
    cells: Cells,
}

impl Psf {
    /// From a function of the offset in frame pixels.
    fn new(name: &'static str, side: usize, oversampling: f64, psf: impl Fn(f64, f64) -> f64) -> Self {
        let grid = StampGrid::new(side, side).and_then(|grid| grid.with_oversampling(oversampling));
        let grid = grid.unwrap();
        let at = |i: usize, centre: f64| (i as f64 - centre) / oversampling;
        let mut stamp = Array2::from_shape_fn(grid.dim(), |(y, x)| {
            psf(at(x, grid.centre_x()), at(y, grid.centre_y()))
        });
        stamp /= stamp.sum() / (oversampling * oversampling);
        let cells = Cells::new(stamp.view(), grid);
        let model = model_of_stamp(stamp, grid);
        Self { name, model, cells }
    }
}

/// The response of a pixel, by five points along each axis. Like that of a square pixel, its transform is
/// 0 at the sampling frequency, so the sum over pixels does not depend on where they lie.
fn over_pixel(x: f64, y: f64, psf: impl Fn(f64, f64) -> f64) -> f64 {
    let nodes = [-0.4, -0.2, 0.0, 0.2, 0.4];
    nodes
        .map(|dy| nodes.map(|dx| psf(x + dx, y + dy)).iter().sum::<f64>())
        .iter()
        .sum()
}

fn gaussian() -> Psf {
    Psf::new("Gaussian", 25, 1.0, |x, y| (-(x * x + y * y) / 4.5).exp())
}

fn moffat() -> Psf {
    Psf::new("Moffat", 82, 2.0, |x, y| {
        over_pixel(x, y, |x, y| (1.0 + (x * x + 1.2 * y * y) / 3.0).powf(-2.5))
    })
}

/// The obstructed aperture of a space telescope like Roman, at 1.3 micrometres, and the response of a
/// pixel (Born and Wolf, section 8.6.2).
fn roman() -> Psf {
    const OBSTRUCTION: f64 = 0.31;
    /// Radians of the Airy pattern per pixel: pi D / lambda times 0.11 arcseconds.
    const PER_PIXEL: f64 = 3.04;
    let bessel = |x: f64| -> f64 {
        // J_1 by the trapezoidal rule for Bessel's integral.
        const STEPS: usize = 128;
        (0..STEPS)
            .map(|i| (i as f64 + 0.5) * PI / STEPS as f64)
            .map(|t| (t - x * t.sin()).cos())
            .sum::<f64>()
            / STEPS as f64
    };
    let disc = |x: f64| if x < 1e-6 { 1.0 } else { 2.0 * bessel(x) / x };
    let airy: Vec<f64> = (0..10_000)
        .map(|i| PER_PIXEL * f64::from(i) / 256.0)
        .map(|x| (disc(x) - OBSTRUCTION.powi(2) * disc(OBSTRUCTION * x)).powi(2))
        .collect();
    Psf::new("Roman", 128, 4.0, |x, y| {
        over_pixel(x, y, |x, y| airy[(x.hypot(y) * 256.0).round() as usize])
    })
}

/// Half-light radius, index, axis ratio.
const GALAXIES: [(f64, f64, f64); 24] = [
    (20.0, 0.5, 1.0),
    (20.0, 1.0, 0.1),
    (20.0, 2.5, 0.5),
    (20.0, 4.0, 0.3),
    (20.0, 8.0, 0.7),
    (60.0, 0.5, 0.2),
    (60.0, 1.0, 0.6),
    (60.0, 4.0, 0.5),
    (60.0, 6.2, 0.5),
    (100.0, 2.5, 1.0),
    (100.0, 4.0, 0.1),
    (120.0, 8.0, 0.2),
    (120.0, 1.0, 0.3),
    (200.0, 1.0, 1.0),
    (200.0, 0.7, 0.4),
    (200.0, 4.0, 0.8),
    (300.0, 1.0, 1.0),
    (300.0, 2.5, 0.5),
    (500.0, 1.0, 1.0),
    (500.0, 0.5, 0.5),
    (500.0, 6.2, 0.9),
    (1000.0, 1.0, 0.7),
    (1000.0, 2.5, 0.2),
    (1000.0, 8.0, 1.0),
];
const SIDE: usize = 1025;
const CENTRE: (f64, f64) = (512.3, 511.8);

/// Pixels around the centre, and along the axes and diagonals: at the edges and corners of windows of
/// any size, within them and beyond.
fn pixels() -> Vec<(usize, usize)> {
    const DISTANCES: [i64; 19] = [
        9, 14, 18, 23, 30, 34, 39, 47, 63, 79, 95, 119, 158, 163, 191, 238, 319, 383, 478,
    ];
    let at = |(x, y): (i64, i64)| ((512 + x) as usize, (512 + y) as usize);
    let around = (-3..=3).flat_map(|y| (-3..=3).map(move |x| (x, y)));
    let directions = [
        (1, 0),
        (1, 1),
        (0, 1),
        (-1, 1),
        (-1, 0),
        (-1, -1),
        (0, -1),
        (1, -1),
    ];
    let far = DISTANCES
        .into_iter()
        .flat_map(|d| directions.map(|(x, y)| (x * d, y * d)));
    around.chain(far).map(at).collect()
}

/// Galaxies of index 8 and of large radii among others.
fn some() -> Vec<(f64, f64, f64)> {
    GALAXIES.into_iter().skip(2).step_by(3).collect()
}

fn galaxy((re, n, q): (f64, f64, f64), angle_deg: f64) -> SersicSource {
    let profile = SersicProfile::new(re, n, q, angle_deg).unwrap();
    SersicSource::new(Position::new(CENTRE.0, CENTRE.1).unwrap(), 1.0, profile).unwrap()
}

fn drawn<T: ConvReal>(psf: &Psf, galaxy: SersicSource, tolerance: f64) -> Array2<T> {
    let plan = SourcePlan::<T>::new(&psf.model, PlanOptions::new(tolerance).unwrap(), None).unwrap();
    let frame = FrameShape::new(SIDE, SIDE).unwrap().region();
    let mut image = Array2::zeros((SIDE, SIDE));
    extended(&[galaxy], |sources| {
        plan.draw_extended_into(sources, frame, frame, image.view_mut(), &NoProgress)
    })
    .unwrap();
    image
}

/// Compares the pixels and the flux in the frame with the integrals, at each tolerance.
fn check(psf: &Psf, galaxies: &[(f64, f64, f64)], tolerances: &[f64]) {
    let pixels = pixels();
    let mut wrong = Vec::new();
    for (number, &(re, n, q)) in galaxies.iter().enumerate() {
        let angle_deg = 37.0 * number as f64 % 180.0;
        let shape = Shape { re, n, q, angle_deg };
        let truth = Truth::new(shape);
        let exact: Vec<f64> = pixels
            .par_iter()
            .map(|&(x, y)| {
                psf.cells
                    .image(&truth, (x as f64 - CENTRE.0, y as f64 - CENTRE.1))
            })
            .collect();
        let peak = exact.iter().copied().fold(0.0, f64::max);
        let last = SIDE as f64 - 1.0;
        let sum = truth.sum_over(
            [-CENTRE.0, -CENTRE.1],
            [last - CENTRE.0, last - CENTRE.1],
            psf.cells.covariance(),
        );
        for &tolerance in tolerances {
            let image = drawn::<f64>(psf, galaxy((re, n, q), angle_deg), tolerance);
            let flux = image.sum() - sum;
            let (mut largest, mut at) = (0.0_f64, (0, 0));
            for (&(x, y), exact) in pixels.iter().zip(&exact) {
                let error = (image[[y, x]] - exact) / peak;
                if error.abs() > largest.abs() {
                    (largest, at) = (error, (x, y));
                }
            }
            let case = format!(
                "{}, re = {re}, n = {n}, q = {q}, tolerance {tolerance:e}: pixel {largest:+.1e} of the peak \
                 at {at:?}, flux {flux:+.1e}",
                psf.name
            );
            println!("{case}");
            let limit = tolerance.max(SINGLE_PRECISION);
            if largest.abs() > limit || flux.abs() > limit {
                wrong.push(case);
            }
        }
    }
    assert!(wrong.is_empty(), "{} wrong:\n{}", wrong.len(), wrong.join("\n"));
}

/// Errors of light and transforms in single precision, as a fraction of the peak and of the flux. They
/// are the documented limit below this tolerance.
const SINGLE_PRECISION: f64 = 1e-6;
const TOLERANCES: [f64; 4] = [1e-3, 1e-4, 1e-6, 0.0];

#[test]
fn large_galaxies_are_within_the_tolerance() {
    check(&gaussian(), &GALAXIES, &TOLERANCES);
}

#[test]
fn large_galaxies_through_a_psf_with_wings() {
    check(&moffat(), &some(), &[1e-3, 1e-6]);
}

#[test]
fn large_galaxies_through_an_obstructed_aperture() {
    check(&roman(), &some(), &[1e-3, 1e-6]);
}

#[test]
#[ignore = "takes minutes: all galaxies at all tolerances"]
fn all_galaxies_through_psfs_with_wings() {
    check(&moffat(), &GALAXIES, &TOLERANCES);
    check(&roman(), &GALAXIES, &TOLERANCES);
}

/// In f32, the light that a window's period brings in must not be so bright that its rounding matters.
#[test]
fn large_galaxies_in_single_precision() {
    const TOLERANCE: f64 = 1e-4;
    let psf = gaussian();
    for shape in [
        (300.0, 1.0, 1.0),
        (1000.0, 0.5, 0.8),
        (1000.0, 1.0, 0.3),
        (1000.0, 2.5, 0.7),
    ] {
        let single = drawn::<f32>(&psf, galaxy(shape, 20.0), TOLERANCE);
        let double = drawn::<f64>(&psf, galaxy(shape, 20.0), TOLERANCE);
        let peak = double.iter().copied().fold(0.0, f64::max);
        let errors = single.iter().zip(&double).map(|(a, b)| (f64::from(*a) - b).abs());
        let largest = errors.fold(0.0, f64::max) / peak;
        println!("{shape:?}: {largest:.1e}");
        assert!(largest < 0.3 * TOLERANCE, "{shape:?}: {largest:e}");
    }
}

/// Galaxies much larger than the largest windows are nearly flat, and have no dark pixels.
#[test]
fn huge_galaxies_are_flat() {
    const TOLERANCE: f64 = 1e-3;
    let psf = gaussian();
    for (re, n) in [(3e4, 0.5), (3e4, 1.0), (3e4, 4.0)] {
        let image = drawn::<f64>(&psf, galaxy((re, n, 1.0), 0.0), TOLERANCE);
        let light = Truth::new(Shape {
            re,
            n,
            q: 1.0,
            angle_deg: 0.0,
        });
        let peak = image.iter().copied().fold(0.0, f64::max);
        let at = |(x, y): (usize, usize)| {
            let exact = psf
                .cells
                .image(&light, (x as f64 - CENTRE.0, y as f64 - CENTRE.1));
            image[[y, x]] - exact
        };
        let largest = pixels()
            .into_iter()
            .map(|pixel| at(pixel).abs())
            .fold(0.0, f64::max)
            / peak;
        println!("re = {re:e}, n = {n}: {largest:.1e}");
        assert!(image.iter().all(|&v| v > 0.0), "re = {re:e}, n = {n}");
        assert!(largest < TOLERANCE, "re = {re:e}, n = {n}: {largest:e}");
    }
}
