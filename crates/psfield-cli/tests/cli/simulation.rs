//! `psfield fit` and `psfield simulate`: what they compute.

use ndarray::{Array2, Axis, s};
use psfield::psf_io::{self, Card, CardValue, HeaderCards};
use psfield::psf_types::Image;

use crate::desk::{Desk, NX, NY, STAMP, assert_keys, difference, points, scene};

/// Rounding of f32 transforms, relative to the peak.
const SINGLE: f64 = 1e-6;
/// Rounding of f64 transforms and of a model file in doubles.
const DOUBLE: f64 = 1e-12;
/// Two results that differ by more than this are not equal.
const VISIBLE: f64 = 1e-3;

const TO: &str = "simulate scene.fits --psf samples.fits --precision f64";

/// The sample in the middle of the field, at pixel (30, 25).
fn middle_sample(desk: &Desk) -> Array2<f64> {
    desk.samples("samples.fits")
        .stamps()
        .index_axis(Axis(0), 4)
        .to_owned()
}

#[test]
fn fit_reports_its_figures() {
    let desk = Desk::new();
    let report = desk.done("fit samples.fits -o model.fits --json").json();
    assert_keys(
        &report,
        &[
            "rank",
            "elbow",
            "singular_values",
            "max_error",
            "rms_error",
            "leave_one_out",
        ],
    );
    assert_eq!(report["interpolation"], "bicubic");
    assert!(report["max_error"].as_f64().unwrap() < 1e-4);
    assert_eq!(report["errors"].as_array().unwrap().len(), 9);
    let text = desk.done("fit samples.fits -o again.fits --rank 2").stdout;
    assert!(text.contains("9 samples, 2 components"), "{text}");
}

#[test]
fn samples_and_their_model_give_the_same_image() {
    let desk = Desk::new();
    desk.done("fit samples.fits -o model.fits");
    for (precision, tolerance) in [("f32", SINGLE), ("f64", DOUBLE)] {
        for psf in ["samples", "model"] {
            desk.done(&format!(
                "simulate scene.fits --psf {psf}.fits -o {psf}_{precision}.fits --precision {precision}"
            ));
        }
        let [a, b] = ["samples", "model"].map(|psf| desk.image(&format!("{psf}_{precision}.fits")));
        assert!(difference(&a, &b) <= tolerance);
    }
    let [single, double] = ["f32", "f64"].map(|p| desk.image(&format!("model_{p}.fits")));
    let between = difference(&single, &double);
    assert!(between > 0.0 && between <= SINGLE, "{between:e}");
    assert!(
        desk.bytes("model_f32.fits")
            .windows(30)
            .any(|w| w == b"BITPIX  =                  -32")
    );
    assert!(
        desk.bytes("model_f64.fits")
            .windows(30)
            .any(|w| w == b"BITPIX  =                  -64")
    );
}

#[test]
fn a_point_at_a_sample_shows_that_sample() {
    let desk = Desk::new();
    desk.write_image("scene.fits", points(&[(30, 25, 2.0)]));
    let stamp = middle_sample(&desk);
    for method in ["basis", "direct", "patch=1", "auto --tolerance 0"] {
        desk.done(&format!(
            "{TO} --rank full --method {method} -o image.fits --overwrite"
        ));
        let image = desk.image("image.fits");
        let half = STAMP / 2;
        let cut = image
            .slice(s![25 - half..=25 + half, 30 - half..=30 + half])
            .to_owned();
        assert!(difference(&cut, &(2.0 * &stamp)) <= DOUBLE, "{method}");
        assert!((image.sum() - 2.0).abs() <= DOUBLE, "{method}");
    }
}

#[test]
fn methods_agree_under_both_anchors() {
    let desk = Desk::new();
    for anchor in ["source", "output"] {
        for method in ["direct", "basis", "patch=1", "patch=40"] {
            desk.done(&format!(
                "{TO} --anchor {anchor} --method {method} -o {anchor}_{method}.fits"
            ));
        }
        let image = |method: &str| desk.image(&format!("{anchor}_{method}.fits"));
        let direct = image("direct");
        assert!(difference(&image("basis"), &direct) <= DOUBLE);
        assert!(difference(&image("patch=1"), &direct) <= DOUBLE);
        // Large patches are not exact: the comparison can fail.
        assert!(difference(&image("patch=40"), &direct) > VISIBLE);
    }
    let [source, output] = ["source", "output"].map(|a| desk.image(&format!("{a}_direct.fits")));
    assert!(difference(&source, &output) > VISIBLE);
    let light = desk.image("scene.fits").sum();
    assert!((source.sum() - light).abs() <= DOUBLE * light, "the flux is kept");
}

