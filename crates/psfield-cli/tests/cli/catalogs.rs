//! `psfield simulate`: catalogues, finer scenes, extensions, a detector.

use ndarray::{Array2, s};
use psfield::psf_io::{self, Card, CardValue, HeaderCards};
use psfield::psf_types::Image;

use crate::desk::{Desk, NX, NY, difference, points, samples};

/// Rounding of f64.
const DOUBLE: f64 = 1e-11;
/// Two images that differ by more than this are not equal.
const VISIBLE: f64 = 1e-3;

const SHAPE: &str = "--shape 61,51";

/// Stars drawn with samples that are fine enough to place them between pixels.
fn desk() -> Desk {
    let desk = Desk::new();
    desk.write_samples("fine.fits", &samples(3, 3));
    desk.write("stars.csv", "x,y,flux\n30.25,25.5,100\n10,12,50\n-3,20.5,70\n");
    desk
}

fn stars(desk: &Desk, options: &str, name: &str) -> Array2<f64> {
    let run = format!("simulate --psf fine.fits {SHAPE} --precision f64 --tolerance 0 {options} -o {name}");
    desk.done(&run);
    desk.image(name)
}

/// Writes a dark frame whose world coordinates refer to right ascension 150 at its middle. `cards` add the others.
fn write_frame_on_sky(desk: &Desk, name: &str, cards: &[(&str, CardValue)]) {
    let all = [
        ("CTYPE1", CardValue::from("RA---TAN")),
        ("CTYPE2", "DEC--TAN".into()),
        ("CRPIX1", 31.0.into()),
        ("CRPIX2", 26.0.into()),
        ("CRVAL1", 150.0.into()),
    ];
    let card = |(keyword, value): &(&str, CardValue)| Card::new(keyword, value.clone(), "").unwrap();
    let cards: Vec<Card> = all.iter().chain(cards).map(card).collect();
    let image = Image::new(Array2::<f64>::zeros((NY, NX))).unwrap();
    psf_io::write_image(desk.path(name), &image, &HeaderCards::new(), &cards, false).unwrap();
}

#[test]
fn columns_origins_and_magnitudes() {
    let desk = desk();
    let expected = stars(&desk, "--catalog stars.csv", "expected.fits");
    assert!(
        expected.slice(s![.., ..3]).sum() > 1.0,
        "the star off the frame shines in"
    );
    desk.write(
        "sextractor.cat",
        "#   1 X_IMAGE  [pixel]\n#   2 Y_IMAGE  [pixel]\n#   3 MAG_AUTO  [mag]\n 31.25 26.5 20.0\n 11 13 20.752574989159953\n -2 21.5 20.38725\n",
    );
    let mapped = stars(
        &desk,
        "--catalog sextractor.cat --columns x=X_IMAGE,y=Y_IMAGE,mag=MAG_AUTO --one-based --zero-point 25",
        "mapped.fits",
    );
    // The last magnitude has five decimals.
    assert!(difference(&mapped, &expected) < 1e-5);
    let shifted = stars(
        &desk,
        "--catalog sextractor.cat --columns x=X_IMAGE,y=Y_IMAGE,mag=MAG_AUTO --zero-point 25",
        "shifted.fits",
    );
    assert!(difference(&shifted, &expected) > VISIBLE);
}

