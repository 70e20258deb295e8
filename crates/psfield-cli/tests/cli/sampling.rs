//! `psfield sample` and `psfield demo`.

use serde_json::Value;

use crate::desk::{Desk, assert_keys};

/// A small telescope, in focus in the middle of its field.
pub(crate) const TELESCOPE: &str = r#"name = "small"
wavelength_nm = 633.0
pixel_scale_arcsec = 0.1
frame = { nx = 128, ny = 96 }
stamp = { nx = 24, ny = 24 }
aperture = { diameter_m = 1.2, obscuration = 0.3 }

[wavefront]
unit = "nm"
modes = [{ noll = 4, terms = [{ x = 2, value = 60.0 }, { y = 2, value = 30.0 }] }]

[detector]
pixel_integration = true
"#;

fn desk() -> Desk {
    let desk = Desk::empty();
    desk.write("telescope.toml", TELESCOPE);
    desk
}

fn sampled(desk: &Desk, options: &str, out: &str) -> Value {
    desk.done(&format!("sample telescope.toml -o {out} --json {options}"))
        .json()
}

/// The default settings suit the built-in telescopes: some hundred samples, and seconds.
#[test]
fn presets_need_no_options() {
    let desk = Desk::empty();
    for preset in ["survey-2m", "wide-field-lens"] {
        let line = format!("sample --preset {preset} -o {preset}.fits --json");
        let report = desk.done(&line).json();
        assert_eq!(report["outcome"], "met", "{preset}");
        assert_eq!(report["method"], "kriging", "{preset}");
        assert!(report["samples"].as_u64().unwrap() < 250, "{report}");
        assert_eq!(report["draws"], report["samples"], "no draw is lost");
        let random = &report["verification"];
        assert_eq!(
            (random["tests"].as_u64(), random["above"].as_u64()),
            (Some(16), Some(0))
        );
        assert!(random["fraction_limit"].as_f64().unwrap() < 0.171);
    }
}

#[test]
fn uniform_samples() {
    let desk = desk();
    let report = sampled(&desk, "--uniform 4,3", "uniform.fits");
    assert_keys(
        &report,
        &["output", "samples", "draws", "cells", "worst", "outcome"],
    );
    assert_eq!(report["samples"], 12);
    let samples = desk.samples("uniform.fits");
    assert_eq!(samples.len(), 12);
    let field = samples.positions().field().unwrap();
    assert_eq!((field.nx(), field.ny()), (128, 96));
    let at: Vec<(f64, f64)> = samples
        .positions()
        .as_slice()
        .iter()
        .map(|p| (p.x(), p.y()))
        .collect();
    for corner in [(0.0, 0.0), (127.0, 0.0), (0.0, 95.0), (127.0, 95.0)] {
        assert!(at.contains(&corner), "{corner:?}");
    }
    desk.done("fit uniform.fits -o model.fits");
}

#[test]
fn adaptive_samples() {
    let desk = desk();
    let learned = sampled(&desk, "--threshold 0.01 --verify 20 --seed 5", "learned.fits");
    assert_keys(&learned, &["method", "worst_at", "expected", "verification"]);
    assert_eq!(
        (&learned["method"], &learned["outcome"]),
        (&"kriging".into(), &"met".into())
    );
    assert_eq!(learned["verification"]["tests"], 20);
    assert!(learned["expected"].as_f64().unwrap() <= 0.01);
    let text = desk.done("sample telescope.toml -o text.fits --threshold 0.01");
    assert!(
        text.stdout.contains("0 of 16 PSFs above the threshold"),
        "{text:?}"
    );
    let loose = sampled(&desk, "--threshold 0.2 --start 3,3", "loose.fits");
    let tight = sampled(&desk, "--threshold 0.1 --start 3,3", "tight.fits");
    for (report, threshold) in [(&loose, 0.2), (&tight, 0.1)] {
        assert_eq!(report["outcome"], "met");
        assert_eq!(report["method"], "mesh", "--start belongs to the mesh");
        assert!(report["worst"].as_f64().unwrap() <= threshold);
    }
    let count = |report: &Value| report["samples"].as_u64().unwrap() as usize;
    assert!(count(&tight) > count(&loose) && count(&loose) > 9);
    assert_eq!(desk.samples("tight.fits").len(), count(&tight));
    let by_error = sampled(
        &desk,
        "--criterion interpolation --threshold 0.1 --measure l1",
        "error.fits",
    );
    assert_eq!(by_error["outcome"], "met");
}

