//! Reading STDPSF libraries.

mod support;

use psf_io::{FileKind, GriddedPsf, IoError, detect, read_stdpsf, read_stdpsf_hdu};
use support::libraries::{SIZE, stdpsf, stdpsf_of};
use support::mutations::{
    assert_refused, cut, huge_sizes, not_finite, replaced, with_value, without, wrong_types,
};
use support::{Scratch, chain};

fn read(bytes: &[u8], detector: Option<usize>) -> Result<GriddedPsf, IoError> {
    read_stdpsf(Scratch::new().put("a.fits", bytes), detector)
}

/// x, y and the plane of each sample, counted from 0.
fn places(library: &GriddedPsf) -> Vec<(f64, f64, usize)> {
    let samples = library.samples();
    let plane = |i: usize| samples.stamps()[[i, SIZE / 2, SIZE / 2]] as usize - 1;
    let positions = samples.positions().as_slice().iter().enumerate();
    positions.map(|(i, p)| (p.x(), p.y(), plane(i))).collect()
}

#[test]
fn positions_count_from_0_with_x_fastest_and_fillers_are_not_read() {
    let scratch = Scratch::new();
    let path = scratch.put("a.fits", &stdpsf(3, 2));
    assert_eq!(detect(&path).unwrap(), FileKind::Stdpsf);
    let library = read_stdpsf(&path, None).unwrap();
    let expected = [
        (0.0, 0.0, 0),
        (100.0, 0.0, 1),
        (200.0, 0.0, 2),
        (0.0, 50.0, 3),
        (100.0, 50.0, 4),
        (200.0, 50.0, 5),
    ];
    assert_eq!(places(&library), expected);
    let grid = library.samples().grid();
    assert_eq!(
        (grid.oversampling(), grid.centre_x(), grid.centre_y()),
        (4.0, 2.0, 2.0)
    );
    assert!(grid.pixel_response_included());
    assert_eq!(library.detector(), None);
    assert!(library.notes().is_empty(), "{:?}", library.notes());
    assert_eq!(read_stdpsf(&path, Some(1)).unwrap(), library);
}

#[test]
fn positions_are_pixels_of_the_chosen_detector() {
    // ACS: the second detector begins at row 5 with y = 251.
    let wfc1 = read(&stdpsf(9, 10), Some(2)).unwrap();
    let found = places(&wfc1);
    assert_eq!((wfc1.detector(), found.len()), (Some("WFC1"), 45));
    assert_eq!(found[0], (0.0, 250.0 - 2048.0, 45));
    assert_eq!(found[44], (800.0, 450.0 - 2048.0, 89));
    assert!(wfc1.notes()[0].contains("2 (WFC1) of 2"), "{:?}", wfc1.notes());
    let uvis2 = places(&read(&stdpsf(7, 8), Some(1)).unwrap());
    assert_eq!(
        (uvis2.len(), uvis2[0], uvis2[27]),
        (28, (0.0, 0.0, 0), (600.0, 150.0, 27))
    );
    // WFPC2: the planetary camera is the upper right, WF2 the upper left.
    let pc = read(&stdpsf(6, 6), Some(1)).unwrap();
    assert_eq!((pc.detector(), places(&pc).len()), (Some("PC"), 9));
    assert_eq!(places(&pc)[0], (300.0 - 800.0, 150.0 - 800.0, 21));
    assert_eq!(
        places(&read(&stdpsf(6, 6), Some(2)).unwrap())[0],
        (0.0, 150.0 - 800.0, 18)
    );
    // NIRCam: B3 is the third of the upper row.
    let b3 = read(&stdpsf(20, 10), Some(7)).unwrap();
    assert_eq!((b3.detector(), places(&b3).len()), (Some("B3"), 25));
    assert_eq!(places(&b3)[0], (1000.0 - 4096.0, 250.0 - 2048.0, 110));
    assert_eq!(places(&b3)[24], (1400.0 - 4096.0, 450.0 - 2048.0, 194));
}

#[test]
fn one_of_several_detectors_must_be_chosen() {
    for detector in [None, Some(0), Some(9)] {
        let error = read(&stdpsf(20, 10), detector).unwrap_err();
        assert_eq!(error.setting(), Some("detector"));
        let error = chain(&error);
        for part in ["1 (A1)", "8 (B4)", "choose one"] {
            assert!(error.contains(part), "{error}");
        }
    }
    assert!(read(&stdpsf(3, 2), Some(2)).is_err());
}

/// 20 x 10 PSFs with positions in strings, as in NIRCam's short-wave files.
fn listed() -> Vec<String> {
    let list = |stem: &str, letter: char, first: usize, step: usize| {
        let numbers: Vec<String> = (first..first + 5).map(|i| (i * step + 1).to_string()).collect();
        format!("{stem}{letter}5 = '{}'", numbers.join("  "))
    };
    let mut cards = vec!["NXPSFS  = 20".to_owned(), "NYPSFS  = 10".to_owned()];
    cards.extend(
        "ABCD"
            .chars()
            .enumerate()
            .map(|(i, letter)| list("IPSFX", letter, 5 * i, 100)),
    );
    cards.extend(
        "AB".chars()
            .enumerate()
            .map(|(i, letter)| list("JPSFY", letter, 5 * i, 50)),
    );
    cards
}

