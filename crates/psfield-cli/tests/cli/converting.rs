//! `psfield convert`, and PSF files of every kind as inputs.

use ndarray::{Array2, Array3, Axis};
use psfield::psf_io::{
    self, HeaderCards, PlaneOrder, PsfexAxis, PsfexModel, PsfexPolynomial, read_psfex, read_stpsf,
    write_psfex,
};
use psfield::psf_types::{Image, Position, PsfSamples, StampInterpolation};
use serde_json::json;

use crate::desk::{Desk, NX, NY, STAMP, samples, samples_at};

/// Rounding of stamps in f32, relative to the peak.
const SINGLE: f64 = 1e-6;

fn largest(a: ndarray::ArrayView3<'_, f64>, b: ndarray::ArrayView3<'_, f64>) -> f64 {
    assert_eq!(a.dim(), b.dim());
    let peak = b.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    a.iter().zip(b).fold(0.0f64, |m, (a, b)| m.max((a - b).abs())) / peak
}

/// A model of degree 2 over the field. Its planes do not have unit flux.
fn psfex(size: usize, sampling: f64) -> PsfexModel {
    let axis = |name, n| PsfexAxis::new(name, (n - 1) as f64 / 2.0, (n - 1) as f64).unwrap();
    let polynomial = PsfexPolynomial::new(axis("X_IMAGE", NX), axis("Y_IMAGE", NY), 2).unwrap();
    let planes = Array3::from_shape_fn((6, size, size), |(t, y, x)| {
        let offset = |k: usize| (k as f64 - (size / 2) as f64) * sampling;
        let r2 = offset(x).powi(2) + offset(y).powi(2);
        let sigma = 1.4 + 0.1 * t as f64;
        let amplitude = [0.1, 0.02, 0.01, -0.015, 0.01, 0.02][t];
        f64::from((amplitude * (-0.5 * r2 / (sigma * sigma)).exp()) as f32)
    });
    PsfexModel::new(planes, sampling, Some(polynomial)).unwrap()
}

fn put_psfex(desk: &Desk, name: &str, model: &PsfexModel) {
    write_psfex(desk.path(name), model, &[], false).unwrap();
}

fn put_stamps(desk: &Desk, name: &str, count: usize) {
    let stamps = samples(3, 1).stamps().to_owned();
    let plane = |k: usize| stamps.index_axis(Axis(0), k).to_owned();
    if count == 1 {
        let image = Image::new(plane(4)).unwrap();
        psf_io::write_image(desk.path(name), &image, &HeaderCards::new(), &[], false).unwrap();
        return;
    }
    // A cube without positions: samples whose table is cut off.
    desk.write_samples("with_table.fits", &samples(3, 1));
    let bytes = desk.bytes("with_table.fits");
    let table = bytes.windows(8).position(|w| w == b"XTENSION").unwrap();
    desk.write(name, &bytes[..table]);
}

#[test]
fn samples_become_a_psfex_model_and_come_back() {
    let desk = Desk::new();
    let run = desk.noted(
        "convert samples.fits -o field.psf --to psfex=2 --json",
        &["Lanczos", "field.psf"],
    );
    let report = run.json();
    assert_eq!(report["format"], "psfex");
    assert_eq!(
        (&report["planes"], &report["shape"]),
        (&json!(6), &json!([STAMP, STAMP]))
    );
    assert_eq!(report["notes"].as_array().unwrap().len(), 1);
    let error = report["max_error"].as_f64().unwrap();
    // Six terms for nine samples.
    assert!((1e-6..1e-2).contains(&error), "{error:e}");
    desk.write(
        "at.csv",
        "x,y\n0,0\n30,0\n60,0\n0,25\n30,25\n60,25\n0,50\n30,50\n60,50\n",
    );
    desk.done("convert field.psf -o back.fits --to psf-samples --at at.csv");
    desk.done("convert field.psf -o raw.fits --to psf-samples --at at.csv --normalise keep --precision f64");
    let truth = desk.samples("samples.fits");
    for name in ["back.fits", "raw.fits"] {
        let back = desk.samples(name);
        assert_eq!(back.positions().as_slice(), truth.positions().as_slice());
        assert_eq!(back.grid().interpolation(), StampInterpolation::Lanczos3);
        let difference = largest(back.stamps(), truth.stamps());
        assert!(
            difference > 0.1 * error && difference < 2.0 * error,
            "{difference:e}"
        );
    }
    assert!((desk.samples("back.fits").flux(3) - 1.0).abs() < SINGLE);
    // Exact: a polynomial with enough terms for the samples.
    let text = desk.run("convert samples.fits -o exact.psf --to psfex=0").stdout;
    assert!(
        text.contains("1 polynomial terms") && text.contains("largest error"),
        "{text}"
    );
}

