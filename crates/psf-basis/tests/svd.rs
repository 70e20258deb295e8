//! Tests of the SVD basis against theory, nalgebra and itself.

mod common;

use common::{normal, orthonormal_rows, samples};
use ndarray::{Array3, Axis};
use psf_basis::{BasisError, BasisFit, BasisMethod, Centring, GivenStamps, PixelNoise, RankSelection, Svd};
use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};

/// The error of a backward stable SVD is a few units of rounding times the largest singular value.
const SINGULAR_VALUE_TOLERANCE: f64 = 1e-10;
/// Householder transformations lose only a few units of rounding.
const ORTHONORMALITY: f64 = 1e-12;

const SIX: [f64; 6] = [5.0, 3.0, 2.0, 1.0, 0.5, 0.02];

/// A matrix of `count` samples on a bright mean stamp, with exactly these singular values once the
/// mean is subtracted.
fn with_singular_values(values: &[f64], count: usize, side: usize, noise: f64) -> PsfSamples {
    let pixels = side * side;
    let stamps = orthonormal_rows(values.len(), pixels, 1);
    let coefficients = orthonormal_rows(values.len(), count, 2);
    let mut stack = normal(count, pixels, 3) * noise;
    for (k, &value) in values.iter().enumerate() {
        for j in 0..count {
            stack
                .row_mut(j)
                .scaled_add(value * coefficients[[k, j]], &stamps.row(k));
        }
    }
    stack += &ndarray::Array1::from_elem(pixels, 2.0).insert_axis(Axis(0));
    samples(stack.into_shape_with_order((count, side, side)).unwrap())
}

fn positive_noise(count: usize, ny: usize, nx: usize) -> PsfSamples {
    let stack = normal(count, ny * nx, 7).mapv(|v| v + 3.0);
    samples(stack.into_shape_with_order((count, ny, nx)).unwrap())
}

#[test]
fn singular_values_agree_with_nalgebra_also_where_they_are_small() {
    for (count, side) in [(60, 20), (30, 5)] {
        // Twelve decades of singular values.
        let values: Vec<f64> = (0..20).map(|k| 10f64.powf(-0.6 * f64::from(k))).collect();
        let samples = with_singular_values(&values, count, side, 0.0);
        for centring in [Centring::Mean, Centring::None] {
            let fit = Svd::new().with_centring(centring).fit(&samples).unwrap();
            let rows = samples
                .stamps()
                .into_shape_with_order((count, side * side))
                .unwrap()
                .to_owned();
            let rows = match centring {
                Centring::Mean => &rows - &rows.mean_axis(Axis(0)).unwrap(),
                _ => rows,
            };
            let matrix = nalgebra::DMatrix::from_row_slice(count, side * side, rows.as_slice().unwrap());
            let mut reference: Vec<f64> = matrix.singular_values().iter().copied().collect();
            reference.sort_by(|a, b| b.total_cmp(a));
            let ours = &fit.spectrum().unwrap().singular_values;
            assert_eq!(ours.len(), reference.len());
            for (a, b) in ours.iter().zip(&reference) {
                assert!(
                    (a - b).abs() <= SINGULAR_VALUE_TOLERANCE * reference[0],
                    "{a} against {b}"
                );
            }
        }
    }
}

/// faer's decomposition of more samples than pixels, in nearly square matrices, could return
/// unordered values.
#[test]
fn repeated_samples_lose_no_component() {
    let side = 17;
    let stamp = |kind: usize, y: usize, x: usize| {
        let (dx, dy, sigma) = (x as f64 - 8.0, y as f64 - 8.0, 2.0 + 0.3 * kind as f64);
        let squeeze = 1.0 + 0.1 * (kind * kind) as f64;
        (-(dx * dx + squeeze * dy * dy) / (2.0 * sigma * sigma)).exp() / (sigma * sigma)
    };
    for (count, distinct) in [(300, 3), (360, 5), (440, 5), (300, 2), (320, 1)] {
        let samples = samples(Array3::from_shape_fn((count, side, side), |(j, y, x)| {
            stamp(j % distinct, y, x)
        }));
        let fit = Svd::new()
            .with_centring(Centring::None)
            .with_rank(RankSelection::Full)
            .fit(&samples)
            .unwrap();
        assert_eq!(fit.rank(), distinct, "{count} samples");
        assert!(
            fit.max_error() < 1e-13,
            "{count}, {distinct}: {}",
            fit.max_error()
        );
        let rows = samples.stamps().to_owned();
        let matrix = nalgebra::DMatrix::from_row_slice(count, side * side, rows.as_slice().unwrap());
        let mut reference: Vec<f64> = matrix.singular_values().iter().copied().collect();
        reference.sort_by(|a, b| b.total_cmp(a));
        for (a, b) in fit.spectrum().unwrap().singular_values.iter().zip(&reference) {
            assert!(
                (a - b).abs() <= SINGULAR_VALUE_TOLERANCE * reference[0],
                "{count}, {distinct}: {a} against {b}"
            );
        }
        let flat = fit
            .basis()
            .components()
            .into_shape_with_order((distinct, side * side))
            .unwrap();
        for ((i, j), product) in flat.dot(&flat.t()).indexed_iter() {
            assert!((product - f64::from(u8::from(i == j))).abs() <= ORTHONORMALITY);
        }
        let centred = Svd::new().with_rank(RankSelection::Full).fit(&samples).unwrap();
        assert!(centred.rank() >= distinct - 1 && centred.max_error() < 1e-12);
    }
}

