//! Reading and writing PSFEx models, with files like those of PSFEx and with invalid ones.

mod support;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use ndarray::Array3;
use psf_io::{
    Card, CardValue, FileKind, HduChoice, IoErrorKind, PsfexAxis, PsfexFigures, PsfexModel, PsfexPolynomial,
    detect, read_psfex, read_psfex_at, write_psfex,
};
use psf_types::{Position, StampInterpolation};
use support::mutations::{assert_refused, cut, huge_sizes, with_value, without, wrong_types};
use support::{SIMPLE, Scratch, assert_error, chain, f32s, image, names, table};

const NX: usize = 5;
const NY: usize = 4;
/// The longest time for reading or refusing a file of any claimed size.
const QUICK: Duration = Duration::from_secs(1);

/// The header of a model of degree 1, as PSFEx 3 writes it.
fn cards() -> Vec<String> {
    [
        "LOADED  = 534 / Number of loaded sources",
        "ACCEPTED= 483",
        "CHI2    = 0.99445946",
        "POLNAXIS= 2",
        "POLGRP1 = 1",
        "POLNAME1= 'X_IMAGE '",
        "POLZERO1= 1.024312829971E+03",
        "POLSCAL1= 2.003128734589E+03",
        "POLGRP2 = 1",
        "POLNAME2= 'Y_IMAGE '",
        "POLZERO2= 21",
        "POLSCAL2= 40",
        "POLNGRP = 1",
        "POLDEG1 = 1",
        "PSF_FWHM= 4.58",
        "PSF_SAMP= 0.5",
        "PSFNAXIS= 3",
        "PSFAXIS1= 5",
        "PSFAXIS2= 4",
        "PSFAXIS3= 3",
        "TDIM1   = '(5, 4, 3)'",
    ]
    .map(str::to_owned)
    .to_vec()
}

/// Replaces the card with this keyword, or removes it if the new card is empty.
fn changed(mut cards: Vec<String>, keyword: &str, card: &str) -> Vec<String> {
    let of = |card: &String| card.split('=').next().is_some_and(|k| k.trim() == keyword);
    match (cards.iter().position(of), card.is_empty()) {
        (Some(at), false) => card.clone_into(&mut cards[at]),
        (Some(at), true) => drop(cards.remove(at)),
        (None, _) => cards.push(card.to_owned()),
    }
    cards
}

fn values() -> Vec<f32> {
    (0..NX * NY * 3).map(|i| (i as f32 - 20.0) / 7.0).collect()
}

fn extension(name: &str, cards: &[String], form: &str, data: &[u8]) -> Vec<u8> {
    let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
    table(name, &[("PSF_MASK", form)], 1, &cards, data)
}

fn with_primary(extensions: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = image(SIMPLE, 8, &[], &["EXTEND  = T"], &[]);
    for extension in extensions {
        bytes.extend(extension);
    }
    bytes
}

fn good() -> Vec<u8> {
    with_primary(&[extension("PSF_DATA", &cards(), "60E", &f32s(&values()))])
}

/// A file with one card changed.
fn file_with(scratch: &Scratch, keyword: &str, card: &str) -> PathBuf {
    let cards = changed(cards(), keyword, card);
    scratch.put(
        "changed.psf",
        &with_primary(&[extension("PSF_DATA", &cards, "60E", &f32s(&values()))]),
    )
}

#[test]
fn a_model_is_read_with_the_conventions_of_psfex() {
    let scratch = Scratch::new();
    let path = scratch.put("good.psf", &good());
    assert_eq!(detect(&path).unwrap(), FileKind::Psfex);
    let model = read_psfex(&path, None).unwrap();
    assert_eq!(model.planes().dim(), (3, NY, NX));
    assert_eq!(
        model.planes()[[1, 2, 3]],
        f64::from(values()[NX * NY + 2 * NX + 3])
    );
    let grid = model.grid();
    assert_eq!((grid.oversampling(), grid.pixel_response_included()), (2.0, true));
    assert_eq!((grid.centre_x(), grid.centre_y()), (2.0, 2.0));
    assert_eq!(grid.interpolation(), StampInterpolation::Lanczos3);
    assert_eq!(model.figures().fwhm_px, Some(4.58));
    assert_eq!(
        (model.figures().loaded, model.figures().accepted),
        (Some(534), Some(483))
    );
    let polynomial = model.polynomial().unwrap();
    assert_eq!(
        (polynomial.degree(), polynomial.y().zero(), polynomial.y().scale()),
        (1, 20.0, 40.0)
    );
    // x is its 0-based offset. y is a quarter of its scale above its offset. So the terms are 1, 0
    // and 1/4.
    let at = Position::new(polynomial.x().zero(), 30.0).unwrap();
    let psf = model.psf_at(at).unwrap();
    let expected = model.planes()[[0, 1, 1]] + 0.25 * model.planes()[[2, 1, 1]];
    assert!((psf.values()[[1, 1]] - expected).abs() < 1e-15);
}

