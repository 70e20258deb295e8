//! Rank selection with noisy samples: modes are kept, noise is not.

mod common;

use common::{normal, orthonormal_rows, samples};
use nalgebra::DMatrix;
use ndarray::{Array1, Array2, Axis};
use psf_basis::{BasisMethod, Centring, RankSelection, Svd};

const COUNT: usize = 400;
const SIDE: usize = 15;
const MODES: usize = 6;
/// Singular values of the six modes, relative to the sixth.
const STRENGTHS: [f64; MODES] = [60.0, 25.0, 10.0, 4.0, 2.0, 1.0];
/// The sixth singular value divided by the largest one of pure noise.
const LEVELS: [f64; 6] = [2.0, 3.0, 10.0, 100.0, 1e3, 1e4];

/// A round PSF of unit flux and FWHM 2.4 pixels.
fn mean_stamp() -> Array1<f64> {
    let psf = Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
        let r2 = (x as f64 - 7.0).powi(2) + (y as f64 - 7.0).powi(2);
        (-0.5 * r2).exp()
    });
    let flux = psf.sum();
    (psf / flux).into_flat()
}

/// The samples without noise `[sample, pixel]`, of unit flux. They consist of the PSF and six modes
/// of zero flux, the sixth of strength `sixth`.
fn clean(sixth: f64) -> Array2<f64> {
    let pixels = SIDE * SIDE;
    let modes = orthonormal_rows(MODES, pixels, 1);
    let fields = orthonormal_rows(MODES, COUNT, 2);
    let mut rows = Array2::zeros((COUNT, pixels));
    rows += &mean_stamp().insert_axis(Axis(0));
    for k in 0..MODES {
        for j in 0..COUNT {
            rows.row_mut(j)
                .scaled_add(sixth * STRENGTHS[k] * fields[[k, j]], &modes.row(k));
        }
    }
    rows
}

/// The largest singular value of centred rows.
fn norm(rows: &Array2<f64>) -> f64 {
    let centred = rows - &rows.mean_axis(Axis(0)).unwrap();
    let matrix = DMatrix::from_row_slice(
        COUNT,
        SIDE * SIDE,
        centred.as_standard_layout().as_slice().unwrap(),
    );
    matrix.singular_values().max()
}

/// Noise levels of the samples: a factor of `spread` between the brightest and the faintest star,
/// evenly spaced in the logarithm.
fn unevenness(spread: f64) -> Vec<f64> {
    // In an order unrelated to the fields of the modes.
    (0..COUNT)
        .map(|j| spread.powf(((j * 149) % COUNT) as f64 / COUNT as f64))
        .collect()
}

fn noise(spread: f64, seed: u64) -> Array2<f64> {
    let levels: Array1<f64> = unevenness(spread).into_iter().collect();
    normal(COUNT, SIDE * SIDE, seed) * &levels.insert_axis(Axis(1))
}

fn check(rows: &Array2<f64>, what: &str) {
    let stack = rows.clone().into_shape_with_order((COUNT, SIDE, SIDE)).unwrap();
    let samples = samples(stack);
    for centring in [Centring::Mean, Centring::None] {
        // Without centring, the mean stamp is one more component.
        let expected = MODES + usize::from(centring == Centring::None);
        let fit = Svd::new().with_centring(centring).fit(&samples).unwrap();
        let spectrum = fit.spectrum().unwrap();
        assert!(
            fit.rank().abs_diff(expected) <= 1,
            "{what}, {centring}: {} components, noise {:?}, edge {:?}, values {:?}",
            fit.rank(),
            spectrum.noise_sigma,
            spectrum.noise_edge,
            &spectrum.singular_values[..12]
        );
        let elbow = Svd::new()
            .with_centring(centring)
            .with_rank(RankSelection::Elbow)
            .fit(&samples)
            .unwrap();
        assert!(
            elbow.rank() <= expected + 1,
            "{what}, {centring}: elbow at {}",
            elbow.rank()
        );
    }
}

#[test]
fn auto_finds_the_rank_at_any_level_of_even_noise() {
    let noise = noise(1.0, 3);
    let sixth = 1e-3;
    for level in LEVELS {
        let scale = sixth / (level * norm(&noise));
        check(
            &(clean(sixth) + &noise * scale),
            &format!("sixth value {level} x the noise"),
        );
    }
}

#[test]
fn auto_finds_the_rank_where_stars_differ_in_brightness() {
    let sixth = 1e-3;
    for spread in [3.0, 10.0, 30.0] {
        let noise = noise(spread, 4);
        for level in LEVELS {
            let scale = sixth / (level * norm(&noise));
            let what = format!("noise {spread} x uneven, sixth value {level} x the noise");
            check(&(clean(sixth) + &noise * scale), &what);
        }
    }
}

#[test]
fn auto_finds_the_rank_of_stars_scaled_to_unit_flux() {
    let sixth = 1e-3;
    for spread in [1.0, 10.0, 30.0] {
        let noise = noise(spread, 5);
        for level in LEVELS {
            // An error of the measured flux scales the whole stamp, so it adds noise to the sample.
            let scaled = |scale: f64| {
                let noisy = clean(sixth) + &noise * scale;
                let fluxes = noisy.sum_axis(Axis(1));
                noisy / &fluxes.insert_axis(Axis(1))
            };
            let guess = sixth / (level * norm(&noise));
            let edge = norm(&(scaled(guess) - clean(sixth)));
            let scale = guess * sixth / (level * edge);
            let what = format!("unit flux, noise {spread} x uneven, sixth value {level} x the noise");
            check(&scaled(scale), &what);
        }
    }
}

/// 64 stars of signal to noise 100 to 400, and their own noise levels.
#[test]
fn the_noise_of_few_stars_is_found_for_each_of_them() {
    const FEW: usize = 64;
    let pixels = SIDE * SIDE;
    let all = clean(2e-3);
    let exact = all.slice(ndarray::s![..FEW, ..]);
    let sigmas: Array1<f64> = (0..FEW)
        .map(|j| 1e-3 * 4.0_f64.powf((j * 29 % FEW) as f64 / FEW as f64))
        .collect();
    let rows = &exact + &(normal(FEW, pixels, 9) * sigmas.view().insert_axis(Axis(1)));
    let fit = Svd::new().fit(&samples(rows.into_shape_with_order((FEW, SIDE, SIDE)).unwrap()));
    let fit = fit.unwrap();
    assert!(fit.rank() <= 2 * MODES, "{}", fit.rank());
    let noise = fit.noise().expect("noise is found");
    let mut ratios: Vec<f64> = noise
        .iter()
        .zip(&sigmas)
        .map(|(found, sigma)| found / sigma)
        .collect();
    ratios.sort_by(f64::total_cmp);
    // Signal that is not told from noise counts as noise. 200 pixels tell a standard deviation to 5 %.
    assert!(ratios[0] > 0.8 && ratios[FEW - 1] < 1.6, "{ratios:?}");
    assert!((ratios[FEW / 2] - 1.0).abs() < 0.1, "{ratios:?}");
}