#[test]
fn a_psfex_model_keeps_its_planes() {
    let desk = Desk::empty();
    for (name, size) in [("odd.psf", 15), ("even.psf", 16)] {
        let model = psfex(size, 0.5);
        put_psfex(&desk, name, &model);
        let same = desk.done(&format!("convert {name} -o same_{name} --json")).json();
        assert_eq!(same["max_error"], 0.0);
        assert_eq!(
            read_psfex(desk.path(&format!("same_{name}")), None).unwrap(),
            model
        );
        let report = desk
            .done(&format!(
                "convert {name} -o model_{size}.fits --to psf-model --json"
            ))
            .json();
        assert_eq!(
            (&report["planes"], &report["oversampling"]),
            (&json!(5), &json!(2.0))
        );
        desk.done(&format!("convert model_{size}.fits -o again_{name}"));
        let again = read_psfex(desk.path(&format!("again_{name}")), None).unwrap();
        // Odd, so that every reader finds the centre in the middle.
        assert_eq!(again.grid().dim(), (size / 2 * 2 + 1, size / 2 * 2 + 1));
        let part = again
            .planes()
            .slice_move(ndarray::s![.., ..size, ..size])
            .to_owned();
        assert!(largest(part.view(), model.planes()) <= SINGLE);
        let total: f64 = again.planes().iter().map(|v| v.abs()).sum();
        assert!((total / part.iter().map(|v| v.abs()).sum::<f64>() - 1.0).abs() < 1e-12);
        assert_eq!(again.degree(), 2);
    }
    // One degree more gives equal PSFs and more planes.
    desk.done("convert odd.psf -o cubic.psf --to psfex=3");
    let (cubic, model) = (read_psfex(desk.path("cubic.psf"), None).unwrap(), psfex(15, 0.5));
    assert_eq!(cubic.planes().dim().0, 10);
    let at = Position::new(17.0, 44.0).unwrap();
    let difference = cubic.psf_at(at).unwrap().into_values() - model.psf_at(at).unwrap().values();
    assert!(difference.iter().all(|d| d.abs() < SINGLE * 0.1));
}

#[test]
fn a_psfex_model_serves_every_command() {
    let desk = Desk::new();
    let model = psfex(31, 0.5);
    put_psfex(&desk, "field.psf", &model);
    desk.write("at.csv", "x,y\n3,4\n40.5,20\n-10,70\n");
    let far = "are used at x = -10 to 40 and y = 4 to 70";
    desk.warned(
        "evaluate field.psf --at at.csv -o raw.fits --normalise keep --precision f64",
        far,
    );
    let raw = desk.samples("raw.fits");
    for (j, &p) in raw.positions().as_slice().iter().enumerate() {
        let difference = raw.stamp(j).to_owned() - model.psf_at(p).unwrap().values();
        assert!(difference.iter().all(|d| d.abs() < 1e-13), "{p}");
    }
    desk.warned("evaluate field.psf --at at.csv -o unit.fits", far);
    let unit = desk.samples("unit.fits");
    assert!((0..3).all(|j| (unit.flux(j) - 1.0).abs() < SINGLE) && (raw.flux(0) - 1.0).abs() > 1e-3);
    // By default the polynomial extends outside the field.
    desk.refused(
        "evaluate field.psf --at at.csv -o out.fits --outside error",
        1,
        &["at.csv", "(-10, 70)"],
    );
    desk.done("simulate scene.fits --psf field.psf -o image.fits --method direct");
    let (image, scene) = (desk.image("image.fits"), desk.image("scene.fits"));
    assert!((image.sum() / scene.sum() - 1.0).abs() < 1e-3);
    desk.refused(
        "fit field.psf -o model.fits",
        1,
        &["field.psf", "PSFEx", "convert --to psf-model"],
    );
    desk.refused(
        "evaluate field.psf --at at.csv -o out.fits --rank 3",
        2,
        &["field.psf", "not fitted"],
    );
}

