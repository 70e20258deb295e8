//! The contract that every source fulfils: shifts, oversampling, field, threads.

mod common;

use common::{largest_difference, peak};
use ndarray::{Array2, s};
use psf_optics::{
    FieldPolynomial, FieldTerm, FrameParams, GaussianField, ModeParams, MoffatField, ProfileShape,
    SeeingParams, SpiderParams, StampParams, Telescope, TelescopeParams,
};
use psf_types::{FrameShape, Position, PsfSource, StampGrid};
use rayon::prelude::*;

/// Rounding errors of transforms and phases.
const ROUNDING: f64 = 1e-12;

const FIELD: FrameParams = FrameParams { nx: 301, ny: 201 };

fn linear(constant: f64, u: f64, v: f64) -> Vec<FieldTerm> {
    vec![
        FieldTerm {
            x: 0,
            y: 0,
            value: constant,
        },
        FieldTerm { x: 1, y: 0, value: u },
        FieldTerm { x: 0, y: 1, value: v },
    ]
}

/// A telescope with every option switched on.
fn full_telescope(nx: usize, ny: usize, oversampling: usize) -> TelescopeParams {
    let mut params = TelescopeParams::diffraction_limited(0.8, 650.0, 0.21, FIELD, 8);
    params.stamp = StampParams {
        nx,
        ny,
        oversampling,
        padding: 2.0,
    };
    params.aperture.obscuration = 0.25;
    params.aperture.spider = Some(SpiderParams {
        vanes: 3,
        width_m: 0.02,
        angle_deg: 20.0,
    });
    let modes = [
        (4, 60.0, 30.0),
        (6, -40.0, 50.0),
        (7, 20.0, 30.0),
        (9, 25.0, -10.0),
        (22, 5.0, 5.0),
    ];
    params.wavefront.modes = modes
        .map(|(noll, constant, slope)| ModeParams {
            noll,
            terms: linear(constant, slope, 0.5 * slope),
        })
        .into();
    params.seeing = Some(SeeingParams {
        r0_m: None,
        fwhm_arcsec: Some(0.3),
        at_wavelength_nm: 500.0,
        outer_scale_m: Some(30.0),
    });
    params.detector.blur_sigma_px = 0.25;
    params
}

/// The sources with stamps of `nx` x `ny` stamp pixels.
fn sources(nx: usize, ny: usize, oversampling: usize) -> Vec<(&'static str, Box<dyn PsfSource + Send>)> {
    let field = FrameShape::new(FIELD.nx, FIELD.ny).unwrap();
    let grid = StampGrid::new(nx, ny)
        .unwrap()
        .with_oversampling(oversampling as f64)
        .unwrap();
    let shape = ProfileShape {
        fwhm_px: FieldPolynomial::new(linear(2.8, 0.4, 0.2)).unwrap(),
        e1: FieldPolynomial::new(linear(0.1, 0.2, 0.0)).unwrap(),
        e2: FieldPolynomial::new(linear(-0.05, 0.0, 0.2)).unwrap(),
    };
    let gaussian = GaussianField::new(field, grid, shape.clone()).unwrap();
    let moffat = MoffatField::new(field, grid, 3.0, shape).unwrap();
    vec![
        (
            "telescope",
            Box::new(Telescope::new(full_telescope(nx, ny, oversampling)).unwrap()),
        ),
        ("gaussian", Box::new(gaussian.clone())),
        (
            "gaussian over pixels",
            Box::new(gaussian.with_pixel_integration()),
        ),
        ("moffat", Box::new(moffat.clone())),
        ("moffat over pixels", Box::new(moffat.with_pixel_integration())),
    ]
}

fn at(x: f64, y: f64) -> Position {
    Position::new(x, y).unwrap()
}

fn shifted(source: &dyn PsfSource, position: Position, shift: (f64, f64)) -> Array2<f64> {
    let mut stamp = Array2::from_elem(source.grid().dim(), f64::NAN);
    source
        .draw_shifted_into(position, shift, stamp.view_mut())
        .unwrap();
    stamp
}

