//! Findings of fuzzing: files for which CFITSIO would take unbounded memory, leave its buffers
//! uninitialised, or write beyond them.

mod support;

use std::io::Write;

use flate2::Compression;
use flate2::write::GzEncoder;
use psf_io::{IoError, IoErrorKind, Place, read_image};
use support::mutations::{assert_refused, replaced, with_value};
use support::{IMAGE, SIMPLE, Scratch, f64s, hdu, i16s, i32s, image, table};

/// Pixels per row. The images here have two tiles of 4 pixels.
const NX: usize = 4;
const NY: usize = 2;

/// A compressed image: its own cards, the columns, the rows of descriptors, and the heap.
fn tiled(bitpix: i32, algorithm: &str, columns: &[(&str, &str)], rows: &[u8], heap: &[u8]) -> Vec<u8> {
    let mut cards = vec![
        "XTENSION= 'BINTABLE'".to_owned(),
        "BITPIX  = 8".to_owned(),
        "NAXIS   = 2".to_owned(),
        format!("NAXIS1  = {}", rows.len() / NY),
        format!("NAXIS2  = {NY}"),
        format!("PCOUNT  = {}", heap.len()),
        "GCOUNT  = 1".to_owned(),
        format!("TFIELDS = {}", columns.len()),
    ];
    for (i, (name, form)) in columns.iter().enumerate() {
        cards.push(format!("TTYPE{}  = '{name}'", i + 1));
        cards.push(format!("TFORM{}  = '{form}'", i + 1));
    }
    cards.extend([
        "ZIMAGE  = T".to_owned(),
        format!("ZBITPIX = {bitpix}"),
        "ZNAXIS  = 2".to_owned(),
        format!("ZNAXIS1 = {NX}"),
        format!("ZNAXIS2 = {NY}"),
        format!("ZTILE1  = {NX}"),
        "ZTILE2  = 1".to_owned(),
        format!("ZCMPTYPE= '{algorithm}'"),
    ]);
    if algorithm == "RICE_1" {
        cards.push("ZVAL1   = 32".to_owned());
    }
    let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
    let mut bytes = image(SIMPLE, 8, &[], &["EXTEND  = T"], &[]);
    bytes.extend(hdu(&cards, &[rows, heap].concat()));
    bytes
}

const COMPRESSED: (&str, &str) = ("COMPRESSED_DATA", "1PB");

