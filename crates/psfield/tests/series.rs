//! Series of exposures against sums of many short ones.

use std::sync::Arc;

use ndarray::{Array2, Array3, s};
use psfield::conv_core::ConvReal;
use psfield::prelude::*;
use psfield::psf_io::{Catalog, CatalogOptions, read_catalog_with};
use psfield::psf_types::{
    FrameShape, Image, NoProgress, PointSource, Position, PsfSamples, SamplePositions, StampGrid, StateKind,
};
use psfield::series::{Exposures, LightCurves, Pointing, PointingPath, Series, SeriesExposure, SeriesFrames};
use psfield::spectra::{Bandpass, Curve};
use psfield::{ErrorKind, Method, Motion, SceneLight, SpotCheck};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Columns and rows of the frames.
const FRAME: (usize, usize) = (90, 110);
/// The largest error of a pixel of a star, relative to the peak: that of the interpolation of stamps
/// between pixels and the engine's tolerance.
const PIXEL: f64 = 5e-5;
/// The width of the PSF at the right edge, relative to that at the left.
const WIDENING: f64 = 1.2;
/// The tolerance of the engine.
const TOLERANCE: f64 = 1e-6;

/// A PSF with these widths (r.m.s., frame pixels), one per state, with four stamp pixels per frame
/// pixel. At the right edge of the frame, it is wider by the factor `widening`.
fn psf(kind: Option<(StateKind, &[f64])>, sigmas: &[f64], widening: f64) -> Psf {
    let (size, s) = (97, 4.0);
    let middle = (size / 2) as f64;
    let stamps = Array3::from_shape_fn((2 * sigmas.len(), size, size), |(j, y, x)| {
        let sigma = sigmas[j / 2] * s * if j % 2 == 1 { widening } else { 1.0 };
        let (x, y) = (x as f64 - middle, y as f64 - middle);
        (-(x * x + 1.3 * y * y) / (2.0 * sigma * sigma)).exp()
    });
    let at = [Position::of_pixel(0, 45), Position::of_pixel(109, 45)];
    let field = Some(FrameShape::new(FRAME.1, FRAME.0).unwrap());
    let positions = match kind {
        Some((kind, values)) => SamplePositions::in_every_state(&at, field, kind, values),
        None => SamplePositions::new(at.to_vec(), field),
    };
    let grid = StampGrid::new(size, size).unwrap().with_oversampling(s).unwrap();
    PsfSamples::new(stamps, positions.unwrap(), grid).unwrap().into()
}

fn stars() -> Vec<PointSource> {
    [(30.3, 40.8, 100.0), (70.6, 30.1, 50.0), (55.0, 61.4, 80.0)]
        .map(|(x, y, flux)| PointSource::new(Position::new(x, y).unwrap(), flux).unwrap())
        .to_vec()
}

fn options() -> SimulateOptions {
    SimulateOptions {
        tolerance: TOLERANCE,
        ..SimulateOptions::default()
    }
}

/// The frames of a series with an image and a catalogue.
fn frames_of<T: ConvReal>(
    psf: &Psf,
    shape: (usize, usize),
    options: SimulateOptions,
    series: Series,
    (image, catalog): (Option<Image<T>>, Catalog),
) -> Result<SeriesFrames<T>, PsfieldError> {
    let mut light = SceneLight::new();
    if let Some(image) = image {
        light.add_image(None, image.into_pixels()).unwrap();
    }
    light.set_catalog(catalog);
    SeriesFrames::new(psf, shape, options, series, light)
}

fn image_of(exposure: &SeriesExposure<'_, f64>) -> Image<f64> {
    exposure.simulator.simulate(&exposure.scene).unwrap()
}

fn check_of(exposure: &SeriesExposure<'_, f64>, image: &Image<f64>, count: usize) -> SpotCheck {
    let simulator = &exposure.simulator;
    simulator
        .spot_check(&exposure.scene, image, (count, 1), &NoProgress)
        .unwrap()
}

