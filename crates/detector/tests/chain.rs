//! Each step of the chain: steps without random numbers are exact, the others are within their
//! sampling distribution.

mod common;

use common::{NX, NY, PIXELS, assert_within, detector, flat, moments};
use ndarray::{Array2, array};
use psf_detector::{BadPixelMask, CountUnit, Detector, DetectorError, Exposer, PixelFlags, SkyGradient};
use psf_types::{FrameShape, Image};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson};

/// Rounding error of a few sums and products in double precision.
const ROUNDING: f64 = 1e-12;

#[test]
fn a_perfect_detector_gives_back_the_image() {
    let perfect = detector(|_| {});
    assert!(perfect.is_perfect());
    let light = Image::new(array![[0.0_f32, 1.25, 3e30], [7.0, 1e-30, 0.5]]).unwrap();
    let exposure = perfect.expose(&light, 1).unwrap();
    assert_eq!(exposure.counts(), &light);
    assert_eq!(perfect.truth(&light).unwrap(), light);
    assert_eq!(
        (perfect.unit(), perfect.saturation()),
        (CountUnit::Electron, None)
    );
    assert!(exposure.flags().iter().all(|flag| *flag == 0));
    assert!(!detector(|d| d.read_noise_e = 1.0).is_perfect());
}

#[test]
fn read_noise_has_its_mean_and_variance() {
    for sigma in [0.5, 5.0, 250.0] {
        let ccd = detector(|d| d.read_noise_e = sigma);
        let got = moments(ccd.expose(&flat(1000.0), 3).unwrap().counts().pixels());
        let variance = sigma * sigma;
        assert_within("mean", got.mean, 1000.0, sigma / PIXELS.sqrt());
        assert_within(
            "variance",
            got.variance,
            variance,
            variance * (2.0 / PIXELS).sqrt(),
        );
        assert_within(
            "third moment",
            got.third,
            0.0,
            (6.0 * variance.powi(3) / PIXELS).sqrt(),
        );
    }
}

#[test]
fn all_sources_of_noise_add_up() {
    let ccd = detector(|d| {
        d.photon_noise = true;
        d.electrons_per_flux = 3.0;
        d.exposure_s = Some(200.0);
        d.sky_e = 50.0;
        d.dark_e_per_s = 0.1;
        d.read_noise_e = 7.0;
        d.gain_e_per_adu = Some(2.5);
        d.bias_adu = Some(100.0);
    });
    let light = flat(30.0);
    let expected_e: f64 = 3.0 * 30.0 + 50.0 + 20.0;
    let exposure = ccd.expose(&light, 6).unwrap();
    let got = moments(exposure.counts().pixels());
    let variance = (expected_e + 49.0) / 6.25;
    assert_within(
        "mean",
        got.mean,
        expected_e / 2.5 + 100.0,
        (variance / PIXELS).sqrt(),
    );
    // The photons' excess over a normal kurtosis, 1 / m, is far below the tolerance.
    assert_within(
        "variance",
        got.variance,
        variance,
        variance * (2.02 / PIXELS).sqrt(),
    );
    let truth = ccd.truth(&light).unwrap();
    assert!((truth.pixels()[[3, 4]] - (expected_e / 2.5 + 100.0)).abs() < ROUNDING * 100.0);
    assert_eq!(
        (exposure.report().mean_sky_e, exposure.report().dark_e),
        (50.0, 20.0)
    );
    assert_eq!(ccd.unit(), CountUnit::Adu);
}

#[test]
fn the_sky_rises_along_its_gradient() {
    let ccd = detector(|d| {
        d.sky_e = 40.0;
        d.sky_gradient_e_per_px = Some(SkyGradient { x: 0.25, y: -2.0 });
    });
    let light = Image::new(Array2::<f64>::zeros((5, 9))).unwrap();
    let exposure = ccd.expose(&light, 0).unwrap();
    for ((y, x), value) in exposure.counts().pixels().indexed_iter() {
        let expected = 40.0 + 0.25 * (x as f64 - 4.0) - 2.0 * (y as f64 - 2.0);
        assert!((value - expected).abs() < ROUNDING * 40.0);
    }
    let steep = detector(|d| {
        d.sky_e = 1.0;
        d.sky_gradient_e_per_px = Some(SkyGradient { x: 1.0, y: 0.0 });
    });
    assert!(matches!(
        steep.expose(&light, 0),
        Err(DetectorError::NegativeSky {
            lowest_e: -3.0,
            index: [0, 0]
        })
    ));
}

