//! The spot check passes correct images for every seed, and fails images in which one source is wrong.

use std::f64::consts::TAU;

use conv_core::ConvReal;
use ndarray::{Array2, Array3};
use psf_types::{
    Image, NoProgress, PointSource, Position, PsfSamples, SamplePositions, SersicProfile, SersicSource,
    StampGrid,
};
use psfield::{Device, Psf, Scene, Simulator};

const SIDE: usize = 160;
/// Pixels that each check compares.
const PIXELS: usize = 100;
const SEEDS: u64 = 3;

/// Moffat PSFs whose width varies over the frame.
fn psf() -> Psf {
    let (side, last) = (33, (SIDE - 1) as f64);
    let corners = [(0.0, 0.0), (last, 0.0), (0.0, last), (last, last), (80.0, 70.0)];
    let mut stamps = Array3::zeros((corners.len(), side, side));
    for ((n, j, i), value) in stamps.indexed_iter_mut() {
        let width = 1.5 + 0.1 * n as f64;
        let (x, y) = (i as f64 - 16.0, j as f64 - 16.0);
        *value = (1.0 + (x * x + 1.1 * y * y) / (width * width)).powf(-3.0);
    }
    let positions = corners.map(|(x, y)| Position::new(x, y).unwrap()).to_vec();
    let positions = SamplePositions::new(positions, None).unwrap();
    let grid = StampGrid::new(side, side)
        .unwrap()
        .with_pixel_response_included(true);
    PsfSamples::new(stamps, positions, grid).unwrap().into()
}

fn simulator<T: ConvReal>(tolerance: f64) -> Simulator<T> {
    let simulator = psf().simulator((SIDE, SIDE)).tolerance(tolerance);
    simulator.device(Device::Cpu).build().unwrap()
}

fn star(x: f64, y: f64, flux: f64) -> PointSource {
    PointSource::new(Position::new(x, y).unwrap(), flux).unwrap()
}

fn galaxy((x, y): (f64, f64), flux: f64, (re, n, q): (f64, f64, f64)) -> SersicSource {
    let profile = SersicProfile::new(re, n, q, 30.0).unwrap();
    SersicSource::new(Position::new(x, y).unwrap(), flux, profile).unwrap()
}

fn galaxies() -> Vec<SersicSource> {
    vec![
        galaxy((80.3, 77.6), 1000.0, (10.0, 2.5, 1.0)),
        galaxy((30.1, 40.2), 300.0, (3.0, 1.0, 0.5)),
        galaxy((120.4, 30.7), 200.0, (0.5, 1.0, 0.8)),
        galaxy((40.9, 130.3), 500.0, (5.0, 1.5, 0.7)),
    ]
}

/// Numbers from 0 to 1 without order.
fn mixed(i: usize) -> f64 {
    (i as f64 * 0.618_033_988_749_895).fract()
}

/// A cluster of stars whose density falls from the centre.
fn cluster(count: usize) -> Vec<PointSource> {
    let place = |i: usize| {
        let radius = 14.0 * (-2.0 * mixed(i + 1).ln()).sqrt();
        let (sin, cos) = (TAU * mixed(7 * i * i)).sin_cos();
        star(
            75.0 + radius * cos,
            82.0 + radius * sin,
            1.0 + 100.0 * mixed(3 * i),
        )
    };
    (0..count).map(place).collect()
}

/// The seeds for which an image fails its check.
fn failures<T: ConvReal>(simulator: &Simulator<T>, scene: &Scene<'_, T>, image: &Image<T>) -> Vec<u64> {
    (0..SEEDS)
        .filter(|&seed| {
            let check = simulator
                .spot_check(scene, image, (PIXELS, seed), &NoProgress)
                .unwrap();
            check.passed != Some(true)
        })
        .collect()
}

fn scenes<T: ConvReal>() -> Vec<(&'static str, Scene<'static, T>)> {
    let coincident = (0..200).map(|_| star(60.3, 90.7, 50.0)).collect::<Vec<_>>();
    vec![
        ("galaxies", Scene::dark().with_galaxies(galaxies())),
        ("cluster", Scene::dark().with_stars(cluster(2000))),
        ("coincident stars", Scene::dark().with_stars(coincident)),
        (
            "stars and galaxies",
            Scene::dark().with_stars(cluster(300)).with_galaxies(galaxies()),
        ),
    ]
}

fn correct_images_pass<T: ConvReal>() {
    for tolerance in [1e-4, 0.0] {
        let simulator = simulator::<T>(tolerance);
        for (name, scene) in scenes::<T>() {
            let image = simulator.simulate(&scene).unwrap();
            let failed = failures(&simulator, &scene, &image);
            assert!(failed.is_empty(), "{name}, {}, {tolerance}: {failed:?}", T::NAME);
        }
    }
}