#[test]
fn catalogues_that_do_not_suit() {
    let desk = desk();
    desk.write("mags.csv", "x,y,mag\n1,2,20\n");
    desk.write("bad.csv", "x,y,flux\n1,2,3\n4,,5\n");
    desk.write("sky.csv", "ra,dec,flux\n10,20,3\n");
    desk.write("lacks.csv", "x,y,flux,re,n\n1,2,3,4,\n");
    desk.write("galaxy.csv", "x,y,flux,re,n\n1,2,3,4,9\n");
    let simulate = |options: &str| format!("simulate --psf fine.fits {SHAPE} -o x.fits {options}");
    for (options, needles) in [
        ("--catalog mags.csv", &["mags.csv", "--zero-point"][..]),
        ("--catalog bad.csv", &["bad.csv", "line 3, column \"y\""]),
        ("--catalog sky.csv", &["sky.csv", "sky coordinates"]),
        ("--catalog galaxy.csv", &["galaxy.csv", "line 2", "index"]),
        ("--catalog stars.csv --columns x=XX,y=y", &["stars.csv", "XX"]),
        (
            "--catalog stars.csv --zero-point 25",
            &["stars.csv", "flux", "--zero-point"],
        ),
        ("--catalog lacks.csv", &["lacks.csv", "line 2", "index"]),
    ] {
        desk.refused(&simulate(options), 1, needles);
    }
    for (options, needles) in [
        ("--catalog stars.csv --columns x=1", &["--columns"][..]),
        ("--catalog stars.csv --oversampling 0", &["--oversampling"]),
        ("--catalog stars.csv --truth t.fits", &["--detector"]),
        ("--catalog stars.csv --extension 1", &["SCENE"]),
    ] {
        desk.refused(&simulate(options), 2, needles);
    }
    desk.refused(
        "simulate scene.fits --psf fine.fits -o x.fits --one-based",
        2,
        &["--one-based", "catalogue"],
    );
    let report = desk
        .done(&simulate("--catalog bad.csv --skip-invalid --json"))
        .json();
    assert_eq!(
        (report["sources"].as_u64(), report["invalid_rows"].as_u64()),
        (Some(1), Some(1))
    );
}

/// Galaxies are the same without a scene, on a scene, streamed, and on a scene of finer pixels.
#[test]
fn galaxies_are_convolved() {
    let desk = desk();
    desk.write(
        "galaxies.csv",
        "x,y,flux,re,n,q,angle\n30.5,25,100,2.5,1,0.6,30\n10,12,50,0,0,,\n",
    );
    let report = desk
        .done(&format!(
            "simulate --psf fine.fits {SHAPE} --catalog galaxies.csv -o g.fits --precision f64 -q --json"
        ))
        .json();
    assert_eq!(
        (report["sources"].as_u64(), report["galaxies"].as_u64()),
        (Some(1), Some(1))
    );
    let alone = desk.image("g.fits");
    assert!((alone.sum() - 150.0).abs() < 0.5);
    // Wider than the star next to it, and elongated along the angle.
    let around = |x: usize, y: usize| alone[[y, x]];
    assert!(
        around(34, 27) > 1.5 * around(34, 23),
        "{} {}",
        around(34, 27),
        around(34, 23)
    );

    desk.write_image("dark.fits", Array2::zeros((NY, NX)));
    for options in ["", "--stream"] {
        desk.done(&format!(
            "simulate dark.fits --psf fine.fits --catalog galaxies.csv -o same.fits --precision f64 -q --overwrite {options}"
        ));
        assert!(difference(&desk.image("same.fits"), &alone) < DOUBLE, "{options}");
    }
    desk.done(&format!(
        "simulate --psf fine.fits {SHAPE} --catalog galaxies.csv --oversampling 3 -o finer.fits --precision f64 -q"
    ));
    assert!(difference(&desk.image("finer.fits"), &alone) < DOUBLE);
}

