//! PSFs that depend on a wavelength or a frame: `fit` of several files, and the choice of a state.

use ndarray::concatenate;
use psfield::psf_io::{self, Card};
use psfield::psf_types::{PsfSamples, SamplePositions, StateKind};
use serde_json::json;

use crate::desk::{Desk, difference, points, samples};

/// Rounding of images in f32, relative to the peak.
const SINGLE: f64 = 1e-6;

/// Samples at two wavelengths: the desk's PSF, and one that is sheared to (x, x).
pub(crate) fn coloured() -> PsfSamples {
    let red = samples(3, 1);
    let mut blue = red.stamps().to_owned();
    blue.swap_axes(1, 2);
    let blue = blue.as_standard_layout().to_owned();
    let stamps = concatenate(ndarray::Axis(0), &[red.stamps(), blue.view()]).unwrap();
    let (at, field) = (red.positions().as_slice(), red.positions().field());
    let positions = SamplePositions::in_every_state(at, field, StateKind::Wavelength, &[0.9, 0.5]);
    PsfSamples::new(stamps, positions.unwrap(), red.grid()).unwrap()
}

#[test]
fn a_wavelength_is_chosen_from_samples_and_from_models() {
    let desk = Desk::new();
    desk.write_samples("colour.fits", &coloured());
    desk.write_image("point.fits", points(&[(20, 20, 1000.0)]));
    let report = desk
        .done("fit colour.fits -o colour_model.fits --rank full --json")
        .json();
    assert_eq!(
        (&report["depends_on"], &report["states"]),
        (&json!("wavelength"), &json!([0.5, 0.9]))
    );
    let text = desk.run("fit colour.fits -o again.fits").stdout;
    assert!(
        text.contains("18 samples at 2 values of the wavelength (0.5 to 0.9)"),
        "{text}"
    );
    let image = |psf: &str, name: &str| {
        desk.done(&format!(
            "simulate point.fits --psf {psf} -o {name} --tolerance 1e-6"
        ));
        desk.image(name)
    };
    let red = image("samples.fits --rank full", "red.fits");
    let chosen = image("colour_model.fits --psf-wavelength 0.9", "chosen.fits");
    assert!(difference(&chosen, &red) < SINGLE * 10.0);
    let direct = image("colour.fits --rank full --psf-wavelength 0.9", "direct.fits");
    assert!(difference(&direct, &red) < SINGLE * 10.0);
    let blue = image("colour_model.fits --psf-wavelength 0.5", "blue.fits");
    assert!(difference(&blue, &red) > 1e-3);
    let between = image("colour_model.fits --psf-wavelength 0.7", "between.fits");
    assert!(difference(&between, &((&red + &blue) / 2.0)) < SINGLE * 10.0);
    for (arguments, code, needles) in [
        (
            "--psf colour_model.fits",
            1,
            &[
                "colour_model.fits",
                "depends on the wavelength",
                "--psf-wavelength",
            ][..],
        ),
        (
            "--psf colour_model.fits --psf-wavelength 1.2",
            2,
            &["colour_model.fits", "0.5 to 0.9 um", "--psf-wavelength"],
        ),
        (
            "--psf colour_model.fits --psf-frame 1",
            2,
            &["colour_model.fits", "wavelength", "--psf-frame"],
        ),
        (
            "--psf samples.fits --psf-wavelength 0.9",
            2,
            &["samples.fits", "position only", "--psf-wavelength"],
        ),
    ] {
        desk.refused(
            &format!("simulate point.fits {arguments} -o no.fits"),
            code,
            needles,
        );
    }
}

/// A folder with a PSF that depends on the wavelength, and a bandpass.
fn desk_with_band() -> Desk {
    let desk = Desk::new();
    desk.write_samples("colour.fits", &coloured());
    desk.done("fit colour.fits -o colour_model.fits --rank full");
    // Photons per wavelength are constant, and the bandpass is symmetric about 0.7 um.
    desk.write(
        "band.csv",
        "wavelength_nm,throughput\n500,0\n600,1\n800,1\n900,0\n",
    );
    desk
}

