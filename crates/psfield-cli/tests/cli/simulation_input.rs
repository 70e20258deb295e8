//! `psfield simulate`: catalogues, oversampled samples, sizes of stamps.

use ndarray::Array2;

use crate::desk::{Desk, NX, NY, difference, points, samples, scene};

/// Rounding of f64 transforms.
const DOUBLE: f64 = 1e-12;
/// Error of interpolating a well-sampled Gaussian, three times oversampled, to pixels and back.
const RESAMPLING: f64 = 1e-3;

const OPTIONS: &str = "--precision f64 --rank full";
/// Rounding in the fast engine with a tolerance of 0.
const EXACT: &str = "--precision f64 --rank full --tolerance 0";

fn centroid(image: &Array2<f64>) -> (f64, f64) {
    let sum = image.sum();
    let of = |axis: fn((usize, usize)) -> usize| {
        image
            .indexed_iter()
            .map(|(at, v)| axis(at) as f64 * v)
            .sum::<f64>()
            / sum
    };
    (of(|(_, x)| x), of(|(y, _)| y))
}

#[test]
fn stars_on_pixels_are_lit_pixels() {
    let desk = Desk::new();
    desk.write("stars.csv", "# two stars\nid,flux,x,y\na,10,20,15\nb,4.5,40,33\n");
    desk.write_image("lit.fits", points(&[(20, 15, 10.0), (40, 33, 4.5)]));
    desk.done(&format!(
        "simulate lit.fits --psf samples.fits -o lit_out.fits {EXACT}"
    ));
    let report = desk
        .done(&format!(
            "simulate --catalog stars.csv --shape 61,51 --psf samples.fits -o stars_out.fits {EXACT} --json"
        ))
        .json();
    assert_eq!(report["sources"], 2);
    let (stars, lit) = (desk.image("stars_out.fits"), desk.image("lit_out.fits"));
    assert!(difference(&stars, &lit) <= DOUBLE);

    // A scene with a catalogue gives the sum of both.
    for method in ["basis", "direct", "patch=1"] {
        let common = format!("--psf samples.fits {OPTIONS} --method {method}");
        desk.done(&format!("simulate scene.fits {common} -o scene_{method}.fits"));
        desk.done(&format!(
            "simulate scene.fits --catalog stars.csv {common} -o both_{method}.fits"
        ));
        let sum = desk.image(&format!("scene_{method}.fits")) + &stars;
        assert!(
            difference(&desk.image(&format!("both_{method}.fits")), &sum) <= DOUBLE,
            "{method}"
        );
    }
}

#[test]
fn oversampled_samples_serve_scene_and_catalogue() {
    let desk = Desk::new();
    desk.write_samples("fine.fits", &samples(3, 3));
    desk.write("star.csv", "x,y,flux\n30,25,10\n");
    desk.write_image("lit.fits", points(&[(30, 25, 10.0)]));
    let fine = format!("--psf fine.fits {EXACT}");
    desk.done(&format!("simulate lit.fits {fine} -o lit_out.fits"));
    desk.done(&format!(
        "simulate --catalog star.csv --shape 61,51 {fine} -o star_out.fits"
    ));
    let (star, lit) = (desk.image("star_out.fits"), desk.image("lit_out.fits"));
    assert!(difference(&star, &lit) <= RESAMPLING);
    // The PSF drawn at the frame's pixels.
    desk.done(&format!(
        "simulate lit.fits --psf samples.fits {EXACT} -o coarse_out.fits"
    ));
    assert!(difference(&lit, &desk.image("coarse_out.fits")) <= RESAMPLING);
    // Both together, with the check against the direct sum over both.
    desk.done(&format!("simulate scene.fits {fine} -o scene_out.fits"));
    let report = desk
        .done(&format!(
            "simulate scene.fits --catalog star.csv {fine} -o both.fits --spot-check 300 --json"
        ))
        .json();
    assert!(report["spot_check"]["max_over_peak"].as_f64().unwrap() <= DOUBLE);
    assert!(difference(&desk.image("both.fits"), &(desk.image("scene_out.fits") + &star)) <= DOUBLE);
}

#[test]
fn stars_between_pixels_stay_where_they_are() {
    let desk = Desk::new();
    desk.write_samples("fine.fits", &samples(3, 3));
    desk.write("star.csv", "x,y,flux\n30.3,24.6,10\n");
    for psf in ["fine", "samples"] {
        let simulate =
            format!("simulate --catalog star.csv --shape 61,51 --psf {psf}.fits -o {psf}_out.fits {OPTIONS}");
        if psf == "fine" {
            desk.done(&simulate);
        } else {
            desk.warned(&simulate, "too coarse to be interpolated");
        }
        let image = desk.image(&format!("{psf}_out.fits"));
        let (x, y) = centroid(&image);
        assert!(
            (x - 30.3).abs() < 0.01 && (y - 24.6).abs() < 0.01,
            "{psf}: {x} {y}"
        );
        assert!((image.sum() - 10.0).abs() < 0.01, "{psf}: {}", image.sum());
    }
    desk.done(&format!(
        "simulate --catalog star.csv --shape 61,51 --frame 10,5,40,40 --psf fine.fits -o cut.fits {OPTIONS}"
    ));
    let (x, y) = centroid(&desk.image("cut.fits"));
    assert!((x - 20.3).abs() < 0.01 && (y - 19.6).abs() < 0.01, "{x} {y}");
}

