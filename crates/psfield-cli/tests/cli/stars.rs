//! Frames with stars: `psfield sample FRAME.fits` and `psfield validate`.

use ndarray::Array2;
use psfield::psf_io;

use crate::desk::{Desk, assert_keys};

const SIDE: usize = 192;
/// Error of a centroid at a signal-to-noise ratio of 100 and more.
const PLACE_PX: f64 = 0.05;
/// Error of the median flux ratio of 25 stars. The noise of a single aperture is 50, or 0.4 % of
/// the median flux, and the positions of the stars have errors.
const FLUX_RATIO: f64 = 0.01;

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
    let trip = "validate frame.fits --report trip --realisations 2 --json";
    let run = desk.run(trip);
    assert_eq!(run.code, Some(0), "{run:?}");
    let report = run.json();
    assert_eq!(report["stars"], 25);
    assert_eq!(report["realisations"], 2);
    let ratio = report["fwhm_px"]["median_ratio"].as_f64().unwrap();
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    for stars in [&report, &report["left_out"]] {
        let flux = &stars["flux_ratio"];
        assert_eq!(flux["count"], 25);
        assert!(
            (flux["median"].as_f64().unwrap() - 1.0).abs() < FLUX_RATIO,
            "{flux}"
        );
        assert!(stars["reduced_chi_square"]["median"].as_f64().unwrap() > 0.0);
    }
    assert_eq!(report["photon_noise"], false);
    let told = desk.run("roundtrip frame.fits --report told --realisations 1 --gain 2");
    assert!(
        told.stdout.contains("each star drawn by a model made without it"),
        "{told:?}"
    );
    assert!(told.stdout.contains("background and photons"), "{told:?}");
    for name in report["files"].as_array().unwrap() {
        assert!(!desk.bytes(&format!("trip/{}", name.as_str().unwrap())).is_empty());
    }
    assert_eq!(desk.image("trip/simulated.fits").dim(), (SIDE, SIDE));
    desk.refused("validate frame.fits --report trip", 1, &["exists", "--overwrite"]);

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
        ("--max-draws 9", "--max-draws"),
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
        &format!("{to} --detection-threshold 1e9"),
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
    let run = desk.run("validate mef.fits --extension FRAME --report trip --realisations 1");
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

/// Copies `frame.fits` to `nan.fits`, with NaN in these pixels `(x, y)`.
fn put_nan(desk: &Desk, pixels: &[(usize, usize)]) {
    let mut bytes = desk.bytes("frame.fits");
    // A double-precision image after a header of one block or more.
    let end = (0..1000)
        .find(|k| bytes[80 * k..].starts_with(b"END     "))
        .unwrap();
    let data = (80 * (end + 1)).next_multiple_of(2880);
    for (x, y) in pixels {
        let at = data + 8 * (y * SIDE + x);
        bytes[at..at + 8].fill(0xff);
    }
    desk.write("nan.fits", bytes);
}

#[test]
fn pixels_without_a_value_are_told_of() {
    let desk = desk();
    put_nan(&desk, &[(0, 0)]);
    for (command, option) in [
        ("sample nan.fits -o out.fits", "--nan-is-masked, or --mask"),
        ("validate nan.fits --report out", "--nan-is-masked, or --mask"),
    ] {
        desk.refused(command, 1, &["nan.fits", "NaN", option]);
    }
}