#[test]
fn each_source_has_the_psf_of_its_spectrum() {
    let desk = desk_with_band();
    desk.write("blue.txt", "0.4 1\n0.55 1\n0.551 0\n1.0 0\n");
    desk.write_image("point.fits", points(&[(20, 20, 1000.0)]));
    desk.write_image("other.fits", points(&[(40, 30, 500.0)]));
    let image = |arguments: &str, name: &str| {
        desk.done(&format!(
            "simulate --psf colour_model.fits -o {name} --tolerance 1e-6 {arguments}"
        ));
        desk.image(name)
    };
    let flat = "--bandpass band.csv --sed powerlaw:-1";
    let mean = image(&format!("point.fits {flat} --spot-check 200"), "mean.fits");
    let at_the_middle = image("point.fits --psf-wavelength 0.7", "middle.fits");
    assert!(difference(&mean, &at_the_middle) < SINGLE * 10.0);

    // Images of two spectra are added, and equal to a catalogue with the spectra.
    let blue = "blue.txt:um:photons";
    let layers = image(
        &format!("point.fits {flat} --layer other.fits:sed={blue} --spot-check 200"),
        "layers.fits",
    );
    let alone = image(
        &format!("other.fits --bandpass band.csv --sed {blue}"),
        "alone.fits",
    );
    assert!(difference(&layers, &(&mean + &alone)) < SINGLE * 10.0);
    assert!(difference(&alone, &image(&format!("other.fits {flat}"), "flat.fits")) > 1e-3);
    desk.write(
        "seds.csv",
        format!("x,y,flux,sed\n20,20,1000,powerlaw:-1\n40,30,500,{blue}\n"),
    );
    let stars = image(
        "--catalog seds.csv --shape 61,51 --bandpass band.csv --spot-check 100",
        "stars.fits",
    );
    assert!(difference(&stars, &layers) < 1e-5);
    desk.write("teff.csv", "x,y,flux,teff\n20,20,1000,3000\n40,30,500,20000\n");
    image(
        "--catalog teff.csv --shape 61,51 --bandpass band.csv --spot-check 100",
        "teff.fits",
    );

    desk.write("plain.csv", "x,y,flux\n20,20,1000\n");
    desk.write("wrong.csv", "x,y,flux,sed\n20,20,1000,sun\n");
    desk.write("far.txt", "2.0 1\n3.0 1\n");
    desk.write("unsorted.csv", "wavelength_nm,t\n600,1\n500,1\n");
    for (arguments, code, needles) in [
        ("point.fits --bandpass band.csv", 2, &["--sed"][..]),
        ("point.fits --sed blackbody:3000", 2, &["--bandpass"]),
        (
            "point.fits --layer other.fits --bandpass band.csv --sed powerlaw:0",
            2,
            &["red.fits:sed="],
        ),
        (
            "point.fits --bandpass blue.txt --sed powerlaw:0",
            1,
            &["blue.txt", "unit of its wavelengths"],
        ),
        (
            "point.fits --bandpass unsorted.csv --sed powerlaw:0",
            1,
            &["unsorted.csv", "must ascend"],
        ),
        (
            "point.fits --bandpass band.csv --sed blackbody:cold",
            1,
            &["blackbody:KELVIN"],
        ),
        (
            "point.fits --bandpass band.csv --sed far.txt:um",
            1,
            &["no light in the bandpass"],
        ),
        (
            "--catalog plain.csv --shape 61,51 --bandpass band.csv",
            1,
            &["plain.csv", "sed", "teff"],
        ),
        (
            "--catalog wrong.csv --shape 61,51 --bandpass band.csv",
            1,
            &["sun"],
        ),
    ] {
        let psf = "--psf colour_model.fits";
        desk.refused(&format!("simulate {psf} {arguments} -o no.fits"), code, needles);
    }
    let plain = "simulate point.fits --psf samples.fits --bandpass band.csv --sed powerlaw:0 -o no.fits";
    desk.refused(plain, 1, &["samples.fits", "does not depend on the wavelength"]);
}

