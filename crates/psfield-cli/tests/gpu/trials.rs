//! The tests of the command line on a GPU.

use ndarray::{Array2, Array3};
use psfield::conv_core::gpu::{AdapterKind, adapters};
use psfield::conv_core::{ConvReal, Plan, PlanOptions};
use psfield::device::{CpuReason, MIN_SECONDS_FOR_GPU, Placement};
use psfield::psf_io::{Card, CardValue};
use psfield::psf_types::NoProgress;
use psfield::{Device, Psf, Scene, SimulateOptions, Simulator};
use serde_json::Value;

use crate::desk::{Desk, Run, assert_keys, difference};

/// Rounding of a plan in f32 by different hardware, relative to the peak.
pub(crate) const ROUNDING: f64 = 1e-5;
/// Two results that differ by more than this are not equal.
const VISIBLE: f64 = 1e-3;

pub(crate) const TO: &str = "simulate scene.fits --psf samples.fits";

/// The adapter that `--device gpu` takes: its name, kind and backend.
fn preferred() -> String {
    adapters()[0].to_string()
}

fn text(desk: &Desk, file: &str, keyword: &str) -> Option<String> {
    match desk.header(file).get(keyword).and_then(Card::value) {
        Some(CardValue::Text(text)) => Some(text),
        _ => None,
    }
}

pub(crate) fn agree() {
    let desk = Desk::new();
    for anchor in ["source", "output"] {
        for method in ["auto", "lowrank", "lowrank --stream", "lowrank --gpu-memory 1K"] {
            let options = format!("--anchor {anchor} --method {method} --overwrite");
            desk.done_with_drivers(&format!("{TO} {options} --device gpu -o {anchor}.fits"));
            let options = options.replace("--gpu-memory", "--memory");
            let run = desk.run(&format!("{TO} {options} --device cpu -o cpu.fits"));
            assert_eq!(run.code, Some(0), "{run:?}");
            // A plan beyond its memory is made again by each execution.
            let is_slow = run.stderr.contains("option --memory");
            assert_eq!(is_slow, options.contains("--memory"), "{run:?}");
            let apart = difference(&desk.image(&format!("{anchor}.fits")), &desk.image("cpu.fits"));
            assert!(apart <= ROUNDING, "{anchor} {method}: {apart:e}");
        }
    }
    // The comparison can fail.
    assert!(difference(&desk.image("source.fits"), &desk.image("output.fits")) > VISIBLE);
}

pub(crate) fn signed() {
    let desk = Desk::new();
    let report = desk
        .done_with_drivers(&format!("{TO} --device gpu -o gpu.fits --spot-check 50 --json"))
        .json();
    assert_eq!(report["device"]["on"], "gpu");
    assert_eq!(report["device"]["adapter"], preferred().as_str());
    assert_eq!(report["device"]["predicted_seconds"], Value::Null);
    assert_eq!(report["spot_check"]["passed"], true);
    assert_eq!(text(&desk, "gpu.fits", "PSFDEV"), Some(preferred()));
    let said = desk
        .done_with_drivers(&format!("{TO} --device gpu -o gpu.fits --overwrite"))
        .stdout;
    assert!(
        said.contains(&format!("\ndevice: on {}\n", preferred())),
        "{said}"
    );
}

pub(crate) fn names() {
    let desk = Desk::new();
    let first = &adapters()[0];
    let part: String = first
        .name
        .split_whitespace()
        .next()
        .unwrap_or_default()
        .to_uppercase();
    for name in [part.as_str(), first.backend.as_str()] {
        desk.done_with_drivers(&format!(
            "{TO} --device gpu --gpu-adapter {name} -o out.fits --overwrite"
        ));
        assert_eq!(text(&desk, "out.fits", "PSFDEV"), Some(preferred()), "{name}");
    }
}

pub(crate) fn unknown_names() {
    let desk = Desk::new();
    let name = &adapters()[0].name;
    let needles = ["voodoo-2", name.as_str(), "--device cpu"];
    desk.refused(
        &format!("{TO} --device gpu --gpu-adapter voodoo-2 -o out.fits"),
        1,
        &needles,
    );
    desk.refused(
        "bench --quick --device gpu --gpu-adapter voodoo-2",
        1,
        &needles[..2],
    );
}

pub(crate) fn listed() {
    let desk = Desk::empty();
    let report = desk.done_with_drivers("devices --json").json();
    let rows = report["adapters"].as_array().unwrap();
    assert_eq!(rows.len(), adapters().len());
    for (k, (row, adapter)) in rows.iter().zip(adapters()).enumerate() {
        assert_keys(
            row,
            &[
                "name",
                "kind",
                "backend",
                "driver",
                "timestamps",
                "workgroup_threads",
            ],
        );
        assert_eq!(row["preferred"], k == 0);
        assert_eq!(row["name"], adapter.name);
        assert_eq!(row["largest_binding_bytes"], adapter.largest_binding);
        assert_eq!(row["workgroup_memory_bytes"], adapter.workgroup_memory);
    }
    let table = desk.done_with_drivers("devices").stdout;
    let marked: Vec<&str> = table.lines().filter(|line| line.starts_with("*  ")).collect();
    assert!(
        marked.len() == 1 && marked[0].contains(&adapters()[0].name),
        "{table}"
    );
    let takes_cpu = report["auto"].as_str().unwrap().starts_with("takes the CPU");
    assert_eq!(takes_cpu, adapters()[0].kind == AdapterKind::Software);
}

