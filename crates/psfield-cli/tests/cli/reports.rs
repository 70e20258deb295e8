//! `reproduce` and `validate`.

use std::fmt::Write;

use ndarray::Array3;
use psfield::psf_types::{FrameShape, Position, PsfSamples, SamplePositions, StampGrid};
use serde_json::Value;

use crate::desk::Desk;

/// The smallest possible frame, samples and objects. Every stage runs.
const TINY: &str = "reproduce --report out --quick --frame 420,420 --samples 8 --objects 3 --image-side 96 --galaxy-side 96 \
                    --adaptive-threshold 0.2 --json";

const FIGURES: [&str; 11] = [
    "singular-values",
    "sampling",
    "fwhm",
    "eccentricity-differences",
    "eccentricity-distribution",
    "mae-distribution",
    "mse-map",
    "e1-map",
    "e2-map",
    "galaxy",
    "colour",
];

fn number(value: &Value, pointer: &str) -> f64 {
    value
        .pointer(pointer)
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("no number at {pointer}"))
}

/// A number as tables show it.
fn cell(value: f64) -> String {
    if (0.01..1e4).contains(&value) {
        format!("<td>{value:.3}</td>")
    } else {
        format!("<td>{value:.1e}</td>")
    }
}

/// Checks that page and JSON have equal numbers.
fn check_numbers(desk: &Desk, folder: &str, summaries: &[&str]) {
    let page = String::from_utf8(desk.bytes(&format!("{folder}/report.html"))).unwrap();
    let report: Value = serde_json::from_slice(&desk.bytes(&format!("{folder}/report.json"))).unwrap();
    for target in report["targets"].as_array().unwrap() {
        let row = format!(
            "<td>{}</td>{}{}<td>{}</td>",
            target["what"].as_str().unwrap(),
            cell(number(target, "/limit")),
            cell(number(target, "/measured")),
            if target["met"] == true { "yes" } else { "no" }
        );
        assert!(page.contains(&row), "{row}");
    }
    for summary in summaries {
        let mut row = String::new();
        for value in [
            "eccentricity/q90",
            "eccentricity/largest",
            "e1/q90",
            "e2/q90",
            "fwhm_px/q90",
        ] {
            row.push_str(&cell(number(&report, &format!("{summary}/{value}"))));
        }
        assert!(page.contains(&row), "{summary}: {row}");
    }
}

/// Checks that the page is self-contained.
fn check_page(desk: &Desk, name: &str) {
    let page = String::from_utf8(desk.bytes(name)).unwrap();
    assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"));
    assert!(page.contains("prefers-color-scheme") && page.contains("@media print"));
    for outside in ["http", "url(", "<script", "<link"] {
        assert!(!page.contains(outside), "{name}: {outside}");
    }
    assert!(page.contains("<svg role=\"img\"") && !page.contains("<img"));
}

/// Checks stars of several temperatures: positions, directions of the change, and errors.
fn check_colours(report: &Value) {
    let stars = report["colours"]["stars"].as_array().unwrap();
    // At 13 temperatures, at 3 positions.
    assert_eq!(stars.len(), 39);
    assert_eq!(
        (&stars[0]["place"], &stars[38]["place"]),
        (&"centre".into(), &"corner".into())
    );
    let fwhm = |star: usize, key: &str| number(&stars[star], key);
    // Blue stars are sharper at the centre, and wider in the corner.
    assert!(fwhm(12, "/fwhm_px") < 0.95 * fwhm(0, "/fwhm_px"));
    assert!(fwhm(38, "/fwhm_px") > 1.1 * fwhm(26, "/fwhm_px"));
    for star in 0..stars.len() {
        let error = fwhm(star, "/fwhm_px") / fwhm(star, "/fwhm_px_true") - 1.0;
        assert!(error != 0.0 && error.abs() < FWHM_ERROR, "{star}: {error}");
    }
}

