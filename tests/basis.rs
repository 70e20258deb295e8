//! Bases of sampled telescopes.

use integration_tests::{small_telescope, uniform_samples};
use ndarray::Axis;
use psfield::psf_basis::{BasisMethod, RankSelection, Svd};
use psfield::psf_sample::ShiftAugmentation;
use psfield::psf_types::{NoProgress, PsfSamples, SamplePositions};

#[test]
fn auto_keeps_the_components_that_an_error_of_1e_4_needs() {
    let samples = uniform_samples(&small_telescope(1), 9, 7).into_unit_flux();
    let auto = Svd::new().fit(&samples).unwrap();
    let spectrum = auto.spectrum().unwrap();
    println!(
        "auto keeps {} of {} components, elbow at {}",
        auto.rank(),
        spectrum.numerical_rank,
        spectrum.elbow
    );
    assert!(auto.max_error() <= 1e-4);
    assert!(auto.rank() >= spectrum.elbow && auto.rank() < spectrum.numerical_rank);
    assert!(spectrum.noise_sigma.is_none(), "the telescope makes no noise");
    if auto.rank() > spectrum.elbow {
        let one_less = Svd::new()
            .with_rank(RankSelection::Fixed(auto.rank() - 1))
            .fit(&samples)
            .unwrap();
        assert!(one_less.max_error() > 1e-4);
    }
    let flat = auto
        .basis()
        .components()
        .into_shape_with_order((auto.rank(), 24 * 24))
        .unwrap();
    for ((i, j), product) in flat.dot(&flat.t()).indexed_iter() {
        assert!((product - f64::from(u8::from(i == j))).abs() < 1e-12);
    }
}

#[test]
fn a_basis_trained_on_shifts_represents_shifted_psfs_better() {
    let telescope = small_telescope(1);
    let samples = uniform_samples(&telescope, 5, 5);
    let shifted = |seed| {
        let augmentation = ShiftAugmentation::new(3, 0.5, seed).unwrap();
        augmentation
            .draw(&telescope, samples.positions(), &NoProgress)
            .unwrap()
            .stamps
    };
    let svd = Svd::new().with_rank(RankSelection::Fixed(20));
    let plain = svd.fit(&samples).unwrap();
    let trained = svd.fit_augmented(samples.clone(), shifted(1).view()).unwrap();
    // Both bases are tested with new shifts, one for each sample.
    let unseen = shifted(2).slice(ndarray::s![..;3, .., ..]).to_owned();
    let positions: SamplePositions = samples.positions().clone();
    let unseen = PsfSamples::new(unseen, positions, samples.grid()).unwrap();
    let error = |fit: &psfield::psf_basis::BasisFit| {
        let components = fit.basis().components();
        let mean = fit.basis().mean().unwrap();
        let stamps = unseen.stamps();
        let errors = stamps.outer_iter().map(|stamp| {
            let mut rest = &stamp - &mean;
            for component in components.axis_iter(Axis(0)) {
                let a = (&rest * &component).sum();
                rest.scaled_add(-a, &component);
            }
            (rest.mapv(|v| v * v).sum() / stamp.mapv(|v| v * v).sum()).sqrt()
        });
        errors.collect::<Vec<f64>>().iter().sum::<f64>() / 25.0
    };
    println!(
        "mean error on unseen shifts: {:.2e} with training on shifts, {:.2e} without",
        error(&trained),
        error(&plain)
    );
    assert!(error(&trained) < 0.5 * error(&plain));
}