/// The scene's world coordinates, cut and binned with it, and sources placed by them.
#[test]
fn sky_coordinates_and_headers() {
    let desk = desk();
    let cards = |crpix: f64, step: f64| {
        [
            ("CTYPE1", CardValue::from("RA---TAN")),
            ("CTYPE2", "DEC--TAN".into()),
            ("CRVAL1", 150.0.into()),
            ("CRVAL2", 2.0.into()),
            ("CRPIX1", crpix.into()),
            ("CRPIX2", crpix.into()),
            ("CD1_1", (-step).into()),
            ("CD1_2", 0.0.into()),
            ("CD2_1", 0.0.into()),
            ("CD2_2", step.into()),
        ]
        .map(|(keyword, value)| Card::new(keyword, value, "").unwrap())
    };
    let write = |name: &str, pixels: Array2<f64>, cards: &[Card]| {
        let image = Image::new(pixels).unwrap();
        psf_io::write_image(desk.path(name), &image, &HeaderCards::new(), cards, true).unwrap();
    };
    // One-based pixel (31, 31) is (30, 30) from 0. A step in declination moves up.
    write("wcs.fits", points(&[]), &cards(31.0, 1e-4));
    desk.write("sky.csv", "ra,dec,flux\n150,2.0005,10\n150,2,20\n330,-2,5\n");
    desk.write("pixels.csv", "x,y,flux\n30,35,10\n30,30,20\n");
    let expected = stars(&desk, "--catalog pixels.csv", "expected.fits");
    desk.done(
        "simulate wcs.fits --psf fine.fits --precision f64 --tolerance 0 --catalog sky.csv -o placed.fits",
    );
    assert!(difference(&desk.image("placed.fits"), &expected) < 1e-6);
    let placed = stars(&desk, "--wcs wcs.fits --catalog sky.csv", "dark.fits");
    assert!(difference(&placed, &expected) < 1e-6);
    let number = |name: &str, keyword: &str| match desk.header(name).get(keyword).unwrap().value() {
        Some(CardValue::Real(value)) => value,
        other => panic!("{other:?}"),
    };
    assert_eq!(number("dark.fits", "CRPIX1"), 31.0);

    // Twice as fine, at the same position on the sky.
    write(
        "fine_wcs.fits",
        Array2::zeros((2 * NY, 2 * NX)),
        &cards(61.5, 0.5e-4),
    );
    desk.done(
        "simulate fine_wcs.fits --psf fine.fits --oversampling 2 --precision f64 --tolerance 0 --catalog sky.csv -o binned.fits \
         --frame 2,4,40,44",
    );
    let cut = expected.slice(s![4..48, 2..42]).to_owned();
    let image = desk.image("binned.fits");
    assert_eq!(image.dim(), cut.dim());
    assert_eq!(
        (number("binned.fits", "CRPIX1"), number("binned.fits", "CD2_2")),
        (29.0, 1e-4)
    );
    // The field begins at the frame's first pixel, so that the PSF differs slightly. The positions
    // are equal.
    let brightest = |image: &Array2<f64>| {
        image
            .indexed_iter()
            .max_by(|a, b| a.1.total_cmp(b.1))
            .map(|(place, _)| place)
    };
    assert_eq!(brightest(&image), brightest(&cut));

    // With a constant PSF, the frame equals that part of the whole image.
    desk.done("simulate wcs.fits --psf fine.fits -o no_sky.fits");
    write("none.fits", points(&[]), &[]);
    desk.refused(
        "simulate none.fits --psf fine.fits --catalog sky.csv -o x.fits",
        1,
        &["sky.csv", "world coordinates"],
    );
}

/// Compares a finer scene with stars at the centres of its pixels. The scene is streamed and
/// checked too.
#[test]
fn finer_scenes() {
    let desk = desk();
    let mut light = Array2::zeros((2 * NY, 2 * NX));
    light[[51, 60]] = 100.0;
    desk.write_image("fine_scene.fits", light);
    desk.write("centre.csv", "x,y,flux\n29.75,25.25,100\n");
    let expected = stars(&desk, "--catalog centre.csv", "expected.fits");
    for options in ["", "--stream", "--method basis"] {
        let run = format!(
            "simulate fine_scene.fits --oversampling 2 --psf fine.fits --precision f64 --spot-check 200 {options} -o image.fits --overwrite --json"
        );
        let report = desk.done(&run).json();
        assert_eq!(report["shape"][0].as_u64(), Some(NX as u64));
        assert_eq!(report["spot_check"]["passed"].as_bool(), Some(true));
        let largest = difference(&desk.image("image.fits"), &expected);
        assert!(largest < 1e-4, "{options}: {largest}");
    }
    desk.refused(
        "simulate scene.fits --oversampling 2 --psf fine.fits -o x.fits",
        1,
        &["61 x 51", "must be multiples of 2", "--frame"],
    );
    desk.refused(
        "simulate scene.fits --oversampling 99 --psf fine.fits -o x.fits",
        2,
        &["--oversampling"],
    );
}