#[test]
fn the_basis_is_orthonormal_and_full_rank_reproduces_the_samples() {
    for (count, ny, nx) in [(30, 8, 9), (200, 6, 7), (1, 5, 5), (17, 1, 13)] {
        let samples = positive_noise(count, ny, nx);
        let fit = Svd::new()
            .with_centring(Centring::None)
            .with_rank(RankSelection::Full)
            .fit(&samples)
            .unwrap();
        let k = fit.rank();
        assert_eq!(k, count.min(ny * nx));
        let flat = fit
            .basis()
            .components()
            .into_shape_with_order((k, ny * nx))
            .unwrap();
        for ((i, j), product) in flat.dot(&flat.t()).indexed_iter() {
            let expected = f64::from(u8::from(i == j));
            assert!(
                (product - expected).abs() <= ORTHONORMALITY,
                "{i}, {j}: {product}"
            );
        }
        assert!(fit.max_error() < 1e-13, "{}", fit.max_error());
    }
}

#[test]
fn a_noise_free_rank_six_field_has_its_elbow_and_auto_at_six() {
    let samples = with_singular_values(&SIX, 150, 24, 0.0);
    for (rank, expected) in [
        (RankSelection::Elbow, 6),
        (RankSelection::Auto, 6),
        (RankSelection::Full, 6),
    ] {
        let fit = Svd::new().with_rank(rank).fit(&samples).unwrap();
        assert_eq!(fit.rank(), expected, "{rank}");
        let spectrum = fit.spectrum().unwrap();
        assert_eq!(spectrum.elbow, 6);
        for (found, made) in spectrum.singular_values.iter().zip(&SIX) {
            assert!((found - made).abs() < 1e-12, "{found} against {made}");
        }
    }
}

#[test]
fn noise_modes_are_not_kept() {
    // The sixth singular value is twice the noise edge.
    let (count, side) = (150, 24);
    let edge = SIX[5] / 2.0;
    let sigma = edge / ((side as f64) + (count as f64 - 1.0).sqrt());
    let samples = with_singular_values(&SIX, count, side, sigma);
    for noise in [PixelNoise::Estimate, PixelNoise::Known(sigma)] {
        let fit = Svd::new().with_noise(noise).fit(&samples).unwrap();
        assert_eq!(fit.rank(), 6, "{noise:?}");
        let spectrum = fit.spectrum().unwrap();
        assert!(spectrum.elbow <= 6);
        assert_eq!(spectrum.significant, 6);
        assert!(
            (spectrum.noise_sigma.unwrap() / sigma - 1.0).abs() < 0.02,
            "{:?} against {sigma}",
            spectrum.noise_sigma
        );
        assert!((spectrum.noise_edge.unwrap() / edge - 1.0).abs() < 0.02);
    }
    // The noise edge is the reason: if the noise is given as 0, `auto` keeps noise modes.
    let fit = Svd::new()
        .with_noise(PixelNoise::Known(0.0))
        .fit(&samples)
        .unwrap();
    assert!(fit.rank() > 6);
}