#[test]
fn positions_may_be_in_strings() {
    let singly = read(&stdpsf(20, 10), Some(7)).unwrap();
    assert_eq!(read(&stdpsf_of(200, &listed()), Some(7)).unwrap(), singly);

    // Lists are padded with 9999, and only as many positions are read as the grid has.
    let cards = [
        "NXPSFS  = 3",
        "NYPSFS  = 2",
        "IPSFXA5 = '1 101 201 9999 9999'",
        "JPSFYA5 = '1 51 9999'",
    ];
    let cards: Vec<String> = cards.map(ToOwned::to_owned).into();
    assert_eq!(
        read(&stdpsf_of(6, &cards), None).unwrap(),
        read(&stdpsf(3, 2), None).unwrap()
    );
}

#[test]
fn bad_border_rows_are_reported_and_kept() {
    let mut bytes = stdpsf(1, 1);
    let data = bytes.len() - 2880;
    for x in 0..SIZE {
        bytes[data + 4 * x..data + 4 * x + 4].copy_from_slice(&(-0.1_f32).to_be_bytes());
    }
    let library = read(&bytes, None).unwrap();
    assert_eq!(library.notes().len(), 1, "{:?}", library.notes());
    assert!(library.notes()[0].contains("bottom") && library.notes()[0].contains("-0.1"));
    assert_eq!(library.samples().stamps()[[0, 0, 0]], f64::from(-0.1_f32));
}

#[test]
fn planes_without_flux_can_be_left_out() {
    let mut bytes = stdpsf(7, 8);
    let plane = 4 * SIZE * SIZE;
    let data = bytes.len() - (56 * plane).next_multiple_of(2880);
    // Planes 1 and 27 belong to the first detector, plane 28 to the second.
    for number in [1, 27, 28] {
        bytes[data + number * plane..data + (number + 1) * plane].fill(0);
    }
    let error = read(&bytes, Some(1)).unwrap_err();
    assert_eq!(error.setting(), Some("skip_invalid"));
    let said = "plane 1 (0-based) at (100, 0) has flux 0";
    assert!(chain(&error).contains(said), "{}", chain(&error));
    let path = Scratch::new();
    let path = path.put("a.fits", &bytes);
    let first = read_stdpsf_hdu(&path, None, Some(1), true).unwrap();
    assert_eq!((first.left_out(), first.samples().len()), (&[1, 27][..], 26));
    assert!(
        places(&first)
            .iter()
            .all(|&(.., plane)| plane != 1 && plane != 27)
    );
    assert!(
        first.notes()[1].contains("2 of 28 left out"),
        "{:?}",
        first.notes()
    );
    let second = read_stdpsf_hdu(&path, None, Some(2), true).unwrap();
    assert_eq!(second.left_out(), [28]);
}

#[test]
fn errors_name_the_card() {
    let good = stdpsf(3, 2);
    let list = stdpsf_of(200, &listed());
    let cases = [
        (with_value(&good, "IPSFX02", "9999"), "IPSFX02"),
        (with_value(&good, "JPSFY02", "9999.0"), "JPSFY02"),
        (
            with_value(&good, "IPSFX03", "101"),
            "the positions in IPSFX02 and IPSFX03 are both 101",
        ),
        (
            with_value(&good, "NXPSFs", "2"),
            "NXPSFS times NYPSFS states 2 times 2",
        ),
        (with_value(&good, "NXPSFs", "-3"), "NXPSFS"),
        (replaced(&good, "NYPSFs", "COMMENT"), "NYPSFS"),
        (replaced(&good, "JPSFY01", "COMMENT"), "JPSFY01"),
        (
            with_value(&list, "IPSFXC5", "'1001 1101 1201 1301 9999'"),
            "IPSFXC5",
        ),
        (with_value(&list, "IPSFXC5", "'1001 1101 12x1'"), "IPSFXC5"),
        (with_value(&list, "IPSFXC5", "7"), "IPSFXC5"),
        (replaced(&list, "IPSFXD5", "COMMENT"), "IPSFXD5"),
        (with_value(&list, "JPSFYB5", "'251 301'"), "JPSFYC5"),
    ];
    for (mutation, expected) in cases {
        let detector = mutation.bytes.len() > 20_000;
        let error = chain(&read(&mutation.bytes, detector.then_some(7)).unwrap_err());
        assert!(error.contains(expected), "{}: {error}", mutation.name);
    }
}

#[test]
fn damaged_files_are_refused_soon() {
    let good = stdpsf(3, 2);
    let cards = ["NXPSFs", "NYPSFs", "IPSFX01", "IPSFX03", "JPSFY02"];
    let mut all = cut(&good);
    all.extend(without(&good, &cards));
    all.extend(without(&good, &["NAXIS3", "BITPIX"]));
    all.extend(wrong_types(&good, &cards, &[]));
    all.extend(huge_sizes(&good));
    all.extend(not_finite(&good));
    all.extend(["IPSFX01", "IPSFX03", "JPSFY02"].map(|card| with_value(&good, card, "9999")));
    for size in [
        "4611686018427387904",
        "9223372036854775807",
        "99999999999999999999",
    ] {
        all.push(with_value(&good, "NXPSFs", size));
    }
    assert!(all.len() > 50, "{}", all.len());
    assert_refused(all, |path| read_stdpsf(path, None));

    let list = stdpsf_of(200, &listed());
    let mut all = cut(&list);
    all.extend(without(&list, &["IPSFXA5", "IPSFXD5", "JPSFYA5"]));
    all.extend(wrong_types(&list, &[], &["IPSFXA5", "JPSFYB5"]));
    assert_refused(all, |path| read_stdpsf(path, Some(1)));
}