pub(crate) fn stars_alone() {
    let desk = Desk::new();
    desk.write("stars.csv", "x,y,flux\n30,25,5\n");
    desk.warned(
        "simulate --catalog stars.csv --shape 61,51 --psf samples.fits -o out.fits --device gpu",
        "stars and galaxies are drawn on the CPU",
    );
    assert_eq!(text(&desk, "out.fits", "PSFDEV").as_deref(), Some("CPU"));
}

pub(crate) fn batch() {
    let desk = Desk::new();
    let job = |output: &str, device: &str| {
        format!("[[job]]\nscene = 'scene.fits'\noutput = '{output}.fits'\ndevice = '{device}'\n")
    };
    let jobs = [job("a", "gpu"), job("b", "gpu"), job("c", "cpu")].concat();
    desk.write("night.toml", format!("[defaults]\npsf = 'samples.fits'\n{jobs}"));
    let run = desk.done_with_drivers("batch night.toml");
    let lines: Vec<Value> = run
        .stdout
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let reused: Vec<&Value> = lines.iter().map(|line| &line["reused"]).collect();
    // The plan on the GPU differs from that of the processor.
    assert_eq!(reused, [false, true, false]);
    for (name, adapter) in [("a", preferred()), ("b", preferred()), ("c", "CPU".into())] {
        assert_eq!(text(&desk, &format!("{name}.fits"), "PSFDEV"), Some(adapter));
    }
    assert!(desk.image("a.fits") == desk.image("b.fits"));
    assert!(difference(&desk.image("a.fits"), &desk.image("c.fits")) <= ROUNDING);
}

pub(crate) fn batch_after_trouble() {
    let desk = Desk::new();
    let job = |output: &str, adapter: &str| {
        format!("[[job]]\noutput = '{output}.fits'\ngpu-adapter = '{adapter}'\n")
    };
    let backend = &adapters()[0].backend;
    let jobs = [job("a", backend), job("b", "voodoo-2"), job("c", backend)].concat();
    desk.write(
        "night.toml",
        format!("[defaults]\nscene = 'scene.fits'\npsf = 'samples.fits'\ndevice = 'gpu'\n{jobs}"),
    );
    let run = desk.run("batch night.toml");
    assert_eq!(run.code, Some(1), "{run:?}");
    let statuses: Vec<Value> = run
        .stdout
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap()["status"].clone())
        .collect();
    assert_eq!(statuses, ["done", "failed", "done"], "{run:?}");
    assert!(desk.image("a.fits") == desk.image("c.fits"));
}

pub(crate) fn bench() {
    let desk = Desk::empty();
    let run = desk.done_with_drivers(
        "bench --sizes 96 --grids 3 --methods single,lowrank,auto,patch --tolerances 1e-3 --patches 48 --repeat 1 \
         --pixels 60 --device gpu --json out.json",
    );
    assert!(
        run.stdout
            .contains(&format!("lowrank and auto on {}", preferred()))
    );
    assert!(run.stdout.contains("kernel s"), "{}", run.stdout);
    let report: Value = serde_json::from_slice(&desk.bytes("out.json")).unwrap();
    assert_eq!(report["options"]["device"], "gpu");
    for row in report["rows"].as_array().unwrap() {
        let on_gpu = ["lowrank", "auto"].contains(&row["method"].as_str().unwrap());
        let adapter = if on_gpu {
            Value::from(preferred())
        } else {
            Value::Null
        };
        assert_eq!(row["gpu"], adapter, "{row}");
        if let Some(error) = row["tolerance"].as_f64() {
            assert!(row["relative_l2"].as_f64().unwrap() <= error + ROUNDING, "{row}");
        }
        let times = &row["gpu_seconds"];
        if !on_gpu {
            assert_eq!(*times, Value::Null, "{row}");
            continue;
        }
        let (total, run) = (times["total"].as_f64().unwrap(), row["seconds"].as_f64().unwrap());
        assert!(total > 0.0 && total <= run, "{row}");
        assert_eq!(times["kernels"].is_number(), adapters()[0].timestamps, "{row}");
        let copied: u64 = (0..2).map(|k| times["bytes"][k].as_u64().unwrap()).sum();
        assert!(
            copied >= 2 * 4 * 96 * 96 && copied >= times["least_bytes"][0].as_u64().unwrap(),
            "{row}"
        );
    }
    let cpu = desk.done_with_drivers(
        "bench --sizes 32 --grids 2 --methods lowrank --tolerances 1e-2 --repeat 1 --pixels 9",
    );
    assert!(!cpu.stdout.contains("kernel s"), "{}", cpu.stdout);
}