fn series(exposures: Exposures) -> Series {
    Series {
        exposures,
        pointing: Pointing::default(),
        light_curves: LightCurves::default(),
    }
}

/// A random walk of the pointing, for 10 s.
fn walk(steps: usize) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut x, mut y) = (0.3, -0.2);
    let mut rows = (vec![0.0], vec![x], vec![y]);
    for step in 1..=steps {
        x += 0.06 * (rng.random::<f64>() - 0.5);
        y += 0.06 * (rng.random::<f64>() - 0.48);
        rows.0.push(10.0 * step as f64 / steps as f64);
        rows.1.push(x);
        rows.2.push(y);
    }
    rows
}

fn largest_difference(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
    let peak = b.iter().fold(0.0f64, |most, v| most.max(v.abs()));
    let largest = a
        .iter()
        .zip(b)
        .fold(0.0f64, |most, (a, b)| most.max((a - b).abs()));
    largest / peak
}

#[test]
fn a_moving_telescope_gives_the_mean_of_a_thousand_short_exposures() {
    // Constant over the field. A PSF that varies is taken at the mean position of the source.
    let psf = psf(None, &[1.1], 1.0);
    let (times, dx, dy) = walk(1000);
    let pointing = Pointing {
        drift_px_per_s: [0.05, 0.0],
        jitter_px: 0.0,
        path: Some(PointingPath::new(times.clone(), &dx, &dy).unwrap()),
    };
    let whole = Series {
        pointing,
        ..series(Exposures::regular(1, 10.0, 10.0).unwrap())
    };
    let light = Catalog::new(stars(), Vec::new());
    let mut moving = frames_of::<f64>(&psf, FRAME, options(), whole.clone(), (None, light)).unwrap();
    let exposure = moving.exposure(0, &NoProgress).unwrap();
    let found = image_of(&exposure);

    // The sum of stars at the middle of every step.
    let fixed = psf.simulator(FRAME).options(options()).build::<f64>().unwrap();
    let mut points = Vec::new();
    for step in 0..1000 {
        let drift = 0.05 * 0.5 * (times[step] + times[step + 1]);
        let (x, y) = (
            0.5 * (dx[step] + dx[step + 1]) + drift,
            0.5 * (dy[step] + dy[step + 1]),
        );
        for star in stars() {
            let at = Position::new(star.position().x() + x, star.position().y() + y).unwrap();
            points.push(PointSource::new(at, star.flux() / 1000.0).unwrap());
        }
    }
    let expected = fixed.simulate(&Scene::dark().with_stars(points)).unwrap();
    let error = largest_difference(&found.pixels().to_owned(), &expected.pixels().to_owned());
    assert!(error < PIXEL, "{error:e}");
    let [x, y] = exposure.shift_px;
    assert!((exposure.sources[0].x - 30.3 - x).abs() < 1e-12);
    assert!((exposure.sources[0].y - 40.8 - y).abs() < 1e-12);

    // As pixels of an image, the light moves by whole pixels, and the PSF does the rest.
    let mut pixels = Array2::zeros(FRAME);
    pixels[(40, 30)] = 100.0;
    let image = Image::new(pixels).unwrap();
    let mut moving =
        frames_of::<f64>(&psf, FRAME, options(), whole, (Some(image), Catalog::default())).unwrap();
    let exposure = moving.exposure(0, &NoProgress).unwrap();
    let found = image_of(&exposure);
    let points = (0..1000).map(|step| {
        let drift = 0.05 * 0.5 * (times[step] + times[step + 1]);
        let (x, y) = (
            0.5 * (dx[step] + dx[step + 1]) + drift,
            0.5 * (dy[step] + dy[step + 1]),
        );
        PointSource::new(Position::new(30.0 + x, 40.0 + y).unwrap(), 0.1).unwrap()
    });
    let expected = fixed
        .simulate(&Scene::dark().with_stars(points.collect::<Vec<_>>()))
        .unwrap();
    let error = largest_difference(&found.pixels().to_owned(), &expected.pixels().to_owned());
    assert!(error < PIXEL, "{error:e}");
}