#[test]
fn masked_pixels_are_left_out() {
    let desk = desk();
    // The core of one star is NaN, and the mask has the core of another star.
    let core = |k: usize| (stars()[k].0.round() as usize, stars()[k].1.round() as usize);
    put_nan(&desk, &[core(6), (core(6).0 + 1, core(6).1)]);
    let mut mask = Array2::zeros((SIDE, SIDE));
    mask[[core(18).1, core(18).0]] = 4.0;
    desk.write_image("mask.fits", mask.clone());
    for (frame, options, masked) in [
        ("frame", "--mask mask.fits", 1),
        ("nan", "--nan-is-masked", 1),
        ("nan", "--nan-is-masked --mask mask.fits", 2),
    ] {
        let run = desk.run(&format!(
            "sample {frame}.fits -o out.fits --sources out.csv --overwrite --json {options}"
        ));
        assert_eq!(run.code, Some(0), "{run:?}");
        let report = run.json();
        assert_eq!(report["samples"], 25 - masked, "{report}");
        assert_eq!(report["rejected"]["masked"], masked, "{report}");
        let background = report["background_rms"].as_f64().unwrap();
        assert!((background / 4.0 - 1.0).abs() < 0.1, "{background}");
    }
    // A mask that covers the NaN pixels suffices.
    mask[[core(6).1, core(6).0]] = 1.0;
    let sample = "sample nan.fits -o out.fits --overwrite --mask mask.fits --json";
    desk.write_image("mask.fits", mask.clone());
    assert!(desk.run(sample).stderr.contains("--nan-is-masked"));
    mask[[core(6).1, core(6).0 + 1]] = 1.0;
    desk.write_image("mask.fits", mask);
    assert_eq!(desk.run(sample).json()["samples"], 23);

    desk.done("sample frame.fits -o samples.fits -q");
    let validate = "validate samples.fits --reference nan.fits --report report";
    desk.refused(validate, 1, &["nan.fits", "NaN", "--nan-is-masked, or --mask"]);
    let report = desk
        .done(&format!("{validate} --mask mask.fits --json -q"))
        .json();
    assert_eq!(report["objects"]["summary"]["objects"], 23, "{report}");
    // A round trip: the residual of pixels without a value is the noise of the simulation.
    let trip = desk
        .done("validate nan.fits --report trip --mask mask.fits --json -q")
        .json();
    assert_eq!(trip["stars"], 23, "{trip}");
    let residual = desk.image("trip/residual.fits")[[core(6).1, core(6).0]];
    assert!(residual.abs() < 5.0 * 4.0, "{residual}");
    desk.refused(
        "validate samples.fits --reference samples.fits --report other --nan-is-masked",
        2,
        &["--nan-is-masked applies only to frames"],
    );
    desk.write_image("small.fits", Array2::zeros((SIDE, SIDE - 1)));
    desk.refused(
        "sample frame.fits -o other.fits --mask small.fits",
        1,
        &["small.fits", "191 x 192", "192 x 192", "--mask"],
    );
}

#[test]
fn stars_can_be_held_out_for_a_check() {
    let desk = desk();
    let run = desk.run("sample frame.fits -o samples.fits --hold-out 5 --sources sources.csv --json");
    assert_eq!(run.code, Some(0), "{run:?}");
    let report = run.json();
    assert_eq!(
        (report["samples"].as_u64(), report["held_out"].as_u64()),
        (Some(20), Some(5))
    );
    assert_eq!(report["rejected"]["held-out"], 5);
    let text = String::from_utf8(desk.bytes("sources.csv")).unwrap();
    assert_eq!(text.lines().filter(|line| line.ends_with(",held-out")).count(), 5);

    let (samples, held_out) = (desk.samples("samples.fits"), desk.samples("samples_holdout.fits"));
    assert_eq!(held_out.grid(), samples.grid());
    // Together they are the stars, each of unit flux.
    let mut all: Vec<(f64, f64)> = stars().iter().map(|s| (s.0, s.1)).collect();
    for found in [&samples, &held_out] {
        for (k, at) in found.positions().as_slice().iter().enumerate() {
            all.retain(|star| (star.0 - at.x()).hypot(star.1 - at.y()) > PLACE_PX);
            assert!((found.flux(k) - 1.0).abs() < 1e-5);
        }
    }
    assert!(all.is_empty(), "{all:?}");

    desk.run("fit samples.fits -o model.fits");
    let run = desk.run("validate model.fits --reference samples_holdout.fits --report check --json");
    assert!(!run.stderr.contains("half a pixel of a sample"), "{run:?}");
    assert_eq!(run.json()["at_samples"], 0);
    // A frame contains the stars from which the model was made.
    let run = desk.run("validate model.fits --reference frame.fits --report frame --json");
    assert!(run.stderr.contains("20 of 25 objects in frame.fits"), "{run:?}");

    desk.refused(
        "sample frame.fits -o x.fits --hold-out 25",
        1,
        &["stars to hold out is 25", "below 25"],
    );
    // Stars of a well-sampled frame can be held out of an oversampled PSF, too.
    let run = desk.run("sample frame.fits -o x.fits --hold-out 3 --registration epsf --json");
    assert_eq!(run.json()["held_out"], 3, "{run:?}");
}
