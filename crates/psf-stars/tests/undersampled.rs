//! Undersampled stars with a varying PSF: the oversampled PSF recovers information that single
//! stars do not contain.

use ndarray::Array2;
use psf_stars::{Registration, RegistrationMethod, StarSamples, StarSampling};
use psf_types::{Image, Position};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SIDE: usize = 400;
const NOISE: f64 = 3.0;

/// Sigma along x and y in pixels, without the pixel response: a FWHM of 1.2 to 1.7 pixels over the
/// field.
fn sigmas(at: Position) -> (f64, f64) {
    let (u, v) = (at.x() / SIDE as f64, at.y() / SIDE as f64);
    (0.5 + 0.15 * u, 0.5 + 0.1 * v + 0.1 * u * v)
}

/// The fraction of a Gaussian's light in the pixel at `offset`.
fn in_pixel(offset: f64, sigma: f64) -> f64 {
    const STEPS: usize = 16;
    let sum: f64 = (0..STEPS)
        .map(|k| {
            let t = offset + (k as f64 + 0.5) / STEPS as f64 - 0.5;
            (-0.5 * (t / sigma).powi(2)).exp()
        })
        .sum();
    sum / STEPS as f64 / (sigma * std::f64::consts::TAU.sqrt())
}

fn psf(at: Position, dx: f64, dy: f64) -> f64 {
    let (sx, sy) = sigmas(at);
    in_pixel(dx, sx) * in_pixel(dy, sy)
}

fn frame() -> (Image<f64>, Vec<Position>) {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut pixels = Array2::from_shape_simple_fn((SIDE, SIDE), || {
        let noise: f64 = StandardNormal.sample(&mut rng);
        200.0 + NOISE * noise
    });
    let mut stars = Vec::new();
    for k in 0..144u32 {
        let place = |c: u32, shift: f64| 20.0 + 32.7 * f64::from(c) + shift;
        let (x, y) = (
            place(k % 12, rng.random::<f64>()),
            place(k / 12, rng.random::<f64>()),
        );
        let at = Position::new(x, y).unwrap();
        let flux = 2000.0 * 10f64.powf(rng.random::<f64>());
        for ((row, column), value) in pixels.indexed_iter_mut() {
            let (dx, dy) = (column as f64 - x, row as f64 - y);
            if dx.abs() < 8.0 && dy.abs() < 8.0 {
                *value += flux * psf(at, dx, dy);
            }
        }
        stars.push(at);
    }
    (Image::new(pixels).unwrap(), stars)
}

fn sampled(frame: &Image<f64>, method: RegistrationMethod) -> StarSamples {
    let registration = Registration::default().with_method(method);
    StarSampling::default()
        .with_registration(registration)
        .run(frame)
        .unwrap()
}

/// Median relative L2 error of the samples' stamps at frame pixels of all phases.
fn median_error(found: &StarSamples) -> f64 {
    let grid = found.samples.grid();
    let offset = |k: usize, centre: f64| (k as f64 - centre) / grid.oversampling();
    let mut errors: Vec<f64> = found
        .samples
        .stamps()
        .outer_iter()
        .zip(found.samples.positions().as_slice())
        .map(|(stamp, &at)| {
            let (mut off, mut power) = (0.0, 0.0);
            for ((j, i), value) in stamp.indexed_iter() {
                let truth = psf(at, offset(i, grid.centre_x()), offset(j, grid.centre_y()));
                off += (value - truth).powi(2);
                power += truth * truth;
            }
            (off / power).sqrt()
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

/// Noise of about 140 stars with a signal-to-noise ratio of at least 100, and cubic splines on two
/// nodes per pixel.
const EPSF_ERROR: f64 = 0.05;
/// The error of positions, including noise.
const PLACE_PX: f64 = 0.03;

#[test]
fn an_oversampled_psf_is_closer_to_the_truth_than_single_stars() {
    let (frame, stars) = frame();
    let epsf = sampled(&frame, RegistrationMethod::Auto);
    assert_eq!(epsf.registration.method, RegistrationMethod::Epsf);
    assert!(epsf.samples.len() >= 140, "{} samples", epsf.samples.len());
    let own = sampled(&frame, RegistrationMethod::Stamps);
    let (with, without) = (median_error(&epsf), median_error(&own));
    println!("median relative L2 error: epsf {with:.4}, own stamps {without:.4}");
    assert!(
        with < EPSF_ERROR && with < 0.5 * without,
        "{with} against {without}"
    );

    let mut distances: Vec<f64> = epsf
        .samples
        .positions()
        .as_slice()
        .iter()
        .map(|p| stars.iter().map(|s| s.distance(*p)).fold(f64::INFINITY, f64::min))
        .collect();
    distances.sort_by(f64::total_cmp);
    let median = distances[distances.len() / 2];
    println!("median distance from the true place: {median:.4} pixels");
    assert!(median < PLACE_PX, "{median}");
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let (frame, _) = frame();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| sampled(&frame, RegistrationMethod::Auto))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn holding_stars_out_does_not_choose_another_method() {
    let held_out = StarSampling::default().with_hold_out(135, 1);
    let error = held_out.run(&frame().0).unwrap_err().to_string();
    assert!(error.contains("method epsf"), "{error}");
}