#[test]
fn frame_cuts_the_image_and_moves_its_origin() {
    let desk = Desk::new();
    desk.done(&format!("{TO} --tolerance 0 -o whole.fits"));
    let report = desk
        .done(&format!(
            "{TO} --tolerance 0 -o part.fits --frame 0,0,40,30 --json"
        ))
        .json();
    assert_eq!(report["shape"], serde_json::json!([40, 30]));
    let whole = desk.image("whole.fits");
    assert!(difference(&desk.image("part.fits"), &whole.slice(s![..30, ..40]).to_owned()) <= DOUBLE);
    desk.done(&format!("{TO} -o shifted.fits --frame 5,7,40,30"));
    let header = desk.header("shifted.fits");
    let real = |key: &str| match header.get(key).and_then(Card::value) {
        Some(CardValue::Real(value)) => value,
        other => panic!("{key}: {other:?}"),
    };
    assert_eq!((real("CRPIX1"), real("CRPIX2")), (15.5, 23.0));
    // The PSF's field begins at the frame's first pixel, so a point in its middle has the middle
    // sample.
    desk.write_image("point.fits", points(&[(35, 32, 1.0)]));
    desk.done("simulate point.fits --psf samples.fits --precision f64 --rank full --tolerance 0 --frame 5,7,56,44 -o point_out.fits");
    let stamp = middle_sample(&desk);
    let image = desk.image("point_out.fits");
    let cut = image.slice(s![25 - 7..=25 + 7, 30 - 7..=30 + 7]).to_owned();
    assert!(difference(&cut, &stamp) <= DOUBLE);
}

#[test]
fn light_from_beyond_the_frame_comes_in() {
    let desk = Desk::new();
    let mut wide = Array2::zeros((NY + 10, NX + 10));
    wide[[30, 4]] = 100.0;
    desk.write_image("wide.fits", wide);
    desk.refused(
        "simulate wide.fits --psf samples.fits -o out.fits",
        1,
        &["samples.fits", "71 x 61", "61 x 51", "--frame"],
    );
    desk.done(&format!(
        "simulate wide.fits --psf samples.fits -o out.fits --frame 5,5,{NX},{NY}"
    ));
    let image = desk.image("out.fits");
    assert!(image[[25, 0]] > 0.1, "{}", image[[25, 0]]);
    assert!(image.sum() < 60.0);
}

#[test]
fn headers_say_how_to_repeat_the_result() {
    let desk = Desk::new();
    let run = desk.run("simulate scene.fits --psf samples.fits -o image.fits --rank 3 --anchor output --spot-check 20 --seed 5");
    assert!(
        run.code == Some(0) && run.stderr.contains("flux in circles"),
        "{run:?}"
    );
    let header = desk.header("image.fits");
    let value = |key: &str| {
        header
            .get(key)
            .and_then(Card::value)
            .unwrap_or_else(|| panic!("no {key}"))
    };
    let text = |t: &str| CardValue::Text(t.to_owned());
    assert_eq!(value("PSFIELD"), text(env!("CARGO_PKG_VERSION")));
    assert_eq!(value("PSFANCH"), text("output"));
    assert_eq!(value("PSFMETH"), text("auto"));
    assert_eq!(value("PSFTOL"), CardValue::Real(1e-4));
    assert_eq!(value("PSFTOLON"), text("aperture"));
    assert_eq!(value("PSFSCPIX"), text("point"));
    assert_eq!(value("PSFRANK"), CardValue::Integer(3));
    assert_eq!(value("PSFPREC"), text("f32"));
    assert_eq!(value("PSFNORM"), text("unit"));
    assert_eq!(value("PSFCHKN"), CardValue::Integer(20));
    assert_eq!(value("TELESCOP"), text("Small One"));
    let history: String = header
        .iter()
        .filter(|card| card.keyword() == "HISTORY")
        .map(Card::comment_text)
        .collect();
    let command = "psfield simulate scene.fits --psf samples.fits -o image.fits --rank 3 --anchor output --spot-check 20 --seed 5";
    assert!(history.contains(command), "{history:?}");
}

