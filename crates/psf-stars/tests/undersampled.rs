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

/// The PSF with a tenth of its light in wings with a FWHM of 4.7 pixels.
fn psf_with_wings(at: Position, dx: f64, dy: f64) -> f64 {
    0.9 * psf(at, dx, dy) + 0.1 * in_pixel(dx, 2.0) * in_pixel(dy, 2.0)
}

/// A frame with 144 stars, and their positions and fluxes.
fn frame(psf: fn(Position, f64, f64) -> f64) -> (Image<f64>, Vec<(Position, f64)>) {
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
        stars.push((at, flux));
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
    let (frame, stars) = frame(psf);
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
        .map(|p| {
            stars
                .iter()
                .map(|s| s.0.distance(*p))
                .fold(f64::INFINITY, f64::min)
        })
        .collect();
    distances.sort_by(f64::total_cmp);
    let median = distances[distances.len() / 2];
    println!("median distance from the true place: {median:.4} pixels");
    assert!(median < PLACE_PX, "{median}");
}

/// Relative error of the median flux of 140 stars. The wings outside the stamp hold 0.25 % of the
/// light, and noise in the wings of the PSF is another few parts in a thousand.
const FLUX: f64 = 0.01;

/// A local background that is fitted together with the star, or a PSF that is expected to be a
/// Gaussian, takes the wings from the PSF and their light from the stars.
#[test]
fn the_flux_of_a_star_includes_its_wings() {
    let (frame, stars) = frame(psf_with_wings);
    let found = sampled(&frame, RegistrationMethod::Epsf);
    let mut ratios: Vec<f64> = found
        .sources
        .iter()
        .filter(|s| s.sample.is_some())
        .map(|s| {
            let at = Position::new(s.x, s.y).unwrap();
            let near =
                |a: &&(Position, f64), b: &&(Position, f64)| a.0.distance(at).total_cmp(&b.0.distance(at));
            s.flux / stars.iter().min_by(near).unwrap().1
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    let median = ratios[ratios.len() / 2];
    println!("median flux / true flux of {} stars: {median:.4}", ratios.len());
    assert!(ratios.len() >= 130 && (median - 1.0).abs() < FLUX, "{median}");
}

/// The fluxes of the stars and the PSF's sum at each phase are determined together only by the
/// condition that this sum is 1.
const PHASE_SUM: f64 = 2e-3;
/// The error of pixels in units of the PSF's flux, for stars without much noise.
const PIXEL: f64 = 0.012;

#[test]
fn pixels_around_a_star_hold_all_its_light_at_every_phase() {
    for sigma in [0.42, 0.55] {
        for flux in [1e5, 1e7] {
            let round = move |dx: f64, dy: f64| in_pixel(dx, sigma) * in_pixel(dy, sigma);
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let mut pixels = Array2::from_shape_simple_fn((SIDE, SIDE), || {
                let noise: f64 = StandardNormal.sample(&mut rng);
                200.0 + NOISE * noise
            });
            for k in 0..144u32 {
                let place = |c: u32, shift: f64| 20.0 + 32.7 * f64::from(c) + shift;
                let (x, y) = (
                    place(k % 12, rng.random::<f64>()),
                    place(k / 12, rng.random::<f64>()),
                );
                for ((row, column), value) in pixels.indexed_iter_mut() {
                    let (dx, dy) = (column as f64 - x, row as f64 - y);
                    if dx.abs() < 6.0 && dy.abs() < 6.0 {
                        *value += flux * round(dx, dy);
                    }
                }
            }
            let found = StarSampling::default().run(&Image::new(pixels).unwrap()).unwrap();
            let (samples, grid) = (&found.samples, found.samples.grid());
            let scale = grid.oversampling() as usize;
            let stamp = samples.stamps().index_axis(ndarray::Axis(0), 0).to_owned();
            let (mut least, mut most, mut worst) = (f64::MAX, f64::MIN, 0.0f64);
            for (y, x) in (0..scale).flat_map(|y| (0..scale).map(move |x| (y, x))) {
                let phase = stamp.slice(ndarray::s![y..; scale, x..; scale]);
                (least, most) = (least.min(phase.sum()), most.max(phase.sum()));
                for ((j, i), value) in phase.indexed_iter() {
                    let at = |k: usize, first: usize, centre: f64| {
                        ((k * scale + first) as f64 - centre) / scale as f64
                    };
                    let truth = round(at(i, x, grid.centre_x()), at(j, y, grid.centre_y()));
                    worst = worst.max((value - truth).abs());
                }
            }
            println!(
                "sigma {sigma}, flux {flux:e}: sums {least:.5} to {most:.5}, largest error {worst:.4}, {:?}",
                found.registration
            );
            assert!(1.0 - least < PHASE_SUM && most - 1.0 < PHASE_SUM);
            assert!(worst < PIXEL);
        }
    }
}

#[test]
fn every_star_is_left_out_of_the_samples_of_one_fold() {
    let (frame, stars) = frame(psf);
    let found = StarSampling::default()
        .with_cross_validation()
        .run(&frame)
        .unwrap();
    assert_eq!(found.folds.len(), 5);
    let mut left_out: Vec<usize> = Vec::new();
    for fold in &found.folds {
        assert!(fold.samples.len() + fold.left_out.len() <= found.samples.len());
        for star in &fold.left_out {
            left_out.push(star.sample.unwrap());
            let at = Position::new(star.x, star.y).unwrap();
            let nearest = |p: &[Position]| p.iter().map(|s| s.distance(at)).fold(f64::INFINITY, f64::min);
            assert!(nearest(fold.samples.positions().as_slice()) > 10.0);
            let truth: Vec<Position> = stars.iter().map(|s| s.0).collect();
            assert!(nearest(&truth) < 0.5);
        }
    }
    left_out.sort_unstable();
    assert_eq!(left_out, (0..found.samples.len()).collect::<Vec<_>>());
    // The other results do not change.
    let alone = StarSampling::default().run(&frame).unwrap();
    assert!(alone.folds.is_empty());
    assert_eq!((alone.samples, alone.sources), (found.samples, found.sources));
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let (frame, _) = frame(psf);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            StarSampling::default()
                .with_cross_validation()
                .run(&frame)
                .unwrap()
        })
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn holding_stars_out_does_not_choose_another_method() {
    let held_out = StarSampling::default().with_hold_out(135, 1);
    let error = held_out.run(&frame(psf).0).unwrap_err().to_string();
    assert!(error.contains("method epsf"), "{error}");
}
