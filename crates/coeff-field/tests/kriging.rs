//! Kriging: closed forms against refits, radial splines, noise, and the choice of parameters.

mod common;

use coeff_field::{FieldInterpolation, Kriging, LeftOut, choose};
use common::{Extent, at, field, grid, samples_of, scattered, value};
use ndarray::Array2;
use psf_types::{
    Interpolation, KrigingKernel, KrigingParameters, OutsidePolicy, Position, SampleCoefficients,
    SamplePositions,
};
use rand::RngExt;

/// Rounding of solutions, for condition numbers of up to 1e14 and values of order 1.
const ROUNDING: f64 = 1e-6;

const KERNELS: [(KrigingKernel, usize); 6] = [
    (KrigingKernel::Gaussian, 0),
    (KrigingKernel::Matern52, 1),
    (KrigingKernel::Matern32, 2),
    (KrigingKernel::ThinPlate, 1),
    (KrigingKernel::Cubic, 1),
    (KrigingKernel::Quintic, 2),
];

fn with(kernel: KrigingKernel, length: f64, trend: usize, nugget: f64) -> Kriging {
    Kriging::new(KrigingParameters::new(kernel, [length, 1.2 * length], trend, nugget).unwrap())
}

fn waves(p: Position, k: usize) -> f64 {
    (0.05 * p.x() + k as f64).sin() * (0.04 * p.y()).cos()
}

#[test]
fn samples_are_met_and_trends_are_reproduced() {
    let positions = scattered(60, 3, 0.0, 100.0);
    for (kernel, trend) in KERNELS {
        let method = with(kernel, 0.7, trend, 0.0);
        let smooth = field(&samples_of(&positions, 2, waves), &method, OutsidePolicy::Nearest);
        let polynomial = |p: Position, _: usize| match trend {
            0 => 2.0,
            1 => 2.0 + 0.1 * p.x() - 0.2 * p.y(),
            _ => 2.0 + 0.01 * p.x() * p.y() - 0.02 * p.y() * p.y(),
        };
        let of_trend = field(
            &samples_of(&positions, 1, polynomial),
            &method,
            OutsidePolicy::Extend,
        );
        for &p in &positions {
            assert!((value(&smooth, p) - waves(p, 0)).abs() < ROUNDING, "{kernel}");
        }
        for p in Extent::of(&positions).probes(50, 8, 0.3) {
            let error = (value(&of_trend, p) - polynomial(p, 0)).abs();
            assert!(
                error < 1e-8 * polynomial(p, 0).abs().max(1.0),
                "{kernel} {error:e}"
            );
        }
    }
}

/// The closed form equals a prediction by the field of the other samples. Their bounding box differs,
/// so that the lengths are adapted.
#[test]
fn left_out_samples_are_predicted_as_by_a_refit() {
    let positions = scattered(50, 4, 0.0, 100.0);
    let samples = samples_of(&positions, 3, waves);
    let half = |positions: &[Position]| {
        let extent = Extent::of(positions);
        0.5 * extent.size()
    };
    for (kernel, trend) in KERNELS {
        for nugget in [0.0, 1e-3] {
            let method = with(kernel, 0.8, trend, nugget);
            for outside in [OutsidePolicy::Nearest, OutsidePolicy::Extend] {
                let found = method.leave_one_out(&samples, outside).unwrap();
                for left_out in (0..50).step_by(3) {
                    let others: Vec<usize> = (0..50).filter(|&i| i != left_out).collect();
                    let at_others: Vec<Position> = others.iter().map(|&i| positions[i]).collect();
                    let scale = half(&positions) / half(&at_others);
                    let of_others = samples_of(&at_others, 3, waves);
                    // A nugget is relative to the variance of all samples, which differs a little.
                    let refit = Kriging::new(
                        KrigingParameters::new(kernel, [0.8 * scale, 0.96 * scale], trend, nugget).unwrap(),
                    );
                    let field = field(&of_others, &refit, outside);
                    let mut predicted = vec![0.0; 3];
                    field.evaluate_into(positions[left_out], &mut predicted).unwrap();
                    let error: f64 = predicted
                        .iter()
                        .zip(samples.values().row(left_out))
                        .map(|(a, b)| (a - b).powi(2))
                        .sum::<f64>()
                        .sqrt();
                    let (LeftOut::Predicted { error: closed } | LeftOut::Extrapolated { error: closed }) =
                        found.outcomes()[left_out]
                    else {
                        panic!("{kernel} {left_out}");
                    };
                    let tolerance = if nugget == 0.0 { 1e-4 } else { 0.1 };
                    assert!(
                        (closed - error).abs() < tolerance * error + 1e-7,
                        "{kernel} {nugget} {outside} {left_out}: {closed:e} {error:e}"
                    );
                }
            }
        }
    }
}

