//! Tests of plans as plain arrays: the sum over them is the convolution.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::grid_field::GridField;
use common::{
    ANCHORS, Execute, KINDS, PixelByPixel, STAMPS, Scene, Waves, largest_difference, model_with, noise,
    options, peak, region, scene, single,
};
use conv_core::{ConvError, ConvReal, Direct, Engine, Paths, Plan, PlanArrays};
use ndarray::{Array2, ArrayView2, s};
use psf_types::{Anchor, CoefficientField, FieldError, NoProgress, Normalisation, Position, PsfModel};

/// Rounding of the engine's transforms, and of the modes, in f64.
const ROUNDING_F64: f64 = 1e-12;
/// Rounding of the engine's transforms in f32.
const ROUNDING_F32: f64 = 3e-6;

/// Applies the arrays to values of the side that the light comes from, in f64.
fn summed<T: ConvReal>(
    arrays: &PlanArrays<T>,
    anchor: Anchor,
    from: ArrayView2<'_, T>,
    shape: (usize, usize),
) -> Array2<f64> {
    let mut result = Array2::zeros(shape);
    let other = match anchor {
        Anchor::Output => from.dim(),
        _ => shape,
    };
    for block in &arrays.blocks {
        for ((kernel, y, x), weight) in block.weights.indexed_iter() {
            let (x, y) = (x + block.first.0, y + block.first.1);
            for ((j, i), factor) in block.kernels.index_axis(ndarray::Axis(0), kernel).indexed_iter() {
                let (v, u) = (
                    y as i64 + arrays.reach.1 + j as i64,
                    x as i64 + arrays.reach.0 + i as i64,
                );
                if (0..other.0 as i64).contains(&v) && (0..other.1 as i64).contains(&u) {
                    let (weighted, other) = ([y, x], [v as usize, u as usize]);
                    let (source, target) = match anchor {
                        Anchor::Output => (other, weighted),
                        _ => (weighted, other),
                    };
                    result[target] += weight.as_f64() * factor.as_f64() * from[source].as_f64();
                }
            }
        }
    }
    result
}

/// The image by the sum over the arrays of a plan.
fn image_of<T: ConvReal>(plan: &Plan<T>, anchor: Anchor, light: ArrayView2<'_, T>) -> Array2<f64> {
    let part = plan.light_region();
    let (x0, y0) = (part.x0() as usize, part.y0() as usize);
    let light = light.slice(s![y0..y0 + part.shape().ny(), x0..x0 + part.shape().nx()]);
    let (arrays, shape) = (plan.arrays().unwrap(), plan.region().shape());
    let (image, light_shape) = ((shape.ny(), shape.nx()), light.dim());
    let (weighted, other) = match anchor {
        Anchor::Output => (image, light_shape),
        _ => (light_shape, image),
    };
    // The reach of the weighted side covers the other side.
    let (_, ny, nx) = arrays.blocks[0].kernels.dim();
    assert!(arrays.reach.0 <= 0 && arrays.reach.1 <= 0);
    assert!(arrays.reach.0 + (weighted.1 + nx - 1) as i64 >= other.1 as i64);
    assert!(arrays.reach.1 + (weighted.0 + ny - 1) as i64 >= other.0 as i64);
    summed(&arrays, anchor, light, image)
}

/// Nodes of a grid that tiles can follow.
fn grid(nodes: usize, step: f64) -> Arc<GridField> {
    Arc::new(GridField::new(
        step,
        nodes,
        noise(nodes * nodes, 3, 21).mapv(|v| 0.2 * v),
    ))
}

fn cases() -> Vec<(PsfModel, Scene<f64>)> {
    let mut cases = Vec::new();
    for (n, (shape, centre)) in STAMPS.into_iter().enumerate() {
        let (mean, normalisation) = KINDS[n % 3];
        let field: Arc<dyn CoefficientField> = if n % 2 == 0 { Arc::new(Waves) } else { grid(4, 9.5) };
        let model = model_with(field, shape, centre, mean, normalisation);
        let scene = scene(29, 23, n as u64);
        cases.push((model.clone(), scene.clone().with_frame(region(7, 3, 17, 19))));
        cases.push((model, scene));
    }
    cases
}

