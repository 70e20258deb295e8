//! Tests that must pass on every device.

use std::slice::from_ref;
use std::sync::Arc;

use conv_core::{ConvError, Operation, Paths, RowStream};
use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};
use psf_types::{
    Anchor, CoefficientField, FieldError, Image, ImageView, NoProgress, Normalisation, Position, PsfModel,
};
use rayon::prelude::*;

use crate::common::grid_field::GridField;
use crate::common::{
    ANCHORS, Execute, KINDS, PATHS, Patience, STAMPS, Scene, Waves, double_sum, model_with, noise, options,
    region, scene, single,
};
use crate::on_device::OnDevice;

/// Rounding of transforms of a few thousand values in f32, relative to the peak of the image.
pub(crate) const ROUNDING: f64 = 3e-6;

type Body = fn(&OnDevice);

pub(crate) const ALL: [(&str, Body); 12] = [
    ("at_tolerance_0_it_is_the_double_sum", double_sums),
    ("the_adjoint_is_the_transpose", adjoints),
    ("every_pixel_sees_a_psf_within_the_tolerance", tolerances),
    ("flux_is_kept_at_any_tolerance", fluxes),
    ("a_bright_star_adds_no_noise_to_faint_light", bright_stars),
    ("a_faint_psf_beside_bright_ones_keeps_its_accuracy", faint_psfs),
    ("light_beyond_the_range_is_brought_near_1", ranges),
    ("threads_and_streaming_change_nothing", same_bytes),
    ("executions_at_the_same_time_do_not_mix", at_once),
    ("light_without_a_psf_is_an_error", no_psf),
    ("regions_put_together_are_the_whole", regions),
    ("stopped_work_ends_and_the_plan_serves_again", stopped),
];

pub(crate) fn of_light(light: Array2<f32>) -> Scene<f32> {
    Scene::new(light)
}

fn doubles(image: &Image<f32>) -> Array2<f64> {
    image.pixels().mapv(f64::from)
}

fn norm(values: &Array2<f64>) -> f64 {
    values.mapv(|v| v * v).sum().sqrt()
}

/// `|a - b| / |b|`.
pub(crate) fn relative(a: &Array2<f64>, b: &Array2<f64>) -> f64 {
    norm(&(a - b)) / norm(b)
}

const SCENES: [(usize, usize); 5] = [(12, 12), (13, 7), (1, 1), (1, 37), (67, 53)];

fn double_sums(device: &OnDevice) {
    for (n, (shape, centre)) in STAMPS.into_iter().enumerate() {
        for (m, (nx, ny)) in SCENES.into_iter().enumerate() {
            let (mean, normalisation) = KINDS[(n + m) % 3];
            let model = model_with(Arc::new(Waves), shape, centre, mean, normalisation);
            let mut scene = scene(nx, ny, (nx * ny + n) as u64);
            if m % 2 == 0 {
                // Only every fifth pixel is lit, so that every method for tiles is used.
                let mut light = scene.pixels().to_owned();
                for ((y, x), value) in light.indexed_iter_mut() {
                    *value *= f64::from(u8::from((3 * y + x) % 5 == 0));
                }
                scene = Scene::new(light);
            }
            if (n + m) % 2 == 0 {
                let frame = region((nx / 3) as i64, (ny / 4) as i64, nx - nx / 3, ny.div_ceil(2));
                scene = scene.with_frame(frame);
            }
            for anchor in ANCHORS {
                let truth = double_sum(&model, &scene, anchor);
                let scale = truth.iter().fold(1.0_f64, |m, v| m.max(v.abs()));
                for paths in PATHS {
                    let scene = single(&scene);
                    let plan = scene.plan(&model, options(0.0, anchor, paths));
                    let image = device.with(plan).image_of(&scene).unwrap();
                    let largest = (doubles(&image) - &truth)
                        .iter()
                        .fold(0.0_f64, |m, v| m.max(v.abs()));
                    let case = format!("{shape:?} {nx} x {ny} {anchor} {paths:?}");
                    assert!(largest <= ROUNDING * scale, "{case}: {:e}", largest / scale);
                }
            }
        }
    }
}

