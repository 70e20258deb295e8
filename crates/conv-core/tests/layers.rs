//! Tests of plans for several layers of light, each with its own PSFs.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::extended::extended;
use common::{ANCHORS, Waves, model_with, options, peak};
use conv_core::{
    ConvError, ConvReal, ConvolutionMethod, Direct, Engine, Operation, Paths, Plan, PlanOptions, RowStream,
    SourcePlan,
};
use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};
use psf_types::{
    Anchor, CoefficientField, FieldError, FrameShape, ImageView, NoProgress, Normalisation, PointSource,
    Position, PsfModel, SersicProfile, SersicSource,
};

const SIZE: (usize, usize) = (170, 131);
/// Rounding of images in f64, relative to the peak.
const ROUNDING: f64 = 1e-12;

/// The field of a layer: [`Waves`], scaled and shifted.
#[derive(Debug)]
struct Layer(f64);

impl CoefficientField for Layer {
    fn component_count(&self) -> usize {
        Waves.component_count()
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
        let at = Position::new(p.x() + 40.0 * self.0, p.y() - 25.0 * self.0).expect("finite");
        Waves.evaluate_into(at, a)?;
        for a in a.iter_mut() {
            *a *= 1.0 - 0.3 * self.0;
        }
        Ok(())
    }
}

fn models(normalisation: Normalisation) -> Vec<PsfModel> {
    let first = model_with(Arc::new(Layer(0.0)), (23, 18), (11, 9), true, normalisation);
    let others = [0.7, 1.9].map(|shift| first.with_field(Arc::new(Layer(shift))).unwrap());
    std::iter::once(first).chain(others).collect()
}

fn shape() -> FrameShape {
    FrameShape::new(SIZE.0, SIZE.1).unwrap()
}

/// Light of a layer: lit everywhere, here and there, with one bright pixel, or nowhere.
fn light<T: ConvReal>(kind: usize, layer: usize) -> Array2<T> {
    Array2::from_shape_fn((SIZE.1, SIZE.0), |(y, x)| {
        let even = ((3 * x + 5 * y + 7 * layer) % 11) as f64;
        let lit = (31 * x + 17 * y + layer).is_multiple_of(1409);
        T::nearest(match kind {
            1 if lit => 100.0,
            2 if (x, y) == (90 + layer, 60) => 1e6,
            1 => 0.0,
            3 if layer != 1 => 0.0,
            _ => even,
        })
    })
}

fn views<T: ConvReal>(light: &[Array2<T>]) -> Vec<ImageView<'_, T>> {
    light.iter().map(|l| ImageView::new(l.view()).unwrap()).collect()
}

fn exact(models: &[PsfModel], light: &[Array2<f64>], anchor: Anchor) -> Array2<f64> {
    let mut sum = Array2::zeros((SIZE.1, SIZE.0));
    for (model, light) in models.iter().zip(views(light)) {
        let direct = Direct::new(anchor);
        let image = direct
            .convolve(model, &light, shape().region(), &NoProgress)
            .unwrap();
        sum += &image.pixels();
    }
    sum
}

/// The image of the light of all layers.
fn convolved<T: ConvReal>(engine: &Engine<T>, light: &[Array2<T>]) -> Array2<T> {
    let mut image = engine.plan().zeros();
    let into = vec![image.view_mut()];
    engine
        .execute(Operation::Convolve, &views(light), into, &NoProgress)
        .unwrap();
    image
}

fn plan<T: ConvReal>(models: &[PsfModel], options: PlanOptions) -> Plan<T> {
    let frame = shape().region();
    Plan::of_layers(models, shape(), frame, frame, options, &NoProgress).unwrap()
}

#[test]
fn layers_equal_the_sum_of_direct_convolutions() {
    for normalisation in [Normalisation::Unit, Normalisation::Keep] {
        let models = models(normalisation);
        for anchor in ANCHORS {
            for paths in [Paths::Cheapest, Paths::Transforms] {
                for tolerance in [0.0, 1e-3] {
                    let engine = Engine::new(plan::<f64>(&models, options(tolerance, anchor, paths)));
                    for kind in 0..4 {
                        let light: Vec<_> = (0..3).map(|layer| light(kind, layer)).collect();
                        let exact = exact(&models, &light, anchor);
                        let image = convolved(&engine, &light);
                        let error = peak(&(&image - &exact)) / peak(&exact);
                        let allowed = tolerance + ROUNDING;
                        let case = format!("{normalisation} {anchor} {paths:?} {tolerance:e}, kind {kind}");
                        assert!(error <= allowed, "{case}: {error:e}");
                    }
                }
            }
        }
    }
}