#[test]
fn written_models_are_read_back() {
    let scratch = Scratch::new();
    let axis = |name, zero| PsfexAxis::new(name, zero, 2048.0).unwrap();
    for degree in [0, 1, 3] {
        let polynomial =
            PsfexPolynomial::new(axis("XWIN_IMAGE", 1023.5), axis("YWIN_IMAGE", 7.25), degree).unwrap();
        let terms = PsfexPolynomial::term_count(degree);
        // The values are sixteenths, which single precision holds exactly.
        let planes = Array3::from_shape_fn((terms, 7, 9), |(t, y, x)| (t + 3 * y * x) as f64 / 16.0);
        let model = PsfexModel::new(planes, 0.476, Some(polynomial)).unwrap();
        let mut figures = PsfexFigures::default();
        (figures.fwhm_px, figures.chi2) = (Some(3.5), Some(1.01));
        let model = model.with_figures(figures);
        let path = scratch.path(&format!("{degree}.psf"));
        let note = [Card::new("ORIGIN", "a test", "").unwrap()];
        write_psfex(&path, &model, &note, false).unwrap();
        assert_eq!(read_psfex(&path, None).unwrap(), model);
        assert_error(
            write_psfex(&path, &model, &[], false),
            IoErrorKind::Exists,
            "exists",
        );
        let text = std::fs::read(&path).unwrap();
        for card in ["ORIGIN  = 'a test", "PSF_SAMP=", "TDIM1   = '(9, 7, "] {
            assert!(text.windows(card.len()).any(|w| w == card.as_bytes()), "{card}");
        }
    }
    let constant = PsfexModel::new(Array3::from_elem((1, 3, 3), 0.125), 1.0, None).unwrap();
    let path = scratch.path("constant.psf");
    write_psfex(&path, &constant, &[], false).unwrap();
    assert_eq!(read_psfex(&path, None).unwrap(), constant);
    let huge = PsfexModel::new(Array3::from_elem((1, 3, 3), 1e300), 1.0, None).unwrap();
    let result = write_psfex(scratch.path("huge.psf"), &huge, &[], false);
    assert_error(result, IoErrorKind::Limit, "single precision");
    assert!(!scratch.path("huge.psf").exists());
}

#[test]
fn a_constant_psf_needs_neither_coordinates_nor_a_third_axis() {
    let scratch = Scratch::new();
    let constant: Vec<String> = ["POLNAXIS= 0", "PSF_SAMP= 1.5", "PSFAXIS1= 5", "PSFAXIS2= 4"]
        .map(str::to_owned)
        .to_vec();
    for more in [
        &["PSFNAXIS= 2", "TDIM1   = '(5,4)'"][..],
        &["PSFNAXIS= 3", "PSFAXIS3= 1"],
    ] {
        let cards: Vec<String> = constant
            .iter()
            .cloned()
            .chain(more.iter().map(ToString::to_string))
            .collect();
        let bytes = with_primary(&[extension("PSF_DATA", &cards, "20E", &f32s(&values()[..20]))]);
        let model = read_psfex(scratch.put("constant.psf", &bytes), None).unwrap();
        assert_eq!((model.degree(), model.polynomial()), (0, None));
        assert_eq!(model.planes().dim(), (1, NY, NX));
    }
}