#[test]
fn the_atmosphere_shifts_blue_stars_towards_the_zenith() {
    let desk = Desk::empty();
    let wavelengths = "0.45,0.5,0.55,0.6,0.65,0.7,0.75";
    desk.done(&format!(
        "sample --preset wide-field-lens --uniform 2,2 -o lens.fits --wavelengths {wavelengths}"
    ));
    desk.write(
        "band.csv",
        "wavelength_nm,throughput\n450,0\n500,1\n700,1\n750,0\n",
    );
    let row = |teff: u32| {
        desk.write("star.csv", format!("x,y,flux,teff\n50,40,1000,{teff}\n"));
        let scene =
            "--catalog star.csv --shape 100,80 --psf lens.fits --bandpass band.csv -o star.fits --overwrite";
        let run = desk.run(&format!(
            "simulate {scene} --dispersion zenith=60,scale=0.5,direction=90"
        ));
        assert!(run.stderr.contains("fewer than two pixels"), "{}", run.stderr);
        let image = desk.image("star.fits");
        image.indexed_iter().map(|((y, _), v)| y as f64 * v).sum::<f64>() / image.sum()
    };
    let (red, blue) = (row(3000), row(20_000));
    // Half of the difference of the refractions at 0.5 and 0.65 um is about 0.4 pixels.
    assert!((0.1..1.0).contains(&(blue - red)), "{red} {blue}");
    for (value, part) in [
        ("zenith=60", "scale"),
        ("zenith=95,scale=1", "90"),
        ("zenith=1,scale=1,z=2", "zenith"),
    ] {
        let scene =
            "simulate --catalog star.csv --shape 100,80 --psf lens.fits --bandpass band.csv -o no.fits";
        desk.refused(
            &format!("{scene} --dispersion {value}"),
            2,
            &["--dispersion", part],
        );
    }
}

#[test]
fn a_telescope_is_sampled_at_several_wavelengths() {
    let desk = Desk::empty();
    let sample = "sample --preset survey-2m --uniform 2,2 -o survey.fits";
    desk.done(&format!("{sample} --wavelengths 0.75,0.45"));
    let samples = desk.samples("survey.fits");
    let states = samples.positions().states().unwrap();
    assert_eq!((samples.len(), states.kind()), (8, StateKind::Wavelength));
    assert_eq!(states.values(), [0.45, 0.75]);
    assert_eq!(states.index_of_sample(0), 1);
    // In this corner the aberrations are fewer waves in the red, so that the PSF is sharper.
    let peak = |sample: usize| samples.stamp(sample).iter().fold(0.0_f64, |m, v| m.max(*v));
    assert!(peak(0) > 1.2 * peak(4), "{} {}", peak(0), peak(4));
    desk.refused(
        &format!("{sample} --overwrite --wavelengths 0.5"),
        2,
        &["two or more wavelengths"],
    );
    desk.refused(
        &format!("{sample} --overwrite --wavelengths 0.5,-1"),
        2,
        &["--wavelengths"],
    );
    desk.write_image("frame.fits", points(&[(20, 20, 1000.0)]));
    desk.refused(
        "sample frame.fits -o no.fits --wavelengths 0.5,0.6",
        2,
        &["--wavelengths", "frame"],
    );
}

#[test]
fn files_of_several_frames_get_one_basis() {
    let desk = Desk::new();
    let turned = coloured();
    let plane = turned.len() / 2;
    let positions = samples(3, 1).positions().clone();
    let stamps = turned
        .stamps()
        .slice_move(ndarray::s![plane.., .., ..])
        .to_owned();
    desk.write_samples(
        "second.fits",
        &PsfSamples::new(stamps, positions, turned.grid()).unwrap(),
    );
    desk.write_image("point.fits", points(&[(20, 20, 1000.0)]));
    let report = desk
        .done("fit samples.fits second.fits -o frames.fits --rank full --json")
        .json();
    assert_eq!(
        (&report["depends_on"], &report["states"]),
        (&json!("frame"), &json!([0.0, 1.0]))
    );
    let image = |psf: &str, name: &str| {
        desk.done(&format!(
            "simulate point.fits --psf {psf} -o {name} --tolerance 1e-6"
        ));
        desk.image(name)
    };
    let own = image("second.fits --rank full", "own.fits");
    assert!(difference(&image("frames.fits --psf-frame 1", "one.fits"), &own) < SINGLE * 10.0);

    // A given basis finds the same coefficients for a single file.
    let report = desk
        .done("fit second.fits -o in_basis.fits --basis frames.fits --json")
        .json();
    assert!(report["max_error"].as_f64().unwrap() < 1e-6);
    assert_eq!(report["singular_values"], json!([]));
    assert!(difference(&image("in_basis.fits", "two.fits"), &own) < SINGLE * 10.0);

    // Shifted copies need more components.
    let rank = |options: &str| {
        let fitted =
            format!("fit samples.fits -o shifted.fits --rank error=1e-4 --overwrite --json {options}");
        desk.done(&fitted).json()["rank"].as_u64().unwrap()
    };
    assert!(rank("--shift-augment 4") > rank(""));

    for (arguments, code, needles) in [
        (
            "samples.fits frames.fits",
            1,
            &["frames.fits", "fitted model already"][..],
        ),
        (
            "samples.fits colour.fits",
            1,
            &["colour.fits", "another quantity"],
        ),
        (
            "second.fits --basis frames.fits --rank 3",
            2,
            &["--basis", "--rank"],
        ),
        (
            "fine.fits --basis frames.fits",
            1,
            &["fine.fits", "oversampling 2", "oversampling 1"],
        ),
    ] {
        desk.write_samples("colour.fits", &turned);
        desk.write_samples("fine.fits", &samples(3, 2));
        desk.refused(&format!("fit {arguments} -o no.fits"), code, needles);
    }
}