#[test]
fn a_cap_is_an_error_unless_accepted() {
    let desk = desk();
    // Kriging, and the mesh. The old name of the option still works.
    for (out, options, draws) in [
        ("kriging.fits", "--max-draws 30", "30 draws"),
        ("mesh.fits", "--max-samples 100 --method mesh", "100 draws"),
    ] {
        let to = format!("sample telescope.toml -o {out} --threshold 1e-6 {options}");
        let needles = [
            draws,
            "--max-draws",
            "--threshold",
            "--accept-cap",
            "largest error",
            "at (",
        ];
        desk.refused(&to, 1, &needles);
        let run = desk.run(&format!("{to} --accept-cap --json"));
        assert_eq!(run.code, Some(0), "{run:?}");
        assert!(
            run.stderr.contains("warning") && run.stderr.contains(draws),
            "{run:?}"
        );
        let report = run.json();
        assert_eq!(report["outcome"], "cap-reached");
        assert!((20..=100).contains(&desk.samples(out).len()));
        let quiet = desk.done(&format!("{to} --accept-cap --overwrite -q"));
        assert_eq!(quiet.stdout, "");
    }
}

#[test]
fn bad_telescopes_and_options() {
    let desk = desk();
    desk.write("bad.toml", TELESCOPE.replace("wavelength_nm", "wavelength"));
    desk.refused(
        "sample bad.toml -o out.fits",
        1,
        &["bad.toml", "`wavelength`", "wavelength_nm"],
    );
    desk.write("bad.toml", TELESCOPE.replace("633.0", "-633.0"));
    desk.refused("sample bad.toml -o out.fits", 1, &["bad.toml", "-633"]);
    desk.refused("sample none.toml -o out.fits", 1, &["none.toml"]);
    desk.refused("sample -o out.fits", 2, &["TELESCOPE.toml"]);
    let to = "sample telescope.toml -o out.fits";
    for (option, needle) in [
        ("--threshold 0", "--threshold"),
        ("--threshold -0.1", "--threshold"),
        ("--start 1,5", "--start"),
        ("--uniform 3,0", "--uniform"),
        ("--uniform 1000000,1000000", "--uniform"),
        ("--max-draws 15", "at least 16"),
        ("--max-draws 24 --start 5,5", "--max-draws"),
        ("--method kriging --start 5,5", "left out with the method kriging"),
        (
            "--method kriging --criterion neighbours",
            "left out with the method kriging",
        ),
        (
            "--criterion neighbours --verify 5",
            "left out with the method mesh",
        ),
        ("--uniform 3,3 --verify 5", "--verify"),
        ("--uniform 3,3 --threshold 0.1", "--threshold"),
        ("--preset survey-2m", "--preset"),
    ] {
        desk.refused(&format!("{to} {option}"), 2, &[needle]);
    }
}