#[test]
fn one_of_several_models_must_be_chosen() {
    let scratch = Scratch::new();
    let of = |name, degree: f32| {
        let values: Vec<f32> = values().iter().map(|v| v + degree).collect();
        extension(name, &cards(), "60E", &f32s(&values))
    };
    let stars = table("STARS", &[("N", "J")], 1, &[], &[0, 0, 0, 1]);
    let bytes = with_primary(&[of("PSF_DATA", 0.0), stars, of("CCD7", 1.0), of("PSF_DATA", 2.0)]);
    let path = scratch.put("several.psf", &bytes);
    assert_eq!(detect(&path).unwrap(), FileKind::Psfex);
    let error = read_psfex(&path, None).unwrap_err();
    let text = error.to_string();
    for part in ["1 \"PSF_DATA\"", "3 \"CCD7\"", "4 \"PSF_DATA\""] {
        assert!(text.contains(part), "{text}");
    }
    assert_eq!(error.setting(), Some("extension"));
    assert!(names(&error, &path) && !text.contains("STARS"), "{text}");
    let first = |choice: &str| {
        read_psfex(&path, Some(&choice.parse::<HduChoice>().unwrap())).map(|model| model.planes()[[0, 0, 0]])
    };
    let base = f64::from(values()[0]);
    assert!((first("1").unwrap() - base).abs() < 1e-6);
    assert!((first("ccd7").unwrap() - base - 1.0).abs() < 1e-6);
    assert!((first("4").unwrap() - base - 2.0).abs() < 1e-6);
    assert_error(
        first("psf_data"),
        IoErrorKind::Setting,
        "the file has 2 PSFEx models",
    );
    for wrong in ["2", "0", "STARS", "99"] {
        let part = format!("HDU {wrong} is none of the PSFEx models");
        assert_error(first(wrong), IoErrorKind::Setting, &part);
        assert_error(first(wrong), IoErrorKind::Setting, "3 \"CCD7\"");
    }
}

#[test]
fn unsupported_keywords_are_named() {
    let scratch = Scratch::new();
    for (keyword, card, parts) in [
        ("POLNAXIS", "POLNAXIS= 1", &["PSFAXIS3", "2 terms"][..]),
        ("POLNAXIS", "POLNAXIS= 11", &["POLNAXIS", "got 11"]),
        ("POLNAXIS", "POLNAXIS= -1", &["POLNAXIS"]),
        ("POLNAXIS", "POLNAXIS= 'two'", &["POLNAXIS", "two"]),
        ("POLNGRP", "POLNGRP = 2", &["POLDEG2", "missing"]),
        ("POLNGRP", "POLNGRP = 3", &["POLNGRP", "groups"]),
        ("POLGRP2", "POLGRP2 = 2", &["POLGRP2"]),
        ("POLNAME1", "POLNAME1= 'MAG_AUTO'", &["depends on MAG_AUTO"]),
        ("POLNAME1", "POLNAME1= 'Y_IMAGE'", &["POLNAME2", "Y_IMAGE"]),
        ("POLNAME1", "POLNAME1= 'X2_IMAGE'", &["depends on X2_IMAGE"]),
        ("POLNAME2", "POLNAME2= 'Y_WORLD'", &["depends on Y_WORLD"]),
        ("POLNAME2", "", &["POLNAME2"]),
        ("POLZERO1", "", &["POLZERO1"]),
        ("POLZERO2", "POLZERO2= 'zero'", &["POLZERO2", "number"]),
        ("POLSCAL1", "POLSCAL1= 0.0", &["POLSCAL1"]),
        ("POLSCAL2", "POLSCAL2= NAN", &["POLSCAL2"]),
        ("POLDEG1", "POLDEG1 = 2", &["PSFAXIS3", "3 planes", "6 terms"]),
        ("POLDEG1", "POLDEG1 = -1", &["POLDEG1"]),
        ("POLDEG1", "POLDEG1 = 11", &["POLDEG1", "11"]),
        ("POLDEG1", "", &["POLDEG1"]),
        ("PSF_SAMP", "PSF_SAMP= 0.0", &["PSF_SAMP", "above 0"]),
        ("PSF_SAMP", "PSF_SAMP= -0.5", &["PSF_SAMP"]),
        ("PSF_SAMP", "PSF_SAMP= T", &["PSF_SAMP"]),
        ("PSF_SAMP", "", &["PSF_SAMP"]),
        ("PSFNAXIS", "PSFNAXIS= 2", &["PSFNAXIS", "3"]),
        ("PSFNAXIS", "PSFNAXIS= 4", &["PSFNAXIS"]),
        ("PSFAXIS1", "PSFAXIS1= 6", &["PSFAXIS1", "TDIM1"]),
        ("PSFAXIS1", "PSFAXIS1= 0", &["PSFAXIS1", "above 0"]),
        ("PSFAXIS2", "PSFAXIS2= 9223372036854775807", &["PSFAXIS"]),
        ("PSFAXIS3", "PSFAXIS3= 2", &["PSFAXIS3"]),
        ("TDIM1", "TDIM1   = '(4, 5, 3)'", &["TDIM1"]),
        ("TDIM1", "TDIM1   = 60", &["TDIM1"]),
        ("LOADED", "LOADED  = 'many'", &["LOADED"]),
        ("PSF_FWHM", "PSF_FWHM= 'wide'", &["PSF_FWHM"]),
    ] {
        let path = file_with(&scratch, keyword, card);
        let clock = Instant::now();
        let error = read_psfex(&path, None).expect_err(card);
        assert!(clock.elapsed() < QUICK, "{card}");
        let text = chain(&error);
        assert!(names(&error, &path), "{text}");
        for part in parts {
            assert!(text.contains(part), "{card}: {text}");
        }
    }
}

