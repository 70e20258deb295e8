//! `psfield expose`.

use ndarray::s;
use psfield::psf_io::{Card, CardValue};

use crate::desk::{Desk, NX, NY, assert_keys, points};

/// Detector settings of each kind.
const CCD: &str = r#"
    name = "CCD"
    electrons_per_flux = 20.0
    exposure_s = 100.0
    photon_noise = true
    sky_e = 30.0
    sky_gradient_e_per_px = { x = 0.1, y = -0.05 }
    dark_e_per_s = 0.1
    response_rms = 0.01
    full_well_e = 900.0
    read_noise_e = 4.0
    gain_e_per_adu = 1.5
    bias_adu = 200.0
    bits = 16
    pattern_seed = 18446744073709551615
    [bad_pixels]
    dead_fraction = 0.01
    hot_fraction = 0.01
    hot_dark_e_per_s = 3.0
    bad_column_fraction = 0.02
"#;

fn with_detector() -> Desk {
    let desk = Desk::new();
    desk.write("ccd.toml", CCD);
    desk
}

fn text(desk: &Desk, file: &str, keyword: &str) -> String {
    match desk.header(file).get(keyword).and_then(Card::value) {
        Some(CardValue::Text(text)) => text,
        other => panic!("{keyword} of {file}: {other:?}"),
    }
}

fn number(desk: &Desk, file: &str, keyword: &str) -> f64 {
    match desk.header(file).get(keyword).and_then(Card::value) {
        Some(CardValue::Real(value)) => value,
        Some(CardValue::Integer(value)) => value as f64,
        other => panic!("{keyword} of {file}: {other:?}"),
    }
}

#[test]
fn a_whole_detector_from_a_file() {
    let desk = with_detector();
    let input = desk.bytes("scene.fits");
    let report = desk
        .done("expose scene.fits --detector ccd.toml --seed 5 -o raw.fits --truth truth.fits --quality quality.fits --json")
        .json();
    assert_keys(
        &report,
        &[
            "output",
            "truth",
            "quality",
            "shape",
            "precision",
            "unit",
            "saturation",
            "detector",
            "seed",
            "pixels",
            "saturated_pixels",
            "below_zero_pixels",
            "negative_pixels",
            "lowest_expected_e",
            "bad_pixels",
            "dead_pixels",
            "hot_pixels",
            "bad_column_pixels",
            "mean_sky_e",
            "dark_e",
            "seconds",
        ],
    );
    assert_eq!(report["unit"], "adu");
    assert_eq!(report["detector"]["read_noise_e"], 4.0);
    assert_eq!(report["pixels"].as_u64(), Some((NX * NY) as u64));
    assert_eq!(desk.bytes("scene.fits"), input, "the input is never touched");

    let raw = desk.image("raw.fits");
    assert!(raw.iter().all(|v| v.fract() == 0.0 && (0.0..65536.0).contains(v)));
    assert!(desk.bytes("raw.fits")[80..].starts_with(b"BITPIX  =                   16"));
    // Cards of the input, cards for readers of raw frames, and the settings.
    assert_eq!(text(&desk, "raw.fits", "TELESCOP"), "Small One");
    for (keyword, value) in [
        ("GAIN", 1.5),
        ("RDNOISE", 4.0),
        ("EXPTIME", 100.0),
        ("SATURATE", 800.0),
        ("CRPIX1", 20.5),
        ("DETNSAT", report["saturated_pixels"].as_f64().unwrap()),
        ("DETNBAD", report["bad_pixels"].as_f64().unwrap()),
    ] {
        assert_eq!(number(&desk, "raw.fits", keyword), value, "{keyword}");
    }
    assert_eq!(
        (
            text(&desk, "raw.fits", "BUNIT"),
            text(&desk, "truth.fits", "BUNIT")
        ),
        ("adu".into(), "adu".into())
    );
    assert!(desk.header("truth.fits").get("DETTRUTH").is_some());

    let (scene, truth) = (desk.image("scene.fits"), desk.image("truth.fits"));
    for ((y, x), flux) in scene.indexed_iter() {
        let sky = 30.0 + 0.1 * (x as f64 - 30.0) - 0.05 * (y as f64 - 25.0);
        let expected = (20.0 * flux + sky + 10.0) / 1.5 + 200.0;
        // The truth is written in single precision.
        assert!((truth[[y, x]] / expected - 1.0).abs() < 1e-6);
    }
    let quality = desk.image("quality.fits");
    let count = |bit: u8| quality.iter().filter(|&&v| v as u8 & bit != 0).count() as u64;
    for (bit, key) in [
        (1, "dead_pixels"),
        (2, "hot_pixels"),
        (4, "bad_column_pixels"),
        (8, "saturated_pixels"),
    ] {
        assert_eq!(Some(count(bit)), report[key].as_u64(), "{key}");
        assert!(count(bit) > 0, "{key}");
    }
    // Good pixels differ from the truth by their noise.
    let (mut chi, mut good) = (0.0, 0.0);
    for ((at, count), quality) in raw.indexed_iter().zip(&quality) {
        if *quality == 0.0 {
            let electrons = (truth[at] - 200.0) * 1.5;
            let variance = (electrons + 16.0 + (0.01 * electrons).powi(2)) / 2.25 + 1.0 / 12.0;
            chi += (count - truth[at]).powi(2) / variance;
            good += 1.0;
        }
    }
    // Chi-square over its degrees of freedom, whose deviation is sqrt(2 / n).
    let off = (chi / good - 1.0) / f64::sqrt(2.0 / good);
    assert!(off.abs() < 4.0, "{off} standard deviations");
}