#[test]
fn a_model_is_validated_between_its_samples() {
    let desk = desk();
    let report = sampled(&desk, "--uniform 5,5 --hold-out 30", "samples.fits");
    assert_eq!(report["hold_out"], "samples_holdout.fits");
    assert_eq!(report["held_out"], 30);
    let held_out = desk.samples("samples_holdout.fits");
    let samples = desk.samples("samples.fits");
    assert_eq!((held_out.len(), samples.len()), (30, 25));
    assert_eq!(held_out.grid(), samples.grid());

    desk.done("fit samples.fits -o model.fits");
    let validated = |truth: &str| {
        let run = desk.run(&format!(
            "validate model.fits --reference {truth}.fits --report {truth} --json"
        ));
        assert_eq!(run.code, Some(0), "{run:?}");
        let report = run.json();
        let error = report["objects"]["summary"]["relative_l2"]["median"].as_f64();
        (error.unwrap(), report["at_samples"].as_u64().unwrap(), run.stderr)
    };
    let (between, coinciding, quiet) = validated("samples_holdout");
    assert_eq!((coinciding, quiet.as_str()), (0, ""));
    let (at_samples, coinciding, warning) = validated("samples");
    assert_eq!(coinciding, 25);
    assert!(warning.contains("25 of 25 objects in samples.fits"), "{warning}");
    // On its own samples a model looks better than it is.
    assert!(between > 1.5 * at_samples, "{between} {at_samples}");

    let page = String::from_utf8(desk.bytes("samples/report.html")).unwrap();
    assert!(page.contains("25 PSFs, 25 of them at positions of the model's own samples"));
    // A PSFEx file does not tell its samples.
    desk.done("convert model.fits -o field.psf --to psfex=2 -q");
    let run = desk.run("validate field.psf --reference samples.fits --report field --json");
    assert!(run.json()["at_samples"].is_null(), "{run:?}");
    let page = String::from_utf8(desk.bytes("field/report.html")).unwrap();
    assert!(page.contains("25 PSFs, the positions of the model's own samples are not known"));
    // A seed gives one choice, and needs something to choose.
    desk.done("sample telescope.toml -o again.fits --uniform 5,5 --hold-out 30 --seed 2");
    assert_ne!(desk.samples("again_holdout.fits"), held_out);
    for fixed in ["--uniform 3,3", "--method mesh"] {
        let line = format!("sample telescope.toml -o seed.fits {fixed} --seed 2");
        desk.refused(&line, 2, &["--hold-out"]);
    }
    desk.refused(
        "sample telescope.toml -o again.fits --hold-out 0 --overwrite",
        2,
        &["--hold-out"],
    );
    // The second file is an output like the first.
    std::fs::remove_file(desk.path("again.fits")).unwrap();
    desk.refused(
        "sample telescope.toml -o again.fits --uniform 5,5 --hold-out 3",
        1,
        &["again_holdout.fits", "--overwrite"],
    );
}

#[test]
fn demo_writes_all_that_it_lists_and_protects_it() {
    let desk = Desk::empty();
    let report = desk.done("demo --out demo --json").json();
    assert_keys(
        &report,
        &["files", "samples", "rank", "elbow", "spot_check", "seconds"],
    );
    let mut listed: Vec<String> = serde_json::from_value(report["files"].clone()).unwrap();
    let mut there: Vec<String> = desk
        .content()
        .into_keys()
        .map(|path| path.file_name().unwrap().to_str().unwrap().to_owned())
        .collect();
    listed.sort();
    there.sort();
    assert_eq!(listed, there);
    let written: Value = serde_json::from_slice(&desk.bytes("demo/report.json")).unwrap();
    assert_eq!(written, report);

    // The numbers are plausible.
    // Images and stars are within the default tolerance.
    assert!(report["spot_check"]["relative_rms"].as_f64().unwrap() < 1e-4);
    assert!(report["model_error_max"].as_f64().unwrap() < 0.02);
    // |e| = (a^2 - b^2) / (a^2 + b^2), which is below sqrt(1 - b^2 / a^2).
    let shape = |name: &str| report[name].as_f64().unwrap();
    assert!(
        shape("ellipticity_max") < 0.5 * shape("eccentricity_max"),
        "{report}"
    );
    assert_eq!(
        desk.samples("demo/samples.fits").len() as u64,
        report["samples"].as_u64().unwrap()
    );
    assert_eq!(desk.image("demo/image.fits").dim(), (1024, 1024));
    for (name, start) in [
        ("sampling.svg", "<svg xmlns=".as_bytes()),
        ("psf_field.svg", b"<svg xmlns="),
        ("patch_error.svg", b"<svg xmlns="),
        ("scene.png", b"\x89PNG"),
        ("image.png", b"\x89PNG"),
    ] {
        assert!(desk.bytes(&format!("demo/{name}")).starts_with(start), "{name}");
    }

    // The other commands read its files, and give its image.
    desk.done("simulate demo/scene.fits --catalog demo/stars.csv --psf demo/model.fits -o again.fits");
    let compared = desk.done("compare again.fits demo/image.fits --json").json();
    assert_eq!(compared["max_abs"], 0.0);

    desk.refused(
        "demo --out demo",
        1,
        &["demo/telescope.toml", "exists", "--overwrite"],
    );
    // Nothing is written even if only the last file is in the way.
    for name in listed.iter().filter(|name| *name != "report.json") {
        std::fs::remove_file(desk.path(&format!("demo/{name}"))).unwrap();
    }
    desk.refused(
        "demo --out demo",
        1,
        &["demo/report.json", "exists", "--overwrite"],
    );
    desk.refused("demo --out again.fits", 1, &["again.fits", "folder"]);
}