#[test]
fn correct_images_pass_in_f32() {
    correct_images_pass::<f32>();
}

#[test]
fn correct_images_pass_in_f64() {
    correct_images_pass::<f64>();
}

/// Squares of such fluxes are beyond the range of double precision.
/// Large galaxies, and galaxies with much light far out: the drawing and the check share no window.
#[test]
fn large_galaxies_pass() {
    for profile in [(500.0, 1.0, 1.0), (120.0, 8.0, 0.2), (30.0, 4.0, 0.7)] {
        let scene = Scene::dark().with_galaxies(vec![galaxy((80.3, 77.6), 1e4, profile)]);
        let simulator = simulator::<f64>(1e-4);
        let image = simulator.simulate(&scene).unwrap();
        assert_eq!(
            failures(&simulator, &scene, &image),
            Vec::<u64>::new(),
            "{profile:?}"
        );
    }
}

#[test]
fn squares_of_fluxes_may_overflow() {
    for flux in [1e200, 1e-200] {
        let simulator = simulator::<f64>(1e-4);
        let stars = [star(30.2, 40.7, flux), star(90.4, 80.1, 0.5 * flux)];
        let scene = Scene::dark().with_stars(stars.to_vec());
        let image = simulator.simulate(&scene).unwrap();
        assert!(failures(&simulator, &scene, &image).is_empty(), "{flux:e}");
        let wrong = Scene::dark().with_stars(vec![stars[0], star(90.4, 80.1, 0.501 * flux)]);
        let wrong = simulator.simulate(&wrong).unwrap();
        assert_eq!(
            failures(&simulator, &scene, &wrong).len(),
            SEEDS as usize,
            "{flux:e}"
        );
    }
}

/// One source is too bright by ten times the tolerance. No other source lies on its stamp.
fn a_wrong_source_fails<T: ConvReal>(tolerance: f64) {
    let simulator = simulator::<T>(tolerance);
    let factor = 1.0 + 10.0 * tolerance;
    let stars = [
        star(15.3, 90.2, 100.0),
        star(140.4, 105.7, 60.0),
        star(100.6, 142.1, 80.0),
        star(70.2, 15.4, 30.0),
    ];
    let scene = Scene::<T>::dark()
        .with_stars(stars.to_vec())
        .with_galaxies(galaxies());
    let correct = simulator.simulate(&scene).unwrap();
    let (correct, all) = (correct.into_pixels(), SEEDS as usize);
    let with = |wrong: Scene<'_, T>| {
        let added = simulator.simulate(&wrong).unwrap().into_pixels();
        let more = T::nearest(factor - 1.0);
        let sum: Array2<T> = &correct + &added.mapv(|v| v * more);
        failures(&simulator, &scene, &Image::new(sum).unwrap()).len()
    };
    for galaxy in galaxies() {
        let failed = with(Scene::dark().with_galaxies(vec![galaxy]));
        assert_eq!(failed, all, "{galaxy:?}, {tolerance}");
    }
    for star in &stars {
        let failed = with(Scene::dark().with_stars(vec![*star]));
        assert_eq!(failed, all, "{star:?}, {tolerance}");
    }
}

#[test]
fn a_source_off_by_ten_times_the_tolerance_fails() {
    a_wrong_source_fails::<f32>(1e-3);
    a_wrong_source_fails::<f64>(1e-3);
    a_wrong_source_fails::<f64>(1e-4);
}

/// The check shares nothing with the drawing of galaxies: light that the period of a window would bring
/// in, and light that is left out at a window's edge, both fail.
#[test]
fn light_as_from_a_window_fails() {
    let simulator = simulator::<f64>(1e-4);
    let scene = Scene::dark().with_galaxies(vec![galaxy((80.3, 77.6), 1000.0, (10.0, 2.5, 1.0))]);
    let image = simulator.simulate(&scene).unwrap().into_pixels();
    let half = 40;
    let repeated = Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
        let from = |v: usize| if v < 80 { v + 80 } else { v - 80 };
        image[[y, x]] + image[[from(y), x]] + image[[y, from(x)]]
    });
    let cut = Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
        let inside = |v: usize| (80 - half..80 + half).contains(&v);
        if inside(x) && inside(y) {
            image[[y, x]]
        } else {
            0.0
        }
    });
    for wrong in [repeated, cut] {
        let failed = failures(&simulator, &scene, &Image::new(wrong).unwrap());
        assert_eq!(failed.len(), SEEDS as usize);
    }
}
