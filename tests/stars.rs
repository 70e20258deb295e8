//! From a frame with stars of a known PSF to samples and a fit: noise stays out of the model.

use ndarray::Array2;
use psfield::FitOptions;
use psfield::fit::fit;
use psfield::psf_stars::{Registration, RegistrationMethod, StarSampling};
use psfield::psf_types::Image;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const ACROSS: usize = 16;
const STEP: f64 = 34.0;
const SIDE: usize = 550;

/// White noise and stars at all sub-pixel phases. The PSF is one Gaussian, or mixes with a wider
/// one along x.
fn frame(fwhm_px: f64, varies: bool) -> Image<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    let mut pixels = Array2::from_shape_simple_fn((SIDE, SIDE), || {
        // The sum of twelve uniform numbers is close enough to a normal distribution here.
        let sum: f64 = (0..12).map(|_| rng.random::<f64>()).sum();
        200.0 + 5.0 * (sum - 6.0)
    });
    let sigma = fwhm_px / 2.354_82;
    for k in 0..ACROSS * ACROSS {
        let place = |c: usize, shift: f64| STEP * (c as f64 + 0.5) + shift;
        let (x, y) = (place(k % ACROSS, rng.random()), place(k / ACROSS, rng.random()));
        let flux = 2e4 * 10f64.powf(0.7 * rng.random::<f64>());
        let wide = if varies { 0.5 * x / SIDE as f64 } else { 0.0 };
        let (column, row) = (x.round() as usize, y.round() as usize);
        for j in row - 14..=row + 14 {
            for i in column - 14..=column + 14 {
                let r2 = (i as f64 - x).powi(2) + (j as f64 - y).powi(2);
                let gaussian = |s: f64| (-0.5 * r2 / (s * s)).exp() / (std::f64::consts::TAU * s * s);
                pixels[[j, i]] += flux * ((1.0 - wide) * gaussian(sigma) + wide * gaussian(1.3 * sigma));
            }
        }
    }
    Image::new(pixels).unwrap()
}

fn rank(fwhm_px: f64, varies: bool, registration: Registration) -> usize {
    let found = StarSampling::default()
        .with_registration(registration)
        .run(&frame(fwhm_px, varies))
        .unwrap();
    assert!(found.samples.len() > 200, "{} samples", found.samples.len());
    let fitted = fit(found.samples, &FitOptions::default()).unwrap();
    let rank = fitted.record().basis().rank();
    println!(
        "FWHM {fwhm_px}, varies: {varies}: {:?}, rank {rank}",
        found.registration
    );
    rank
}

/// Terms of the polynomial of the highest degree over the field, 4.
const MOST_TERMS: usize = 15;
/// One mode of the field, and a few for errors of positions and of the background at the stamp's
/// edge.
const FEW: usize = 6;

#[test]
fn noise_of_well_sampled_stars_stays_out_of_the_model() {
    let stamps = Registration::default().with_method(RegistrationMethod::Stamps);
    for fwhm_px in [2.9, 3.0] {
        let kept = rank(fwhm_px, false, stamps);
        assert!(kept <= FEW, "FWHM {fwhm_px}: {kept}");
    }
    // This test can fail: on a finer grid the noise is not white.
    let finer = stamps.with_oversampling(2).unwrap();
    assert!(rank(2.9, false, finer) > 100);
    // By default, one oversampled PSF has at most as many modes as the polynomial has terms.
    for fwhm_px in [2.9, 3.0] {
        let kept = rank(fwhm_px, true, Registration::default());
        assert!(kept < MOST_TERMS, "FWHM {fwhm_px}: {kept}");
    }
}

#[test]
fn undersampled_stars_give_no_more_shapes_than_the_field_has_terms() {
    // One mode for each term of the polynomial except the constant. The least rank is 1.
    for (varies, most) in [(false, 1), (true, 2)] {
        let kept = rank(1.7, varies, Registration::default());
        assert!(kept <= most, "varies: {varies}: {kept}");
    }
    let own = Registration::default()
        .with_method(RegistrationMethod::Epsf)
        .with_own_shapes(true);
    assert!(rank(1.7, false, own) > 100);
}
