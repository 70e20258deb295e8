//! Tests of the correlations of light with images, the derivatives with respect to samples' PSFs.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use coeff_field::{Bilinear, Delaunay, FieldInterpolation, Kriging, NaturalNeighbour};
use common::{ANCHORS, Scene, model_with, noise, options, region};
use conv_core::{ConvReal, Engine, LightAndImage, Paths, Plan, PlanOptions, SampleWeights};
use ndarray::{Array1, Array2, Array3};
use psf_types::{
    Anchor, CoefficientField, Image, NoProgress, Normalisation, OutsidePolicy, PixelRegion, Position,
    SampleCoefficients, SamplePositions,
};

/// Sums in f64 in two orders.
const ROUNDING_F64: f64 = 1e-12;
/// Transforms in f32.
const ROUNDING_F32: f64 = 2e-6;
const SHAPE: (usize, usize) = (75, 91);
const STAMP: (usize, usize) = (9, 7);
const CENTRE: (usize, usize) = (5, 2);

/// Samples on a grid of 4 x 3, and their field with these values.
fn field(method: &dyn FieldInterpolation, values: Array2<f64>) -> Arc<dyn CoefficientField> {
    let nodes = (0..12).map(|j| Position::of_pixel(-5 + 35 * (j % 4), -4 + 43 * (j / 4)));
    let positions = SamplePositions::new(nodes.collect(), None).unwrap();
    let samples = SampleCoefficients::new(values, positions).unwrap();
    method.interpolate(&samples, OutsidePolicy::Extend).unwrap()
}

/// The derivative with respect to samples' PSFs `[sample, y, x]` and with respect to their fluxes, from their
/// definition.
fn by_definition(
    unit: &dyn CoefficientField,
    (light, image, result): (&Array2<f64>, &Array2<f64>, &Array2<f64>),
    frame: PixelRegion,
    anchor: Anchor,
    fluxes: Option<&Array1<f64>>,
) -> (Array3<f64>, Array1<f64>) {
    let count = unit.component_count();
    let mut of_psfs = Array3::zeros((count, STAMP.1, STAMP.0));
    let mut of_fluxes = Array1::zeros(count);
    let (x0, y0) = (frame.x0(), frame.y0());
    let mut weights = vec![0.0; count];
    let value = |array: &Array2<f64>, (y, x): (i64, i64)| {
        let inside = y >= 0 && x >= 0;
        let at = inside.then(|| array.get((y as usize, x as usize))).flatten();
        at.copied().unwrap_or(0.0)
    };
    // Pixels of the side that PSFs belong to, and the first pixel of the frame on this side.
    let (own, other, from) = match anchor {
        Anchor::Output => (image, light, (0, 0)),
        _ => (light, image, (y0, x0)),
    };
    for ((row, column), &value_here) in own.indexed_iter() {
        let (y, x) = (row as i64 - from.0, column as i64 - from.1);
        unit.evaluate_into(Position::of_pixel(x, y), &mut weights)
            .unwrap();
        let weights = Array1::from(weights.clone());
        let value_here = value_here / fluxes.map_or(1.0, |fluxes| weights.dot(fluxes));
        of_fluxes.scaled_add(value_here * result[[row, column]], &weights);
        for v in 0..STAMP.1 {
            for u in 0..STAMP.0 {
                let (dy, dx) = (v as i64 - CENTRE.1 as i64, u as i64 - CENTRE.0 as i64);
                let there = match anchor {
                    Anchor::Output => (y - dy + y0, x - dx + x0),
                    _ => (y + dy, x + dx),
                };
                let product = value_here * value(other, there);
                for (j, weight) in weights.iter().enumerate() {
                    of_psfs[[j, v, u]] += weight * product;
                }
            }
        }
    }
    (of_psfs, of_fluxes)
}

fn correlated<T: ConvReal>(
    engine: &Engine<T>,
    unit: &Arc<dyn CoefficientField>,
    [light, image, result]: [&Array2<f64>; 3],
    fluxes: Option<&Array1<f64>>,
    pairs: usize,
) -> (Array3<f64>, Array1<f64>) {
    let plan = engine.plan();
    let weights = SampleWeights::new(plan, Arc::clone(unit), &NoProgress).unwrap();
    let images: Vec<_> = [light, image, result]
        .map(|array| Image::new(array.mapv(T::nearest)).unwrap())
        .into_iter()
        .collect();
    let pair = |_| LightAndImage {
        light: images[0].view(),
        image: images[1].view(),
        result: Some(images[2].view()),
    };
    let pairs: Vec<_> = (0..pairs).map(pair).collect();
    let count = weights.sample_count();
    let mut of_psfs = Array2::zeros((count, STAMP.0 * STAMP.1));
    let mut of_fluxes = Array1::zeros(count);
    let mut take = |part: conv_core::Correlations| {
        of_psfs += &part.shares.t().dot(&part.correlations);
        of_fluxes += &part.shares.t().dot(&part.products);
    };
    let fluxes = fluxes.map(|fluxes| fluxes.view());
    engine
        .correlate(&weights, &pairs, fluxes, &NoProgress, &mut take)
        .unwrap();
    let of_psfs = of_psfs.into_shape_with_order((count, STAMP.1, STAMP.0)).unwrap();
    (of_psfs, of_fluxes)
}

