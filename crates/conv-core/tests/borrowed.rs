//! Tests of executions on borrowed arrays.

#[allow(dead_code, reason = "each test binary uses a part")]
mod common;

use std::slice::from_ref;
use std::sync::Arc;

use common::{ANCHORS, Execute, PATHS, Scene, Waves, drawn, model_with, noise, options, region};
use conv_core::{ConvError, Direct, Operation, SourcePlan};
use ndarray::{Array2, ArrayViewMut2, s};
use psf_types::{
    FrameShape, Image, ImageView, NoProgress, Normalisation, PixelRegion, PointSource, Position, PsfModel,
};

const SCENE: (usize, usize) = (71, 53);

fn model() -> PsfModel {
    model_with(Arc::new(Waves), (6, 5), (3, 2), true, Normalisation::Unit)
}

fn frame() -> PixelRegion {
    region(13, 11, 37, 29)
}

fn scene() -> Scene<f64> {
    Scene::new(noise(SCENE.1, SCENE.0, 5)).with_frame(frame())
}

/// Calls `each` with the pixels in every layout that NumPy may pass. Unused memory between the
/// pixels has bad values.
fn layouts(pixels: &Array2<f64>, mut each: impl FnMut(&str, ArrayViewMut2<'_, f64>)) {
    let (ny, nx) = pixels.dim();
    let mut whole = pixels.clone();
    each("row-major", whole.view_mut());
    let mut whole = Array2::from_elem((ny + 5, nx + 3), 7e7);
    whole.slice_mut(s![2..2 + ny, 1..=nx]).assign(pixels);
    each("rows apart", whole.slice_mut(s![2..2 + ny, 1..=nx]));
    assert_eq!(whole[[1, 1]], 7e7);
    let mut whole = Array2::from_elem((3 * ny, nx), 7e7);
    whole.slice_mut(s![..;-3, ..]).assign(pixels);
    each("rows backwards", whole.slice_mut(s![..;-3, ..]));
    let mut whole = Array2::from_elem((ny, 2 * nx), 7e7);
    whole.slice_mut(s![.., ..;2]).assign(pixels);
    each("every second column", whole.slice_mut(s![.., ..;2]));
    assert!(whole.slice(s![.., 1..;2]).iter().all(|&v| v == 7e7));
    let mut whole = pixels.t().as_standard_layout().into_owned();
    each("columns", whole.view_mut().reversed_axes());
}

#[test]
fn every_layout_gives_the_same_bytes() {
    let (model, scene) = (model(), scene());
    let light = scene.pixels().to_owned();
    let present = noise(frame().shape().ny(), frame().shape().nx(), 6);
    for anchor in ANCHORS {
        for paths in PATHS {
            let engine = scene.engine(&model, options(1e-3, anchor, paths));
            let mut expected = present.clone();
            let scene_light = scene.light.view();
            engine
                .execute(
                    Operation::Convolve,
                    from_ref(&scene_light),
                    vec![expected.view_mut()],
                    &NoProgress,
                )
                .unwrap();
            let back = engine.adjoint(&Image::new(present.clone()).unwrap()).unwrap();
            layouts(&light, |layout, light| {
                let view = ImageView::new(light.view()).unwrap();
                let mut image = present.clone();
                engine
                    .execute(
                        Operation::Convolve,
                        from_ref(&view),
                        vec![image.view_mut()],
                        &NoProgress,
                    )
                    .unwrap();
                assert_eq!(image, expected, "light {layout}, {anchor} {paths:?}");
            });
            layouts(&present, |layout, mut image| {
                let view = ImageView::new(image.view()).unwrap();
                let light = engine.adjoint_of(&view, &NoProgress).unwrap();
                assert_eq!(light, back, "adjoint of {layout}, {anchor} {paths:?}");
                engine
                    .execute(
                        Operation::Convolve,
                        from_ref(&scene_light),
                        vec![image.view_mut()],
                        &NoProgress,
                    )
                    .unwrap();
                assert_eq!(image, expected, "image {layout}, {anchor} {paths:?}");
            });
            layouts(&Array2::zeros((SCENE.1, SCENE.0)), |layout, mut plane| {
                let image = ImageView::new(present.view()).unwrap();
                engine
                    .execute(
                        Operation::Adjoint,
                        from_ref(&image),
                        vec![plane.view_mut()],
                        &NoProgress,
                    )
                    .unwrap();
                assert_eq!(plane, back.pixels(), "adjoint to {layout}, {anchor} {paths:?}");
            });
        }
    }
}

#[test]
fn the_light_that_reaches_the_frame_is_enough() {
    let (model, scene) = (model(), scene());
    for anchor in ANCHORS {
        let engine = scene.engine(&model, options(1e-3, anchor, PATHS[0]));
        let part = engine.plan().light_region();
        // The stamps reach 3 columns to the left, 2 columns to the right, and 2 rows both ways.
        assert_eq!(part, region(13 - 2, 11 - 2, 37 + 5, 29 + 4));
        let rows = part.y0() as usize..part.y0() as usize + part.shape().ny();
        let columns = part.x0() as usize..part.x0() as usize + part.shape().nx();
        let light = scene.pixels();
        let cut = light.slice(s![rows.clone(), columns.clone()]);
        let mut image = engine.plan().zeros();
        engine
            .execute(
                Operation::Convolve,
                from_ref(&ImageView::new(cut).unwrap()),
                vec![image.view_mut()],
                &NoProgress,
            )
            .unwrap();
        let expected = engine.image_of(&scene).unwrap();
        assert_eq!(image, expected.pixels());

        let mut plane = Array2::zeros(cut.dim());
        engine
            .execute(
                Operation::Adjoint,
                from_ref(&expected.view()),
                vec![plane.view_mut()],
                &NoProgress,
            )
            .unwrap();
        let whole = engine.adjoint(&expected).unwrap();
        assert_eq!(plane, whole.pixels().slice(s![rows, columns]));

        // Single pixels are the same from the part of the light as from the whole light.
        let pixels = [(0, 0), (36, 28), (17, 5)];
        let first = (part.x0() as usize, part.y0() as usize);
        let of_part = Direct::new(anchor)
            .at_pixels(&model, (cut, first), scene.shape(), frame(), &pixels, &NoProgress)
            .unwrap();
        assert_eq!(of_part, scene.at_pixels(&model, anchor, &pixels).unwrap());
    }
}

#[test]
fn other_shapes_are_errors_that_say_what_fits() {
    let (model, scene) = (model(), scene());
    let engine = scene.engine(&model, options(1e-3, ANCHORS[0], PATHS[0]));
    let mut image = engine.plan().zeros();
    let wrong = Array2::zeros((SCENE.1, SCENE.0 + 1));
    let error = engine.execute(
        Operation::Convolve,
        from_ref(&ImageView::new(wrong.view()).unwrap()),
        vec![image.view_mut()],
        &NoProgress,
    );
    assert_eq!(
        error.unwrap_err().to_string(),
        "the light has 72 x 53 pixels, but the plan accepts the whole scene of 71 x 53 or its part of 42 x 33 at (11, 9) that reaches the image"
    );
    let light = scene.light.view();
    let mut wide = Array2::zeros((29, 38));
    for result in [
        engine
            .execute(
                Operation::Convolve,
                from_ref(&light),
                vec![wide.view_mut()],
                &NoProgress,
            )
            .map(|_| ()),
        engine.adjoint_of(&light, &NoProgress).map(|_| ()),
        SourcePlan::new(&model, options(1e-3, ANCHORS[0], PATHS[0]), None)
            .unwrap()
            .draw_stars_into(&[], frame(), frame(), wide.view_mut(), &NoProgress),
    ] {
        assert!(matches!(result, Err(ConvError::FrameShape { .. })), "{result:?}");
    }
    assert!(wide.iter().all(|&v| v == 0.0));
}

#[test]
fn stars_in_a_part_of_the_frame_are_those_of_the_whole() {
    let model = model();
    let frame = FrameShape::new(67, 59).unwrap().region();
    let star = |i: usize| {
        let (x, y) = ((i * 37 % 76) as f64 - 4.3, (i * 53 % 70) as f64 - 5.1);
        PointSource::new(Position::new(x, y).unwrap(), 1.0 + i as f64).unwrap()
    };
    let stars: Vec<PointSource> = (0..200).map(star).collect();
    for anchor in ANCHORS {
        let plan = SourcePlan::new(&model, options(1e-3, anchor, PATHS[0]), None).unwrap();
        let whole = drawn(&plan, &stars, frame);
        for (x, y, nx, ny) in [
            (0, 0, 67, 59),
            (0, 0, 1, 1),
            (66, 58, 1, 1),
            (10, 20, 31, 17),
            (40, 0, 27, 59),
        ] {
            let part = region(x as i64, y as i64, nx, ny);
            layouts(&Array2::zeros((ny, nx)), |layout, mut image| {
                plan.draw_stars_into(&stars, frame, part, image.view_mut(), &NoProgress)
                    .unwrap();
                assert_eq!(
                    image,
                    whole.slice(s![y..y + ny, x..x + nx]),
                    "{layout} {part:?} {anchor}"
                );
            });
        }
    }
}
