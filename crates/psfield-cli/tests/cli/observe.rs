//! `psfield observe` and `psfield inject`.

use ndarray::Array2;
use psfield::psf_io::{self, Card, HeaderCards};
use psfield::psf_types::Image;

use crate::desk::{Desk, NX, NY, samples};

/// A PSF that is fine enough to place stars between pixels.
fn desk() -> Desk {
    let desk = Desk::new();
    desk.write_samples("fine.fits", &samples(3, 3));
    desk
}

/// A survey of two detectors and two dithers, with positions of stars that the detectors of 61 x 51 pixels see.
const SURVEY: &str = r#"
catalog = "sky.csv"
output = "raw/{exposure}_{detector}.fits"
truth_table = "raw/{exposure}_{detector}_t.fits"
frames = "frames.csv"
seed = 3

[band.r]
zero_point = 25.0
sky_e_per_s = 1.0

[[detector]]
name = "A"
shape = [61, 51]
psf = "fine.fits"
settings = "ccd.toml"
geometry = { pixel_scale_arcsec = 1.0, centre_arcsec = [40, 0] }

[[detector]]
name = "B"
shape = [61, 51]
psf = "fine.fits"
settings = "ccd.toml"
geometry = { pixel_scale_arcsec = 1.0, centre_arcsec = [-40, 0], rotation_deg = 180 }

[[pointing]]
ra = 150.0
dec = 2.0
band = "r"
exposure_s = 10
dithers_arcsec = [[0, 0], [3, 2]]
"#;

const SKY: &str = "ra,dec,mag\n150.011,2.0,15\n149.989,2.001,16\n150.012,1.999,17\n150.3,2.0,15\n";

#[test]
fn a_survey_is_observed_continued_and_refused() {
    let desk = desk();
    desk.write("survey.toml", SURVEY);
    desk.write("sky.csv", SKY);
    desk.write(
        "ccd.toml",
        "photon_noise = true\ndark_e_per_s = 0.1\nfull_well_e = 2000.0\n",
    );
    let run = desk.run("observe survey.toml --log log.jsonl");
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!(run.stdout.matches("\"status\":\"done\"").count(), 4);
    assert_eq!(run.stdout.as_bytes(), desk.bytes("log.jsonl"));
    let names = ["001-1_A", "001-1_B", "001-2_A", "001-2_B"];
    for name in names {
        assert_eq!(desk.image(&format!("raw/{name}.fits")).dim(), (51, 61));
        assert!(desk.path(&format!("raw/{name}_t.fits")).exists());
    }
    let list = String::from_utf8(desk.bytes("frames.csv")).unwrap();
    assert!(list.starts_with("exposure,detector,file,extension,ra,dec,rotation_deg,date,band,exposure_s\n"));
    assert!(list.contains("001-2,B,raw/001-2_B.fits,,"), "{list}");
    // Again: nothing is done. A frame that is missing is made with the same pixels.
    let before = desk.image("raw/001-2_A.fits");
    std::fs::remove_file(desk.path("raw/001-2_A.fits")).unwrap();
    let run = desk.run("observe survey.toml");
    assert_eq!(
        run.stdout.matches("\"reason\":\"exists\"").count(),
        3,
        "{}",
        run.stdout
    );
    assert_eq!(desk.image("raw/001-2_A.fits"), before);
    // Another seed: the frames are not those of the survey.
    desk.write("survey.toml", SURVEY.replace("seed = 3", "seed = 4"));
    let run = desk.run("observe survey.toml -q");
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.contains("4 of 4 frames failed") && run.stdout.contains("other options"));
    let run = desk.run("observe survey.toml --overwrite");
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_ne!(desk.image("raw/001-2_A.fits"), before);
}

#[test]
fn bad_surveys_are_bad_usage_that_names_the_place() {
    let desk = desk();
    desk.write("sky.csv", SKY);
    desk.write("ccd.toml", "photon_noise = true\n");
    for (before, after, parts) in [
        ("seed = 3", "sead = 3", &["survey.toml", "line 6", "sead"][..]),
        ("name = \"B\"", "name = \"A\"", &["detector A appears twice"]),
        (
            "{exposure}_{detector}.fits",
            "{detector}.fits",
            &["raw/A.fits", "exposure 001-2"],
        ),
        (
            "raw/{exposure}_{detector}.fits",
            "fine.fits",
            &["fine.fits", "an input of the survey"],
        ),
        (
            "band = \"r\"",
            "band = \"g\"",
            &["pointing 1", "\"g\"", "bands r"],
        ),
        ("dec = 2.0", "dec = 99.0", &["pointing 1", "dec must be"]),
        (
            "shape = [61, 51]\npsf = \"fine.fits\"\nsettings = \"ccd.toml\"\ngeometry = { pixel_scale_arcsec = 1.0, centre_arcsec = [40, 0] }",
            "shape = [61, 51]\npsf = \"fine.fits\"",
            &["detector A", "geometry"],
        ),
        (
            "pixel_scale_arcsec = 1.0, centre_arcsec = [40, 0]",
            "pixel_scale_arcsec = 0",
            &["detector A", "above 0"],
        ),
    ] {
        assert!(SURVEY.contains(before), "{before}");
        desk.write("survey.toml", SURVEY.replace(before, after));
        desk.refused("observe survey.toml", 2, parts);
    }
    desk.refused("observe no.toml", 1, &["no.toml"]);
    desk.write("survey.toml", SURVEY);
    desk.refused(
        "observe survey.toml --log sky.csv",
        2,
        &["sky.csv", "an input of the survey"],
    );
    assert!(!desk.path("raw").exists());
}

