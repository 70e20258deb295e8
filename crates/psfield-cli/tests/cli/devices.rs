//! `--device` and `psfield devices`, with and without a GPU. Tests that need one are in
//! `tests/gpu`.

use psfield::psf_io::{Card, CardValue};
use serde_json::Value;

use crate::desk::{Desk, assert_keys};

const TO: &str = "simulate scene.fits --psf samples.fits -o out.fits";

#[test]
fn devices_are_listed_or_it_is_said_that_there_are_none() {
    let desk = Desk::empty();
    let report = desk.done_with_drivers("devices --json").json();
    assert_keys(&report, &["instruction_set", "gpu_support", "adapters", "auto"]);
    assert_eq!(report["gpu_support"], cfg!(feature = "gpu"));
    let adapters = report["adapters"].as_array().unwrap();
    let text = desk.done_with_drivers("devices").stdout;
    match (cfg!(feature = "gpu"), adapters.first()) {
        (false, _) => assert!(adapters.is_empty() && text.contains("built without GPU support")),
        (true, None) => assert!(text.contains("No GPU was found"), "{text}"),
        (true, Some(first)) => {
            assert!(text.contains(first["name"].as_str().unwrap()), "{text}");
        }
    }
    assert_eq!(desk.done_with_drivers("devices -q").stdout, "");
    desk.refused("devices all", 2, &["all"]);
}

#[cfg(unix)]
#[test]
fn a_variable_chooses_the_vector_instructions() {
    let desk = Desk::empty();
    let run = desk.shell("PSFIELD_SIMD=scalar \"$PSFIELD\" devices --json");
    assert_eq!(run.json()["instruction_set"], "scalar");
    let run = desk.shell("PSFIELD_SIMD=avx51 \"$PSFIELD\" devices");
    assert!(
        run.code == Some(2) && run.stderr.contains("PSFIELD_SIMD"),
        "{run:?}"
    );
}

#[cfg(unix)]
#[test]
fn drivers_do_not_write_to_the_terminal() {
    let run = Desk::empty().shell("env -u XDG_RUNTIME_DIR \"$PSFIELD\" devices");
    assert_eq!((run.code, run.stderr.as_str()), (Some(0), ""), "{run:?}");
}

/// The `device` in the report of a run.
fn device(desk: &Desk, options: &str) -> Value {
    let run = desk.run(&format!("{TO} {options} --overwrite --json"));
    assert_eq!(run.code, Some(0), "{run:?}");
    run.json()["device"].clone()
}

#[test]
fn small_and_unsuited_work_stays_on_the_cpu_and_says_why() {
    let desk = Desk::new();
    desk.write("stars.csv", "x,y,flux\n30,25,5\n");
    for (options, reason) in [
        ("", "small"),
        ("--device cpu", "asked"),
        ("--device cpu --method direct", "asked"),
        ("--device auto --precision f64", "precision"),
        ("--method basis", "method"),
        ("--gpu-adapter any --gpu-memory 64M", "small"),
        ("--stream", "small"),
    ] {
        let device = device(&desk, options);
        assert_eq!(device["on"], "cpu", "{options}");
        assert_eq!(device["reason"]["kind"], reason, "{options}");
        assert!(device["text"].as_str().unwrap().starts_with("on the CPU: "));
        let card = desk.header("out.fits").get("PSFDEV").and_then(Card::value);
        assert_eq!(card, Some(CardValue::Text("CPU".into())), "{options}");
    }
    let stars = "simulate --catalog stars.csv --shape 61,51 --psf samples.fits -o stars.fits";
    let report = desk.done(&format!("{stars} --json")).json();
    assert_eq!(report["device"]["reason"]["kind"], "stars");
    let text = desk.done(&format!("{TO} --overwrite --device cpu")).stdout;
    assert!(text.contains("\ndevice: on the CPU: as asked\n"), "{text}");
}

#[test]
fn options_that_exclude_each_other() {
    let desk = Desk::new();
    for (options, needles) in [
        ("--device fast", ["--device", "auto"]),
        ("--device cpu --gpu-adapter x", ["--gpu-adapter", "--device cpu"]),
        ("--device cpu --gpu-memory 1G", ["--gpu-memory", "--device cpu"]),
        ("--device gpu --precision f64", ["--device gpu", "f32"]),
        ("--device gpu --method direct", ["--device gpu", "lowrank"]),
        ("--device gpu --method basis", ["--device gpu", "lowrank"]),
        ("--device gpu --method patch=32", ["--device gpu", "lowrank"]),
        ("--gpu-memory much", ["--gpu-memory", "256M"]),
    ] {
        desk.refused(&format!("{TO} {options}"), 2, &needles);
    }
    desk.write(
        "night.toml",
        "[[job]]\nscene = 'scene.fits'\npsf = 'samples.fits'\noutput = 'out.fits'\ndevice = 'gpu'\nprecision = 'f64'\n",
    );
    desk.refused(
        "batch night.toml",
        2,
        &["night.toml", "job 1", "--device gpu", "f32"],
    );
    for (options, needles) in [
        ("--device auto", ["--device", "cpu"]),
        ("--gpu-adapter x", ["--gpu-adapter", "--device gpu"]),
        ("--device gpu --precision f64", ["--device gpu", "f32"]),
    ] {
        desk.refused(&format!("bench --quick {options}"), 2, &needles);
    }
}

#[test]
#[cfg(not(feature = "gpu"))]
fn a_build_without_gpus_says_how_to_get_one_with() {
    // Another package of this build may have enabled the feature `gpu` of the library.
    let refused = psfield::device::open_gpu(Some("no such GPU")).unwrap_err();
    if !refused.to_string().contains("without GPU support") {
        return;
    }
    let desk = Desk::new();
    desk.write("stars.csv", "x,y,flux\n30,25,5\n");
    let needles = ["built without GPU support", "--features gpu"];
    desk.refused(&format!("{TO} --device gpu"), 1, &needles);
    let stars = "simulate --catalog stars.csv --shape 61,51 --psf samples.fits -o out.fits --device gpu";
    desk.refused(stars, 1, &needles);
    desk.refused("bench --quick --device gpu", 1, &needles);
}
