//! Tests the geometry of scenes and frames, the errors for unsuitable settings, and the warnings.

use ndarray::{Array2, Array3};
use psf_types::{
    Anchor, PointSource, Position, PsfSamples, SamplePositions, SersicProfile, SersicSource, StampGrid,
    ToleranceOn,
};

use super::*;
use crate::scene::ProfileSource;
use crate::simulate_options::{Device, Method, ScenePixels};

fn shape(nx: usize, ny: usize) -> FrameShape {
    FrameShape::new(nx, ny).unwrap()
}

fn at(x: f64, y: f64) -> Position {
    Position::new(x, y).unwrap()
}

fn star(x: f64, y: f64, flux: f64) -> PointSource {
    PointSource::new(at(x, y), flux).unwrap()
}

fn galaxy(x: f64, y: f64, radius: f64) -> SersicSource {
    SersicSource::new(
        at(x, y),
        100.0,
        SersicProfile::new(radius, 1.0, 0.7, 20.0).unwrap(),
    )
    .unwrap()
}

fn ramp(nx: usize, ny: usize) -> Array2<f64> {
    Array2::from_shape_fn((ny, nx), |(y, x)| (10 * y + x) as f64)
}

/// One stamp of 3 x 3 frame pixels for any field. Only its middle pixel is not 0.
fn psf(oversampling: usize) -> Psf {
    let side = 3 * oversampling;
    let grid = StampGrid::new(side, side).and_then(|grid| grid.with_oversampling(oversampling as f64));
    let mut stamps = Array3::zeros((1, side, side));
    stamps[[0, side / 2, side / 2]] = 1.0;
    let positions = SamplePositions::new(vec![Position::of_pixel(0, 0)], None).unwrap();
    PsfSamples::new(stamps, positions, grid.unwrap()).unwrap().into()
}

/// Builds a simulator for scenes of `nx` columns and `ny` rows, in scene pixels.
fn built<T: ConvReal>(
    (nx, ny): (usize, usize),
    options: SimulateOptions,
) -> Result<Simulator<T>, PsfieldError> {
    let options = SimulateOptions {
        device: Device::Cpu,
        ..options
    };
    psf(1).simulator((ny, nx)).options(options).build()
}

fn finer(oversample: usize) -> SimulateOptions {
    SimulateOptions {
        oversample,
        ..SimulateOptions::default()
    }
}

#[test]
fn stars_and_galaxies_are_in_frame_pixels_of_the_scene() {
    let frame = PixelRegion::new(2, 1, shape(10, 8));
    let options = SimulateOptions {
        frame: Some(frame),
        ..finer(3)
    };
    let simulator = built::<f64>((60, 45), options).unwrap();
    // Pixel (3, 1) of the frame has its centre at pixel (10, 4) of the scene, counted from the
    // frame's first pixel.
    assert_eq!(simulator.setup.geometry.sampled_pixel((3, 1)), (10, 4));
    let stars = Scene::dark().with_stars(vec![star(5.0, 2.0, 7.0)]);
    let image = simulator.simulate(&stars).unwrap();
    let mut expected = Array2::zeros((8, 10));
    expected[[1, 3]] = 7.0;
    assert!((&image.pixels() - &expected).iter().all(|d| d.abs() < 1e-12));
    // A galaxy is the same through scenes of any sampling, and adds to the scene's image.
    let galaxies = [galaxy(-1.0, 0.0, 2.0), galaxy(6.2, 4.9, 0.7)];
    let image_of = |oversample, image: Option<f64>, galaxies: &[SersicSource]| {
        let options = SimulateOptions {
            frame: Some(frame),
            ..finer(oversample)
        };
        let (nx, ny) = (20 * oversample, 15 * oversample);
        let scene = match image {
            Some(value) => Scene::new(Array2::from_elem((ny, nx), value)).unwrap(),
            None => Scene::dark(),
        };
        let simulator = built::<f64>((nx, ny), options).unwrap();
        let image = simulator.simulate(&scene.with_galaxies(galaxies)).unwrap();
        image.into_pixels()
    };
    let alone = image_of(1, None, &galaxies);
    assert!(alone.sum() > 90.0, "{}", alone.sum());
    assert_eq!(alone, image_of(3, None, &galaxies));
    let added = image_of(2, Some(1.0), &galaxies) - image_of(2, Some(1.0), &[]);
    assert!((added - alone).iter().all(|v| v.abs() < 1e-10));
}

#[test]
fn a_profile_of_the_callers_own_is_drawn_and_checked_as_a_galaxy() {
    let simulator: Simulator<f64> = psfex(2.0, 1.4).simulator((90, 60)).build().unwrap();
    let galaxies = [galaxy(20.3, 31.8, 2.5), galaxy(40.1, 60.7, 1.2)];
    let own = galaxies.map(|galaxy| ProfileSource {
        point: PointSource::new(galaxy.position(), galaxy.flux()).unwrap(),
        light: Arc::new(sersic::SersicLight::new(&galaxy)),
    });
    let own = Scene::dark().with_profiles(own.to_vec());
    let image = simulator.simulate(&own).unwrap();
    let expected = simulator
        .simulate(&Scene::dark().with_galaxies(&galaxies[..]))
        .unwrap();
    assert_eq!(image.pixels(), expected.pixels());
    let check = simulator.spot_check(&own, &image, (100, 1), &NoProgress).unwrap();
    assert_eq!((check.passed, check.sources), (Some(true), 2));
    assert!(
        !simulator
            .warnings(&own, None)
            .iter()
            .any(|w| matches!(w, SimulationWarning::NoSourceInFrame { .. }))
    );
}

