//! The lists of runs of `PLIO_1` tiles, checked before CFITSIO follows them: it takes their lengths on trust.
//!
//! A list is of 16-bit words (Pence et al., FITS standard 4.0, section 10.4.3): its length and the place of its first instruction in a
//! header, then instructions, one of which (`SH`, set high value) takes the word after it.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};

use crate::IoError;
use crate::columns::columns;
use crate::hdu::Hdu;
use crate::tiled::PLIO;

/// The column of tiles.
const TILES: &str = "COMPRESSED_DATA";
/// The instruction that takes the next word.
const SET_HIGH: i16 = 1;

/// Checks the lists of an image in `PLIO_1` tiles; others pass.
pub(crate) fn check(hdu: &Hdu) -> Result<(), IoError> {
    if !hdu.is_tiled() || hdu.text("ZCMPTYPE").is_none_or(|name| name.trim() != PLIO) {
        return Ok(());
    }
    let length = |keyword| {
        let value = hdu.structural(keyword, None)?;
        usize::try_from(value).map_err(|_| hdu.header_error(keyword, "must not be negative"))
    };
    let (row_bytes, rows) = (length("NAXIS1")?, length("NAXIS2")?);
    let mut place = 0;
    let mut found = None;
    for column in columns(hdu, row_bytes)? {
        if column.name.eq_ignore_ascii_case(TILES) {
            found = Some((place, column.code));
        }
        place += column.bytes().expect("columns have been added up");
    }
    let long = match found {
        Some((_, b'Q')) => true,
        Some((_, b'P')) => false,
        _ => return Err(hdu.header_error("TTYPE1", "there is no column COMPRESSED_DATA of lists")),
    };
    let place = found.map_or(0, |(place, _)| place);
    let table = row_bytes as u64 * rows as u64;
    let heap = match hdu.structural("THEAP", Some(table as i64))? {
        heap if heap >= 0 && heap as u64 >= table => heap as u64,
        _ => return Err(hdu.header_error("THEAP", "must lie behind the rows")),
    };
    let failed = |source| IoError::Read {
        path: hdu.source().path().to_owned(),
        source,
    };
    let mut file = BufReader::new(File::open(hdu.source().file()).map_err(failed)?);
    let mut read = |at: u64, bytes: &mut [u8]| {
        file.seek(SeekFrom::Start(hdu.data_start + at)).map_err(failed)?;
        file.read_exact(bytes).map_err(failed)
    };
    let mut list = Vec::new();
    for row in 0..rows {
        let mut descriptor = [0; 16];
        let width = if long { 8 } else { 4 };
        read((row * row_bytes + place) as u64, &mut descriptor[..2 * width])?;
        let number = |bytes: &[u8]| {
            bytes
                .iter()
                .fold(0_u64, |number, &byte| (number << 8) | u64::from(byte))
        };
        let words = number(&descriptor[..width]);
        let start = heap.checked_add(number(&descriptor[width..2 * width]));
        let end = start.and_then(|start| start.checked_add(words.checked_mul(2)?));
        let (Some(start), Some(_)) = (start, end.filter(|&end| end <= hdu.data_length)) else {
            return Err(broken(hdu, row));
        };
        list.resize(2 * words as usize, 0);
        read(start, &mut list)?;
        if !is_sound(&list) {
            return Err(broken(hdu, row));
        }
    }
    Ok(())
}

fn broken(hdu: &Hdu, tile: usize) -> IoError {
    IoError::Tile {
        path: hdu.source().path().to_owned(),
        hdu: hdu.index,
        tile,
    }
}

/// Whether a list stays within its words.
fn is_sound(list: &[u8]) -> bool {
    let word = |number: usize| {
        let bytes = list.get(2 * number..2 * number + 2)?;
        Some(i16::from_be_bytes([bytes[0], bytes[1]]))
    };
    let words = list.len() / 2;
    // The third word is the length in short lists, and not positive in long ones.
    let Some(short) = word(2) else {
        return false;
    };
    let length = if short > 0 {
        i64::from(short)
    } else {
        let (Some(start), Some(low), Some(high)) = (word(1), word(3), word(4)) else {
            return false;
        };
        if start < 0 {
            return false;
        }
        (i64::from(high) << 15) + i64::from(low)
    };
    // An empty list is fine.
    let Ok(length) = usize::try_from(length) else {
        return true;
    };
    let ends_open = length == words && word(words - 1).is_some_and(|last| last / 4096 == SET_HIGH);
    length <= words && !ends_open
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_that_leave_their_words_are_told() {
        let list = |words: &[i16]| {
            words
                .iter()
                .flat_map(|word| word.to_be_bytes())
                .collect::<Vec<_>>()
        };
        assert!(is_sound(&list(&[0, 7, -100, 8, 0, 0, 0, 0x4005])));
        assert!(is_sound(&list(&[0, 0, 4, 0x4005])));
        for bad in [
            &[][..],
            &[0, 7],
            &[0, 7, -100, 9, 0, 0, 0, 0x4005],
            &[0, 7, -100, 8, 1, 0, 0, 0x4005],
            &[0, -7, -100, 8, 0, 0, 0, 0x4005],
            &[0, 7, -100, 8, 0, 0, 0, 0x1005],
            &[0, 0, 5, 0x4005],
        ] {
            assert!(!is_sound(&list(bad)), "{bad:?}");
        }
    }
}