/// Nodes of a grid are bright and faint by turns. They lie a little beyond pixels, so that cells end
/// at pixels that are nearly as faint as a node.
fn faint_psfs(device: &OnDevice) {
    let values = Array2::from_shape_fn((25, 3), |(node, component)| {
        let brightness = if node % 2 == 0 { 1e6 } else { 1.0 };
        brightness * [1.0, 0.3, -0.2][component]
    });
    let field = Arc::new(GridField::new(17.000_000_01, 5, values));
    let model = model_with(field, (9, 7), (4, 3), false, Normalisation::Keep);
    for node in [1, 9, 19, 21, 23] {
        let mut light = Array2::zeros((69, 69));
        light[[17 * (node / 5), 17 * (node % 5)]] = 1.0;
        let scene = Scene::new(light);
        let truth = double_sum(&model, &scene, Anchor::Source);
        for paths in PATHS {
            let plan = single(&scene).plan(&model, options(1e-6, Anchor::Source, paths));
            let image = device.with(plan).image_of(&single(&scene)).unwrap();
            let error = relative(&doubles(&image), &truth);
            assert!(error <= 1e-5, "{node} {paths:?}: {error:e}");
        }
    }
}

fn adjoints(device: &OnDevice) {
    let scene = single(&scene(67, 53, 8).with_frame(region(5, 9, 50, 37)));
    let model = model_with(Arc::new(Waves), (5, 7), (2, 3), true, Normalisation::Unit);
    for anchor in ANCHORS {
        for paths in PATHS {
            let plan = scene.plan(&model, options(1e-2, anchor, paths));
            let engine = device.with(plan);
            let g = noise(37, 50, 77);
            let forward = doubles(&engine.image_of(&scene).unwrap());
            let back = doubles(
                &engine
                    .adjoint(&Image::new(g.mapv(|v| v as f32)).unwrap())
                    .unwrap(),
            );
            let left = (&forward * &g).sum();
            let right = (&scene.pixels().mapv(f64::from) * &back).sum();
            let error = (left - right).abs() / (norm(&forward) * norm(&g));
            assert!(error <= 1e-6, "{error:e} {anchor} {paths:?}");
        }
    }
}

/// Convolves single units of light by transforms. The modes do not depend on the light.
fn tolerances(device: &OnDevice) {
    let (nx, ny) = (120, 90);
    let model = model_with(Arc::new(Waves), (9, 8), (4, 4), true, Normalisation::Unit);
    let mut coarsest: f64 = 0.0;
    for tolerance in [3e-1, 1e-2, 1e-3, 0.0] {
        for anchor in ANCHORS {
            let options = options(tolerance, anchor, Paths::Transforms);
            let dark = of_light(Array2::zeros((ny, nx)));
            let engine = device.with(dark.plan(&model, options));
            for n in 0..12 {
                let (x, y) = ((n * 37 + 11) % nx, (n * 53 + 7) % ny);
                let mut one = Array2::zeros((ny, nx));
                one[[y, x]] = 1.0;
                // If output-anchored, the kernel of one output pixel is a row of the operator,
                // which is a column of its transpose.
                let (response, sign) = if anchor == Anchor::Source {
                    (engine.image_of(&of_light(one)).unwrap(), 1)
                } else {
                    (engine.adjoint(&Image::new(one).unwrap()).unwrap(), -1)
                };
                let psf = model.psf_at(Position::of_pixel(x as i64, y as i64)).unwrap();
                let mut exact = Array2::zeros((ny, nx));
                for ((j, i), &h) in psf.values().indexed_iter() {
                    let (row, column) = (y as i64 + sign * (j as i64 - 4), x as i64 + sign * (i as i64 - 4));
                    if (0..ny as i64).contains(&row) && (0..nx as i64).contains(&column) {
                        exact[[row as usize, column as usize]] = h;
                    }
                }
                // The tolerance is relative to the whole PSF. The response is truncated at the
                // image's edge.
                let error = norm(&(doubles(&response) - &exact)) / norm(&psf.values().to_owned());
                assert!(
                    error <= tolerance + ROUNDING,
                    "{error:e} > {tolerance:e} at {x}, {y}"
                );
                coarsest = coarsest.max(error);
            }
        }
    }
    // Some errors must be large: without truncation, the test would prove nothing.
    assert!(coarsest > 1e-3, "{coarsest:e}");
}

