//! Tests the geometry of scenes and frames, the errors for unsuitable settings, and the warnings.

use ndarray::{Array2, Array3, s};
use psf_types::{Position, PsfSamples, SamplePositions, SersicProfile, SersicSource, StampGrid};

use super::*;
use crate::ErrorKind;
use crate::Method;

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
fn everything_is_in_pixels_of_the_padded_scene() {
    let frame = PixelRegion::new(2, 1, shape(10, 8));
    let options = SimulateOptions {
        frame: Some(frame),
        ..finer(3)
    };
    let simulator = built::<f64>((60, 45), options).unwrap();
    let galaxies = vec![galaxy(-1.0, 0.0, 2.0)];
    let stars = Scene::dark().with_stars(vec![star(5.0, 2.0, 7.0)]);
    let padding = simulator.padding(&stars.clone().with_galaxies(&galaxies[..]));
    assert_eq!(padding, 12);
    let geometry = simulator.geometry;
    assert_eq!(geometry.padded_shape(padding).unwrap(), shape(60 + 24, 45 + 24));
    let expected = PixelRegion::new(2 * 3 + 12, 3 + 12, shape(30, 24));
    assert_eq!(geometry.fine_frame(padding).unwrap(), expected);
    let fine = geometry.fine_galaxies(&galaxies, padding).unwrap();
    assert_eq!(fine[0].position(), at(10.0, 13.0));
    assert_eq!(fine[0].profile().half_light_radius_px(), 6.0);
    // Pixel (3, 1) of the frame has its centre at pixel (10, 4) of the scene, counted from the
    // frame's first pixel.
    assert_eq!(geometry.sampled_pixel((3, 1)), (10, 4));
    let image = simulator.simulate(&stars).unwrap();
    let mut expected = Array2::zeros((8, 10));
    expected[[1, 3]] = 7.0;
    assert!((&image.pixels() - &expected).iter().all(|d| d.abs() < 1e-12));
    // A scene without galaxies needs no padding, because stars outside the frame are drawn without
    // it.
    assert_eq!(simulator.padding(&stars), 0);
    assert_eq!(geometry.padded_shape(0).unwrap(), shape(60, 45));
}

#[test]
fn owned_and_borrowed_images_give_the_same_light() {
    let (nx, ny) = (20, 15);
    for (galaxies, stamp_size) in [
        (vec![], 3),
        (vec![galaxy(4.0, 3.0, 2.5)], 1),
        (vec![galaxy(-2.0, 3.0, 2.5)], 3),
    ] {
        let options = SimulateOptions {
            stamp_size: Some(stamp_size),
            method: Method::Direct,
            ..SimulateOptions::default()
        };
        let simulator = built::<f64>((nx, ny), options.clone()).unwrap();
        let image = ramp(nx, ny);
        let borrowed = Scene::from(ImageView::new(image.view()).unwrap());
        let borrowed = borrowed
            .with_stars(vec![star(3.0, 3.0, 2.0)])
            .with_galaxies(&galaxies[..]);
        let owned = Scene::new(image.clone()).unwrap().with_galaxies(&galaxies[..]);
        let convolver = simulator.convolver(&borrowed, &NoProgress).unwrap();
        let light_of = |scene: &Scene<'_, f64>| {
            let (light, first) = simulator.light(scene, convolver, &NoProgress).unwrap();
            assert_eq!(first, (0, 0));
            // A scene that is only an image is not copied.
            let of_image = scene.image().map(|image| image.pixels().as_ptr());
            assert_eq!(of_image == Some(light.pixels().as_ptr()), galaxies.is_empty());
            light.pixels().to_owned()
        };
        let mut light = light_of(&borrowed);
        assert_eq!(light_of(&owned), light);
        let p = convolver.padding;
        assert_eq!(light.dim(), (ny + 2 * p, nx + 2 * p));

        // The light that reaches a region is a part of the scene's light.
        let planned = SimulateOptions {
            method: Method::Auto,
            region: Some(PixelRegion::new(7, 2, shape(5, 6))),
            ..options
        };
        let planned = built::<f64>((nx, ny), planned).unwrap();
        let convolver = planned.convolver(&owned, &NoProgress).unwrap();
        let (part, (x, y)) = planned.light(&owned, convolver, &NoProgress).unwrap();
        let (rows, columns) = part.pixels().dim();
        assert_eq!(part.pixels(), light.slice(s![y..y + rows, x..x + columns]));
        assert_eq!(rows < light.nrows(), !galaxies.is_empty());

        // Subtract the image: the galaxies' light remains.
        light.slice_mut(s![p..p + ny, p..p + nx]).scaled_add(-1.0, &image);
        // This is the flux of the galaxies inside the padded scene.
        let flux = light.sum();
        assert!(
            if galaxies.is_empty() {
                flux == 0.0
            } else {
                (30.0..100.0).contains(&flux)
            },
            "{flux}"
        );
        // Without an image, the light is only the galaxies' light.
        let dark = Scene::dark().with_galaxies(&galaxies[..]);
        assert_eq!(has_extended_light(&dark), !galaxies.is_empty());
        if has_extended_light(&dark) {
            // Rounding of the sums above, with values up to 160.
            assert!((&light_of(&dark) - &light).iter().all(|d: &f64| d.abs() < 1e-12));
        }
    }
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
    // A padding that no memory can hold is an error, not an overflow.
    assert!(matches!(
        double.geometry.padded_shape(usize::MAX),
        Err(DataError::FrameTooLarge { .. })
    ));
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
        simulator.check_sources(&scene, false)?;
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