/// A frame with columns and rows exchanged reaches far beyond the polynomial of a PSFEx model.
#[test]
fn frames_beyond_the_polynomial_are_warned_of() {
    let desk = Desk::new();
    put_psfex(&desk, "field.psf", &psfex(31, 0.5));
    desk.write("stars.csv", "x,y,flux\n20,20,1\n");
    desk.done(&format!(
        "simulate --psf field.psf --catalog stars.csv --shape {NX},{NY} -o right.fits"
    ));
    let swapped = |output: &str, more: &str| {
        format!("simulate --psf field.psf --catalog stars.csv --shape {NY},{NX} -o {output} {more}")
    };
    let needles = [
        "field.psf: the polynomials",
        "x = 0 to 60 and y = 0 to 50, but are used at x = 0 to 50 and y = 0 to 60",
        "by 0 % of the range in x and 20 % in y",
        "option --outside",
    ];
    for (i, needle) in needles.into_iter().enumerate() {
        desk.warned(&swapped(&format!("swapped{i}.fits"), ""), needle);
    }
    desk.done(&swapped("nearest.fits", "--outside nearest"));
}

/// Without `--shape`, a scene without an image has the shape of the PSF's field.
#[test]
fn a_psfex_model_states_the_frame() {
    let desk = Desk::new();
    // The stars of the model lie at 0-based x = 4 to 56 and y = 3 to 47.
    let axis = |name, zero, scale| PsfexAxis::new(name, zero, scale).unwrap();
    let (x, y) = (axis("X_IMAGE", 30.0, 52.0), axis("Y_IMAGE", 25.0, -44.0));
    let model = psfex(31, 0.5);
    let polynomial = PsfexPolynomial::new(x, y, 2).unwrap();
    let model = PsfexModel::new(model.planes().to_owned(), 0.5, Some(polynomial)).unwrap();
    put_psfex(&desk, "field.psf", &model);
    desk.write("stars.csv", "x,y,flux\n20,20,1\n");
    desk.noted(
        "simulate --psf field.psf --catalog stars.csv -o image.fits",
        &["61 x 51 pixels", "--shape"],
    );
    assert_eq!(desk.image("image.fits").dim(), (51, 61));
    put_psfex(
        &desk,
        "constant.psf",
        &PsfexModel::new(Array3::ones((1, 9, 9)), 0.5, None).unwrap(),
    );
    desk.refused(
        "simulate --psf constant.psf --catalog stars.csv -o out.fits",
        2,
        &["--shape NX,NY", "does not state a field"],
    );
}

