//! `psfield measure`.

use psfield::psf_io::read_columns;

use crate::desk::{Desk, points, samples};

/// FWHM of a Gaussian over its sigma.
const FWHM: f64 = 2.354_820_045;
/// The PSF is a Gaussian at pixel centres. The fit recovers it except for its own stopping rule and
/// the cut at the stamp's edge.
const FIT: f64 = 1e-4;

const HEADER: &str = "x,y,flux,x_centroid,y_centroid,fwhm_px,fwhm_major_px,fwhm_minor_px,angle_rad,eccentricity,e1,e2,g1,g2,sigma_px,ellipticity,note";

/// The lines of a table of measurements, without the header.
fn rows(desk: &Desk, name: &str) -> Vec<Vec<String>> {
    let text = String::from_utf8(desk.bytes(name)).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some(HEADER));
    lines
        .map(|line| line.splitn(17, ',').map(str::to_owned).collect())
        .collect()
}

/// Sigma of the PSF at the sample (0, 0), along x and y.
const SIGMA: (f64, f64) = (1.2, 1.3);

#[test]
fn stamps_of_samples() {
    let desk = Desk::new();
    for (options, out) in [
        ("", "table.csv"),
        ("--window 11", "window.csv"),
        ("--background", "sky.csv"),
    ] {
        let report = desk
            .done(&format!("measure samples.fits -o {out} {options} --json"))
            .json();
        assert_eq!(
            (report["measured"].as_u64(), report["with_notes"].as_u64()),
            (Some(9), Some(0))
        );
        let [x, y, flux, cx, cy, major, minor] = read_columns(
            desk.path(out),
            [
                "x",
                "y",
                "flux",
                "x_centroid",
                "y_centroid",
                "fwhm_major_px",
                "fwhm_minor_px",
            ],
        )
        .unwrap();
        assert_eq!((x[4], y[4]), (30.0, 25.0));
        let near = |got: f64, expected: f64| assert!((got - expected).abs() < FIT, "{got} {expected}");
        near(flux[0], 1.0);
        near(cx[0], 7.0);
        near(cy[0], 7.0);
        near(major[0], FWHM * SIGMA.1);
        near(minor[0], FWHM * SIGMA.0);
        let [e1, g1, e2, sigma] = read_columns(desk.path(out), ["e1", "g1", "e2", "sigma_px"]).unwrap();
        let (a, b) = (SIGMA.0.powi(2), SIGMA.1.powi(2));
        near(e1[0], (a - b) / (a + b));
        near(g1[0], (SIGMA.0 - SIGMA.1) / (SIGMA.0 + SIGMA.1));
        near(e2[0], 0.0);
        near(sigma[0], (SIGMA.0 * SIGMA.1).sqrt());
    }
}

/// Eccentricity and ellipticity of one ellipse are different numbers, each with its own name.
#[test]
fn eccentricity_and_ellipticity() {
    let desk = Desk::new();
    desk.done("measure samples.fits -o table.csv");
    let [eccentricity, ellipticity] =
        read_columns(desk.path("table.csv"), ["eccentricity", "ellipticity"]).unwrap();
    let (a, b) = (SIGMA.1.powi(2), SIGMA.0.powi(2));
    assert!(
        (eccentricity[0] - (1.0 - b / a).sqrt()).abs() < 1e-3,
        "{eccentricity:?}"
    );
    assert!(
        (ellipticity[0] - (a - b) / (a + b)).abs() < FIT,
        "{ellipticity:?}"
    );
    assert!(eccentricity[0] > 4.0 * ellipticity[0]);
}

/// Lengths and flux of oversampled samples are those on the frame. Centroids are indices of the
/// stamp.
#[test]
fn oversampled_samples_are_measured_in_frame_pixels() {
    let desk = Desk::empty();
    desk.write_samples("fine.fits", &samples(3, 3));
    desk.done("measure fine.fits -o fine.csv");
    let columns = ["flux", "fwhm_major_px", "fwhm_minor_px", "sigma_px", "x_centroid"];
    let [flux, major, minor, sigma, x] = read_columns(desk.path("fine.csv"), columns).unwrap();
    let near = |got: f64, expected: f64| assert!((got - expected).abs() < 2e-3, "{got} {expected}");
    near(flux[0], 1.0);
    near(major[0], FWHM * SIGMA.1);
    near(minor[0], FWHM * SIGMA.0);
    near(sigma[0], (SIGMA.0 * SIGMA.1).sqrt());
    let middle = desk.samples("fine.fits").grid().nx() / 2;
    near(x[0], middle as f64);
}

#[test]
fn positions_of_an_image() {
    let desk = Desk::new();
    desk.write_image("stars.fits", points(&[(15, 20, 100.0), (45, 30, 50.0)]));
    desk.done("simulate stars.fits --psf samples.fits -o image.fits --precision f64 --rank full");
    desk.write("at.csv", "x,y\n15,20\n45,30\n");
    desk.done("measure image.fits --at at.csv -o table.csv");
    let [flux, x, y] = read_columns(desk.path("table.csv"), ["flux", "x_centroid", "y_centroid"]).unwrap();
    for (got, expected) in [
        (flux[0] / 100.0, 1.0),
        (flux[1] / 50.0, 1.0),
        (x[1], 45.0),
        (y[1], 30.0),
    ] {
        // The PSF between samples is a mean of Gaussians, not a Gaussian.
        assert!((got - expected).abs() < 0.02, "{got} {expected}");
    }
}