/// The header of a model in these contexts: name, offset, scale and group. `degrees` are those of the groups.
fn contexts(axes: &[(&str, f64, f64, usize)], degrees: &[usize], terms: usize) -> Vec<String> {
    let mut all: Vec<String> = cards()
        .into_iter()
        .filter(|card| {
            !card.starts_with("POL") && !card.starts_with("PSFAXIS3") && !card.starts_with("TDIM1")
        })
        .collect();
    all.push(format!("POLNAXIS= {}", axes.len()));
    for ((name, zero, scale, group), i) in axes.iter().zip(1..) {
        all.extend([
            format!("POLGRP{i} = {group}"),
            format!("POLNAME{i}= '{name}'"),
            format!("POLZERO{i}= {zero:?}"),
            format!("POLSCAL{i}= {scale:?}"),
        ]);
    }
    all.push(format!("POLNGRP = {}", degrees.len()));
    all.extend(
        degrees
            .iter()
            .zip(1..)
            .map(|(degree, i)| format!("POLDEG{i} = {degree}")),
    );
    all.extend([
        format!("PSFAXIS3= {terms}"),
        format!("TDIM1   = '(5, 4, {terms})'"),
    ]);
    all
}

/// A file whose plane `k` holds the value `k + 1` everywhere.
fn numbered(scratch: &Scratch, cards: &[String], terms: usize) -> PathBuf {
    let values: Vec<f32> = (0..NX * NY * terms).map(|i| (i / (NX * NY) + 1) as f32).collect();
    let form = format!("{}E", values.len());
    scratch.put(
        "contexts.psf",
        &with_primary(&[extension("PSF_DATA", cards, &form, &f32s(&values))]),
    )
}

/// The value of all pixels of the PSF at a position.
fn value_at(model: &PsfexModel, x: f64, y: f64) -> f64 {
    let terms = model.polynomial().map_or_else(
        || vec![1.0],
        |polynomial| polynomial.terms(Position::new(x, y).unwrap()),
    );
    let planes = model.planes();
    terms
        .iter()
        .zip(planes.outer_iter())
        .map(|(term, plane)| term * plane[[0, 0]])
        .sum()
}

