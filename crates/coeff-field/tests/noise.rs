//! Kriging of samples with noise: errors against the truth, and the errors that it expects.

mod common;

use coeff_field::{FieldInterpolation, Kriging, NoisyKrigingFit, interpolation};
use common::{rng, scattered};
use ndarray::Array2;
use psf_types::{CoefficientField, OutsidePolicy, Position, SampleCoefficients, SamplePositions};
use rand::RngExt;

const COMPONENTS: usize = 8;
/// The number of places at which errors are measured.
const PLACES: usize = 300;

/// A smooth field whose components have amplitudes 1, 1/3, 1/9 ...
fn truth(seed: u64) -> impl Fn(Position) -> Vec<f64> {
    let mut random = rng(seed);
    let mut number = move || random.random_range(-1.0..1.0);
    let waves: Vec<[f64; 5]> = (0..COMPONENTS * 6)
        .map(|_| {
            [
                number(),
                0.04 * number(),
                0.04 * number(),
                3.0 * number(),
                number(),
            ]
        })
        .collect();
    move |p: Position| {
        let of = |k: usize| {
            let sum: f64 = waves[6 * k..6 * k + 6]
                .iter()
                .map(|w| w[0] * (w[1] * p.x() + w[2] * p.y() + w[3]).sin())
                .sum();
            sum / 3.0_f64.powi(k as i32)
        };
        (0..COMPONENTS).map(of).collect()
    }
}

/// A number from the normal distribution.
fn normal(random: &mut impl RngExt) -> f64 {
    let (u, v): (f64, f64) = (random.random_range(1e-12..1.0), random.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// Samples with noise, and the noise of each.
fn noisy(count: usize, noise: f64, seed: u64) -> (SampleCoefficients, Vec<f64>) {
    let (field, mut random) = (truth(seed), rng(seed + 100));
    let positions = scattered(count, seed, 0.0, 100.0);
    let sigmas: Vec<f64> = (0..count)
        .map(|_| noise * (0.5 * normal(&mut random)).exp())
        .collect();
    let mut values = Array2::zeros((count, COMPONENTS));
    for ((mut row, &position), sigma) in values.outer_iter_mut().zip(&positions).zip(&sigmas) {
        for (v, exact) in row.iter_mut().zip(field(position)) {
            *v = exact + sigma * normal(&mut random);
        }
    }
    let positions = SamplePositions::new(positions, None).unwrap();
    (SampleCoefficients::new(values, positions).unwrap(), sigmas)
}

fn length(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// The r.m.s. error of a field inside the samples.
fn error(field: &dyn CoefficientField, seed: u64) -> f64 {
    let (exact, mut a) = (truth(seed), vec![0.0; COMPONENTS]);
    let places = scattered(PLACES, seed + 7, 10.0, 80.0);
    let squares = places.iter().map(|&p| {
        field.evaluate_into(p, &mut a).unwrap();
        length(&a, &exact(p)).powi(2)
    });
    (squares.sum::<f64>() / PLACES as f64).sqrt()
}

/// The mean square over seeds of errors against the truth. All numbers come from fixed seeds.
#[test]
fn kriging_with_noise_is_as_good_as_any_method_and_expects_its_errors() {
    const SEEDS: u64 = 3;
    const OTHERS: [&str; 6] = [
        "kriging",
        "polynomial=2",
        "polynomial=4",
        "polynomial=6",
        "natural-neighbour",
        "idw",
    ];
    for (count, noise) in [(60, 0.3), (60, 0.03), (200, 0.1), (200, 0.01)] {
        let (mut own, mut pulls, mut others) = (0.0, 0.0, [0.0; OTHERS.len()]);
        for seed in 0..SEEDS {
            let (samples, sigmas) = noisy(count, noise, seed);
            let fit = NoisyKrigingFit::new(&samples, &sigmas).unwrap();
            // The field is kriging through the samples without noise.
            let field = Kriging::new(fit.parameters()).interpolate(fit.samples(), OutsidePolicy::Nearest);
            let field = field.unwrap();
            own += error(field.as_ref(), seed).powi(2);
            let places = scattered(PLACES, seed + 7, 10.0, 80.0);
            let expected = fit.expected_errors(&places).unwrap();
            let (exact, mut a) = (truth(seed), vec![0.0; COMPONENTS]);
            for (&p, expected) in places.iter().zip(&expected) {
                field.evaluate_into(p, &mut a).unwrap();
                pulls += (length(&a, &exact(p)) / expected).powi(2) / (PLACES as u64 * SEEDS) as f64;
            }
            for (name, sum) in OTHERS.iter().zip(&mut others) {
                let method = interpolation(name.parse().unwrap()).unwrap();
                let field = method.interpolate(&samples, OutsidePolicy::Nearest).unwrap();
                *sum += error(field.as_ref(), seed).powi(2);
            }
        }
        let pulls = f64::sqrt(pulls);
        assert!((0.8..=1.3).contains(&pulls), "{count} {noise}: {pulls}");
        for (name, other) in OTHERS.iter().zip(others) {
            assert!(
                own <= other,
                "{count} samples, noise {noise}: {own} against {other} of {name}"
            );
        }
    }
}

#[test]
fn a_sample_with_much_noise_counts_little() {
    let (samples, mut sigmas) = noisy(60, 0.01, 5);
    let good = NoisyKrigingFit::new(&samples, &sigmas).unwrap();
    let mut values = samples.values().to_owned();
    values[(7, 0)] += 3.0;
    let spoilt = SampleCoefficients::new(values, samples.positions().clone()).unwrap();
    sigmas[7] = 3.0;
    let found = NoisyKrigingFit::new(&spoilt, &sigmas).unwrap();
    let moved = (found.samples().values()[(7, 0)] - good.samples().values()[(7, 0)]).abs();
    assert!(moved < 0.1, "{moved}");
    // Predictions are made without the sample.
    let left_out = found.leave_one_out(&spoilt).unwrap();
    assert_eq!(left_out.outcomes().len(), 60);
    assert!(left_out.worst().unwrap().0 == 7);
    // Bad noise is refused.
    sigmas[3] = 0.0;
    let error = NoisyKrigingFit::new(&spoilt, &sigmas).unwrap_err().to_string();
    assert!(error.contains("noise of a sample must be above 0"), "{error}");
    assert!(NoisyKrigingFit::new(&spoilt, &sigmas[1..]).is_err());
}
