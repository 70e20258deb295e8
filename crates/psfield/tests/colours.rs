//! Scenes in colour: images, stars and galaxies of several spectra through one PSF.

use ndarray::{Array2, Array3};
use psfield::psf_basis::RankSelection;
use psfield::psf_types::{
    Anchor, Image, NoProgress, PointSource, Position, PsfSamples, SamplePositions, SampleStates,
    SersicProfile, SersicSource, StampGrid, StateKind,
};
use psfield::spectra::{Bandpass, Curve};
use psfield::{
    ColourSimulator, Device, FitOptions, Method, Psf, Scene, ScenePixels, SimulateOptions, Simulator,
    open_spectrum,
};

const SHAPE: (usize, usize) = (120, 150);
/// Rounding of images in f64, relative to the peak.
const ROUNDING: f64 = 1e-12;

/// A PSF that widens with the wavelength and over the field, for three spectra.
fn psf(oversampling: f64) -> Psf {
    let wavelengths = [0.5, 0.6, 0.7, 0.8];
    let corners = [(0, 0), (149, 0), (0, 119), (149, 119), (70, 50)].map(|(x, y)| Position::of_pixel(x, y));
    let (mut at, mut states) = (Vec::new(), Vec::new());
    for wavelength in wavelengths {
        at.extend(corners);
        states.extend([wavelength; 5]);
    }
    let size = 12 * oversampling as usize + 1;
    let middle = (size / 2) as f64;
    let stamps = Array3::from_shape_fn((at.len(), size, size), |(j, y, x)| {
        let sigma = (0.6 + 1.2 * states[j] + at[j].x() / 400.0) * oversampling;
        let q = 1.0 + 0.2 * states[j] * at[j].y() / 120.0;
        let square = (y as f64 - middle).powi(2) * q + (x as f64 - middle).powi(2) / q;
        (-square / (2.0 * sigma * sigma)).exp()
    });
    let states = SampleStates::new(StateKind::Wavelength, &states).unwrap();
    let positions = SamplePositions::with_states(at, None, Some(states)).unwrap();
    let grid = StampGrid::new(size, size)
        .unwrap()
        .with_oversampling(oversampling)
        .unwrap();
    let options = FitOptions {
        rank: RankSelection::Full,
        ..FitOptions::default()
    };
    let psf = Psf::new(PsfSamples::new(stamps, positions, grid).unwrap(), options);
    let curve = Curve::new(vec![0.5, 0.55, 0.75, 0.8], vec![0.0, 1.0, 0.7, 0.0]).unwrap();
    let spectra = ["blackbody:3000", "powerlaw:-1@z=0.5", "blackbody:20000"];
    let spectra = spectra.map(|name| open_spectrum(name).unwrap());
    psf.for_spectra(&Bandpass::new(curve), &spectra).unwrap()
}

/// Scenes with an image and stars, with a galaxy and stars, and with an image.
fn scenes(finer: usize) -> Vec<Scene<'static>> {
    let image = |seed: usize| {
        Array2::from_shape_fn((SHAPE.0 * finer, SHAPE.1 * finer), |(y, x)| {
            ((3 * x + 7 * y + seed) % 13) as f64
        })
    };
    let at = |x, y| Position::new(x, y).unwrap();
    let star = |x, y| PointSource::new(at(x, y), 500.0).unwrap();
    let profile = SersicProfile::new(3.0, 1.0, 0.6, 20.0).unwrap();
    let galaxy = SersicSource::new(at(90.0, 40.2), 2000.0, profile).unwrap();
    vec![
        Scene::new(image(0)).unwrap().with_stars(vec![star(30.2, 41.7)]),
        Scene::dark()
            .with_stars(vec![star(100.0, 81.5)])
            .with_galaxies(vec![galaxy]),
        Scene::new(image(5)).unwrap(),
    ]
}

fn largest(image: &Image<f64>) -> f64 {
    image.pixels().iter().fold(0.0, |m: f64, v| m.max(v.abs()))
}