/// The largest relative error of the FWHM of a star, a target of the report.
const FWHM_ERROR: f64 = 1e-3;

/// Checks the frames with one basis.
fn check_frames(report: &Value) {
    let frames = report["frames"]["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 4);
    for (row, number_of_frame) in frames.iter().zip(0..) {
        assert_eq!(
            (&row["frame"], &row["samples"]),
            (&number_of_frame.into(), &150.into())
        );
        let ratio = number(row, "/sample_signal_to_noise");
        assert!((20.0 * ratio.log10() - number(row, "/sample_snr_db")).abs() < 1e-9);
        let errors = ["/psfs/relative_l2", "/psfs/fwhm_px", "/ellipticity"];
        assert!(
            errors
                .iter()
                .all(|key| number(row, &format!("{key}/median")) > 0.0)
        );
        assert!(number(row, "/seconds") > 0.0);
    }
}

#[test]
fn a_tiny_reproduction_has_every_figure_and_number() {
    let desk = Desk::empty();
    let run = desk.run(TINY);
    assert_eq!(run.code, Some(0), "{run:?}");
    let printed = run.json();
    let written: Value = serde_json::from_slice(&desk.bytes("out/report.json")).unwrap();
    for report in [&printed, &written] {
        assert_eq!(number(report, "/samples"), 64.0);
        assert_eq!(number(report, "/objects"), 9.0);
        assert_eq!(number(report, "/stars/summary/objects"), 9.0);
        // Four for stars, four for galaxies, two for colours, one for frames.
        assert_eq!(report["targets"].as_array().unwrap().len(), 11);
        check_colours(report);
        check_frames(report);
        // Two kinds at four tolerances.
        assert_eq!(report["tolerances"].as_array().unwrap().len(), 8);
        assert_eq!(report["interpolations"].as_array().unwrap().len(), 4);
        // A single PSF, psfield at two tolerances, four sizes of patches.
        assert_eq!(report["table_1"][0]["rows"].as_array().unwrap().len(), 7);
        assert_eq!(report["basis"]["singular_values"].as_array().unwrap().len(), 64);
        assert_eq!(number(report, "/basis/cumulative_weights/63"), 1.0);
    }
    assert!(
        written["software"]["command"]
            .as_str()
            .unwrap()
            .contains("--samples 8")
    );
    assert!(
        written["inputs"]["telescope"]
            .as_str()
            .unwrap()
            .contains("survey-2m")
    );

    // The page names the paper and the conditions under which times were measured.
    let page = String::from_utf8(desk.bytes("out/report.html")).unwrap();
    for text in [
        "An Ultrafast Image Simulation Technique",
        "doi:10.3847/1538-3881/ad9b2e",
        "load at the start",
    ] {
        assert!(page.contains(text), "{text}");
    }
    let started = written["started"].as_str().unwrap();
    assert!(started.len() == 19 && started.contains('T'), "{started}");
    if let Ok(processors) = std::fs::read_to_string("/proc/cpuinfo") {
        assert!(number(&written, "/load") >= 0.0);
        let named = processors
            .lines()
            .find_map(|line| line.strip_prefix("model name"));
        if let Some(name) = named {
            let machine = written["software"]["machine"].as_str().unwrap();
            assert!(
                machine.contains(name.trim_start_matches(['\t', ' ', ':'])),
                "{machine}"
            );
        }
    }
    // Table 1 counts the plan of psfield, as each run of patches makes their PSFs.
    let seconds = |row: usize, name: &str| number(&written, &format!("/table_1/0/rows/{row}/{name}"));
    let first = |row: usize| seconds(row, "seconds_plan") + seconds(row, "seconds");
    for row in [1, 2] {
        let (ratio, later) = (first(row) / first(0), seconds(row, "ratio_to_single"));
        let cells = format!("<td>{ratio:.2}</td><td>{later:.2}</td>");
        assert!(page.contains(&cells), "{cells}");
    }

    // Seams of patches are far larger than the engine's error.
    let patches = number(&written, "/large_galaxy/patch_relative_l2");
    let ours = number(&written, "/large_galaxy/lowrank_relative_l2");
    assert!(patches > 1e-3 && ours < 1e-4, "{patches} {ours}");
    // The samples are far apart, so that interpolation dominates the error at fine tolerances, and
    // the engine at the coarsest one.
    let star_errors: Vec<f64> = (0..8)
        .step_by(2)
        .map(|row| number(&written, &format!("/tolerances/{row}/summary/relative_l2/mean")))
        .collect();
    assert!(
        star_errors.windows(2).all(|w| w[1] <= w[0] * 1.05),
        "{star_errors:?}"
    );

    for figure in FIGURES {
        let svg = String::from_utf8(desk.bytes(&format!("out/{figure}.svg"))).unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("<text"), "{figure}");
        // The page shows the same drawing.
        let drawn = svg.split_once("<rect").unwrap().1;
        assert!(page.contains(drawn), "{figure}");
    }
    check_page(&desk, "out/report.html");
    let summaries: Vec<String> = (0..8).map(|k| format!("/tolerances/{k}/summary")).collect();
    check_numbers(
        &desk,
        "out",
        &summaries.iter().map(String::as_str).collect::<Vec<_>>(),
    );
    let table = String::from_utf8(desk.bytes("out/stars.csv")).unwrap();
    assert_eq!(table.lines().count(), 10);

    let again = desk.run(TINY);
    assert_eq!(again.code, Some(1));
    assert!(again.stderr.contains("--overwrite"), "{again:?}");
}

