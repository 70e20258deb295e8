//! Rank selection with noisy samples: modes are kept, noise is not.

mod common;

use common::{normal, orthonormal_rows, samples};
use nalgebra::DMatrix;
use ndarray::{Array1, Array2, Array3, Axis};
use psf_basis::{BasisMethod, Centring, PixelNoise, RankSelection, Svd, WeightedPca};
use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

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
            (fit.rank() - spectrum.smooth).abs_diff(expected) <= 1 && spectrum.smooth <= 1,
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

/// Stars at random positions, with a noise level each, and a stamp whose strength is linear in x.
struct Stars {
    rows: Array2<f64>,
    positions: SamplePositions,
    weak: Array1<f64>,
}

impl Stars {
    /// `strength` is the root of the sum of the squared coefficients of the weak stamp, divided by the
    /// smallest one that the singular values of all samples show.
    fn new(count: usize, strength: f64, noise: &Array2<f64>) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(21);
        let mut along = || rng.random_range(0.0..1000.0);
        let positions: Vec<Position> = (0..count)
            .map(|_| Position::new(along(), along()).unwrap())
            .collect();
        let weak = orthonormal_rows(1, SIDE * SIDE, 22).row(0).to_owned();
        let visible = (count as f64).powf(0.25) * (SIDE as f64).sqrt();
        let mut rows = noise + &(1e3 * mean_stamp()).insert_axis(Axis(0));
        let slope = strength * visible / (count as f64 / 12.0).sqrt();
        for (mut row, at) in rows.outer_iter_mut().zip(&positions) {
            row.scaled_add(slope * (at.x() / 1000.0 - 0.5), &weak);
        }
        let positions = SamplePositions::new(positions, None).unwrap();
        Self {
            rows,
            positions,
            weak,
        }
    }

    fn samples(&self) -> PsfSamples {
        let stack = self
            .rows
            .clone()
            .into_shape_with_order((self.rows.nrows(), SIDE, SIDE));
        let grid = StampGrid::new(SIDE, SIDE).unwrap();
        PsfSamples::new(stack.unwrap(), self.positions.clone(), grid).unwrap()
    }
}

#[test]
fn what_varies_smoothly_is_found_below_the_noise() {
    for (count, spread, strength) in [(60, 1.0, 0.8), (200, 1.0, 0.8), (200, 4.0, 0.8)] {
        let mut noise = normal(count, SIDE * SIDE, 23);
        for (j, mut row) in noise.outer_iter_mut().enumerate() {
            row *= spread_of(spread, j, count);
        }
        let stars = Stars::new(count, strength, &noise);
        let weights = Array3::from_shape_fn((count, SIDE, SIDE), |(j, _, _)| {
            spread_of(spread, j, count).powi(-2)
        });
        let fits = [
            Svd::new().fit(&stars.samples()).unwrap(),
            WeightedPca::new(weights).unwrap().fit(&stars.samples()).unwrap(),
        ];
        for fit in fits {
            let spectrum = fit.spectrum().unwrap();
            let what = format!(
                "{count} stars, spread {spread}: {} {}",
                fit.rank(),
                spectrum.smooth
            );
            // A component of noise may come before it, as one among all samples.
            assert!((1..=2).contains(&fit.rank()) && spectrum.smooth <= 1, "{what}");
            let components = fit.basis().components();
            let agreements = components.outer_iter().map(|found| {
                let found = found.to_shape(SIDE * SIDE).unwrap();
                found.dot(&stars.weak).abs()
            });
            let agreement = agreements.fold(0.0, f64::max);
            // As well as so weak a stamp can be known from these samples.
            assert!(agreement > 0.4, "{what}: {agreement}");
            let median =
                fit.noise().expect("noise is found")[count / 2] / spread_of(spread, count / 2, count);
            assert!((0.8..1.25).contains(&median), "{what}: noise {median}");
        }
    }
}

/// The noise of a sample.
fn spread_of(spread: f64, sample: usize, count: usize) -> f64 {
    spread.powf(((sample * 149) % count) as f64 / count as f64 - 0.5)
}

#[test]
fn noise_alone_is_rarely_taken_for_something_smooth() {
    let mut found = [0; 2];
    for seed in 0..30 {
        let white = normal(150, SIDE * SIDE, 100 + seed);
        // Each pixel with half of its right neighbour.
        let correlated = Array2::from_shape_fn(white.dim(), |(j, u)| {
            white[[j, u]] + 0.5 * white[[j, (u + 1) % (SIDE * SIDE)]]
        });
        for (found, noise) in found.iter_mut().zip([white, correlated]) {
            let svd = Svd::new().with_noise(PixelNoise::Known(1.0));
            let fit = svd.fit(&Stars::new(150, 0.0, &noise).samples()).unwrap();
            *found += fit.spectrum().unwrap().smooth;
        }
    }
    // Each of six degrees may be wrong in 1 % of cases.
    assert!(found[0] <= 4 && found[1] <= 8, "{found:?} in 30");
}
