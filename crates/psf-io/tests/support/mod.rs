//! FITS files made byte by byte, independent of the crate's own writer.
#![allow(dead_code, reason = "each test file uses a part")]

pub(crate) mod libraries;
pub(crate) mod mutations;

use std::path::{Path, PathBuf};

use psf_io::{IoError, IoErrorKind};

/// A directory for the files of one test.
pub(crate) struct Scratch(tempfile::TempDir);

impl Scratch {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes the bytes to a file.
    pub(crate) fn put(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

/// Bytes padded to whole blocks.
fn blocks(mut bytes: Vec<u8>, fill: u8) -> Vec<u8> {
    bytes.resize(bytes.len().next_multiple_of(2880), fill);
    bytes
}

/// An HDU from its cards (without END) and its data.
pub(crate) fn hdu(cards: &[&str], data: &[u8]) -> Vec<u8> {
    let mut header = Vec::new();
    for card in cards.iter().chain(&["END"]) {
        header.extend(format!("{card:<80}").bytes());
    }
    let mut bytes = blocks(header, b' ');
    bytes.extend(blocks(data.to_vec(), 0));
    bytes
}

/// An image HDU: `axes` with NAXIS1 first, then further cards.
pub(crate) fn image(first_card: &str, bitpix: i32, axes: &[usize], cards: &[&str], data: &[u8]) -> Vec<u8> {
    let mut all = vec![
        first_card.to_owned(),
        format!("BITPIX  = {bitpix}"),
        format!("NAXIS   = {}", axes.len()),
    ];
    all.extend(
        axes.iter()
            .enumerate()
            .map(|(i, n)| format!("{:<8}= {n}", format!("NAXIS{}", i + 1))),
    );
    if first_card.starts_with("XTENSION") {
        all.extend(["PCOUNT  = 0".to_owned(), "GCOUNT  = 1".to_owned()]);
    }
    all.extend(cards.iter().map(ToString::to_string));
    hdu(&all.iter().map(String::as_str).collect::<Vec<_>>(), data)
}

pub(crate) const SIMPLE: &str = "SIMPLE  = T";
pub(crate) const IMAGE: &str = "XTENSION= 'IMAGE   '";

/// A binary table of columns (name, TFORM). `data` holds its rows as bytes.
pub(crate) fn table(
    name: &str,
    columns: &[(&str, &str)],
    rows: usize,
    cards: &[&str],
    data: &[u8],
) -> Vec<u8> {
    let mut all = vec![
        "XTENSION= 'BINTABLE'".to_owned(),
        "BITPIX  = 8".to_owned(),
        "NAXIS   = 2".to_owned(),
        format!("NAXIS1  = {}", data.len().checked_div(rows).unwrap_or(0)),
        format!("NAXIS2  = {rows}"),
        "PCOUNT  = 0".to_owned(),
        "GCOUNT  = 1".to_owned(),
        format!("TFIELDS = {}", columns.len()),
        format!("EXTNAME = '{name}'"),
    ];
    for (i, (name, form)) in columns.iter().enumerate() {
        all.push(format!("{:<8}= '{name}'", format!("TTYPE{}", i + 1)));
        all.push(format!("{:<8}= '{form}'", format!("TFORM{}", i + 1)));
    }
    all.extend(cards.iter().map(ToString::to_string));
    hdu(&all.iter().map(String::as_str).collect::<Vec<_>>(), data)
}

/// Big-endian bytes, as in FITS.
macro_rules! big_endian {
    ($name:ident, $type:ty) => {
        pub(crate) fn $name(values: &[$type]) -> Vec<u8> {
            values.iter().flat_map(|v| v.to_be_bytes()).collect()
        }
    };
}

big_endian!(i16s, i16);
big_endian!(i32s, i32);
big_endian!(i64s, i64);
big_endian!(f32s, f32);
big_endian!(f64s, f64);

/// The text of an error and of all its causes.
pub(crate) fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(e) = cause {
        text = format!("{text}: {e}");
        cause = e.source();
    }
    text
}

/// Asserts the kind of an error, and that its text or that of a cause contains a part.
#[track_caller]
pub(crate) fn assert_error<T>(result: Result<T, IoError>, kind: IoErrorKind, part: &str) {
    let error = result.map(drop).unwrap_err();
    assert!(
        error.kind() == kind && chain(&error).contains(part),
        "{kind:?}, {part}: {error:?}"
    );
}

/// Returns whether the text of an error names the file.
pub(crate) fn names(error: &IoError, path: &Path) -> bool {
    error.path() == path && error.to_string().contains(&*path.to_string_lossy())
}
