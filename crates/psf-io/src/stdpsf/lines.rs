//! The lines of the grid: positions along an axis.

use std::ops::Range;
use std::path::Path;

use crate::error::unsuitable;
use crate::library_cards::LibraryCards;
use crate::{GriddedError, IoError};

/// What stands where there is no position.
const FILLER: f64 = 9999.0;
const NUMBER_EXPECTED: &str = "a position of the grid in pixels (9999 stands for none)";
const LIST_EXPECTED: &str = "a text of positions of the grid in pixels (9999 stands for none)";

/// The positions of the lines `wanted` among the first `count`, as the file has them. `stem` is `IPSFX` or `JPSFY`.
pub(super) fn read(
    path: &Path,
    hdu: usize,
    cards: &LibraryCards<'_>,
    stem: &str,
    count: usize,
    wanted: Range<usize>,
) -> Result<Vec<f64>, IoError> {
    let mut lines = if cards.has(&list_keyword(stem, 0)) && !cards.has(&format!("{stem}01")) {
        listed(cards, stem, count)?
    } else {
        single(cards, stem, count)?
    };
    if let Some((_, keyword)) = lines.iter().find(|(value, _)| *value == FILLER) {
        return Err(cards.bad_value(
            keyword,
            "a position, since the grid has a line there",
            FILLER.to_string(),
        ));
    }
    let lines: Vec<(f64, String)> = lines.drain(wanted).collect();
    for (i, (value, second)) in lines.iter().enumerate() {
        if let Some((_, first)) = lines[..i].iter().find(|(earlier, _)| earlier == value) {
            return Err(unsuitable(path)(GriddedError::EqualLines {
                hdu,
                first: first.clone(),
                second: second.clone(),
                value: *value,
            }));
        }
    }
    Ok(lines.into_iter().map(|(value, _)| value).collect())
}

/// One card a line.
fn single(cards: &LibraryCards<'_>, stem: &str, count: usize) -> Result<Vec<(f64, String)>, IoError> {
    (1..=count)
        .map(|line| {
            let keyword = format!("{stem}{line:02}");
            Ok((cards.required_number(&keyword, NUMBER_EXPECTED)?, keyword))
        })
        .collect()
}

/// Texts of several lines each.
fn listed(cards: &LibraryCards<'_>, stem: &str, count: usize) -> Result<Vec<(f64, String)>, IoError> {
    let mut lines = Vec::new();
    let mut list = 0;
    while lines.len() < count {
        let keyword = list_keyword(stem, list);
        let text = cards
            .text(&keyword, LIST_EXPECTED)?
            .ok_or_else(|| cards.missing(&keyword, LIST_EXPECTED))?;
        for word in text.split_whitespace() {
            let value: Option<f64> = word.parse().ok().filter(|v: &f64| v.is_finite());
            let value = value.ok_or_else(|| cards.bad_value(&keyword, LIST_EXPECTED, text.clone()))?;
            lines.push((value, keyword.clone()));
        }
        list += 1;
    }
    lines.truncate(count);
    Ok(lines)
}

/// The keyword of a list: `IPSFXA5`, `IPSFXB5` ...; beyond Z there is none.
fn list_keyword(stem: &str, list: u8) -> String {
    format!("{stem}{}5", char::from(b'A'.saturating_add(list)))
}
