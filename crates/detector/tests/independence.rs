//! Seeds, threads, and the independence of pixels.

mod common;

use common::{NX, NY, PIXELS, SIGMAS, correlation, detector, flat};
use ndarray::{Array2, s};
use psf_detector::Detector;

fn everything() -> Detector {
    detector(|d| {
        d.photon_noise = true;
        d.exposure_s = Some(10.0);
        d.sky_e = 20.0;
        d.sky_gradient_e_per_px = Some(psf_detector::SkyGradient { x: 0.01, y: -0.01 });
        d.dark_e_per_s = 0.3;
        d.response_rms = 0.02;
        d.full_well_e = Some(60.0);
        d.read_noise_e = 3.0;
        d.gain_e_per_adu = Some(1.7);
        d.bias_adu = Some(4.0);
        d.bits = Some(12);
        d.bad_pixels.dead_fraction = 0.001;
        d.bad_pixels.hot_fraction = 0.002;
        d.bad_pixels.hot_dark_e_per_s = 5.0;
        d.bad_pixels.bad_column_fraction = 0.003;
    })
}

#[test]
fn the_same_seed_gives_the_same_bytes_for_any_number_of_threads() {
    let (ccd, light) = (everything(), flat(15.0));
    let exposed = |threads, seed| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| ccd.expose(&light, seed).unwrap())
    };
    let one = exposed(1, 11);
    for threads in [2, 7] {
        assert_eq!(exposed(threads, 11), one, "{threads} threads");
    }
    assert_ne!(exposed(2, 12).counts(), one.counts());
    // Bad pixels belong to the sensor, not to the exposure.
    assert_eq!(exposed(2, 12).report().bad_pixels, one.report().bad_pixels);
}

#[test]
fn bands_of_any_height_equal_the_whole_image() {
    let (ccd, light) = (everything(), flat(15.0));
    let whole = ccd.expose(&light, 3).unwrap();
    let exposer = ccd.exposer(light.shape(), 3).unwrap();
    let mut report = None;
    let mut first = 0;
    for height in [1, 96, 400, 500] {
        let rows = s![first..first + height, ..];
        let band = exposer.expose_rows(first, light.pixels().slice(rows)).unwrap();
        assert_eq!(band.counts, whole.counts().pixels().slice(rows));
        assert_eq!(band.flags, whole.flags().slice(rows));
        match &mut report {
            None => report = Some(band.report),
            Some(report) => report.add(&band.report),
        }
        first += height;
    }
    assert_eq!(first, NY);
    assert_eq!(report.as_ref(), Some(whole.report()));
}

/// The largest absolute correlation of independent images.
fn by_chance() -> f64 {
    SIGMAS / PIXELS.sqrt()
}

fn noise(seed: u64, photons: bool) -> Array2<f64> {
    let ccd = detector(|d| {
        d.photon_noise = photons;
        d.read_noise_e = if photons { 0.0 } else { 3.0 };
    });
    ccd.expose(&flat(14.0), seed).unwrap().into_counts().into_pixels()
}

#[test]
fn neighbours_and_rows_are_not_correlated() {
    for photons in [true, false] {
        let noise = noise(5, photons);
        for (dy, dx) in [(0, 1), (1, 0), (1, 1), (0, 2), (2, 0), (3, 5), (64, 0), (0, 64)] {
            let a = noise.slice(s![..NY - dy, ..NX - dx]);
            let b = noise.slice(s![dy.., dx..]);
            let r = correlation(a, b);
            assert!(r.abs() < by_chance() * 1.1, "lag ({dy}, {dx}): {r}");
        }
    }
}

#[test]
fn seeds_and_steps_are_not_correlated() {
    let photons: Vec<_> = (0..4).map(|seed| noise(seed, true)).collect();
    for (i, a) in photons.iter().enumerate() {
        for b in &photons[..i] {
            assert!(correlation(a.view(), b.view()).abs() < by_chance());
        }
        let read = noise(i as u64, false);
        assert!(correlation(a.view(), read.view()).abs() < by_chance());
        // The test can fail: images with common noise are correlated.
        assert!(correlation(a.view(), (a + &read).view()) > 100.0 * by_chance());
    }
}

#[test]
fn read_noise_does_not_change_the_photons() {
    let photons = noise(21, true);
    let both = detector(|d| {
        d.photon_noise = true;
        d.read_noise_e = 3.0;
    });
    let both = both.expose(&flat(14.0), 21).unwrap().into_counts().into_pixels();
    let read = noise(21, false) - 14.0;
    let rest = (&both - &photons - &read).mapv(f64::abs);
    assert!(rest.iter().all(|v| *v < 1e-12));
}
