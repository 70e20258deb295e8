//! The effect of single Zernike terms on the PSF, and its direction.

mod common;

use common::{draw, largest_difference, moments, peak, perfect};
use ndarray::{Array2, s};
use psf_optics::{FieldTerm, ModeParams, Telescope, TelescopeParams, WavefrontUnit};
use psf_types::PsfSource;

/// A perfect telescope, 2 pixels per lambda / D, with terms in waves r.m.s.
fn aberrated(terms: &[(usize, f64)]) -> TelescopeParams {
    let mut params = perfect(0.05, 65);
    params.wavefront.unit = WavefrontUnit::Waves;
    params.wavefront.modes = terms
        .iter()
        .map(|&(noll, value)| ModeParams {
            noll,
            terms: vec![FieldTerm { x: 0, y: 0, value }],
        })
        .collect();
    params
}

/// A tilt and a shift differ by light from beyond the computed focal plane.
const TILT: f64 = 1e-4;

#[test]
fn tilt_moves_the_psf() {
    // W = a Z2 = 2 a x: the light goes to 4 a lambda / D.
    let waves = 0.37;
    let shift = 4.0 * waves * common::LAMBDA_OVER_D / 0.05;
    let perfect = Telescope::new(aberrated(&[])).unwrap();
    for (noll, by) in [(2, (shift, 0.0)), (3, (0.0, shift))] {
        let tilted = draw(&aberrated(&[(noll, waves)]));
        let mut shifted = Array2::zeros((65, 65));
        perfect
            .draw_shifted_into(common::centre_of_field(), by, shifted.view_mut())
            .unwrap();
        let error = largest_difference(tilted.view(), shifted.view()) / peak(shifted.view());
        assert!(error < TILT, "Z{noll}: {error:e}");
    }
}

#[test]
fn piston_does_nothing() {
    let error = largest_difference(draw(&aberrated(&[(1, 0.3)])).view(), draw(&aberrated(&[])).view());
    assert!(error < 1e-14, "{error:e}");
}

/// The pupil's grid is square. It has the symmetries of the square exactly, and those of the circle
/// nearly.
const MIRROR: f64 = 1e-12;
const DIAGONAL: f64 = 2e-4;

#[test]
fn defocus_is_round_and_its_sign_does_not_matter() {
    let stamp = draw(&aberrated(&[(4, 0.25)]));
    let top = peak(stamp.view());
    let error = |other: Array2<f64>| largest_difference(stamp.view(), other.view()) / top;
    assert!(error(stamp.slice(s![.., ..;-1]).to_owned()) < MIRROR);
    assert!(error(stamp.slice(s![..;-1, ..]).to_owned()) < MIRROR);
    assert!(error(stamp.t().to_owned()) < DIAGONAL);
    assert!(error(draw(&aberrated(&[(4, -0.25)]))) < 1e-9);
    assert!(top < 0.5 * peak(draw(&aberrated(&[])).view()), "defocus blurs");
}

#[test]
fn astigmatism_elongates_as_its_sign_says() {
    let m = |terms: &[(usize, f64)]| moments(draw(&aberrated(terms)).view());
    let (x, y) = (m(&[(4, 0.3), (6, 0.2)]), m(&[(4, 0.3), (6, -0.2)]));
    assert!(
        x.xx > 1.3 * x.yy && y.yy > 1.3 * y.xx,
        "Z6 with positive defocus: along x when positive"
    );
    let (up, down) = (m(&[(4, 0.3), (5, 0.2)]), m(&[(4, 0.3), (5, -0.2)]));
    assert!(
        up.xy > 0.1 * up.xx && down.xy < -0.1 * down.xx,
        "Z5: along the rising diagonal when positive"
    );
}

#[test]
fn coma_draws_a_tail() {
    // dW/dx of Z8 is positive at the pupil's edge, so the tail points to +x.
    let stamp = draw(&aberrated(&[(8, 0.3)]));
    let m = moments(stamp.view());
    let brightest = stamp
        .row(32)
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(b.1))
        .unwrap()
        .0;
    assert!(
        m.x > 0.0 && (brightest as f64 - 32.0) < m.x,
        "centroid {}, peak {brightest}",
        m.x
    );
    assert!(m.y.abs() < 1e-9);
    let mirrored = draw(&aberrated(&[(8, -0.3)]));
    let flipped = mirrored.slice(s![.., ..;-1]);
    assert!(largest_difference(stamp.view(), flipped) < MIRROR);
}

#[test]
fn small_aberrations_follow_marechal() {
    // Strehl ratio = exp(-(2 pi sigma)^2) to fourth order for any term of r.m.s. sigma.
    let perfect = peak(draw(&aberrated(&[])).view());
    for noll in [4, 5, 7, 9, 11, 14, 22, 28, 37] {
        let strehl = peak(draw(&aberrated(&[(noll, 0.02)])).view()) / perfect;
        let expected = (-(std::f64::consts::TAU * 0.02).powi(2)).exp();
        assert!(
            (strehl - expected).abs() < 1e-3,
            "Z{noll}: {strehl}, expected {expected}"
        );
    }
}