#[test]
fn the_light_of_a_region_is_a_part_of_the_image() {
    let options = SimulateOptions {
        region: Some(PixelRegion::new(7, 2, shape(5, 6))),
        ..SimulateOptions::default()
    };
    let simulator = built::<f64>((20, 15), options).unwrap();
    let whole = Scene::new(ramp(20, 15)).unwrap();
    let image = whole.layers()[0].image().unwrap();
    let (light, first) = simulator.light(image, &whole, &NoProgress).unwrap();
    assert_eq!((light.pixels(), first), (ramp(20, 15).view(), (0, 0)));
    let part = simulator.light_region(&NoProgress).unwrap();
    let light = Image::new(Array2::zeros((part.shape().ny(), part.shape().nx()))).unwrap();
    let at_hand = Scene::from(light);
    let image = at_hand.layers()[0].image().unwrap();
    let (_, first) = simulator.light(image, &at_hand, &NoProgress).unwrap();
    assert_eq!(first, (part.x0() as usize, part.y0() as usize));
}

fn of(error: &PsfieldError) -> (ErrorKind, Option<&'static str>) {
    (error.kind(), error.setting())
}

#[test]
fn what_does_not_fit_is_refused() {
    let frame = |x0, y0, nx, ny| SimulateOptions {
        frame: Some(PixelRegion::new(x0, y0, shape(nx, ny))),
        ..finer(2)
    };
    let refused = |options| built::<f32>((20, 15), options).unwrap_err();
    let error = refused(finer(2));
    assert_eq!(of(&error), (ErrorKind::Data, Some("frame")));
    assert!(error.to_string().contains("must be multiples of 2"), "{error}");
    assert!(built::<f32>((20, 15), frame(0, 0, 10, 7)).is_ok());
    for options in [frame(0, 0, 10, 8), frame(-1, 0, 2, 2)] {
        let error = refused(options);
        assert_eq!(of(&error), (ErrorKind::Setting, Some("frame")));
        assert!(error.cause::<DataError>().is_some());
    }
    let error = refused(frame(i64::MAX, 0, 2, 2));
    assert_eq!(of(&error), (ErrorKind::Setting, Some("frame")));
    assert!(error.to_string().contains("lies outside any scene"), "{error}");

    let single = built::<f32>((20, 15), frame(0, 0, 10, 7)).unwrap();
    let double = built::<f64>((20, 15), frame(0, 0, 10, 7)).unwrap();
    let bright = [star(1.0, 1.0, 1e39)];
    assert!(double.simulate(&Scene::dark().with_stars(&bright[..])).is_ok());
    let error = single
        .simulate(&Scene::dark().with_stars(&bright[..]))
        .unwrap_err();
    assert_eq!(of(&error), (ErrorKind::Data, Some("precision")));
    assert!(error.to_string().starts_with("a flux of 1e39 is"), "{error}");
    let huge = SimulateOptions {
        stamp_size: Some(usize::MAX),
        ..frame(0, 0, 10, 7)
    };
    let huge = built::<f64>((20, 15), huge).unwrap();
    let reaching = [galaxy(1.0, 1.0, 3.0)];
    assert!(huge.simulate(&Scene::dark().with_galaxies(&reaching[..])).is_ok());

    let other = ramp(15, 20);
    let borrowed = Scene::from(ImageView::new(other.view()).unwrap());
    let error = double.simulate(&borrowed).unwrap_err();
    assert!(matches!(error.cause(), Some(DataError::ImageShape { .. })));
    assert!(double.simulate(&Scene::new(other.clone()).unwrap()).is_err());
}

#[test]
fn a_frame_must_lie_in_the_scene() {
    let framed = |x0, y0, nx, ny| {
        let options = SimulateOptions {
            frame: Some(PixelRegion::new(x0, y0, shape(nx, ny))),
            ..SimulateOptions::default()
        };
        built::<f64>((10, 8), options)
    };
    assert!(framed(2, 1, 8, 7).is_ok());
    for (x0, y0, nx, ny) in [(-1, 0, 4, 4), (3, 0, 8, 4), (0, 2, 4, 7), (0, 0, 1 << 40, 1)] {
        let error = framed(x0, y0, nx, ny).unwrap_err();
        assert_eq!(of(&error), (ErrorKind::Setting, Some("frame")));
        assert!(matches!(error.cause(), Some(DataError::FrameOutsideScene { .. })));
    }
}

