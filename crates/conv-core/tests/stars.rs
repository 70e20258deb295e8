//! Tests that compare stars drawn by a plan with stars drawn one by one.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::{Waves, drawn, largest_difference, model_of_stamp, peak, region};
use conv_core::{ConvError, ConvReal, PlanOptions, SourcePlan, StarPainter};
use ndarray::{Array2, Array3};
use psf_types::{
    Anchor, CoefficientField, FieldError, NoProgress, Normalisation, PixelRegion, PointSource, Position,
    PsfBasis, PsfModel, StampGrid, StampInterpolation,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const FRAME: (usize, usize) = (150, 97);

/// Rounding, and phases that are moved by at most 1e-9 to a stamp's pixel.
const SAME: f64 = 1e-11;

/// The model with the same stamp values on a grid of another oversampling, centre and kernel.
fn resampled(
    model: &PsfModel,
    oversampling: f64,
    centre: (f64, f64),
    kernel: StampInterpolation,
) -> PsfModel {
    let grid = StampGrid::new(model.grid().nx(), model.grid().ny())
        .and_then(|g| g.with_oversampling(oversampling))
        .and_then(|g| g.with_centre(centre.0, centre.1))
        .unwrap()
        .with_interpolation(kernel);
    let stamps = model.stamps().to_owned();
    let basis = PsfBasis::new(None, stamps, grid).unwrap();
    PsfModel::new(&basis, Arc::new(Waves), model.normalisation(), None).unwrap()
}

fn model(normalisation: Normalisation) -> PsfModel {
    common::model_with(Arc::new(Waves), (23, 18), (11, 9), false, normalisation)
}

/// Stars on the frame, at its edges and outside, and on pixels, between pixels and close to their
/// borders.
fn stars(count: usize) -> Vec<PointSource> {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut at = |low: f64, high: f64| rng.random_range(low..high);
    let star = |x: f64, y: f64, flux: f64| PointSource::new(Position::new(x, y).unwrap(), flux).unwrap();
    let mut stars = vec![
        star(20.0, 30.0, 5.0),
        star(64.0, 64.0, -2.0),
        star(63.5, 20.5, 1.0),
        star(63.499_999_999_999, 20.5, 1.0),
        star(0.25, 0.75, 3.0),
        star(1e6, 1e6, 1.0),
        star(70.0, 70.0, 0.0),
    ];
    stars.extend((0..count).map(|_| star(at(-15.0, 165.0), at(-12.0, 110.0), at(0.1, 4.0))));
    stars
}

fn frame() -> PixelRegion {
    region(0, 0, FRAME.0, FRAME.1)
}

fn planned<T: ConvReal>(
    model: &PsfModel,
    stars: &[PointSource],
    options: PlanOptions,
    size: Option<usize>,
) -> Array2<f64> {
    let plan = SourcePlan::<T>::new(model, options, size).unwrap();
    drawn(&plan, stars, frame()).mapv(T::as_f64)
}

fn painted(
    model: &PsfModel,
    stars: &[PointSource],
    frame: PixelRegion,
    anchor: Anchor,
    size: Option<usize>,
) -> Array2<f64> {
    let mut image = Array2::<f64>::zeros((frame.shape().ny(), frame.shape().nx()));
    let painter = StarPainter::new(model, frame, anchor, size).unwrap();
    painter
        .draw_into(stars, frame.shape().region(), image.view_mut(), &NoProgress)
        .unwrap();
    image
}

/// For every sampling, kernel, centre and size, at tolerance 0 the results agree up to rounding.
#[test]
fn a_plan_draws_what_the_painter_draws() {
    let stars = stars(300);
    let exact = PlanOptions::new(0.0).unwrap();
    for kernel in [StampInterpolation::CubicSpline, StampInterpolation::Lanczos3] {
        for (stamp, oversampling, centre) in [
            ((23, 18), 1.0, (11.0, 9.0)),
            ((23, 18), 2.0, (11.0, 8.5)),
            ((23, 18), 4.0, (10.5, 9.25)),
            ((23, 18), 7.0, (12.0, 9.0)),
            ((23, 18), 2.1, (11.0, 9.0)),
            ((7, 3), 8.0, (3.0, 1.0)),
            ((3, 1), 1.0, (1.0, 0.0)),
        ] {
            let model = common::model_with(Arc::new(Waves), stamp, (0, 0), false, Normalisation::Keep);
            let model = resampled(&model, oversampling, centre, kernel);
            for size in [None, Some(5), Some(4), Some(60)] {
                let reference = painted(&model, &stars, frame(), Anchor::Source, size);
                let image = planned::<f64>(&model, &stars, exact, size);
                let largest = largest_difference(&image, &reference) / peak(&reference);
                assert!(
                    largest < SAME,
                    "{kernel} {stamp:?} {oversampling} {size:?}: {largest}"
                );
                assert!(peak(&reference) > 0.1, "the test must see stars");
            }
        }
    }
}

#[derive(Debug)]
struct One(fn(Position) -> f64);
impl CoefficientField for One {
    fn component_count(&self) -> usize {
        1
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
        a[0] = (self.0)(p);
        Ok(())
    }
}

/// PSFs that are scaled to unit flux, and PSFs that are not, both with a mean stamp.
#[test]
fn scaling_and_means_are_kept() {
    let positive = |p: Position| 1.5 + (p.x() / 9.0).sin();
    let bump = |width: f64| {
        move |y: usize, x: usize| (-((y as f64 - 8.0).powi(2) + (x as f64 - 8.0).powi(2)) / width).exp()
    };
    let (mean, component) = (
        Array2::from_shape_fn((17, 17), |(y, x)| bump(6.0)(y, x)),
        Array2::from_shape_fn((17, 17), |(y, x)| bump(14.0)(y, x)),
    );
    let norm = component.mapv(|v| v * v).sum().sqrt();
    let components: Array3<f64> = (component / norm).insert_axis(ndarray::Axis(0));
    let grid = StampGrid::new(17, 17).unwrap().with_oversampling(2.0).unwrap();
    let basis = PsfBasis::new(Some(mean), components, grid).unwrap();
    let stars = stars(100);
    for normalisation in [Normalisation::Unit, Normalisation::Keep] {
        let model = PsfModel::new(&basis, Arc::new(One(positive)), normalisation, None).unwrap();
        let reference = painted(&model, &stars, frame(), Anchor::Source, None);
        let image = planned::<f64>(&model, &stars, PlanOptions::new(0.0).unwrap(), None);
        assert!(largest_difference(&image, &reference) < SAME * peak(&reference));
    }
}

/// The tolerance applies to every single star.
#[test]
fn every_star_is_within_the_tolerance() {
    let model = resampled(
        &model(Normalisation::Keep),
        3.0,
        (11.0, 9.0),
        StampInterpolation::CubicSpline,
    );
    for tolerance in [0.3, 1e-1, 1e-2] {
        let mut largest = 0.0f64;
        for star in stars(40).into_iter().filter(|s| s.flux() != 0.0) {
            let options = PlanOptions::new(tolerance).unwrap();
            let (a, b) = (
                planned::<f64>(&model, &[star], options, None),
                painted(&model, &[star], frame(), Anchor::Source, None),
            );
            let l2 = |v: &Array2<f64>| v.mapv(|v| v * v).sum().sqrt();
            if l2(&b) > 0.0 {
                largest = largest.max(l2(&(&a - &b)) / l2(&b));
            }
        }
        assert!(largest <= tolerance, "{tolerance}: {largest}");
        assert!(
            largest > 0.0 || tolerance < 0.1,
            "the test must be able to see an error"
        );
    }
}

/// PSFs of a smooth bell and of components that differ from 0 only at every `s`-th pixel of the
/// stamp: only stars of one sub-pixel phase see the components fully. The components become
/// fainter, so that a tolerance leaves out some of them. They change from row to row, so that no
/// block knows all its PSFs.
fn model_of_one_phase(s: usize, kernel: StampInterpolation) -> PsfModel {
    const COUNT: usize = 24;
    #[derive(Debug)]
    struct Fainter;
    impl CoefficientField for Fainter {
        fn component_count(&self) -> usize {
            COUNT
        }
        fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
            for (k, value) in a.iter_mut().enumerate() {
                let (u, v) = (p.x() / (20.0 + k as f64), p.y() / (2.0 + 0.1 * k as f64));
                *value = 0.2 * 0.75_f64.powi(k as i32) * (u + v + k as f64).sin();
            }
            Ok(())
        }
    }
    let n = 9 * s;
    let at = |i: usize| (i as f64 - (n / 2) as f64) / s as f64;
    let bell = |y: usize, x: usize| (-(at(x).powi(2) + at(y).powi(2)) / 1.5).exp();
    let mean = Array2::from_shape_fn((n, n), |(y, x)| bell(y, x));
    let mean = &mean / mean.mapv(|v| v * v).sum().sqrt();
    let mut components = Array3::<f64>::zeros((COUNT, n, n));
    for k in 0..COUNT {
        let mut stamp = Array2::from_shape_fn((n, n), |(y, x)| {
            let on = x % s == 0 && y % s == 0;
            let wave = ((1 + k) as f64 * at(x) + (2 + k / 3) as f64 * at(y)).sin();
            if on { bell(y, x) * wave } else { 0.0 }
        });
        for earlier in components.outer_iter().take(k) {
            let along = (&stamp * &earlier).sum();
            stamp.scaled_add(-along, &earlier);
        }
        let norm = stamp.mapv(|v| v * v).sum().sqrt();
        components
            .index_axis_mut(ndarray::Axis(0), k)
            .assign(&(stamp / norm));
    }
    let grid = StampGrid::new(n, n)
        .and_then(|g| g.with_oversampling(s as f64))
        .unwrap()
        .with_interpolation(kernel);
    let basis = PsfBasis::new(Some(mean), components, grid).unwrap();
    PsfModel::new(&basis, Arc::new(Fainter), Normalisation::Keep, None).unwrap()
}

