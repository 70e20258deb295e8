//! Tests of properties that only a GPU has.

use std::sync::Arc;

use conv_core::gpu::{GpuDevice, GpuError, GpuOptions, ShaderTrial};
use conv_core::{ConvError, Engine, Paths, Plan};
use ndarray::Array2;
use psf_types::{Anchor, NoProgress, Normalisation, PsfModel};

use crate::bodies::{of_light, relative};
use crate::common::{ANCHORS, Execute, Scene, Waves, model_with, noise, options, scene, single};
use crate::on_device::OnDevice;
use crate::shaders;

/// Relative L2 difference of the devices in f32, which use different transforms.
const PARITY: f64 = 3e-6;
/// Relative error of a shader in f32, compared with its twin in f64: rounding.
const TWIN: f64 = 1e-6;
/// Relative difference between pieces of different sizes: only the order of additions changes.
const ORDER: f64 = 1e-6;

type Body = Box<dyn FnOnce(&OnDevice) + Send>;

pub(crate) fn all() -> Vec<(String, Body)> {
    let mut all: Vec<(String, Body)> = ShaderTrial::names()
        .map(|name| {
            let body: Body = Box::new(move |device| twin(device.handle(), name));
            (format!("{name}_is_its_twin"), body)
        })
        .collect();
    let mut add = |name: &str, body: fn(&OnDevice)| all.push((name.to_owned(), Box::new(body)));
    add("it_equals_the_processor_at_all_sizes_of_transforms", sizes);
    add("it_equals_the_processor_on_every_kind_of_light", lights);
    add("pieces_of_any_size_give_the_same", pieces);
    add("a_lost_gpu_is_an_error", lost);
    add("an_impossible_plan_is_an_error", refused);
    add("it_reports_durations", times);
    all
}

/// Radices 4 and 8, then also 3 and 5. Rows in groups of 16 and fewer.
fn twin(gpu: &GpuDevice, name: &str) {
    let adapter = gpu.adapter();
    // Too little memory for padding, too few threads for one butterfly each, one line at a time.
    let mut small = adapter.clone();
    (small.workgroup_memory, small.workgroup_threads) = (2048, 24);
    for (adapter, size) in [
        (adapter, (64, 128)),
        (adapter, (48, 160)),
        (adapter, (240, 96)),
        (&small, (240, 96)),
    ] {
        let error = shaders::error_against_twin(gpu, adapter, name, size, false).unwrap();
        assert!(error <= TWIN, "{name} {size:?}: {error:e}");
    }
    if name != "draw_stamps" {
        // Proves that the comparison can fail: one root of unity is wrong.
        let error = shaders::error_against_twin(gpu, adapter, name, (64, 128), true).unwrap();
        assert!(error > 1e-3, "{name}: {error:e}");
    }
}

/// The images of the processor and of the GPU from one plan.
fn both(gpu: &GpuDevice, plan: Plan<f32>, scene: &Scene<f32>) -> [Array2<f64>; 2] {
    let image = |engine: Engine<f32>| engine.image_of(scene).unwrap().pixels().mapv(f64::from);
    let whole = plan.region();
    let on_gpu = plan.for_other_region(whole, &NoProgress).unwrap();
    [
        image(Engine::new(plan)),
        image(on_gpu_with(on_gpu, gpu, GpuOptions::default())),
    ]
}

/// The plan on a GPU that can execute it.
fn on_gpu_with(plan: Plan<f32>, gpu: &GpuDevice, options: GpuOptions) -> Engine<f32> {
    Engine::on_gpu(plan, gpu, options)
        .map_err(|(_, error)| error)
        .unwrap()
}