#[test]
fn sizes_are_checked_before_memory_is_taken() {
    // Builds a simulator for frames of `nx` x `ny` pixels and checks a scene with one star.
    let with_a_star = |nx: usize, ny: usize, s: usize| {
        let simulator = built::<f32>((nx.saturating_mul(s), ny.saturating_mul(s)), finer(s))?;
        let scene = Scene::dark().with_stars(vec![star(1.0, 1.0, 1.0)]);
        simulator.check_scene(&scene)?;
        Ok::<_, PsfieldError>((simulator, scene))
    };
    let side = 1 << 15;
    assert!(with_a_star(side, side, 1).is_ok());
    for (nx, ny, s) in [(side, side, 2), (side, side + 1, 1)] {
        let error = with_a_star(nx, ny, s).map(|_| ()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::TooLarge, "{nx} x {ny}: {error:?}");
    }
    // No memory is allocated for the image either.
    let simulator = built::<f32>((1 << 40, 1 << 10), finer(1)).unwrap();
    let error = simulator.simulate(&Scene::dark()).unwrap_err();
    assert_eq!(of(&error), (ErrorKind::TooLarge, Some("shape")));
    for (nx, ny) in [(0, 5), (5, 0), (0, usize::MAX), (usize::MAX, 3)] {
        let error = built::<f32>((nx, ny), finer(2)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Data, "{error:?}");
    }
    for s in [0, SimulateOptions::MAX_OVERSAMPLE + 1] {
        let error = built::<f32>((5, 5), finer(s)).unwrap_err();
        assert_eq!(of(&error), (ErrorKind::Setting, Some("oversample")));
    }
}

/// A round Gaussian with an FWHM of `fwhm_px` frame pixels, averaged over frame pixels, for any field.
fn gaussian(oversampling: f64, fwhm_px: f64) -> Psf {
    const POINTS: usize = 40;
    let side = (8.0 * fwhm_px * oversampling) as usize / 2 * 2 + 1;
    let sigma = fwhm_px / 2.354_82 * oversampling;
    let along = |i: usize| -> f64 {
        let value = |point: usize| {
            let within = ((point as f64 + 0.5) / POINTS as f64 - 0.5) * oversampling;
            (-0.5 * ((i as f64 - (side / 2) as f64 + within) / sigma).powi(2)).exp()
        };
        (0..POINTS).map(value).sum()
    };
    let stamps = Array3::from_shape_fn((1, side, side), |(_, y, x)| along(y) * along(x));
    let grid = StampGrid::new(side, side).and_then(|grid| grid.with_oversampling(oversampling));
    let positions = SamplePositions::new(vec![Position::of_pixel(0, 0)], None).unwrap();
    PsfSamples::new(stamps, positions, grid.unwrap()).unwrap().into()
}

#[test]
fn warnings_tell_of_coarse_stamps() {
    let warnings = |(oversampling, fwhm_px), s, x, galaxies: Vec<SersicSource>| {
        let psf = gaussian(oversampling, fwhm_px);
        let simulator = psf.simulator((30 * s, 40 * s)).oversample(s);
        let simulator: Simulator<f64> = simulator.device(Device::Cpu).build().unwrap();
        let scene = Scene::dark().with_stars(vec![star(x, 4.0, 1.0)]);
        simulator.warnings(&scene.with_galaxies(galaxies), None)
    };
    let galaxies = vec![galaxy(5.0, 5.0, 3.0)];
    for s in [1, 2, 3] {
        assert!(warnings((1.0, 2.0), s, 7.0, vec![]).is_empty(), "{s}");
        for (x, galaxies) in [(7.25, vec![]), (7.0, galaxies.clone())] {
            let all = warnings((1.0, 2.0), s, x, galaxies);
            let [SimulationWarning::SourcesBetweenPixels(_)] = all[..] else {
                panic!("{s}: {all:?}");
            };
        }
    }
    // The stamps decide, not the factor alone: with 2.5 per pixel the flux depends on the phase.
    for (sampling, coarse) in [
        ((2.0, 2.0), false),
        ((2.5, 2.0), true),
        ((3.0, 2.0), false),
        ((2.0, 1.0), true),
        ((1.5, 4.0), false),
        ((1.0, 4.0), false),
    ] {
        let all = warnings(sampling, 1, 7.25, galaxies.clone());
        assert_eq!(!all.is_empty(), coarse, "{sampling:?}: {all:?}");
    }
}

#[test]
fn samples_that_do_not_determine_the_psf_are_warned_of() {
    // The light of each sample is on another pixel.
    let stamps = Array3::from_shape_fn((25, 5, 5), |(j, y, x)| f64::from(u8::from(5 * y + x == j)));
    let at = (0..25)
        .map(|j| Position::of_pixel(j % 5 * 10, j / 5 * 10))
        .collect();
    let positions = SamplePositions::new(at, None).unwrap();
    let psf: Psf = PsfSamples::new(stamps, positions, StampGrid::new(5, 5).unwrap())
        .unwrap()
        .into();
    let simulator: Simulator<f64> = psf.simulator((50, 50)).device(Device::Cpu).build().unwrap();
    let scene = Scene::dark().with_stars(vec![star(7.0, 4.0, 1.0)]);
    simulator.simulate(&scene).unwrap();
    let warnings = simulator.warnings(&scene, None);
    let [SimulationWarning::Fit(sentence)] = &warnings[..] else {
        panic!("{warnings:?}");
    };
    assert!(sentence.contains("do not determine"), "{sentence}");
    // PSFs that are made from this one hold it, too.
    assert_eq!(psf.fitted().unwrap().fit_warnings(), [sentence.as_str()]);
}