#[test]
fn the_same_seed_gives_the_same_bytes_for_any_number_of_threads() {
    let desk = with_detector();
    let exposed = |options: &str| {
        desk.done(&format!(
            "expose scene.fits --detector ccd.toml -o raw.fits --overwrite --quality quality.fits {options}"
        ));
        (desk.bytes("raw.fits"), desk.bytes("quality.fits"))
    };
    let one = exposed("--seed 7 --threads 1");
    assert_eq!(exposed("--seed 7 --threads 2"), one);
    assert_eq!(exposed("--seed 7 --threads 7"), one);
    exposed("--seed 7");
    let first = desk.image("raw.fits");
    exposed("--seed 8");
    assert_ne!(desk.image("raw.fits"), first);
}

#[test]
fn the_header_is_enough_to_repeat_an_exposure() {
    let desk = with_detector();
    desk.done("expose scene.fits --detector ccd.toml --seed 12345678901234567890 -o raw.fits");
    let header = desk.header("raw.fits");
    let mut settings = String::new();
    let mut bad = String::from("[bad_pixels]\n");
    for (keyword, key, table) in [
        ("DETEPF", "electrons_per_flux", false),
        ("EXPTIME", "exposure_s", false),
        ("DETSKY", "sky_e", false),
        ("DETSKYX", "sky_gradient_e_per_px.x", false),
        ("DETSKYY", "sky_gradient_e_per_px.y", false),
        ("DETDARK", "dark_e_per_s", false),
        ("DETRESP", "response_rms", false),
        ("DETFULL", "full_well_e", false),
        ("RDNOISE", "read_noise_e", false),
        ("GAIN", "gain_e_per_adu", false),
        ("DETBIAS", "bias_adu", false),
        ("DETBITS", "bits", false),
        ("DETDEAD", "dead_fraction", true),
        ("DETHOT", "hot_fraction", true),
        ("DETHOTD", "hot_dark_e_per_s", true),
        ("DETBCOL", "bad_column_fraction", true),
    ] {
        let value = header.get(keyword).and_then(Card::value).unwrap();
        let line = format!("{key} = {value}\n");
        if table { &mut bad } else { &mut settings }.push_str(&line);
    }
    assert_eq!(header.get("DETPHOT").and_then(Card::value), Some(true.into()));
    let seed = text(&desk, "raw.fits", "DETSEED");
    let pattern = text(&desk, "raw.fits", "DETPSEED");
    desk.write(
        "again.toml",
        format!("photon_noise = true\npattern_seed = {pattern}\n{settings}{bad}"),
    );
    desk.done(&format!(
        "expose scene.fits --detector again.toml --seed {seed} -o again.fits"
    ));
    assert_eq!(desk.image("again.fits"), desk.image("raw.fits"));
}