#[test]
fn the_report_counts_what_was_done() {
    let desk = Desk::new();
    let report = desk
        .done("simulate scene.fits --psf samples.fits -o image.fits --rank 3 --spot-check 50 --json -q")
        .json();
    assert_keys(
        &report,
        &[
            "seconds",
            "modes",
            "peak_memory_bytes",
            "spot_check",
            "method",
            "anchor",
            "tolerance",
            "tolerance_on",
            "scene_pixels",
            "tiles",
            "plan",
        ],
    );
    assert_keys(&report["seconds"], &["read", "fit", "plan", "execute", "write"]);
    assert_eq!(report["rank"], 3);
    assert_eq!(report["tolerance_on"], "aperture");
    let l2 = desk
        .done("simulate scene.fits --psf samples.fits -o l2.fits --rank 3 --tolerance-on l2 --json")
        .json();
    assert_eq!(l2["tolerance_on"], "l2");
    assert_eq!(l2["scene_pixels"], "point");
    let integrated = desk
        .done("simulate scene.fits --psf samples.fits -o integrated.fits --rank 3 --scene-pixels integrated --spot-check 50 --json -q")
        .json();
    assert_eq!(integrated["scene_pixels"], "integrated");
    assert_eq!(integrated["spot_check"]["passed"], true);
    let card = desk
        .header("integrated.fits")
        .get("PSFSCPIX")
        .and_then(Card::value);
    assert_eq!(card, Some(CardValue::Text("integrated".to_owned())));
    let modes = report["modes"].as_f64().unwrap();
    assert!((1.0..=4.0).contains(&modes), "{modes}");
    let tiles = &report["tiles"];
    let count = |how: &str| tiles[how].as_u64().unwrap();
    assert_eq!(
        count("dark") + count("drawn") + count("direct") + count("transformed"),
        report["plan"]["tiles"].as_u64().unwrap()
    );
    assert_eq!(report["spot_check"]["pixels"], 50);
    let worst = report["spot_check"]["max_over_peak"].as_f64().unwrap();
    assert!(worst > 0.0 && worst <= 1e-4, "{worst:e}");
    assert_eq!(report["spot_check"]["passed"], true);
    let basis = desk
        .done("simulate scene.fits --psf samples.fits -o basis.fits --rank 3 --method basis --spot-check 50 --json")
        .json();
    assert_eq!(basis["modes"], 4.0);
    assert!(basis["tiles"].is_null() && basis["tolerance"].is_null() && basis["tolerance_on"].is_null());
    assert!(basis["spot_check"]["max_over_peak"].as_f64().unwrap() <= SINGLE);
    // Patches are not exact, and the check says so.
    let report = desk
        .done("simulate scene.fits --psf samples.fits -o patches.fits --method patch=40 --spot-check 200 --json")
        .json();
    assert!(report["spot_check"]["max_over_peak"].as_f64().unwrap() > VISIBLE);
    // Patches promise no accuracy.
    assert!(report["spot_check"]["passed"].is_null());
}

#[test]
fn the_tolerance_is_kept_and_made_use_of() {
    let desk = Desk::new();
    let error = |tolerance: &str, method: &str| {
        desk.done(&format!(
            "{TO} --method {method} --tolerance {tolerance} --overwrite -o image.fits"
        ));
        let report = desk.done("compare image.fits exact.fits --json").json();
        report["relative_l2"].as_f64().unwrap()
    };
    desk.done(&format!("{TO} --method direct -o exact.fits"));
    for method in ["auto", "lowrank"] {
        assert!(error("0", method) <= DOUBLE);
        let coarse = error("0.3", method);
        assert!(coarse > 1e-4 && coarse <= 0.3, "{coarse:e}");
        assert!(error("1e-3", method) <= 1e-3);
    }
}