/// Stars are cut as in GalSim and photutils: to N pixels around the one on which the star lies.
#[test]
fn stars_are_cut_to_the_stamp_size() {
    let desk = desk();
    let whole = stars(&desk, "--catalog stars.csv", "whole.fits");
    let cut = stars(&desk, "--catalog stars.csv --stamp-size 5", "cut.fits");
    for ((y, x), value) in cut.indexed_iter() {
        // Pixels (30, 26), (10, 12) and (-3, 21).
        let inside = [(30, 26), (10, 12), (-3, 21)]
            .iter()
            .any(|&(i, j)| (x as i64 - i).abs() <= 2 && (y as i64 - j).abs() <= 2);
        assert!(
            (value - if inside { whole[[y, x]] } else { 0.0 }).abs() < 1e-9,
            "{x}, {y}"
        );
    }
    let run = format!(
        "simulate --psf fine.fits {SHAPE} --precision f64 --catalog stars.csv --stamp-size 5 --method direct -o direct.fits"
    );
    desk.done(&run);
    assert!(difference(&desk.image("direct.fits"), &cut) < DOUBLE);
}

/// The extension of the scene is chosen, not guessed. The cards of the primary header are copied.
#[test]
fn scenes_in_extensions() {
    let desk = desk();
    desk.write("mef.fits", mef());
    desk.refused(
        "simulate mef.fits --psf samples.fits -o x.fits",
        1,
        &["mef.fits", "SCI", "WHT", "--extension"],
    );
    desk.done("simulate mef.fits --extension SCI --psf samples.fits -o image.fits");
    assert!((desk.image("image.fits").sum() - 3.0).abs() < 1e-3);
    let telescope = desk.header("image.fits").get("TELESCOP").and_then(Card::value);
    assert_eq!(telescope, Some("Small One".into()));
    desk.refused(
        "simulate mef.fits --extension 7 --psf samples.fits -o x.fits",
        1,
        &["mef.fits", "7"],
    );
}

/// An empty primary HDU and two images of the desk's field, SCI with light in one pixel.
fn mef() -> Vec<u8> {
    let header = |cards: &[String]| {
        let mut bytes: Vec<u8> = cards
            .iter()
            .flat_map(|card| format!("{card:<80}").into_bytes())
            .collect();
        bytes.extend(format!("{:<80}", "END").into_bytes());
        bytes.resize(bytes.len().next_multiple_of(2880), b' ');
        bytes
    };
    let card = |keyword: &str, value: &str| format!("{keyword:<8}= {value:>20}");
    let mut file = header(&[
        card("SIMPLE", "T"),
        card("BITPIX", "8"),
        card("NAXIS", "0"),
        card("EXTEND", "T"),
        "TELESCOP= 'Small One'".to_owned(),
    ]);
    for (name, lit) in [("SCI", 3.0f32), ("WHT", 1.0)] {
        file.extend(header(&[
            "XTENSION= 'IMAGE   '".to_owned(),
            card("BITPIX", "-32"),
            card("NAXIS", "2"),
            card("NAXIS1", &NX.to_string()),
            card("NAXIS2", &NY.to_string()),
            card("PCOUNT", "0"),
            card("GCOUNT", "1"),
            format!("EXTNAME = '{name:<8}'"),
        ]));
        let mut data: Vec<u8> = (0..NX * NY)
            .flat_map(|i| if i == 25 * NX + 30 { lit } else { 0.0 }.to_be_bytes())
            .collect();
        data.resize(data.len().next_multiple_of(2880), 0);
        file.extend(data);
    }
    file
}