#[test]
fn what_fails_is_empty_and_says_why() {
    let desk = Desk::new();
    desk.write_image("stars.fits", points(&[(15, 20, 100.0)]));
    // The direct sum leaves the sky exactly 0.
    desk.done("simulate stars.fits --psf samples.fits -o image.fits --method direct");
    desk.write("at.csv", "x,y\n15,20\n45,35\n400,3\n");
    let report = desk
        .done("measure image.fits --at at.csv -o table.csv --json")
        .json();
    assert_eq!(
        (report["measured"].as_u64(), report["with_notes"].as_u64()),
        (Some(3), Some(2))
    );
    let rows = rows(&desk, "table.csv");
    assert_eq!(rows[0][16], "");
    assert!(
        rows[0][2..16]
            .iter()
            .all(|field| field.parse::<f64>().unwrap().is_finite())
    );
    for (row, why) in [
        (&rows[1], "Gaussian fit"),
        (&rows[2], "outside the image of 61 x 51 pixels"),
    ] {
        assert!(row[2..16].iter().all(String::is_empty), "{row:?}");
        assert!(row[16].contains(why), "{row:?}");
    }
    let text = desk.done("measure image.fits --at at.csv -o again.csv").stdout;
    assert!(
        text.contains("3 rows, 2 of them with a failed measurement"),
        "{text}"
    );
}

#[test]
fn cubes_without_positions_and_single_stamps() {
    let desk = Desk::new();
    // Keeps only the cube: the primary HDU ends where the HDU of the table begins.
    let bytes = desk.bytes("samples.fits");
    let table = bytes.windows(8).position(|w| w == b"XTENSION").unwrap();
    desk.write("cube.fits", &bytes[..table]);
    desk.done("measure cube.fits -o cube.csv");
    desk.done("measure samples.fits -o samples.csv");
    let (cube, samples) = (rows(&desk, "cube.csv"), rows(&desk, "samples.csv"));
    assert_eq!(cube.len(), 9);
    for (a, b) in cube.iter().zip(&samples) {
        assert_eq!((a[0].as_str(), a[1].as_str()), ("", ""));
        assert_eq!(a[2..], b[2..]);
    }
    let plane = desk
        .samples("samples.fits")
        .stamps()
        .index_axis_move(ndarray::Axis(0), 3)
        .to_owned();
    desk.write_image("stamp.fits", plane);
    desk.done("measure stamp.fits -o stamp.csv");
    assert_eq!(rows(&desk, "stamp.csv")[0][2..], samples[3][2..]);
}

#[test]
fn inputs_that_cannot_be_measured() {
    let desk = Desk::new();
    desk.write("at.csv", "x,y\n15,20\n");
    desk.done("fit samples.fits -o model.fits");
    desk.refused(
        "measure model.fits -o out.csv",
        1,
        &["model.fits", "PSF model", "evaluate"],
    );
    desk.refused(
        "measure samples.fits --at at.csv -o out.csv",
        2,
        &["samples.fits", "--at", "Usage: psfield measure"],
    );
    desk.refused("measure at.csv -o out.csv", 1, &["at.csv", "not a FITS file"]);
    desk.refused("measure samples.fits --window 0 -o out.csv", 2, &["--window"]);
}

#[test]
fn a_table_of_failures_is_a_failure() {
    let desk = Desk::new();
    desk.write_image(
        "image.fits",
        points(&[
            (20, 20, 1.0),
            (21, 20, 0.4),
            (20, 21, 0.5),
            (19, 20, 0.4),
            (20, 19, 0.5),
        ]),
    );
    desk.write("far.csv", "x,y\n1000,4\n4,1000\n");
    let run = desk.run("measure image.fits --at far.csv -o far_out.csv");
    assert_eq!(run.code, Some(1), "{run:?}");
    assert!(run.stderr.contains("all measurements failed"), "{run:?}");
    assert!(desk.path("far_out.csv").exists());
    desk.write("one.csv", "x,y\n1000,4\n20,20\n");
    desk.done("measure image.fits --at one.csv -o one_out.csv");
}

#[test]
fn positions_may_have_any_columns() {
    let desk = Desk::new();
    desk.write("at.csv", "x,y\n20,25\n30,14\n");
    desk.write("sex.csv", "X_IMAGE,Y_IMAGE\n21,26\n31,15\n");
    let other = "--columns x=X_IMAGE,y=Y_IMAGE --one-based";
    desk.done("measure scene.fits --at at.csv -o a.csv");
    desk.done(&format!("measure scene.fits --at sex.csv -o b.csv {other}"));
    assert!(desk.bytes("a.csv") == desk.bytes("b.csv"));
    desk.done("evaluate samples.fits --at at.csv -o a.fits");
    desk.done(&format!("evaluate samples.fits --at sex.csv -o b.fits {other}"));
    assert_eq!(desk.samples("a.fits"), desk.samples("b.fits"));
    desk.done(&format!(
        "convert samples.fits --to psf-samples --at sex.csv -o c.fits {other}"
    ));
    let positions = |name: &str| desk.samples(name).positions().as_slice().to_vec();
    assert_eq!(positions("a.fits"), positions("c.fits"));
    desk.refused(
        "measure samples.fits -o c.csv --one-based",
        2,
        &["--one-based", "--at"],
    );
    desk.refused(
        "convert samples.fits --to psf-samples -o d.fits --one-based",
        2,
        &["--one-based", "--at"],
    );
}