#[test]
fn a_bad_plane_of_a_library_can_be_left_out() {
    /// The PSFs change smoothly, so that two ways to interpolate give similar PSFs.
    const INTERPOLATED: f64 = 0.05;
    let desk = Desk::new();
    let nodes = (0..16).map(|k| (f64::from(k % 4 * 16), f64::from(k / 4 * 16)));
    desk.write_samples("square.fits", &samples_at(&nodes.collect::<Vec<_>>(), 1));
    desk.done("convert square.fits -o library.fits --to gridded");
    let planes = psf_io::read_cube::<f64>(desk.path("library.fits")).unwrap();
    let plane = planes.len() / planes.dim().0 * 8;
    let mut bytes = desk.bytes("library.fits");
    let card = bytes
        .chunks(80)
        .position(|card| card.starts_with(b"END "))
        .unwrap();
    let data = ((card + 1) * 80).next_multiple_of(2880);
    // Plane 5 is one of the four inner nodes.
    bytes[data + 5 * plane..data + 6 * plane].fill(0);
    desk.write("bad.fits", &bytes);
    desk.write("at.csv", "x,y\n20,17\n10,30\n");
    let evaluate = |file: &str, options: &str, output: &str| {
        format!("evaluate {file} --at at.csv -o {output} --precision f64 {options}")
    };
    desk.refused(
        &evaluate("bad.fits", "", "out.fits"),
        1,
        &[
            "bad.fits",
            "plane 5 (0-based) at (16, 16)",
            "has flux 0",
            "option --psf-skip-invalid",
        ],
    );
    desk.noted(
        &evaluate("bad.fits", "--psf-skip-invalid", "skipped.fits"),
        &[
            "1 of 16 left out",
            "plane 5 (0-based) at (16, 16)",
            "natural-neighbour",
        ],
    );
    desk.run(&evaluate("library.fits", "", "whole.fits"));
    let (skipped, whole) = (desk.samples("skipped.fits"), desk.samples("whole.fits"));
    assert!(largest(skipped.stamps(), whole.stamps()) < INTERPOLATED);
    desk.refused(
        &evaluate("samples.fits", "--psf-skip-invalid", "out.fits"),
        2,
        &["samples.fits", "STPSF and STDPSF libraries", "--psf-skip-invalid"],
    );
}

#[test]
fn one_of_several_psfex_models_is_chosen() {
    let desk = Desk::empty();
    put_psfex(&desk, "a.psf", &psfex(9, 0.5));
    put_psfex(&desk, "b.psf", &psfex(11, 1.0));
    let second = desk.bytes("b.psf");
    let table = second.windows(8).position(|w| w == b"XTENSION").unwrap();
    let both = [desk.bytes("a.psf"), second[table..].to_vec()].concat();
    desk.write("both.psf", both);
    desk.refused(
        "convert both.psf -o out.fits --to psf-model",
        1,
        &["both.psf", "--psf-extension", "1 \"PSF_DATA\"", "2 \"PSF_DATA\""],
    );
    desk.refused(
        "convert both.psf -o out.fits --to psf-model --psf-extension 3",
        1,
        &["both.psf", "HDU 3", "2 \"PSF_DATA\""],
    );
    for (extension, size) in [(1, 9), (2, 11)] {
        let report = desk
            .done(&format!(
                "convert both.psf -o out{extension}.psf --psf-extension {extension} --json"
            ))
            .json();
        assert_eq!(report["shape"], json!([size, size]));
    }
}

#[test]
fn samples_become_a_library_and_come_back() {
    let desk = Desk::empty();
    desk.write_samples("samples.fits", &samples(3, 4));
    let needles = ["25 planes for 9 samples", "exchange x and y"];
    let arguments = "convert samples.fits -o library.fits --to gridded --json";
    let report = desk.noted(arguments, &needles).json();
    assert_eq!(report["oversampling"], 4.0);
    assert_eq!(report["planes"], 25);
    // 60 = 4 x 15 pixels, centred at pixel 30, get one more pixel along each axis.
    assert_eq!(report["shape"], json!([61, 61]));
    let library = read_stpsf(desk.path("library.fits"), PlaneOrder::Auto).unwrap();
    assert_eq!(
        library.samples().positions().as_slice(),
        desk.samples("samples.fits").positions().as_slice()
    );
    desk.write("at.csv", "x,y\n0,0\n30,25\n60,50\n");
    // The note says how the planes were ordered.
    desk.noted(
        "evaluate library.fits --at at.csv -o back.fits",
        &["library.fits"],
    );
    let (back, truth) = (desk.samples("back.fits"), desk.samples("samples.fits"));
    for (plane, sample) in [(0, 0), (1, 4), (2, 8)] {
        let found = back.stamp(plane).slice_move(ndarray::s![..60, ..60]).to_owned();
        let difference = largest(
            found.insert_axis(Axis(0)).view(),
            truth.stamp(sample).insert_axis(Axis(0)),
        );
        assert!(difference < SINGLE, "{difference:e}");
    }
    // Fractional sampling is resampled, a polynomial is evaluated on a grid.
    put_psfex(&desk, "field.psf", &psfex(31, 0.45));
    let run = desk.noted(
        "convert field.psf -o resampled.fits --to gridded --grid 5,5 --json",
        &["resampled from 2.2"],
    );
    assert_eq!(run.json()["oversampling"], 3.0);
    let error = run.json()["max_error"].as_f64().unwrap();
    assert!((1e-6..0.1).contains(&error), "{error:e}");
    desk.noted("convert field.psf -o auto.fits --to gridded", &["11 x 11"]);
}