#[test]
fn options_without_a_file_and_over_one() {
    let desk = with_detector();
    desk.write_image("dark.fits", points(&[]));
    let report = desk
        .done("expose dark.fits -o raw.fits --photon-noise --sky 400 --read-noise 5 --exposure 10 --dark 2 --seed 1 --json")
        .json();
    assert_eq!(
        (report["unit"].as_str(), report["dark_e"].as_f64()),
        (Some("electron"), Some(20.0))
    );
    let pixels = desk.image("raw.fits");
    let n = pixels.len() as f64;
    let mean = pixels.mean().unwrap();
    let variance = pixels.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    // Five standard deviations of the mean and of the variance.
    assert!((mean - 420.0).abs() < 5.0 * (445.0 / n).sqrt(), "{mean}");
    assert!(
        (variance - 445.0).abs() < 5.0 * 445.0 * (2.0 / n).sqrt(),
        "{variance}"
    );
    assert!(desk.bytes("raw.fits")[80..].starts_with(b"BITPIX  =                  -32"));

    let report = desk
        .done("expose dark.fits --detector ccd.toml -o over.fits --bits 8 --gain 3 --bias 10 --full-well 500 --json")
        .json();
    assert_eq!(report["detector"]["bits"], 8);
    assert_eq!(report["detector"]["sky_e"], 30.0);
    assert!(desk.bytes("over.fits")[80..].starts_with(b"BITPIX  =                    8"));
    assert_eq!(
        number(&desk, "over.fits", "SATURATE"),
        (500.0f64 / 3.0 + 10.0).min(255.0)
    );
}

#[test]
fn photons_alone() {
    let desk = Desk::new();
    desk.done("expose scene.fits --photons-only --seed 3 -o photons.fits --truth truth.fits --precision f64");
    let photons = desk.image("photons.fits");
    assert!(photons.iter().all(|n| *n >= 0.0 && n.fract() == 0.0));
    assert_eq!(desk.image("truth.fits"), desk.image("scene.fits"));
    // The photon noise equals that of a detector without other effects.
    desk.done("expose scene.fits --photon-noise --seed 3 -o same.fits --precision f64");
    assert_eq!(desk.image("same.fits"), photons);
}

#[test]
fn masks_of_bad_pixels() {
    let desk = Desk::new();
    desk.write_image("mask.fits", points(&[(3, 4, 1.0), (5, 6, 4.0), (7, 8, 8.0)]));
    desk.write_image("flat.fits", points(&[]));
    let options = "--sky 10 --quality quality.fits --overwrite -q";
    desk.done(&format!(
        "expose flat.fits --mask mask.fits -o raw.fits {options}"
    ));
    let (raw, quality) = (desk.image("raw.fits"), desk.image("quality.fits"));
    assert_eq!(
        (raw[[4, 3]], raw[[6, 5]], raw[[8, 7]], raw[[0, 0]]),
        (0.0, 0.0, 10.0, 10.0)
    );
    assert_eq!((quality[[4, 3]], quality[[6, 5]], quality.sum()), (1.0, 4.0, 5.0));
    // The written flags are a mask.
    desk.done(&format!(
        "expose flat.fits --mask quality.fits -o again.fits {}",
        "--sky 10 -q"
    ));
    assert_eq!(desk.image("again.fits"), raw);

    desk.write_image("bad.fits", points(&[(3, 4, 0.5)]));
    let to = "expose flat.fits -o out.fits --photon-noise --mask";
    desk.refused(
        &format!("{to} bad.fits"),
        1,
        &["bad.fits", "0.5", "[4, 3]", "1 (dead)"],
    );
    desk.write_image("hot.fits", points(&[(3, 4, 2.0)]));
    desk.refused(
        &format!("{to} hot.fits"),
        1,
        &["hot", "bad_pixels.hot_dark_e_per_s"],
    );
    desk.write_image("small.fits", ndarray::Array2::zeros((3, 4)));
    desk.refused(&format!("{to} small.fits"), 1, &["4 x 3", "61 x 51"]);
}

