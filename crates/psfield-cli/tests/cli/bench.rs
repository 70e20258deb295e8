//! `bench`: run time against measured error.

use serde_json::Value;

use crate::desk::{Desk, NX, NY, assert_keys};

/// Small enough for a test: seconds.
const SMALL: &str =
    "bench --sizes 96 --grids 5 --patches 16,48 --ranks 2,5 --repeat 2 --pixels 60 --threads 2";
/// Rounding in single precision, in addition to the tolerance.
const ROUNDING_F32: f64 = 1e-6;
const KEYS: [&str; 20] = [
    "method",
    "setting",
    "tolerance",
    "size",
    "samples",
    "rank",
    "precision",
    "anchor",
    "seconds_plan",
    "seconds",
    "seconds_median",
    "ratio_to_single",
    "relative_l2",
    "modes",
    "tile",
    "transform",
    "threads",
    "peak_memory_bytes",
    "gpu",
    "gpu_seconds",
];

fn rows<'a>(report: &'a Value, method: &str) -> Vec<&'a Value> {
    let rows = report["rows"].as_array().expect("rows");
    rows.iter().filter(|row| row["method"] == method).collect()
}

fn errors(report: &Value, method: &str) -> Vec<f64> {
    let error = |row: &&Value| row["relative_l2"].as_f64().expect("a finite error");
    rows(report, method).iter().map(error).collect()
}

#[test]
fn every_method_has_its_row_and_its_error() {
    let desk = Desk::empty();
    let run = desk.done(&format!(
        "{SMALL} --tolerances 1e-1,1e-2,1e-4,0 --json out.json --plot out.svg"
    ));
    for method in ["single", "lowrank", "auto", "patch", "basis", "direct"] {
        assert!(
            run.stdout.contains(&format!("\n{method} ")),
            "{method} in {}",
            run.stdout
        );
    }
    let report: Value = serde_json::from_slice(&desk.bytes("out.json")).unwrap();
    assert_keys(&report, &["version", "options", "rows", "skipped"]);
    let count = |method| rows(&report, method).len();
    assert_eq!(
        ["single", "lowrank", "auto", "patch", "basis", "direct"].map(count),
        [1, 4, 4, 2, 2, 1]
    );
    for row in report["rows"].as_array().unwrap() {
        assert_keys(row, &KEYS);
        assert_eq!(row["size"], serde_json::json!([96, 96]));
        assert_eq!(
            (row["samples"].as_u64(), row["threads"].as_u64()),
            (Some(25), Some(2))
        );
        assert!(row["seconds"].as_f64().unwrap() > 0.0);
        assert!(row["seconds"].as_f64() <= row["seconds_median"].as_f64());
        assert!(row["relative_l2"].as_f64().unwrap().is_finite());
    }
    assert_eq!(rows(&report, "single")[0]["ratio_to_single"], 1.0);
    for method in ["lowrank", "auto"] {
        let found = errors(&report, method);
        for (error, tolerance) in found.iter().zip([1e-1, 1e-2, 1e-4, 0.0]) {
            assert!(
                *error <= tolerance + ROUNDING_F32,
                "{method}: {error} for {tolerance}"
            );
        }
        assert!(
            found.windows(2).all(|pair| pair[1] <= pair[0] + ROUNDING_F32),
            "{found:?}"
        );
        // The tolerance causes the error, not rounding.
        assert!(found[0] > 10.0 * found[3], "{method}: {found:?}");
    }
    // A single PSF, large patches and few components have errors, which decrease in each list.
    let (single, patch, basis) = (
        errors(&report, "single"),
        errors(&report, "patch"),
        errors(&report, "basis"),
    );
    assert!(single[0] > patch[1] && patch[1] > patch[0] && patch[0] > 10.0 * ROUNDING_F32);
    assert!(basis[0] > basis[1] && basis[1] > 10.0 * ROUNDING_F32);
    assert!(errors(&report, "direct")[0] < ROUNDING_F32);

    let plot = String::from_utf8(desk.bytes("out.svg")).unwrap();
    assert!(plot.starts_with("<svg"));
    for text in [
        "measured relative L2 error",
        "run time (s)",
        "96 x 96 pixels",
        "lowrank",
        "patch",
        "basis",
    ] {
        assert!(plot.contains(text), "{text}");
    }
}

#[test]
fn the_same_seed_finds_the_same_errors_on_any_number_of_threads() {
    let desk = Desk::empty();
    let errors_of = |arguments: &str| {
        let report = desk
            .done(&format!(
                "{SMALL} --methods lowrank,patch --tolerances 1e-2 --json {arguments}"
            ))
            .json();
        [errors(&report, "lowrank"), errors(&report, "patch")]
    };
    let found = errors_of("--seed 3");
    let one = desk
        .done("bench --sizes 96 --grids 5 --patches 16,48 --repeat 1 --pixels 60 --threads 1 --methods lowrank,patch --tolerances 1e-2 --seed 3 --json")
        .json();
    assert_eq!(found, [errors(&one, "lowrank"), errors(&one, "patch")]);
    assert_ne!(found, errors_of("--seed 4"));
}

