//! `psfield sample FRAME.fits` and `psfield roundtrip`.

use ndarray::Array2;
use psfield::psf_io;

use crate::desk::{Desk, assert_keys};

const SIDE: usize = 192;
/// Error of a centroid at a signal-to-noise ratio of 100 and more.
const PLACE_PX: f64 = 0.05;

/// Stars with a FWHM of 2.8 pixels at known positions on a noisy background, bright enough to be
/// measured well.
fn stars() -> Vec<(f64, f64, f64)> {
    (0..25usize)
        .map(|k| {
            let (i, j) = ((k % 5) as f64, (k / 5) as f64);
            let (dx, dy) = ((k * 7 % 11) as f64 / 11.0, (k * 5 % 13) as f64 / 13.0);
            (
                20.0 + 36.0 * i + dx,
                20.0 + 36.0 * j + dy,
                8e3 + 2e3 * (k % 6) as f64,
            )
        })
        .collect()
}

fn desk() -> Desk {
    let desk = Desk::empty();
    let sigma2 = 1.2f64 * 1.2;
    // The sum of several remainders is nearly normal, and equal on every machine.
    let noise = |x: usize, y: usize| {
        let sum: usize = [7919, 104_729, 1_299_709, 15_485_863]
            .iter()
            .enumerate()
            .map(|(k, p)| ((x + 31 * k) * p + (y + 17 * k) * (p / 3 + 7) * (x % 13 + 1)) % 101)
            .sum();
        (sum as f64 - 200.0) / 58.3
    };
    let mut frame = Array2::from_shape_fn((SIDE, SIDE), |(y, x)| 500.0 + 4.0 * noise(x, y));
    for (x, y, flux) in stars() {
        for ((row, column), value) in frame.indexed_iter_mut() {
            let r2 = (column as f64 - x).powi(2) + (row as f64 - y).powi(2);
            *value += flux / (std::f64::consts::TAU * sigma2) * (-0.5 * r2 / sigma2).exp();
        }
    }
    desk.write_image("frame.fits", frame);
    desk
}

#[test]
fn the_stars_of_a_frame_become_samples() {
    let desk = desk();
    let run =
        desk.run("sample frame.fits -o samples.fits --sources sources.csv --coverage coverage.fits --json");
    assert_eq!(run.code, Some(0), "{run:?}");
    let report = run.json();
    assert_keys(
        &report,
        &[
            "samples",
            "sources",
            "rejected",
            "fwhm_px",
            "saturation",
            "registration",
            "coverage",
        ],
    );
    assert_eq!(report["samples"], 25, "{report}");
    assert!((report["fwhm_px"].as_f64().unwrap() / (2.3548 * 1.2) - 1.0).abs() < 0.02);
    assert_eq!(report["registration"]["method"], "stamps");
    let samples = desk.samples("samples.fits");
    for (x, y, _) in stars() {
        let near = |p: &&psfield::psf_types::Position| (p.x() - x).hypot(p.y() - y) < PLACE_PX;
        assert_eq!(samples.positions().as_slice().iter().filter(near).count(), 1);
    }
    let coverage = psf_io::read_cube::<f64>(desk.path("coverage.fits")).unwrap();
    assert_eq!(coverage.dim().0, 3);
    assert_eq!(coverage.index_axis(ndarray::Axis(0), 0).sum(), 25.0);
    let [flux] = psf_io::read_columns(desk.path("sources.csv"), ["flux"]).unwrap();
    let total: f64 = flux.iter().sum();
    let made: f64 = stars().iter().map(|s| s.2).sum();
    assert!((total / made - 1.0).abs() < 0.03, "{total} against {made}");
    desk.done("fit samples.fits -o model.fits");
}

#[test]
fn a_round_trip_reports_and_protects_its_files() {
    let desk = desk();
    let trip = "roundtrip frame.fits --report trip --realisations 2 --json";
    let run = desk.run(trip);
    assert_eq!(run.code, Some(0), "{run:?}");
    let report = run.json();
    assert_eq!(report["stars"], 25);
    assert_eq!(report["realisations"], 2);
    let ratio = report["fwhm_px"]["median_ratio"].as_f64().unwrap();
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    for name in report["files"].as_array().unwrap() {
        assert!(!desk.bytes(&format!("trip/{}", name.as_str().unwrap())).is_empty());
    }
    assert_eq!(desk.image("trip/simulated.fits").dim(), (SIDE, SIDE));
    desk.refused(
        "roundtrip frame.fits --report trip",
        1,
        &["exists", "--overwrite"],
    );

    // Equal seeds give equal bytes, with any number of threads.
    let before = desk.bytes("trip/stars.csv");
    desk.run(&format!("{trip} --overwrite --threads 1"));
    assert_eq!(desk.bytes("trip/stars.csv"), before);
    desk.run(&format!("{trip} --overwrite --seed 2"));
    assert_ne!(desk.bytes("trip/stars.csv"), before);
}

