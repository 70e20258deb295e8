//! Cards of PSF libraries, among them those with a number in their keyword.

use std::collections::HashMap;
use std::path::Path;

use crate::card::Card;
use crate::error::unsuitable;
use crate::hdu::Hdu;
use crate::{CardValue, GriddedError, IoError};

/// The header of an HDU, read by keywords that are made at run time.
///
/// Upper and lower case are the same: real STDPSF files have `NXPSFs`.
#[derive(Debug)]
pub(crate) struct LibraryCards<'a> {
    path: &'a Path,
    hdu: usize,
    /// The first card of each keyword. A table, since headers may be long and the keywords asked for many.
    cards: HashMap<String, &'a Card>,
}

impl<'a> LibraryCards<'a> {
    pub(crate) fn new(path: &'a Path, hdu: &'a Hdu) -> Self {
        let mut cards = HashMap::new();
        for card in &hdu.header {
            cards.entry(card.keyword().to_ascii_uppercase()).or_insert(card);
        }
        Self {
            path,
            hdu: hdu.index,
            cards,
        }
    }

    /// The value, turned by `convert` into what is expected.
    fn optional<T>(
        &self,
        keyword: &str,
        expected: &'static str,
        convert: impl FnOnce(CardValue) -> Option<T>,
    ) -> Result<Option<T>, IoError> {
        let Some(card) = self.cards.get(keyword) else {
            return Ok(None);
        };
        match card.value().and_then(convert) {
            Some(value) => Ok(Some(value)),
            None => Err(self.bad(keyword, expected, card)),
        }
    }

    /// A finite number.
    pub(crate) fn number(&self, keyword: &str, expected: &'static str) -> Result<Option<f64>, IoError> {
        self.optional(keyword, expected, as_number)
    }

    /// A finite number that must be there.
    pub(crate) fn required_number(&self, keyword: &str, expected: &'static str) -> Result<f64, IoError> {
        self.number(keyword, expected)?
            .ok_or_else(|| self.missing(keyword, expected))
    }

    /// A whole number of at least `least`, also one written with a point.
    pub(crate) fn count(
        &self,
        keyword: &str,
        least: usize,
        expected: &'static str,
    ) -> Result<Option<usize>, IoError> {
        self.optional(keyword, expected, |value| {
            let number = as_number(value)?;
            // Above 2^53 floats no longer count; no file has as many of anything.
            let counts = number.fract() == 0.0 && (least as f64..=2_f64.powi(53)).contains(&number);
            counts.then_some(number as usize)
        })
    }

    /// The same where it must be there.
    pub(crate) fn required_count(
        &self,
        keyword: &str,
        least: usize,
        expected: &'static str,
    ) -> Result<usize, IoError> {
        self.count(keyword, least, expected)?
            .ok_or_else(|| self.missing(keyword, expected))
    }

    /// A text.
    pub(crate) fn text(&self, keyword: &str, expected: &'static str) -> Result<Option<String>, IoError> {
        self.optional(keyword, expected, |value| match value {
            CardValue::Text(text) => Some(text.trim().to_owned()),
            _ => None,
        })
    }

    /// Whether there is a card of this keyword.
    pub(crate) fn has(&self, keyword: &str) -> bool {
        self.cards.contains_key(keyword)
    }

    pub(crate) fn missing(&self, keyword: &str, expected: &'static str) -> IoError {
        unsuitable(self.path)(GriddedError::MissingCard {
            hdu: self.hdu,
            keyword: keyword.to_owned(),
            expected,
        })
    }

    /// The error for a card whose value is not what it must be.
    pub(crate) fn bad(&self, keyword: &str, expected: &'static str, card: &Card) -> IoError {
        let got = match card.value() {
            Some(value) => value.to_string(),
            None => card.to_string().trim_end().to_owned(),
        };
        self.bad_value(keyword, expected, got)
    }

    pub(crate) fn bad_value(&self, keyword: &str, expected: &'static str, got: String) -> IoError {
        unsuitable(self.path)(GriddedError::BadCard {
            hdu: self.hdu,
            keyword: keyword.to_owned(),
            expected,
            got,
        })
    }
}

/// Whether an HDU has a card of this keyword, in upper or lower case.
pub(crate) fn has_card(hdu: &Hdu, keyword: &str) -> bool {
    hdu.header
        .iter()
        .any(|card| card.keyword().eq_ignore_ascii_case(keyword))
}

fn as_number(value: CardValue) -> Option<f64> {
    match value {
        CardValue::Integer(value) => Some(value as f64),
        CardValue::Real(value) => Some(value),
        _ => None,
    }
}
