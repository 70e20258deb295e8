//! Frames with many stars of all brightnesses, by default settings: the samples are near the truth,
//! however faint most of the stars are.

use ndarray::Array2;
use psf_stars::{Registration, RegistrationMethod, StarSamples, StarSampling};
use psf_types::Image;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SKY: f64 = 350.0;
const NOISE: f64 = 9.0;

/// A star: x, y, flux.
type Star = (f64, f64, f64);

/// A frame of `side` x `side` pixels with `stars`, whose PSF at a position has the value `psf(x, y,
/// dx, dy)` at the offset `(dx, dy)`.
fn frame(side: usize, stars: &[Star], psf: impl Fn(f64, f64, f64, f64) -> f64) -> Image<f64> {
    const REACH: usize = 12;
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut pixels = Array2::from_shape_simple_fn((side, side), || {
        let noise: f64 = StandardNormal.sample(&mut rng);
        SKY + NOISE * noise
    });
    for &(x, y, flux) in stars {
        let range = |v: f64| {
            let centre = v.round() as usize;
            centre.saturating_sub(REACH)..(centre + REACH + 1).min(side)
        };
        for row in range(y) {
            for column in range(x) {
                pixels[[row, column]] += flux * psf(x, y, column as f64 - x, row as f64 - y);
            }
        }
    }
    Image::new(pixels).unwrap()
}

fn gaussian(sigma: f64, dx: f64, dy: f64) -> f64 {
    let variance = sigma * sigma;
    (-0.5 * (dx * dx + dy * dy) / variance).exp() / (std::f64::consts::TAU * variance)
}

/// The median and the largest relative L2 error of the samples. `psf` as for [`frame`].
fn errors(found: &StarSamples, psf: impl Fn(f64, f64, f64, f64) -> f64) -> (f64, f64) {
    let grid = found.samples.grid();
    let offset = |k: usize, centre: f64| (k as f64 - centre) / grid.oversampling();
    let at = found.samples.positions().as_slice();
    let mut errors: Vec<f64> = found
        .samples
        .stamps()
        .outer_iter()
        .zip(at)
        .map(|(stamp, at)| {
            let (mut off, mut power) = (0.0, 0.0);
            for ((j, i), value) in stamp.indexed_iter() {
                let (dx, dy) = (offset(i, grid.centre_x()), offset(j, grid.centre_y()));
                let truth = psf(at.x(), at.y(), dx, dy);
                off += (value - truth).powi(2);
                power += truth * truth;
            }
            (off / power).sqrt()
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    (errors[errors.len() / 2], errors[errors.len() - 1])
}

/// Stars with a power law of fluxes, most of them near the detection limit.
fn faint_stars(side: usize, count: usize) -> Vec<Star> {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let star = |_| {
        let mut place = || (side - 1) as f64 * rng.random::<f64>();
        let (x, y) = (place(), place());
        (x, y, 250.0 * (1.0 - rng.random::<f64>()).powf(-1.0 / 0.75))
    };
    (0..count).map(star).collect()
}

/// The noise of some 400 stars, and of the spline.
const DEFAULT_ERROR: (f64, f64) = (0.01, 0.03);

#[test]
fn faint_stars_do_not_rule_the_psf() {
    let psf = |_: f64, _: f64, dx: f64, dy: f64| gaussian(1.4, dx, dy);
    let image = frame(1448, &faint_stars(1448, 1500), psf);
    let found = StarSampling::default().run(&image).unwrap();
    let (middle, largest) = errors(&found, psf);
    println!(
        "{} samples, {:?}: {middle:.4}, {largest:.4}",
        found.samples.len(),
        found.registration
    );
    assert_eq!(found.registration.method, RegistrationMethod::Epsf);
    assert!(middle < DEFAULT_ERROR.0 && largest < DEFAULT_ERROR.1);
}

/// Noise of single stars with a signal-to-noise ratio of at least 10.
const STAMP_ERROR: f64 = 3.0;

#[test]
fn stamps_of_faint_stars_keep_their_scale() {
    let psf = |_: f64, _: f64, dx: f64, dy: f64| gaussian(1.4, dx, dy);
    let image = frame(724, &faint_stars(724, 375), psf);
    let registration = Registration::default().with_method(RegistrationMethod::Stamps);
    let found = StarSampling::default()
        .with_registration(registration)
        .run(&image)
        .unwrap();
    // Divided by their own sum, stamps of stars whose sum is near 0 would be tens of times too large.
    let (_, largest) = errors(&found, psf);
    println!("{} samples: largest error {largest:.3}", found.samples.len());
    assert!(largest < STAMP_ERROR);
    let sums = found
        .samples
        .stamps()
        .outer_iter()
        .map(|s| s.sum())
        .collect::<Vec<_>>();
    assert!(sums.iter().all(|sum| (sum - 1.0).abs() < 1e-9), "{sums:?}");
}

#[test]
fn a_psf_that_varies_fast_keeps_the_stamps_of_its_stars() {
    let side = 640;
    let sigma = |x: f64| 1.5 + 0.2 * (x / 25.0).sin();
    let psf = |x: f64, _: f64, dx: f64, dy: f64| gaussian(sigma(x), dx, dy);
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let star = |k: u32| {
        let mut place = |v: u32| 30.0 + 30.0 * f64::from(v) + rng.random::<f64>();
        (place(k % 20), place(k / 20), 3e5)
    };
    let mut stars: Vec<Star> = (0..400).map(star).collect();
    let image = frame(side, &stars, psf);
    let found = StarSampling::default().run(&image).unwrap();
    let (middle, largest) = errors(&found, psf);
    println!("{:?}: {middle:.4}, {largest:.4}", found.registration);
    assert_eq!(found.registration.method, RegistrationMethod::Stamps);
    assert!(middle < DEFAULT_ERROR.0, "{middle}");
    // Fainter stars at the same places, with a PSF that varies as a parabola.
    for star in &mut stars {
        star.2 = 3e4;
    }
    let sigma = |x: f64| 1.4 + 0.2 * (x / 640.0).powi(2);
    let psf = |x: f64, _: f64, dx: f64, dy: f64| gaussian(sigma(x), dx, dy);
    let found = StarSampling::default().run(&frame(side, &stars, psf)).unwrap();
    let (middle, largest) = errors(&found, psf);
    println!("{:?}: {middle:.4}, {largest:.4}", found.registration);
    assert_eq!(found.registration.method, RegistrationMethod::Epsf);
    assert!(middle < DEFAULT_ERROR.0 && largest < DEFAULT_ERROR.1);
}