#[test]
fn jitter_is_the_convolution_with_a_gaussian() {
    let (narrow, wide) = (
        psf(None, &[1.1], WIDENING),
        psf(None, &[1.1f64.hypot(0.6)], WIDENING),
    );
    let moved = narrow
        .moved(&Motion::fixed([0.0, 0.0]).with_jitter_px(0.6).unwrap())
        .unwrap();
    // The samples of the other node are 1.2 times as wide before the jitter, so this one is compared.
    let at = Position::of_pixel(0, 45);
    let (a, b) = (
        moved.model().unwrap().psf_at(at).unwrap(),
        wide.model().unwrap().psf_at(at).unwrap(),
    );
    let margin = a.grid().centre_x() as usize - b.grid().centre_x() as usize;
    let inner = a
        .values()
        .slice(s![margin..margin + 97, margin..margin + 97])
        .to_owned();
    // Along y, the stamps are narrower by sqrt(1.3), so that only the profile along x agrees.
    let profile = |stamp: &Array2<f64>| {
        let sums: Vec<f64> = stamp.columns().into_iter().map(|column| column.sum()).collect();
        Array2::from_shape_vec((1, sums.len()), sums).unwrap()
    };
    let error = largest_difference(&profile(&inner), &profile(&b.values().to_owned()));
    assert!(error < PIXEL, "{error:e}");
}

#[test]
fn a_psf_with_times_is_averaged_over_each_exposure() {
    let times = [0.0, 10.0, 20.0, 30.0, 40.0];
    let psf = psf(
        Some((StateKind::Time, &times)),
        &[1.0, 1.15, 1.2, 1.1, 1.05],
        WIDENING,
    );
    let all = series(Exposures::new(vec![1.0, 12.0, 33.0], 7.0).unwrap());
    let light = Catalog::new(stars(), Vec::new());
    let mut varying = frames_of::<f64>(&psf, FRAME, options(), all, (None, light)).unwrap();
    for (number, from) in [1.0, 12.0, 33.0].into_iter().enumerate() {
        let exposure = varying.exposure(number, &NoProgress).unwrap();
        let found = image_of(&exposure);
        let mut expected = Array2::zeros(FRAME);
        for part in 0..100 {
            let time = from + 7.0 * (f64::from(part) + 0.5) / 100.0;
            let at_time = psf.at_state(time).unwrap();
            let simulator = at_time
                .simulator(FRAME)
                .options(options())
                .build::<f64>()
                .unwrap();
            expected += &simulator
                .simulate(&Scene::dark().with_stars(stars()))
                .unwrap()
                .pixels();
        }
        expected /= 100.0;
        let error = largest_difference(&found.pixels().to_owned(), &expected);
        assert!(error < PIXEL, "exposure {number}: {error:e}");
    }
    let late = series(Exposures::new(vec![35.0], 7.0).unwrap());
    let error = frames_of::<f64>(&psf, FRAME, options(), late, (None, Catalog::default()));
    let message = error.unwrap_err().to_string();
    assert!(message.contains("from 0 to 40 s"), "{message}");
}