#[test]
fn charge_stops_at_the_full_well() {
    let ccd = detector(|d| {
        d.full_well_e = Some(100.0);
        d.gain_e_per_adu = Some(4.0);
        d.bias_adu = Some(10.0);
    });
    assert_eq!(ccd.saturation(), Some(35.0));
    let light = Image::new(array![[0.0, 99.0, 100.0], [101.0, 1e300, 50.0]]).unwrap();
    let exposure = ccd.expose(&light, 0).unwrap();
    assert_eq!(
        exposure.counts().pixels(),
        array![[10.0, 34.75, 35.0], [35.0, 35.0, 22.5]]
    );
    assert_eq!(exposure.flags(), array![[0, 0, 8], [8, 8, 0]]);
    assert_eq!(exposure.report().saturated_pixels, 3);
    // The noise-free image has no upper limit.
    assert_eq!(ccd.truth(&light).unwrap().pixels()[[1, 0]], 35.25);
}

#[test]
fn converters_clip_at_both_ends() {
    let ccd = detector(|d| {
        d.bias_adu = Some(-3.0);
        d.bits = Some(4);
    });
    assert_eq!(ccd.saturation(), Some(15.0));
    let light = Image::new(array![[0.0_f32, 2.6, 3.6], [17.4, 17.6, 1e9]]).unwrap();
    let exposure = ccd.expose(&light, 0).unwrap();
    assert_eq!(
        exposure.counts().pixels(),
        array![[0.0, 0.0, 1.0], [14.0, 15.0, 15.0]]
    );
    assert_eq!(exposure.flags(), array![[0, 0, 0], [0, 8, 8]]);
    let report = exposure.report();
    assert_eq!((report.saturated_pixels, report.below_zero_pixels), (2, 1));
    // The lower of the two limits determines the saturation.
    let full = detector(|d| {
        d.full_well_e = Some(7.0);
        d.bits = Some(4);
    });
    assert_eq!(full.saturation(), Some(7.0));
}

#[test]
fn digitisation_adds_the_variance_of_rounding() {
    let ccd = detector(|d| {
        d.read_noise_e = 6.0;
        d.gain_e_per_adu = Some(3.0);
        d.bias_adu = Some(1000.3);
        d.bits = Some(16);
    });
    let exposure = ccd.expose(&flat(0.0), 2).unwrap();
    assert!(exposure.counts().pixels().iter().all(|v| v.fract() == 0.0));
    let got = moments(exposure.counts().pixels());
    // Sheppard's correction: 1/12, exact to exp(-2 pi^2 sigma^2) = 1e-34 at sigma = 2.
    let variance = 4.0 + 1.0 / 12.0;
    assert_within("mean", got.mean, 1000.3, (variance / PIXELS).sqrt());
    assert_within(
        "variance",
        got.variance,
        variance,
        variance * (2.0 / PIXELS).sqrt(),
    );
}

