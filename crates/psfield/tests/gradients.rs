//! Derivatives with respect to light and to the parameters of the PSF, compared with differences.

use ndarray::{Array1, Array2, Array3, Axis};
use psf_types::{
    Anchor, FrameShape, ImageView, Interpolation, NoProgress, Normalisation, PixelRegion, Position,
    PsfSamples, SamplePositions, StampGrid,
};
use psfield::prelude::*;
use psfield::{FitOptions, Gradients, PsfParameters, ScenePixels, SimulateOptions, WantedGradients};

/// Central differences, relative to the derivative along a direction.
const CENTRAL_DIFFERENCES: f64 = 1e-7;
/// The step of differences, relative to the parameters.
const STEP: f64 = 1e-4;

/// Numbers between -1 and 1 that follow no pattern.
fn noise(count: usize, seed: usize) -> Vec<f64> {
    let value = |i: usize| (12.9898 * (i + 1) as f64 + 78.233 * seed as f64).sin() * 43758.5453;
    (0..count).map(|i| 2.0 * value(i).rem_euclid(1.0) - 1.0).collect()
}

/// Twelve samples of an elliptical PSF that changes over the field of 50 x 40 pixels, as a model with its
/// parameters.
fn psf(interpolation: Interpolation, normalisation: Normalisation, oversampling: f64) -> Psf {
    let n = (11.0 * oversampling) as usize;
    let positions = (0..12).map(|j| Position::of_pixel(16 * (j % 4), 19 * (j / 4)));
    let positions = SamplePositions::new(positions.collect(), FrameShape::new(50, 40).ok()).unwrap();
    let stamps = Array3::from_shape_fn((12, n, n), |(j, y, x)| {
        let at = |v: usize| (v as f64 - (n / 2) as f64) / oversampling;
        let (x, y, j) = (at(x), at(y), j as f64);
        let turn = 0.1 * j;
        let (u, v) = (x * turn.cos() + y * turn.sin(), y * turn.cos() - x * turn.sin());
        let narrow = 1.2 + 0.05 * (1.7 * j).sin();
        (1.0 + 0.1 * (j % 3.0)) * (-u * u / (2.0 * narrow * narrow) - v * v / (3.0 + 0.1 * j)).exp()
    });
    let grid = StampGrid::new(n, n)
        .unwrap()
        .with_oversampling(oversampling)
        .unwrap();
    let samples = PsfSamples::new(stamps, positions, grid).unwrap();
    let options = FitOptions {
        interpolation,
        normalisation,
        ..FitOptions::default()
    };
    let psf = Psf::new(samples, options);
    let parameters = psf.parameters().unwrap().clone();
    psf.with_parameters(parameters).unwrap()
}

fn simulator(psf: &Psf, options: &SimulateOptions, shape: (usize, usize)) -> Simulator<f64> {
    psf.simulator(shape).options(options.clone()).build().unwrap()
}

/// The scalar product of a derivative with a direction, for each kind of parameter.
fn along(derivative: &PsfParameters, direction: &PsfParameters) -> [f64; 3] {
    let of_mean = derivative.mean.as_ref().zip(direction.mean.as_ref());
    [
        of_mean.map_or(0.0, |(a, b)| (a * b).sum()),
        (&derivative.components * &direction.components).sum(),
        (&derivative.coefficients * &direction.coefficients).sum(),
    ]
}

/// Parameters plus a multiple of one kind of a direction.
fn moved(parameters: &PsfParameters, direction: &PsfParameters, kind: usize, step: f64) -> PsfParameters {
    let mut moved = parameters.clone();
    match kind {
        0 => {
            if let (Some(mean), Some(along)) = (&mut moved.mean, &direction.mean) {
                mean.scaled_add(step, along);
            }
        }
        1 => moved.components.scaled_add(step, &direction.components),
        _ => moved.coefficients.scaled_add(step, &direction.coefficients),
    }
    moved
}

fn like(parameters: &PsfParameters, seed: usize) -> PsfParameters {
    let scaled =
        |count: usize, largest: f64, seed: usize| Array1::from(noise(count, seed)).mapv(|v| v * largest);
    let largest = |values: &[f64]| values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let mean = parameters.mean.as_ref().map(|mean| {
        let size = largest(mean.as_slice().unwrap());
        scaled(mean.len(), size, seed)
            .into_shape_with_order(mean.dim())
            .unwrap()
    });
    let (components, coefficients) = (&parameters.components, &parameters.coefficients);
    PsfParameters {
        mean,
        components: scaled(components.len(), 0.3, seed + 1)
            .into_shape_with_order(components.dim())
            .unwrap(),
        coefficients: scaled(
            coefficients.len(),
            largest(coefficients.as_slice().unwrap()),
            seed + 2,
        )
        .into_shape_with_order(coefficients.dim())
        .unwrap(),
    }
}