/// The counts of a detector and the truth are those of `expose`.
#[test]
fn a_detector_behind_the_image() {
    let desk = desk();
    desk.write(
        "ccd.toml",
        "photon_noise = true\nsky_e = 50.0\nread_noise_e = 4.0\ngain_e_per_adu = 2.0\nbias_adu = 100.0\nbits = 16\n",
    );
    let simulate = "simulate scene.fits --psf samples.fits";
    let report = desk
        .done(&format!(
            "{simulate} --detector ccd.toml --seed 5 --truth truth.fits -o raw.fits --json"
        ))
        .json();
    assert!(report["exposure"]["mean_sky_e"].as_f64().is_some());
    desk.done(&format!("{simulate} -o image.fits"));
    desk.done("expose image.fits --detector ccd.toml --seed 5 -o exposed.fits");
    assert_eq!(desk.image("raw.fits"), desk.image("exposed.fits"));
    let (image, truth) = (desk.image("image.fits"), desk.image("truth.fits"));
    let expected = image.mapv(|v| 0.5 * (v + 50.0) + 100.0);
    assert!(difference(&truth, &expected) < 1e-6);
    let noise = (&desk.image("raw.fits") - &truth)
        .mapv(|v| v * v)
        .mean()
        .unwrap()
        .sqrt();
    assert!((2.0..8.0).contains(&noise), "{noise}");
    desk.done(&format!("{simulate} --detector ccd.toml --seed 6 -o other.fits"));
    assert_ne!(desk.image("raw.fits"), desk.image("other.fits"));
    // By default the truth is written next to the image.
    assert_eq!(desk.image("other_truth.fits"), truth);
    desk.done(&format!("{simulate} --detector ccd.toml --no-truth -o bare.fits"));
    assert!(!desk.path("bare_truth.fits").exists());
    desk.write("perfect.toml", "");
    desk.refused(
        &format!("{simulate} --detector perfect.toml -o x.fits"),
        2,
        &["nothing to add"],
    );
    desk.refused(
        &format!("{simulate} --detector ccd.toml --truth scene.fits -o x.fits --overwrite"),
        2,
        &["scene.fits"],
    );
    desk.refused(
        &format!("{simulate} --stream --detector ccd.toml -o x.fits"),
        2,
        &["--stream", "expose"],
    );
}

/// Galaxies at the edge of the frame and outside contribute the light that a wider frame shows
/// there. They are tested streamed and in finer pixels too.
#[test]
fn galaxies_beyond_the_edge_shine_in() {
    /// Windows and outskirts of galaxies depend on their places, by 1e-8 of the flux at tolerance 0.
    const WINDOWS: f64 = 1e-6;
    let desk = desk();
    // The PSF is constant, so that the position of the frame does not matter.
    desk.write_samples("one.fits", &crate::desk::samples_at(&[(30.0, 25.0)], 3));
    let rows = [(0.0, 20.0), (-4.0, 30.5), (60.5, 50.0), (30.0, -6.25)];
    let table = |dx: f64| {
        let line = |(x, y): &(f64, f64)| format!("{},{},100,3,1,0.7,20\n", x + dx, y + dx);
        "x,y,flux,re,n,q,angle\n".to_owned() + &rows.iter().map(line).collect::<String>()
    };
    desk.write("galaxies.csv", table(0.0));
    desk.write("moved.csv", table(40.0));
    let psf = "--psf one.fits --precision f64 --tolerance 0 -q";
    desk.done(&format!(
        "simulate {psf} --catalog moved.csv --shape 141,131 --frame 40,40,61,51 -o wide.fits"
    ));
    let expected = desk.image("wide.fits");
    assert!(
        expected.slice(s![.., 0]).sum() > 1.0,
        "light comes in at the left"
    );
    desk.write_image("dark.fits", Array2::zeros((NY, NX)));
    for (scene, options) in [(SHAPE, ""), ("dark.fits", ""), ("dark.fits", "--stream")] {
        desk.done(&format!(
            "simulate {scene} {psf} --catalog galaxies.csv {options} -o image.fits --overwrite --spot-check 100"
        ));
        let largest = difference(&desk.image("image.fits"), &expected);
        assert!(largest < WINDOWS, "{scene} {options}: {largest}");
    }
    // The header refers to pixels of the frame, not to those of the margin added to the scene.
    let place = desk.header("image.fits").get("CRPIX1").and_then(Card::value);
    assert_eq!(place, Some(20.5.into()));
    desk.done(&format!(
        "simulate {SHAPE} {psf} --catalog galaxies.csv --frame 3,4,50,40 -o cut.fits"
    ));
    let cut = expected.slice(s![4..44, 3..53]).to_owned();
    assert!(difference(&desk.image("cut.fits"), &cut) < WINDOWS);
}