/// The tolerance applies to the frame's pixels that a star lights, at the star's own phase.
#[test]
fn stars_of_every_phase_are_within_the_tolerance() {
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let l2 = |v: &Array2<f64>| v.mapv(|v| v * v).sum().sqrt();
    for kernel in [StampInterpolation::CubicSpline, StampInterpolation::Lanczos3] {
        for s in [1, 2, 4] {
            let model = model_of_one_phase(s, kernel);
            for tolerance in [3e-2, 1e-2, 2e-3] {
                let plan =
                    SourcePlan::<f64>::new(&model, PlanOptions::new(tolerance).unwrap(), None).unwrap();
                let (mut largest, mut by_modes) = (0.0f64, 0);
                for i in 0..400 {
                    // Half of the stars lie at phases that use the stamp's pixels.
                    let mut place = |count: f64| {
                        let v: f64 = rng.random_range(15.0..count - 15.0);
                        if i % 2 == 0 {
                            (v * s as f64).round() / s as f64
                        } else {
                            v
                        }
                    };
                    let position = Position::new(place(FRAME.0 as f64), place(FRAME.1 as f64)).unwrap();
                    let star = [PointSource::new(position, 1.0).unwrap()];
                    let exact = painted(&model, &star, frame(), Anchor::Source, None);
                    let error = l2(&(&drawn(&plan, &star, frame()) - &exact)) / l2(&exact);
                    largest = largest.max(error);
                    by_modes += usize::from(error > SAME);
                }
                println!("{kernel} {s} {tolerance:e}: largest {largest:.2e}, {by_modes} by modes");
                assert!(largest <= tolerance, "{kernel} {s} {tolerance}: {largest}");
                assert!(by_modes > 300, "the test must see the modes: {by_modes}");
            }
        }
    }
}

