//! `psfield series`.

use std::time::{Duration, Instant};

use ndarray::Array2;
use psfield::psf_io::{Card, CardValue};
use psfield::psf_types::{PsfSamples, SamplePositions, StateKind};

use crate::desk::{Desk, NX, NY, difference, samples};

/// Rounding of images in f32, relative to the peak.
const SINGLE: f64 = 1e-6;
/// Errors of the interpolation of the desk's stamps between pixels, relative to the peak.
const INTERPOLATION: f64 = 1e-3;

const SERIES: &str = "start = \"2026-12-31T23:59:00\"
exposure_s = 30.5
cadence_s = 40.0
count = 3
light_curves = \"curves.csv\"

[pointing]
drift_px_per_s = [0.05, 0.0]
jitter_px = 0.1

[simulate]
psf = \"samples.fits\"
catalog = \"stars.csv\"
shape = [61, 51]
";

fn desk() -> Desk {
    let desk = Desk::new();
    // Stamps that can be shifted by fractions of a pixel.
    desk.write_samples("samples.fits", &samples(3, 3));
    desk.write("series.toml", SERIES);
    desk.write(
        "stars.csv",
        "x,y,flux,vx,vy\n20,25.5,100,0,0\n40.2,20,50,-0.1,-0.05\n",
    );
    desk.write("curves.csv", "row,time,factor\n0,0,1\n0,1000,11\n");
    desk
}

fn number(desk: &Desk, file: &str, keyword: &str) -> f64 {
    match desk.header(file).get(keyword).and_then(Card::value) {
        Some(CardValue::Real(value)) => value,
        other => panic!("{keyword}: {other:?}"),
    }
}

fn text(desk: &Desk, file: &str, keyword: &str) -> String {
    match desk.header(file).get(keyword).and_then(Card::value) {
        Some(CardValue::Text(value)) => value,
        other => panic!("{keyword}: {other:?}"),
    }
}

#[test]
fn frames_have_their_times_their_light_and_their_truth() {
    let desk = desk();
    let report = desk.done("series series.toml --out frames --json").json();
    assert_eq!(report["frames"].as_array().unwrap().len(), 3);
    let file = "frames/frame_0002.fits";
    assert_eq!(text(&desk, file, "DATE-OBS"), "2027-01-01T00:00:20.000000");
    assert_eq!(text(&desk, file, "DATE-END"), "2027-01-01T00:00:50.500000");
    assert_eq!(number(&desk, file, "EXPTIME"), 30.5);
    // The middle of the exposure is at 95.25 s.
    let middle: f64 = 80.0 + 15.25;
    assert!((number(&desk, file, "SHIFTX") - 0.05 * middle).abs() < 1e-9);
    let table = String::from_utf8(desk.bytes("frames/frame_0002_sources.csv")).unwrap();
    let rows: Vec<Vec<f64>> = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|v| v.parse().unwrap()).collect())
        .collect();
    let expected = [
        [0.0, 20.0 + 0.05 * middle, 25.5, 100.0 * (1.0 + middle / 100.0)],
        [1.0, 40.2 - 0.05 * middle, 20.0 - 0.05 * middle, 50.0],
    ];
    for (row, expected) in rows.iter().zip(expected) {
        let close = row
            .iter()
            .zip(expected)
            .all(|(a, b)| (a - b).abs() < 1e-9 * b.abs().max(1.0));
        assert!(close, "{row:?} {expected:?}");
    }
    let sum = desk.image(file).sum();
    assert!((sum / (rows[0][3] + 50.0) - 1.0).abs() < 1e-4, "{sum}");

    // The table is a catalogue: without motion during the exposure, it gives the same image.
    let still = SERIES
        .replace("[0.05, 0.0]", "[0.0, 0.0]")
        .replace("jitter_px = 0.1", "jitter_px = 0.0");
    desk.write("still.toml", still);
    desk.write("stars.csv", "x,y,flux\n20,25.5,100\n40.2,20,50\n");
    desk.done("series still.toml --out still");
    desk.done("simulate --catalog still/frame_0001_sources.csv --shape 61,51 --psf samples.fits -o one.fits");
    let (a, b) = (desk.image("still/frame_0001.fits"), desk.image("one.fits"));
    assert!(difference(&a, &b) < SINGLE);
}