#[test]
fn stamp_size_cuts_and_pads() {
    let desk = Desk::new();
    desk.write_image("lit.fits", points(&[(30, 25, 1.0)]));
    let simulate = |size: &str, out: &str| {
        desk.done(&format!(
            "simulate lit.fits --psf samples.fits {OPTIONS} --method direct {size} -o {out}"
        ));
        desk.image(out)
    };
    let whole = simulate("", "whole.fits");
    let cut = simulate("--stamp-size 7", "cut.fits");
    let padded = simulate("--stamp-size 21", "padded.fits");
    for ((y, x), &value) in cut.indexed_iter() {
        let inside = x.abs_diff(30) <= 3 && y.abs_diff(25) <= 3;
        // The basis leaves only rounding.
        assert!(
            if inside {
                value > 1e-4
            } else {
                value.abs() <= DOUBLE
            },
            "{x} {y} {value:e}"
        );
    }
    assert!((cut.sum() - 1.0).abs() <= DOUBLE, "scaled to unit flux again");
    assert!(difference(&padded, &whole) <= DOUBLE);
    // A stamp far wider than the PSF costs no more than the PSF's own stamp.
    let clock = std::time::Instant::now();
    desk.done(&format!(
        "simulate lit.fits --psf samples.fits {OPTIONS} --tolerance 0 --stamp-size 5000 -o wide.fits"
    ));
    let seconds = clock.elapsed().as_secs();
    assert!(seconds < 20, "{seconds} s");
    assert!(difference(&desk.image("wide.fits"), &whole) <= 10.0 * DOUBLE);
    desk.done("fit samples.fits -o model.fits --rank full");
    desk.done(
        "simulate lit.fits --psf model.fits --precision f64 --tolerance 0 --stamp-size 7 -o cut_model.fits",
    );
    assert!(difference(&desk.image("cut_model.fits"), &cut) <= DOUBLE);
}

#[test]
fn scenes_and_frames_that_do_not_fit_are_refused() {
    let desk = Desk::new();
    desk.write("bright.csv", "x,y,flux\n3,4,1e39\n");
    for (arguments, code, needle) in [
        (
            "scene.fits --frame 10,10,61,20",
            2,
            "error: the frame (first pixel 10, 10; 61 x 20 pixels) reaches beyond the scene of 61 x 51 pixels (option --frame)\n",
        ),
        (
            "scene.fits --frame 9223372036854775807,10,5,6 --oversampling 3",
            2,
            "error: the frame of 5 x 6 pixels at (9223372036854775807, 10) lies outside any scene (option --frame)\n",
        ),
        (
            "--catalog bright.csv --shape 100000,90000",
            2,
            "error: --shape: 100000 x 90000 pixels are too many: a scene without an image may have at most 2^30 = 1073741824 pixels \
             (--oversampling multiplies both sides)\n",
        ),
        (
            "scene.fits --oversampling 7",
            1,
            "psfield: error: the scene is 61 x 51 pixels, but both numbers must be multiples of 7, because 7 scene pixels lie \
             along each side of a frame pixel: cut the scene, or choose a part of it with a frame (option --frame)\n",
        ),
        (
            "--catalog bright.csv --shape 61,51",
            1,
            "psfield: error: bright.csv: a flux of 1e39 is beyond single precision (3.4e38): choose f64 (option --precision)\n",
        ),
    ] {
        desk.refused(
            &format!("simulate {arguments} --psf samples.fits -o image.fits --device cpu"),
            code,
            &[needle],
        );
    }
}

#[test]
fn nan_pixels_of_a_scene_become_a_flux_and_are_counted() {
    let desk = Desk::new();
    let mut pixels = scene();
    desk.write_image("nan.fits", pixels.clone());
    let mut bytes = desk.bytes("nan.fits");
    for (x, y) in [(20, 15), (21, 15), (40, 30)] {
        pixels[[y, x]] = 2.5;
        let at = bytes.len().next_multiple_of(2880) - (NX * NY * 8).next_multiple_of(2880) + 8 * (y * NX + x);
        bytes[at..at + 8].fill(0xff);
    }
    desk.write("nan.fits", bytes);
    desk.write_image("scene.fits", pixels);
    let to = format!("--psf samples.fits {EXACT}");
    desk.done(&format!("simulate scene.fits {to} -o truth.fits"));
    for how in ["", "--stream", "--stream --spot-check 20"] {
        let run = format!("simulate nan.fits {to} -o image.fits --overwrite --nan-as 2.5 {how}");
        let report = desk.done(&format!("{run} --json")).json();
        assert_eq!(report["nan_pixels"], 3, "{report}");
        assert!(difference(&desk.image("image.fits"), &desk.image("truth.fits")) <= DOUBLE);
        assert!(
            desk.done(&run)
                .stdout
                .contains("NaN pixels of the scene that were replaced: 3\n")
        );
    }
    desk.refused(
        "simulate --catalog stars.csv --shape 5,5 --psf samples.fits -o x.fits --nan-as 0",
        2,
        &["--nan-as"],
    );
    desk.refused(
        "simulate nan.fits --psf samples.fits -o x.fits --nan-as nan",
        2,
        &["--nan-as", "finite"],
    );
}