/// A PSFEx model of a frame of 60 x 90 pixels, with stars at x = 3 to 56 and y = 3 to 86.
fn psfex(sampling: f64, sigma_px: f64) -> Psf {
    let axis = |name, pixels: f64| psf_io::PsfexAxis::new(name, (pixels - 1.0) / 2.0, pixels - 7.0).unwrap();
    let (x, y) = (axis("X_IMAGE", 60.0), axis("Y_IMAGE", 90.0));
    let polynomial = psf_io::PsfexPolynomial::new(x, y, 1).unwrap();
    let planes = Array3::from_shape_fn((3, 25, 25), |(term, y, x)| {
        let r2 = ((x as f64 - 12.0).powi(2) + (y as f64 - 12.0).powi(2)) * sampling * sampling;
        let sigma = sigma_px + 0.1 * term as f64;
        [0.2, 0.02, -0.01][term] * (-0.5 * r2 / (sigma * sigma)).exp()
    });
    let model = psf_io::PsfexModel::new(planes, sampling, Some(polynomial)).unwrap();
    crate::psf::record_of_psfex(&model).unwrap().into()
}

#[test]
fn frames_beyond_the_polynomials_of_the_psf_are_warned_of() {
    let psf = psfex(0.4, 0.8);
    let warnings = |psf: &Psf, ny: usize, nx: usize| {
        let simulator: Simulator<f64> = psf.simulator((ny, nx)).device(Device::Cpu).build().unwrap();
        simulator.warnings(&Scene::dark().with_stars(vec![star(7.0, 4.0, 1.0)]), None)
    };
    // The frame of the stars, and one that is a little larger.
    assert!(warnings(&psf, 90, 60).is_empty());
    assert!(warnings(&psf, 92, 59).is_empty());
    for (ny, nx, far) in [
        (60, 90, [33.0 / 53.0, 3.0 / 83.0]),
        (100, 60, [3.0 / 53.0, 13.0 / 83.0]),
    ] {
        let [SimulationWarning::BeyondPolynomial(crate::psf::Extrapolation { beyond, used, .. })] =
            &warnings(&psf, ny, nx)[..]
        else {
            panic!("{ny} x {nx}: no warning");
        };
        assert_eq!(*used, [nx, ny].map(|count| (0.0, (count - 1) as f64)));
        assert!(
            (beyond[0] - far[0]).abs() < 1e-9 && (beyond[1] - far[1]).abs() < 1e-9,
            "{beyond:?}"
        );
    }
    // The PSF also tells of single positions far beyond its polynomials.
    let at = |x: i64, y: i64| psf.extrapolation(&[Position::of_pixel(20, 20), Position::of_pixel(x, y)]);
    assert!(at(58, 88).is_none() && at(70, 20).is_some());
    // With this policy, nothing is extrapolated.
    let record = psf.record().unwrap();
    let nearest = psf_types::PsfModelRecord::new(
        record.basis().clone(),
        record.coefficients().clone(),
        record.interpolation(),
        psf_types::OutsidePolicy::Nearest,
        record.normalisation(),
    );
    assert!(warnings(&nearest.unwrap().into(), 60, 90).is_empty());
}

#[test]
fn a_plan_beyond_its_memory_is_said_to_be_slow() {
    let warnings = |memory| {
        let options = SimulateOptions {
            memory,
            device: Device::Cpu,
            ..SimulateOptions::default()
        };
        let builder = psfex(2.0, 1.0).simulator((90, 60)).options(options);
        let simulator: Simulator<f64> = builder.build().unwrap();
        let scene = Scene::new(Array2::from_elem((90, 60), 1.0)).unwrap();
        simulator.prepare(&scene, &NoProgress).unwrap();
        simulator.warnings(&scene, None)
    };
    let [
        SimulationWarning::MadeAnew {
            made_anew,
            blocks,
            bytes,
        },
    ] = warnings(Some(0))[..]
    else {
        panic!("no warning");
    };
    assert!(made_anew == blocks && bytes > 0);
    assert_eq!(warnings(Some(1 << 24)), []);
    assert_eq!(warnings(None), []);
}

#[test]
fn the_stated_errors_are_those_of_images() {
    /// The phases differ, and the stated errors are those of stamps that fade at their edges.
    const ROOM: f64 = 0.1;
    let simulator: Simulator<f64> = gaussian(2.5, 2.0)
        .simulator((90, 60))
        .device(Device::Cpu)
        .build()
        .unwrap();
    let image_at = |x: f64| {
        let scene = Scene::dark().with_stars(vec![star(x, x, 1.0)]);
        let warnings = simulator.warnings(&scene, None);
        (simulator.simulate(&scene).unwrap(), warnings)
    };
    let mut flux: f64 = 0.0;
    for phase in 0..16 {
        let (image, _) = image_at(30.0 + f64::from(phase) / 16.0);
        flux = flux.max((image.pixels().sum() - 1.0).abs());
    }
    let [SimulationWarning::SourcesBetweenPixels(stated)] = image_at(30.25).1[..] else {
        panic!("no warning");
    };
    assert!(
        flux > 2.5e-4 && (stated.flux / flux - 1.0).abs() < ROOM,
        "{stated:?} {flux:e}"
    );
}