/// More exposures than share local bases. The PSF changes, and the telescope drifts.
#[test]
fn exposures_do_not_depend_on_those_before() {
    const COUNT: usize = 20;
    let times = [0.0, 50.0, 100.0, 150.0, 200.0];
    let psf = psf(
        Some((StateKind::Time, &times)),
        &[1.0, 1.15, 1.2, 1.1, 1.05],
        WIDENING,
    );
    let image = Array2::from_shape_fn(FRAME, |(y, x)| 5.0 + ((7 * x + 11 * y) % 13) as f64);
    let image = Image::new(image).unwrap();
    for (with_image, stars) in [(true, Vec::new()), (false, stars()), (true, stars())] {
        for drift in [0.0, 0.02] {
            let mut all = series(Exposures::regular(COUNT, 5.0, 10.0).unwrap());
            all.pointing = Pointing {
                drift_px_per_s: [drift, -0.5 * drift],
                jitter_px: 0.2,
                path: None,
            };
            let simulator = || {
                let light = (
                    with_image.then(|| image.clone()),
                    Catalog::new(stars.clone(), Vec::new()),
                );
                frames_of::<f64>(&psf, FRAME, options(), all.clone(), light).unwrap()
            };
            let (mut forward, mut backward) = (simulator(), simulator());
            let mut images = Vec::new();
            for number in 0..COUNT {
                let exposure = forward.exposure(number, &NoProgress).unwrap();
                let made = image_of(&exposure);
                let check = check_of(&exposure, &made, 100);
                assert_eq!(
                    check.passed,
                    Some(true),
                    "{with_image} {drift} {number}: {check:?}"
                );
                images.push(made.into_pixels());
            }
            for number in (0..COUNT).rev() {
                let exposure = backward.exposure(number, &NoProgress).unwrap();
                let made = image_of(&exposure).into_pixels();
                let error = largest_difference(&made, &images[number]);
                assert!(error < TOLERANCE, "{with_image} {drift} {number}: {error:e}");
            }
            assert!(largest_difference(&images[10], &images[0]) > 1e-2);
        }
    }
}

#[test]
fn fluxes_follow_the_light_curves() {
    // Sums and aperture photometry, corrected by the known PSF, in 20 exposures with drift and jitter.
    let times = [0.0, 100.0, 200.0];
    let psf = psf(Some((StateKind::Time, &times)), &[1.0, 1.1, 1.15], WIDENING);
    let rows: Vec<f64> = [0.0, 1.0].iter().flat_map(|&row| vec![row; 3]).collect();
    let curves = LightCurves::new(
        &rows,
        &[0.0, 100.0, 200.0, 0.0, 100.0, 200.0],
        &[1.0, 1.0, 1.0, 1.0, 3.0, 2.0],
    )
    .unwrap();
    let all = Series {
        exposures: Exposures::regular(20, 8.0, 10.0).unwrap(),
        pointing: Pointing {
            drift_px_per_s: [0.004, -0.01],
            jitter_px: 0.15,
            path: None,
        },
        light_curves: curves.clone(),
    };
    let apart = vec![stars()[0], stars()[1]];
    let light = Catalog::new(apart, Vec::new());
    let mut varying = frames_of::<f64>(&psf, FRAME, options(), all, (None, light)).unwrap();
    for number in 0..20 {
        let exposure = varying.exposure(number, &NoProgress).unwrap();
        let image = image_of(&exposure);
        let (from, to) = (10.0 * number as f64, 10.0 * number as f64 + 8.0);
        let mean = curves.mean_factor(1, (from, to)).unwrap();
        let (sum, expected) = (image.pixels().sum(), 100.0 + 50.0 * mean);
        assert!((sum / expected - 1.0).abs() < 1e-5, "{number}: {sum}");
        for (source, alone) in exposure.sources.iter().zip([100.0, 50.0 * mean]) {
            assert!((source.flux / alone - 1.0).abs() < 1e-12);
            // The fraction of the light in the aperture, from the PSF drawn alone at the known position.
            let window = s![
                source.y.round() as usize - 3..source.y.round() as usize + 4,
                source.x.round() as usize - 3..source.x.round() as usize + 4
            ];
            let at = Position::new(source.x, source.y).unwrap();
            let one = vec![PointSource::new(at, 1.0).unwrap()];
            let of_psf = exposure
                .simulator
                .simulate(&Scene::dark().with_stars(one))
                .unwrap();
            let fraction = of_psf.pixels().slice(window).sum();
            let measured = image.pixels().slice(window).sum() / fraction;
            assert!(
                (measured / alone - 1.0).abs() < 1e-5,
                "{number}: {measured} {alone}"
            );
        }
    }
    let wrong = Series {
        light_curves: LightCurves::new(&[7.0, 7.0], &[0.0, 200.0], &[1.0, 1.0]).unwrap(),
        ..series(Exposures::regular(1, 8.0, 10.0).unwrap())
    };
    let light = Catalog::new(stars(), Vec::new());
    let error = frames_of::<f64>(&psf, FRAME, options(), wrong, (None, light)).unwrap_err();
    assert!(error.to_string().contains("source 7"), "{error}");
}