#[test]
fn what_is_left_out_is_said() {
    let desk = Desk::new();
    desk.warned("expose scene.fits --read-noise 3 -o raw.fits", "no photon noise");
    let text = desk
        .done("expose scene.fits --photon-noise --sky 3 -o raw.fits --seed 9 --overwrite")
        .stdout;
    for needle in [
        "raw.fits: 61 x 51 pixels in electron",
        "seed 9",
        "sky 3 e",
        "0 saturated",
    ] {
        assert!(text.contains(needle), "{text}");
    }
    // Levels of an earlier exposure are not copied to the next one.
    desk.done("expose scene.fits --photon-noise --read-noise 3 --full-well 90 -o first.fits");
    desk.done("expose first.fits --photon-noise -o second.fits");
    assert!(desk.header("second.fits").get("SATURATE").is_none());
    assert_eq!(number(&desk, "second.fits", "RDNOISE"), 0.0);
}

#[test]
fn negative_light_is_counted() {
    let desk = Desk::new();
    desk.write_image("dip.fits", points(&[(3, 4, -0.25), (9, 9, 50.0)]));
    let report = desk
        .done("expose dip.fits --photons-only -o raw.fits --json")
        .json();
    assert_eq!(
        (
            report["negative_pixels"].as_u64(),
            report["lowest_expected_e"].as_f64()
        ),
        (Some(1), Some(-0.25))
    );
    // Minus a Poisson number.
    let count = desk.image("raw.fits")[[4, 3]];
    assert!(count <= 0.0 && count.fract() == 0.0, "{count}");
}

#[test]
fn bad_usage() {
    let desk = with_detector();
    let to = "expose scene.fits -o out.fits";
    desk.refused(to, 2, &["nothing to add", "--detector", "Usage: psfield expose"]);
    desk.refused("expose -o out.fits --photon-noise", 2, &["IMAGE.fits"]);
    desk.refused("expose scene.fits --photon-noise", 2, &["--output"]);
    for (option, needles) in [
        ("--sky -1", ["--sky", "0 or above"]),
        ("--read-noise nan", ["--read-noise", "0 or above"]),
        ("--gain 0", ["--gain", "above 0"]),
        ("--full-well -5", ["--full-well", "above 0"]),
        ("--bits 25", ["--bits", "25"]),
        ("--bias inf", ["--bias", "inf"]),
        ("--dark 1", ["--dark needs --exposure", "give --exposure"]),
        ("--seed one", ["--seed", "one"]),
        (
            "--photons-only --detector ccd.toml",
            ["--photons-only", "--detector"],
        ),
        ("--photons-only --sky 3", ["--photons-only", "--sky"]),
        ("--precision f16", ["--precision", "f32"]),
    ] {
        desk.refused(&format!("{to} {option}"), 2, &needles);
    }
}

#[test]
fn bad_detectors_and_files() {
    let desk = Desk::new();
    let to = "expose scene.fits -o out.fits --detector";
    desk.refused(&format!("{to} none.toml"), 1, &["none.toml", "cannot read"]);
    for (content, needle) in [
        ("read_noise = 5.0", "read_noise"),
        ("read_noise_e = -5.0", "read_noise_e must be a number, 0 or above"),
        ("dark_e_per_s = 1.0", "exposure_s"),
        ("sky_e = ", "line 1"),
    ] {
        desk.write("bad.toml", content);
        desk.refused(&format!("{to} bad.toml"), 1, &["bad.toml", needle]);
    }
    desk.write(
        "steep.toml",
        "photon_noise = true\nsky_e = 1.0\nsky_gradient_e_per_px = { y = 1.0 }",
    );
    desk.refused(
        &format!("{to} steep.toml"),
        1,
        &["sky", "[0, 0]", "sky_gradient_e_per_px"],
    );

    desk.refused(
        "expose none.fits -o out.fits --photons-only",
        1,
        &["none.fits", "cannot read"],
    );
    desk.refused(
        "expose samples.fits -o out.fits --photons-only",
        1,
        &["samples.fits", "[9, 15, 15]"],
    );
    desk.refused(
        "expose scene.fits -o none/out.fits --photons-only",
        1,
        &["no directory none"],
    );
    // No input and no other output is ever overwritten, even with --overwrite.
    let photons = "expose scene.fits --photons-only --overwrite";
    desk.refused(
        &format!("{photons} -o scene.fits"),
        2,
        &["scene.fits", "another name"],
    );
    desk.refused(
        &format!("{photons} -o ./scene.fits"),
        2,
        &["scene.fits", "another name"],
    );
    desk.refused(
        &format!("{photons} -o a.fits --truth ./a.fits"),
        2,
        &["a.fits", "another name"],
    );
    desk.refused(
        &format!("{photons} -o a.fits --quality scene.fits"),
        2,
        &["scene.fits", "another name"],
    );
    desk.write("there.fits", "kept");
    desk.refused(
        "expose scene.fits --photons-only -o a.fits --truth there.fits",
        1,
        &["there.fits", "exists", "--overwrite"],
    );
}