/// The order of the terms is that of PSFEx's `poly.c`: the first context is the fastest, and the sum of the
/// exponents of a group is at most its degree. The expected sums are written out by hand.
#[test]
fn polynomials_in_other_contexts_and_groups_are_read() {
    let scratch = Scratch::new();
    let x = |group| ("X_IMAGE", 11.0, 10.0, group);
    let y = |group| ("YWIN_IMAGE", 21.0, 20.0, group);
    let mag = |group| ("MAG_AUTO", 18.0, 2.0, group);
    let mags = [("mag_auto".to_owned(), 19.0)];
    // At this 0-based position X = 0.5 and Y = 0.25, and M = 0.5.
    let at = |model: &PsfexModel| value_at(model, 15.0, 25.0);
    let read = |cards: &[String], terms: usize, values: &[(String, f64)]| {
        read_psfex_at(numbered(&scratch, cards, terms), None, values).unwrap()
    };

    // 1, X, X^2
    let model = read(&contexts(&[x(1)], &[2], 3), 3, &[]);
    assert_eq!(at(&model), 1.0 + 2.0 * 0.5 + 3.0 * 0.25);
    assert_eq!(value_at(&model, 15.0, 900.0), at(&model));
    assert_eq!(model.polynomial().unwrap().frame_shape(), None);
    // 1, X, Y, M of one group of degree 1
    let model = read(&contexts(&[x(1), y(1), mag(1)], &[1], 4), 4, &mags);
    assert_eq!(at(&model), 1.0 + 2.0 * 0.5 + 3.0 * 0.25 + 4.0 * 0.5);
    // The contexts may stand in any order: 1, M, Y, X
    let model = read(&contexts(&[mag(1), y(1), x(1)], &[1], 4), 4, &mags);
    assert_eq!(at(&model), 1.0 + 2.0 * 0.5 + 3.0 * 0.25 + 4.0 * 0.5);
    // (1, X, Y) times (1, M, M^2), the position fastest
    let model = read(&contexts(&[x(1), y(1), mag(2)], &[1, 2], 9), 9, &mags);
    let of_mag = [1.0, 0.5, 0.25];
    let expected: f64 = (0..3)
        .map(|k| of_mag[k] * ((3 * k + 1) as f64 + (3 * k + 2) as f64 * 0.5 + (3 * k + 3) as f64 * 0.25))
        .sum();
    assert!((at(&model) - expected).abs() < 1e-12);
    // (1, X) times (1, Y): a polynomial of degree 2 without squares
    let model = read(&contexts(&[x(1), y(2)], &[1, 1], 4), 4, &[]);
    assert_eq!(at(&model), 1.0 + 2.0 * 0.5 + 3.0 * 0.25 + 4.0 * 0.5 * 0.25);
    assert_eq!(model.degree(), 2);
    // A magnitude alone
    let model = read(&contexts(&[mag(1)], &[1], 2), 2, &mags);
    assert_eq!((model.polynomial(), at(&model)), (None, 1.0 + 2.0 * 0.5));

    let cards = contexts(&[x(1), y(1), mag(1)], &[1], 4);
    let path = numbered(&scratch, &cards, 4);
    let colour = ("COLOUR".to_owned(), 1.0);
    for (values, part) in [
        (vec![], "depends on MAG_AUTO besides the position"),
        (vec![mags[0].clone(), colour], "a value for COLOUR"),
    ] {
        let error = read_psfex_at(&path, None, &values).unwrap_err();
        assert_eq!(error.setting(), Some("contexts"));
        assert!(error.to_string().contains(part), "{error}");
    }
    let error = read_psfex_at(scratch.put("good.psf", &good()), None, &mags).unwrap_err();
    assert!(error.to_string().contains("nothing but the position"), "{error}");
}

#[test]
fn what_the_column_tells_need_not_be_in_the_header() {
    let scratch = Scratch::new();
    let model = read_psfex(scratch.put("good.psf", &good()), None).unwrap();
    for keyword in ["POLNAXIS", "POLNGRP", "PSFNAXIS"] {
        let path = file_with(&scratch, keyword, "");
        assert_eq!(read_psfex(&path, None).unwrap(), model, "{keyword}");
    }
    // A constant PSF, told by its column alone.
    let cards = ["PSF_SAMP= 0.5", "TDIM1   = '(5, 4)'"].map(str::to_owned);
    let values = f32s(&values()[..NX * NY]);
    let bytes = with_primary(&[extension("PSF_DATA", &cards, "20E", &values)]);
    let constant = read_psfex(scratch.put("constant.psf", &bytes), None).unwrap();
    assert_eq!(
        (constant.polynomial(), constant.planes().dim()),
        (None, (1, NY, NX))
    );
}