fn largest_difference(a: &Array3<f64>, b: &Array3<f64>) -> f64 {
    let scale = b.fold(0.0_f64, |m, v| m.max(v.abs()));
    (a - b).fold(0.0_f64, |m, v| m.max(v.abs())) / scale
}

#[test]
fn correlations_are_the_derivative_with_respect_to_the_samples_psfs() {
    let methods: [&dyn FieldInterpolation; 4] =
        [&Bilinear, &Delaunay, &NaturalNeighbour, &Kriging::default()];
    let frame = region(6, 3, 70, 60);
    let (light, image) = (noise(SHAPE.0, SHAPE.1, 1), noise(60, 70, 2));
    let fluxes = noise(12, 1, 3)
        .mapv(|v| 1.0 + 0.2 * v)
        .remove_axis(ndarray::Axis(1));
    for method in methods {
        let unit = field(method, Array2::eye(12));
        let model = model_with(
            field(method, noise(12, 3, 4).mapv(|v| 0.2 * v)),
            STAMP,
            CENTRE,
            true,
            Normalisation::Unit,
        );
        for anchor in ANCHORS {
            for fluxes in [None, Some(&fluxes)] {
                let scene = Scene::new(light.clone()).with_frame(frame);
                let engine = scene.engine(&model, options(0.0, anchor, Paths::Cheapest));
                // Like an adjoint, the result is 0 where light does not reach the frame.
                let reached = engine.plan().light_region();
                let result = match anchor {
                    Anchor::Output => image.mapv(|v| 1.0 + v),
                    _ => Array2::from_shape_fn(light.dim(), |(y, x)| {
                        let inside = reached.contains(region(x as i64, y as i64, 1, 1));
                        if inside { 1.0 - light[[y, x]] } else { 0.0 }
                    }),
                };
                let arrays = [&light, &image, &result];
                let expected = by_definition(&*unit, (&light, &image, &result), frame, anchor, fluxes);
                for pairs in [1, 3] {
                    let (of_psfs, of_fluxes) = correlated(&engine, &unit, arrays, fluxes, pairs);
                    let times = pairs as f64;
                    let difference = largest_difference(&(of_psfs / times), &expected.0);
                    assert!(difference < ROUNDING_F64, "{method:?} {anchor:?}: {difference:e}");
                    let difference = (&of_fluxes / times - &expected.1).mapv(f64::abs).sum();
                    let scale = expected.1.mapv(f64::abs).sum();
                    assert!(
                        difference < ROUNDING_F64 * scale,
                        "{method:?} {anchor:?}: {difference:e}"
                    );
                }
                let single = Plan::<f32>::new(
                    &model,
                    scene.shape(),
                    frame,
                    options(0.0, anchor, Paths::Cheapest),
                );
                let single = Engine::new(single.unwrap());
                let (of_psfs, _) = correlated(&single, &unit, arrays, fluxes, 1);
                let difference = largest_difference(&of_psfs, &expected.0);
                assert!(difference < ROUNDING_F32, "{method:?} {anchor:?}: {difference:e}");
            }
        }
    }
}

#[test]
fn a_tolerance_bounds_the_error_of_correlations() {
    let unit = field(&Kriging::default(), Array2::eye(12));
    let coefficients = noise(12, 3, 4).mapv(|v| 0.2 * v);
    let model = model_with(
        field(&Bilinear, coefficients),
        STAMP,
        CENTRE,
        true,
        Normalisation::Keep,
    );
    let scene = Scene::new(noise(SHAPE.0, SHAPE.1, 1));
    let image = noise(SHAPE.0, SHAPE.1, 2);
    let arrays = [&scene.pixels().to_owned(), &image, &image];
    let of = |tolerance| {
        let plan: PlanOptions = options(tolerance, Anchor::Source, Paths::Cheapest);
        correlated(&scene.engine(&model, plan), &unit, arrays, None, 1).0
    };
    let (exact, coarse) = (of(0.0), of(1e-2));
    let difference = largest_difference(&coarse, &exact);
    assert!(difference > 1e-5 && difference < 1e-2, "{difference:e}");
}