#[test]
fn negative_light_keeps_its_mean_and_is_counted() {
    let light = Image::new(array![[-1e-9, 4.0, -0.5], [0.0, 9.0, 2.0]]).unwrap();
    let noiseless = detector(|_| {}).expose(&light, 1).unwrap();
    assert_eq!(noiseless.counts().pixels(), light.pixels());
    let report = noiseless.report();
    assert_eq!(
        (report.pixels, report.negative_pixels, report.lowest_expected_e),
        (6, 2, -0.5)
    );
    // With a sky, no pixel is negative.
    let sky = detector(|d| d.sky_e = 1.0).expose(&light, 1).unwrap();
    assert_eq!(sky.report().negative_pixels, 0);
    assert_eq!(sky.counts().pixels()[[0, 2]], 0.5);

    // Minus a Poisson number: its mean and its variance are the size of the charge.
    let ccd = detector(|d| d.photon_noise = true);
    let faint = Image::new(Array2::from_elem((NY, NX), -0.3)).unwrap();
    let got = moments(ccd.expose(&faint, 2).unwrap().counts().pixels());
    assert_within("mean", got.mean, -0.3, (0.3 / PIXELS).sqrt());
    // The fourth central moment is mean + 3 mean^2.
    assert_within(
        "variance",
        got.variance,
        0.3,
        ((0.3 + 2.0 * 0.09) / PIXELS).sqrt(),
    );
    // Light of both signs keeps its sum. Clipped at 0, it would be 2.0 per pair.
    let both = Array2::from_shape_fn((NY, NX), |(_, x)| if x % 2 == 0 { 2.0 } else { -1.9 });
    let got = moments(
        ccd.expose(&Image::new(both).unwrap(), 3)
            .unwrap()
            .counts()
            .pixels(),
    );
    assert_within("mean of both signs", got.mean, 0.05, (1.95 / PIXELS).sqrt());

    // The converter clips at 0, and the report counts the pixels.
    let digitised = detector(|d| {
        d.photon_noise = true;
        d.bits = Some(16);
    });
    let exposure = digitised.expose(&faint, 2).unwrap();
    assert!(exposure.counts().pixels().iter().all(|count| *count == 0.0));
    let below = 1.0 - (-0.3_f64).exp();
    let clipped = exposure.report().below_zero_pixels as f64 / PIXELS;
    assert_within("clipped", clipped, below, (below * (1.0 - below) / PIXELS).sqrt());
}

#[test]
fn values_that_are_not_finite_are_refused() {
    let ccd = detector(|d| d.electrons_per_flux = 1e10);
    let frame = FrameShape::new(3, 4).unwrap();
    let exposer = ccd.exposer(frame, 0).unwrap();
    let mut rows = Array2::<f64>::zeros((2, 3));
    rows[[1, 2]] = f64::NAN;
    for result in [
        exposer.expose_rows(2, rows.view()).map(drop),
        exposer.truth_rows(2, rows.view()).map(drop),
    ] {
        match result {
            Err(DetectorError::NonFinite { index, value }) => {
                assert!(index == [3, 2] && value.is_nan());
            }
            other => panic!("{other:?}"),
        }
    }
    rows[[1, 2]] = f64::MAX;
    assert!(matches!(
        exposer.expose_rows(0, rows.view()),
        Err(DetectorError::NonFinite { index: [1, 2], .. })
    ));
    let single = Array2::from_elem((1, 3), f32::MAX);
    assert!(matches!(
        exposer.expose_rows(0, single.view()),
        Err(DetectorError::TooLarge {
            index: [0, 0],
            precision: "f32",
            ..
        })
    ));
    assert!(matches!(
        exposer.expose_rows(3, rows.view()),
        Err(DetectorError::Rows { .. })
    ));
    assert!(matches!(
        exposer.expose_rows(0, rows.t()),
        Err(DetectorError::RowWidth { expected: 3, got: 2 })
    ));
    let lower = Image::<f64>::zeros(FrameShape::new(3, 2).unwrap());
    assert!(matches!(exposer.expose(&lower), Err(DetectorError::Rows { .. })));
}