#[test]
fn moving_sources_leave_trails() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("asteroids.csv");
    std::fs::write(&path, "x,y,flux,vx,vy\n30.3,40.8,100,0.4,-0.3\n70,30,50,0,0\n").unwrap();
    let catalog = read_catalog_with(&path, &CatalogOptions::new().with_velocities(true)).unwrap();
    let psf = psf(None, &[1.1], WIDENING);
    let all = series(Exposures::new(vec![5.0], 10.0).unwrap());
    let mut moving = frames_of::<f64>(&psf, FRAME, options(), all, (None, catalog)).unwrap();
    let exposure = moving.exposure(0, &NoProgress).unwrap();
    let found = image_of(&exposure);
    let mut points = vec![PointSource::new(Position::new(70.0, 30.0).unwrap(), 50.0).unwrap()];
    for step in 0..1000 {
        let time = 5.0 + 0.01 * (f64::from(step) + 0.5);
        let at = Position::new(30.3 + 0.4 * time, 40.8 - 0.3 * time).unwrap();
        points.push(PointSource::new(at, 0.1).unwrap());
    }
    let expected = exposure
        .simulator
        .simulate(&Scene::dark().with_stars(points))
        .unwrap();
    let error = largest_difference(&found.pixels().to_owned(), &expected.pixels().to_owned());
    assert!(error < PIXEL, "{error:e}");
    assert!((exposure.sources[0].x - 34.3).abs() < 1e-12);
}

#[test]
fn exposures_with_equal_psfs_share_a_simulator() {
    let pointing = Pointing {
        drift_px_per_s: [0.3, 0.1],
        jitter_px: 0.2,
        path: None,
    };
    let all = Series {
        pointing,
        ..series(Exposures::regular(3, 3.3, 7.1).unwrap())
    };
    let light = Catalog::new(stars(), Vec::new());
    let mut moving =
        frames_of::<f32>(&psf(None, &[1.1], WIDENING), FRAME, options(), all, (None, light)).unwrap();
    let first = Arc::clone(&moving.exposure(0, &NoProgress).unwrap().simulator);
    let second = Arc::clone(&moving.exposure(2, &NoProgress).unwrap().simulator);
    assert!(Arc::ptr_eq(&first, &second));
}

#[test]
fn a_telescope_that_follows_a_source_makes_it_a_point() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("asteroid.csv");
    std::fs::write(
        &path,
        "x,y,flux,vx,vy,re,n\n30.3,40.8,100,0.4,-0.3,0,\n80,60,50,0.4,-0.3,1.5,1\n",
    )
    .unwrap();
    let catalog = read_catalog_with(&path, &CatalogOptions::new().with_velocities(true)).unwrap();
    let psf = psf(None, &[1.1], 1.0);
    let all = Series {
        pointing: Pointing {
            drift_px_per_s: [-0.4, 0.3],
            jitter_px: 0.0,
            path: None,
        },
        ..series(Exposures::new(vec![5.0], 10.0).unwrap())
    };
    let mut follows = frames_of::<f64>(&psf, FRAME, options(), all, (None, catalog.clone())).unwrap();
    let exposure = follows.exposure(0, &NoProgress).unwrap();
    let found = image_of(&exposure);
    let fixed = psf.simulator(FRAME).options(options()).build::<f64>().unwrap();
    let scene = Scene::dark()
        .with_stars(catalog.stars().to_vec())
        .with_galaxies(catalog.galaxies().to_vec());
    let expected = fixed.simulate(&scene).unwrap();
    let error = largest_difference(&found.pixels().to_owned(), &expected.pixels().to_owned());
    assert!(error < PIXEL, "{error:e}");
    let check = check_of(&exposure, &found, 50);
    assert_eq!(check.passed, Some(true));
}

