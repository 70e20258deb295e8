//! `psfield sample` and `psfield demo`.

use serde_json::Value;

use crate::desk::{Desk, assert_keys};

/// A small telescope, in focus in the middle of its field.
const TELESCOPE: &str = r#"
name = "small"
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
    let loose = sampled(&desk, "--threshold 0.2 --start 3,3", "loose.fits");
    let tight = sampled(&desk, "--threshold 0.1 --start 3,3", "tight.fits");
    for (report, threshold) in [(&loose, 0.2), (&tight, 0.1)] {
        assert_eq!(report["outcome"], "met");
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
    let to = "sample telescope.toml -o out.fits --threshold 0.01 --max-samples 30";
    desk.refused(
        to,
        1,
        &["30 samples", "--max-samples", "--threshold", "--accept-cap"],
    );
    let run = desk.run(&format!("{to} --accept-cap --json"));
    assert_eq!(run.code, Some(0), "{run:?}");
    assert!(
        run.stderr.contains("warning") && run.stderr.contains("30 samples"),
        "{run:?}"
    );
    let report = run.json();
    assert_eq!(report["outcome"], "cap-reached");
    assert!(report["unmet_cells"].as_u64().unwrap() > 0);
    assert!(desk.samples("out.fits").len() <= 30);
    let quiet = desk.done(&format!("{to} --accept-cap --overwrite -q"));
    assert_eq!(quiet.stdout, "");
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
        ("--max-samples 24", "--start 5,5"),
        ("--uniform 3,3 --threshold 0.1", "--threshold"),
        ("--preset survey-2m", "--preset"),
    ] {
        desk.refused(&format!("{to} {option}"), 2, &[needle]);
    }
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
    assert_eq!(
        desk.samples("demo/samples.fits").len() as u64,
        report["samples"].as_u64().unwrap()
    );
    assert_eq!(desk.image("demo/image.fits").dim(), (1024, 1024));
    let pictures = [
        "sampling.png",
        "psf_field.png",
        "scene.png",
        "image.png",
        "patch_error.png",
    ];
    for name in pictures {
        assert!(
            desk.bytes(&format!("demo/{name}")).starts_with(b"\x89PNG"),
            "{name}"
        );
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