#[test]
fn light_of_an_image_moves_with_the_pointing() {
    let desk = desk();
    let mut pixels = Array2::zeros((NY, NX));
    pixels[(25, 20)] = 100.0;
    desk.write_image("point.fits", pixels);
    desk.write("path.csv", "time,dx,dy\n-1,0,0\n0,3,-2\n1000,3,-2\n");
    desk.write(
        "series.toml",
        "start = 2026-12-31T23:59:00Z\nexposure_s = 10\nstarts_s = [0, 20]\n[pointing]\npath = \"path.csv\"\n\
         [simulate]\npsf = \"samples.fits\"\nscene = \"point.fits\"\n",
    );
    desk.done("series series.toml -o frames");
    desk.write("star.csv", "x,y,flux\n23,23,100\n");
    desk.done("simulate --catalog star.csv --shape 61,51 --psf samples.fits -o one.fits");
    let (a, b) = (desk.image("frames/frame_0001.fits"), desk.image("one.fits"));
    assert!(difference(&a, &b) < INTERPOLATION);
    // World coordinates move with the light (CRPIX1 of the desk's scenes is 20.5).
    assert_eq!(number(&desk, "frames/frame_0000.fits", "CRPIX1"), 23.5);
    // Existing frames are kept.
    let run = desk.run("series series.toml -o frames");
    assert_eq!(run.code, Some(1));
    assert!(
        run.stderr.contains("frame_0000.fits") && run.stderr.contains("--overwrite"),
        "{run:?}"
    );
    desk.done("series series.toml -o frames --overwrite");
}

#[test]
fn a_detector_exposes_each_frame_with_its_own_noise() {
    let desk = desk();
    desk.write(
        "camera.toml",
        "photon_noise = true\nsky_e = 100.0\nread_noise_e = 3.0\n",
    );
    desk.write("series.toml", format!("{SERIES}detector = \"camera.toml\"\n"));
    desk.done("series series.toml -o frames");
    assert_eq!(number(&desk, "frames/frame_0001.fits", "EXPTIME"), 30.5);
    let noise = |n: usize| {
        let truth = desk.image(&format!("frames/frame_000{n}_truth.fits"));
        desk.image(&format!("frames/frame_000{n}.fits")) - truth
    };
    let (a, b) = (noise(0), noise(1));
    assert!(a.std(0.0) > 5.0 && difference(&a, &b) > 0.5);
    desk.write("camera.toml", "photon_noise = true\nexposure_s = 100.0\n");
    let run = desk.run("series series.toml -o others");
    assert_eq!(run.code, Some(1));
    assert!(
        run.stderr.contains("100 s") && run.stderr.contains("30.5 s"),
        "{run:?}"
    );
}