#[test]
fn the_adjoint_of_layers_is_their_transpose() {
    let models = models(Normalisation::Keep);
    let light: Vec<Array2<f64>> = (0..3).map(|layer| light(0, layer)).collect();
    let seen = Array2::from_shape_fn((SIZE.1, SIZE.0), |(y, x)| ((5 * x + 2 * y) % 9) as f64 - 3.0);
    let product = |a: &Array2<f64>, b: &Array2<f64>| (a * b).sum();
    for anchor in ANCHORS {
        for paths in [Paths::Cheapest, Paths::Transforms] {
            let engine = Engine::new(plan::<f64>(&models, options(1e-3, anchor, paths)));
            let image = convolved(&engine, &light);
            let mut back = vec![Array2::zeros((SIZE.1, SIZE.0)); 3];
            let into = back.iter_mut().map(|plane| plane.view_mut()).collect();
            let seen_view = ImageView::new(seen.view()).unwrap();
            engine
                .execute(Operation::Adjoint, &[seen_view], into, &NoProgress)
                .unwrap();
            let (forth, mut sum) = (product(&image, &seen), 0.0);
            for (light, back) in light.iter().zip(&back) {
                sum += product(light, back);
            }
            assert!(
                (forth - sum).abs() < 1e-11 * forth.abs(),
                "{anchor} {paths:?}: {forth} {sum}"
            );
            // Each layer alone, too: the others are dark.
            for (layer, back) in back.iter().enumerate() {
                let dark = Array2::zeros((SIZE.1, SIZE.0));
                let only: Vec<_> = (0..3)
                    .map(|l| {
                        if l == layer {
                            light[l].clone()
                        } else {
                            dark.clone()
                        }
                    })
                    .collect();
                let image = convolved(&engine, &only);
                let (forth, back) = (product(&image, &seen), product(&light[layer], back));
                assert!(
                    (forth - back).abs() < 1e-11 * forth.abs().max(1.0),
                    "{anchor} {layer}"
                );
            }
        }
    }
}

#[test]
fn layers_in_single_precision_do_not_depend_on_threads() {
    let models = models(Normalisation::Unit);
    let engine = Engine::new(plan::<f32>(
        &models,
        options(1e-3, Anchor::Source, Paths::Cheapest),
    ));
    for kind in 0..3 {
        let light: Vec<Array2<f32>> = (0..3).map(|layer| light(kind, layer)).collect();
        let in_f64: Vec<_> = light.iter().map(|l| l.mapv(f64::from)).collect();
        let exact = exact(&models, &in_f64, Anchor::Source);
        let image = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| convolved(&engine, &light))
        };
        let single = image(1);
        assert!(single == image(3));
        let error = peak(&(&single.mapv(f64::from) - &exact)) / peak(&exact);
        assert!(error < 1e-3, "{kind}: {error:e}");
    }
}

/// Light in bands of rows, and the image of all bands.
struct Bands<'a> {
    light: &'a [Array2<f64>],
    image: Vec<f64>,
}

impl RowStream<f64> for Bands<'_> {
    type Error = ConvError;
    fn read(
        &mut self,
        layer: usize,
        rows: std::ops::Range<usize>,
        mut light: ArrayViewMut2<'_, f64>,
    ) -> Result<(), ConvError> {
        light.assign(&self.light[layer].slice(s![rows, ..]));
        Ok(())
    }
    fn write(&mut self, rows: ArrayView2<'_, f64>) -> Result<(), ConvError> {
        self.image.extend(rows);
        Ok(())
    }
}

#[test]
fn streamed_layers_give_the_same_image() {
    let models = models(Normalisation::Keep);
    let light: Vec<_> = (0..3).map(|layer| light(2, layer)).collect();
    for anchor in ANCHORS {
        let engine = Engine::new(plan::<f64>(&models, options(1e-3, anchor, Paths::Cheapest)));
        let whole = convolved(&engine, &light);
        let (light, image) = (&light[..], Vec::new());
        let mut bands = Bands { light, image };
        engine.stream(&mut bands, &NoProgress).unwrap();
        assert_eq!(bands.image, whole.iter().copied().collect::<Vec<_>>(), "{anchor}");
    }
}

#[test]
fn a_plan_of_layers_for_other_fields_keeps_its_tiles() {
    let models = models(Normalisation::Keep);
    let options = options(1e-3, Anchor::Source, Paths::Cheapest);
    let first = plan::<f64>(&models, options);
    let turned: Vec<_> = models.iter().rev().cloned().collect();
    let other = first
        .for_other_fields(&turned, 1 << 28, &NoProgress)
        .unwrap()
        .unwrap();
    assert_eq!(other.summary().tiles, first.summary().tiles);
    let light: Vec<_> = (0..3).map(|layer| light(0, layer)).collect();
    let exact = exact(&turned, &light, Anchor::Source);
    let image = convolved(&Engine::new(other), &light);
    assert!(peak(&(&image - &exact)) / peak(&exact) < 1e-3);
}