/// The response of a pixel is applied to galaxies once. A small galaxy therefore looks like a star.
/// Native stamps are too coarse for galaxies, and a warning says so.
#[test]
fn small_galaxies_look_like_stars() {
    let desk = desk();
    desk.write("small.csv", "x,y,flux,re,n\n30.4,25,100,0.05,1\n");
    desk.write("star.csv", "x,y,flux\n30.4,25,100\n");
    let run = |psf: &str, sources: &str, out: &str| {
        format!("simulate --psf {psf}.fits {SHAPE} --precision f64 --catalog {sources}.csv -o {out}.fits")
    };
    desk.done(&run("fine", "star", "star"));
    desk.done(&run("fine", "small", "small"));
    let between = difference(&desk.image("small.fits"), &desk.image("star.fits"));
    assert!(between < 5e-3, "{between}");
    // The centre of a pixel makes no difference: a galaxy is always interpolated.
    desk.write("centred.csv", "x,y,flux,re,n\n30,25,100,3,1\n");
    desk.done(&run("fine", "centred", "enough"));
    desk.warned(
        &run("samples", "centred", "coarse"),
        "too coarse to be interpolated for stars between pixels and for galaxies",
    );
}

#[test]
fn a_catalogue_that_lights_nothing_is_noticed() {
    let desk = Desk::new();
    let simulate = "simulate --shape 61,51 --psf samples.fits";
    desk.write("none.csv", "x,y,flux\n");
    desk.warned(
        &format!("{simulate} --catalog none.csv -o none.fits"),
        "none.csv: the catalogue has no sources",
    );
    desk.write("far.csv", "x,y,flux\n500,5,1\n-30,4,2\n");
    desk.warned(
        &format!("{simulate} --catalog far.csv -o far.fits"),
        "no light of the stars and galaxies (2 in all)",
    );
    // One source in the frame is enough.
    desk.write("one.csv", "x,y,flux\n500,5,1\n30,14,2\n");
    desk.done(&format!("{simulate} --catalog one.csv -o one.fits"));
}

/// The unit of the scene's image is that of fluxes.
#[test]
fn fluxes_have_the_unit_of_the_image() {
    let desk = desk();
    let image = Image::new(Array2::<f64>::zeros((NY, NX))).unwrap();
    let unit = Card::new("BUNIT", "Jy", "").unwrap();
    psf_io::write_image(
        desk.path("jansky.fits"),
        &image,
        &HeaderCards::new(),
        &[unit],
        false,
    )
    .unwrap();
    desk.write("plain.csv", "x,y,flux\n30.25,25.5,0.1\n");
    let ecsv = |unit: &str| {
        format!(
            "# %ECSV 1.0\n# ---\n# datatype:\n# - {{name: x, datatype: float64}}\n# - {{name: y, datatype: float64}}\n\
             # - {{name: flux, unit: {unit}, datatype: float64}}\nx y flux\n30.25 25.5 100\n"
        )
    };
    desk.write("milli.ecsv", ecsv("mJy"));
    desk.write("electrons.ecsv", ecsv("electron"));
    let simulate = "simulate jansky.fits --psf fine.fits --precision f64 --tolerance 0 -o";
    desk.done(&format!("{simulate} plain.fits --catalog plain.csv"));
    desk.done(&format!("{simulate} milli.fits --catalog milli.ecsv"));
    assert!(difference(&desk.image("milli.fits"), &desk.image("plain.fits")) < DOUBLE);
    desk.refused(
        &format!("{simulate} no.fits --catalog electrons.ecsv"),
        1,
        &["electrons.ecsv", "column \"flux\"", "electron", "Jy"],
    );
}