#[test]
fn frames_give_each_exposure_its_own_psf() {
    let numbers = [0.0, 1.0];
    let psf = psf(Some((StateKind::Frame, &numbers)), &[1.0, 1.3], WIDENING);
    let mut pixels = Array2::from_elem(FRAME, 0.1);
    pixels[(40, 30)] = 100.0;
    let image = Image::new(pixels).unwrap();
    let all = series(Exposures::regular(2, 10.0, 10.0).unwrap());
    let light = (Some(image.clone()), Catalog::new(stars(), Vec::new()));
    let mut frames = frames_of::<f64>(&psf, FRAME, options(), all, light).unwrap();
    for number in 0..2 {
        let exposure = frames.exposure(number, &NoProgress).unwrap();
        let found = image_of(&exposure);
        let chosen = psf.at_state(number as f64).unwrap();
        let simulator = chosen.simulator(FRAME).options(options()).build::<f64>().unwrap();
        let expected = simulator
            .simulate(&Scene::from(&image).with_stars(stars()))
            .unwrap();
        let error = largest_difference(&found.pixels().to_owned(), &expected.pixels().to_owned());
        assert!(error < 2.0 * TOLERANCE, "{number}: {error:e}");
    }
    let three = series(Exposures::regular(3, 10.0, 10.0).unwrap());
    let error = frames_of::<f64>(&psf, FRAME, options(), three, (None, Catalog::default()));
    let message = error.unwrap_err().to_string();
    assert!(
        message.contains("exposure 2 needs the PSF of frame 2"),
        "{message}"
    );
}