#[test]
fn each_selection_does_what_it_says() {
    // A spectrum without a cliff: a smooth decay down to rounding.
    let values: Vec<f64> = (0..119).map(|k| 0.7f64.powi(k)).collect();
    let samples = with_singular_values(&values, 120, 16, 0.0);
    let full = Svd::new().with_rank(RankSelection::Full).fit(&samples).unwrap();

    let energy = Svd::new()
        .with_rank(RankSelection::Energy(0.999))
        .fit(&samples)
        .unwrap();
    let squares: Vec<f64> = values.iter().map(|v| v * v).collect();
    let held = |k: usize| squares[..k].iter().sum::<f64>() / squares.iter().sum::<f64>();
    assert!(held(energy.rank()) >= 0.999 && held(energy.rank() - 1) < 0.999);

    let limit = 1e-3;
    let by_error = Svd::new()
        .with_rank(RankSelection::Error(limit))
        .fit(&samples)
        .unwrap();
    let one_less = Svd::new()
        .with_rank(RankSelection::Fixed(by_error.rank() - 1))
        .fit(&samples)
        .unwrap();
    assert!(by_error.max_error() <= limit && one_less.max_error() > limit);

    let auto = Svd::new().fit(&samples).unwrap();
    assert!(auto.max_error() <= RankSelection::AUTO_ERROR && auto.rank() >= auto.spectrum().unwrap().elbow);
    assert!(auto.rank() < full.rank());

    // A truncation keeps the leading part of the full fit.
    let first = full
        .basis()
        .components()
        .slice_move(ndarray::s![..auto.rank(), .., ..])
        .to_owned();
    assert_eq!(first, auto.basis().components());

    let refused = Svd::new().with_rank(RankSelection::Fixed(10_000)).fit(&samples);
    assert!(matches!(
        refused,
        Err(BasisError::RankTooHigh { asked: 10_000, .. })
    ));
    let refused = Svd::new()
        .with_centring(Centring::None)
        .with_rank(RankSelection::Fixed(0))
        .fit(&samples);
    assert!(matches!(refused, Err(BasisError::RankZero)));
}

#[test]
fn truncation_errors_are_those_of_the_tail() {
    let samples = positive_noise(40, 9, 9);
    let fit = Svd::new()
        .with_noise(PixelNoise::Known(0.0))
        .with_rank(RankSelection::Fixed(10))
        .fit(&samples)
        .unwrap();
    let tail: f64 = fit.spectrum().unwrap().singular_values[10..]
        .iter()
        .map(|s| s * s)
        .sum();
    let total: f64 = (0..40)
        .map(|j| (fit.errors()[j]).powi(2) * samples.stamp(j).iter().map(|v| v * v).sum::<f64>())
        .sum();
    assert!((total / tail - 1.0).abs() < 1e-12);
    assert!(fit.rms_error() <= fit.max_error());
}

#[test]
fn a_constant_field_needs_only_its_mean() {
    let one = samples(Array3::from_shape_fn((5, 4, 4), |(_, y, x)| {
        1.0 + (y * 4 + x) as f64 / 3.0
    }));
    let fit = Svd::new().fit(&one).unwrap();
    assert_eq!(fit.rank(), 0);
    assert!(fit.max_error() < 1e-15);
    let fit = Svd::new().with_centring(Centring::None).fit(&one).unwrap();
    assert_eq!(fit.rank(), 1);
}

#[test]
fn centred_components_of_unit_samples_hold_no_flux() {
    let samples = positive_noise(50, 8, 8).into_unit_flux();
    let fit = Svd::new().with_rank(RankSelection::Full).fit(&samples).unwrap();
    for component in fit.basis().components().outer_iter() {
        assert!(component.sum().abs() < 1e-12, "{}", component.sum());
    }
    assert!((fit.basis().mean().unwrap().sum() - 1.0).abs() < 1e-14);
}

#[test]
fn training_stamps_enter_the_basis_but_not_the_coefficients() {
    let samples = positive_noise(20, 6, 6);
    let extra = positive_noise(15, 6, 6).stamps().mapv(|v| v * v);
    let fit = Svd::new()
        .with_rank(RankSelection::Full)
        .fit_augmented(samples.clone(), extra.view())
        .unwrap();
    assert_eq!(fit.coefficients().values().nrows(), 20);
    assert_eq!(fit.rank(), 34);
    assert!(fit.max_error() < 1e-13);
    let alone = Svd::new().fit(&samples).unwrap();
    assert_eq!(
        Svd::new()
            .fit_augmented(samples.clone(), Array3::zeros((0, 6, 6)).view())
            .unwrap(),
        alone
    );
    let refused = Svd::new().fit_augmented(samples, Array3::zeros((1, 5, 6)).view());
    assert!(matches!(refused, Err(BasisError::TrainingShape { .. })));
}