#[test]
fn bad_pixels_have_the_requested_fractions() {
    let ccd = detector(|d| {
        d.exposure_s = Some(10.0);
        d.bias_adu = Some(100.0);
        d.bad_pixels.dead_fraction = 0.01;
        d.bad_pixels.hot_fraction = 0.03;
        d.bad_pixels.hot_dark_e_per_s = 50.0;
        d.bad_pixels.bad_column_fraction = 0.05;
    });
    let exposure = ccd.expose(&flat(7.0), 1).unwrap();
    let report = exposure.report();
    let binomial = |p: f64| (PIXELS * p * (1.0 - p)).sqrt();
    assert_within("dead", report.dead_pixels as f64, 0.01 * PIXELS, binomial(0.01));
    assert_within("hot", report.hot_pixels as f64, 0.03 * PIXELS, binomial(0.03));
    let columns = report.bad_column_pixels / NY;
    assert_eq!(columns * NY, report.bad_column_pixels, "whole columns");
    assert_within(
        "columns",
        columns as f64,
        0.05 * NX as f64,
        (NX as f64 * 0.05 * 0.95).sqrt(),
    );
    for (flag, value) in exposure.flags().iter().zip(exposure.counts().pixels()) {
        let expected = if flag & (PixelFlags::DEAD | PixelFlags::BAD_COLUMN) != 0 {
            100.0
        } else if flag & PixelFlags::HOT != 0 {
            607.0
        } else {
            107.0
        };
        assert_eq!(*value, expected);
    }
    let other = detector(|d| {
        *d = ccd.params().clone();
        d.pattern_seed = 1;
    });
    assert_ne!(other.expose(&flat(7.0), 1).unwrap().flags(), exposure.flags());
}

#[test]
fn mask_pixels_are_added_to_drawn_bad_pixels() {
    let values = array![[1.0_f64, 2.0, 4.0], [0.0, 8.0, 3.0]];
    let mask = BadPixelMask::new(values.view()).unwrap();
    let light = Image::new(Array2::from_elem((2, 3), 5.0)).unwrap();
    let ccd = detector(|d| {
        d.exposure_s = Some(2.0);
        d.bad_pixels.hot_dark_e_per_s = 10.0;
    });
    let exposer = ccd.exposer(light.shape(), 0).unwrap().with_mask(&mask).unwrap();
    let exposure = exposer.expose(&light).unwrap();
    assert_eq!(
        exposure.counts().pixels(),
        array![[0.0, 25.0, 0.0], [5.0, 5.0, 0.0]]
    );
    assert_eq!(exposure.flags(), array![[1, 2, 4], [0, 0, 3]]);
    assert_eq!(exposure.report().bad_pixels, 4);

    let cold = detector(|_| {});
    let error = cold
        .exposer(light.shape(), 0)
        .unwrap()
        .with_mask(&mask)
        .unwrap_err();
    assert!(matches!(
        error,
        DetectorError::Needs {
            other: "bad_pixels.hot_dark_e_per_s",
            ..
        }
    ));
    let wide = Image::<f64>::zeros(FrameShape::new(4, 2).unwrap());
    let error = cold
        .exposer(wide.shape(), 0)
        .unwrap()
        .with_mask(&mask)
        .unwrap_err();
    assert!(
        error.to_string().contains("3 x 2") && error.to_string().contains("4 x 2"),
        "{error}"
    );
    for bad in [-1.0, 16.0, 0.5, f64::NAN] {
        let error = BadPixelMask::new(array![[0.0, bad]].view()).unwrap_err();
        assert!(
            matches!(error, DetectorError::MaskValue { index: [0, 1], .. }),
            "{error}"
        );
    }
}

#[test]
fn the_response_has_the_requested_spread() {
    let rms = 0.02;
    let ccd = detector(|d| d.response_rms = rms);
    let exposed = |seed| ccd.expose(&flat(1000.0), seed).unwrap();
    let got = moments(exposed(1).counts().pixels());
    assert_within("mean", got.mean, 1000.0, 1000.0 * rms / PIXELS.sqrt());
    let variance = (1000.0 * rms).powi(2);
    assert_within(
        "variance",
        got.variance,
        variance,
        variance * (2.0 / PIXELS).sqrt(),
    );
    assert_eq!(
        exposed(1).counts(),
        exposed(2).counts(),
        "the response belongs to the sensor"
    );
    // The dark current does not depend on the response.
    let dark = detector(|d| {
        d.response_rms = rms;
        d.dark_e_per_s = 3.0;
        d.exposure_s = Some(2.0);
    });
    let dark = dark.expose(&flat(0.0), 1).unwrap();
    assert!(dark.counts().pixels().iter().all(|v| *v == 6.0));
}