/// A table as legacypipe writes it: keywords as columns, and planes of the size of the largest CCD.
#[test]
fn models_in_the_rows_of_a_table_are_read() {
    let scratch = Scratch::new();
    let columns = [
        ("expnum", "J"),
        ("ccdname", "4A"),
        ("polnaxis", "J"),
        ("polname1", "7A"),
        ("polzero1", "D"),
        ("polscal1", "D"),
        ("polname2", "7A"),
        ("polzero2", "D"),
        ("polscal2", "D"),
        ("polngrp", "J"),
        ("poldeg1", "J"),
        ("psf_samp", "D"),
        ("psfnaxis", "J"),
        ("psfaxis1", "J"),
        ("psfaxis2", "J"),
        ("psfaxis3", "J"),
        ("psf_mask", "60E"),
    ];
    let row = |name: &[u8; 4], degree: i32, [nx, ny, terms]: [i32; 3]| {
        let mut bytes = Vec::new();
        let whole = |bytes: &mut Vec<u8>, n: i32| bytes.extend(n.to_be_bytes());
        let real = |bytes: &mut Vec<u8>, v: f64| bytes.extend(v.to_be_bytes());
        whole(&mut bytes, 12);
        bytes.extend(name);
        whole(&mut bytes, 2);
        for (letter, zero, scale) in [(b"X_IMAGE", 11.0, 10.0), (b"Y_IMAGE", 21.0, 20.0)] {
            bytes.extend(letter);
            real(&mut bytes, zero);
            real(&mut bytes, scale);
        }
        whole(&mut bytes, 1);
        whole(&mut bytes, degree);
        real(&mut bytes, 0.5);
        for n in [3, nx, ny, terms] {
            whole(&mut bytes, n);
        }
        // Plane k of the model holds k + 1, and zeros where the plane ends.
        for k in 0..3 {
            for (y, x) in (0..NY as i32).flat_map(|y| (0..NX as i32).map(move |x| (y, x))) {
                let on = k < terms && y < ny && x < nx;
                bytes.extend((if on { (k + 1) as f32 } else { 0.0 }).to_be_bytes());
            }
        }
        bytes
    };
    let rows = [row(b"N4  ", 1, [5, 4, 3]), row(b"S12 ", 0, [3, 3, 1])].concat();
    let bytes = with_primary(&[table("", &columns, 2, &["TDIM17  = '(5, 4, 3)'"], &rows)]);
    let path = scratch.put("merged.fits", &bytes);
    assert_eq!(detect(&path).unwrap(), FileKind::Psfex);
    let choose = |choice: &str| read_psfex(&path, Some(&choice.parse::<HduChoice>().unwrap()));
    let first = choose("n4").unwrap();
    assert_eq!(
        (first.planes().dim(), value_at(&first, 15.0, 25.0)),
        ((3, 4, 5), 1.0 + 1.0 + 0.75)
    );
    let second = choose("1").unwrap();
    assert_eq!((second.planes().dim(), second.planes().sum()), ((1, 3, 3), 9.0));
    for wrong in [read_psfex(&path, None), choose("N5"), choose("2")] {
        let error = wrong.unwrap_err();
        assert_eq!(error.setting(), Some("extension"));
        assert!(error.to_string().contains("[N4, S12]"), "{error}");
    }
}

