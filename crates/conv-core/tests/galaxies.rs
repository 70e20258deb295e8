//! Galaxies drawn through a PSF, compared with closed forms and with a direct integral.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::f64::consts::TAU;
use std::sync::Arc;

use common::extended::extended;
use common::model_of_stamp;
use conv_core::{ConvError, PlanOptions, SourcePlan, StampInterpolator};
use ndarray::Array2;
use psf_types::{
    Anchor, CoefficientField, FieldError, FrameShape, LightProfile, NoProgress, Normalisation, PixelRegion,
    Position, PsfBasis, PsfModel, SersicProfile, SersicSource, StampGrid, StampInterpolation,
};
use sersic::SersicLight;

fn model(size: usize, oversampling: f64, psf: impl Fn(f64, f64) -> f64) -> PsfModel {
    let grid = StampGrid::new(size, size).and_then(|grid| grid.with_oversampling(oversampling));
    model_on(grid.unwrap(), psf)
}

/// The model of a PSF, which is a function of the offset from the centre in frame pixels.
fn model_on(grid: StampGrid, psf: impl Fn(f64, f64) -> f64) -> PsfModel {
    let oversampling = grid.oversampling();
    let stamp = Array2::from_shape_fn(grid.dim(), |(y, x)| {
        psf(
            (x as f64 - grid.centre_x()) / oversampling,
            (y as f64 - grid.centre_y()) / oversampling,
        )
    });
    model_of_stamp(stamp, grid)
}

fn galaxy(at: (f64, f64), re: f64, n: f64, q: f64, angle: f64) -> SersicSource {
    let profile = SersicProfile::new(re, n, q, angle).unwrap();
    SersicSource::new(Position::new(at.0, at.1).unwrap(), 1.0, profile).unwrap()
}

fn drawn(model: &PsfModel, galaxy: SersicSource, side: usize, tolerance: f64) -> Array2<f64> {
    let plan = SourcePlan::<f64>::new(model, PlanOptions::new(tolerance).unwrap(), None).unwrap();
    let frame = FrameShape::new(side, side).unwrap().region();
    let mut image = Array2::zeros((side, side));
    extended(&[galaxy], |sources| {
        plan.draw_extended_into(sources, frame, frame, image.view_mut(), &NoProgress)
    })
    .unwrap();
    image
}

/// Largest error of the interpolation of stamps, relative to the peak.
const INTERPOLATION: f64 = 3e-4;

/// A Gaussian galaxy through a Gaussian PSF is a Gaussian.
#[test]
fn gaussian_galaxies_through_gaussian_psfs() {
    let gauss = |d: f64, s: f64| (-0.5 * (d / s).powi(2)).exp() / (s * std::f64::consts::TAU.sqrt());
    // Native stamps are interpolated well if they are wide.
    for (s, size, sigma) in [(1.0, 51, 3.2), (2.0, 61, 1.4), (3.0, 90, 1.4), (2.5, 75, 1.6)] {
        let model = model(size, s, |x, y| gauss(x, sigma) * gauss(y, sigma));
        for (re, q) in [(0.01, 1.0), (1.0, 0.5), (3.0, 0.2), (20.0, 0.7)] {
            let galaxy = galaxy((70.3, 66.8), re, 0.5, q, 0.0);
            let image = drawn(&model, galaxy, 140, 1e-6);
            let own = re / (2.0 * std::f64::consts::LN_2).sqrt();
            let (sx, sy) = (own.hypot(sigma), (q * own).hypot(sigma));
            let peak = gauss(0.0, sx) * gauss(0.0, sy);
            for ((j, i), v) in image.indexed_iter() {
                let truth = gauss(i as f64 - 70.3, sx) * gauss(j as f64 - 66.8, sy);
                let error = (v - truth).abs() / peak;
                assert!(
                    error < INTERPOLATION,
                    "s = {s}, re = {re}, ({i}, {j}): {v} {truth} {error:e}"
                );
            }
        }
    }
}

