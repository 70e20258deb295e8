//! Reading catalogues and positions.

mod support;

use psf_io::{
    CatalogOptions, FileKind, IoErrorKind, detect, read_catalog, read_columns, read_positions,
    read_positions_with, write_csv,
};
use support::{SIMPLE, Scratch, assert_error, chain, f32s, f64s, hdu, i16s, i32s, image, names, table};

fn fits(tables: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = image(SIMPLE, 8, &[], &[], &[]);
    for table in tables {
        bytes.extend(table);
    }
    bytes
}

#[test]
fn the_first_table_with_the_columns_counts_whatever_their_types() {
    let scratch = Scratch::new();
    let other = table("OTHER", &[("X", "D"), ("MAG", "D")], 1, &[], &f64s(&[0.0, 0.0]));
    let row = |flux: i16, x: f32, y: i32| [i16s(&[flux]), b"star".to_vec(), f32s(&[x]), i32s(&[y])].concat();
    let columns = [("FLUX", "I"), ("NAME", "4A"), ("X", "E"), ("y", "1J")];
    let scaled = table(
        "STARS",
        &columns,
        2,
        &["TZERO1  = 32768"],
        &[row(-1, 2.5, 7), row(3, -0.5, 8)].concat(),
    );
    let path = scratch.put("stars.csv", &fits(&[other, scaled]));
    let stars = read_catalog(&path).unwrap();
    assert_eq!(stars.len(), 2);
    assert_eq!(
        (stars[0].position().x(), stars[0].position().y(), stars[0].flux()),
        (2.5, 7.0, 32767.0)
    );
    assert_eq!(read_positions(&path).unwrap()[1].x(), -0.5);
    assert_eq!(detect(&path).unwrap(), FileKind::PointTable);
}

#[test]
fn the_error_for_an_ascii_table_says_what_to_do() {
    let ascii = hdu(
        &[
            "XTENSION= 'TABLE   '",
            "BITPIX  = 8",
            "NAXIS   = 2",
            "NAXIS1  = 10",
            "NAXIS2  = 1",
            "PCOUNT  = 0",
            "GCOUNT  = 1",
            "TFIELDS = 2",
            "TTYPE1  = 'x'",
            "TBCOL1  = 1",
            "TFORM1  = 'F4.1'",
            "TTYPE2  = 'y'",
            "TBCOL2  = 6",
            "TFORM2  = 'F4.1'",
        ],
        b" 1.0  2.0 ",
    );
    let scratch = Scratch::new();
    let path = scratch.put("a.fits", &fits(&[ascii]));
    let chosen = CatalogOptions::new().with_table("1".parse().unwrap());
    for result in [read_positions(&path), read_positions_with(&path, &chosen)] {
        let error = result.unwrap_err();
        assert!(names(&error, &path) && error.to_string().contains("binary table"));
        assert_error(
            Err::<(), _>(error),
            IoErrorKind::Format,
            "HDU 1: this is an ASCII table",
        );
    }
}

#[test]
fn undefined_values_name_row_and_column() {
    let scratch = Scratch::new();
    let floats = table(
        "T",
        &[("x", "D"), ("y", "D")],
        2,
        &[],
        &f64s(&[0.0, 1.0, f64::INFINITY, 1.0]),
    );
    let whole = table(
        "T",
        &[("x", "I"), ("y", "I")],
        2,
        &["TNULL1  = -1"],
        &i16s(&[0, 1, -1, 1]),
    );
    for bytes in [floats, whole] {
        let path = scratch.put("a.fits", &fits(&[bytes]));
        let error = read_positions(&path).unwrap_err();
        assert!(
            names(&error, &path) && error.to_string().contains("row 1 (0-based), column \"x\""),
            "{error}"
        );
    }
}

#[test]
fn missing_columns_and_tables_are_named() {
    let scratch = Scratch::new();
    let path = scratch.put(
        "a.fits",
        &fits(&[table("T", &[("x", "D"), ("mag", "D")], 1, &[], &f64s(&[0.0; 2]))]),
    );
    let part = "column \"y\": there is no such column, but positions need x and y, or ra and dec. The columns are \"x\", \"mag\"";
    assert_error(read_catalog(&path), IoErrorKind::Table, part);
    let path = scratch.put("b.fits", &fits(&[]));
    assert_error(
        read_positions(&path),
        IoErrorKind::Format,
        "the file has no binary table",
    );
    let path = scratch.put("c.csv", b"x,y\n1,2\n");
    let error = chain(&read_catalog(&path).unwrap_err());
    assert!(error.contains("\"flux\"") && error.contains("c.csv"), "{error}");
    assert_eq!(detect(&path).unwrap(), FileKind::NotFits);
}

#[test]
fn text_tables_come_back() {
    let scratch = Scratch::new();
    let path = scratch.path("stars.fits");
    let rows = [(1.0 / 3.0, -2.0, 1e-7), (4.0, 5e10, 6.0)];
    write_csv(&path, &["X", "Y", "Flux"], rows, false).unwrap();
    let stars = read_catalog(&path).unwrap();
    let back: Vec<_> = stars
        .iter()
        .map(|s| (s.position().x(), s.position().y(), s.flux()))
        .collect();
    assert_eq!(back, rows);
    assert_eq!(read_columns(&path, ["flux"]).unwrap(), [vec![1e-7, 6.0]]);
}

#[test]
fn lines_may_end_in_a_carriage_return_only() {
    let scratch = Scratch::new();
    for text in ["x,y\r1,2\r3,4\r", "x y\r1 2\r3 4", "x,y\r\n1,2\r\n3,4\r\n"] {
        let path = scratch.put("a.csv", text.as_bytes());
        let found = read_positions(&path).unwrap();
        let found: Vec<_> = found.iter().map(|p| (p.x(), p.y())).collect();
        assert_eq!(found, [(1.0, 2.0), (3.0, 4.0)], "{text:?}");
    }
}

#[test]
fn empty_tables_are_no_error() {
    let scratch = Scratch::new();
    assert!(
        read_catalog(scratch.put("a.csv", b"x,y,flux\n"))
            .unwrap()
            .is_empty()
    );
    // NAXIS1 is 16 although the table has no rows.
    let bytes = String::from_utf8(fits(&[table("T", &[("x", "D"), ("y", "D")], 0, &[], &[])])).unwrap();
    let bytes = bytes.replace("NAXIS1  = 0 ", "NAXIS1  = 16");
    assert!(
        read_positions(scratch.put("a.fits", bytes.as_bytes()))
            .unwrap()
            .is_empty()
    );
}

#[test]
fn forged_row_counts_take_no_memory() {
    let scratch = Scratch::new();
    let forged = |from: &str, to: &str| {
        let bytes = fits(&[table("T", &[("x", "D"), ("y", "D")], 1, &[], &[])]);
        let text = String::from_utf8(bytes).unwrap().replace(from, to);
        read_positions(scratch.put("a.fits", text.as_bytes()))
    };
    // If rows have no bytes, any number of them fits in the file.
    let kind = |from, to| forged(from, to).unwrap_err().kind();
    assert_eq!(
        kind("NAXIS2  = 1       ", "NAXIS2  = 99999999"),
        IoErrorKind::Header
    );
    assert!(matches!(
        kind("'D' ", "'0D'"),
        IoErrorKind::Header | IoErrorKind::Table
    ));
}