/// The sum of the images of all spectra, each by a simulator of its own.
fn one_by_one(psf: &Psf, scenes: &[Scene<'_>], options: &SimulateOptions) -> Array2<f64> {
    let shape = (SHAPE.0 * options.oversample, SHAPE.1 * options.oversample);
    let mut sum = Array2::zeros(SHAPE);
    for (spectrum, scene) in scenes.iter().enumerate() {
        let of_spectrum = psf.at_state(spectrum as f64).unwrap();
        let simulator: Simulator<f64> = of_spectrum
            .simulator(shape)
            .options(options.clone())
            .build()
            .unwrap();
        sum += &simulator.simulate(scene).unwrap().pixels();
    }
    sum
}

#[test]
fn a_scene_in_colour_is_the_sum_of_its_spectra() {
    let cases = [
        (1.0, SimulateOptions::default()),
        (
            2.0,
            SimulateOptions {
                anchor: Anchor::Output,
                ..SimulateOptions::default()
            },
        ),
        (
            2.0,
            SimulateOptions {
                oversample: 2,
                ..SimulateOptions::default()
            },
        ),
        (
            3.0,
            SimulateOptions {
                scene_pixels: ScenePixels::Integrated,
                ..SimulateOptions::default()
            },
        ),
        (
            1.0,
            SimulateOptions {
                method: Method::Basis,
                ..SimulateOptions::default()
            },
        ),
    ];
    for (oversampling, options) in cases {
        let options = SimulateOptions {
            tolerance: 0.0,
            ..options
        };
        let (psf, scenes) = (psf(oversampling), scenes(options.oversample));
        let expected = one_by_one(&psf, &scenes, &options);
        let shape = (SHAPE.0 * options.oversample, SHAPE.1 * options.oversample);
        let simulator = ColourSimulator::<f64>::new(&psf, shape, &options).unwrap();
        let image = simulator.simulate(&scenes).unwrap();
        let peak = largest(&image);
        for (a, b) in image.pixels().iter().zip(&expected) {
            // The bases of resampled PSFs differ in their rounding.
            assert!((a - b).abs() < 20.0 * ROUNDING * peak, "{options:?}: {a} {b}");
        }
    }
}

#[test]
fn colours_are_within_the_tolerance() {
    let (psf, scenes) = (psf(1.0), scenes(1));
    let options = SimulateOptions {
        tolerance: 3e-3,
        ..SimulateOptions::default()
    };
    let simulator = ColourSimulator::<f64>::new(&psf, SHAPE, &options).unwrap();
    let image = simulator.simulate(&scenes).unwrap();
    let check = simulator
        .spot_check(&scenes, &image, (500, 3), &NoProgress)
        .unwrap();
    assert_eq!(check.passed, Some(true), "{check:?}");
    assert!(check.max_abs > 0.0);
    // The PSF of the first spectrum for all sources does not pass.
    let dark: Vec<Scene<'_>> = scenes
        .iter()
        .map(|scene| {
            Scene::dark()
                .with_stars(scene.stars().to_vec())
                .with_galaxies(scene.galaxies().to_vec())
        })
        .collect();
    let first = psf.at_state(0.0).unwrap();
    let wrong = first.simulator(SHAPE).options(options).build::<f64>().unwrap();
    let mut image = wrong.zeros();
    for scene in &dark {
        wrong.simulate_into(scene, image.view_mut(), &NoProgress).unwrap();
    }
    let check = |image| {
        simulator
            .spot_check(&dark, &image, (500, 3), &NoProgress)
            .unwrap()
            .passed
    };
    assert_eq!(check(simulator.simulate(&dark).unwrap()), Some(true));
    assert_eq!(check(Image::new(image).unwrap()), Some(false));
}

#[test]
fn wrong_numbers_of_scenes_and_gpus_are_refused() {
    let psf = psf(1.0);
    let simulator = ColourSimulator::<f64>::new(&psf, SHAPE, &SimulateOptions::default()).unwrap();
    let error = simulator.simulate(&scenes(1)[..2]).unwrap_err();
    assert!(
        error.to_string().contains("3 spectra, but there are 2 scenes"),
        "{error}"
    );
    let options = SimulateOptions {
        device: Device::Gpu,
        ..SimulateOptions::default()
    };
    let simulator = ColourSimulator::<f32>::new(&psf, SHAPE, &options).unwrap();
    let scenes: Vec<Scene<'_, f32>> = (0..3).map(|_| Scene::new(Array2::ones(SHAPE)).unwrap()).collect();
    let error = simulator.simulate(&scenes).unwrap_err();
    assert_eq!(error.setting(), Some("device"), "{error}");
}
