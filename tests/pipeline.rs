//! From a telescope to an image, through files and on any number of threads.

use std::sync::Arc;

use integration_tests::{relative_l2, small_telescope, small_telescope_params, test_scene, uniform_samples};
use psfield::evaluate::{EvaluateOptions, OutputGrid, evaluate};
use psfield::fit::fit;
use psfield::psf_basis::{Centring, RankSelection};
use psfield::psf_io::{Precision, read_model, read_samples, write_model, write_samples};
use psfield::psf_sample::{AdaptiveSampling, DifferenceMeasure, InterpolationError, SamplingMethod};
use psfield::psf_types::{Image, Interpolation, NoProgress, PointSource, Position};
use psfield::{FitOptions, Psf, Scene};

fn simulated(psf: &Psf, scene: &Scene<'_>) -> Image<f64> {
    let simulator = psf.simulator((120, 160)).build().unwrap();
    simulator.simulate(scene).unwrap()
}

fn image(psf: &Psf) -> Image<f64> {
    simulated(psf, &test_scene(160, 120, 0).into())
}

#[test]
fn a_round_trip_through_files_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let samples = uniform_samples(&small_telescope(1), 9, 7);
    let here = image(&samples.clone().into());

    let path = folder.path().join("samples.fits");
    write_samples(&path, &samples, &[], Precision::Double, false).unwrap();
    assert_eq!(image(&Psf::open(&path).unwrap()), here);
    write_samples(&path, &samples, &[], Precision::Single, true).unwrap();
    let single = Psf::from(read_samples(&path).unwrap());
    assert!(relative_l2(&image(&single), &here) < 1e-6);

    let fitted = fit(samples, &FitOptions::default()).unwrap();
    let path = folder.path().join("model.fits");
    write_model(&path, fitted.record(), fitted.singular_values(), &[], false).unwrap();
    assert_eq!(&read_model(&path).unwrap(), fitted.record());
    assert_eq!(image(&Psf::open(&path).unwrap()), here);
}

#[test]
fn the_number_of_threads_does_not_matter_from_end_to_end() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let telescope = psfield::psf_optics::Telescope::new(small_telescope_params()).unwrap();
            let criterion = InterpolationError::new(0.02, DifferenceMeasure::L2).unwrap();
            let sampling = AdaptiveSampling::new(Arc::new(criterion))
                .with_start(3, 3)
                .unwrap();
            let samples = sampling.sample(&telescope, &NoProgress).unwrap().samples;
            let star = PointSource::new(Position::new(50.3, 70.9).unwrap(), 40.0).unwrap();
            let scene = Scene::from(test_scene(160, 120, 0)).with_stars(vec![star]);
            simulated(&samples.into(), &scene)
        })
    };
    let one = run(1);
    for threads in [2, 4] {
        assert!(run(threads) == one, "{threads} threads");
    }
}

/// An oversampled telescope convolves an image like the telescope sampled at the frame's pixels.
#[test]
fn oversampled_psfs_image_a_scene_on_the_frame_s_pixels() {
    let native = image(&uniform_samples(&small_telescope(1), 9, 7).into());
    let fine = Psf::from(uniform_samples(&small_telescope(3), 9, 7));
    let model = Psf::from(fine.record().unwrap().clone());
    // A 72-pixel stamp, three times oversampled, covers 24 pixels like the native one.
    for (name, fine, limit) in [("samples", fine, 2e-5), ("a model", model, 2e-4)] {
        let error = relative_l2(&image(&fine), &native);
        println!("from {name}: {error:.1e}");
        assert!(error < limit, "{name}: {error}");
    }
}

#[test]
fn evaluation_follows_its_options() {
    let telescope = small_telescope(3);
    let psf = Psf::from(uniform_samples(&telescope, 5, 5));
    let model = psf.model().unwrap();
    let at = vec![
        Position::new(40.25, 30.75).unwrap(),
        Position::new(100.0, 90.0).unwrap(),
    ];
    let stamps = |options| evaluate(model, at.clone(), options).unwrap();
    let own = stamps(EvaluateOptions::default());
    assert_eq!(own.grid(), model.grid());
    assert_eq!(own.stamp(0), model.psf_at(at[0]).unwrap().values());

    let native = EvaluateOptions {
        grid: OutputGrid::Native,
        ..EvaluateOptions::default()
    };
    let centred = stamps(native);
    assert_eq!((centred.grid().nx(), centred.grid().oversampling()), (24, 1.0));
    assert!((centred.stamp(1)[[12, 12]] - own.stamp(1)[[36, 36]]).abs() < 1e-15);

    let phased = stamps(EvaluateOptions {
        sub_pixel: true,
        ..native
    });
    // The position (40.25, 30.75) is a quarter pixel right of pixel column 40 and a quarter above
    // row 31.
    let centroid = |stamp: ndarray::ArrayView2<'_, f64>| {
        let (mut x, mut y, mut sum) = (0.0, 0.0, 0.0);
        for ((row, column), v) in stamp
            .indexed_iter()
            .filter(|((r, c), _)| (6..18).contains(r) && (6..18).contains(c))
        {
            (x, y, sum) = (x + v * column as f64, y + v * row as f64, sum + v);
        }
        (x / sum, y / sum)
    };
    let (before, after) = (centroid(centred.stamp(0)), centroid(phased.stamp(0)));
    assert!(
        (after.0 - before.0 - 0.25).abs() < 0.02 && (after.1 - before.1 + 0.25).abs() < 0.02,
        "{before:?} {after:?}"
    );
    assert_eq!(phased.stamp(1), centred.stamp(1));

    let cut = stamps(EvaluateOptions {
        size: Some(9),
        ..native
    });
    assert_eq!(cut.stamp(1), centred.stamp(1).slice(ndarray::s![8..17, 8..17]));
}

/// A lit pixel and a star on that pixel give equal images, even if truncation changes the flux of a
/// PSF. The PSF at the position is scaled to unit flux, not the samples that it is interpolated
/// from.
#[test]
fn a_truncated_uncentred_model_images_pixels_and_stars_alike() {
    let options = FitOptions {
        rank: RankSelection::Fixed(2),
        centring: Centring::None,
        // Its cells are exact, so that the pixel and the star have the same PSF.
        interpolation: Interpolation::Bilinear,
        ..FitOptions::default()
    };
    let fitted = fit(uniform_samples(&small_telescope(3), 5, 4), &options).unwrap();
    let psf = Psf::from(fitted.record().clone());
    let (x, y) = (37, 71);
    let mut light = ndarray::Array2::<f64>::zeros((120, 160));
    light[[y, x]] = 1.0;
    let pixel = simulated(&psf, &Scene::new(light).unwrap());
    let star = PointSource::new(Position::of_pixel(x as i64, y as i64), 1.0).unwrap();
    let star = simulated(&psf, &Scene::dark().with_stars(vec![star]));
    // The pixel's and the star's image are each scaled by the flux of the PSF on their own pixels.
    // For a truncated PSF these fluxes differ slightly.
    let (flux, stars_flux) = (pixel.pixels().sum(), star.pixels().sum());
    assert!(
        (flux - 1.0).abs() < 1e-12 && (stars_flux - 1.0).abs() < 1e-3,
        "{flux} {stars_flux}"
    );
    let star = Image::new(star.pixels().mapv(|v| v / stars_flux)).unwrap();
    let error = relative_l2(&pixel, &star);
    println!("pixel against star: {error:.1e}");
    assert!(error < 1e-12, "{error}");
}