#[test]
fn a_streamed_image_has_the_same_bytes() {
    let desk = Desk::new();
    for (n, options) in [
        "",
        "--anchor output --frame 3,4,50,40",
        "--catalog stars.csv --spot-check 30 --tolerance 0.1",
    ]
    .into_iter()
    .enumerate()
    {
        desk.write("stars.csv", "x,y,flux\n10,12,50\n30,40,7\n");
        let run = |how: &str| {
            let report = desk
                .done(&format!("{TO} --overwrite -o image.fits --json {options} {how}"))
                .json();
            let image = desk.bytes("image.fits");
            let mut check = report["spot_check"].clone();
            // Around pixels of the scene that are chosen by their light, unless they are streamed.
            if let Some(worst) = check.get_mut("worst_source") {
                assert!(worst.as_f64().unwrap() < 1.0);
                *worst = serde_json::Value::Null;
            }
            (report["streamed"].as_bool().unwrap(), check, image)
        };
        let (whole, bands) = (run(""), run("--stream"));
        assert!(!whole.0 && bands.0);
        assert_eq!(whole.1, bands.1, "case {n}");
        assert!(whole.2 == bands.2, "case {n}");
    }
    desk.refused(
        &format!("{TO} -o x.fits --stream --method basis"),
        2,
        &["--stream", "lowrank"],
    );
    desk.refused(
        "simulate --catalog stars.csv --shape 60,50 --psf samples.fits --stream -o x.fits",
        2,
        &["scene"],
    );
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let desk = Desk::new();
    for (folder, threads) in [("one", "--threads 1"), ("two", "--threads=2"), ("all", "--json")] {
        std::fs::create_dir(desk.path(folder)).unwrap();
        for name in ["samples.fits", "scene.fits"] {
            desk.write(&format!("{folder}/{name}"), desk.bytes(name));
        }
        let run = |arguments: &str| {
            let run = std::process::Command::new(env!("CARGO_BIN_EXE_psfield"))
                .env("SOURCE_DATE_EPOCH", "0")
                .args(arguments.split_whitespace())
                .current_dir(desk.path(folder))
                .output()
                .unwrap();
            assert!(run.status.success(), "{run:?}");
        };
        run(&format!("fit samples.fits {threads} -o model.fits"));
        run(&format!(
            "simulate scene.fits --psf model.fits -o image.fits {threads}"
        ));
    }
    for name in ["model.fits", "image.fits"] {
        for folder in ["two", "all"] {
            assert!(
                desk.bytes(&format!("one/{name}")) == desk.bytes(&format!("{folder}/{name}")),
                "{folder}/{name}"
            );
        }
    }
}

#[test]
fn headers_say_when_an_image_was_made_of_which_psf_and_in_which_unit() {
    let desk = Desk::new();
    let mut header = HeaderCards::new();
    header.push(Card::new("BUNIT", "electron", "").unwrap());
    header.push(Card::new("PSFFILE", "other.fits", "").unwrap());
    let scene = Image::new(scene()).unwrap();
    psf_io::write_image(desk.path("scene.fits"), &scene, &header, &[], true).unwrap();
    let text = |file: &str, keyword: &str| desk.header(file).get(keyword).and_then(Card::value);
    for (epoch, date) in [
        ("0", "1970-01-01T00:00:00"),
        ("951782400", "2000-02-29T00:00:00"),
        ("4107542399", "2100-02-28T23:59:59"),
        ("4107542400", "2100-03-01T00:00:00"),
        ("1798761600", "2027-01-01T00:00:00"),
        ("99999999999999999999", ""),
    ] {
        let line = format!(
            "SOURCE_DATE_EPOCH={epoch} $PSFIELD simulate scene.fits --psf ./samples.fits -o image.fits --overwrite -q"
        );
        let run = desk.shell(&line);
        assert_eq!(run.code, Some(0), "{run:?}");
        let found = text("image.fits", "DATE");
        // A number that is not valid is not used: the date is today's.
        let today = |text: &str| text > "2025" && text < "2999" && text.len() == 19;
        assert!(
            matches!(&found, Some(CardValue::Text(text)) if text == date || date.is_empty() && today(text)),
            "{found:?}"
        );
    }
    assert_eq!(text("image.fits", "PSFFILE"), Some("samples.fits".into()));
    assert_eq!(text("image.fits", "BUNIT"), Some("electron".into()));
}

#[test]
fn compressed_outputs_are_refused_before_the_work() {
    let desk = Desk::new();
    let to = "simulate scene.fits --psf samples.fits -o";
    for (output, needle) in [
        ("image.fits.gz", "write image.fits and run gzip"),
        ("image.fits.fz", "write image.fits and run fpack"),
        ("-", "standard output is not supported"),
    ] {
        desk.refused(&format!("{to} {output}"), 1, &[needle]);
    }
}

#[test]
fn quiet_says_nothing_and_overwrite_replaces() {
    let desk = Desk::new();
    for command in [
        "fit samples.fits -o model.fits -q",
        "simulate scene.fits --psf model.fits -o image.fits -q --spot-check 5",
        "compare image.fits scene.fits --quiet",
    ] {
        assert_eq!(desk.done(command).stdout, "", "{command}");
    }
    let before = desk.image("image.fits");
    desk.done("simulate scene.fits --psf model.fits -o image.fits --overwrite --anchor output");
    assert!(difference(&desk.image("image.fits"), &before) > VISIBLE);
}