/// A core that varies, and a faint wide halo whose share of the flux varies by 1e-3.
fn varying_halo(rank: psf_basis::RankSelection) -> Psf {
    const SIDE: usize = 65;
    let profile = |x: usize, y: usize, sigma: f64| {
        let square = (x as f64 - 32.0).powi(2) + (y as f64 - 32.0).powi(2);
        (-square / (2.0 * sigma * sigma)).exp() / (std::f64::consts::TAU * sigma * sigma)
    };
    let stamps = Array3::from_shape_fn((9, SIDE, SIDE), |(j, y, x)| {
        let (width, halo) = (0.1 * (j % 3) as f64, 1e-3 * (j / 3) as f64);
        let core = (1.0 - width) * profile(x, y, 2.0) + width * profile(x, y, 2.5);
        (1.0 - halo) * core + halo * profile(x, y, 12.0)
    });
    let positions = (0..9)
        .map(|j| Position::of_pixel(j % 3 * 20, j / 3 * 20))
        .collect();
    let positions = SamplePositions::new(positions, None).unwrap();
    let samples = PsfSamples::new(stamps, positions, StampGrid::new(SIDE, SIDE).unwrap()).unwrap();
    let options = crate::fit::FitOptions {
        rank,
        ..crate::fit::FitOptions::default()
    };
    Psf::new(samples, options)
}

#[test]
fn a_model_that_does_not_keep_the_flux_in_circles_is_warned_of() {
    use psf_basis::RankSelection;
    let warnings = |psf: &Psf, tolerance, tolerance_on| {
        let builder = psf
            .simulator((40, 40))
            .tolerance(tolerance)
            .tolerance_on(tolerance_on);
        let simulator: Simulator<f64> = builder.device(Device::Cpu).build().unwrap();
        let scene = Scene::dark().with_stars(vec![star(7.0, 4.0, 1.0)]);
        simulator.prepare(&scene, &NoProgress).unwrap();
        simulator.warnings(&scene, None)
    };
    let narrow = varying_halo(RankSelection::Fixed(1));
    let file = tempfile::tempdir().unwrap();
    let path = file.path().join("model.fits");
    narrow.fit().unwrap().unwrap().write(&path, &[], false).unwrap();
    for psf in [&narrow, &Psf::open(&path).unwrap()] {
        let [SimulationWarning::FluxInCircles { error, tolerance }] =
            warnings(psf, 1e-4, ToleranceOn::Aperture)[..]
        else {
            panic!("no warning");
        };
        assert!((3e-4..1e-2).contains(&error) && tolerance == 1e-4, "{error:e}");
        assert_eq!(warnings(psf, 1e-2, ToleranceOn::Aperture), []);
        assert_eq!(warnings(psf, 1e-4, ToleranceOn::L2), []);
    }
    let auto = varying_halo(RankSelection::Auto);
    assert_eq!(warnings(&auto, 1e-4, ToleranceOn::Aperture), []);
}

#[test]
fn settings_that_a_method_or_a_model_cannot_follow_are_refused() {
    let on_gpu = SimulateOptions {
        device: Device::Gpu,
        method: Method::Basis,
        ..SimulateOptions::default()
    };
    let refused = psf(1).simulator((10, 10)).options(on_gpu).build::<f32>();
    assert_eq!(refused.unwrap_err().setting(), Some("device"));

    // Without a frame, there is no table of a model's field, which may be the caller's own.
    let own = Psf::from(psf(1).model().unwrap().clone());
    let scene = Scene::new(Array2::from_elem((12, 12), 1.0)).unwrap();
    let image = own.simulator((12, 12)).build::<f64>().unwrap().simulate(&scene);
    assert!(image.is_ok());
    for options in [
        finer(3),
        SimulateOptions {
            stamp_size: Some(5),
            ..SimulateOptions::default()
        },
        SimulateOptions {
            scene_pixels: ScenePixels::Integrated,
            ..SimulateOptions::default()
        },
    ] {
        let simulator = own.simulator((12, 12)).options(options).build::<f64>().unwrap();
        let refused = simulator.simulate(&scene).unwrap_err();
        assert_eq!(refused.kind(), ErrorKind::Format);
        assert!(refused.to_string().contains("state the frame"), "{refused}");
    }
}

#[test]
fn preparation_counts_the_seconds_of_this_call() {
    let simulator = built::<f64>((40, 30), SimulateOptions::default()).unwrap();
    let scene = Scene::new(ramp(40, 30))
        .unwrap()
        .with_stars(vec![star(5.0, 2.0, 7.0)]);
    let first = simulator.prepare(&scene, &NoProgress).unwrap();
    assert!(first.plan_seconds > 0.0);
    let second = simulator.prepare(&scene, &NoProgress).unwrap();
    assert_eq!((second.fit_seconds, second.plan_seconds), (0.0, 0.0));
}