#[test]
fn a_scene_and_a_psf_of_the_callers() {
    let desk = Desk::new();
    let run = desk.done(
        "bench --scene scene.fits --psf samples.fits --methods lowrank --tolerances 1e-3 --json out.json --threads 1",
    );
    assert!(
        run.stdout.contains("61 x 51 pixels, 9 PSF samples"),
        "{}",
        run.stdout
    );
    let report: Value = serde_json::from_slice(&desk.bytes("out.json")).unwrap();
    let lowrank = rows(&report, "lowrank");
    assert_eq!(lowrank.len(), 1);
    assert_eq!(lowrank[0]["size"], serde_json::json!([NX, NY]));
    assert_eq!(
        (&lowrank[0]["tolerance"], &lowrank[0]["rank"]),
        (&0.001.into(), &8.into())
    );
    assert!(errors(&report, "lowrank")[0] < 1e-3);
    // The single PSF is always measured.
    assert_eq!(rows(&report, "single").len(), 1);

    // A model file works too, truncated to fewer components.
    desk.done("fit samples.fits -o model.fits --rank full");
    let cut = desk
        .done("bench --psf model.fits --rank 2 --scene scene.fits --methods basis --repeat 1 --json")
        .json();
    assert_eq!(rows(&cut, "basis")[0]["rank"], 2);
    assert_eq!(rows(&cut, "basis").len(), 1, "ranks beyond the model's are one");

    // Positions belong to their field unless they are stretched.
    desk.refused(
        "bench --psf samples.fits --sizes 96 --methods lowrank",
        1,
        &["samples.fits", "61 x 51", "--stretch"],
    );
    let wide = desk
        .done("bench --psf samples.fits --stretch --sizes 96 --methods lowrank --tolerances 0 --repeat 1 --anchor output --precision f64 --json")
        .json();
    assert!(errors(&wide, "lowrank")[0] < 1e-12);
    assert_eq!(rows(&wide, "lowrank")[0]["anchor"], "output");
}

#[test]
fn what_takes_too_long_says_so() {
    let desk = Desk::empty();
    let run = desk.run("bench --sizes 512 --grids 3 --methods direct --repeat 1 --pixels 4 --json");
    assert_eq!(run.code, Some(0), "{run:?}");
    let report = run.json();
    assert!(rows(&report, "direct").is_empty());
    let reason = report["skipped"][0]["reason"].as_str().unwrap();
    assert!(reason.contains("262144 pixels with light"), "{reason}");
}

/// The keys of a row of `bench --real`.
const WORK_KEYS: [&str; 14] = [
    "group",
    "psf",
    "size",
    "amount",
    "unit",
    "seconds_plan",
    "seconds_first",
    "seconds",
    "seconds_median",
    "seconds_single",
    "seconds_simpler",
    "seconds_photons",
    "relative_l2",
    "peak_memory_bytes",
];

#[test]
fn real_work_has_rows_for_every_group_within_the_tolerance() {
    let desk = Desk::empty();
    let run = desk.done("bench --real --quick --sizes 96 --json out.json --threads 2");
    let report: Value = serde_json::from_slice(&desk.bytes("out.json")).unwrap();
    assert_keys(&report, &["version", "options", "rows"]);
    let options = &report["options"];
    assert_eq!(
        (&options["tolerance"], &options["tolerance_on"]),
        (&0.001.into(), &"l2".into())
    );
    let tolerance = options["tolerance"].as_f64().unwrap();
    let of_group = |group: &str| {
        let rows = report["rows"].as_array().unwrap().iter();
        rows.filter(|row| row["group"] == group).collect::<Vec<_>>()
    };
    for (group, count) in [
        ("pixels", 5),
        ("light", 3),
        ("stars", 1),
        ("galaxies", 1),
        ("floor", 2),
        ("wings", 2),
        ("starphotons", 2),
        ("galaxyphotons", 2),
        ("frames", 1),
        ("fields", 5),
        ("colours", 1),
        ("series", 1),
        ("starseries", 1),
    ] {
        assert!(
            run.stdout.contains(&format!("\n{group} ")),
            "{group} in {}",
            run.stdout
        );
        let rows = of_group(group);
        assert_eq!(rows.len(), count, "{group}");
        for row in rows {
            assert_keys(row, &WORK_KEYS);
            assert_eq!(row["size"], serde_json::json!([96, 96]));
            let seconds = |key: &str| row[key].as_f64().unwrap();
            assert!(seconds("seconds") > 0.0 && seconds("seconds") <= seconds("seconds_median"));
            assert!(seconds("seconds_plan") > 0.0 && seconds("seconds_first") > 0.0);
            let of_photons = group.ends_with("photons");
            let without_single = ["stars", "galaxies", "floor", "series", "starseries"].contains(&group);
            assert_eq!(
                row["seconds_single"].is_null(),
                without_single || of_photons,
                "{row}"
            );
            let has_simpler = ["colours", "series", "starseries"].contains(&group);
            assert_eq!(
                row["seconds_simpler"].is_number(),
                has_simpler || of_photons,
                "{row}"
            );
            assert_eq!(row["seconds_photons"].is_number(), of_photons, "{row}");
            match row["relative_l2"].as_f64() {
                // The floor drops some light.
                Some(error) => assert!(group == "floor" || error <= tolerance, "{row}"),
                None => assert!(of_photons || row["amount"] == 0.0, "{row}"),
            }
        }
    }
    // The error of the approximation is measured, not only rounding.
    let error = |row: &&Value| row["relative_l2"].as_f64();
    let errors: Vec<f64> = of_group("pixels").iter().filter_map(error).collect();
    assert!(errors.iter().any(|&e| e > 10.0 * ROUNDING_F32), "{errors:?}");

    let one = desk
        .done("bench --real=light --quick --sizes 64 --tolerance-on aperture --json")
        .json();
    assert_eq!(one["options"]["tolerance_on"], "aperture");
    let mut rows = one["rows"].as_array().unwrap().iter();
    assert!(rows.all(|row| row["group"] == "light"));
}

