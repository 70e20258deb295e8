//! Reading STPSF libraries.

mod support;

use psf_io::{FileKind, GriddedPsf, IoError, PlaneOrder, detect, read_stpsf, read_stpsf_hdu};
use support::libraries::{SIZE, stamp, stpsf};
use support::mutations::{assert_refused, replaced, with_value, without};
use support::{SIMPLE, Scratch, chain, f32s, image};

fn read(bytes: &[u8], order: PlaneOrder) -> Result<GriddedPsf, IoError> {
    read_stpsf(Scratch::new().put("a.fits", bytes), order)
}

/// x, y and the value in the middle of each sample.
fn places(library: &GriddedPsf) -> Vec<(f64, f64, f64)> {
    let samples = library.samples();
    samples
        .positions()
        .as_slice()
        .iter()
        .enumerate()
        .map(|(i, p)| (p.x(), p.y(), samples.stamps()[[i, SIZE / 2, SIZE / 2]]))
        .collect()
}

const AS_CARDS: [(f64, f64, f64); 6] = [
    (0.0, 0.0, 1.0),
    (0.0, 10.0, 2.0),
    (0.0, 20.0, 3.0),
    (100.0, 0.0, 4.0),
    (100.0, 10.0, 5.0),
    (100.0, 20.0, 6.0),
];
const SORTED: [(f64, f64, f64); 6] = [
    (0.0, 0.0, 1.0),
    (100.0, 0.0, 2.0),
    (0.0, 10.0, 3.0),
    (100.0, 10.0, 4.0),
    (0.0, 20.0, 5.0),
    (100.0, 20.0, 6.0),
];

#[test]
fn the_stamp_grid_agrees_with_photutils() {
    let scratch = Scratch::new();
    let path = scratch.put("a.fits", &stpsf(&[]));
    assert_eq!(detect(&path).unwrap(), FileKind::Stpsf);
    let library = read_stpsf(&path, PlaneOrder::Auto).unwrap();
    let grid = library.samples().grid();
    assert_eq!(
        (grid.centre_x(), grid.centre_y(), grid.oversampling()),
        (2.0, 2.0, 2.0)
    );
    assert!(grid.pixel_response_included());
    assert_eq!(library.detector(), Some("NRCA1"));
    let first: Vec<f64> = library.samples().stamp(0).iter().copied().collect();
    assert_eq!(first, stamp(0));

    // The middle of four pixels lies between the second and the third.
    let even = image(
        SIMPLE,
        -32,
        &[4, 6],
        &["OVERSAMP= 2", "DET_YX0 = '(1023.5, 7.5)'"],
        &f32s(&[1.0; 24]),
    );
    let library = read(&even, PlaneOrder::Auto).unwrap();
    let grid = library.samples().grid();
    assert_eq!((grid.centre_x(), grid.centre_y()), (1.5, 2.5));
    assert_eq!(places(&library)[0].0, 7.5);
}

#[test]
fn the_writer_or_the_caller_decides_the_order_of_the_planes() {
    let order = |bytes: &[u8], order| {
        let library = read(bytes, order).unwrap();
        (places(&library), library.notes().join("; "))
    };
    let old = stpsf(&[]);
    let new = with_value(&old, "VERSION", "'2.0.0'").bytes;
    let marked = stpsf(&["PLANEORD= 'sorted'"]);
    let (found, note) = order(&old, PlaneOrder::Auto);
    assert!(found == AS_CARDS && note.contains("VERSION is 1.2.1"), "{note}");
    let (found, note) = order(&new, PlaneOrder::Auto);
    assert!(found == SORTED && note.contains("VERSION is 2.0.0"), "{note}");
    let (found, note) = order(&marked, PlaneOrder::Auto);
    assert!(found == SORTED && note.contains("PLANEORD"), "{note}");
    let (found, note) = order(&new, PlaneOrder::Cards);
    assert!(found == AS_CARDS && note.contains("as requested"), "{note}");
    assert_eq!(order(&old, PlaneOrder::Sorted).0, SORTED);

    let dated = |date: &str| {
        let bytes = replaced(&old, "VERSION", "COMMENT none").bytes;
        with_value(&bytes, "DATE", date).bytes
    };
    assert_eq!(
        order(&dated("'2023-12-10T23:59:59'"), PlaneOrder::Auto).0,
        AS_CARDS
    );
    assert_eq!(order(&dated("'2023-12-11'"), PlaneOrder::Auto).0, SORTED);
    let error = read(&dated("'last week'"), PlaneOrder::Auto).unwrap_err();
    assert_eq!(error.setting(), Some("plane_order"), "{error}");
    assert!(read(&dated("'last week'"), PlaneOrder::Sorted).is_ok());
}