/// Moffat PSFs with oversampled stamps, whose width varies over a frame of 120 x 100 pixels.
fn moffats() -> Psf {
    let (side, s) = (61, 2.0);
    let corners = [(0.0, 0.0), (119.0, 0.0), (0.0, 99.0), (119.0, 99.0), (60.0, 50.0)];
    let mut stamps = Array3::zeros((corners.len(), side, side));
    for ((n, j, i), value) in stamps.indexed_iter_mut() {
        let width = 1.5 + 0.1 * n as f64;
        let (x, y) = ((i as f64 - 30.0) / s, (j as f64 - 30.0) / s);
        *value = (1.0 + (x * x + 1.1 * y * y) / (width * width)).powf(-3.0);
    }
    let positions = corners.map(|(x, y)| at(x, y)).to_vec();
    let positions = SamplePositions::new(positions, None).unwrap();
    let grid = StampGrid::new(side, side).and_then(|grid| grid.with_oversampling(s));
    let grid = grid.unwrap().with_pixel_response_included(true);
    PsfSamples::new(stamps, positions, grid).unwrap().into()
}

/// An image in which one source is off by ten times its tolerance fails, and one in which a pixel is
/// off by ten times what is allowed there.
#[test]
fn the_spot_check_fails_wrong_images() {
    const TOLERANCE: f64 = 1e-3;
    const PIXELS: usize = 40;
    let simulator = moffats().simulator((100, 120)).tolerance(TOLERANCE);
    let simulator: Simulator<f64> = simulator.device(Device::Cpu).build().unwrap();
    let stars: Vec<_> = (0..8)
        .map(|i| star(10.3 + 14.0 * f64::from(i), 20.8 + 3.0 * f64::from(i), 100.0))
        .collect();
    let galaxies: Vec<_> = (0..8)
        .map(|i| galaxy(12.6 + 13.0 * f64::from(i), 60.2 + 3.0 * f64::from(i), 0.5))
        .collect();
    let mut light = Array2::zeros((100, 120));
    light[[90, 20]] = 50.0;
    light[[95, 100]] = 70.0;
    let scenes = [
        Scene::dark()
            .with_stars(stars.clone())
            .with_galaxies(galaxies.clone()),
        Scene::new(light).unwrap().with_stars(stars.clone()),
    ];
    let spot_check = |scene: &Scene<'_, f64>, pixels: Array2<f64>| {
        let image = Image::new(pixels).unwrap();
        simulator
            .spot_check(scene, &image, (PIXELS, 7), &NoProgress)
            .unwrap()
    };
    // The error of a source: its own image, scaled to an L2 norm.
    let wrong = |image: &Array2<f64>, alone: Scene<'_, f64>, flux: f64, position| {
        let own = simulator.simulate(&alone).unwrap().into_pixels();
        let norm = simulator.sources(0).unwrap().psf_norm(position).unwrap();
        let size = own.mapv(|v| v * v).sum().sqrt();
        image + &(own * (10.0 * TOLERANCE * flux * norm / size))
    };
    for scene in &scenes {
        let image = simulator.simulate(scene).unwrap().into_pixels();
        let good = spot_check(scene, image.clone());
        assert_eq!(good.passed, Some(true), "{good:?}");
        assert!(good.sources >= 10 && good.worst_source.unwrap() < 1.0);
        let alone = Scene::dark().with_stars(vec![stars[3]]);
        let check = spot_check(scene, wrong(&image, alone, 100.0, stars[3].position()));
        assert!(
            check.passed == Some(false) && check.worst_source.unwrap() > 1.0,
            "{check:?}"
        );
    }
    let (scene, image) = (&scenes[0], simulator.simulate(&scenes[0]).unwrap().into_pixels());
    let alone = Scene::dark().with_galaxies(vec![galaxies[5]]);
    let check = spot_check(scene, wrong(&image, alone, 100.0, galaxies[5].position()));
    assert!(
        check.passed == Some(false) && check.worst_source.unwrap() > 1.0,
        "{check:?}"
    );

    let mut picker = simulator.picker(scene, (PIXELS, 7));
    picker.pass_rows(image.view());
    let brightest = picker
        .finish()
        .0
        .into_iter()
        .max_by(|a, b| a.value.total_cmp(&b.value))
        .unwrap();
    let mut allowed = simulator.promised(&Scene::dark(), 1).unwrap();
    let place = [(brightest.column, brightest.row)];
    simulator
        .add_errors_of_sources((0, &scene.layers()[0]), &place, &mut allowed)
        .unwrap();
    let mut pixels = image;
    pixels[[brightest.row, brightest.column]] += 10.0 * allowed[0].sum;
    let check = spot_check(scene, pixels);
    assert!(
        check.passed == Some(false) && check.worst_pixel.unwrap() > 5.0,
        "{check:?}"
    );
}

/// Two samples of a Gaussian PSF that includes the pixel response, `sigma` frame pixels wide.
fn gaussian_psf(oversampling: usize, sigma: f64) -> Psf {
    let side = 2 * (7.0 * sigma * oversampling as f64).ceil() as usize + 1;
    let grid = StampGrid::new(side, side).and_then(|grid| grid.with_oversampling(oversampling as f64));
    let square = |i: usize| (i as f64 - (side / 2) as f64).powi(2);
    let width = 2.0 * (sigma * oversampling as f64).powi(2);
    let stamps = Array3::from_shape_fn((2, side, side), |(_, y, x)| {
        (-(square(x) + square(y)) / width).exp()
    });
    let positions = vec![Position::of_pixel(0, 0), Position::of_pixel(50, 50)];
    let positions = SamplePositions::new(positions, None).unwrap();
    PsfSamples::new(stamps, positions, grid.unwrap()).unwrap().into()
}