#[test]
fn real_work_refuses_options_that_do_not_apply() {
    let desk = Desk::new();
    for option in [
        "--grids 3",
        "--psf samples.fits",
        "--scene scene.fits",
        "--preset survey-2m",
        "--rank 2",
        "--methods auto",
        "--tolerances 1e-2",
        "--patches 32",
        "--ranks 2",
        "--anchor output",
        "--precision f64",
        "--plot out.svg",
        "--device cpu",
    ] {
        let name = option.split(' ').next().unwrap();
        desk.refused(&format!("bench --real --quick {option}"), 2, &["--real", name]);
    }
    desk.refused("bench --real=moon --quick", 2, &["--real", "galaxies", "moon"]);
}

#[test]
fn options_that_make_no_sense() {
    let desk = Desk::new();
    for (option, needles) in [
        ("--sizes 0", ["--sizes", "from 1"]),
        ("--sizes 512,x", ["--sizes", "whole number"]),
        ("--sizes 1000000", ["--sizes", "32768"]),
        ("--grids 1", ["--grids", "from 2"]),
        ("--methods fastest", ["--methods", "lowrank"]),
        ("--tolerances 1", ["--tolerances", "below 1"]),
        ("--tolerances -0.1", ["--tolerances", "from 0 to below 1"]),
        ("--tolerances nan", ["--tolerances", "from 0 to below 1"]),
        ("--patches 0", ["--patches", "whole number"]),
        ("--ranks 0", ["--ranks", "0"]),
        ("--rank 0", ["--rank", "0"]),
        ("--repeat 0", ["--repeat", "0"]),
        ("--pixels 0", ["--pixels", "0"]),
        ("--preset hubble", ["--preset", "survey-2m"]),
        ("--precision f16", ["--precision", "f32"]),
        ("--anchor middle", ["--anchor", "source"]),
        ("--stretch", ["--stretch", "--psf"]),
        ("--plot out.png", ["--plot", ".svg"]),
        ("--psf samples.fits --grids 3", ["--psf", "--grids"]),
        ("--scene scene.fits --sizes 64", ["--scene", "--sizes"]),
    ] {
        desk.refused(&format!("bench --quick {option}"), 2, &needles);
    }
    desk.refused(
        "bench --quick --json samples.fits",
        1,
        &["samples.fits", "--overwrite"],
    );
    desk.refused("bench --quick --plot nowhere/out.svg", 1, &["nowhere"]);
    desk.refused("bench --quick --psf missing.fits", 1, &["missing.fits"]);
    desk.refused("bench --quick --scene missing.fits", 1, &["missing.fits"]);
    desk.write_image("dark.fits", ndarray::Array2::zeros((20, 20)));
    desk.refused("bench --quick --scene dark.fits", 1, &["dark.fits", "dark"]);
}

#[test]
fn other_commands_take_no_file_for_json() {
    let desk = Desk::new();
    let fitted = desk.done("fit samples.fits -o model.fits --json").json();
    assert_keys(&fitted, &["rank"]);
    desk.refused(
        "fit samples.fits -o other.fits --json out.json",
        1,
        &["out.json", "cannot read"],
    );
    desk.refused(
        "convert samples.fits -o other.fits --json out.json",
        2,
        &["out.json"],
    );
    let quiet = desk.done("-q bench --sizes 32 --grids 2 --methods single --repeat 1");
    assert_eq!(quiet.stdout, "");
    let global = desk
        .done("--json bench --sizes 32 --grids 2 --methods single --repeat 1")
        .json();
    assert_eq!(rows(&global, "single").len(), 1);
}