/// The direct integral of a Gaussian galaxy times an interpolated stamp. The stamps are so sharp
/// that their interpolation has light far beyond their Nyquist frequency.
#[test]
fn galaxies_through_sharp_stamps() {
    /// Error of the sum over points, relative to the peak.
    const SUM: f64 = 1e-5;
    let gauss = |d: f64, s: f64| (-0.5 * (d / s).powi(2)).exp() / (s * std::f64::consts::TAU.sqrt());
    let (spline, lanczos) = (StampInterpolation::CubicSpline, StampInterpolation::Lanczos3);
    for (s, size, off_centre, interpolation) in [
        (1.0, 13, 0.0, spline),
        (1.0, 12, 0.0, spline),
        (2.0, 21, 0.0, spline),
        (2.0, 20, 0.3, spline),
        (1.5, 16, 0.3, spline),
        (1.0, 13, 0.3, lanczos),
        (2.0, 20, 0.0, lanczos),
        (1.5, 16, 0.3, lanczos),
    ] {
        let sigma = 0.4 / s;
        let grid = StampGrid::new(size, size - 1)
            .and_then(|grid| grid.with_oversampling(s))
            .and_then(|grid| {
                grid.with_centre(grid.centre_x() + off_centre, grid.centre_y() - 0.7 * off_centre)
            })
            .unwrap()
            .with_interpolation(interpolation);
        let model = model_on(grid, |x, y| gauss(x - 0.1, sigma) * gauss(y + 0.2, 1.5 * sigma));
        let interpolated = StampInterpolator::new(model.stamp(0), model.grid());
        // The points around the centre of the stamp, in frame pixels.
        let (fine, side) = (12.0, 12 * 14 + 1);
        let points = StampGrid::new(side, side)
            .and_then(|grid| grid.with_oversampling(fine))
            .unwrap();
        let psf = interpolated.resample((0.0, 0.0), points);
        let at = |i: usize| (i as f64 - (side / 2) as f64) / fine;
        for (re, q, angle, centre) in [(0.8, 1.0, 0.0, (30.0, 30.0)), (1.2, 0.6, 35.0, (30.4, 29.7))] {
            let image = drawn(&model, galaxy(centre, re, 0.5, q, angle), 60, 1e-6);
            let (sin, cos) = f64::to_radians(angle).sin_cos();
            let peak = image.iter().fold(0.0_f64, |m, v| m.max(*v));
            let own = re / (2.0 * std::f64::consts::LN_2).sqrt();
            for (i, j) in [(30, 30), (29, 30), (31, 28), (33, 31), (26, 30)] {
                let offset = (i as f64 - centre.0, j as f64 - centre.1);
                let sum: f64 = psf
                    .indexed_iter()
                    .map(|((v, u), h)| {
                        let (x, y) = (offset.0 - at(u), offset.1 - at(v));
                        h * gauss(x * cos + y * sin, own) * gauss(y * cos - x * sin, q * own)
                    })
                    .sum();
                let error = (image[[j, i]] - sum / (fine * fine)).abs() / peak;
                assert!(
                    error < SUM,
                    "{interpolation}, s = {s}, size {size}, re = {re}, ({i}, {j}): {error:e}"
                );
            }
        }
    }
}

/// Two components, whose coefficients grow along the axes of the field.
#[derive(Debug)]
struct Slopes;
impl CoefficientField for Slopes {
    fn component_count(&self) -> usize {
        2
    }
    fn evaluate_into(&self, at: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        let wave = (0.1 * at.x()).sin();
        coefficients.copy_from_slice(&[2e-3 * at.x() + 0.05 * wave, 1e-3 * at.y() - 0.1]);
        Ok(())
    }
}

/// A round PSF whose ellipticity varies over the field. The PSF sums to 1.
fn elliptical(field: impl CoefficientField + 'static) -> PsfModel {
    const SIDE: usize = 60;
    let grid = StampGrid::new(SIDE, SIDE)
        .and_then(|grid| grid.with_oversampling(2.0))
        .unwrap();
    let stamp = |factor: fn(f64, f64) -> f64| {
        Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
            let (x, y) = (x as f64 - grid.centre_x(), y as f64 - grid.centre_y());
            factor(x, y) * (-(x * x + y * y) / 18.0).exp()
        })
    };
    let round = stamp(|_, _| 1.0);
    let parts = [stamp(|x, y| x * x - y * y), stamp(|x, y| x * y)].map(|part| {
        let norm = part.mapv(|v| v * v).sum().sqrt();
        part / norm
    });
    let components = ndarray::stack(ndarray::Axis(0), &[parts[0].view(), parts[1].view()]).unwrap();
    let basis = PsfBasis::new(Some(&round / round.sum() * 4.0), components, grid).unwrap();
    PsfModel::new(&basis, Arc::new(field), Normalisation::Keep, None).unwrap()
}