#[test]
fn equal_orders_need_no_choice() {
    let cards = ["OVERSAMP= 1", "DET_YX1 = '(5.0, 9.0)'", "DET_YX0 = '(5.0, 1.0)'"];
    let bytes = image(SIMPLE, -32, &[4, 4, 2], &cards, &f32s(&[1.0; 32]));
    let library = read(&bytes, PlaneOrder::Auto).unwrap();
    assert_eq!(places_of(&library), [(1.0, 5.0), (9.0, 5.0)]);
    assert!(library.notes()[0].contains("one order"), "{:?}", library.notes());
}

fn places_of(library: &GriddedPsf) -> Vec<(f64, f64)> {
    let positions = library.samples().positions().as_slice();
    positions.iter().map(|p| (p.x(), p.y())).collect()
}

#[test]
fn positions_need_not_form_a_grid() {
    let bytes = with_value(&stpsf(&[]), "DET_YX4", "'(10.25, 777.5)'").bytes;
    let library = read(&bytes, PlaneOrder::Cards).unwrap();
    assert_eq!(places(&library)[4], (777.5, 10.25, 5.0));
}

#[test]
fn plane_numbers_of_three_digits_need_long_keywords() {
    let keyword = |i: usize| match i {
        0..100 => format!("{:<8}= '(0.0, {i}.0)'", format!("DET_YX{i}")),
        _ => format!("HIERARCH DET_YX{i} = '(0.0, {i}.0)'"),
    };
    let mut cards: Vec<String> = (0..121).map(keyword).collect();
    cards.push("OVERSAMP= 1".to_owned());
    let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
    let bytes = image(SIMPLE, -32, &[4, 4, 121], &cards, &f32s(&[1.0; 16 * 121]));
    let library = read(&bytes, PlaneOrder::Auto).unwrap();
    assert_eq!(places_of(&library)[120], (120.0, 0.0));
}

#[test]
fn the_sampling_that_matches_the_stamps_is_used() {
    let differing = |across: &str| {
        let bytes = stpsf(&[across]);
        with_value(&bytes, "DET_SAMP", "5").bytes
    };
    let oversampling =
        |bytes: &[u8]| read(bytes, PlaneOrder::Auto).map(|library| library.samples().grid().oversampling());
    assert_eq!(oversampling(&differing("FOVPIXEL= 1")).unwrap(), 5.0);
    let error = chain(&oversampling(&differing("FOVPIXEL= 7")).unwrap_err());
    assert!(
        error.contains("DET_SAMP") && error.contains("FOVPIXEL"),
        "{error}"
    );
    assert!(oversampling(&differing("OTHER   = 1")).is_err());
}

#[test]
fn errors_name_the_card() {
    let good = stpsf(&[]);
    let cases = [
        (without(&good, &["DET_YX3"]).remove(0), "DET_YX3"),
        (with_value(&good, "DET_YX3", "'(1.0)'"), "DET_YX3"),
        (with_value(&good, "DET_YX3", "'1.0, 2.0, 3.0'"), "DET_YX3"),
        (with_value(&good, "DET_YX3", "'(nan, 1.0)'"), "DET_YX3"),
        (with_value(&good, "DET_YX3", "7"), "DET_YX3"),
        (replaced(&good, "DET_YX3", "DET_YX2 = '(1.0, 2.0)'"), "DET_YX2"),
        (replaced(&good, "DET_YX3", "DET_YX6 = '(1.0, 2.0)'"), "DET_YX6"),
        (with_value(&good, "DET_YX3", "'(0.0, 0.0)'"), "samples 0 and 3"),
        (with_value(&good, "NUM_PSFS", "5"), "NUM_PSFS"),
        (with_value(&good, "OVERSAMP", "2.5"), "OVERSAMP"),
        (with_value(&good, "OVERSAMP", "0"), "OVERSAMP"),
        (with_value(&good, "DETECTOR", "3"), "DETECTOR"),
        (with_value(&good, "VERSION", "3"), "VERSION"),
    ];
    for (mutation, expected) in cases {
        let error = chain(&read(&mutation.bytes, PlaneOrder::Auto).unwrap_err());
        assert!(error.contains(expected), "{}: {error}", mutation.name);
    }
}