#[test]
fn images_of_several_spectra_are_streamed() {
    let desk = Desk::new();
    desk.write_samples("colour.fits", &coloured());
    desk.write("band.csv", "wavelength_um,throughput\n0.5,0\n0.6,1\n0.9,0\n");
    desk.write_image("red.fits", points(&[(20, 20, 1000.0), (40, 30, 70.0)]));
    desk.write_image("blue.fits", points(&[(30, 25, 500.0)]));
    desk.write("stars.csv", "x,y,flux,teff\n10,12,300,4000\n");
    let to = "simulate red.fits --sed blackbody:3000 --layer blue.fits:sed=blackbody:15000 --catalog stars.csv \
              --psf colour.fits --bandpass band.csv --spot-check 30 -q";
    desk.done(&format!("{to} -o whole.fits"));
    let report = desk
        .done(&format!("{to} -o streamed.fits --stream --json"))
        .json();
    assert_eq!(report["streamed"], json!(true));
    assert_eq!(report["spot_check"]["passed"], json!(true));
    assert_eq!(desk.image("whole.fits"), desk.image("streamed.fits"));
    let twice = to.replace("blackbody:15000", "blackbody:3000");
    let run = desk.run(&format!("{twice} -o twice.fits --stream"));
    assert!(
        run.code == Some(1) && run.stderr.contains("add them up"),
        "{run:?}"
    );
}

/// A batch keeps the plans of spectra, and a series gives each source the PSF of its spectrum.
#[test]
fn jobs_and_exposures_may_be_in_colour() {
    let desk = desk_with_band();
    desk.write("teff.csv", "x,y,flux,teff\n20,20,1000,3000\n40,30,500,20000\n");
    desk.write("swapped.csv", "x,y,flux,teff\n20,20,1000,20000\n40,30,500,3000\n");
    let alone = |catalog: &str, name: &str| {
        desk.done(&format!(
            "simulate --catalog {catalog} --shape 61,51 --psf colour_model.fits --bandpass band.csv -o {name}"
        ));
        desk.image(name)
    };
    let (first, swapped) = (alone("teff.csv", "a.fits"), alone("swapped.csv", "b.fits"));
    assert!(difference(&first, &swapped) > 1e-3);
    desk.write(
        "jobs.csv",
        "catalog,output\nteff.csv,c.fits\nswapped.csv,d.fits\n",
    );
    let run =
        desk.done("batch jobs.csv --set psf=colour_model.fits --set shape=61,51 --set bandpass=band.csv");
    let reused: Vec<bool> = run
        .stdout
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["reused"] == true)
        .collect();
    assert_eq!(reused, [false, true]);
    assert!(difference(&desk.image("c.fits"), &first) == 0.0);
    assert!(difference(&desk.image("d.fits"), &swapped) < SINGLE);

    desk.write(
        "series.toml",
        "start = \"2026-12-31T23:59:00\"\nexposure_s = 1.0\ncount = 2\n[simulate]\npsf = \"colour_model.fits\"\n\
         catalog = \"teff.csv\"\nshape = [61, 51]\nbandpass = \"band.csv\"\nspot-check = 50\n",
    );
    desk.done("series series.toml --out frames");
    assert!(difference(&desk.image("frames/frame_0001.fits"), &first) < SINGLE);
    // Without a bandpass, a PSF of several wavelengths has no spectrum.
    let plain = std::fs::read_to_string(desk.path("series.toml")).unwrap();
    desk.write("plain.toml", plain.replace("bandpass = \"band.csv\"\n", ""));
    desk.refused("series plain.toml --out plain", 1, &["give a bandpass"]);
}