/// Galaxies on the frame and around it, some with light far from their centres.
fn catalogue() -> Vec<SersicSource> {
    let shapes = [(1e-3, 0.5), (0.4, 1.0), (1.5, 2.5), (3.0, 4.0), (6.0, 1.5)];
    (0..25)
        .map(|i| {
            let at = (f64::from(i * 37 % 170) - 10.3, f64::from(i * 53 % 150) - 9.6);
            let (re, n) = shapes[i as usize % shapes.len()];
            galaxy(at, re, n, 0.3 + 0.02 * f64::from(i), f64::from(i * 20))
        })
        .collect()
}

const FRAME: (usize, usize) = (130, 150);

fn frame() -> PixelRegion {
    FrameShape::new(FRAME.1, FRAME.0).unwrap().region()
}

fn exact(plan: &SourcePlan<f64>, galaxies: &[SersicSource], pixels: &[(usize, usize)]) -> Vec<f64> {
    extended(galaxies, |sources| {
        plan.extended_at_pixels(sources, frame(), pixels, &NoProgress)
    })
    .unwrap()
}

fn planned(tolerance: f64, anchor: Anchor) -> SourcePlan<f64> {
    let options = PlanOptions::new(tolerance).unwrap().with_anchor(anchor);
    SourcePlan::new(&elliptical(Slopes), options, None).unwrap()
}

fn image_of(plan: &SourcePlan<f64>, galaxies: &[SersicSource], region: PixelRegion) -> Array2<f64> {
    let mut image = Array2::zeros((region.shape().ny(), region.shape().nx()));
    extended(galaxies, |sources| {
        plan.draw_extended_into(sources, frame(), region, image.view_mut(), &NoProgress)
    })
    .unwrap();
    image
}

/// The image of a galaxy is the light convolved with its PSF. So its relative error is at most that
/// of the PSF, but for the galaxy's smaller norm, and for windows and outskirts.
#[test]
fn every_galaxy_is_within_the_tolerance() {
    /// Pixels along each axis for each pixel that is compared.
    const STEP: usize = 2;
    let some: Vec<(usize, usize)> = (0..FRAME.0)
        .step_by(STEP)
        .flat_map(|y| (0..FRAME.1).step_by(STEP).map(move |x| (x, y)))
        .collect();
    let precise = planned(1e-8, Anchor::Source);
    let plans = [1e-2, 1e-3, 1e-4, 1e-5].map(|tolerance| (tolerance, planned(tolerance, Anchor::Source)));
    let inside = |galaxy: &SersicSource| {
        let at = galaxy.position();
        (20.0..130.0).contains(&at.x()) && (20.0..110.0).contains(&at.y())
    };
    let norm =
        |values: &mut dyn Iterator<Item = f64>| STEP as f64 * values.map(|v| v * v).sum::<f64>().sqrt();
    for galaxy in catalogue().into_iter().filter(inside) {
        let truth = exact(&precise, &[galaxy], &some);
        let point = SersicProfile::new(1e-6, 0.5, 1.0, 0.0).unwrap();
        let star = SersicSource::new(galaxy.position(), 1.0, point).unwrap();
        let psf = norm(&mut exact(&precise, &[star], &some).into_iter());
        let peak = truth.iter().copied().fold(0.0, f64::max);
        for (tolerance, plan) in &plans {
            let drawn = image_of(plan, &[galaxy], frame());
            let differences = some.iter().zip(&truth).map(|(&(x, y), v)| drawn[[y, x]] - v);
            let difference = norm(&mut { differences });
            // Windows and outskirts: an error of the pixels that a window holds.
            let windows = 0.3 * tolerance * peak * 100.0_f64.sqrt();
            assert!(
                difference <= tolerance * psf + windows,
                "{tolerance} {galaxy:?}: {difference:e} {psf}"
            );
        }
    }
}