#[test]
fn a_frame_that_fails_says_why_and_leaves_the_others() {
    let desk = desk();
    desk.write("sky.csv", SKY.replace("150.012,1.999,17", "150.012,1.999,"));
    desk.write("ccd.toml", "photon_noise = true\n");
    desk.write("survey.toml", SURVEY);
    let run = desk.run("observe survey.toml");
    assert_eq!(run.code, Some(1));
    assert!(
        run.stdout.contains("sky.csv: line 4") && run.stdout.contains("\\\"mag\\\""),
        "{}",
        run.stdout
    );
    assert_eq!(run.stdout.matches("\"status\":\"done\"").count(), 2);
    assert!(
        run.stderr.contains("2 of 4 frames failed: 001-1, A, 001-2, A"),
        "{}",
        run.stderr
    );
    desk.write("survey.toml", SURVEY.replace("zero_point = 25.0", ""));
    let run = desk.run("observe survey.toml --overwrite");
    assert!(
        run.stdout.contains("band r: the catalogue holds magnitudes"),
        "{}",
        run.stdout
    );
    desk.write("survey.toml", SURVEY.replace("[61, 51]", "[60, 51]"));
    let run = desk.run("observe survey.toml --overwrite");
    assert!(
        run.stdout.contains("fine.fits: this PSF is for frames of"),
        "{}",
        run.stdout
    );
}

#[test]
fn exposures_become_extensions() {
    let desk = desk();
    desk.write(
        "survey.toml",
        SURVEY.replace("{exposure}_{detector}.fits", "{exposure}.fits"),
    );
    desk.write("sky.csv", SKY);
    desk.write("ccd.toml", "photon_noise = true\n");
    let run = desk.run("observe survey.toml");
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    for name in ["A", "B"] {
        let image = psf_io::read_image_hdu::<f64>(desk.path("raw/001-2.fits"), Some(&name.parse().unwrap()));
        assert_eq!(image.unwrap().image().pixels().dim(), (51, 61));
    }
    assert!(!desk.path("raw/001-2.fits.parts").exists());
    let run = desk.run("observe survey.toml");
    assert_eq!(
        run.stdout.matches("\"status\":\"skipped\"").count(),
        4,
        "{}",
        run.stdout
    );
}

/// A frame with a gain, and a catalogue for it.
#[test]
fn sources_are_injected_into_a_frame() {
    let desk = desk();
    let sky = Image::new(Array2::from_elem((NY, NX), 100.0)).unwrap();
    let cards = [
        Card::new("GAIN", 2.0, "").unwrap(),
        Card::new("SATURATE", 400.0, "").unwrap(),
    ];
    psf_io::write_image(desk.path("real.fits"), &sky, &HeaderCards::new(), &cards, false).unwrap();
    psf_io::write_image(desk.path("plain.fits"), &sky, &HeaderCards::new(), &[], false).unwrap();
    desk.write("new.csv", "x,y,flux\n30,25,20000\n9,40,300\n");
    let run = desk.run("inject real.fits --catalog new.csv --psf fine.fits -o out.fits --truth-table t.fits");
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert!(
        run.stdout.contains("2 sources, 2 of them on the frame"),
        "{}",
        run.stdout
    );
    let image = desk.image("out.fits");
    assert_eq!(image[[25, 30]], 400.0);
    assert_eq!(image[[2, 2]], 100.0);
    assert!((image.mapv(|v| v - 100.0).sum() / 20300.0) > 0.2);
    let header = psf_io::read_header(desk.path("out.fits")).unwrap();
    assert!(
        header
            .iter()
            .any(|card| card.to_string().contains("sources injected, gain 2"))
    );
    assert_eq!(
        psf_io::read_cards(desk.path("t.fits"), None)
            .unwrap()
            .get("INJSEED")
            .unwrap()
            .value(),
        Some("0".into())
    );
    desk.done("inject real.fits --catalog new.csv --psf fine.fits --runs 3 --seed 5 -o r_{seed}.fits");
    assert_ne!(desk.image("r_5.fits"), desk.image("r_7.fits"));
    let inject = "--catalog new.csv --psf fine.fits -o x.fits";
    desk.refused(
        &format!("inject plain.fits {inject}"),
        2,
        &["plain.fits", "no gain", "--gain"],
    );
    desk.done(&format!("inject plain.fits {inject} --gain 1.5"));
    desk.refused(
        "inject real.fits --catalog new.csv --psf fine.fits -o z.fits --runs 2",
        2,
        &["z.fits", "{seed}"],
    );
    desk.refused(&format!("inject real.fits {inject}"), 1, &["x.fits", "exists"]);
    desk.refused(
        "inject real.fits --catalog new.csv --psf fine.fits -o real.fits --overwrite",
        2,
        &["real.fits"],
    );
    desk.refused("inject real.fits --catalog new.csv -o y.fits", 1, &["real.fits"]);
    desk.write("sky.csv", "ra,dec,flux\n1,2,3\n");
    desk.refused(
        "inject real.fits --catalog sky.csv --psf fine.fits -o y.fits",
        1,
        &["world coordinates"],
    );
}