/// Half the width of a stamp.
const HALF: usize = 15;

/// A simulator limited only by rounding, for frames of `size` x `size` pixels and Gaussians that
/// widen to the right.
fn simulator<T: ConvReal>(size: usize, options: SimulateOptions) -> Simulator<T> {
    let last = (size - 1) as f64;
    let corners = [(0.0, 0.0), (last, 0.0), (0.0, last), (last, last)];
    let squared = |k: usize| (k as f64 - HALF as f64).powi(2);
    let side = 2 * HALF + 1;
    let stamps = Array3::from_shape_fn((4, side, side), |(j, y, x)| {
        (-(squared(y) + squared(x)) / (8.0 + j as f64)).exp()
    });
    let psf = Psf::from_samples(stamps.view(), &corners).unwrap();
    let options = SimulateOptions {
        tolerance: 0.0,
        ..options
    };
    psf.simulator((size, size)).options(options).build().unwrap()
}

pub(crate) fn double() {
    let options = SimulateOptions {
        device: Device::Gpu,
        ..SimulateOptions::default()
    };
    let simulator = simulator::<f64>(40, options);
    let error = simulator.prepare(&Scene::streamed(), &NoProgress).unwrap_err();
    assert!(
        error.kind() == psfield::ErrorKind::Gpu && error.to_string().contains("f32"),
        "{error}"
    );
}

/// Pixels along each side of a frame for which `auto` considers GPUs.
const LARGE: usize = 4096;

pub(crate) fn auto() {
    // Predictions depend on the number of threads.
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let light = Array2::zeros((LARGE, LARGE));
    let scene = Scene::<f32>::new(light).unwrap();
    let simulator = simulator::<f32>;
    let of_auto = simulator(LARGE, SimulateOptions::default());
    let made = one_thread.install(|| of_auto.prepare(&scene, &NoProgress).unwrap());
    let cpu = made.plan.unwrap().predicted_seconds;
    assert!(cpu > MIN_SECONDS_FOR_GPU, "a larger frame is needed: {cpu}");
    let first = &adapters()[0];
    let shape = of_auto.scene_shape();
    let memory = PlanOptions::memory_for::<f32>(shape, made.model);
    let options = PlanOptions::default().with_memory(memory);
    let plan = Plan::<f32>::new(made.model, shape, shape.region(), options).unwrap();
    let (gpu, placement) = (plan.predicted_gpu_seconds(first), made.placement);
    let on_gpu = matches!(placement, Placement::Gpu { .. });
    of_auto.simulate(&scene).unwrap();
    assert_eq!(on_gpu, of_auto.gpu_seconds().is_some(), "{placement}");
    let software = first.kind == AdapterKind::Software;
    assert_eq!(
        on_gpu,
        !software && gpu.is_some_and(|gpu| gpu < cpu),
        "{placement}"
    );
    if software {
        let reason = CpuReason::Software {
            adapter: first.to_string(),
        };
        assert_eq!(placement, Placement::Cpu { reason });
    }
    // With an unknown name `auto` uses the CPU and says so.
    let unknown = SimulateOptions {
        gpu_adapter: Some("voodoo-2".into()),
        ..SimulateOptions::default()
    };
    let of_unknown = simulator(LARGE, unknown);
    let made = one_thread.install(|| of_unknown.prepare(&scene, &NoProgress).unwrap());
    of_unknown.simulate(&scene).unwrap();
    assert!(of_unknown.gpu_seconds().is_none());
    let placement = made.placement;
    assert!(placement.is_failure(), "{placement}");
    assert!(placement.to_string().contains("voodoo-2"), "{placement}");
}

/// Environment that hides drivers from the loaders of Vulkan and EGL.
const HIDDEN: &str = "VK_DRIVER_FILES=/nonexistent VK_ICD_FILENAMES=/nonexistent __EGL_VENDOR_LIBRARY_FILENAMES=/nonexistent \
     EGL_PLATFORM=none $PSFIELD";

pub(crate) fn no_adapter_when_hidden() -> bool {
    let run = Desk::empty().shell(&format!("{HIDDEN} devices --json"));
    run.code == Some(0) && run.json()["adapters"].as_array().is_some_and(Vec::is_empty)
}

pub(crate) fn without() {
    let desk = Desk::new();
    let run = |arguments: &str| -> Run { desk.shell(&format!("{HIDDEN} {arguments}")) };
    let none = run("devices");
    assert!(
        none.code == Some(0) && none.stdout.contains("No GPU was found"),
        "{none:?}"
    );
    for options in ["", "--gpu-adapter nvidia"] {
        let refused = run(&format!("{TO} --device gpu {options} -o out.fits"));
        assert_eq!(refused.code, Some(1), "{refused:?}");
        assert!(refused.stderr.contains("there is no GPU"), "{refused:?}");
        assert!(!desk.path("out.fits").exists());
    }
    let auto = run(&format!("{TO} -o out.fits"));
    assert_eq!((auto.code, auto.stderr.as_str()), (Some(0), ""), "{auto:?}");
}