#[test]
fn wrong_series_say_what_to_do() {
    let desk = desk();
    let cases = [
        ("count = 3\n", "", 2, "count"),
        ("count = 3\n", "count = 0\n", 2, "at least one exposure"),
        (
            "cadence_s = 40.0\n",
            "cadence_s = 20.0\n",
            2,
            "before exposure 0 ends",
        ),
        ("2026-12-31T23:59:00", "tonight", 2, "2026-11-27T21:00:00"),
        ("exposure_s = 30.5\n", "", 2, "exposure_s"),
        ("jitter_px = 0.1\n", "jitter_px = -0.1\n", 2, "jitter_px"),
        ("jitter_px = 0.1\n", "jitters_px = 0.1\n", 2, "jitters_px"),
        (
            "shape = [61, 51]\n",
            "shape = [61, 51]\noutput = \"a.fits\"\n",
            2,
            "output",
        ),
        (
            "shape = [61, 51]\n",
            "shape = [61, 51]\nstream = true\n",
            2,
            "stream",
        ),
        ("shape = [61, 51]\n", "shaped = [61, 51]\n", 2, "shaped"),
        (
            "count = 3\n",
            "count = 1152921504606846976\n",
            2,
            "at most 1000000 exposures",
        ),
        ("jitter_px = 0.1\n", "jitter_px = 1500\n", 1, "check the units"),
        ("jitter_px = 0.1\n", "jitter_px = 1e6\n", 1, "check the units"),
        ("curves.csv", "none.csv", 1, "none.csv"),
        ("\"samples.fits\"", "\"none.fits\"", 1, "none.fits"),
    ];
    for (from, to, code, part) in cases {
        desk.write("wrong.toml", SERIES.replace(from, to));
        let run = desk.run("series wrong.toml -o wrong");
        assert_eq!(run.code, Some(code), "{to}: {run:?}");
        assert!(run.stderr.contains(part), "{to}: {run:?}");
        assert!(!desk.path("wrong/frame_0000.fits").exists());
    }
    desk.write("curves.csv", "row,time,factor\n5,0,1\n5,1000,11\n");
    let run = desk.run("series series.toml -o wrong");
    assert!(run.code == Some(1) && run.stderr.contains("source 5"), "{run:?}");
    desk.write("curves.csv", "row,time,factor\n0,0,1\n0,100,11\n");
    let run = desk.run("series series.toml -o wrong");
    assert!(
        run.code == Some(1) && run.stderr.contains("from 0 to 100 s"),
        "{run:?}"
    );
    desk.write("stars.csv", "x,y,flux,vx\n20,25.5,100,0\n");
    let run = desk.run("series series.toml -o wrong");
    assert!(run.code == Some(1) && run.stderr.contains("\"vy\""), "{run:?}");
}

#[test]
fn outputs_do_not_replace_inputs() {
    let desk = desk();
    desk.done("series series.toml -o night");
    desk.write(
        "again.toml",
        SERIES.replace("stars.csv", "night/frame_0001_sources.csv"),
    );
    let before = desk.bytes("night/frame_0001_sources.csv");
    let run = desk.run("series again.toml -o night --overwrite");
    assert!(
        run.code == Some(2) && run.stderr.contains("an input of the series"),
        "{run:?}"
    );
    assert_eq!(desk.bytes("night/frame_0001_sources.csv"), before);
    desk.write(
        "late.toml",
        SERIES
            .replace("count = 3\n", "")
            .replace("cadence_s = 40.0", "starts_s = [1e12]")
            .replace("light_curves = \"curves.csv\"\n", "")
            .replace("[0.05, 0.0]", "[0.0, 0.0]"),
    );
    let run = desk.run("series late.toml -o late");
    assert!(run.code == Some(1) && run.stderr.contains("9999"), "{run:?}");
}

/// Neither a long drift nor many exposures take long.
#[test]
fn large_numbers_are_quick() {
    const QUICK: Duration = Duration::from_secs(60);
    let desk = desk();
    let quick = |text: &str, out: &str| {
        desk.write("large.toml", text);
        let clock = Instant::now();
        let run = desk.run(&format!("series large.toml -o {out}"));
        assert!(clock.elapsed() < QUICK, "{text}: {:?}", clock.elapsed());
        run
    };
    // By 600 pixels along x and y in each exposure.
    let drift = SERIES.replace("[0.05, 0.0]", "[19.7, 19.7]");
    let run = quick(&drift.replace("count = 3", "count = 1"), "drift");
    assert_eq!(run.code, Some(0), "{run:?}");
    // A million exposures, of which the PSF knows the first.
    let samples = samples(3, 3);
    let (at, field) = (samples.positions().as_slice(), samples.positions().field());
    let positions = SamplePositions::in_every_state(at, field, StateKind::Time, &[0.0, 100.0]).unwrap();
    let stamps = ndarray::concatenate(ndarray::Axis(0), &[samples.stamps(), samples.stamps()]).unwrap();
    let timed = PsfSamples::new(stamps, positions, samples.grid()).unwrap();
    desk.write_samples("samples.fits", &timed);
    let run = quick(&SERIES.replace("count = 3", "count = 1000000"), "many");
    assert!(
        run.code == Some(1) && run.stderr.contains("from 0 to 100 s"),
        "{run:?}"
    );
}