#[test]
fn a_polynomial_survives_a_library_of_a_field_that_is_not_square() {
    let desk = Desk::empty();
    put_psfex(&desk, "field.psf", &psfex(31, 0.5));
    desk.noted(
        "convert field.psf -o library.fits --to gridded --grid 5,5 --normalise keep",
        &["planes for 25 samples"],
    );
    let arguments = "convert library.fits -o back.psf --to psfex=2 --json";
    let back = desk.noted(arguments, &["only 25 of"]).json();
    let error = back["max_error"].as_f64().unwrap();
    assert!(error < SINGLE, "{error:e}");
}

#[test]
fn plain_stamps_need_a_word() {
    let desk = Desk::new();
    put_stamps(&desk, "stamp.fits", 1);
    put_stamps(&desk, "cube.fits", 9);
    desk.write("at.csv", "x,y\n3,4\n40,20\n");
    desk.refused(
        "evaluate stamp.fits --at at.csv -o out.fits",
        1,
        &["stamp.fits", "POSITIONS", "--psf-oversampling"],
    );
    desk.noted(
        "evaluate stamp.fits --at at.csv -o constant.fits --psf-oversampling 1",
        &["stamp.fits", "whole field"],
    );
    let constant = desk.samples("constant.fits");
    assert_eq!(constant.stamp(0), constant.stamp(1));
    // A file written by psfield holds its oversampling.
    desk.refused(
        "evaluate cube.fits --at at.csv -o out.fits",
        1,
        &["cube.fits", "--psf-positions"],
    );
    desk.write(
        "nodes.csv",
        "x,y\n0,0\n30,0\n60,0\n0,25\n30,25\n60,25\n0,50\n30,50\n60,50\n",
    );
    desk.done("convert cube.fits -o same.fits --to psf-samples --psf-positions nodes.csv");
    let (same, truth): (PsfSamples, PsfSamples) = (desk.samples("same.fits"), desk.samples("samples.fits"));
    assert_eq!(same.positions().as_slice(), truth.positions().as_slice());
    assert!(largest(same.stamps(), truth.stamps()) < SINGLE);
    desk.write("few.csv", "x,y\n0,0\n30,0\n");
    desk.refused(
        "convert cube.fits -o out.fits --to psf-samples --psf-positions few.csv",
        1,
        &["cube.fits", "positions", "9", "2"],
    );
}

#[test]
fn even_stamps_tell_their_centre() {
    let desk = Desk::new();
    desk.write("at.csv", "x,y\n3,4\n");
    desk.write_image("even.fits", Array2::from_elem((16, 14), 1.0));
    desk.noted(
        "evaluate even.fits --at at.csv -o middle.fits --psf-oversampling 1",
        &["14 x 16", "(7, 8)", "--psf-centre"],
    );
    let run = desk.noted(
        "evaluate even.fits --at at.csv -o between.fits --psf-oversampling 1 --psf-centre 6.5,7.5",
        &["whole field"],
    );
    assert!(!run.stderr.contains("--psf-centre"), "{run:?}");
    let centre = |name: &str| {
        let grid = desk.samples(name).grid();
        (grid.centre_x(), grid.centre_y())
    };
    assert_eq!(
        (centre("middle.fits"), centre("between.fits")),
        ((7.0, 8.0), (6.5, 7.5))
    );
    desk.refused(
        "evaluate even.fits --at at.csv -o out.fits --psf-oversampling 1 --psf-centre 99,7",
        1,
        &["even.fits", "centre"],
    );
}