fn fluxes(device: &OnDevice) {
    let mut light = Array2::zeros((160, 200));
    light
        .slice_mut(s![40..120, 40..160])
        .assign(&noise(80, 120, 4).mapv(|v| (v + 1.2) as f32));
    let model = model_with(Arc::new(Waves), (16, 12), (8, 6), true, Normalisation::Unit);
    let exact: f64 = light.iter().map(|&v| f64::from(v)).sum();
    let scene = of_light(light);
    for tolerance in [0.0, 1e-2, 0.5] {
        let options = options(tolerance, Anchor::Source, Paths::Cheapest);
        let engine = device.with(scene.plan(&model, options));
        let flux = doubles(&engine.image_of(&scene).unwrap()).sum();
        assert!(
            (flux / exact - 1.0).abs() < 1e-6,
            "{flux} {exact} at {tolerance:e}"
        );
    }
}

fn bright_stars(device: &OnDevice) {
    let model = model_with(Arc::new(Waves), (9, 8), (4, 4), true, Normalisation::Unit);
    let mut light = noise(200, 200, 5).mapv(|v| v + 1.5);
    light[[100, 90]] = 1e8;
    let scene = Scene::new(light);
    let far: Vec<(usize, usize)> = (0..200_usize)
        .map(|n| (60 + (n * 7) % 60, 70 + (n * 11) % 60))
        .filter(|&(x, y)| x.abs_diff(90) > 12 || y.abs_diff(100) > 12)
        .collect();
    for anchor in ANCHORS {
        let truth = scene.at_pixels(&model, anchor, &far).unwrap();
        let error = |paths: Paths| {
            let scene = single(&scene);
            let plan = scene.plan(&model, options(0.0, anchor, paths));
            let image = device.with(plan).image_of(&scene).unwrap();
            let pairs = far.iter().zip(&truth);
            let squares = pairs.map(|(&(x, y), v)| (f64::from(image.pixels()[[y, x]]) - v).powi(2));
            (squares.sum::<f64>() / truth.iter().map(|v| v * v).sum::<f64>()).sqrt()
        };
        assert!(error(Paths::Cheapest) < 1e-6, "{anchor}");
        // If only transforms are used, the star adds noise.
        assert!(error(Paths::Transforms) > 1e-3, "{anchor}");
    }
}

fn ranges(device: &OnDevice) {
    let model = model_with(Arc::new(Waves), (9, 8), (4, 4), true, Normalisation::Unit);
    let light = noise(90, 120, 3).mapv(|v| (v + 1.5) as f32);
    for anchor in ANCHORS {
        let scene = of_light(light.clone());
        let options = options(0.0, anchor, Paths::Transforms);
        let engine = device.with(scene.plan(&model, options));
        let usual = doubles(&engine.image_of(&scene).unwrap());
        for exponent in [-110, 110] {
            let power = 2_f32.powi(exponent);
            let image = engine.image_of(&of_light(light.mapv(|v| v * power))).unwrap();
            let error = relative(&(doubles(&image) / f64::from(power)), &usual);
            assert!(error < 1e-6, "{error:e} at 2^{exponent}, {anchor}");
        }
    }
}

