//! Sampling methods, compared by the errors of the models made from their samples.

use std::sync::Arc;

use integration_tests::{CornerRise, fitted, model_errors, uniform_samples};
use psfield::FitOptions;
use psfield::psf_basis::RankSelection;
use psfield::psf_sample::{
    AdaptiveSampling, DifferenceMeasure, InterpolationError, SamplingMethod, SamplingOutcome,
};
use psfield::psf_types::{Interpolation, NoProgress, Normalisation, PsfSamples};

/// The largest error, on a dense grid of positions, of a model that interpolates by Delaunay
/// triangles.
fn largest_error(samples: PsfSamples) -> f64 {
    let options = FitOptions {
        rank: RankSelection::Full,
        interpolation: Interpolation::Delaunay,
        normalisation: Normalisation::Keep,
        ..FitOptions::default()
    };
    model_errors(&fitted(samples, &options), &CornerRise, 83).max()
}

#[test]
fn a_field_that_varies_in_a_corner_needs_at_most_half_the_samples_of_a_uniform_grid() {
    let criterion = InterpolationError::new(0.01, DifferenceMeasure::L2).unwrap();
    let sampling = AdaptiveSampling::new(Arc::new(criterion))
        .sample(&CornerRise, &NoProgress)
        .unwrap();
    assert_eq!(sampling.report.outcome, SamplingOutcome::Met);
    let adaptive = sampling.samples.len();
    let error = largest_error(sampling.samples);
    // The smallest uniform grid whose error is no larger, found by counting up.
    let uniform = (2..64)
        .find(|&n| largest_error(uniform_samples(&CornerRise, n, n)) <= error)
        .map(|n| n * n)
        .expect("a fine enough grid");
    println!(
        "largest interpolation error {error:.2e}: {adaptive} samples against {uniform} on a uniform grid"
    );
    assert!(error < 0.015, "{error}");
    assert!(2 * adaptive <= uniform, "{adaptive} against {uniform}");
}