#[test]
fn columns_that_are_not_read_are_named_once() {
    let desk = desk();
    desk.write("moving.csv", "x,y,flux,pmra,parallax,id\n30,25,100,3,4,5\n");
    let run = desk.run(&format!(
        "simulate --psf fine.fits {SHAPE} --catalog moving.csv -o moving.fits"
    ));
    let warned = run.stderr.matches("pmra, parallax").count();
    assert_eq!((run.code, warned), (Some(0), 1), "{}", run.stderr);
    // A series and a batch warn, too.
    desk.write(
        "jobs.toml",
        "[[job]]\npsf = 'fine.fits'\ncatalog = 'moving.csv'\nshape = [61, 51]\noutput = 'job.fits'\n",
    );
    let run = desk.run("batch jobs.toml");
    assert!(run.stderr.contains("pmra, parallax"), "{}", run.stderr);
    desk.write(
        "series.toml",
        "start = '2026-11-27T21:00:00'\ncount = 2\nexposure_s = 10\n\
         [simulate]\npsf = 'fine.fits'\ncatalog = 'moving.csv'\nshape = [61, 51]\n",
    );
    let run = desk.run("series series.toml -o frames");
    assert_eq!(run.stderr.matches("pmra, parallax").count(), 1, "{}", run.stderr);
}

/// Old cards of the matrix (Pan-STARRS): a frame whose columns count against the right ascension, or not.
#[test]
fn old_cards_of_the_matrix_change_positions() {
    let desk = desk();
    let with = |keyword: &str, name: &str| {
        let cards = [
            ("CRVAL2", 2.0),
            ("CDELT1", 1e-4),
            ("CDELT2", 1e-4),
            (keyword, -1.0),
        ];
        write_frame_on_sky(
            &desk,
            name,
            &cards.map(|(keyword, value)| (keyword, value.into())),
        );
    };
    with("PC1_1", "new.fits");
    with("PC001001", "old.fits");
    desk.write("sky.csv", "ra,dec,flux\n150.001,2.0005,100\n");
    let simulate = |scene: &str, name: &str| {
        desk.done(&format!(
            "simulate {scene} --psf fine.fits --catalog sky.csv -o {name}"
        ));
        desk.image(name)
    };
    let (new, old) = (simulate("new.fits", "a.fits"), simulate("old.fits", "b.fits"));
    assert!(new.slice(s![.., ..30]).sum() > 50.0, "the star lies on the left");
    assert_eq!(new, old);
}

