//! Reading and writing PSFEx models, with files like those of PSFEx and with invalid ones.

mod support;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use ndarray::Array3;
use psf_io::{
    Card, CardValue, FileKind, HduChoice, IoErrorKind, PsfexAxis, PsfexFigures, PsfexModel, PsfexPolynomial,
    detect, read_psfex, write_psfex,
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
        ("POLNAXIS", "POLNAXIS= 1", &["POLNAXIS", "2", "got 1"][..]),
        ("POLNAXIS", "POLNAXIS= -1", &["POLNAXIS"]),
        ("POLNAXIS", "POLNAXIS= 'two'", &["POLNAXIS", "two"]),
        ("POLNAXIS", "", &["POLNAXIS"]),
        ("POLNGRP", "POLNGRP = 2", &["POLNGRP", "groups"]),
        ("POLNGRP", "", &["POLNGRP"]),
        ("POLGRP2", "POLGRP2 = 2", &["POLGRP2"]),
        (
            "POLNAME1",
            "POLNAME1= 'MAG_AUTO'",
            &["POLNAME1", "MAG_AUTO", "not supported"],
        ),
        ("POLNAME1", "POLNAME1= 'Y_IMAGE'", &["POLNAME1", "Y_IMAGE"]),
        ("POLNAME1", "POLNAME1= 'X2_IMAGE'", &["POLNAME1", "X2_IMAGE"]),
        ("POLNAME2", "POLNAME2= 'Y_WORLD'", &["POLNAME2", "Y_WORLD"]),
        ("POLNAME2", "", &["POLNAME2"]),
        ("POLZERO1", "", &["POLZERO1"]),
        ("POLZERO2", "POLZERO2= 'zero'", &["POLZERO2", "number"]),
        ("POLSCAL1", "POLSCAL1= 0.0", &["POLSCAL1"]),
        ("POLSCAL2", "POLSCAL2= NAN", &["POLSCAL2"]),
        ("POLDEG1", "POLDEG1 = 2", &["PSFAXIS3", "(d+1)(d+2)/2", "got 3"]),
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
    // A third coordinate, such as a colour.
    let cards = changed(cards(), "POLNAXIS", "POLNAXIS= 3");
    let cards = changed(cards, "POLNAME3", "POLNAME3= 'MAG_AUTO'");
    let bytes = with_primary(&[extension("PSF_DATA", &cards, "60E", &f32s(&values()))]);
    let text = chain(&read_psfex(scratch.put("colour.psf", &bytes), None).unwrap_err());
    assert!(
        text.contains("POLNAME3") && text.contains("MAG_AUTO") && text.contains("position"),
        "{text}"
    );
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
    spoilt.extend(without(&whole, &NEEDED));
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