#[test]
fn of_several_images_one_must_be_chosen() {
    let desk = Desk::new();
    desk.write("at.csv", "x,y\n3,4\n");
    // A file of WebbPSF for one position: one PSF at several samplings.
    put_stamps(&desk, "first.fits", 1);
    desk.write_image("second.fits", Array2::from_elem((9, 9), 1.0));
    let mut bytes = desk.bytes("second.fits");
    bytes[..80].copy_from_slice(format!("{:<80}", "XTENSION= 'IMAGE   '").as_bytes());
    desk.write("both.fits", [desk.bytes("first.fits"), bytes].concat());
    desk.refused(
        "evaluate both.fits --at at.csv -o out.fits --psf-oversampling 1",
        1,
        &["both.fits", "2 images", "--psf-extension"],
    );
    for (extension, side) in [(0, STAMP), (1, 9)] {
        desk.noted(
            &format!("evaluate both.fits --at at.csv -o {extension}.fits --psf-oversampling 1 --psf-extension {extension}"),
            &["whole field"],
        );
        assert_eq!(desk.samples(&format!("{extension}.fits")).grid().nx(), side);
    }
}

#[test]
fn options_of_other_formats_are_bad_usage() {
    let desk = Desk::new();
    put_psfex(&desk, "field.psf", &psfex(9, 1.0));
    desk.write("at.csv", "x,y\n3,4\n");
    for (file, option) in [
        ("samples.fits", "--psf-extension 1"),
        ("samples.fits", "--psf-detector 2"),
        ("samples.fits", "--psf-oversampling 2"),
        ("samples.fits", "--psf-centre 7,7"),
        ("samples.fits", "--psf-positions at.csv"),
        ("field.psf", "--psf-order cards"),
        ("field.psf", "--psf-wavelength 2.2"),
        ("field.psf", "--pixel-scale 0.004"),
        ("field.psf", "--field-centre 10,-3"),
    ] {
        let name = option.split(' ').next().unwrap();
        desk.refused(
            &format!("evaluate {file} --at at.csv -o out.fits {option}"),
            2,
            &[file, name],
        );
    }
    for option in [
        "--psf-detector 0",
        "--psf-order backwards",
        "--field-centre 3",
        "--psf-centre 3",
        "--pixel-scale -1",
        "--pixel-response perhaps",
        "--psf-extension ,2",
    ] {
        let name = option.split(' ').next().unwrap();
        desk.refused(
            &format!("evaluate field.psf --at at.csv -o out.fits {option}"),
            2,
            &[name],
        );
    }
}

#[test]
fn conversions_that_cannot_be() {
    let desk = Desk::new();
    put_psfex(&desk, "field.psf", &psfex(9, 1.0));
    desk.done("fit samples.fits -o model.fits");
    desk.write("at.csv", "x,y\n3,4\n5,6\n");
    for (arguments, code, needles) in [
        ("samples.fits -o out.fits", 2, &["--to"][..]),
        (
            "samples.fits -o out.psf",
            1,
            &["samples.fits", "--to psfex=DEGREE"],
        ),
        ("samples.fits -o out.psf --to psfex=11", 2, &["0 to 10"]),
        ("samples.fits -o out.psf --to psfex=-1", 2, &["0 to 10"]),
        (
            "samples.fits -o out.psf --to psfex=3",
            1,
            &["10 terms", "9 in all"],
        ),
        ("samples.fits -o out.fits --to fits", 2, &["psf-samples"]),
        (
            "samples.fits -o out.psf --to psfex=1 --pixel-response missing",
            1,
            &["samples.fits", "pixel response"],
        ),
        (
            "samples.fits -o out.psf --to psfex=1 --rank 3",
            2,
            &["--normalise"],
        ),
        (
            "samples.fits -o out.fits --to psf-samples --rank 3",
            2,
            &["--normalise"],
        ),
        ("field.psf -o out.psf --normalise keep", 2, &["--normalise"]),
        ("field.psf -o out.psf --outside nearest", 2, &["--outside"]),
        ("field.psf -o out.fits --to psf-model --grid 3,3", 2, &["--grid"]),
        ("field.psf -o out.psf --at at.csv", 2, &["--at"]),
        (
            "field.psf -o out.fits --to psf-model --precision f32",
            2,
            &["--precision"],
        ),
        (
            "field.psf -o out.fits --to psf-samples --grid 3,3 --at at.csv",
            2,
            &["--grid", "--at"],
        ),
        (
            "field.psf -o out.fits --to psf-samples --grid 3,0",
            2,
            &["--grid"],
        ),
        (
            "model.fits -o out.fits --to psf-samples --grid 100000,100000",
            2,
            &["65536"],
        ),
        (
            "scene.fits -o out.fits --to psf-model",
            1,
            &["scene.fits", "POSITIONS"],
        ),
        ("none.psf -o out.psf", 1, &["none.psf"]),
    ] {
        desk.refused(&format!("convert {arguments}"), code, needles);
    }
    for command in [
        "fit samples.fits -o samples.fits --overwrite",
        "evaluate model.fits --at at.csv -o model.fits --overwrite",
        "evaluate model.fits --at at.csv -o at.csv --overwrite",
    ] {
        desk.refused(command, 2, &["another name"]);
    }
    // At other positions the samples are fitted.
    desk.noted(
        "convert samples.fits -o elsewhere.fits --to gridded --rank 3 --grid 3,3",
        &["25 planes for 9 samples"],
    );
    // A single stamp without a field has no grid.
    put_stamps(&desk, "stamp.fits", 1);
    desk.refused(
        "convert stamp.fits -o out.fits --to gridded --psf-oversampling 1",
        1,
        &["area"],
    );
    desk.write_image("dark.fits", Array2::zeros((5, 5)));
    desk.refused(
        "convert dark.fits -o out.fits --to psf-model --psf-oversampling 1",
        1,
        &["dark.fits", "flux"],
    );
}