#[test]
fn a_library_without_one_of_its_cards_is_still_recognised() {
    let bytes = without(&stpsf(&[]), &["OVERSAMP"]).remove(0).bytes;
    assert_eq!(
        detect(Scratch::new().put("a.fits", &bytes)).unwrap(),
        FileKind::Stpsf
    );
    assert!(chain(&read(&bytes, PlaneOrder::Auto).unwrap_err()).contains("OVERSAMP"));
}

#[test]
fn planes_without_flux_are_named() {
    let mut file = stpsf(&[]);
    let data = file.len() - (6 * SIZE * SIZE * 8_usize).next_multiple_of(2880);
    let plane = SIZE * SIZE * 8;
    for value in file[data + 4 * plane..data + 5 * plane].chunks_mut(8) {
        // Changes the sign.
        value[0] ^= 0x80;
    }
    let whole = read(&stpsf(&[]), PlaneOrder::Auto).unwrap();
    let position = whole.samples().positions().as_slice()[4];
    let error = read(&file, PlaneOrder::Auto).unwrap_err();
    assert_eq!(error.setting(), Some("skip_invalid"));
    let said = format!("plane 4 (0-based) at {position} has flux -");
    assert!(chain(&error).contains(&said), "{}", chain(&error));

    // Without the bad plane, the others are those of the good file.
    let scratch = Scratch::new();
    let skipping = |bytes: &[u8]| read_stpsf_hdu(scratch.put("a.fits", bytes), None, PlaneOrder::Auto, true);
    let library = skipping(&file).unwrap();
    assert_eq!((library.left_out(), library.samples().len()), (&[4][..], 5));
    assert!(
        library.notes().iter().any(|note| note.contains(&said)),
        "{:?}",
        library.notes()
    );
    let mut expected = places_of(&whole);
    expected.remove(4);
    assert_eq!(places_of(&library), expected);
    assert_eq!(library.samples().stamp(4), whole.samples().stamp(5));
    assert_eq!(skipping(&stpsf(&[])).unwrap(), whole);

    for value in file[data..data + 6 * plane].chunks_mut(8) {
        value.fill(0);
    }
    let error = skipping(&file).unwrap_err();
    assert_eq!(error.setting(), None);
    assert!(
        chain(&error).contains("No plane of the library has positive flux"),
        "{}",
        chain(&error)
    );
}

#[test]
fn damaged_files_are_refused_soon() {
    use support::mutations::{cut, huge_sizes, not_finite, wrong_types};
    let good = stpsf(&[]);
    let mut all = cut(&good);
    all.extend(without(
        &good,
        &["OVERSAMP", "DET_YX0", "DET_YX5", "NAXIS3", "BITPIX"],
    ));
    all.extend(wrong_types(
        &good,
        &["OVERSAMP", "DET_SAMP", "NUM_PSFS"],
        &["DET_YX0", "DET_YX5", "DETECTOR", "VERSION"],
    ));
    all.extend(huge_sizes(&good));
    all.extend(not_finite(&good));
    all.push(with_value(&good, "NAXIS3", "5"));
    all.push(with_value(&good, "DET_YX5", "'(9999, 9999, 9999)'"));
    all.push(with_value(&good, "NUM_PSFS", "4611686018427387904"));
    all.push(replaced(&good, "DET_YX5", "DET_YX99= '(1.0, 2.0)'"));
    assert!(all.len() > 60, "{}", all.len());
    assert_refused(all, |path| read_stpsf(path, PlaneOrder::Auto));
}