/// Compares derivatives of `<g, A f>` with differences along random directions.
fn check(psf: &Psf, options: &SimulateOptions, name: &str) {
    let s = options.oversample;
    let shape = (40 * s, 50 * s);
    let simulator = simulator(psf, options, shape);
    let image = simulator.image_shape();
    let light = Array2::from_shape_vec(shape, noise(shape.0 * shape.1, 5)).unwrap();
    let cotangent =
        Array2::from_shape_vec((image.ny(), image.nx()), noise(image.ny() * image.nx(), 6)).unwrap();
    let (f, g) = (
        [ImageView::new(light.view()).unwrap()],
        [ImageView::new(cotangent.view()).unwrap()],
    );
    let wanted = WantedGradients {
        light: true,
        coefficients: true,
        stamps: true,
    };
    let Gradients {
        light: of_light,
        psf: of_psf,
    } = simulator.gradients(&f, &g, wanted, &NoProgress).unwrap();
    let value = |simulator: &Simulator<f64>| {
        let image = simulator.simulate(&Scene::new(light.clone()).unwrap()).unwrap();
        (&image.pixels() * &cotangent).sum()
    };
    let of_light = of_light.unwrap();
    let lit = simulator.light_region(&NoProgress).unwrap();
    if lit.shape() == simulator.scene_shape() {
        let product = (&of_light.index_axis(Axis(0), 0) * &light).sum();
        let expected = value(&simulator);
        assert!(
            (product - expected).abs() < 1e-12 * light.len() as f64,
            "{name}: {product} {expected}"
        );
    }
    let parameters = psf.parameters().unwrap();
    let direction = like(parameters, 7);
    let found = along(&of_psf.unwrap(), &direction);
    for (kind, found) in found.into_iter().enumerate() {
        let at = |step: f64| {
            let psf = psf
                .with_parameters(moved(parameters, &direction, kind, step))
                .unwrap();
            value(&simulator.with_psf(psf, &NoProgress).unwrap())
        };
        // The fourth-order formula, whose error is small beside the rounding.
        let near = (at(STEP) - at(-STEP)) / (2.0 * STEP);
        let far = (at(2.0 * STEP) - at(-2.0 * STEP)) / (4.0 * STEP);
        let expected = (4.0 * near - far) / 3.0;
        let difference = (found - expected).abs() / expected.abs();
        assert!(
            difference < CENTRAL_DIFFERENCES,
            "{name}, kind {kind}: {found} {expected}, {difference:e}"
        );
    }
}

fn exact() -> SimulateOptions {
    SimulateOptions {
        tolerance: 0.0,
        ..SimulateOptions::default()
    }
}

#[test]
fn parameters_of_every_interpolation() {
    for interpolation in [
        "kriging",
        "delaunay",
        "natural-neighbour",
        "idw",
        "bilinear",
        "bicubic",
        "polynomial=2",
        "nearest",
    ] {
        for normalisation in [Normalisation::Unit, Normalisation::Keep] {
            let psf = psf(interpolation.parse().unwrap(), normalisation, 1.0);
            check(&psf, &exact(), &format!("{interpolation} {normalisation:?}"));
        }
    }
}

#[test]
fn parameters_of_every_kind_of_scene() {
    let kriging: Interpolation = "kriging".parse().unwrap();
    for (normalisation, oversampling) in [(Normalisation::Unit, 2.0), (Normalisation::Keep, 3.0)] {
        let psf = psf(kriging, normalisation, oversampling);
        for anchor in [Anchor::Source, Anchor::Output] {
            for (oversample, scene_pixels) in [
                (1, ScenePixels::Point),
                (2, ScenePixels::Point),
                (1, ScenePixels::Integrated),
            ] {
                let options = SimulateOptions {
                    anchor,
                    oversample,
                    scene_pixels,
                    stamp_size: Some(9),
                    ..exact()
                };
                let name = format!("{normalisation:?} {anchor} {oversample} {scene_pixels}");
                check(&psf, &options, &name);
                let region = PixelRegion::new(7, 5, FrameShape::new(30, 21).unwrap());
                let options = SimulateOptions {
                    region: Some(region),
                    ..options
                };
                check(&psf, &options, &format!("{name} region"));
            }
        }
    }
}

#[test]
fn a_tolerance_bounds_the_error_of_derivatives() {
    let psf = psf("kriging".parse().unwrap(), Normalisation::Unit, 1.0);
    let light = Array2::from_shape_vec((40, 50), noise(2000, 1))
        .unwrap()
        .mapv(|v| v + 1.0);
    let cotangent = Array2::from_shape_vec((40, 50), noise(2000, 2)).unwrap();
    let of = |tolerance: f64| {
        let options = SimulateOptions { tolerance, ..exact() };
        let (f, g) = (
            [ImageView::new(light.view()).unwrap()],
            [ImageView::new(cotangent.view()).unwrap()],
        );
        let wanted = WantedGradients {
            light: false,
            coefficients: true,
            stamps: false,
        };
        let simulator = simulator(&psf, &options, (40, 50));
        simulator
            .gradients(&f, &g, wanted, &NoProgress)
            .unwrap()
            .psf
            .unwrap()
    };
    let (exact, coarse) = (of(0.0), of(0.1));
    let largest = |values: &Array2<f64>| values.fold(0.0_f64, |m, v| m.max(v.abs()));
    let error = largest(&(&exact.coefficients - &coarse.coefficients)) / largest(&exact.coefficients);
    assert!(error > 1e-9 && error < 0.1, "{error:e}");
}

#[test]
fn parameters_without_derivatives_are_refused_in_a_sentence() {
    let of_samples = Psf::from_samples(Array3::ones((1, 5, 5)).view(), &[(0.0, 0.0)]).unwrap();
    let simulator = simulator(&of_samples, &exact(), (10, 10));
    let light = Array2::ones((10, 10));
    let view = || [ImageView::new(light.view()).unwrap()];
    let wanted = WantedGradients {
        light: false,
        coefficients: true,
        stamps: false,
    };
    let error = simulator
        .gradients(&view(), &view(), wanted, &NoProgress)
        .unwrap_err();
    assert!(error.to_string().contains("Psf::with_parameters"), "{error}");
    let error = simulator
        .gradients(&view(), &[], wanted, &NoProgress)
        .unwrap_err();
    assert!(error.to_string().contains("0 images for 1 lights"), "{error}");
}
