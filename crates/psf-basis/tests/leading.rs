//! Large problems: the leading components, computed without the rest, are those of the whole
//! decomposition, which rank `full` computes.

mod common;

use common::{normal, orthonormal_rows, samples};
use ndarray::{Array2, Array3, Axis, s};
use psf_basis::{BasisFit, BasisMethod, Centring, PixelNoise, RankSelection, Svd};
use psf_types::PsfSamples;

/// Side of the stamps, and number of samples. Both sides of the matrix are just large enough for
/// the search of leading components.
const SIDE: usize = 32;
const COUNT: usize = 1050;

/// Largest difference of singular values and of coefficients, relative to the largest singular
/// value.
const EQUAL: f64 = 1e-10;
/// Largest relative difference of singular values above 1e-4 of the largest. Rounding relative to
/// the largest is 1e-15.
const EACH_EQUAL: f64 = 1e-10;

/// Elliptical PSFs whose width, shape and centre vary over the field, of unit flux.
fn psfs(count: usize, side: usize) -> Array3<f64> {
    let mut stamps = Array3::from_shape_fn((count, side, side), |(j, y, x)| {
        let u = (j as f64 * 0.618_034).fract() - 0.5;
        let v = (j as f64 + 0.5) / count as f64 - 0.5;
        let half = side as f64 / 2.0;
        let (dx, dy) = (x as f64 - half - 0.3 * u, y as f64 - half - 0.2 * u * v);
        let (e1, e2) = (0.1 * u + 0.05 * v * v, 0.1 * v);
        let width = 2.0 + 0.3 * u * u + 0.2 * v;
        let r2 = (1.0 + e1) * dx * dx + (1.0 - e1) * dy * dy + 2.0 * e2 * dx * dy;
        (1.0 + r2 / (width * width)).powf(-2.5)
    });
    for mut stamp in stamps.outer_iter_mut() {
        let flux = stamp.sum();
        stamp /= flux;
    }
    stamps
}

/// White noise for stamps, of a level that differs by up to this factor between samples.
fn noise(count: usize, side: usize, sigma: f64, spread: f64) -> Array3<f64> {
    let mut noise = normal(count, side * side, 5) * sigma;
    for (j, mut row) in noise.outer_iter_mut().enumerate() {
        row *= spread.powf(((j * 149) % count) as f64 / count as f64);
    }
    noise.into_shape_with_order((count, side, side)).unwrap()
}

/// The largest truncation error over the samples for each rank, from a fit of full rank.
fn max_errors(samples: &PsfSamples, full: &BasisFit) -> Vec<f64> {
    let a = full.coefficients().values();
    let norms = samples
        .stamps()
        .map_axis(Axis(2), |row| row.dot(&row))
        .sum_axis(Axis(1));
    let mut rest: Vec<f64> = vec![0.0; samples.len()];
    let mut errors = vec![0.0];
    for k in (0..full.rank()).rev() {
        let mut largest = 0.0f64;
        for (j, rest) in rest.iter_mut().enumerate() {
            *rest += a[[j, k]].powi(2);
            largest = largest.max((*rest / norms[j]).sqrt());
        }
        errors.push(largest);
    }
    errors.reverse();
    errors
}

/// The part of the samples that the first components hold, `[sample, pixel]`.
fn held_part(fit: &BasisFit, rank: usize) -> Array2<f64> {
    let components = fit.basis().components();
    let components = components.slice_move(s![..rank, .., ..]);
    let pixels = components.len() / rank.max(1);
    let rows = components.to_shape((rank, pixels)).unwrap();
    fit.coefficients().values().slice(s![.., ..rank]).dot(&rows)
}

/// Compares fits of several ranks with the fit of full rank. Returns the number of singular values
/// that the fit of rank `auto` computed.
fn compare(what: &str, stamps: &Array3<f64>, method: Svd) -> usize {
    let samples = samples(stamps.clone());
    let full = method.with_rank(RankSelection::Full).fit(&samples).unwrap();
    let all = full.spectrum().unwrap();
    let errors = max_errors(&samples, &full);
    let for_error = |limit: f64| errors.iter().position(|&e| e <= limit).unwrap();
    let energy: f64 = all.singular_values.iter().map(|s| s * s).sum();
    let held = |k: usize| all.singular_values[..k].iter().map(|s| s * s).sum::<f64>();
    let for_energy = (0..samples.len()).find(|&k| held(k) >= 0.9999 * energy).unwrap();
    let auto = all
        .elbow
        .max(for_error(RankSelection::AUTO_ERROR))
        .min(all.significant);
    let fixed = full.rank().min(7);
    let mut computed = 0;
    for (rank, expected) in [
        (RankSelection::Elbow, all.elbow),
        (RankSelection::Error(1e-2), for_error(1e-2)),
        (RankSelection::Energy(0.9999), for_energy),
        (RankSelection::Fixed(fixed), fixed),
        (RankSelection::Auto, auto),
    ] {
        let fit = method.with_rank(rank).fit(&samples).unwrap();
        let spectrum = fit.spectrum().unwrap();
        assert_eq!(fit.rank() - spectrum.smooth, expected, "{what}, {rank}");
        computed = spectrum.singular_values.len();
        assert_eq!(spectrum.elbow, all.elbow, "{what}, {rank}: elbow");
        let top = all.singular_values[0];
        let pairs = spectrum.singular_values.iter().zip(&all.singular_values);
        for (k, (a, b)) in pairs.enumerate() {
            assert!(
                (a - b).abs() <= EQUAL * top,
                "{what}, {rank}: value {k} is {a}, not {b}"
            );
            if *b > 1e-4 * top {
                assert!(
                    (a / b - 1.0).abs() <= EACH_EQUAL,
                    "{what}, {rank}: value {k} is {a}, not {b}"
                );
            }
        }
        let weights = spectrum.cumulative_weights.iter().zip(&all.cumulative_weights);
        for (a, b) in weights {
            assert!((a - b).abs() < 0.02, "{what}, {rank}: weight {a}, not {b}");
        }
        // Close singular values leave the directions of their components open. The part of the
        // samples that the components hold is unique if none of the values left out is close.
        let kept = expected;
        if all
            .singular_values
            .get(kept)
            .is_some_and(|v| *v > 0.999 * all.singular_values[kept - 1])
        {
            continue;
        }
        let difference = held_part(&fit, kept) - held_part(&full, kept);
        let largest = difference.iter().fold(0.0f64, |m, d| m.max(d.abs()));
        assert!(
            largest <= EQUAL * top,
            "{what}, {rank}: samples differ by {largest:e}"
        );
        assert_eq!(
            spectrum.noise_sigma.is_some(),
            all.noise_sigma.is_some(),
            "{what}, {rank}"
        );
    }
    computed
}