/// A window's image repeats with the period of the window. The light of the repetitions must not
/// stay in the window, where it would add up to many times the tolerance.
#[test]
fn windows_hold_no_light_of_their_repetitions() {
    const SIDE: usize = 420;
    const TOLERANCE: f64 = 1e-5;
    let moffat = |x: f64, y: f64| (1.0 + (x * x + y * y) / 3.0).powf(-2.5) / TAU;
    let model = model(82, 2.0, moffat);
    let precise = SourcePlan::<f64>::new(&model, PlanOptions::new(1e-8).unwrap(), None).unwrap();
    let pixels: Vec<(usize, usize)> = (0..SIDE)
        .step_by(2)
        .flat_map(|y| (0..SIDE).step_by(2).map(move |x| (x, y)))
        .collect();
    let frame = FrameShape::new(SIDE, SIDE).unwrap().region();
    for (re, n, q, angle) in [(4.9, 2.3, 0.66, 30.0), (4.8, 3.5, 0.24, 0.0)] {
        let galaxy = galaxy((210.0, 210.0), re, n, q, angle);
        let image = drawn(&model, galaxy, SIDE, TOLERANCE);
        let truth = extended(&[galaxy], |sources| {
            precise.extended_at_pixels(sources, frame, &pixels, &NoProgress)
        });
        let truth = truth.unwrap();
        let peak = truth.iter().copied().fold(0.0, f64::max);
        let errors = pixels.iter().zip(&truth).map(|(&(x, y), v)| image[[y, x]] - v);
        let (sum, largest) = errors.fold((0.0, 0.0_f64), |(sum, largest), error| {
            (sum + 4.0 * error.abs(), largest.max(error.abs()))
        });
        assert!(sum < TOLERANCE, "re = {re}, q = {q}: {sum:e}");
        assert!(
            largest < TOLERANCE * peak,
            "re = {re}, q = {q}: {:e}",
            largest / peak
        );
    }
}

/// Regions of a frame, and single pixels, have the light of the whole frame.
#[test]
fn light_does_not_depend_on_the_region() {
    for anchor in [Anchor::Source, Anchor::Output] {
        let plan = planned(1e-5, anchor);
        let whole = image_of(&plan, &catalogue(), frame());
        let region = PixelRegion::new(37, 41, FrameShape::new(50, 60).unwrap());
        let part = image_of(&plan, &catalogue(), region);
        assert_eq!(part, whole.slice(ndarray::s![41..101, 37..87]), "{anchor}");
        // At this tolerance, a galaxy's own modes represent its PSF to less than 1e-5.
        let pixels = [(0, 0), (75, 60), (149, 129), (40, 100)];
        for (&(x, y), exact) in pixels.iter().zip(exact(&plan, &catalogue(), &pixels)) {
            assert!(
                (whole[[y, x]] - exact).abs() < 1e-5,
                "{anchor} {x} {y}: {} {exact}",
                whole[[y, x]]
            );
        }
    }
}

/// A point on finely sampled stamps has light at all wavenumbers.
#[test]
fn transforms_that_are_too_large_are_an_error() {
    let model = model(9, 64.0, |u, v| if u == 0.0 && v == 0.0 { 1.0 } else { 0.0 });
    let plan = SourcePlan::<f32>::new(&model, PlanOptions::new(1e-4).unwrap(), None).unwrap();
    let mut image = Array2::zeros((64, 64));
    let frame = FrameShape::new(64, 64).unwrap().region();
    let galaxies = [galaxy((30.0, 31.0), 6.0, 4.0, 0.8, 20.0)];
    let error = extended(&galaxies, |sources| {
        plan.draw_extended_into(sources, frame, frame, image.view_mut(), &NoProgress)
    });
    let error = error.unwrap_err();
    assert!(
        matches!(error, ConvError::GalaxyTransform { x: 30.0, y: 31.0, points } if points > 1 << 15),
        "{error}"
    );
}

/// Bands of a frame have the light of the whole frame bit by bit, also far from a galaxy, where its
/// light ends.
#[test]
fn bands_have_the_light_of_the_whole_frame() {
    let plan = planned(1e-4, Anchor::Source);
    let galaxies = [
        galaxy((12.0, 9.0), 1.5, 4.0, 0.8, 20.0),
        galaxy((300.0, 30.0), 0.7, 4.0, 0.5, 70.0),
    ];
    let shape = FrameShape::new(700, 700).unwrap();
    let draw = |region: PixelRegion| {
        let mut image = Array2::zeros((region.shape().ny(), region.shape().nx()));
        extended(&galaxies, |sources| {
            plan.draw_extended_into(sources, shape.region(), region, image.view_mut(), &NoProgress)
        })
        .unwrap();
        image
    };
    let whole = draw(shape.region());
    for first in (0..700).step_by(70) {
        let band = draw(PixelRegion::new(
            0,
            i64::from(first),
            FrameShape::new(700, 70).unwrap(),
        ));
        assert_eq!(
            band,
            whole.slice(ndarray::s![first..first + 70, ..]),
            "from row {first}"
        );
    }
}