#[test]
fn layers_that_do_not_belong_together_are_refused() {
    let models = models(Normalisation::Keep);
    let frame = shape().region();
    let options = options(1e-3, Anchor::Source, Paths::Cheapest);
    let refused = |models: &[PsfModel]| {
        let made = Plan::<f32>::of_layers(models, shape(), frame, frame, options, &NoProgress);
        made.unwrap_err().to_string()
    };
    let other = model_with(Arc::new(Waves), (21, 18), (11, 9), true, Normalisation::Keep);
    assert!(refused(&[models[0].clone(), other]).contains("the same stamps"));
    assert!(refused(&[]).contains("at least one model"));
    let engine = Engine::new(plan::<f32>(&models, options));
    let light = light::<f32>(0, 0);
    let one = ImageView::new(light.view()).unwrap();
    let mut image = engine.plan().zeros();
    for operation in [Operation::Convolve, Operation::Adjoint] {
        let error = engine
            .execute(
                operation,
                std::slice::from_ref(&one),
                vec![image.view_mut()],
                &NoProgress,
            )
            .unwrap_err();
        assert!(matches!(error, ConvError::Layers(_)), "{error}");
    }
    let error = engine
        .execute(Operation::Convolve, &[one], vec![image.view_mut()], &NoProgress)
        .unwrap_err();
    assert!(error.to_string().contains("as many layers"), "{error}");
}

/// A sum of the fields of layers.
#[derive(Debug)]
struct Sum(Vec<(f64, PsfModel)>);

impl CoefficientField for Sum {
    fn component_count(&self) -> usize {
        Waves.component_count()
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
        let mut of_layer = vec![0.0; a.len()];
        a.fill(0.0);
        for (weight, model) in &self.0 {
            model.field().evaluate_into(p, &mut of_layer)?;
            a.iter_mut()
                .zip(&of_layer)
                .for_each(|(sum, value)| *sum += weight * value);
        }
        Ok(())
    }
}

#[test]
fn sources_of_another_field_share_local_bases() {
    const TOLERANCE: f64 = 1e-3;
    let models = models(Normalisation::Unit);
    let mixed = Sum(vec![(0.3, models[0].clone()), (0.7, models[2].clone())]);
    let mixed = models[0].with_field(Arc::new(mixed)).unwrap();
    let options = options(TOLERANCE, Anchor::Source, Paths::Cheapest);
    let frame = shape().region();
    let at = |i: usize| {
        let (x, y) = ((37 * i % 160) as f64 + 5.3, (53 * i % 120) as f64 + 5.7);
        Position::new(x, y).unwrap()
    };
    let stars: Vec<_> = (0..200)
        .map(|i| PointSource::new(at(i), 1.0 + i as f64).unwrap())
        .collect();
    let draw = |plan: &SourcePlan<f64>| {
        let mut image = Array2::zeros((SIZE.1, SIZE.0));
        plan.draw_stars_into(&stars, frame, frame, image.view_mut(), &NoProgress)
            .unwrap();
        image
    };
    let shared = SourcePlan::<f64>::of_layers(&models, options, None).unwrap();
    let own = draw(&SourcePlan::new(&mixed, options, None).unwrap());
    for repeat in 0..2 {
        // The second time, the local bases exist.
        let found = draw(&shared.for_other_field(&mixed).unwrap());
        let error = peak(&(&found - &own)) / peak(&own);
        assert!(error < 2.0 * TOLERANCE && error > 0.0, "{repeat}: {error:e}");
    }
    // Other layers get local bases of their own.
    let found = draw(&shared.for_other_layers(std::slice::from_ref(&mixed)).unwrap());
    let error = peak(&(&found - &own)) / peak(&own);
    assert!(error < 1e-12, "{error:e}");
    // The plan itself draws with the first model.
    let first = draw(&SourcePlan::new(&models[0], options, None).unwrap());
    let error = peak(&(&draw(&shared) - &first)) / peak(&first);
    assert!(error < 2.0 * TOLERANCE, "{error:e}");

    let profile = SersicProfile::new(2.0, 1.0, 0.7, 30.0).unwrap();
    let galaxies: Vec<_> = (0..30)
        .map(|i| SersicSource::new(at(i), 10.0, profile).unwrap())
        .collect();
    let draw = |plan: &SourcePlan<f64>| {
        let mut image = Array2::zeros((SIZE.1, SIZE.0));
        extended(&galaxies, |sources| {
            plan.draw_extended_into(sources, frame, frame, image.view_mut(), &NoProgress)
        })
        .unwrap();
        image
    };
    let shared = SourcePlan::<f64>::of_layers(&models, options, None).unwrap();
    let own = draw(&SourcePlan::new(&mixed, options, None).unwrap());
    let error = peak(&(&draw(&shared.for_other_field(&mixed).unwrap()) - &own)) / peak(&own);
    assert!(error < 2.0 * TOLERANCE, "{error:e}");

    let found = draw(&shared.for_other_layers(std::slice::from_ref(&mixed)).unwrap());
    let error = peak(&(&found - &own)) / peak(&own);
    assert!(error < 1e-12, "{error:e}");

    let other = model_with(Arc::new(Waves), (21, 18), (11, 9), true, Normalisation::Unit);
    assert!(shared.for_other_field(&other).is_none());
    assert!(shared.for_other_layers(&[mixed, other]).is_none() && shared.for_other_layers(&[]).is_none());
}