/// Photons that were drawn one by one are detected as the response says, and not in dead pixels.
#[test]
fn shot_photons_have_the_statistics_of_light() {
    const RUNS: u64 = 12;
    const FLUX: f64 = 6.0;
    let ccd = detector(|params| {
        params.photon_noise = true;
        params.electrons_per_flux = 0.5;
        params.response_rms = 0.2;
        params.bad_pixels.dead_fraction = 0.1;
    });
    let (dark, light) = (flat(0.0), flat(FLUX));
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let poisson = Poisson::new(FLUX * ccd.photons_per_flux()).unwrap();
    let zeros = || Array2::<f64>::zeros(light.pixels().dim());
    let (mut sum, mut squares, mut of_light) = (zeros(), zeros(), zeros());
    for seed in 0..RUNS {
        let photons = zeros().mapv(|_| poisson.sample(&mut rng) as i32);
        let exposer = ccd.exposer(dark.shape(), seed).unwrap();
        let exposure = exposer
            .with_photons(photons.view())
            .unwrap()
            .expose(&dark)
            .unwrap();
        let dead = exposure.flags().mapv(|flag| flag & PixelFlags::DEAD != 0);
        let counts = exposure.counts().pixels().mapv(f64::from);
        assert!(
            counts
                .iter()
                .zip(&dead)
                .all(|(count, dead)| !dead || *count == 0.0)
        );
        sum += &counts;
        squares += &(&counts * &counts);
        of_light += &ccd
            .expose(&light, seed)
            .unwrap()
            .counts()
            .pixels()
            .mapv(f64::from);
    }
    assert_within("mean", sum.sum() / of_light.sum(), 1.0, 4e-4);
    let runs = RUNS as f64;
    let variances = (&squares - &(&sum * &sum / runs)) / (runs - 1.0);
    assert_within("variance", variances.sum() / (sum.sum() / runs), 1.0, 1e-3);
    // In each pixel the mean is that of light.
    let chi_square = sum
        .iter()
        .zip(&of_light)
        .map(|(a, b)| (a - b).powi(2) / (a + b).max(1.0));
    assert_within("pixels", chi_square.sum::<f64>() / PIXELS / 0.9, 1.0, 2e-3);
}

#[test]
fn photons_alone_are_exposed_as_those_on_a_dark_image() {
    let dark = flat(0.0);
    let photons = Array2::from_shape_fn((NY, NX), |(y, x)| ((y + 3 * x) % 5) as i32 - 1);
    let without_sky = detector(|params| params.photon_noise = true);
    let with_sky = detector(|params| {
        params.photon_noise = true;
        params.sky_e = 3.0;
        params.read_noise_e = 2.0;
        params.bad_pixels.dead_fraction = 0.1;
        params.full_well_e = Some(8.0);
    });
    for ccd in [without_sky, with_sky] {
        let exposer = ccd.exposer(dark.shape(), 1).unwrap();
        let exposer = exposer.with_photons(photons.view()).unwrap();
        assert_eq!(exposer.expose_photons().unwrap(), exposer.expose(&dark).unwrap());
    }
}

#[test]
fn photons_need_the_frames_shape_and_photon_noise() {
    fn exposer(ccd: &Detector) -> Exposer<'_> {
        ccd.exposer(flat(0.0).shape(), 1).unwrap()
    }
    let photons = Array2::zeros((NY, NX));
    let quiet = detector(|_| {});
    let refused = exposer(&quiet).with_photons(photons.view());
    assert!(matches!(
        refused,
        Err(DetectorError::Needs {
            other: "photon_noise",
            ..
        })
    ));
    let noisy = detector(|params| params.photon_noise = true);
    assert!(exposer(&noisy).with_photons(photons.view()).is_ok());
    for shape in [(NY, NX + 1), (NY + 1, NX), (NY - 1, NX)] {
        let photons = Array2::zeros(shape);
        assert!(exposer(&noisy).with_photons(photons.view()).is_err(), "{shape:?}");
    }
}