#[test]
fn single_precision_only_adds_rounding() {
    let model = resampled(
        &model(Normalisation::Keep),
        4.0,
        (11.0, 9.0),
        StampInterpolation::CubicSpline,
    );
    let reference = painted(&model, &stars(200), frame(), Anchor::Source, None);
    let image = planned::<f32>(&model, &stars(200), PlanOptions::new(0.0).unwrap(), None);
    let largest = largest_difference(&image, &reference) / peak(&reference);
    assert!(largest < 1e-6 && largest > 1e-10, "{largest}");
}

/// Very many stars in one place, drawn one by one or spread, lose few digits in single precision. (When they
/// were added one after the other, the sum of so many was off by 1e-3.)
#[test]
fn coincident_stars_add_up() {
    const COUNT: usize = 300_000;
    // Spread stars are added up in f64. Of stars that are drawn, some hundred are added up in f32.
    let spread = (1e-4, 2e-6);
    let drawn_one_by_one = (1e-6, 5e-5);
    let model = resampled(
        &model(Normalisation::Keep),
        2.0,
        (11.0, 9.0),
        StampInterpolation::CubicSpline,
    );
    let star = |flux: f64| PointSource::new(Position::new(64.3, 40.7).unwrap(), flux).unwrap();
    let one = painted(&model, &[star(COUNT as f64)], frame(), Anchor::Source, None);
    for (tolerance, rounding) in [spread, drawn_one_by_one] {
        let options = PlanOptions::new(tolerance).unwrap();
        let image = planned::<f32>(&model, &vec![star(1.0); COUNT], options, None);
        let single = planned::<f32>(&model, &[star(COUNT as f64)], options, None);
        let (sum, whole) = (image.sum(), single.sum());
        assert!(
            (sum / whole - 1.0).abs() < rounding,
            "{tolerance}: {sum} and {whole}"
        );
        let largest = largest_difference(&image, &one) / peak(&one);
        assert!(largest < rounding + tolerance, "{tolerance}: {largest}");
    }
}