/// Stamps from a few pixels to a thousand, scenes of prime sizes: transforms of 32 to 2048 values.
fn sizes(device: &OnDevice) {
    let mut largest = 0;
    for (stamp, (nx, ny)) in [
        ((5, 3), (211, 97)),
        ((33, 21), (307, 211)),
        ((65, 129), (509, 401)),
        ((301, 257), (337, 613)),
        ((1001, 641), (997, 353)),
    ] {
        let centre = (stamp.0 / 2, stamp.1 / 2);
        let model = model_with(Arc::new(Waves), stamp, centre, true, Normalisation::Unit);
        let scene = of_light(noise(ny, nx, 5).mapv(|v| (v + 1.5) as f32));
        for anchor in ANCHORS {
            let plan = scene.plan(&model, options(1e-3, anchor, Paths::Transforms));
            let transform = plan.summary().transform;
            largest = largest.max(transform.0.max(transform.1));
            let [processor, gpu] = both(device.handle(), plan, &scene);
            let error = relative(&gpu, &processor);
            assert!(
                error <= PARITY,
                "{stamp:?} {nx} x {ny} {anchor} {transform:?}: {error:e}"
            );
        }
    }
    assert!(largest > 1024, "{largest}");
}

fn lit(nx: usize, ny: usize, chosen: impl Fn(usize, usize) -> bool) -> Scene<f32> {
    let values = noise(ny, nx, 9);
    of_light(Array2::from_shape_fn((ny, nx), |(y, x)| {
        if chosen(x, y) {
            (values[[y, x]] + 1.5) as f32
        } else {
            0.0
        }
    }))
}

/// Light everywhere, sparse light, a few pixels, one corner, darkness, and the roles of the flux.
fn lights(device: &OnDevice) {
    let (nx, ny) = (431, 283);
    for normalisation in [Normalisation::Unit, Normalisation::Keep] {
        let model: PsfModel = model_with(Arc::new(Waves), (21, 17), (9, 9), true, normalisation);
        for anchor in ANCHORS {
            for (name, scene) in [
                ("full", lit(nx, ny, |_, _| true)),
                ("sparse", lit(nx, ny, |x, y| (x * 7 + y * 13) % 101 == 0)),
                (
                    "few",
                    lit(nx, ny, |x, y| (x, y) == (5, 4) || (x, y) == (nx - 1, 30)),
                ),
                ("corner", lit(nx, ny, |x, y| x > 400 && y > 250)),
            ] {
                let options = options(1e-4, anchor, Paths::Cheapest);
                let plan = scene.plan(&model, options);
                let [processor, gpu] = both(device.handle(), plan, &scene);
                let error = relative(&gpu, &processor);
                assert!(error <= PARITY, "{name} {anchor} {normalisation}: {error:e}");
            }
            let dark = lit(nx, ny, |_, _| false);
            let plan = dark.plan(&model, options(1e-4, anchor, Paths::Cheapest));
            let [_, gpu] = both(device.handle(), plan, &dark);
            assert!(gpu.iter().all(|&v| v == 0.0));
        }
    }
}

/// Compares limits at which nothing is kept, or pieces are so small that a tile's kernels are
/// processed one by one, with the default limits. Uses full and sparse light, forward and adjoint.
fn pieces(device: &OnDevice) {
    let model = model_with(Arc::new(Waves), (33, 29), (16, 11), true, Normalisation::Unit);
    let full = single(&scene(307, 211, 3));
    let sparse = lit(307, 211, |x, y| x < 150 || (x * 7 + y * 13) % 211 == 0);
    for anchor in ANCHORS {
        for (paths, scene) in [(Paths::Transforms, &full), (Paths::Cheapest, &sparse)] {
            let with = |limits: GpuOptions, host: usize| {
                let options = options(0.0, anchor, paths).with_memory(host);
                let engine = on_gpu_with(scene.plan(&model, options), device.handle(), limits);
                let image = engine.image_of(scene).unwrap();
                let back = engine.adjoint(&image).unwrap();
                [image, back].map(|image| image.pixels().mapv(f64::from))
            };
            let usual = with(GpuOptions::default(), usize::MAX);
            for (memory, pieces, host) in [
                (0, GpuOptions::DEFAULT_PIECE_BYTES, usize::MAX),
                (u64::MAX, 1 << 18, usize::MAX),
                (0, 1 << 16, 0),
                (1 << 20, 1, usize::MAX),
            ] {
                let limits = GpuOptions::default().with_memory(memory).with_pieces(pieces);
                let images = with(limits, host);
                for (image, usual) in images.iter().zip(&usual) {
                    let error = relative(image, usual);
                    assert!(error <= ORDER, "{memory} {pieces} {anchor} {paths:?}: {error:e}");
                }
            }
        }
    }
}

