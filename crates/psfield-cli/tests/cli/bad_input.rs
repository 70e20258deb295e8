//! Bad files are refused by name, with the place and the remedy, and nothing is written.

use crate::desk::{Desk, STAMP};

/// Bytes of a FITS block.
const BLOCK: usize = 2880;
/// Bytes of a header card.
const CARD: usize = 80;
const DOUBLE: usize = 8;

/// Returns the first byte of the data of the HDU that begins at `start`.
fn data_of(bytes: &[u8], start: usize) -> usize {
    let cards = bytes[start..].chunks(CARD);
    let end = cards
        .into_iter()
        .position(|card| card.starts_with(b"END "))
        .unwrap();
    start + ((end + 1) * CARD).next_multiple_of(BLOCK)
}

/// Where the rows of the table of positions begin, in a file of so many samples.
fn table_of(bytes: &[u8], samples: usize) -> usize {
    let cube = samples * STAMP * STAMP * DOUBLE;
    data_of(bytes, data_of(bytes, 0) + cube.next_multiple_of(BLOCK))
}

fn put(bytes: &mut [u8], at: usize, value: f64) {
    bytes[at..at + DOUBLE].copy_from_slice(&value.to_be_bytes());
}

fn get(bytes: &[u8], at: usize) -> f64 {
    f64::from_be_bytes(bytes[at..at + DOUBLE].try_into().unwrap())
}

/// Checks that all commands that read samples refuse `bad.fits`.
fn bad_samples(needles: &[&str], spoil: impl FnOnce(&mut Vec<u8>)) {
    let desk = Desk::new();
    let mut bytes = desk.bytes("samples.fits");
    spoil(&mut bytes);
    desk.write("bad.fits", bytes);
    desk.write("at.csv", "x,y\n3,4\n");
    let needles: Vec<&str> = needles.iter().copied().chain(["bad.fits"]).collect();
    for command in [
        "fit bad.fits -o out.fits",
        "simulate scene.fits --psf bad.fits -o out.fits",
        "evaluate bad.fits --at at.csv -o out.fits",
        "measure bad.fits -o out.csv",
    ] {
        desk.refused(command, 1, &needles);
    }
}

/// A device or a pipe in place of a file of settings may never end.
#[cfg(unix)]
#[test]
fn settings_are_read_from_files_alone() {
    // In a folder of their own, because the test compares all files of the other one.
    let (desk, endless) = (Desk::new(), Desk::empty());
    endless.shell("mkfifo pipe.toml; ln -s /dev/zero zero.toml");
    for name in ["pipe.toml", "zero.toml"] {
        let path = endless.path(name);
        let path = path.display();
        for command in [
            format!("series {path} -o out"),
            format!("batch {path}"),
            format!("simulate scene.fits --psf samples.fits --detector {path} -o x.fits"),
            format!("expose scene.fits --detector {path} -o x.fits"),
            format!("sample {path} -o x.fits"),
        ] {
            desk.refused(&command, 1, &[name, "not a regular file"]);
        }
    }
}

#[test]
fn truncated_samples() {
    bad_samples(&["cut short", "HDU 0"], |bytes| bytes.truncate(BLOCK * 3));
    bad_samples(&["cut short", "HDU 1"], |bytes| {
        let end = table_of(bytes, 9) + 10;
        bytes.truncate(end);
    });
    bad_samples(&["cut short"], |bytes| bytes.truncate(CARD * 2));
}

#[test]
fn non_finite_samples() {
    for (value, name) in [
        (f64::NAN, "NaN"),
        (f64::INFINITY, "inf"),
        (f64::NEG_INFINITY, "-inf"),
    ] {
        bad_samples(&[name, "[2, 1, 4]"], |bytes| {
            let pixel = (2 * STAMP + 1) * STAMP + 4;
            let at = data_of(bytes, 0) + pixel * DOUBLE;
            put(bytes, at, value);
        });
    }
}

#[test]
fn stamps_without_flux() {
    for factor in [0.0, -1.0] {
        bad_samples(&["sample 3", "positive flux"], |bytes| {
            let first = data_of(bytes, 0) + 3 * STAMP * STAMP * DOUBLE;
            for pixel in 0..STAMP * STAMP {
                let at = first + pixel * DOUBLE;
                let value = get(bytes, at) * factor;
                put(bytes, at, value);
            }
        });
    }
}

#[test]
fn positions_that_do_not_fit() {
    bad_samples(&["POSITIONS", "8", "9"], |bytes| {
        let table = table_of(bytes, 9);
        let card = b"NAXIS2  =                    9";
        let header = table - BLOCK;
        let at = bytes[header..]
            .windows(card.len())
            .position(|w| w == card)
            .unwrap();
        bytes[header + at + card.len() - 1] = b'8';
    });
    bad_samples(&["samples 0 and 5", "share the position"], |bytes| {
        let table = table_of(bytes, 9);
        put(bytes, table + 5 * 2 * DOUBLE, 0.0);
        put(bytes, table + (5 * 2 + 1) * DOUBLE, 0.0);
    });
    bad_samples(&["sample 7", "outside the field", "61 x 51"], |bytes| {
        let table = table_of(bytes, 9);
        put(bytes, table + 7 * 2 * DOUBLE, 62.0);
    });
    bad_samples(&["row 7", "X", "NaN"], |bytes| {
        let table = table_of(bytes, 9);
        put(bytes, table + 7 * 2 * DOUBLE, f64::NAN);
    });
}

