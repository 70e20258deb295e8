//! Scenes in colour: images, stars and galaxies of several spectra through one PSF.

use ndarray::{Array2, Array3, ArrayView2, ArrayViewMut2, s};
use psfield::colours::open_spectrum;
use psfield::conv_core::{ConvReal, RowStream};
use psfield::psf_basis::RankSelection;
use psfield::psf_types::{
    Anchor, FrameShape, Image, ImageView, NoProgress, PixelRegion, PointSource, Position, PsfSamples,
    SamplePositions, SampleStates, SersicProfile, SersicSource, StampGrid, StateKind,
};
use psfield::spectra::{Bandpass, Curve};
use psfield::{
    Device, FitOptions, Method, Psf, PsfieldError, Scene, ScenePixels, SimulateOptions, Simulator,
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

/// Layers with an image and stars, with a galaxy and stars, and with an image.
fn layers(finer: usize) -> Vec<Scene<'static>> {
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
fn one_by_one(psf: &Psf, layers: &[Scene<'_>], options: &SimulateOptions) -> Array2<f64> {
    let shape = (SHAPE.0 * options.oversample, SHAPE.1 * options.oversample);
    let mut sum = Array2::zeros(SHAPE);
    for (spectrum, scene) in layers.iter().enumerate() {
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
        let (psf, layers) = (psf(oversampling), layers(options.oversample));
        let expected = one_by_one(&psf, &layers, &options);
        let shape = (SHAPE.0 * options.oversample, SHAPE.1 * options.oversample);
        let simulator = psf.simulator(shape).options(options.clone()).build().unwrap();
        let image = simulator.simulate(&Scene::of_layers(layers)).unwrap();
        let peak = largest(&image);
        for (a, b) in image.pixels().iter().zip(&expected) {
            // The bases of resampled PSFs differ in their rounding. Without a plan, galaxies have a tolerance
            // of 1e-7.
            let allowed = if options.method.has_plan() {
                20.0 * ROUNDING
            } else {
                1e-7
            };
            assert!((a - b).abs() < allowed * peak, "{options:?}: {a} {b}");
        }
    }
}

fn planned<T: ConvReal>(psf: &Psf, tolerance: f64) -> Simulator<T> {
    psf.simulator(SHAPE).tolerance(tolerance).build().unwrap()
}

#[test]
fn colours_are_within_the_tolerance() {
    const TOLERANCE: f64 = 3e-3;
    let (psf, scene) = (psf(1.0), Scene::of_layers(layers(1)));
    let simulator = planned::<f64>(&psf, TOLERANCE);
    let image = simulator.simulate(&scene).unwrap();
    let check = simulator
        .spot_check(&scene, &image, (500, 3), &NoProgress)
        .unwrap();
    assert_eq!(check.passed, Some(true), "{check:?}");
    assert!(check.max_abs > 0.0);
    // The PSF of the first spectrum for all sources does not pass.
    let dark = scene.layers().iter().map(|layer| {
        Scene::dark()
            .with_stars(layer.stars().to_vec())
            .with_galaxies(layer.galaxies().to_vec())
    });
    let dark: Vec<Scene<'_>> = dark.collect();
    let wrong = planned::<f64>(&psf.at_state(0.0).unwrap(), TOLERANCE);
    let mut image = wrong.zeros();
    for scene in &dark {
        wrong.simulate_into(scene, image.view_mut(), &NoProgress).unwrap();
    }
    let dark = Scene::of_layers(dark);
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
fn regions_and_other_psfs_take_layers() {
    let (psf, scene) = (psf(1.0), Scene::of_layers(layers(1)));
    let simulator = planned::<f64>(&psf, 0.0);
    let whole = simulator.simulate(&scene).unwrap();
    let peak = largest(&whole);
    let region = PixelRegion::new(40, 30, FrameShape::new(61, 52).unwrap());
    let part = simulator.for_region(region, &NoProgress).unwrap();
    let image = part.simulate(&scene).unwrap();
    let expected = whole.pixels().slice_move(s![30..82, 40..101]);
    let error = (&image.pixels() - &expected).fold(0.0, |m: f64, v| m.max(v.abs()));
    assert!(error < ROUNDING * peak, "{error:e}");
    // Many scenes at once.
    let many = simulator.simulate_many(&[scene.clone(), scene.clone()]).unwrap();
    assert!(many.iter().all(|image| image.pixels() == whole.pixels()));
    // Light of other spectra.
    let turned: Vec<_> = layers(1).into_iter().rev().collect();
    let expected = one_by_one(&psf, &turned, simulator.options());
    let found = simulator.simulate(&Scene::of_layers(turned)).unwrap();
    let differ = |a: &Image<f64>, b: &Array2<f64>| {
        let largest = (&a.pixels() - b).fold(0.0, |m: f64, v| m.max(v.abs()));
        largest / peak
    };
    assert!(differ(&found, &expected) < 20.0 * ROUNDING);
    assert!(differ(&whole, &expected) > 1e-3);
    // Another PSF with the same number of spectra uses the tiles.
    let other = simulator.with_psf(self::psf(2.0), &NoProgress).unwrap();
    let expected = one_by_one(&self::psf(2.0), &layers(1), simulator.options());
    let found = other.simulate(&scene).unwrap();
    assert!(differ(&found, &expected) < 20.0 * ROUNDING);
}

#[test]
fn the_adjoint_has_an_image_for_each_layer() {
    let simulator = planned::<f64>(&psf(1.0), 1e-3);
    let seen = Array2::from_shape_fn(SHAPE, |(y, x)| ((31 * x + 17 * y) % 23) as f64 - 11.0);
    let view = ImageView::new(seen.view()).unwrap();
    let back = simulator.adjoint(&view, &NoProgress).unwrap();
    assert_eq!(back.len(), 3);
    let light: Vec<Array2<f64>> = (0..3)
        .map(|layer| Array2::from_shape_fn(SHAPE, |(y, x)| ((5 * x + 3 * y + layer) % 11) as f64))
        .collect();
    let scenes = light.iter().map(|light| Scene::new(light.clone()).unwrap());
    let image = simulator.simulate(&Scene::of_layers(scenes)).unwrap();
    let (left, mut right) = ((&image.pixels() * &seen).sum(), 0.0);
    for (light, back) in light.iter().zip(&back) {
        right += (light * &back.pixels()).sum();
    }
    assert!((left - right).abs() < 1e-10 * left.abs(), "{left} {right}");
}

/// The rows of the images of some layers.
struct Rows {
    light: Vec<(usize, Array2<f64>)>,
    written: Vec<f64>,
}

impl RowStream<f64> for Rows {
    type Error = PsfieldError;
    fn read(
        &mut self,
        layer: usize,
        rows: std::ops::Range<usize>,
        mut light: ArrayViewMut2<'_, f64>,
    ) -> Result<(), PsfieldError> {
        let (_, image) = self.light.iter().find(|(of, _)| *of == layer).unwrap();
        light.assign(&image.slice(s![rows, ..]));
        Ok(())
    }
    fn write(&mut self, rows: ArrayView2<'_, f64>) -> Result<(), PsfieldError> {
        self.written.extend(rows);
        Ok(())
    }
}

/// A layer in memory and one that is read by rows.
#[test]
fn layers_are_streamed() {
    let (psf, all) = (psf(1.0), layers(1));
    let simulator = planned::<f64>(&psf, 1e-3);
    let whole = simulator.simulate(&Scene::of_layers(all.clone())).unwrap();
    let last = all[2].layers()[0].image().unwrap().pixels().to_owned();
    let mut rows = Rows {
        light: vec![(2, last)],
        written: Vec::new(),
    };
    let streamed = Scene::of_layers([all[0].clone(), all[1].clone(), Scene::streamed()]);
    let (_, check) = simulator
        .stream(&streamed, &mut rows, (300, 5), &NoProgress)
        .unwrap();
    assert_eq!(check.unwrap().passed, Some(true));
    assert!(whole.pixels().iter().eq(&rows.written));
    let error = simulator.simulate(&streamed).unwrap_err();
    assert!(error.to_string().contains("row by row"), "{error}");
}

#[test]
fn wrong_numbers_of_layers_and_gpus_are_refused() {
    let psf = psf(1.0);
    let simulator = planned::<f64>(&psf, 1e-3);
    let two = Scene::of_layers(layers(1).into_iter().take(2));
    let error = simulator.simulate(&two).unwrap_err();
    assert!(
        error.to_string().contains("3 states, but the scene has 2 layers"),
        "{error}"
    );
    let error = simulator.plan_arrays(&NoProgress).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("several states needs the native engine"),
        "{error}"
    );
    let builder = psf.simulator(SHAPE).device(Device::Gpu);
    let simulator: Simulator<f32> = builder.build().unwrap();
    let scenes = (0..3).map(|_| Scene::new(Array2::ones(SHAPE)).unwrap());
    let error = simulator.simulate(&Scene::of_layers(scenes)).unwrap_err();
    assert_eq!(error.setting(), Some("device"), "{error}");
}