#[test]
fn smooth_fields_get_small_errors_and_equal_states_count_together() {
    let positions = scattered(80, 5, 0.0, 100.0);
    let samples = samples_of(&positions, 3, waves);
    let chosen = choose(Interpolation::Auto, &samples, None, OutsidePolicy::Nearest).unwrap();
    let Interpolation::Kriging(Some(parameters)) = chosen.interpolation else {
        panic!("{chosen:?}");
    };
    assert_eq!(parameters.kernel(), KrigingKernel::Gaussian);
    assert!(chosen.reason.contains("natural-neighbour"), "{}", chosen.reason);
    let field = field(&samples, &Kriging::new(parameters), OutsidePolicy::Nearest);
    for p in Extent::of(&positions).probes(200, 9, -0.1) {
        assert!((value(&field, p) - waves(p, 0)).abs() < 1e-4);
    }
    // The text holds all that is needed.
    let text = chosen.interpolation.to_string();
    assert_eq!(text.parse::<Interpolation>().unwrap(), chosen.interpolation);
}

#[test]
fn steps_are_left_to_the_local_method() {
    let step = |p: Position, _: usize| if p.x() + 0.3 * p.y() > 60.0 { 1.0 } else { 0.2 };
    let samples = samples_of(&scattered(150, 6, 0.0, 100.0), 1, step);
    let chosen = choose(Interpolation::Auto, &samples, None, OutsidePolicy::Nearest).unwrap();
    assert!(!chosen.reason.is_empty());
    let few = samples_of(&grid(3, 3, 10.0, 0.0, 0.0), 1, step);
    let chosen = choose(Interpolation::Auto, &few, None, OutsidePolicy::Nearest).unwrap();
    assert_eq!(chosen.interpolation, Interpolation::Bicubic);
}