#[test]
fn given_stamps_serve_as_a_basis() {
    let samples = positive_noise(20, 6, 6);
    let svd = Svd::new()
        .with_rank(RankSelection::Fixed(7))
        .fit(&samples)
        .unwrap();
    let mut stamps = svd.basis().components().to_owned();
    stamps.index_axis_mut(Axis(0), 3).mapv_inplace(|v| v * 5.0);
    let mean = svd.basis().mean().map(|m| m.to_owned());
    let given = GivenStamps::new(stamps.clone(), mean.clone())
        .unwrap()
        .fit(&samples)
        .unwrap();
    for (a, b) in given.errors().iter().zip(svd.errors()) {
        assert!((a - b).abs() < 1e-12);
    }
    // Sums of the stamps span the same space.
    for k in 1..stamps.dim().0 {
        let before = stamps.index_axis(Axis(0), k - 1).to_owned();
        stamps.index_axis_mut(Axis(0), k).scaled_add(0.7, &before);
    }
    let skewed = GivenStamps::new(stamps, mean).unwrap().fit(&samples).unwrap();
    assert_eq!(skewed.rank(), 7);
    for (a, b) in skewed.errors().iter().zip(svd.errors()) {
        assert!((a - b).abs() < 1e-12);
    }
    assert!(matches!(
        GivenStamps::new(Array3::zeros((1, 6, 6)), None),
        Err(BasisError::ZeroStamp { index: 0 })
    ));
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let samples = positive_noise(300, 16, 16);
    let with_threads = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| Svd::new().with_rank(RankSelection::Full).fit(&samples).unwrap())
    };
    let one = with_threads(1);
    for threads in [2, 3, 5] {
        assert_eq!(with_threads(threads), one, "{threads} threads");
    }
}

/// A core that varies, and a faint halo: up to 1e-3 of the flux moves from a narrow one to a wide one.
/// This part's L2 norm is below the limit of `auto`, its flux in circles is not.
fn samples_with_a_halo() -> PsfSamples {
    const SIDE: usize = 65;
    let profile = |x: usize, y: usize, sigma: f64| {
        let square = (x as f64 - 32.0).powi(2) + (y as f64 - 32.0).powi(2);
        (-square / (2.0 * sigma * sigma)).exp() / (std::f64::consts::TAU * sigma * sigma)
    };
    let stamps = Array3::from_shape_fn((9, SIDE, SIDE), |(j, y, x)| {
        let (width, halo) = (0.1 * (j % 3) as f64, 1e-3 * j as f64 / 8.0);
        let core = (1.0 - width) * profile(x, y, 1.0) + width * profile(x, y, 2.0);
        core + halo * (profile(x, y, 16.0) - profile(x, y, 8.0))
    });
    let positions = (0..9).map(|j| Position::of_pixel(j, 0)).collect();
    let positions = SamplePositions::new(positions, None).unwrap();
    let samples = PsfSamples::new(stamps, positions, StampGrid::new(SIDE, SIDE).unwrap()).unwrap();
    samples.into_unit_flux()
}

#[test]
fn auto_keeps_the_flux_in_circles_where_the_l2_error_does_not() {
    let samples = samples_with_a_halo();
    let fit = |rank| Svd::new().with_rank(rank).fit(&samples).unwrap();
    let largest = |fit: &BasisFit| fit.circle_errors().iter().copied().fold(0.0, f64::max);
    let one = fit(RankSelection::Fixed(1));
    assert!(one.max_error() < RankSelection::AUTO_ERROR, "{}", one.max_error());
    // From the definition: the residual in circles about pixel (32, 32).
    let (basis, j) = (one.basis(), 8);
    let psf = &basis.mean().unwrap()
        + &(&basis.components().index_axis(Axis(0), 0) * one.coefficients().values()[[j, 0]]);
    let residual = &samples.stamp(j) - &psf;
    let in_circle = |number: u32| {
        let radius = f64::from(number) / 2.0;
        let inside = residual
            .indexed_iter()
            .filter(|((y, x), _)| (*x as f64 - 32.0).hypot(*y as f64 - 32.0) <= radius);
        inside.map(|(_, v)| v).sum::<f64>().abs()
    };
    let expected = (0..92).map(in_circle).fold(0.0, f64::max);
    assert!(expected > 1.2 * RankSelection::AUTO_ERROR, "{expected}");
    assert!(
        (one.circle_errors()[j] - expected).abs() < 1e-12,
        "{:?}",
        one.circle_errors()
    );
    let auto = fit(RankSelection::Auto);
    assert!(
        auto.rank() == 2 && largest(&auto) < RankSelection::AUTO_ERROR,
        "{} {}",
        auto.rank(),
        largest(&auto)
    );
}