#[test]
fn light_integrated_over_scene_pixels_is_convolved_with_the_pixel_once() {
    /// The aliasing of the Gaussian, its edges and the margin of the filter, of the peak.
    const AS_ANALYTIC: f64 = 2e-5;
    /// The error of light at pixel centres is above this: the pixel is applied twice.
    const OF_POINTS: f64 = 7e-3;
    const FLUX: f64 = 1e-6;
    /// Points along each axis of a pixel for the integral, whose error is below 1e-5 of the peak.
    const POINTS: usize = 40;
    const SIGMA: f64 = 2.0;
    for (s, sigma_psf) in [(1, 1.5), (2, 1.0), (3, 0.9)] {
        let n = 66;
        let (cx, cy) = (30.3, 33.8);
        // The integral of the source over the pixels along one axis, in pixels of the scene.
        let axis = |centre: f64| -> Vec<f64> {
            let at = |i: usize, p: usize| i as f64 + (p as f64 + 0.5) / POINTS as f64 - 0.5 - centre;
            let value = |t: f64| (-0.5 * (t / SIGMA).powi(2)).exp() / (SIGMA * std::f64::consts::TAU.sqrt());
            (0..n)
                .map(|i| (0..POINTS).map(|p| value(at(i, p))).sum::<f64>() / POINTS as f64)
                .collect()
        };
        let (along_y, along_x) = (axis(cy), axis(cx));
        let light = Array2::from_shape_fn((n, n), |(y, x)| along_y[y] * along_x[x]);
        let scene = Scene::new(light.clone()).unwrap();
        let variance = SIGMA * SIGMA + (sigma_psf * s as f64).powi(2);
        let expected = Array2::from_shape_fn((n / s, n / s), |(y, x)| {
            let at = |i: usize, centre: f64| (s * i) as f64 + (s - 1) as f64 / 2.0 - centre;
            let square = at(x, cx).powi(2) + at(y, cy).powi(2);
            (s * s) as f64 * (-square / (2.0 * variance)).exp() / (std::f64::consts::TAU * variance)
        });
        let peak = expected.iter().fold(0.0, |most: f64, &v| most.max(v));
        let of_samples = gaussian_psf(if s == 1 { 1 } else { 2 * s }, sigma_psf);
        let of_record = Psf::from(of_samples.record().unwrap().clone());
        for (psf, anchor) in [(&of_samples, Anchor::Source), (&of_record, Anchor::Output)] {
            let simulator = |scene_pixels| -> Simulator<f64> {
                let builder = psf.simulator((n, n)).oversample(s).scene_pixels(scene_pixels);
                let builder = builder.tolerance(1e-6).anchor(anchor).device(Device::Cpu);
                builder.build().unwrap()
            };
            let error = |scene_pixels| {
                let image = simulator(scene_pixels).simulate(&scene).unwrap();
                let largest = (&image.pixels() - &expected)
                    .iter()
                    .fold(0.0, |most: f64, v| most.max(v.abs()));
                (largest / peak, (image.pixels().sum() - light.sum()).abs())
            };
            let (integrated, flux) = error(ScenePixels::Integrated);
            let (point, _) = error(ScenePixels::Point);
            println!(
                "oversample {s}, {anchor}: integrated {integrated:.1e}, flux {flux:.1e}, point {point:.1e}"
            );
            assert!(integrated < AS_ANALYTIC, "{s}, {anchor}: {integrated:e}");
            assert!(flux < FLUX, "{s}, {anchor}: {flux:e}");
            assert!(point > OF_POINTS, "{s}, {anchor}: {point:e}");

            let simulator = simulator(ScenePixels::Integrated);
            let image = simulator.simulate(&scene).unwrap();
            let check = simulator
                .spot_check(&scene, &image, (100, 1), &NoProgress)
                .unwrap();
            assert_eq!(check.passed, Some(true));
            let (of_image, random) = (image.pixels().mapv(|v| v * v).sum(), image.view());
            let adjoint = simulator.adjoint(&random, &NoProgress).unwrap().remove(0);
            let of_scene = (&adjoint.pixels() * &light).sum();
            assert!(
                (of_image - of_scene).abs() < 1e-12 * of_image,
                "{of_image} {of_scene}"
            );
        }
    }
}

#[test]
fn sources_do_not_depend_on_the_pixels_of_the_scene() {
    let image = |scene_pixels| {
        let simulator: Simulator<f64> = psf(2)
            .simulator((30, 40))
            .scene_pixels(scene_pixels)
            .device(Device::Cpu)
            .build()
            .unwrap();
        let scene = Scene::dark().with_stars(vec![star(5.25, 2.0, 7.0)]);
        let scene = scene.with_galaxies(vec![galaxy(20.0, 15.0, 2.0)]);
        simulator.simulate(&scene).unwrap().into_pixels()
    };
    assert_eq!(image(ScenePixels::Point), image(ScenePixels::Integrated));
}