/// Sources move to the date of the frame, and a table says where they are.
#[test]
fn sources_move_and_are_listed() {
    let desk = desk();
    let mut cards = vec![
        ("CRVAL2", 60.0.into()),
        ("CDELT1", CardValue::from(-1e-4)),
        ("CDELT2", 1e-4.into()),
    ];
    write_frame_on_sky(&desk, "plain.fits", &cards);
    cards.push(("DATE-OBS", "2026-01-01T12:00:00".into()));
    write_frame_on_sky(&desk, "dated.fits", &cards);
    desk.write(
        "gaia.csv",
        "ra,dec,phot_g_mean_mag,pmra,pmdec,parallax,ref_epoch\n150,60,20,360,0,,2016.0\n150,70,20,0,0,1,2016\n",
    );
    desk.write("no_epoch.csv", "ra,dec,flux,pmra,pmdec\n150,60,100,360,0\n");
    let mut count = 0;
    let mut x_of = |options: &str| {
        count += 1;
        let (image, table) = (format!("i{count}.fits"), format!("t{count}.fits"));
        let run = desk.run(&format!(
            "simulate --psf fine.fits {SHAPE} {options} -o {image} --truth-table {table}"
        ));
        assert_eq!(run.code, Some(0), "{}", run.stderr);
        let truth = psf_io::read_columns(desk.path(&table), ["row", "x", "dec"]);
        let [row, x, dec] = truth.unwrap();
        assert_eq!((row[0], (dec[0] - 60.0).abs() < 1e-6), (0.0, true));
        x[0]
    };
    // 3.6 arcseconds in ten years are ten pixels.
    let gaia = "--catalog gaia.csv --zero-point 25";
    assert!((x_of(&format!("--wcs dated.fits {gaia}")) - 20.0).abs() < 0.05);
    assert!((x_of(&format!("--wcs plain.fits {gaia}")) - 30.0).abs() < 1e-6);
    assert!((x_of(&format!("--wcs plain.fits {gaia} --date 2021.0")) - 25.0).abs() < 0.05);
    assert!((x_of("--wcs dated.fits --catalog no_epoch.csv")) > 29.9);
    assert!((x_of("--wcs dated.fits --catalog no_epoch.csv --epoch 2021") - 25.0).abs() < 0.05);
    // A scene's part: pixels of the image.
    let part = x_of(&format!("--wcs dated.fits {gaia} --frame 5,4,40,30"));
    assert!((part - 15.0).abs() < 0.05);
    let none = "simulate --psf fine.fits --wcs plain.fits -o n.fits";
    desk.refused(
        &format!("{none} {SHAPE} --catalog no_epoch.csv --date 2021"),
        1,
        &["no_epoch.csv", "\"pmra\"", "epoch", "--epoch"],
    );
    desk.refused(
        &format!("{none} {SHAPE} --catalog stars.csv --date 2021"),
        1,
        &["pixels", "--date"],
    );
    desk.refused(
        &format!("{none} {SHAPE} --catalog stars.csv --date May"),
        2,
        &["a date is needed"],
    );
    desk.refused(
        "simulate scene.fits --psf fine.fits -o n.fits --truth-table t.fits",
        2,
        &["--truth-table", "--catalog"],
    );
}

/// The size of a galaxy on the sky, and a table with saturated pixels.
#[test]
fn sizes_on_the_sky_and_saturated_stars() {
    let desk = desk();
    let cards = [
        ("CRVAL2", 60.0),
        // Turned by 90 degrees: north points to +x, and east to +y.
        ("CD1_1", 0.0),
        ("CD1_2", 1e-4),
        ("CD2_1", 1e-4),
        ("CD2_2", 0.0),
    ];
    let cards = cards.map(|(keyword, value)| (keyword, value.into()));
    write_frame_on_sky(&desk, "turned.fits", &cards);
    desk.write(
        "sky.csv",
        "ra,dec,flux,re_arcsec,n,q,pa_deg\n150,60,1000,1.08,1,0.5,0\n150.001,60,9000,0,,,\n",
    );
    desk.write(
        "pixels.csv",
        "x,y,flux,re,n,q,angle\n30,25,1000,3,1,0.5,0\n30,30,9000,0,,,\n",
    );
    let on_sky = stars(&desk, "--catalog sky.csv --wcs turned.fits", "a.fits");
    let in_pixels = stars(&desk, "--catalog pixels.csv", "b.fits");
    // The projection is not quite linear.
    assert!(difference(&on_sky, &in_pixels) < 1e-4);
    desk.write("ccd.toml", "photon_noise = true\nfull_well_e = 300.0\n");
    desk.done(&format!(
        "simulate --psf fine.fits {SHAPE} --catalog pixels.csv --detector ccd.toml --no-truth -o c.fits --truth-table t.fits"
    ));
    let [saturated] = psf_io::read_columns(desk.path("t.fits"), ["saturated_pixels"]).unwrap();
    assert!(saturated[0] == 0.0 && saturated[1] > 3.0, "{saturated:?}");
}
