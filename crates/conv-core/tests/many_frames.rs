//! Tests of many scenes through one plan, and of plans that keep the tiles of another plan.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::sync::Arc;

use common::{ANCHORS, Patience, PixelByPixel, Waves, model_with, options, peak};
use conv_core::{ConvReal, Engine, Operation, Paths, Plan};
use ndarray::{Array2, ArrayView2};
use psf_types::{
    Anchor, CoefficientField, FieldError, FrameShape, ImageView, NoProgress, Normalisation, Position,
    PsfModel,
};

const SIDE: usize = 150;

/// The number of scenes: more than threads, so that scenes share tasks.
const SCENES: usize = 37;

fn shape() -> FrameShape {
    FrameShape::new(SIDE, SIDE - 31).unwrap()
}

/// Scenes with all kinds of tiles: dark, with a few lit pixels, with a bright star, and fully lit.
fn scenes<T: ConvReal>() -> Vec<Array2<T>> {
    let scene = |n: usize| {
        Array2::from_shape_fn((SIDE - 31, SIDE), |(y, x)| {
            let lit = match n % 4 {
                0 => x < 40 && y < 40,
                1 => (x * 31 + y * 17 + n).is_multiple_of(997),
                _ => true,
            };
            let bright = if n % 4 == 3 && (x, y) == (77, 50) {
                1e6
            } else {
                1.0
            };
            T::nearest(if lit {
                bright * ((3 * x + 5 * y + n) % 7) as f64
            } else {
                0.0
            })
        })
    };
    (0..SCENES).map(scene).collect()
}

fn each<T: ConvReal>(engine: &Engine<T>, operation: Operation, from: &[Array2<T>]) -> Vec<Array2<T>> {
    let one = |from: &Array2<T>| {
        let mut into = engine.plan().zeros();
        engine
            .execute(
                operation,
                &[view(from.view())],
                vec![into.view_mut()],
                &NoProgress,
            )
            .unwrap();
        into
    };
    from.iter().map(one).collect()
}

fn together<T: ConvReal>(engine: &Engine<T>, operation: Operation, from: &[Array2<T>]) -> Vec<Array2<T>> {
    let mut into: Vec<Array2<T>> = from.iter().map(|_| engine.plan().zeros()).collect();
    let views = from.iter().map(|from| view(from.view())).collect::<Vec<_>>();
    let outputs = into.iter_mut().map(|into| into.view_mut()).collect();
    engine
        .execute_many(operation, &views, outputs, &NoProgress)
        .unwrap();
    into
}

fn view<T: ConvReal>(pixels: ArrayView2<'_, T>) -> ImageView<'_, T> {
    ImageView::new(pixels).unwrap()
}

fn model(field: Arc<dyn CoefficientField>) -> PsfModel {
    model_with(field, (23, 18), (11, 9), false, Normalisation::Keep)
}

fn many_are_equal<T: ConvReal>() {
    let scenes = scenes::<T>();
    for anchor in ANCHORS {
        for paths in [Paths::Cheapest, Paths::Transforms] {
            let options = options(1e-3, anchor, paths);
            let field = Arc::new(PixelByPixel(Waves));
            let plan = Plan::<T>::new(&model(field), shape(), shape().region(), options);
            let engine = Engine::new(plan.unwrap());
            let summary = engine.plan().summary();
            assert!(summary.blocks > 1, "blocks must share scenes");
            for operation in [Operation::Convolve, Operation::Adjoint] {
                let expected = each(&engine, operation, &scenes);
                assert!(expected.iter().any(|image| image.iter().any(|v| !v.is_zero())));
                for threads in [1, 2, 5] {
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
                    let got = pool.unwrap().install(|| together(&engine, operation, &scenes));
                    assert!(
                        got == expected,
                        "{anchor} {paths:?} {operation:?}, {threads} threads"
                    );
                }
            }
        }
    }
}

#[test]
fn many_scenes_give_the_images_of_single_ones() {
    many_are_equal::<f32>();
    many_are_equal::<f64>();
}

/// Stamps nearly as wide as the transforms of a block with a single tile.
#[test]
fn many_small_scenes_give_the_images_of_single_ones() {
    for (nx, ny) in [(10, 8), (30, 20), (64, 64)] {
        let shape = FrameShape::new(nx, ny).unwrap();
        let model = model(Arc::new(Waves));
        let plan = Plan::<f32>::new(
            &model,
            shape,
            shape.region(),
            options(1e-3, Anchor::Source, Paths::Transforms),
        );
        let engine = Engine::new(plan.unwrap());
        let scene = |n: usize| Array2::from_shape_fn((ny, nx), |(y, x)| ((3 * x + 5 * y + n) % 7) as f32);
        let scenes: Vec<Array2<f32>> = (0..SCENES).map(scene).collect();
        for operation in [Operation::Convolve, Operation::Adjoint] {
            let expected = each(&engine, operation, &scenes);
            for threads in [1, 3] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
                let got = pool.unwrap().install(|| together(&engine, operation, &scenes));
                assert!(got == expected, "{shape} {operation:?}, {threads} threads");
            }
        }
    }
}