#[test]
fn their_sum_is_the_direct_sum() {
    for (model, scene) in cases() {
        for anchor in ANCHORS {
            let truth = scene.through(&model, &Direct::new(anchor)).unwrap().into_pixels();
            for tolerance in [0.0, 1e-3] {
                let plan = scene.plan(&model, options(tolerance, anchor, Paths::Cheapest));
                let image = image_of(&plan, anchor, scene.pixels());
                // The tolerance holds for each PSF, relative to its norm. Few stamps overlap in these scenes.
                let error = largest_difference(&image, &truth) / peak(&truth);
                let limit = tolerance + ROUNDING_F64;
                assert!(
                    error <= limit,
                    "{:?} {anchor} {tolerance}: {error:e}",
                    model.grid()
                );
                let engine = Engine::new(plan).image_of(&scene).unwrap().into_pixels();
                let error = largest_difference(&image, &engine) / peak(&truth);
                assert!(error <= ROUNDING_F64, "engine, {anchor} {tolerance}: {error:e}");
            }
        }
    }
}

#[test]
fn regions_cut_blocks() {
    let scene = Scene::new(noise(163, 211, 4));
    let field = grid(4, 37.25);
    let model = model_with(field, (9, 5), (4, 2), true, Normalisation::Unit);
    for anchor in ANCHORS {
        let whole = scene.plan(&model, options(1e-2, anchor, Paths::Cheapest));
        let blocks = whole.arrays().unwrap().blocks;
        assert!(blocks.len() > 1, "{}", blocks.len());
        let image = image_of(&whole, anchor, scene.pixels());
        for (x, y, nx, ny) in [
            (0, 0, 31, 50),
            (13, 29, 80, 40),
            (100, 80, 10, 10),
            (50, 50, 1, 1),
        ] {
            let part = whole.for_other_region(region(x, y, nx, ny), &NoProgress).unwrap();
            let part = image_of(&part, anchor, scene.pixels());
            let (x, y) = (x as usize, y as usize);
            let expected = image.slice(s![y..y + ny, x..x + nx]).to_owned();
            let error = largest_difference(&part, &expected) / peak(&image);
            assert!(error <= ROUNDING_F64, "{anchor} at ({x}, {y}): {error:e}");
        }
    }
}

#[test]
fn in_single_precision_and_without_memory() {
    for (model, scene) in cases() {
        let light = single(&scene);
        for anchor in ANCHORS {
            let options = options(1e-3, anchor, Paths::Cheapest);
            let engine = light.engine(&model, options);
            let expected = engine.image_of(&light).unwrap().pixels().mapv(f64::from);
            let image = image_of(engine.plan(), anchor, light.pixels());
            let error = largest_difference(&image, &expected) / peak(&expected);
            assert!(error <= ROUNDING_F32, "{anchor}: {error:e}");
            let plan = light.plan(&model, options.with_memory(0));
            assert_eq!(image_of(&plan, anchor, light.pixels()), image);
        }
    }
}

/// The comparison fails if a single weight changes by more than the tolerance.
#[test]
fn a_wrong_weight_is_noticed() {
    let (model, scene) = cases().swap_remove(1);
    let truth = scene.through(&model, &Direct::default()).unwrap().into_pixels();
    let plan = scene.plan(&model, options(1e-3, Anchor::Source, Paths::Cheapest));
    let mut arrays = plan.arrays().unwrap();
    arrays.blocks[0].weights[[0, 0, 0]] += 1.0;
    let image = summed(&arrays, Anchor::Source, scene.pixels(), truth.dim());
    assert!(largest_difference(&image, &truth) > 1e-3 * peak(&truth));
}

/// No PSF to the right of a column.
#[derive(Debug)]
struct LeftOnly;

impl CoefficientField for LeftOnly {
    fn component_count(&self) -> usize {
        3
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
        if p.x() > 20.0 {
            return Err(FieldError::OutsideSamples { position: p });
        }
        Waves.evaluate_into(p, a)
    }
}

#[test]
fn plans_without_arrays() {
    let field = Arc::new(PixelByPixel(LeftOnly));
    let model = model_with(field, (5, 5), (2, 2), true, Normalisation::Keep);
    let scene = scene(29, 23, 3);
    let plan = scene.plan(&model, options(0.0, Anchor::Source, Paths::Cheapest));
    let error = plan.arrays().unwrap_err();
    assert!(matches!(error, ConvError::Field(_)), "{error}");
    assert!(error.to_string().contains("(21, 0)"), "{error}");
    // A region that needs none of the missing PSFs.
    let left = plan.for_other_region(region(0, 0, 10, 23), &NoProgress).unwrap();
    assert!(left.arrays().is_ok());

    let model = model_with(Arc::new(Waves), (5, 5), (2, 2), true, Normalisation::Keep);
    let (models, shape) = ([model.clone(), model], scene.shape());
    let options = options(0.0, Anchor::Source, Paths::Cheapest);
    let layers = Plan::<f64>::of_layers(&models, shape, scene.frame, scene.frame, options, &NoProgress);
    let error = layers.unwrap().arrays().unwrap_err();
    assert!(error.to_string().contains("native engine"), "{error}");
}