/// An image of two tiles with equal content.
fn twice(bitpix: i32, algorithm: &str, tile: &[u8], elements: usize) -> Vec<u8> {
    let count = elements as i32;
    let rows = i32s(&[count, 0, count, tile.len() as i32]);
    tiled(bitpix, algorithm, &[COMPRESSED], &rows, &tile.repeat(2))
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn zipped(bitpix: i32, tile: &[u8]) -> Vec<u8> {
    let tile = gzip(tile);
    twice(bitpix, "GZIP_1", &tile, tile.len())
}

fn values(bytes: &[u8]) -> Result<Vec<f64>, IoError> {
    let scratch = Scratch::new();
    let read = read_image::<f64>(scratch.put("a.fits", bytes))?;
    Ok(read.image().pixels().iter().copied().collect())
}

fn is_a_broken_tile(bytes: &[u8], which: usize) -> bool {
    let place = Place::Tile { hdu: 1, tile: which };
    values(bytes).is_err_and(|error| error.kind() == IoErrorKind::Damaged && error.place() == Some(&place))
}

/// A list of `PLIO_1` with four pixels of value 5.
const FIVES: [i16; 9] = [0, 7, -100, 9, 0, 0, 0, 0x2004, 0x4004];

#[test]
fn keywords_of_tiles_have_one_value() {
    let file = twice(8, "RICE_1", &[0; 16], 16);
    // CFITSIO reads the second of these cards, and would divide by 0.
    let mut card = b"ZTILE1  = nan".to_vec();
    card.resize(80, b' ');
    let end = file.windows(8).rposition(|word| word == b"ZVAL1   ").unwrap();
    let mut spoilt = file.clone();
    spoilt[end..end + 80].copy_from_slice(&card);
    let error = values(&spoilt).unwrap_err();
    let place = Place::Keyword {
        hdu: 1,
        keyword: "ZTILE1".to_owned(),
    };
    assert_eq!(error.place(), Some(&place), "{error}");
    assert!(error.to_string().contains("several cards"), "{error}");

    // Other keywords may occur twice.
    let mut other = file;
    let mut card = b"TELTEMP = 12.1".to_vec();
    card.resize(80, b' ');
    let last = other.windows(4).rposition(|word| word == b"END ").unwrap();
    let mut cards = card.clone();
    card[12] = b'2';
    cards.extend(card);
    other[last..last + 160].copy_from_slice(&cards);
    other[last + 160..last + 163].copy_from_slice(b"END");
    assert!(!matches!(values(&other), Err(error) if error.to_string().contains("TELTEMP")));
}

#[test]
fn the_files_of_these_tests_are_sound_if_unchanged() {
    let pixels: Vec<f64> = [1.0, -2.0, 3.0, 4.0].repeat(NY);
    assert_eq!(values(&zipped(32, &i32s(&[1, -2, 3, 4]))).unwrap(), pixels);
    assert_eq!(values(&zipped(16, &i16s(&[1, -2, 3, 4]))).unwrap(), pixels);
    assert_eq!(
        values(&zipped(-64, &f64s(&[1.0, -2.0, 3.0, 4.0]))).unwrap(),
        pixels
    );
    let list = with_value(
        &twice(16, "PLIO_1", &i16s(&FIVES), FIVES.len()),
        "TFORM1",
        "'1PI'",
    );
    assert_eq!(values(&list.bytes).unwrap(), [5.0; NX * NY]);
}

#[test]
fn tiles_that_unpack_to_a_wrong_length_are_refused() {
    // With eight bytes per whole number CFITSIO would leave the pixels uninitialised. The other
    // streams would give wrong numbers.
    for bytes in [
        zipped(32, &i32s(&[1; 2 * NX])),
        zipped(32, &i16s(&[1; NX])),
        zipped(16, &i32s(&[1; NX])),
        zipped(8, &i16s(&[1; NX])),
        // Unquantised floats of half the length: CFITSIO would read doubles beyond its buffer.
        zipped(-64, &i16s(&[1; NX])),
        zipped(-32, &[1; NX]),
        zipped(32, &vec![0; 1 << 20]),
        twice(32, "GZIP_1", b"no gzip", 7),
    ] {
        assert!(is_a_broken_tile(&bytes, 0));
    }
}

#[test]
fn other_columns_must_hold_all_pixels_of_a_tile() {
    let columns = [COMPRESSED, ("UNCOMPRESSED_DATA", "1PD")];
    let of = |count: i32| {
        let rows = i32s(&[0, 0, 4, 0, 0, 0, count, 32]);
        tiled(-64, "GZIP_1", &columns, &rows, &f64s(&[0.5; 1000]))
    };
    assert_eq!(values(&of(4)).unwrap(), [0.5; NX * NY]);
    for count in [0, 3, 5, 900] {
        assert!(is_a_broken_tile(&of(count), 1), "{count}");
    }

    let columns = [COMPRESSED, ("GZIP_COMPRESSED_DATA", "1PB")];
    let of = |bitpix: i32, tile: &[u8]| {
        let tile = gzip(tile);
        let count = tile.len() as i32;
        let rows = i32s(&[0, 0, count, 0, 0, 0, count, 0]);
        tiled(bitpix, "GZIP_2", &columns, &rows, &tile)
    };
    assert_eq!(values(&of(-64, &f64s(&[0.5; NX]))).unwrap(), [0.5; NX * NY]);
    // The data are half as long as needed: CFITSIO would follow a null pointer.
    assert!(is_a_broken_tile(&of(-64, &i32s(&[1; NX])), 0));
    assert!(is_a_broken_tile(&of(32, &i32s(&[1; NX])), 0));
}

#[test]
fn lists_and_blocks_without_pixels_are_refused() {
    let empty = [0, 7, -100, 0, 0, 0, 0];
    let list = twice(16, "PLIO_1", &i16s(&empty), empty.len());
    assert!(is_a_broken_tile(&with_value(&list, "TFORM1", "'1PI'").bytes, 0));
    let block = twice(32, "RICE_1", &[0; 5], 5);
    assert_eq!(values(&block).unwrap(), [0.0; NX * NY]);
    // The pixels need one block more than the bytes hold. Then floats that are not quantised.
    let wide = with_value(&block, "ZNAXIS1", "1000").bytes;
    assert!(is_a_broken_tile(&with_value(&wide, "ZTILE1", "1000").bytes, 0));
    assert!(is_a_broken_tile(&twice(-32, "RICE_1", &[0; 40], 40), 0));
    // The tile lies beyond the heap.
    assert!(is_a_broken_tile(&twice(32, "RICE_1", &[0; 4], 1 << 30), 0));
}

#[test]
fn blocks_of_rice_that_end_too_early_are_refused() {
    // CFITSIO would read beyond each tile. The tiles end before the bit 1 of a difference (found by
    // fuzzing), before a code, in the first pixel, and in low bits.
    for tile in [
        &[0, 0, 0, 0x30, 0x10][..],
        &[0; 4],
        &[0],
        &[0, 0, 0, 0, 0xc8, 0, 0],
    ] {
        assert!(
            is_a_broken_tile(&twice(32, "RICE_1", tile, tile.len()), 0),
            "{tile:?}"
        );
    }
}

#[test]
fn tiles_that_cfitsio_would_convert_are_refused() {
    let block = twice(32, "RICE_1", &[0; 5], 5);
    let list = with_value(
        &twice(16, "PLIO_1", &i16s(&FIVES), FIVES.len()),
        "TFORM1",
        "'1PI'",
    )
    .bytes;
    let zip = zipped(32, &i32s(&[1; NX]));
    let mut mutations = vec![with_value(&list, "TFORM1", "'1PB'")];
    for (tile, form) in [
        (&block, "'1PI'"),
        (&zip, "'1PI'"),
        (&zip, "'1PJ'"),
        (&block, "'1P'"),
    ] {
        mutations.push(with_value(tile, "TFORM1", form));
    }
    for card in ["TSCAL1  = 2.0", "TZERO1  = -128", "TZERO1  = 'no'"] {
        // Replaces a card that may be absent.
        mutations.extend([&block, &list, &zip].map(|good| replaced(good, "ZTILE2", card)));
    }
    assert_refused(mutations, |path| read_image::<f32>(path));
    let neutral = replaced(&block, "ZTILE2", "TSCAL1  = 1.0").bytes;
    assert_eq!(values(&neutral).unwrap(), [0.0; NX * NY]);
}

#[test]
fn headers_that_cfitsio_does_not_check_are_refused() {
    let good = zipped(32, &i32s(&[1; NX]));
    let mut mutations = vec![
        with_value(&good, "ZBITPIX", "64"),
        with_value(&good, "TFORM1", "'2PB'"),
        with_value(&good, "TFORM1", "'8B'"),
        with_value(&good, "TTYPE1", "'PIXELS'"),
        // Replaces cards that may be absent.
        replaced(&good, "ZTILE2", "ZQUANTIZ= 'NONE'"),
    ];
    for count in ["16777216", "1000", "-1", "2"] {
        mutations.push(with_value(&good, "TFIELDS", count));
    }
    // The table with too many columns precedes the image and is not read.
    let mut second = image(SIMPLE, 8, &[], &[], &[]);
    second.extend(table("T", &[("x", "I")], 1, &[], &i16s(&[1])));
    second.extend(image(IMAGE, 16, &[1], &[], &i16s(&[1])));
    mutations.push(with_value(&second, "TFIELDS", "99999999"));
    // An image whose axes claim pixels that no group holds.
    let mut none = image(SIMPLE, 8, &[], &[], &[]);
    none.extend(image(IMAGE, 8, &[2_147_483_648, 21], &[], &[]));
    mutations.push(with_value(&none, "GCOUNT", "0"));
    assert_refused(mutations, |path| read_image::<f32>(path));
}
