//! Seeing, blur and flux in their limiting cases.

mod common;

use common::{draw, moments, peak, perfect};
use ndarray::{Array2, ArrayView2};
use psf_optics::{SeeingParams, TelescopeParams};

/// Full width at half maximum along the row of the centre, by linear interpolation.
fn fwhm_of_row(stamp: ArrayView2<'_, f64>) -> f64 {
    let (ny, nx) = stamp.dim();
    let row = stamp.row(ny / 2);
    let half = row[nx / 2] / 2.0;
    let crossing = |step: isize| {
        let at = |i: isize| row[(nx as isize / 2 + i * step) as usize];
        let i = (0..nx as isize / 2 - 1).find(|&i| at(i + 1) < half).unwrap();
        i as f64 + (at(i) - half) / (at(i) - at(i + 1))
    };
    crossing(1) + crossing(-1)
}

/// A 4 m telescope in bad seeing: diffraction is negligible in comparison.
fn seeing_limited(seeing: SeeingParams) -> TelescopeParams {
    let mut params = perfect(0.1, 160);
    params.aperture.diameter_m = 4.0;
    params.seeing = Some(seeing);
    params
}

const KOLMOGOROV: SeeingParams = SeeingParams {
    r0_m: Some(0.05),
    fwhm_arcsec: None,
    at_wavelength_nm: 500.0,
    outer_scale_m: None,
};

/// The profile is widened by the aperture (1 %) and by the interpolation of the crossing.
const SEEING_FWHM: f64 = 1e-2;
/// Tokovinin's formula is a fit, accurate to 1 per cent.
const OUTER_SCALE_FWHM: f64 = 2e-2;

#[test]
fn seeing_has_the_kolmogorov_width() {
    let lambda_over_r0 = 20.0 * common::LAMBDA_OVER_D;
    let fwhm = |seeing| fwhm_of_row(draw(&seeing_limited(seeing)).view()) * 0.1 / lambda_over_r0;
    let kolmogorov = fwhm(KOLMOGOROV);
    assert!((kolmogorov / 0.976 - 1.0).abs() < SEEING_FWHM, "{kolmogorov}");

    // A seeing with the same r0, given by its FWHM at another wavelength. r0 is proportional to
    // lambda^(6/5), the FWHM to lambda^(-1/5).
    let by_fwhm = SeeingParams {
        r0_m: None,
        fwhm_arcsec: Some(0.975_864 * lambda_over_r0 * 1.6f64.powf(-0.2)),
        at_wavelength_nm: 800.0,
        ..KOLMOGOROV
    };
    assert!((fwhm(by_fwhm) / kolmogorov - 1.0).abs() < 1e-9);

    // Tokovinin 2002: FWHM^2 shrinks by 1 - 2.183 (r0 / L0)^0.356.
    let outer = SeeingParams {
        outer_scale_m: Some(20.0),
        ..KOLMOGOROV
    };
    let expected = (1.0 - 2.183 * (0.05f64 / 20.0).powf(0.356)).sqrt();
    let got = fwhm(outer) / kolmogorov;
    assert!(
        (got / expected - 1.0).abs() < OUTER_SCALE_FWHM,
        "{got}, expected {expected}"
    );
}

/// lambda / D is a fortieth of the blur. The wings of the diffraction take light from the core.
const GAUSSIAN_LIMIT: f64 = 2e-2;

#[test]
fn a_dominating_blur_is_gaussian() {
    let relative = |sigma: f64| {
        let mut params = perfect(1.0, 64);
        params.detector.blur_sigma_px = sigma;
        let got = draw(&params);
        let gaussian = Array2::from_shape_fn((64, 64), |(y, x)| {
            let r2 = (x as f64 - 32.0).powi(2) + (y as f64 - 32.0).powi(2);
            (-r2 / (2.0 * sigma * sigma)).exp() / (std::f64::consts::TAU * sigma * sigma)
        });
        common::largest_difference(got.view(), gaussian.view()) / peak(gaussian.view())
    };
    let (narrow, wide) = (relative(2.0), relative(4.0));
    assert!(wide < GAUSSIAN_LIMIT, "{wide}");
    assert!(
        wide < 0.7 * narrow,
        "the limit is approached: {narrow} at 2 pixels, {wide} at 4"
    );
}

/// A blur shortens the transforms, which changes the error of the far wings. Measured: 1.2e-5 of 10
/// square pixels.
const VARIANCE: f64 = 3e-5;

#[test]
fn blur_and_pixel_add_their_variances() {
    // Compared with the unblurred telescope, so that the diffraction cancels: 1/12 from the pixel,
    // sigma^2 from the blur.
    let variance = |pixel: bool, sigma: f64| {
        let mut params = perfect(0.25, 96);
        params.seeing = Some(SeeingParams {
            r0_m: Some(0.1),
            ..KOLMOGOROV
        });
        params.detector.pixel_integration = pixel;
        params.detector.blur_sigma_px = sigma;
        // On a periodic domain the logarithm of the first Fourier component is -var (2 pi / n)^2 /
        // 2.
        let stamp = draw(&TelescopeParams {
            stamp: psf_optics::StampParams {
                padding: 1.0,
                ..params.stamp
            },
            ..params
        });
        let turn = std::f64::consts::TAU / 96.0;
        let wave: f64 = stamp
            .indexed_iter()
            .map(|((_, x), v)| v * ((x as f64 - 48.0) * turn).cos())
            .sum();
        -2.0 * (wave / stamp.sum()).ln() / (turn * turn)
    };
    let bare = variance(false, 0.0);
    assert!((variance(false, 0.7) - bare - 0.49).abs() < VARIANCE);
    assert!((variance(true, 0.0) - bare - 1.0 / 12.0).abs() < VARIANCE);
}

#[test]
fn flux_tends_to_one() {
    let missing: Vec<f64> = [17, 33, 65, 129]
        .map(|n| {
            let mut params = perfect(0.2, n);
            params.detector.pixel_integration = true;
            1.0 - draw(&params).sum()
        })
        .into();
    for pair in missing.windows(2) {
        // Outside r lambda / D the wings hold 2 / (pi^2 r) of the light: half as much at twice r.
        let ratio = pair[1] / pair[0];
        assert!((0.4..0.6).contains(&ratio), "{missing:?}");
    }
    assert!(missing[3] < 4e-3 && missing[3] > 0.0, "{missing:?}");
}

#[test]
fn the_centroid_stays_and_pixels_are_positive() {
    let mut params = perfect(0.2, 65);
    params.detector.pixel_integration = true;
    let stamp = draw(&params);
    let m = moments(stamp.view());
    assert!(
        m.x.abs() < 1e-9 && m.y.abs() < 1e-9 && m.xy.abs() < 1e-6,
        "{} {}",
        m.x,
        m.y
    );
    assert!(stamp.iter().all(|&v| v > 0.0));
}