const FAINT: &str = "x,y,flux,re,n\n30.3,25.1,4000,0,\n12,40,30,0,\n50.5,9,25,1.5,1\n20,20,40,0,\n";

/// Faint sources are drawn photon by photon, and the counts have the statistics of light.
#[test]
fn faint_sources_are_shot() {
    let desk = Desk::new();
    desk.write("stars.csv", FAINT);
    desk.write(
        "camera.toml",
        "photon_noise = true\nresponse_rms = 0.02\nsky_e = 4.0\n",
    );
    let simulate = format!("simulate --catalog stars.csv --shape {NX},{NY} --psf samples.fits --overwrite");
    let shot = format!("{simulate} --detector camera.toml --shoot-below 1000");
    let report = desk
        .run(&format!("{shot} -o image.fits --spot-check 200 --json"))
        .json();
    assert_eq!(report["shot"]["sources"], 3);
    let photons = report["shot"]["photons"].as_f64().unwrap();
    assert!((photons / (95.0 * 1.16) - 1.0).abs() < 0.4, "{photons}");
    assert_eq!(report["spot_check"]["passed"], true);
    let header = desk.header("image.fits");
    let value = |key: &str| header.get(key).and_then(Card::value);
    assert_eq!(value("PSFSHOT"), Some(CardValue::Integer(3)));
    assert!(
        !desk.path("image_truth.fits").exists(),
        "the truth is made on request"
    );

    // The mean of many exposures is that of light, and so is the truth.
    desk.run(&format!("{shot} -o image.fits --truth truth.fits"));
    let truth = desk.image("truth.fits");
    let mut mean = truth.mapv(|_| 0.0);
    let mut of_faint = 0.0;
    for seed in 0..30 {
        desk.run(&format!("{shot} -o image.fits --seed {seed}"));
        let image = desk.image("image.fits");
        of_faint += image.slice(s![14..27, 14..24]).sum() / 30.0;
        mean += &(image / 30.0);
    }
    let chi_square = mean
        .iter()
        .zip(&truth)
        .map(|(mean, truth)| (mean - truth).powi(2) * 30.0 / truth);
    let chi_square = chi_square.sum::<f64>() / truth.len() as f64;
    assert!((chi_square - 1.0).abs() < 0.12, "{chi_square}");
    let expected = truth.slice(s![14..27, 14..24]).sum();
    assert!(
        (of_faint - expected).abs() < 5.0 * (expected / 30.0).sqrt(),
        "{of_faint} {expected}"
    );

    // A seed gives the same counts again, another one does not.
    let counts = |seed: u32| {
        desk.run(&format!("{shot} -o image.fits --seed {seed}"));
        desk.image("image.fits")
    };
    assert_eq!(counts(1), counts(1));
    assert_ne!(counts(1), counts(2));
}

#[test]
fn shooting_needs_a_detector_with_photon_noise() {
    let desk = Desk::new();
    desk.write("stars.csv", FAINT);
    desk.write("quiet.toml", "read_noise_e = 3.0\n");
    let simulate = format!("simulate --catalog stars.csv --shape {NX},{NY} --psf samples.fits -o image.fits");
    desk.refused(&format!("{simulate} --shoot-below 10"), 2, &["--detector"]);
    desk.refused(
        &format!("{simulate} --shoot-below auto --detector quiet.toml"),
        1,
        &["quiet.toml", "photon_noise"],
    );
    for below in ["-1", "nan", "some"] {
        desk.refused(
            &format!("{simulate} --shoot-below {below} --detector quiet.toml"),
            2,
            &["--shoot-below", "auto or a number"],
        );
    }
}