#[test]
fn psfs_without_flux_have_no_tolerance_on_apertures() {
    let mut stamps = Array3::zeros((1, 3, 3));
    stamps[[0, 1, 0]] = -1.0;
    stamps[[0, 1, 2]] = 1.0;
    let grid = StampGrid::new(3, 3).unwrap();
    let basis = psf_types::PsfBasis::new(None, stamps / 2.0_f64.sqrt(), grid).unwrap();
    let coefficients = psf_types::SampleCoefficients::new(
        Array2::from_elem((1, 1), 1.0),
        SamplePositions::new(vec![Position::of_pixel(0, 0)], None).unwrap(),
    );
    let record = psf_types::PsfModelRecord::new(
        basis,
        coefficients.unwrap(),
        psf_types::Interpolation::Nearest,
        psf_types::OutsidePolicy::Nearest,
        psf_types::Normalisation::Keep,
    );
    let psf = Psf::from(record.unwrap());
    let image = |scene: Scene<'_, f64>, on| {
        let simulator = psf.simulator((10, 12)).tolerance_on(on).device(Device::Cpu);
        let simulator: Simulator<f64> = simulator.build().unwrap();
        simulator.simulate(&scene).map(|image| image.pixels()[[5, 5]])
    };
    let of_image = || Scene::new(ramp(12, 10)).unwrap();
    for scene in [of_image(), Scene::dark().with_stars(vec![star(5.0, 4.0, 1.0)])] {
        let error = image(scene, ToleranceOn::Aperture).unwrap_err();
        assert_eq!(of(&error), (ErrorKind::Setting, Some("tolerance_on")), "{error}");
    }
    assert!((image(of_image(), ToleranceOn::L2).unwrap().abs() - 2.0_f64.sqrt()).abs() < 1e-9);
}

/// Images of many scenes, with and without light, stars and galaxies, are those of single scenes.
#[test]
fn many_scenes_give_the_images_of_single_ones() {
    #[derive(Debug, Default)]
    struct Counts(std::sync::atomic::AtomicU64);
    impl Progress for Counts {
        fn start(&self, _: u64) {}
        fn advance(&self, steps: u64) {
            self.0.fetch_add(steps, std::sync::atomic::Ordering::Relaxed);
        }
    }
    let builder = psfex(1.0, 1.4).simulator((90, 60)).device(Device::Cpu);
    let simulator: Simulator<f64> = builder.build().unwrap();
    let scene = |n: usize| {
        let light = (n != 2).then(|| ramp(60, 90) * (1.0 + n as f64));
        let scene = light.map_or_else(Scene::dark, |light| Scene::new(light).unwrap());
        scene.with_stars(vec![star(20.3 + n as f64, 41.7, 5e4)])
    };
    for numbers in [vec![0, 1, 3, 4, 5, 6, 7], vec![0, 1, 2, 3, 4, 5]] {
        let scenes: Vec<_> = numbers.iter().map(|&n| scene(n)).collect();
        let images = simulator.simulate_many(&scenes).unwrap();
        for (image, scene) in images.iter().zip(&scenes) {
            assert_eq!(image.pixels(), simulator.simulate(scene).unwrap().pixels());
        }
        let mut again: Vec<_> = scenes.iter().map(|_| simulator.zeros()).collect();
        let progress = Counts::default();
        let views = again.iter_mut().map(|image| image.view_mut()).collect();
        simulator.simulate_many_into(&scenes, views, &progress).unwrap();
        assert_eq!(progress.0.into_inner(), scenes.len() as u64);
        assert_eq!(again[0].view(), images[0].pixels());
    }
    let mut wrong = [simulator.zeros(), Array2::zeros((3, 4))];
    let views = wrong.iter_mut().map(|image| image.view_mut()).collect();
    let refused = simulator.simulate_many_into(&[scene(0), scene(1)], views, &NoProgress);
    assert!(refused.is_err());
}

#[test]
fn a_simulator_for_another_psf_keeps_the_tolerance() {
    let of = |psf: Psf| -> Simulator<f64> {
        let builder = psf.simulator((90, 60)).device(Device::Cpu).tolerance(1e-4);
        builder.build().unwrap()
    };
    let scene = Scene::new(ramp(60, 90)).unwrap();
    let image = |simulator: &Simulator<f64>| simulator.simulate(&scene).unwrap().into_pixels();
    let first = of(psfex(1.0, 1.4));
    let kept = first.with_psf(psfex(1.0, 2.0), &NoProgress).unwrap();
    let (kept, new, old) = (image(&kept), image(&of(psfex(1.0, 2.0))), image(&first));
    let largest = |a: &Array2<f64>, b: &Array2<f64>| (a - b).fold(0.0, |m: f64, d| m.max(d.abs()));
    let peak = new.fold(0.0, |m: f64, v| m.max(v.abs()));
    // Each plan may differ by the tolerance.
    assert!(largest(&kept, &new) < 2e-4 * peak);
    assert!(largest(&kept, &old) > 2e-3 * peak, "the PSFs must differ");
}