#[test]
fn bad_keywords_of_samples() {
    bad_samples(&["OVERSAMP", "HDU 0"], |bytes| {
        let key = b"OVERSAMP=";
        let at = bytes.windows(key.len()).position(|w| w == key).unwrap();
        bytes[at + key.len()..at + CARD].fill(b' ');
        bytes[at + key.len() + 1..at + key.len() + 6].copy_from_slice(b"'two'");
    });
}

#[test]
fn bad_scenes() {
    let desk = Desk::new();
    let good = desk.bytes("scene.fits");
    let simulate = "simulate bad.fits --psf samples.fits -o out.fits";
    for (value, name) in [(f64::NAN, "NaN"), (f64::INFINITY, "inf")] {
        let mut bytes = good.clone();
        put(&mut bytes, data_of(&good, 0) + (12 * 61 + 5) * DOUBLE, value);
        desk.write("bad.fits", bytes);
        desk.refused(simulate, 1, &["bad.fits", name, "[12, 5]", "1 pixel", "--nan-as"]);
        desk.refused(
            &format!("{simulate} --stream"),
            1,
            &["bad.fits", "[12, 5]", "--nan-as"],
        );
        desk.refused("compare scene.fits bad.fits", 1, &["bad.fits", name, "[12, 5]"]);
        desk.refused("measure bad.fits -o out.csv", 1, &["bad.fits", name]);
    }
    desk.write("bad.fits", &good[..good.len() - BLOCK]);
    desk.refused(simulate, 1, &["bad.fits", "cut short"]);
    desk.write("bad.fits", "a scene");
    desk.refused(simulate, 1, &["bad.fits", "not a FITS file"]);
    desk.write("bad.fits", "");
    desk.refused(simulate, 1, &["bad.fits"]);
    desk.refused(
        "simulate none.fits --psf samples.fits -o out.fits",
        1,
        &["none.fits", "cannot read"],
    );
    desk.refused(
        "simulate scene.fits --psf none.fits -o out.fits",
        1,
        &["none.fits", "cannot read"],
    );
    desk.refused(
        "simulate samples.fits --psf samples.fits -o out.fits",
        1,
        &["samples.fits", "[9, 15, 15]"],
    );
    desk.refused(
        "simulate scene.fits --psf scene.fits -o out.fits",
        1,
        &["scene.fits", "POSITIONS"],
    );
}

#[test]
fn bad_tables() {
    let desk = Desk::new();
    let catalogue = "simulate --catalog bad.csv --shape 61,51 --psf samples.fits -o out.fits";
    let positions = "evaluate samples.fits --at bad.csv -o out.fits";
    for (content, needles) in [
        ("x,y,flux\n1,2,3\n4,here,6\n", ["line 3", "y", "\"here\""]),
        ("x,y,flux\n1,2,3\n4,nan,6\n", ["line 3", "y", "missing or NaN"]),
        ("x,y,flux\n1,2,3\n4,5\n", ["line 3", "2 fields", "3"]),
        ("a,y,flux\n1,2,3\n", ["column", "\"x\"", "\"a\""]),
    ] {
        desk.write("bad.csv", content);
        let needles: Vec<&str> = needles.into_iter().chain(["bad.csv"]).collect();
        desk.refused(catalogue, 1, &needles);
        desk.refused(positions, 1, &needles);
        desk.refused("measure scene.fits --at bad.csv -o out.csv", 1, &needles);
    }
    desk.write("bad.csv", "x,y,flux\n1,2,inf\n");
    desk.refused(catalogue, 1, &["bad.csv", "line 2", "flux", "\"inf\""]);
    desk.write("bad.csv", "x,y,flux,re,n\n1,2,3,,1\n");
    desk.refused(
        catalogue,
        1,
        &["bad.csv", "line 2", "half-light radius", "--skip-invalid"],
    );
    desk.write("bad.csv", "x,y\n1,2\n");
    desk.refused(catalogue, 1, &["bad.csv", "\"flux\""]);
    desk.write("bad.csv", "x,y\n1,2\n62,3\n");
    desk.refused(
        positions,
        1,
        &["bad.csv", "position 1", "outside the field", "61 x 51"],
    );
    desk.write("bad.csv", "x,y\n1,2\n5,6\n1,2\n");
    desk.refused(positions, 1, &["bad.csv", "positions 0 and 2", "(1, 2)"]);
    desk.write("bad.csv", "x,y\n");
    desk.refused(positions, 1, &["bad.csv", "no positions"]);
    desk.refused(
        "measure scene.fits --at none.csv -o out.csv",
        1,
        &["none.csv", "cannot read"],
    );
}

#[test]
fn outputs_that_cannot_be_written() {
    let desk = Desk::new();
    desk.write("at.csv", "x,y\n3,4\n");
    desk.write("there.fits", "kept");
    for command in [
        "fit samples.fits",
        "simulate scene.fits --psf samples.fits",
        "evaluate samples.fits --at at.csv",
        "measure samples.fits",
        "sample --preset survey-2m",
    ] {
        desk.refused(
            &format!("{command} -o there.fits"),
            1,
            &["there.fits", "exists", "--overwrite"],
        );
        desk.refused(
            &format!("{command} -o none/out.fits"),
            1,
            &["none/out.fits", "no directory none"],
        );
        desk.refused(&format!("{command} -o ."), 1, &["not a regular file"]);
    }
}