#[test]
fn tables_that_cannot_hold_the_planes_are_refused() {
    let scratch = Scratch::new();
    let data = f32s(&values());
    let without_dimensions = changed(cards(), "TDIM1", "");
    let refused = |bytes: Vec<u8>, parts: &[&str]| {
        let path = scratch.put("bad.psf", &bytes);
        let clock = Instant::now();
        let error = read_psfex(&path, None).unwrap_err();
        assert!(clock.elapsed() < QUICK);
        let text = chain(&error);
        assert!(names(&error, &path), "{text}");
        for part in parts {
            assert!(text.contains(part), "{text}");
        }
    };
    // Too few values, text in place of numbers, another name, no name.
    refused(
        with_primary(&[extension("PSF_DATA", &without_dimensions, "59E", &data[..236])]),
        &["PSF_MASK", "59E", "60"],
    );
    refused(
        with_primary(&[extension("PSF_DATA", &without_dimensions, "240A", &data)]),
        &["PSF_MASK", "240A"],
    );
    let list: Vec<String> = cards();
    let list: Vec<&str> = list.iter().map(String::as_str).collect();
    refused(
        with_primary(&[table("PSF_DATA", &[("MASK", "60E")], 1, &list, &data)]),
        &["PSF_MASK", "MASK"],
    );
    refused(
        with_primary(&[table("STARS", &[("MASK", "60E")], 1, &list, &data)]),
        &["PSF_DATA", "PSF_MASK"],
    );
    refused(
        with_primary(&[table(
            "PSF_DATA",
            &[("PSF_MASK", "60E")],
            2,
            &list,
            &data.repeat(2),
        )]),
        &["NAXIS2", "one row"],
    );
    // The header claims sizes that the file does not have.
    let without = |cards: Vec<String>, keyword: &str, card: &str| {
        with_primary(&[extension(
            "PSF_DATA",
            &changed(cards, keyword, card),
            "60E",
            &data,
        )])
    };
    refused(
        without(without_dimensions.clone(), "PSFAXIS1", "PSFAXIS1= 4000000000"),
        &["PSF_MASK", "60E"],
    );
    let huge = with_primary(&[extension("PSF_DATA", &cards(), "9000000000000E", &data)]);
    refused(huge, &["NAXIS1"]);
    for (row, bad) in [(0, f32::NAN), (37, f32::INFINITY)] {
        let mut values = values();
        values[row] = bad;
        refused(
            with_primary(&[extension("PSF_DATA", &cards(), "60E", &f32s(&values))]),
            &["PSF_MASK", "finite"],
        );
    }
}

/// The cards that every model needs.
const NEEDED: [&str; 12] = [
    "POLNAXIS", "POLNAME1", "POLNAME2", "POLZERO1", "POLZERO2", "POLSCAL1", "POLSCAL2", "POLNGRP", "POLDEG1",
    "PSF_SAMP", "PSFNAXIS", "PSFAXIS3",
];

#[test]
fn damaged_models_are_refused_soon_and_without_much_memory() {
    let whole = good();
    let names: Vec<&str> = NEEDED
        .into_iter()
        .filter(|card| card.starts_with("POLNAME"))
        .collect();
    let numbers: Vec<&str> = NEEDED
        .into_iter()
        .filter(|card| !card.starts_with("POLNAME"))
        .collect();
    let mut spoilt = cut(&whole);
    // Cards that repeat the column or the names may be missing.
    let told = |card: &&str| !["POLNAXIS", "POLNGRP", "PSFNAXIS"].contains(card);
    spoilt.extend(without(
        &whole,
        &NEEDED.into_iter().filter(told).collect::<Vec<_>>(),
    ));
    spoilt.extend(wrong_types(&whole, &numbers, &names));
    spoilt.extend(huge_sizes(&whole));
    for (keyword, value) in [
        ("TFORM1", "'9223372036854775807E'"),
        ("TFORM1", "'60D'"),
        ("TFIELDS", "999"),
        ("PSFAXIS1", "4611686018427387904"),
        ("PSFAXIS3", "99999999"),
        ("POLDEG1", "4611686018427387904"),
    ] {
        spoilt.push(with_value(&whole, keyword, value));
    }
    assert_refused(spoilt, |path| read_psfex(path, None));
}

#[test]
fn the_header_has_the_cards_that_psfex_readers_need() {
    let scratch = Scratch::new();
    let model = read_psfex(scratch.put("good.psf", &good()), None).unwrap();
    let path = scratch.path("again.psf");
    write_psfex(&path, &model, &[], false).unwrap();
    assert_eq!(read_psfex(&path, None).unwrap(), model);
    let bytes = std::fs::read(&path).unwrap();
    let records: Vec<&[u8]> = bytes.chunks(80).collect();
    for (keyword, value) in [
        ("POLNAXIS", CardValue::Integer(2)),
        ("POLGRP1", CardValue::Integer(1)),
        ("POLNAME2", CardValue::Text("Y_IMAGE".to_owned())),
        ("POLZERO2", CardValue::Real(21.0)),
        ("PSFNAXIS", CardValue::Integer(3)),
        ("PSFAXIS3", CardValue::Integer(3)),
    ] {
        let expected = Card::new(keyword, value, "").unwrap().to_string();
        let start = expected.trim_end().as_bytes();
        assert!(
            records.iter().any(|record| record.starts_with(start)),
            "{expected}"
        );
    }
}