#[test]
fn a_series_in_colour_is_the_sum_of_its_spectra() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("sources.csv");
    std::fs::write(
        &path,
        "x,y,flux,vx,vy,teff\n30.3,40.8,100,0,0,3000\n80,60,50,0.4,-0.3,3000\n60.5,20.1,70,0,0,20000\n",
    )
    .unwrap();
    let columns = || CatalogOptions::new().with_velocities(true);
    let catalog = read_catalog_with(&path, &columns().with_colours(true)).unwrap();
    let wavelengths = [0.5, 0.6, 0.7];
    let psf = psf(
        Some((StateKind::Wavelength, &wavelengths)),
        &[1.0, 1.2, 1.4],
        WIDENING,
    );
    let bandpass = Curve::new(vec![0.5, 0.6, 0.7], vec![0.0, 1.0, 0.0]).unwrap();
    let bandpass = Bandpass::new(bandpass);
    let all = Series {
        pointing: Pointing {
            drift_px_per_s: [0.15, -0.1],
            jitter_px: 0.2,
            path: None,
        },
        light_curves: LightCurves::new(&[2.0, 2.0], &[0.0, 100.0], &[1.0, 3.0]).unwrap(),
        ..series(Exposures::regular(2, 10.0, 15.0).unwrap())
    };
    let mut pixels = Array2::from_elem(FRAME, 0.1);
    pixels[(40, 50)] = 60.0;
    let mut light = SceneLight::new();
    light.add_image(Some("blackbody:20000"), pixels.clone()).unwrap();
    light
        .set_catalog_with_spectra(catalog.clone(), None, directory.path())
        .unwrap();
    let names = light.spectra().to_vec();
    assert_eq!(names, ["blackbody:20000", "blackbody:3000"]);
    let of_spectra = light.psf_of(&psf, &bandpass, None).unwrap();
    let mut frames = SeriesFrames::new(&of_spectra, FRAME, options(), all.clone(), light).unwrap();
    // The sources of each spectrum, alone.
    let rows = ["80,60,50,0.4,-0.3\n", "60.5,20.1,70,0,0\n"];
    let lines = [
        "x,y,flux,vx,vy\n1,1,0,0,0\n1,1,0,0,0\n",
        "x,y,flux,vx,vy\n30.3,40.8,100,0,0\n",
    ];
    let alone = |hot: bool| {
        let text = if hot {
            format!("{}{}", lines[0], rows[1])
        } else {
            format!("{}{}", lines[1], rows[0])
        };
        let path = directory.path().join(format!("{hot}.csv"));
        std::fs::write(&path, text).unwrap();
        let options = columns().with_invalid_skipped(true);
        read_catalog_with(&path, &options).unwrap()
    };
    for number in 0..2 {
        let exposure = frames.exposure(number, &NoProgress).unwrap();
        assert_eq!(exposure.scene.layers().len(), 4);
        let found = image_of(&exposure);
        assert_eq!(check_of(&exposure, &found, 100).passed, Some(true));
        let mut expected = Array2::zeros(FRAME);
        for (state, hot) in [(0.0, true), (1.0, false)] {
            let one = of_spectra.at_state(state).unwrap();
            // An image without light moves the sources of the red spectrum as that of the blue one does.
            let image = if hot { pixels.clone() } else { Array2::zeros(FRAME) };
            let light_curves = if hot {
                all.light_curves.clone()
            } else {
                LightCurves::default()
            };
            let one_series = Series {
                light_curves,
                ..all.clone()
            };
            let light = (Some(Image::new(image).unwrap()), alone(hot));
            let mut single = frames_of(&one, FRAME, options(), one_series, light).unwrap();
            let exposure = single.exposure(number, &NoProgress).unwrap();
            expected += &image_of(&exposure).pixels();
        }
        let error = largest_difference(&found.pixels().to_owned(), &expected);
        assert!(error < 10.0 * TOLERANCE, "{number}: {error:e}");
    }
}

#[test]
fn large_stamps_hold_the_trail_of_fast_light() {
    let mut pixels = Array2::zeros(FRAME);
    pixels[(45, 30)] = 100.0;
    let image = Image::new(pixels).unwrap();
    let psf = psf(None, &[1.1], 1.0);
    let drift = Pointing {
        drift_px_per_s: [4.0, 0.0],
        ..Pointing::default()
    };
    let image_with = |stamp_size| {
        let series = Series {
            pointing: drift.clone(),
            ..series(Exposures::regular(1, 10.0, 10.0).unwrap())
        };
        let options = SimulateOptions {
            stamp_size,
            ..options()
        };
        let light = (Some(image.clone()), Catalog::default());
        let mut frames = frames_of::<f64>(&psf, FRAME, options, series, light).unwrap();
        image_of(&frames.exposure(0, &NoProgress).unwrap()).into_pixels()
    };
    let (own, large) = (image_with(None), image_with(Some(1000)));
    assert!((large.sum() - 100.0).abs() < 1e-3, "{}", large.sum());
    let error = largest_difference(&own, &large);
    assert!(error < 2.0 * TOLERANCE, "{error:e}");
}

#[test]
fn a_series_refuses_what_it_cannot_do() {
    let psf = psf(None, &[1.1], 1.0);
    let one = || series(Exposures::regular(1, 10.0, 10.0).unwrap());
    let of = |options, light| SeriesFrames::<f64>::new(&psf, FRAME, options, one(), light);
    let own = SimulateOptions {
        method: Method::Own,
        ..options()
    };
    let error = of(own, SceneLight::new()).unwrap_err();
    assert_eq!(
        (error.kind(), error.setting()),
        (ErrorKind::Setting, Some("method"))
    );
    let mut streamed = SceneLight::new();
    streamed.add_streamed(None);
    let error = of(options(), streamed).unwrap_err();
    assert!(error.to_string().contains("not read row by row"), "{error}");
}