#[test]
fn warnings_tell_of_stars_between_pixels_and_blurred_galaxies() {
    use SimulationWarning::{BlurredGalaxies, StarsBetweenPixels};
    let warnings = |oversampling, s, x, radius| {
        let simulator = psf(oversampling).simulator((30 * s, 40 * s)).oversample(s);
        let simulator: Simulator<f64> = simulator.device(Device::Cpu).build().unwrap();
        let scene = Scene::dark().with_stars(vec![star(x, 4.0, 1.0)]);
        simulator.warnings(&scene.with_galaxies(vec![galaxy(5.0, 5.0, radius)]))
    };
    let between = |s, x| {
        warnings(1, s, x, 3.0)
            .iter()
            .any(|w| matches!(w, StarsBetweenPixels { .. }))
    };
    for s in [1, 2, 3] {
        assert!(!between(s, 7.0), "{s}");
        assert!(between(s, 7.25), "{s}");
    }
    // With fewer than 4 scene pixels along a frame pixel, all galaxies are blurred. With 4 or more,
    // only galaxies with a half-light radius below two scene pixels.
    for s in [1, 2, 3] {
        assert_eq!(warnings(1, s, 7.0, 30.0), [BlurredGalaxies { count: 1 }], "{s}");
    }
    assert_eq!(warnings(1, 4, 7.0, 0.49), [BlurredGalaxies { count: 1 }]);
    assert!(warnings(1, 4, 7.0, 0.51).is_empty());
    let both = warnings(1, 1, 7.25, 1.9);
    assert!(
        matches!(
            both[..],
            [StarsBetweenPixels { .. }, BlurredGalaxies { count: 1 }]
        ),
        "{both:?}"
    );
    assert!(warnings(2, 4, 7.25, 3.0).is_empty());
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
    crate::record_of_psfex(&model).unwrap().into()
}

#[test]
fn frames_beyond_the_polynomials_of_the_psf_are_warned_of() {
    let psf = psfex(0.4, 0.8);
    let warnings = |psf: &Psf, ny: usize, nx: usize| {
        let simulator: Simulator<f64> = psf.simulator((ny, nx)).device(Device::Cpu).build().unwrap();
        simulator.warnings(&Scene::dark().with_stars(vec![star(7.0, 4.0, 1.0)]))
    };
    // The frame of the stars, and one that is a little larger.
    assert!(warnings(&psf, 90, 60).is_empty());
    assert!(warnings(&psf, 92, 59).is_empty());
    for (ny, nx, far) in [
        (60, 90, [33.0 / 53.0, 3.0 / 83.0]),
        (100, 60, [3.0 / 53.0, 13.0 / 83.0]),
    ] {
        let [SimulationWarning::BeyondPolynomial { beyond, frame, .. }] = &warnings(&psf, ny, nx)[..] else {
            panic!("{ny} x {nx}: no warning");
        };
        assert_eq!(*frame, [nx, ny]);
        assert!(
            (beyond[0] - far[0]).abs() < 1e-9 && (beyond[1] - far[1]).abs() < 1e-9,
            "{beyond:?}"
        );
    }
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
fn the_flux_of_undersampled_stars_is_stated_over_their_phases() {
    /// Rounding of sums over a stamp.
    const ROUNDING: f64 = 1e-6;
    // Stars much narrower than a pixel: the flux on the pixels depends on the phase.
    let simulator: Simulator<f64> = psfex(0.7, 0.35)
        .simulator((90, 60))
        .device(Device::Cpu)
        .build()
        .unwrap();
    let flux_at = |dx: f64, dy: f64| {
        let scene = Scene::dark().with_stars(vec![star(30.0 + dx, 45.0 + dy, 1.0)]);
        (
            simulator.simulate(&scene).unwrap().pixels().sum(),
            simulator.warnings(&scene),
        )
    };
    let mut range = (f64::INFINITY, f64::NEG_INFINITY);
    for i in 0..16 {
        let (flux, _) = flux_at(f64::from(i % 4) / 4.0, f64::from(i / 4) / 4.0);
        range = (range.0.min(flux), range.1.max(flux));
    }
    let [SimulationWarning::StarsBetweenPixels { flux: Some(stated) }] = &flux_at(0.25, 0.0).1[..] else {
        panic!("no warning");
    };
    assert!(
        (stated.0 - range.0).abs() < ROUNDING && (stated.1 - range.1).abs() < ROUNDING,
        "{stated:?} {range:?}"
    );
    assert!(range.1 - range.0 > 0.01, "{range:?}");
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

    // A model with the caller's own coefficient field cannot be resampled to another grid.
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
    ] {
        let simulator = own.simulator((12, 12)).options(options).build::<f64>().unwrap();
        let refused = simulator.simulate(&scene).unwrap_err();
        assert_eq!(refused.kind(), ErrorKind::Setting);
        assert!(refused.to_string().contains("cannot be resampled"), "{refused}");
    }
}

#[test]
fn preparation_counts_the_seconds_of_this_call() {
    let simulator = built::<f64>((40, 30), SimulateOptions::default()).unwrap();
    let scene = Scene::new(ramp(40, 30))
        .unwrap()
        .with_stars(vec![star(5.0, 2.0, 7.0)]);
    let first = simulator.prepare(&scene, false, &NoProgress).unwrap();
    assert!(first.plan_seconds > 0.0);
    let second = simulator.prepare(&scene, false, &NoProgress).unwrap();
    assert_eq!((second.fit_seconds, second.plan_seconds), (0.0, 0.0));
}