/// Coefficients that differ from [`Waves`] everywhere.
#[derive(Debug)]
struct Other;
impl CoefficientField for Other {
    fn component_count(&self) -> usize {
        Waves.component_count()
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
        for (k, a) in a.iter_mut().enumerate() {
            *a = 1.0 / (1.0 + k as f64) + 0.3 * (0.05 * p.x() * (1.0 + k as f64) - 0.03 * p.y()).cos();
        }
        Ok(())
    }
}

/// A plan that keeps the tiles of another one is as accurate as a new plan.
#[test]
fn another_field_keeps_the_tolerance() {
    const TOLERANCE: f64 = 1e-4;
    for anchor in ANCHORS {
        let options = options(TOLERANCE, anchor, Paths::Transforms);
        let of = |model: &PsfModel| Plan::<f64>::new(model, shape(), shape().region(), options).unwrap();
        let (first, other) = (of(&model(Arc::new(Waves))), model(Arc::new(Other)));
        let kept = first
            .for_other_fields(std::slice::from_ref(&other), 1 << 28, &NoProgress)
            .unwrap()
            .unwrap();
        assert_eq!(kept.summary().tile, first.summary().tile);
        let images =
            [kept, of(&other), first].map(|plan| each(&Engine::new(plan), Operation::Convolve, &scenes()));
        for ((kept, new), old) in images[0].iter().zip(&images[1]).zip(&images[2]) {
            let scale = peak(new);
            // Each of the two plans may differ by the tolerance for every PSF.
            let difference = common::largest_difference(kept, new);
            assert!(
                difference < 2.0 * TOLERANCE * scale,
                "{anchor}: {difference:e} of {scale:e}"
            );
            assert!(
                common::largest_difference(kept, old) > 1e-2 * scale,
                "the fields must differ"
            );
        }
        let larger = model_with(Arc::new(Waves), (25, 18), (11, 9), false, Normalisation::Keep);
        let refused = of(&other)
            .for_other_fields(&[larger], 1 << 28, &NoProgress)
            .unwrap();
        assert!(refused.is_none(), "stamps of another size");
    }
}

/// A missing PSF, a wrong shape and a cancelled run are errors. Outputs of any layout are filled.
#[test]
fn errors_and_layouts_are_those_of_single_scenes() {
    #[derive(Debug)]
    struct Half;
    impl CoefficientField for Half {
        fn component_count(&self) -> usize {
            Waves.component_count()
        }
        fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
            if p.x() > 60.0 {
                return Err(FieldError::OutsideSamples { position: p });
            }
            Waves.evaluate_into(p, a)
        }
    }
    let options = options(1e-3, psf_types::Anchor::Source, Paths::Cheapest);
    let engine = |field: Arc<dyn CoefficientField>| {
        Engine::new(Plan::<f32>::new(&model(field), shape(), shape().region(), options).unwrap())
    };
    let scenes = scenes::<f32>();
    let views: Vec<_> = scenes.iter().map(|scene| view(scene.view())).collect();
    let run = |engine: &Engine<f32>, images: &mut [Array2<f32>], progress: &dyn psf_types::Progress| {
        let outputs: Vec<_> = images.iter_mut().map(|image| image.view_mut()).collect();
        engine.execute_many(Operation::Convolve, &views[..outputs.len()], outputs, progress)
    };
    let zeros = |count: usize| vec![Array2::<f32>::zeros((SIDE - 31, SIDE)); count];
    assert!(run(&engine(Arc::new(Half)), &mut zeros(20), &NoProgress).is_err());
    let whole = engine(Arc::new(Waves));
    let mut wrong = zeros(20);
    wrong[7] = Array2::zeros((3, 4));
    assert!(run(&whole, &mut wrong, &NoProgress).is_err());
    let cancelled = run(&whole, &mut zeros(20), &Patience::of(3));
    assert!(matches!(cancelled, Err(conv_core::ConvError::Cancelled(_))));

    let expected = each(&whole, Operation::Convolve, &scenes[..20]);
    let mut transposed = vec![Array2::<f32>::zeros((SIDE, SIDE - 31)); 20];
    let outputs = transposed
        .iter_mut()
        .map(|image| image.view_mut().reversed_axes())
        .collect();
    whole
        .execute_many(Operation::Convolve, &views[..20], outputs, &NoProgress)
        .unwrap();
    for (image, expected) in transposed.iter().zip(&expected) {
        assert_eq!(image.t(), expected);
    }
}