#[test]
fn a_model_is_validated_by_the_samples_that_it_came_from_and_by_others() {
    let desk = Desk::new();
    let fitted = desk.run("fit samples.fits -o model.fits --rank full");
    assert_eq!(fitted.code, Some(0), "{fitted:?}");
    let run = desk.run("validate model.fits --reference samples.fits --report same --json");
    assert_eq!(run.code, Some(0), "{run:?}");
    let same = run.json();
    assert_eq!(same["truth"], "samples");
    assert_eq!(number(&same, "/objects/summary/objects"), 9.0);
    // Files hold samples in single precision. The model returns them at their own positions.
    assert!(number(&same, "/objects/summary/mae_over_mean/largest") < 1e-5);
    assert!(number(&same, "/objects/summary/eccentricity/largest") < 1e-3);
    check_page(&desk, "same/report.html");
    check_numbers(&desk, "same", &["/objects/summary"]);

    // This truth does not show the error between the samples.
    let warning = "9 of 9 objects in samples.fits lie within half a pixel of a sample";
    assert!(
        run.stderr.contains(warning) && run.stderr.contains("--hold-out"),
        "{run:?}"
    );
    assert_eq!(number(&same, "/at_samples"), 9.0);

    // A model of a single component cannot hold nine different PSFs.
    desk.run("fit samples.fits -o coarse.fits --rank 1");
    let run = desk.run("validate coarse.fits --reference samples.fits --report coarse --json");
    assert!(number(&run.json(), "/objects/summary/mae_over_mean/largest") > 1e-3);

    let of_model = desk.run("validate model.fits --reference model.fits --report model");
    assert_eq!(of_model.code, Some(1));
    assert!(of_model.stderr.contains("psfield evaluate"), "{of_model:?}");
}

