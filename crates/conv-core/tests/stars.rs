//! Tests that compare stars drawn by a plan with stars drawn one by one.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::{Waves, drawn, largest_difference, peak, region};
use conv_core::{ConvError, ConvReal, PlanOptions, StarPainter, StarPlan};
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
    let plan = StarPlan::<T>::new(model, options, size).unwrap();
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
    {
        let model = model(Normalisation::Keep);
        for kernel in [StampInterpolation::CubicSpline, StampInterpolation::Lanczos3] {
            for (oversampling, centre) in [
                (1.0, (11.0, 9.0)),
                (2.0, (11.0, 8.5)),
                (4.0, (10.5, 9.25)),
                (7.0, (12.0, 9.0)),
                (2.1, (11.0, 9.0)),
            ] {
                let model = resampled(&model, oversampling, centre, kernel);
                for size in [None, Some(5), Some(4), Some(60)] {
                    let reference = painted(&model, &stars, frame(), Anchor::Source, size);
                    let image = planned::<f64>(&model, &stars, exact, size);
                    let largest = largest_difference(&image, &reference) / peak(&reference);
                    assert!(largest < SAME, "{kernel} {oversampling} {size:?}: {largest}");
                    assert!(peak(&reference) > 0.1, "the test must see stars");
                }
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
        // The tolerance holds for all pixels of the stamps together. A star uses only every third
        // pixel along each axis, and these may have more of the error than the others.
        assert!(largest < 3.0 * tolerance, "{tolerance}: {largest}");
        assert!(
            largest > 0.0 || tolerance < 0.1,
            "the test must be able to see an error"
        );
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
        let plan = StarPlan::new(&model, options, None).unwrap();
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
    let plan = StarPlan::<f64>::new(&whole, PlanOptions::default(), None).unwrap();
    let mut image = drawn(&plan, &star(70.2), frame());
    let reference = painted(&whole, &star(70.2), frame(), Anchor::Source, None);
    assert!(largest_difference(&image, &reference) < 1e-3 * peak(&reference));
    let refused = plan.draw_into(&star(70.3), frame(), frame(), image.view_mut(), &NoProgress);
    assert!(refused.is_err());
}

#[test]
fn a_star_without_pixels_is_an_error() {
    let (model, frame) = (model(Normalisation::Unit), region(0, 0, 20, 20));
    for anchor in [Anchor::Source, Anchor::Output] {
        let painter = StarPainter::new(&model, frame, anchor, Some(0));
        assert!(matches!(painter, Err(ConvError::StampSize)));
        let options = PlanOptions::default().with_anchor(anchor);
        let plan = StarPlan::<f32>::new(&model, options, Some(0));
        assert!(matches!(plan, Err(ConvError::StampSize)));
    }
}