#[test]
fn images_do_not_depend_on_the_number_of_threads() {
    let image = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap()
            .install(|| image_of(&planned(1e-4, Anchor::Source), &catalogue(), frame()))
    };
    let one = image(1);
    for threads in [2, 5] {
        assert_eq!(image(threads), one, "{threads} threads");
    }
}

/// [`Slopes`], but only in some columns and rows.
#[derive(Debug)]
struct Inside;
impl CoefficientField for Inside {
    fn component_count(&self) -> usize {
        2
    }
    fn evaluate_into(&self, at: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        if [at.x(), at.y()].iter().any(|v| !(10.0..=90.0).contains(v)) {
            return Err(FieldError::OutsideSamples { position: at });
        }
        Slopes.evaluate_into(at, coefficients)
    }
}

/// A block is planned from some of its rows. None of them has a PSF here, and the galaxy does.
#[test]
fn galaxies_need_a_psf_only_at_their_own_positions() {
    let model = elliptical(Inside);
    let plan = SourcePlan::<f64>::new(&model, PlanOptions::new(1e-4).unwrap(), None).unwrap();
    let everywhere = planned(1e-4, Anchor::Source);
    let inside = [galaxy((40.3, 50.1), 1.0, 1.0, 0.5, 10.0)];
    let difference = image_of(&plan, &inside, frame()) - image_of(&everywhere, &inside, frame());
    assert!(difference.iter().all(|v| v.abs() < 1e-5));
    for at in [(5.0, 50.0), (40.0, -3.0)] {
        let mut image = Array2::zeros(FRAME);
        let outside = [galaxy(at, 1.0, 1.0, 0.5, 10.0)];
        let found = extended(&outside, |sources| {
            plan.draw_extended_into(sources, frame(), frame(), image.view_mut(), &NoProgress)
        });
        assert!(found.is_err(), "{at:?}");
    }
    // Not needed where no light reaches the frame.
    for y in [-55.0, -80.0] {
        let dark = [galaxy((40.0, y), 1.0, 1.0, 0.5, 10.0)];
        assert_eq!(image_of(&plan, &dark, frame()).sum(), 0.0, "{y}");
    }
}

/// A PSF whose values nearly cancel has no centroid, so it must not move light far away.
#[test]
fn a_psf_with_hardly_any_flux_stays_at_its_galaxy() {
    let dipole = |x: f64, y: f64| (x + 0.02) * (-(x * x + y * y) / 4.0).exp();
    let image = drawn(
        &model(41, 2.0, dipole),
        galaxy((150.0, 150.0), 2.0, 4.0, 0.8, 0.0),
        300,
        1e-4,
    );
    let peak = image.iter().copied().fold(0.0, f64::max);
    for ((y, x), value) in image.indexed_iter() {
        let distance = (x as f64 - 150.0).hypot(y as f64 - 150.0);
        assert!(distance < 60.0 || value.abs() < 1e-3 * peak, "{x} {y} {value:e}");
    }
}

/// No light is lost or counted twice where windows end.
#[test]
fn the_flux_of_galaxies_is_complete() {
    const TOLERANCE: f64 = 1e-5;
    let model = model(61, 2.0, |x, y| {
        (-(x * x + y * y) / 4.0).exp() / (4.0 * std::f64::consts::PI)
    });
    for (re, n, q) in [(0.3, 4.0, 0.5), (2.0, 2.5, 0.2), (4.0, 4.0, 0.8), (8.0, 8.0, 0.9)] {
        let side = 1500;
        let galaxy = galaxy((700.2, 751.9), re, n, q, 30.0);
        let flux = drawn(&model, galaxy, side, TOLERANCE).sum();
        let missing = SersicLight::new(&galaxy).flux_beyond(q * 700.0);
        assert!(
            (1.0 - flux).abs() <= missing + TOLERANCE,
            "re = {re}, n = {n}: {flux}"
        );
    }
}
