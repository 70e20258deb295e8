//! The fast engine on a GPU: against the truth, against the CPU, and pixel by pixel. A driver that
//! runs shaders on the processor is sufficient. Without any driver, these tests show as ignored.

use std::slice::from_ref;
use std::sync::OnceLock;

use libtest_mimic::{Failed, Trial};
use ndarray::Array2;
use psfield::conv_core::gpu::{GpuDevice, GpuError, GpuOptions};
use psfield::conv_core::{Engine, Operation, Paths, Plan, PlanOptions};
use psfield::metrics::Comparison;
use psfield::psf_types::{Anchor, NoProgress};

use crate::data::{Field, ROMAN, STRONG, ensure, trial};
use crate::responses::{Probes, lit_everywhere};
use crate::simulation::{ANCHORS, FULL};
use crate::tolerance::{MORE, ROUNDING_F32};

const TOLERANCES: [f64; 4] = [1e-1, 1e-3, 1e-5, 0.0];
/// Rounding in single precision, as on the CPU.
const SINGLE: f64 = 1e-6;
/// Difference between two devices that round in different orders.
const PARITY: f64 = 3e-6;
/// The tolerances at which single pixels are tested: one truncates modes, the other keeps all.
const OF_PIXELS: [f64; 2] = [1e-3, 0.0];
const PIXELS: usize = 300;

/// The GPU that all tests share, or the reason why there is none.
fn gpu() -> &'static Result<GpuDevice, GpuError> {
    static GPU: OnceLock<Result<GpuDevice, GpuError>> = OnceLock::new();
    GPU.get_or_init(|| GpuDevice::new(None))
}

fn on_gpu(plan: Plan<f32>) -> Result<Engine<f32>, Failed> {
    let gpu = gpu().as_ref()?;
    Ok(Engine::on_gpu(plan, gpu, GpuOptions::default()).map_err(|(_, error)| error)?)
}

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = Vec::new();
    for field in [STRONG, ROMAN] {
        for (anchor, name) in ANCHORS {
            let label = |what: &str| format!("{}, {name}-anchored: {what} on a GPU", field.name);
            trials.push(trial(label("low rank"), move || images(field, anchor, name)));
            trials.push(trial(label("every pixel's PSF"), move || {
                responses(field, anchor)
            }));
        }
    }
    if let Err(reason) = gpu() {
        eprintln!("tests on a GPU are skipped and show as ignored: {reason}");
        trials = trials
            .into_iter()
            .map(|trial| trial.with_kind("no GPU").with_ignored_flag(true))
            .collect();
    }
    trials
}

fn images(field: Field, anchor: Anchor, truth: &str) -> Result<(), Failed> {
    let model = field.model(FULL)?;
    let exact = field.truth(truth)?;
    let scene = field.scene::<f32>()?;
    for tolerance in TOLERANCES {
        let options = PlanOptions::new(tolerance)?.with_anchor(anchor);
        let plan = || Plan::new(&model, scene.shape(), scene.shape().region(), options);
        let image = |engine: Engine<f32>| -> Result<Array2<f32>, Failed> {
            let mut image = engine.plan().zeros();
            engine.execute(
                Operation::Convolve,
                from_ref(&scene.view()),
                vec![image.view_mut()],
                &NoProgress,
            )?;
            Ok(image)
        };
        let (on_cpu, on_gpu) = (image(Engine::new(plan()?))?, image(on_gpu(plan()?)?)?);
        let error = Comparison::of(on_gpu.view(), exact.pixels())?.relative_l2()?;
        let apart = Comparison::of(on_gpu.view(), on_cpu.view())?.relative_l2()?;
        println!(
            "{} {truth} at {tolerance:.0e}: relative L2 {error:.3e}, from the CPU {apart:.3e}",
            field.name
        );
        ensure(error <= tolerance + SINGLE && apart <= PARITY, || {
            format!("at {tolerance:e}: relative L2 {error:.3e}, from the CPU {apart:.3e}")
        })?;
    }
    Ok(())
}

fn responses(field: Field, anchor: Anchor) -> Result<(), Failed> {
    let model = field.model(FULL)?;
    let frame = field.frame()?;
    let probes = Probes::random(&model, (frame.nx(), frame.ny()), PIXELS, anchor)?;
    let light = lit_everywhere::<f32>(frame.nx(), frame.ny(), 3);
    for tolerance in OF_PIXELS {
        for paths in [Paths::Transforms, Paths::Cheapest] {
            let options = PlanOptions::new(tolerance)?.with_anchor(anchor).with_paths(paths);
            let engine = on_gpu(Plan::new(&model, frame, frame.region(), options)?)?;
            let found = probes.measure(&engine, &light, MORE, tolerance + ROUNDING_F32)?;
            let line = format!(
                "{} {anchor} {paths:?} at {tolerance:.0e}: largest {:.2e}, beyond the stamps {:.1e}, {} violations",
                field.name, found.largest, found.stray, found.violations
            );
            println!("{line}");
            ensure(found.violations == 0 && found.stray <= ROUNDING_F32, || line)?;
        }
    }
    Ok(())
}