#[test]
fn the_planes_of_a_cube_have_spectra() {
    let desk = Desk::new();
    desk.write_samples("colour.fits", &coloured());
    desk.write("band.csv", "wavelength_um,throughput\n0.5,0\n0.6,1\n0.9,0\n");
    let (red, blue) = (points(&[(20, 20, 1000.0)]), points(&[(30, 25, 500.0)]));
    desk.write_image("red.fits", red.clone());
    desk.write_image("blue.fits", blue.clone());
    let cube = ndarray::stack(ndarray::Axis(0), &[red.view(), blue.view()]).unwrap();
    let named = |keyword, name| Card::new(keyword, name, "").unwrap();
    let spectra = [named("SED1", "blackbody:3000"), named("SED2", "blackbody:15000")];
    psf_io::write_cube(desk.path("cube.fits"), cube.view(), &spectra, false).unwrap();
    let to = "--psf colour.fits --bandpass band.csv -q";
    let layers = "red.fits --sed blackbody:3000 --layer blue.fits:sed=blackbody:15000";
    desk.done(&format!("simulate {layers} {to} -o layers.fits"));
    desk.done(&format!("simulate cube.fits {to} -o cube_image.fits"));
    assert_eq!(desk.image("layers.fits"), desk.image("cube_image.fits"));
    assert!(desk.header("cube_image.fits").get("SED1").is_none());
    psf_io::write_cube(desk.path("half.fits"), cube.view(), &spectra[..1], false).unwrap();
    let run = desk.run(&format!("simulate half.fits {to} -o no.fits"));
    assert!(run.code == Some(1) && run.stderr.contains("SED2"), "{run:?}");
    let run = desk.run(&format!("simulate cube.fits {to} -o no.fits --stream"));
    assert!(run.code == Some(1) && run.stderr.contains("--layer"), "{run:?}");
}

#[test]
fn the_planes_of_a_psf_cube_have_wavelengths() {
    let desk = Desk::new();
    let all = coloured();
    let planes = all.stamps().select(ndarray::Axis(0), &[0, 9]);
    let one = SamplePositions::in_every_state(
        &all.positions().as_slice()[..1],
        None,
        StateKind::Wavelength,
        &[0.9, 0.5],
    );
    let samples = PsfSamples::new(planes.clone(), one.unwrap(), all.grid()).unwrap();
    desk.write_samples("one.fits", &samples);
    let card = |keyword, value: f64| Card::new(keyword, value, "").unwrap();
    let cards = [
        card("OVERSAMP", all.grid().oversampling()),
        card("WAVELN00", 0.9e-6),
        card("WAVELN01", 0.5e-6),
    ];
    psf_io::write_cube(desk.path("cube.fits"), planes.view(), &cards, false).unwrap();
    desk.write("band.csv", "wavelength_um,throughput\n0.5,0\n0.6,1\n0.9,0\n");
    desk.write_image("point.fits", points(&[(20, 20, 1000.0)]));
    for options in ["--psf-wavelength 0.7", "--bandpass band.csv --sed blackbody:4000"] {
        let image = |psf: &str, name: &str| {
            desk.done(&format!(
                "simulate point.fits --psf {psf} {options} -o {name} --overwrite -q"
            ));
            desk.image(name)
        };
        let from_cube = image("cube.fits", "a.fits");
        let from_samples = image("one.fits --interpolation nearest", "b.fits");
        assert!(difference(&from_cube, &from_samples) < SINGLE, "{options}");
    }
    let run = desk.run("simulate point.fits --psf cube.fits -o no.fits");
    assert!(
        run.code == Some(1) && run.stderr.contains("--psf-wavelength"),
        "{run:?}"
    );
}
