//! Masked pixels: the background and its noise ignore them, and no sample uses them.

use ndarray::{Array2, s};
use psf_stars::{BackgroundMesh, Rejection, StarError, StarSamples, StarSampling};
use psf_types::Image;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SIDE: usize = 256;
const SKY: f64 = 300.0;
const NOISE: f64 = 3.0;
const SIGMA_PX: f64 = 1.3;

/// Centres of the stars, on a grid with different positions between pixels.
fn stars() -> Vec<(f64, f64)> {
    let shift = |k: usize| (k % 7) as f64 / 7.0;
    (0..36)
        .map(|k| {
            (
                25.0 + 40.0 * (k % 6) as f64 + shift(k),
                25.0 + 40.0 * (k / 6) as f64 + shift(3 * k),
            )
        })
        .collect()
}

fn frame() -> Array2<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut pixels = Array2::from_shape_simple_fn((SIDE, SIDE), || {
        let noise: f64 = StandardNormal.sample(&mut rng);
        SKY + NOISE * noise
    });
    for (x, y) in stars() {
        for ((row, column), value) in pixels.indexed_iter_mut() {
            let r2 = (column as f64 - x).powi(2) + (row as f64 - y).powi(2);
            *value += 2000.0 * (-0.5 * r2 / (SIGMA_PX * SIGMA_PX)).exp();
        }
    }
    pixels
}

fn at(found: &StarSamples, (x, y): (f64, f64)) -> Option<&psf_stars::Source> {
    found.sources.iter().find(|s| (s.x - x).hypot(s.y - y) < 1.5)
}

#[test]
fn stars_with_a_masked_core_are_rejected_and_the_others_do_not_change() {
    let clean = frame();
    let whole = StarSampling::default()
        .run(&Image::new(clean.clone()).unwrap())
        .unwrap();
    assert_eq!(whole.samples.len(), 36);

    // The core of star 7, a pixel in the wing of star 14, and a quarter of the frame, of which one
    // cell of the background is a part, are masked. The values there are wild.
    let (core, wing) = (stars()[7], stars()[14]);
    let pixel = |(x, y): (f64, f64), dx: usize| (y.round() as usize, x.round() as usize + dx);
    let mut bad = clean.clone();
    bad[pixel(core, 1)] = f64::NAN;
    bad[pixel(wing, 7)] = f64::NAN;
    bad.slice_mut(s![165.., 165..]).fill(f64::NAN);
    let found = StarSampling::default().run_masked(bad).unwrap();
    let rejected = at(&found, core).expect("it is detected").rejected;
    assert!(rejected.contains(Rejection::Masked), "{rejected}");
    assert_eq!(rejected.to_string(), "masked");
    let kept = at(&found, wing).unwrap();
    assert!(kept.sample.is_some(), "{kept:?}");
    let inside = |&&(x, y): &&(f64, f64)| x > 165.0 && y > 165.0;
    let masked = stars().iter().filter(inside).count();
    assert_eq!(found.samples.len(), 36 - 1 - masked);
    assert!(found.sources.iter().all(|s| s.x < 165.0 || s.y < 165.0));
    // The sample in whose wing a pixel is masked differs only by noise from the sample of the whole
    // frame, and no sample holds NaN (which its type refuses).
    let stamp = |samples: &StarSamples| {
        let source = at(samples, wing).unwrap();
        samples.samples.stamp(source.sample.unwrap()).to_owned()
    };
    let difference = &stamp(&found) - &stamp(&whole);
    assert!(difference.iter().all(|v| v.abs() < 5e-3), "{difference}");
}

#[test]
fn the_background_ignores_masked_pixels() {
    let clean = frame();
    let mesh = BackgroundMesh::default();
    let truth = mesh.estimate(clean.view()).unwrap();
    let mut bad = clean.clone();
    // Every third pixel, and all pixels of one cell.
    bad.indexed_iter_mut().for_each(|((y, x), v)| {
        if (x + y) % 3 == 0 {
            *v = f64::NAN;
        }
    });
    bad.slice_mut(s![..64, ..64]).fill(f64::NAN);
    let found = mesh.estimate(bad.view()).unwrap();
    assert!((found.typical_level() - truth.typical_level()).abs() < 0.3);
    assert!((found.typical_rms() / truth.typical_rms() - 1.0).abs() < 0.05);
    assert!(found.level().iter().all(|v| (v - SKY).abs() < 3.0));
    // As numbers, bad pixels would spoil the noise.
    let zeros = bad.mapv(|v| if v.is_nan() { 0.0 } else { v });
    let spoiled = mesh.estimate(zeros.view()).unwrap();
    assert!(spoiled.typical_rms() > 10.0 * truth.typical_rms());
}

#[test]
fn frames_without_a_good_pixel_are_refused() {
    let run = |pixels| StarSampling::default().run_masked(pixels).unwrap_err();
    let masked = Array2::from_elem((64, 64), f64::NAN);
    assert!(matches!(
        BackgroundMesh::default().estimate(masked.view()),
        Err(StarError::NoNoise)
    ));
    assert!(
        run(masked)
            .to_string()
            .contains("every pixel of the frame is masked")
    );
    let mut infinite = frame();
    infinite[[3, 4]] = f64::INFINITY;
    assert!(run(infinite).to_string().contains("infinite"));
}