#[test]
fn a_shift_by_whole_pixels_moves_the_stamp() {
    for oversampling in [1, 2] {
        for (name, source) in sources(30, 25, oversampling) {
            let still = shifted(&*source, at(40.0, 33.3), (0.0, 0.0));
            let moved = shifted(&*source, at(40.0, 33.3), (1.0, -2.0));
            let (dx, dy) = (oversampling, 2 * oversampling);
            let error =
                largest_difference(still.slice(s![dy.., ..30 - dx]), moved.slice(s![..25 - dy, dx..]));
            assert!(error < ROUNDING * peak(still.view()), "{name}: {error:e}");
        }
    }
}

#[test]
fn sub_pixel_shifts_move_between_pixels() {
    for ((name, fine), (_, coarse)) in sources(60, 50, 2).into_iter().zip(sources(30, 25, 1)) {
        let expected = shifted(&*fine, at(250.0, 3.0), (0.0, 0.0));
        let got = shifted(&*coarse, at(250.0, 3.0), (0.5, -0.5));
        // Column c of the coarse stamp, (c - 15 - 0.5) pixels from the source, is column 2 c - 1 of
        // the fine stamp. Row r, (r - 12 + 0.5) pixels from the source, is row 2 r + 2.
        let error = largest_difference(got.slice(s![..24, 1..]), expected.slice(s![2..;2, 1..59;2]));
        assert!(error < ROUNDING, "{name}: {error:e}");
    }
}

#[test]
fn an_oversampled_stamp_contains_the_native_stamp() {
    for ((name, fine), (_, native)) in sources(96, 60, 3).into_iter().zip(sources(32, 20, 1)) {
        let (fine, native) = (
            fine.draw(at(10.0, 190.0)).unwrap(),
            native.draw(at(10.0, 190.0)).unwrap(),
        );
        let error = largest_difference(fine.values().slice(s![..;3, ..;3]), native.values());
        assert!(error < ROUNDING, "{name}: {error:e}");
        // The fluxes agree approximately: the oversampled sum is s^2 times as large.
        assert!(
            (fine.flux() - native.flux()).abs() < 5e-3,
            "{name}: {} {}",
            fine.flux(),
            native.flux()
        );
        assert!(
            native.flux() > 0.8 && native.flux() < 1.0 + 1e-9,
            "{name}: {}",
            native.flux()
        );
    }
}

#[test]
fn threads_and_used_scratch_change_no_bit() {
    let positions: Vec<_> = (0..40)
        .map(|i| at(f64::from(i * 37 % 301), f64::from(i * 53 % 201)))
        .collect();
    for (name, source) in sources(24, 31, 1) {
        let serial: Vec<_> = positions.iter().map(|&p| source.draw(p).unwrap()).collect();
        let (_, fresh) = sources(24, 31, 1)
            .into_iter()
            .find(|(other, _)| *other == name)
            .unwrap();
        assert_eq!(
            fresh.draw(positions[39]).unwrap(),
            serial[39],
            "{name}: work arrays that were used before"
        );
        for threads in [2, 4] {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let source = &*source as &(dyn PsfSource + Send);
            let parallel: Vec<_> =
                pool.install(|| positions.par_iter().map(|&p| source.draw(p).unwrap()).collect());
            assert_eq!(parallel, serial, "{name}: {threads} threads");
        }
    }
}

#[test]
fn the_field_matters_and_only_through_its_polynomials() {
    for (name, source) in sources(32, 32, 1) {
        let [a, b] = [at(0.0, 0.0), at(300.0, 200.0)].map(|p| source.draw(p).unwrap().into_values());
        assert!(
            largest_difference(a.view(), b.view()) > 0.05 * peak(a.view()),
            "{name}"
        );
    }
    // A constant wavefront with the polynomials' values at the position gives an identical PSF.
    let params = full_telescope(32, 32, 1);
    let (u, v) = (0.5, -0.5);
    let mut constant = params.clone();
    for mode in &mut constant.wavefront.modes {
        let value = mode.terms[0].value + u * mode.terms[1].value + v * mode.terms[2].value;
        mode.terms = vec![FieldTerm { x: 0, y: 0, value }];
    }
    let varying = Telescope::new(params).unwrap().draw(at(225.0, 50.0)).unwrap();
    let constant = Telescope::new(constant).unwrap().draw(at(0.0, 0.0)).unwrap();
    assert!(largest_difference(varying.values(), constant.values()) < ROUNDING);
}
