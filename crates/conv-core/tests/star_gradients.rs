//! Derivatives with respect to the fluxes and positions of stars, compared with differences.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::{Waves, drawn, model_with, noise, region};
use conv_core::{ConvError, ConvReal, PlanOptions, PointGradient, SourcePlan};
use ndarray::{Array2, s};
use psf_types::{
    Anchor, NoProgress, Normalisation, PixelRegion, PointSource, Position, PsfBasis, PsfModel, StampGrid,
    StampInterpolation,
};

/// The frame, in pixels of the scene.
fn frame() -> PixelRegion {
    region(13, 7, 260, 60)
}

/// Central differences of the fourth order, relative to the largest derivative.
const DIFFERENCES: f64 = 1e-7;

fn model(oversampling: f64, interpolation: StampInterpolation, normalisation: Normalisation) -> PsfModel {
    let side = (12.0 * oversampling) as usize;
    let plain = model_with(Arc::new(Waves), (side, side - 1), (0, 0), true, normalisation);
    let grid = StampGrid::new(side, side - 1)
        .and_then(|grid| grid.with_oversampling(oversampling))
        .and_then(|grid| grid.with_centre(0.5 * side as f64, 0.4 * side as f64))
        .unwrap()
        .with_interpolation(interpolation);
    let stamps = plain.stamps();
    let mean = stamps.slice(s![0, .., ..]).to_owned();
    let basis = PsfBasis::new(Some(mean), stamps.slice(s![1.., .., ..]).to_owned(), grid).unwrap();
    PsfModel::new(&basis, Arc::new(Waves), normalisation, None).unwrap()
}

/// Stars on the frame, at its edges and beyond, one without flux, and some of negative flux.
fn stars() -> Vec<PointSource> {
    let at = noise(40, 3, 5);
    at.outer_iter()
        .map(|at| {
            let position = Position::new(140.0 * (1.0 + at[0]), 37.0 * (1.0 + at[1])).unwrap();
            let flux = if at[2].abs() < 0.1 { 0.0 } else { at[2] };
            PointSource::new(position, flux).unwrap()
        })
        .collect()
}

/// A star moved along an axis: flux (0), x (1) or y (2).
fn moved(star: &PointSource, axis: usize, step: f64) -> PointSource {
    let by = |of: usize| if of == axis { step } else { 0.0 };
    let position = star.position();
    let position = Position::new(position.x() + by(1), position.y() + by(2)).unwrap();
    PointSource::new(position, star.flux() + by(0)).unwrap()
}

fn gradients<T: ConvReal>(
    plan: &SourcePlan<T>,
    stars: &[PointSource],
    region: PixelRegion,
    image: &Array2<f64>,
) -> Vec<PointGradient> {
    let image = image.mapv(T::nearest);
    plan.star_gradients(stars, frame(), region, image.view(), &NoProgress)
        .unwrap()
}

fn plan<T: ConvReal>(model: &PsfModel, anchor: Anchor, tolerance: f64) -> SourcePlan<T> {
    let options = PlanOptions::new(tolerance).unwrap().with_anchor(anchor);
    SourcePlan::new(model, options, None).unwrap()
}

#[test]
fn derivatives_are_differences() {
    use Normalisation::{Keep, Unit};
    use StampInterpolation::{CubicSpline, Lanczos3};
    let part = region(90, 0, 100, 41);
    for (oversampling, interpolation, normalisation, anchor, of) in [
        (1.0, CubicSpline, Unit, Anchor::Source, frame().shape().region()),
        (1.0, Lanczos3, Keep, Anchor::Source, part),
        (2.0, CubicSpline, Keep, Anchor::Source, part),
        (3.0, Lanczos3, Unit, Anchor::Source, frame().shape().region()),
        // Taps share no coefficients.
        (5.0, CubicSpline, Unit, Anchor::Source, part),
        (7.0, Lanczos3, Keep, Anchor::Source, frame().shape().region()),
        // Drawn from all components.
        (1.7, CubicSpline, Unit, Anchor::Source, part),
        (1.7, Lanczos3, Keep, Anchor::Output, part),
        (2.0, CubicSpline, Unit, Anchor::Output, frame().shape().region()),
    ] {
        let model = model(oversampling, interpolation, normalisation);
        let plan = plan::<f64>(&model, anchor, 0.0);
        let (stars, image) = (stars(), noise(of.shape().ny(), of.shape().nx(), 9));
        let found = gradients(&plan, &stars, of, &image);
        let largest = found.iter().map(|g| g.x.abs().max(g.y.abs())).fold(0.0, f64::max);
        assert!(largest > 1e-3);
        for (star, found) in stars.iter().zip(&found) {
            for (axis, derivative) in [found.flux, found.x, found.y].into_iter().enumerate() {
                let value = |step: f64| {
                    let light = drawn(&plan, &[moved(star, axis, step)], frame());
                    let (x, y) = (of.x0() as usize, of.y0() as usize);
                    let (nx, ny) = (of.shape().nx(), of.shape().ny());
                    (&light.slice(s![y..y + ny, x..x + nx]) * &image).sum()
                };
                let step = 1e-4;
                let [near, far] = [1.0, 2.0].map(|n| value(n * step) - value(-n * step));
                let difference = (8.0 * near - far) / (12.0 * step);
                assert!(
                    (derivative - difference).abs() < DIFFERENCES * largest,
                    "{oversampling} {interpolation} {anchor:?} axis {axis}: {derivative} {difference} {star:?}"
                );
            }
        }
    }
}

/// Single precision, and modes within a tolerance.
#[test]
fn derivatives_keep_the_tolerance() {
    let model = model(2.0, StampInterpolation::CubicSpline, Normalisation::Unit);
    let (stars, of) = (stars(), frame().shape().region());
    let image = noise(of.shape().ny(), of.shape().nx(), 9);
    let exact = gradients(&plan::<f64>(&model, Anchor::Source, 0.0), &stars, of, &image);
    let largest = exact.iter().map(|g| g.x.abs().max(g.y.abs())).fold(0.0, f64::max);
    let error = |found: Vec<PointGradient>| {
        let pairs = found.iter().zip(&exact);
        let errors = pairs.map(|(a, b)| {
            (a.x - b.x)
                .abs()
                .max((a.y - b.y).abs())
                .max((a.flux - b.flux).abs())
        });
        errors.fold(0.0, f64::max) / largest
    };
    let rounded = gradients(&plan::<f32>(&model, Anchor::Source, 0.0), &stars, of, &image);
    assert!(error(rounded) < 1e-5);
    let coarse = gradients(&plan::<f32>(&model, Anchor::Source, 1e-3), &stars, of, &image);
    assert!(error(coarse) < 1e-2);
}

#[test]
fn wrong_shapes_are_refused() {
    let model = model(1.0, StampInterpolation::CubicSpline, Normalisation::Unit);
    let plan = plan::<f64>(&model, Anchor::Source, 1e-4);
    let image = Array2::zeros((3, 4));
    let of = frame().shape().region();
    let refused = plan.star_gradients(&stars(), frame(), of, image.view(), &NoProgress);
    assert!(matches!(refused, Err(ConvError::FrameShape { .. })));
}