#[test]
fn options_of_the_other_input_and_frames_without_stars() {
    let desk = desk();
    let to = "sample frame.fits -o out.fits";
    for (option, needle) in [
        ("--criterion neighbours", "--criterion"),
        ("--uniform 3,3", "--uniform"),
        ("--max-samples 9", "--max-samples"),
        ("--stamp-size 4", "stamp size"),
        ("--read-noise 3", "--gain"),
        ("--snr -1", "--snr"),
    ] {
        desk.refused(&format!("{to} {option}"), 2, &[needle]);
    }
    desk.refused(
        "sample --preset survey-2m -o out.fits --snr 5",
        2,
        &["--snr", "frames"],
    );
    desk.refused(&format!("{to} --snr 1e9"), 1, &["frame.fits", "25", "low-snr"]);
    desk.refused(
        &format!("{to} --threshold 1e9"),
        1,
        &["frame.fits", "lower the threshold"],
    );
    desk.refused(
        &format!("{to} --registration epsf --oversampling 4"),
        1,
        &["48 stars", "25"],
    );
    desk.write_image("flat.fits", Array2::from_elem((64, 64), 3.0));
    desk.refused("sample flat.fits -o out.fits", 1, &["flat.fits", "noise"]);
}

/// The image of a file as an extension with this name and these cards.
fn as_extension(image: &[u8], name: &str, cards: &[String]) -> Vec<u8> {
    let end = (0..1000)
        .find(|k| image[80 * k..].starts_with(b"END     "))
        .expect("a header ends");
    let mut header = format!("{:<80}", "XTENSION= 'IMAGE   '").into_bytes();
    for k in 1..end {
        let card = &image[80 * k..80 * (k + 1)];
        if !card.starts_with(b"EXTEND") {
            header.extend(card);
        }
        if card.starts_with(b"NAXIS2") {
            header.extend(format!("{:<80}{:<80}", "PCOUNT  = 0", "GCOUNT  = 1").into_bytes());
        }
    }
    for card in [format!("EXTNAME = '{name:<8}'")].iter().chain(cards) {
        header.extend(format!("{card:<80}").into_bytes());
    }
    header.extend(format!("{:<80}", "END").into_bytes());
    header.resize(header.len().next_multiple_of(2880), b' ');
    header.extend(&image[(80 * (end + 1)).next_multiple_of(2880)..]);
    header
}

/// The frame as extension `FRAME` behind a cube, with cards of its own.
fn in_extension(desk: &Desk, cards: &[String]) {
    psf_io::write_cube(
        desk.path("cube.fits"),
        ndarray::Array3::<f64>::zeros((3, 8, 8)).view(),
        &[psf_io::Card::new("OBJECT", "cube", "").unwrap()],
        true,
    )
    .unwrap();
    let mut file = desk.bytes("cube.fits");
    file.extend(as_extension(&desk.bytes("frame.fits"), "FRAME", cards));
    desk.write("mef.fits", file);
}

#[test]
fn a_frame_in_an_extension_keeps_its_own_header() {
    let desk = desk();
    in_extension(&desk, &["OBJECT  = 'stars   '".to_owned()]);
    let run = desk.run("sample mef.fits --extension FRAME -o samples.fits --json");
    assert_eq!(run.code, Some(0), "{run:?}");
    assert_eq!(run.json()["samples"], 25, "{run:?}");
    let run = desk.run("roundtrip mef.fits --extension FRAME --report trip --realisations 1");
    assert_eq!(run.code, Some(0), "{run:?}");
    let object = desk
        .header("trip/simulated.fits")
        .get("OBJECT")
        .and_then(psf_io::Card::value);
    assert_eq!(object, Some("stars".into()));
    desk.refused("sample mef.fits --extension 0 -o out.fits", 1, &["mef.fits"]);
}

#[test]
fn a_saturation_level_of_the_header_is_named_and_judged() {
    let desk = desk();
    in_extension(&desk, &["SATURATE= 550.0".to_owned()]);
    desk.refused(
        "sample mef.fits --extension FRAME -o out.fits",
        1,
        &["saturated", "550", "SATURATE of the header"],
    );
    let run = desk.run("sample mef.fits --extension FRAME --saturation 1e5 -o given.fits --json");
    assert_eq!(run.json()["saturation"]["origin"], "given");
    in_extension(&desk, &["SATURATE= 0.0".to_owned()]);
    desk.warned("sample mef.fits --extension FRAME -o out.fits", "SATURATE");
    assert_eq!(desk.samples("out.fits").len(), 25);
}

#[test]
fn a_stamp_has_room_at_the_edge() {
    let desk = desk();
    desk.refused(
        "sample frame.fits -o out.fits --edge 3",
        1,
        &["frame.fits", "3 pixels", "half a stamp"],
    );
    let run = desk.run("sample frame.fits -o out.fits --edge 9 --stamp-size 15");
    assert_eq!(run.code, Some(0), "{run:?}");
}

#[test]
fn pixels_without_a_value_are_told_of() {
    let desk = desk();
    let mut bytes = desk.bytes("frame.fits");
    // The first pixel, in a double-precision image after a header of one block or more.
    let end = (0..1000)
        .find(|k| bytes[80 * k..].starts_with(b"END     "))
        .unwrap();
    let data = (80 * (end + 1)).next_multiple_of(2880);
    bytes[data..data + 8].fill(0xff);
    desk.write("nan.fits", bytes);
    desk.refused(
        "sample nan.fits -o out.fits",
        1,
        &["nan.fits", "NaN", "--saturation"],
    );
}