/// The expected errors are those of noise and of the spacing: pulls are of order 1.
#[test]
fn expected_errors_are_those_that_occur() {
    let mut rng = common::rng(12);
    for (noise, count) in [(0.0, 40), (0.05, 150)] {
        let positions = scattered(count, 7, 0.0, 100.0);
        let mut deviate = || noise * (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
        let clean = samples_of(&positions, 2, waves);
        let values = clean.values().mapv(|v| v + deviate());
        let samples = SampleCoefficients::new(values, clean.positions().clone()).unwrap();
        let fit = Kriging::default().fit(&samples, OutsidePolicy::Extend).unwrap();
        let (mut sum, mut count) = (0.0, 0.0);
        let probes = Extent::of(&positions).probes(200, 13, 0.0);
        let expected = fit.expected_errors(&probes).unwrap();
        for (&p, expected) in probes.iter().zip(expected) {
            let mut found = [0.0; 2];
            fit.field().evaluate_into(p, &mut found).unwrap();
            let error = (0..2)
                .map(|k| (found[k] - waves(p, k)).powi(2))
                .sum::<f64>()
                .sqrt();
            sum += (error / expected).powi(2);
            count += 1.0;
        }
        let pull = f64::sqrt(sum / count);
        assert!((0.4..1.6).contains(&pull), "{noise}: {pull}");
    }
}

/// Each least known candidate is the one with the largest expected error when those before it are samples,
/// too. Units of the expected errors depend on the samples' values, so ratios are compared.
#[test]
fn least_known_positions_are_those_of_refits() {
    let positions = scattered(30, 5, 0.0, 100.0);
    let candidates = Extent::of(&positions).probes(60, 9, 0.0);
    let ones = vec![1.0; candidates.len()];
    for (kernel, trend) in KERNELS {
        let method = with(kernel, 0.3, trend, 0.0);
        let fit_of = |positions: &[Position]| {
            let samples = samples_of(positions, 2, waves);
            method.fit(&samples, OutsidePolicy::Extend).unwrap()
        };
        let fit = fit_of(&positions);
        let chosen = fit.least_known(&candidates, &ones, 4).unwrap();
        let mut known = positions.clone();
        for (number, &(next, _)) in chosen.iter().enumerate() {
            let expected = fit_of(&known).expected_errors(&candidates).unwrap();
            let largest = expected.iter().copied().fold(0.0, f64::max);
            assert!(expected[next] >= (1.0 - ROUNDING) * largest, "{kernel} {number}");
            known.push(candidates[next]);
        }
        let first = fit.expected_errors(&candidates[chosen[0].0..][..1]).unwrap()[0];
        assert!((chosen[0].1 / first - 1.0).abs() < ROUNDING, "{kernel}");
        // The errors that are left at two other candidates after the first, which is sure to be taken.
        let (a, b) = (candidates[chosen[1].0], candidates[chosen[2].0]);
        let left = |other| {
            let both = [candidates[chosen[0].0], other];
            fit.least_known(&both, &[1e9, 1.0], 2).unwrap()[1].1
        };
        let refit = fit_of(&[&positions[..], &[candidates[chosen[0].0]]].concat());
        let refit = refit.expected_errors(&[a, b]).unwrap();
        assert!(
            (left(a) / left(b) * refit[1] / refit[0] - 1.0).abs() < ROUNDING,
            "{kernel}"
        );
        // Weights select, and no candidate is taken twice.
        let mut weights = vec![0.0; candidates.len()];
        weights[7] = 1.0;
        assert_eq!(fit.least_known(&candidates, &weights, 1).unwrap()[0].0, 7);
        let mut all: Vec<usize> = fit
            .least_known(&candidates, &ones, 99)
            .unwrap()
            .iter()
            .map(|c| c.0)
            .collect();
        all.sort_unstable();
        assert!(all.into_iter().eq(0..candidates.len()));
    }
}

#[test]
fn samples_that_do_not_suit_are_refused() {
    let two = samples_of(&[at(0.0, 0.0), at(5.0, 1.0)], 1, waves);
    let method = with(KrigingKernel::Gaussian, 1.0, 1, 0.0);
    let error = method.interpolate(&two, OutsidePolicy::Nearest).unwrap_err();
    assert!(error.to_string().contains("needs more than 3 samples"), "{error}");
    // On a line, a trend of degree 1 is not determined.
    let line: Vec<Position> = (0..9).map(|i| at(f64::from(i), 2.0 * f64::from(i))).collect();
    assert!(
        method
            .interpolate(&samples_of(&line, 1, waves), OutsidePolicy::Nearest)
            .is_err()
    );
    // A constant needs nothing.
    let constant = samples_of(&scattered(20, 1, 0.0, 10.0), 1, |_, _| 3.0);
    let field = field(&constant, &Kriging::default(), OutsidePolicy::Error);
    assert!((value(&field, at(5.0, 5.0)) - 3.0).abs() < 1e-12);
    assert!(field.evaluate_into(at(50.0, 5.0), &mut [0.0]).is_err());
    // No component at all.
    let positions = SamplePositions::new(scattered(20, 1, 0.0, 10.0), None).unwrap();
    let empty = SampleCoefficients::new(Array2::zeros((20, 0)), positions).unwrap();
    let chosen = choose(Interpolation::Auto, &empty, None, OutsidePolicy::Nearest).unwrap();
    common::field(
        &empty,
        coeff_field::interpolation(chosen.interpolation).unwrap().as_ref(),
        OutsidePolicy::Nearest,
    );
}