#[test]
fn any_model_becomes_a_model_file() {
    let desk = Desk::new();
    let report = desk
        .done("convert samples.fits -o model.fits --to psf-model --rank 4 --json")
        .json();
    desk.done("fit samples.fits -o fitted.fits --rank 4");
    let [model, fitted] =
        ["model.fits", "fitted.fits"].map(|name| psf_io::read_model(desk.path(name)).unwrap());
    assert_eq!(model, fitted);
    assert_eq!(report["planes"], 4);
    assert!(report["max_error"].as_f64().unwrap() > 0.0);
    desk.done("convert model.fits -o nodes.fits --to psf-samples");
    assert_eq!(desk.samples("nodes.fits").len(), 9);
    desk.done("convert model.fits -o grid.fits --to psf-samples --grid 4,2");
    let grid = desk.samples("grid.fits");
    let position = |k: usize| grid.positions().as_slice()[k];
    assert_eq!(grid.len(), 8);
    assert_eq!(
        (position(0), position(1), position(7)),
        (
            Position::of_pixel(0, 0),
            Position::of_pixel(20, 0),
            Position::of_pixel(60, 50)
        )
    );
}

#[test]
fn no_conversion_replaces_its_input() {
    let desk = Desk::new();
    put_psfex(&desk, "field.psf", &psfex(9, 1.0));
    desk.write("at.csv", "x,y\n3,4\n5,6\n");
    for (arguments, file) in [
        ("field.psf -o field.psf", "field.psf"),
        ("field.psf -o ./field.psf --overwrite", "field.psf"),
        (
            "field.psf -o at.csv --to psf-samples --at at.csv --overwrite",
            "at.csv",
        ),
    ] {
        desk.refused(&format!("convert {arguments}"), 2, &[file, "another name"]);
    }
}

#[test]
fn libraries_that_cannot_be() {
    let desk = Desk::new();
    desk.write("at.csv", "x,y\n3,4\n5,6\n");
    for (arguments, code, needles) in [
        (
            "samples.fits -o out.fits --to gridded --pixel-response missing",
            1,
            &["response"][..],
        ),
        (
            "samples.fits -o out.fits --to gridded --rank 3",
            2,
            &["--normalise", "--grid"],
        ),
        (
            "samples.fits -o out.fits --to gridded --outside error",
            2,
            &["--normalise", "--grid"],
        ),
        (
            "samples.fits -o out.fits --to gridded --at at.csv",
            1,
            &["regular grid", "--grid"],
        ),
    ] {
        desk.refused(&format!("convert {arguments}"), code, needles);
    }
}