/// Draws stars on a frame within the scene, for both anchorings, on any number of threads and
/// several times with one plan.
#[test]
fn frames_anchors_threads_and_repetition() {
    let model = resampled(
        &model(Normalisation::Keep),
        2.0,
        (11.0, 9.0),
        StampInterpolation::CubicSpline,
    );
    let (stars, frame) = (stars(300), region(13, 7, 101, 64));
    for anchor in [Anchor::Source, Anchor::Output] {
        let options = PlanOptions::new(0.0).unwrap().with_anchor(anchor);
        let reference = painted(&model, &stars, frame, anchor, None);
        let plan = SourcePlan::new(&model, options, None).unwrap();
        let mut first = None;
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let image = pool.install(|| drawn(&plan, &stars, frame));
            assert!(
                largest_difference(&image, &reference) < SAME * peak(&reference),
                "{anchor}"
            );
            assert_eq!(
                first.get_or_insert(image.clone()),
                &image,
                "{anchor}, {threads} threads"
            );
        }
    }
}

/// A field that lacks values in some places causes an error only if a star needs a value there.
#[test]
fn a_star_without_a_psf_is_an_error() {
    #[derive(Debug)]
    struct Half;
    impl CoefficientField for Half {
        fn component_count(&self) -> usize {
            3
        }
        fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
            if p.x() > 70.25 {
                return Err(FieldError::OutsideSamples { position: p });
            }
            a.copy_from_slice(&[1.0, 0.5, p.x() / 50.0]);
            Ok(())
        }
    }
    let whole = common::model_with(Arc::new(Half), (9, 9), (4, 4), false, Normalisation::Keep);
    let star = |x: f64| vec![PointSource::new(Position::new(x, 40.3).unwrap(), 1.0).unwrap()];
    let plan = SourcePlan::<f64>::new(&whole, PlanOptions::default(), None).unwrap();
    let mut image = drawn(&plan, &star(70.2), frame());
    let reference = painted(&whole, &star(70.2), frame(), Anchor::Source, None);
    assert!(largest_difference(&image, &reference) < 1e-3 * peak(&reference));
    let refused = plan.draw_stars_into(&star(70.3), frame(), frame(), image.view_mut(), &NoProgress);
    assert!(refused.is_err());
}

#[test]
fn a_star_without_pixels_is_an_error() {
    let (model, frame) = (model(Normalisation::Unit), region(0, 0, 20, 20));
    for anchor in [Anchor::Source, Anchor::Output] {
        let painter = StarPainter::new(&model, frame, anchor, Some(0));
        assert!(matches!(painter, Err(ConvError::StampSize)));
        let options = PlanOptions::default().with_anchor(anchor);
        let plan = SourcePlan::<f32>::new(&model, options, Some(0));
        assert!(matches!(plan, Err(ConvError::StampSize)));
    }
}

/// A star may lose this fraction of its flux at the edges of its stamp.
const LOST: f64 = 1e-6;

/// Stars are drawn beyond stamps whose edges are bright, so that no light is lost. The sums over
/// every `s`-th pixel of these stamps are equal, so the flux does not depend on the sub-pixel
/// position.
#[test]
fn no_star_loses_light_at_the_edges_of_its_stamp() {
    for (kernel, s) in [
        (StampInterpolation::CubicSpline, 1.0),
        (StampInterpolation::CubicSpline, 3.0),
        (StampInterpolation::Lanczos3, 1.0),
    ] {
        // The outermost columns hold 1e-3 of the flux.
        let n = 33 * s as usize;
        let middle = (n / 2) as f64;
        let bell = |i: usize| (-((i as f64 - middle) / (2.0 * s)).powi(2) / 2.0).exp() + 1e-3 / (2.0 * s);
        let stamp = Array2::from_shape_fn((n, n), |(y, x)| bell(y) * bell(x));
        let grid = StampGrid::new(n, n).and_then(|g| g.with_oversampling(s)).unwrap();
        let whole = grid.flux_of_sum(stamp.sum());
        let model = model_of_stamp(stamp / whole, grid.with_interpolation(kernel));
        for (x, y) in [(44.0, 44.0), (44.000_001, 44.0), (44.4, 43.7), (44.5, 44.000_001)] {
            let star = [PointSource::new(Position::new(x, y).unwrap(), 1.0).unwrap()];
            for image in [
                planned::<f64>(&model, &star, PlanOptions::default(), None),
                painted(&model, &star, frame(), Anchor::Source, None),
                painted(&model, &star, frame(), Anchor::Output, None),
            ] {
                let lost = 1.0 - image.sum();
                assert!(lost.abs() < LOST, "{kernel} {s} {x} {y}: {lost:e}");
            }
        }
    }
}