/// A scene in memory that is read by rows.
struct Rows<'a> {
    scene: &'a Scene<f32>,
    image: Vec<f32>,
}

impl RowStream<f32> for Rows<'_> {
    type Error = ConvError;
    fn read(
        &mut self,
        _layer: usize,
        rows: std::ops::Range<usize>,
        mut light: ArrayViewMut2<'_, f32>,
    ) -> Result<(), ConvError> {
        light.assign(&self.scene.pixels().slice(s![rows, ..]));
        Ok(())
    }
    fn write(&mut self, rows: ArrayView2<'_, f32>) -> Result<(), ConvError> {
        self.image.extend(rows.iter());
        Ok(())
    }
}

fn same_bytes(device: &OnDevice) {
    let model = model_with(Arc::new(Waves), (16, 12), (8, 6), true, Normalisation::Unit);
    let scene = single(&scene(40, 5000, 6).with_frame(region(3, 33, 30, 4900)));
    for anchor in ANCHORS {
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| {
                let options = options(1e-3, anchor, Paths::Cheapest);
                let engine = device.with(scene.plan(&model, options));
                let (image, counts) = engine.counted(&scene, &NoProgress).unwrap();
                assert_eq!(counts.tiles(), engine.plan().summary().tiles);
                // Another execution in between leaves other values in the buffers.
                let half = scene.pixels().mapv(|v| v.max(0.0) * -3.0);
                let other = of_light(half).with_frame(scene.frame);
                assert!(engine.image_of(&other).unwrap() != image);
                let again = engine.image_of(&scene).unwrap();
                assert_eq!(image, again, "buffers are dirty the second time");
                (engine, image)
            })
        };
        let (engine, image) = with(1);
        assert!(with(3).1 == image, "{anchor}");
        let mut rows = Rows {
            scene: &scene,
            image: Vec::new(),
        };
        engine.stream(&mut rows, &NoProgress).unwrap();
        assert!(rows.image.iter().eq(image.pixels().iter()), "{anchor}");
    }
}

/// Runs many executions at the same time, on the thread pool that each of them uses too.
fn at_once(device: &OnDevice) {
    let model = model_with(Arc::new(Waves), (16, 12), (8, 6), true, Normalisation::Unit);
    let scenes: Vec<Scene<f32>> = (0..60).map(|seed| single(&scene(150, 130, seed))).collect();
    let options = options(1e-3, Anchor::Source, Paths::Cheapest);
    let engine = device.with(scenes[0].plan(&model, options));
    let one_by_one: Vec<_> = scenes
        .iter()
        .map(|scene| engine.image_of(scene).unwrap())
        .collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    let at_once: Vec<_> = pool.install(|| {
        scenes
            .par_iter()
            .map(|scene| engine.image_of(scene).unwrap())
            .collect()
    });
    assert!(one_by_one == at_once);
}

/// A field without values in the left part.
#[derive(Debug)]
struct Half;

impl CoefficientField for Half {
    fn component_count(&self) -> usize {
        3
    }
    fn evaluate_into(&self, p: Position, a: &mut [f64]) -> Result<(), FieldError> {
        if p.x() < 20.0 {
            return Err(FieldError::External {
                position: p,
                source: "no PSF here".into(),
            });
        }
        Waves.evaluate_into(p, a)
    }
}

fn no_psf(device: &OnDevice) {
    let model: PsfModel = model_with(Arc::new(Half), (5, 7), (2, 3), true, Normalisation::Unit);
    for anchor in ANCHORS {
        let mut light = Array2::zeros((40, 60));
        light.slice_mut(s![.., 30..]).fill(1.0);
        let fine = of_light(light.clone());
        let options = options(1e-3, anchor, Paths::Cheapest);
        let engine = device.with(fine.plan(&model, options));
        assert!(engine.image_of(&fine).is_ok(), "{anchor}");
        light[[7, 10]] = 1.0;
        let error = engine.image_of(&of_light(light)).unwrap_err();
        assert!(matches!(error, ConvError::Field(_)), "{error}");
        // The engine still works after the error.
        assert!(engine.image_of(&fine).is_ok(), "{anchor}");
    }
}