/// A folder in the place of a figure is in the way of drawing, not of the measurements.
#[test]
fn numbers_and_tables_are_written_before_figures() {
    let desk = Desk::new();
    desk.done("fit samples.fits -o model.fits");
    let validate = "validate model.fits --reference samples.fits --report out --overwrite";
    let reproduce = TINY.replace("--report out", "--report out --overwrite");
    for (command, tables) in [
        (validate, &["objects.csv"][..]),
        (&reproduce, &["stars.csv", "galaxies.csv"]),
    ] {
        std::fs::create_dir_all(desk.path("out/fwhm.svg")).unwrap();
        let run = desk.run(command);
        assert!(run.code == Some(1) && run.stderr.contains("fwhm.svg"), "{run:?}");
        let report: Value = serde_json::from_slice(&desk.bytes("out/report.json")).unwrap();
        assert!(report["software"]["psfield"].is_string());
        for table in tables {
            assert!(
                desk.bytes(&format!("out/{table}"))
                    .starts_with(b"x,y,eccentricity")
            );
        }
        assert!(!desk.path("out/report.html").exists());
        std::fs::remove_dir_all(desk.path("out")).unwrap();
    }
}

/// The widths of PSFs that are three times as fine as the frame are in pixels of the frame.
#[test]
fn lengths_of_a_validation_are_in_frame_pixels() {
    let desk = Desk::empty();
    desk.write_samples("fine.fits", &widening_psf(1.0));
    desk.done("fit fine.fits -o model.fits --rank full");
    let text = desk
        .run("validate model.fits --reference fine.fits --report out")
        .stdout;
    assert!(text.contains("FWHM (pixels of the frame)"), "{text}");
    let columns = ["fwhm_rows_px", "fwhm_columns_px_true", "fwhm_px"];
    let [rows, columns, both] = psfield::psf_io::read_columns(desk.path("out/objects.csv"), columns).unwrap();
    let fwhm = |sigma: f64| 2.354_820_045 * sigma;
    // Sigmas of the first PSF, 1.2 and 1.25 pixels.
    for (got, expected) in [
        (rows[0], fwhm(1.2)),
        (columns[0], fwhm(1.25)),
        (both[0], fwhm(1.5f64.sqrt())),
    ] {
        assert!((got / expected - 1.0).abs() < 1e-3, "{got} {expected}");
    }
    let page = String::from_utf8(desk.bytes("out/report.html")).unwrap();
    assert!(page.contains("called ellipticity in the paper") && !page.contains("stamp pixels"));
}

#[test]
fn a_report_folder_is_there_when_the_report_is() {
    let desk = Desk::new();
    desk.done("fit samples.fits -o model.fits");
    for (what, needles) in [
        ("model.fits --reference missing.fits", &["missing.fits"][..]),
        ("missing.fits --reference samples.fits", &["missing.fits"]),
        ("model.fits --reference model.fits", &["psfield evaluate"]),
    ] {
        desk.refused(&format!("validate {what} --report deep/in/here"), 1, needles);
        assert!(!desk.path("deep").exists(), "{what}");
    }
    desk.refused("validate missing.fits --report trip", 1, &["missing.fits"]);
    assert!(!desk.path("trip").exists());

    // Files in the way are reported before the inputs are read.
    desk.refused(
        "validate missing.fits --reference missing.fits --report samples.fits/report",
        1,
        &["samples.fits", "cannot be made"],
    );
    std::fs::create_dir(desk.path("used")).unwrap();
    desk.write("used/notes.txt", "keep me");
    desk.refused(
        "validate missing.fits --reference missing.fits --report used",
        1,
        &["used", "not empty", "--overwrite"],
    );
    desk.done("validate model.fits --reference samples.fits --report used --overwrite -q");
    assert_eq!(desk.bytes("used/notes.txt"), b"keep me");
}

/// Pixels along each side of the frame with stars.
const SIDE: usize = 192;
/// Stars along each side of the frame.
const STARS: usize = 5;
/// At a signal-to-noise ratio of 150, the FWHM of 3 pixels is measured to 0.02 pixels. The errors
/// of 90 % of 25 stars are below this limit: measured 0.017, and 0.26 for stars that are 8 % wider.
const NOISE_OF_FWHM_PX: f64 = 0.06;
/// Noise over the mean of the window: measured 0.047. A width larger by 8 % gives 0.13.
const NOISE_OF_MAE: f64 = 0.08;