const STARS: &str = "x,y,flux\n30.3,25.1,100\n12,40,0.5\n50.5,9,3\n";

/// The report, the text and the header state the dropped light, and the spot check allows it.
#[test]
fn light_below_the_floor_is_dropped() {
    let desk = Desk::new();
    desk.write("stars.csv", STARS);
    let simulate = |floor: &str| {
        let command = format!("simulate --catalog stars.csv --shape {NX},{NY} --psf samples.fits");
        format!("{command} --spot-check 300 -o image{floor}.fits --floor {floor} --overwrite")
    };
    // The stamps of this PSF end before the floor, which is said.
    let report = desk.run(&format!("{} --json", simulate("0.01"))).json();
    let (largest, fraction) = (&report["dropped"]["largest"], &report["dropped"]["fraction"]);
    assert!((1e-3..0.03).contains(&largest.as_f64().unwrap()), "{largest}");
    assert!((1e-7..0.05).contains(&fraction.as_f64().unwrap()), "{fraction}");
    assert_eq!(report["floor"], 0.01);
    let text = desk.run(&simulate("0.01")).stdout;
    assert!(text.contains("dropped light: at most"), "{text}");
    let header = desk.header("image0.01.fits");
    let value = |key: &str| header.get(key).and_then(Card::value);
    assert_eq!(value("PSFFLOOR"), Some(CardValue::Real(0.01)));
    assert_eq!(
        value("PSFDROPM"),
        Some(CardValue::Real(largest.as_f64().unwrap()))
    );
    assert_eq!(value("PSFCHKV"), Some(CardValue::Text("passed".to_owned())));
    // Without a floor nothing is dropped, and nothing is said.
    let report = desk.run(&format!("{} --json", simulate("0"))).json();
    assert!(report["dropped"].is_null());
    assert!(desk.header("image0.fits").get("PSFFLOOR").is_none());
    let [whole, within] = ["image0.fits", "image0.01.fits"].map(|name| desk.image(name));
    let difference = (&whole - &within).mapv(f64::abs).fold(0.0_f64, |m, &v| m.max(v));
    assert!(
        difference > 1e-5 && difference <= largest.as_f64().unwrap(),
        "{difference}"
    );
}

#[test]
fn a_floor_may_follow_the_noise_of_the_detector() {
    let desk = Desk::new();
    desk.write("stars.csv", STARS);
    desk.write(
        "camera.toml",
        "read_noise_e = 3.0\nsky_e = 16.0\nphoton_noise = true\nelectrons_per_flux = 50.0\n",
    );
    let simulate = format!("simulate --catalog stars.csv --shape {NX},{NY} --psf samples.fits --floor auto");
    let report = desk
        .run(&format!("{simulate} -o image.fits --detector camera.toml --json"))
        .json();
    assert!((report["floor"].as_f64().unwrap() - 0.01).abs() < 1e-12);
    desk.refused(
        &format!("{simulate} -o a.fits"),
        2,
        &["--floor auto", "--detector"],
    );
    desk.write("perfect.toml", "electrons_per_flux = 50.0\n");
    desk.refused(
        &format!("{simulate} -o a.fits --detector perfect.toml"),
        1,
        &["perfect.toml", "noise", "--floor"],
    );
    for floor in ["-1", "nan", "x"] {
        desk.refused(
            &format!("simulate scene.fits --psf samples.fits -o a.fits --floor {floor}"),
            2,
            &["--floor", "auto or a number of at least 0"],
        );
    }
    desk.refused(
        "simulate scene.fits --psf samples.fits -o a.fits --floor 1 --method direct",
        2,
        &["--floor applies only to"],
    );
}

#[test]
fn stars_that_are_too_bright_for_their_stamps_are_told() {
    let desk = Desk::new();
    desk.write("stars.csv", STARS);
    let simulate = format!("simulate --catalog stars.csv --shape {NX},{NY} --psf samples.fits --overwrite");
    let run = desk.run(&format!("{simulate} -o a.fits --stamp-size 9 --floor 0.05"));
    assert!(
        run.stderr.contains("too small for 1 star: at 4 pixels"),
        "{run:?}"
    );
    let run = desk.run(&format!("{simulate} -o b.fits --stamp-size 9"));
    assert!(!run.stderr.contains("too small"), "no limit is known: {run:?}");
}