/// Uses a separate device, so that other tests are not affected.
fn lost(_: &OnDevice) {
    let gpu = GpuDevice::new(None).unwrap();
    let model = model_with(Arc::new(Waves), (6, 4), (3, 2), true, Normalisation::Unit);
    let scene = single(&scene(67, 53, 3));
    let plan = || scene.plan(&model, options(1e-3, Anchor::Source, Paths::Cheapest));
    let used = on_gpu_with(plan(), &gpu, GpuOptions::default());
    let before = used.image_of(&scene).unwrap();
    gpu.close();
    let is_lost = |error: &ConvError| matches!(error, ConvError::Gpu(GpuError::Lost { .. }));
    let error = used.image_of(&scene).unwrap_err();
    assert!(is_lost(&error), "{error}");
    assert!(error.to_string().contains("was lost"), "{error}");
    let error = used.adjoint(&before).unwrap_err();
    assert!(is_lost(&error), "{error}");
    let refused = Engine::on_gpu(plan(), &gpu, GpuOptions::default()).map_err(|(_, error)| error);
    assert!(matches!(refused, Err(GpuError::Lost { .. })), "{refused:?}");
}

fn refused(device: &OnDevice) {
    let gpu = device.handle();
    let model = model_with(Arc::new(Waves), (6, 4), (3, 2), true, Normalisation::Unit);
    let scene = scene(67, 53, 3);
    let plan = scene.plan(&model, options(1e-3, Anchor::Source, Paths::Cheapest));
    assert_eq!(plan.predicted_gpu_seconds(gpu.adapter()), None);
    let (plan, error) = Engine::on_gpu(plan, gpu, GpuOptions::default()).unwrap_err();
    assert_eq!(error, GpuError::Precision { precision: "f64" });
    // The plan still runs on the processor.
    let engine = Engine::new(plan);
    assert!(engine.image_of(&scene).is_ok() && engine.gpu().is_none());
    let layers = [model.clone(), model];
    let (shape, frame) = (scene.shape(), scene.frame);
    let options = options(1e-3, Anchor::Source, Paths::Cheapest);
    let plan = Plan::<f32>::of_layers(&layers, shape, frame, frame, options, &NoProgress).unwrap();
    let (_, error) = Engine::on_gpu(plan, gpu, GpuOptions::default()).unwrap_err();
    assert_eq!(error, GpuError::Layers);
    let huge = shaders::error_against_twin(gpu, gpu.adapter(), "add_rows", (1 << 15, 32), false);
    assert!(
        matches!(huge, Err(GpuError::TransformSize { size, most, .. }) if size == 1 << 15 && most < size)
    );
    let unknown = GpuDevice::new(Some("no such thing"));
    assert!(
        matches!(&unknown, Err(GpuError::NoSuchAdapter { present, .. }) if present.contains(&gpu.adapter().name)),
        "{unknown:?}"
    );
}

fn times(device: &OnDevice) {
    let model = model_with(Arc::new(Waves), (33, 29), (16, 11), true, Normalisation::Unit);
    // Every pixel is lit. Dark light would not be moved.
    let scene = single(&Scene::new(noise(211, 307, 3)));
    let plan = scene.plan(&model, options(1e-3, Anchor::Source, Paths::Transforms));
    let engine = device.with(plan);
    assert!(engine.gpu_times().is_none());
    engine.image_of(&scene).unwrap();
    let times = engine.gpu_times().unwrap();
    let work = engine.plan().gpu_work();
    // At least the light, and the image with the pixels that panels share, must be moved.
    assert!(
        times.bytes.0 + times.bytes.1 >= work.bus_bytes,
        "{times:?} {work:?}"
    );
    assert!(times.bytes.0 >= 4 * 307 * 211 && times.bytes.1 >= 4 * 307 * 211);
    assert_eq!(times.kernels.is_some(), device.handle().adapter().timestamps);
    assert!(
        times
            .kernels
            .is_none_or(|kernels| !kernels.is_zero() && kernels <= times.total)
    );
    assert!(
        engine
            .plan()
            .predicted_gpu_seconds(device.handle().adapter())
            .is_some_and(|s| s > 0.0)
    );
}