/// Gaussians three times as fine as the frame, wider to the right and upwards, with all widths
/// multiplied by `scale`.
fn widening_psf(scale: f64) -> PsfSamples {
    const FINE: usize = 3;
    const STAMP: usize = 25 * FINE;
    let at = |k: usize| (SIDE - 1) as f64 * k as f64 / 2.0;
    let positions: Vec<Position> = (0..9)
        .map(|k| Position::new(at(k % 3), at(k / 3)).unwrap())
        .collect();
    let stamps = Array3::from_shape_fn((9, STAMP, STAMP), |(k, y, x)| {
        let offset = |n: usize| (n as f64 - (STAMP / 2) as f64) / FINE as f64;
        let (u, v) = ((k % 3) as f64 / 2.0, (k / 3) as f64 / 2.0);
        let (sigma_x, sigma_y) = (scale * (1.2 + 0.15 * u), scale * (1.25 + 0.1 * v));
        (-0.5 * ((offset(x) / sigma_x).powi(2) + (offset(y) / sigma_y).powi(2))).exp()
    });
    let grid = StampGrid::new(STAMP, STAMP)
        .unwrap()
        .with_oversampling(FINE as f64)
        .unwrap();
    let field = FrameShape::new(SIDE, SIDE).unwrap();
    let positions = SamplePositions::new(positions, Some(field)).unwrap();
    PsfSamples::new(stamps, positions, grid).unwrap().into_unit_flux()
}

#[test]
fn a_model_is_validated_by_the_stars_of_a_frame() {
    let desk = Desk::empty();
    let mut stars = "x,y,flux\n".to_owned();
    for k in 0..STARS * STARS {
        let along = |n: usize, part: usize| 24.0 + 36.0 * n as f64 + (k * part % 13) as f64 / 13.0;
        let (x, y) = (along(k % STARS, 5), along(k / STARS, 7));
        writeln!(stars, "{x},{y},{}", 3e4 + 4e3 * (k % 6) as f64).unwrap();
    }
    desk.write("stars.csv", stars);
    for (scale, name) in [(1.0, "true"), (1.08, "wide")] {
        desk.write_samples(&format!("{name}.fits"), &widening_psf(scale));
        desk.done(&format!("fit {name}.fits -o {name}_model.fits --rank full"));
    }
    desk.done(&format!(
        "simulate --psf true_model.fits --shape {SIDE},{SIDE} --catalog stars.csv -o sky.fits --precision f64"
    ));
    desk.done("expose sky.fits --photon-noise --sky 60 --read-noise 3 --seed 4 -o frame.fits");

    let measured = |model: &str| {
        let report = desk
            .done(&format!(
                "validate {model}_model.fits --reference frame.fits --report {model} --json"
            ))
            .json();
        assert_eq!(report["truth"], "frame");
        assert_eq!(
            number(&report, "/objects/summary/objects"),
            (STARS * STARS) as f64
        );
        assert_eq!(number(&report, "/objects/summary/failed"), 0.0);
        // Targets are for PSFs without noise.
        assert!(report["targets"].as_array().unwrap().is_empty());
        check_page(&desk, &format!("{model}/report.html"));
        check_numbers(&desk, model, &["/objects/summary"]);
        [
            number(&report, "/objects/summary/fwhm_px/q90"),
            number(&report, "/objects/summary/mae_over_mean/median"),
        ]
    };
    let [fwhm, mae] = measured("true");
    assert!(fwhm < NOISE_OF_FWHM_PX && mae < NOISE_OF_MAE, "{fwhm} {mae}");
    // 8 % of 3 pixels.
    let [fwhm, mae] = measured("wide");
    assert!(
        fwhm > 2.0 * NOISE_OF_FWHM_PX && mae > NOISE_OF_MAE,
        "{fwhm} {mae}"
    );
}