/// Computes regions of a frame, each from the light that reaches it, forward and adjoint.
fn regions(device: &OnDevice) {
    let scene = single(&scene(201, 157, 8).with_frame(region(5, 9, 173, 131)));
    let model = model_with(Arc::new(Waves), (11, 7), (4, 3), true, Normalisation::Unit);
    for anchor in ANCHORS {
        for paths in PATHS {
            let plan = scene.plan(&model, options(1e-2, anchor, paths));
            let seen = Image::new(noise(131, 173, 5).mapv(|v| v as f32)).unwrap();
            let (mut image, mut back) = (Array2::zeros((131, 173)), Array2::zeros((157, 201)));
            for (x, y, nx, ny) in [
                (0, 0, 60, 131),
                (60, 0, 113, 64),
                (60, 64, 112, 67),
                (172, 64, 1, 67),
            ] {
                let part = plan
                    .for_other_region(region(x as i64, y as i64, nx, ny), &NoProgress)
                    .unwrap();
                let part = device.with(part);
                let reach = part.plan().light_region();
                let (left, below) = (reach.x0() as usize, reach.y0() as usize);
                let (right, above) = (left + reach.shape().nx(), below + reach.shape().ny());
                let light = scene.pixels().slice_move(s![below..above, left..right]);
                let into = image.slice_mut(s![y..y + ny, x..x + nx]);
                part.execute(
                    Operation::Convolve,
                    from_ref(&ImageView::new(light).unwrap()),
                    vec![into],
                    &NoProgress,
                )
                .unwrap();
                let of_part = ImageView::new(seen.pixels().slice_move(s![y..y + ny, x..x + nx])).unwrap();
                part.execute(
                    Operation::Adjoint,
                    from_ref(&of_part),
                    vec![back.view_mut()],
                    &NoProgress,
                )
                .unwrap();
            }
            let engine = device.with(plan);
            let error = relative(
                &image.mapv(f64::from),
                &doubles(&engine.image_of(&scene).unwrap()),
            );
            assert!(error <= 1e-6, "{error:e} {anchor} {paths:?}");
            let error = relative(&back.mapv(f64::from), &doubles(&engine.adjoint(&seen).unwrap()));
            assert!(error <= ROUNDING, "adjoint {error:e} {anchor} {paths:?}");
        }
    }
}

fn stopped(device: &OnDevice) {
    let model = model_with(Arc::new(Waves), (9, 8), (4, 4), true, Normalisation::Unit);
    let scene = single(&scene(271, 203, 12));
    for anchor in ANCHORS {
        let options = options(1e-3, anchor, Paths::Transforms);
        let engine = device.with(scene.plan(&model, options));
        let image = engine.image_of(&scene).unwrap();
        let back = engine.adjoint(&image).unwrap();
        let endless = Patience::endless();
        engine.counted(&scene, &endless).unwrap();
        let all = endless.asked();
        assert!(all >= engine.plan().summary().tiles, "{anchor}: {all}");
        for enough in [0, 1, all / 2, all - 1] {
            let refused = engine.counted(&scene, &Patience::of(enough)).map(|_| ());
            assert!(matches!(refused, Err(ConvError::Cancelled(_))), "{refused:?}");
            assert!(engine.image_of(&scene).unwrap() == image, "{anchor}");
            let refused = engine.adjoint_of(&image.view(), &Patience::of(enough / 2));
            assert!(matches!(refused, Err(ConvError::Cancelled(_))), "{refused:?}");
            assert!(engine.adjoint(&image).unwrap() == back, "{anchor}");
        }
    }
}
