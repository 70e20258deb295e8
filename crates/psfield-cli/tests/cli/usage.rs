//! Bad usage: exit status 2, a message that names the option, and nothing written. Also options
//! that do not suit the data.

use crate::desk::{Desk, samples_at};

#[test]
fn unknown_words() {
    let desk = Desk::new();
    desk.refused("", 2, &["Usage: psfield"]);
    desk.refused("fitt samples.fits", 2, &["fitt"]);
    desk.refused(
        "fit samples.fits -o out.fits --fast",
        2,
        &["--fast", "Usage: psfield fit"],
    );
    desk.refused("fit samples.fits", 2, &["--output"]);
    desk.refused("fit -o out.fits", 2, &["SAMPLES.fits"]);
    desk.refused("compare scene.fits", 2, &["REFERENCE.fits"]);
}

#[test]
fn values_that_options_do_not_take() {
    let desk = Desk::new();
    desk.write("at.csv", "x,y\n3,4\n");
    for (option, needles) in [
        ("--rank some", ["--rank", "elbow"]),
        ("--rank energy=2", ["--rank", "0 < F <= 1"]),
        ("--centring median", ["--centring", "mean or none"]),
        ("--interpolation cubic", ["--interpolation", "natural-neighbour"]),
        ("--outside zero", ["--outside", "extend"]),
        ("--normalise max", ["--normalise", "keep"]),
        ("--threads 0", ["--threads", "0"]),
    ] {
        for command in [
            "fit samples.fits",
            "simulate scene.fits --psf samples.fits",
            "evaluate samples.fits --at at.csv",
        ] {
            desk.refused(&format!("{command} -o out.fits {option}"), 2, &needles);
        }
    }
    for (option, needles) in [
        ("--method lowest", ["--method", "patch=N"]),
        ("--method patch=0", ["--method", "patch=N"]),
        ("--anchor middle", ["--anchor", "source"]),
        ("--precision f16", ["--precision", "f32"]),
        ("--frame 1,2,3", ["--frame", "four whole numbers"]),
        ("--frame 1,2,0,4", ["--frame", "above 0"]),
        (
            "--frame 40,0,30,30",
            ["--frame", "reaches beyond the scene of 61 x 51"],
        ),
        (
            "--frame -1,0,30,30",
            ["--frame", "reaches beyond the scene of 61 x 51"],
        ),
        ("--stamp-size 0", ["--stamp-size", "1 to"]),
        ("--stamp-size 1000000000", ["--stamp-size", "1 to"]),
        ("--spot-check 100000000000", ["--spot-check", "100000000000"]),
        ("--shape 61,51", ["--shape", "SCENE.fits"]),
    ] {
        desk.refused(
            &format!("simulate scene.fits --psf samples.fits -o out.fits {option}"),
            2,
            &needles,
        );
    }
    for (option, needles) in [
        ("--sub-pixel", ["--sub-pixel", "--pixels native"]),
        ("--pixels fine", ["--pixels", "native"]),
        ("--size 0", ["--size", "1 to"]),
    ] {
        desk.refused(
            &format!("evaluate samples.fits --at at.csv -o out.fits {option}"),
            2,
            &needles,
        );
    }
}

#[test]
fn scenes_that_are_not_there() {
    let desk = Desk::new();
    desk.write("stars.csv", "x,y,flux\n3,4,5\n");
    let to = "simulate --psf samples.fits -o out.fits";
    desk.refused(
        to,
        2,
        &["nothing to convolve", "--catalog", "Usage: psfield simulate"],
    );
    desk.refused(
        &format!("{to} --shape 61,51"),
        2,
        &["nothing to convolve", "--catalog"],
    );
    desk.refused(
        &format!("{to} --catalog stars.csv --shape 61,0"),
        2,
        &["--shape", "above 0"],
    );
    desk.refused(
        &format!("{to} --catalog stars.csv --shape 62,51"),
        1,
        &["62 x 51", "61 x 51", "--frame"],
    );
}

#[test]
fn fit_options_are_for_samples() {
    let desk = Desk::new();
    desk.done("fit samples.fits -o model.fits");
    desk.write("at.csv", "x,y\n3,4\n");
    for option in ["--rank 2", "--centring none", "--interpolation auto"] {
        for command in [
            "simulate scene.fits --psf model.fits",
            "evaluate model.fits --at at.csv",
        ] {
            desk.refused(
                &format!("{command} -o out.fits {option}"),
                2,
                &["model.fits", "not fitted"],
            );
        }
    }
    // Options that apply to a model too. (0, 0) lies within the field, where the policies agree.
    for option in ["--outside extend", "--normalise keep"] {
        desk.done(&format!(
            "simulate scene.fits --psf model.fits -o {}.fits {option}",
            &option[2..9]
        ));
    }
    desk.refused(
        "fit model.fits -o out.fits",
        1,
        &["model.fits", "fitted model already"],
    );
}

#[test]
fn options_that_the_data_cannot_serve() {
    let desk = Desk::new();
    desk.refused(
        "fit samples.fits -o out.fits --rank 100",
        1,
        &["samples.fits", "rank 100", "only 8"],
    );
    desk.refused(
        "fit samples.fits -o out.fits --rank 0 --centring none",
        1,
        &["samples.fits", "the rank is 0"],
    );
    let scattered = samples_at(&[(10.0, 10.0), (50.0, 12.0), (30.0, 40.0), (5.0, 33.0)], 1);
    desk.write_samples("scattered.fits", &scattered);
    desk.refused(
        "fit scattered.fits -o out.fits --interpolation bilinear",
        1,
        &["scattered.fits", "regular grid", "natural-neighbour"],
    );
    desk.refused(
        "fit scattered.fits -o out.fits --interpolation polynomial=3",
        1,
        &["scattered.fits"],
    );
    let auto = desk.done("fit scattered.fits -o out.fits --json").json();
    assert_eq!(auto["interpolation"], "natural-neighbour");
}

/// The noise of the samples belongs to the fit: elsewhere it would be taken for the image's.
#[test]
fn the_noise_of_samples_is_an_option_of_fit_alone() {
    let desk = Desk::new();
    desk.refused(
        "simulate scene.fits --psf samples.fits -o out.fits --noise 5",
        2,
        &["--noise"],
    );
    desk.refused(
        "fit samples.fits -o out.fits --sample-noise -1",
        2,
        &["--sample-noise", "0 or above"],
    );
    desk.noted(
        "fit samples.fits -o out.fits --noise 1e-6",
        &["--noise is now called --sample-noise"],
    );
    desk.warned(
        "fit samples.fits -o none.fits --sample-noise 5",
        "keeps no component",
    );
}

#[test]
fn help_and_version() {
    let desk = Desk::empty();
    let version = desk.done("--version").stdout;
    assert_eq!(version.trim(), format!("psfield {}", env!("CARGO_PKG_VERSION")));
    for command in [
        "demo",
        "sample",
        "fit",
        "simulate",
        "batch",
        "evaluate",
        "convert",
        "expose",
        "measure",
        "compare",
        "bench",
        "devices",
        "reproduce",
        "validate",
    ] {
        assert!(desk.done("--help").stdout.contains(&format!("  {command} ")));
        let help = desk.done(&format!("{command} --help")).stdout;
        assert!(help.contains(&format!("Usage: psfield {command}")), "{help}");
        assert!(help.contains("Common options"), "{help}");
    }
}