#[test]
fn psfs_without_noise() {
    let stamps = psfs(COUNT, SIDE);
    for centring in [Centring::Mean, Centring::None] {
        let computed = compare("exact", &stamps, Svd::new().with_centring(centring));
        assert!(computed < SIDE * SIDE, "{computed} components were computed");
    }
    // Pixels in single precision, and stamps with more pixels than there are samples.
    let rounded = psfs(COUNT, SIDE + 3).mapv(|v| f64::from(v as f32));
    let computed = compare("single precision", &rounded, Svd::new());
    assert!(computed < COUNT, "{computed} components were computed");
}

#[test]
fn psfs_with_noise() {
    for (sigma, spread) in [(1e-4, 1.0), (1e-6, 1.0), (1e-4, 10.0)] {
        let stamps = psfs(COUNT, SIDE) + noise(COUNT, SIDE, sigma, spread);
        let computed = compare(&format!("noise {sigma}, {spread} x uneven"), &stamps, Svd::new());
        assert!(computed < 20, "{computed} components were computed");
    }
    let stamps = psfs(COUNT, SIDE) + noise(COUNT, SIDE, 1e-5, 1.0);
    for known in [1e-5, 3e-5, 0.0] {
        compare(
            &format!("known noise {known}"),
            &stamps,
            Svd::new().with_noise(PixelNoise::Known(known)),
        );
    }
}

#[test]
fn few_modes_and_repeated_samples() {
    let (modes, fields) = (orthonormal_rows(9, SIDE * SIDE, 1), orthonormal_rows(9, COUNT, 2));
    for (what, noise) in [("exact", 0.0), ("noisy", 1e-7)] {
        let mut rows: Array2<f64> = normal(COUNT, SIDE * SIDE, 3) * noise + 1.0;
        for (k, value) in [3.0, 2.9, 2.8, 1.0, 0.4, 0.1, 0.01, 1e-3, 1e-3]
            .into_iter()
            .enumerate()
        {
            for j in 0..COUNT {
                rows.row_mut(j).scaled_add(value * fields[[k, j]], &modes.row(k));
            }
        }
        let stamps = rows.into_shape_with_order((COUNT, SIDE, SIDE)).unwrap();
        compare(&format!("nine modes, {what}"), &stamps, Svd::new());
    }
    for distinct in [1, 2, 40] {
        let few = psfs(distinct, SIDE);
        let index: Vec<usize> = (0..COUNT).map(|j| j % distinct).collect();
        let stamps = few.select(Axis(0), &index);
        compare(
            &format!("{distinct} distinct samples"),
            &stamps,
            Svd::new().with_centring(Centring::None),
        );
    }
}

#[test]
fn equal_samples_need_no_component_beyond_the_rounding_of_their_mean() {
    let stamps = psfs(1, SIDE).select(Axis(0), &[0; COUNT]);
    let fit = Svd::new().fit(&samples(stamps)).unwrap();
    assert!(fit.rank() <= 1);
    assert!(fit.max_error() < 1e-13);
}

#[test]
fn components_just_above_strong_noise() {
    // Convergence is slow just above the edge of the noise, so the space must grow.
    let (count, side) = (2100, 46);
    let stamps = psfs(count, side) + noise(count, side, 1e-3, 1.0);
    let computed = compare("strong noise", &stamps, Svd::new());
    assert!(computed < 100, "{computed} components were computed");
}

#[test]
fn training_stamps_and_threads() {
    let stamps = psfs(COUNT, SIDE);
    let (some, others) = (stamps.slice(s![..200, .., ..]), stamps.slice(s![200.., .., ..]));
    let of_rank = |rank| {
        let svd = Svd::new().with_rank(rank);
        svd.fit_augmented(samples(some.to_owned()), others).unwrap()
    };
    let (auto, full) = (of_rank(RankSelection::Auto), of_rank(RankSelection::Full));
    let spectra = (auto.spectrum().unwrap(), full.spectrum().unwrap());
    assert!(spectra.0.singular_values.len() < spectra.1.singular_values.len());
    assert_eq!(spectra.0.elbow, spectra.1.elbow);
    assert_eq!(auto.coefficients().values().nrows(), 200);
    let kept = auto.rank();
    assert!(auto.max_error() <= RankSelection::AUTO_ERROR);
    let difference = held_part(&auto, kept) - held_part(&full, kept);
    assert!(
        difference
            .iter()
            .all(|d| d.abs() <= EQUAL * spectra.1.singular_values[0])
    );

    let with_threads = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build().unwrap().install(|| of_rank(RankSelection::Auto))
    };
    for threads in [1, 2, 3] {
        assert_eq!(with_threads(threads), auto, "{threads} threads");
    }
}
