//! Header cards.

use crate::card_text::{padded, printable, quoted, text_records, with_comment};
use crate::card_value::plain_value;
use crate::{CardError, CardValue};

/// Bytes in a header record.
pub(crate) const RECORD: usize = 80;
/// A header record as it stands in the file.
pub(crate) type Record = [u8; RECORD];

/// Text in a COMMENT or HISTORY record.
const COMMENTARY_TEXT: usize = 72;
/// Where the value starts.
const VALUE: usize = 10;

/// A card of a FITS header: one record of 80 characters, or several when a text goes on.
///
/// A card read from a file keeps its records byte by byte.
///
/// ```
/// use psf_io::{Card, CardValue};
/// let card = Card::new("TOLERANC", 1e-4, "largest relative L2 error of a PSF")?;
/// assert_eq!(card.to_string().trim_end(), "TOLERANC=               0.0001 / largest relative L2 error of a PSF");
/// assert_eq!(card.value(), Some(CardValue::Real(1e-4)));
/// # Ok::<(), psf_io::CardError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Card {
    /// At least one.
    records: Vec<Record>,
}

impl Card {
    /// A card from its keyword, value and comment. A comment that does not fit is cut; characters that FITS headers cannot
    /// hold (all but printable ASCII) are written as Rust escapes such as `\u{e9}`.
    ///
    /// # Errors
    /// [`CardError`] when FITS does not allow the keyword or the value.
    pub fn new(keyword: &str, value: impl Into<CardValue>, comment: &str) -> Result<Self, CardError> {
        if keyword.is_empty() || keyword.len() > 8 || !keyword.bytes().all(is_keyword_byte) {
            return Err(CardError::Keyword {
                keyword: keyword.to_owned(),
            });
        }
        let comment = printable(comment);
        let fixed = |value: String| Self {
            records: vec![with_comment(format!("{keyword:<8}= {value:>20}"), &comment)],
        };
        match value.into() {
            CardValue::Real(value) if !value.is_finite() => Err(CardError::NonFinite {
                keyword: keyword.to_owned(),
                value,
            }),
            CardValue::Text(text) => Ok(Self {
                records: text_records(keyword, &printable(&text), &comment),
            }),
            value => Ok(fixed(value.to_string())),
        }
    }

    /// A line of HISTORY, in as many records as it needs.
    pub fn history(text: &str) -> Self {
        Self::commentary("HISTORY", text)
    }

    /// A COMMENT, in as many records as it needs.
    pub fn comment(text: &str) -> Self {
        Self::commentary("COMMENT", text)
    }

    fn commentary(keyword: &str, text: &str) -> Self {
        let text = printable(text);
        let mut records: Vec<Record> = text
            .as_bytes()
            .chunks(COMMENTARY_TEXT)
            .map(|part| padded(&[format!("{keyword:<8}").as_bytes(), part].concat()))
            .collect();
        if records.is_empty() {
            records.push(padded(keyword.as_bytes()));
        }
        Self { records }
    }

    pub(crate) fn from_record(record: Record) -> Self {
        Self {
            records: vec![record],
        }
    }

    /// Whether a CONTINUE record may follow.
    pub(crate) fn takes_continuation(&self) -> bool {
        let start = if self.records.len() > 1 {
            Some(VALUE)
        } else {
            self.value_start()
        };
        start
            .and_then(|start| quoted(self.last()[start..].trim_ascii()))
            .is_some_and(|(text, _)| text.ends_with('&'))
    }

    pub(crate) fn push_continuation(&mut self, record: Record) {
        self.records.push(record);
    }

    pub(crate) fn records(&self) -> &[Record] {
        &self.records
    }

    fn last(&self) -> &Record {
        self.records.last().expect("a card has a record")
    }

    /// The keyword; for ESO's HIERARCH cards the words between HIERARCH and `=`.
    pub fn keyword(&self) -> String {
        let record = &self.records[0];
        let name = match self.hierarch_equals() {
            Some(equals) => &record[8..equals],
            None => &record[..8],
        };
        String::from_utf8_lossy(name).trim().to_owned()
    }

    pub(crate) fn has_keyword(&self, keyword: &str) -> bool {
        keyword.len() <= 8 && self.records[0][..8].trim_ascii_end() == keyword.as_bytes()
    }

    /// Where the `=` of a HIERARCH card stands.
    fn hierarch_equals(&self) -> Option<usize> {
        let record = &self.records[0];
        (&record[..8] == b"HIERARCH")
            .then(|| record.iter().position(|&b| b == b'='))
            .flatten()
    }

    /// Whether the card is text without a value: COMMENT, HISTORY, or no `=` in its place.
    pub fn is_commentary(&self) -> bool {
        self.value_start().is_none()
    }

    fn value_start(&self) -> Option<usize> {
        let record = &self.records[0];
        if let Some(equals) = self.hierarch_equals() {
            return Some(equals + 1);
        }
        let commentary = [&b"COMMENT "[..], b"HISTORY ", b"        ", b"CONTINUE"];
        (&record[8..VALUE] == b"= " && !commentary.contains(&&record[..8])).then_some(VALUE)
    }

    /// Whether the keyword has characters that FITS does not allow, so that CFITSIO would not write it.
    pub(crate) fn is_foreign(&self) -> bool {
        !self.records[0][..8]
            .trim_ascii_end()
            .iter()
            .copied()
            .all(is_keyword_byte)
    }

    /// The value, if there is one that is a logical, a number or a text.
    pub fn value(&self) -> Option<CardValue> {
        let record = &self.records[0];
        let field = record[self.value_start()?..].trim_ascii();
        if field.first() != Some(&b'\'') {
            return plain_value(field);
        }
        let (mut text, _) = quoted(field)?;
        for record in &self.records[1..] {
            // A part that goes on ends in `&`, which is not of the text.
            if text.pop() != Some('&') {
                return None;
            }
            let (part, _) = quoted(record[VALUE..].trim_ascii())?;
            text.push_str(&part);
        }
        Some(CardValue::Text(text))
    }

    /// The comment after the value of a single record, or the text of a commentary card.
    pub fn comment_text(&self) -> String {
        let record = &self.records[0];
        let Some(start) = self.value_start() else {
            let texts: Vec<u8> = self.records.iter().flat_map(|r| r[8..].iter().copied()).collect();
            return String::from_utf8_lossy(&texts).trim_end().to_owned();
        };
        let field = record[start..].trim_ascii();
        let rest = match quoted(field) {
            Some((_, rest)) => rest,
            None => field,
        };
        match rest.iter().position(|&b| b == b'/') {
            Some(slash) => String::from_utf8_lossy(&rest[slash + 1..]).trim().to_owned(),
            None => String::new(),
        }
    }
}

impl std::fmt::Display for Card {
    /// The records as they stand in the file, one a line.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (i, record) in self.records.iter().enumerate() {
            let line_break = if i == 0 { "" } else { "\n" };
            write!(f, "{line_break}{}", String::from_utf8_lossy(record))?;
        }
        Ok(())
    }
}

fn is_keyword_byte(byte: u8) -> bool {
    byte.is_ascii_uppercase() || byte.is_ascii_digit() || byte == b'-' || byte == b'_'
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back() {
        let long = "it's a 'long' text, ".repeat(12) + "with quotes' at every place'";
        let values = [
            CardValue::Logical(true),
            CardValue::Integer(i64::MIN),
            CardValue::Real(-1.234_567_890_123_456_7e-300),
            CardValue::Text("a/b '' & c&".into()),
            CardValue::Text(String::new()),
            CardValue::Text(long),
        ];
        for value in values {
            let card = Card::new("KEY-1_A", value.clone(), "a comment / with a slash").unwrap();
            assert_eq!(card.value(), Some(value));
            assert_eq!(card.keyword(), "KEY-1_A");
            assert!(
                card.records()
                    .iter()
                    .all(|r| r.iter().all(|b| (b' '..=b'~').contains(b)))
            );
        }
        let card = Card::new("A", 3, "why / not").unwrap();
        assert_eq!(card.comment_text(), "why / not");
    }

    #[test]
    fn long_texts_go_on_and_are_recognised_as_such() {
        let card = Card::new("A", "x".repeat(100), "").unwrap();
        assert_eq!(card.records().len(), 2);
        let first = Card::from_record(card.records()[0]);
        assert!(first.takes_continuation());
        assert!(!card.takes_continuation());
    }

    #[test]
    fn texts_beyond_ascii_are_escaped() {
        let card = Card::new("OBJECT", "M31\né", "").unwrap();
        assert_eq!(card.value(), Some(CardValue::Text("M31\\n\\u{e9}".into())));
        let history = Card::history(&"word ".repeat(40));
        assert_eq!(history.records().len(), 3);
        assert!(history.is_commentary() && history.value().is_none());
    }

    #[test]
    fn keywords_and_numbers_that_fits_does_not_allow_are_refused() {
        for bad in ["", "lower", "TOOLONG89", "A B", "É"] {
            assert!(
                matches!(Card::new(bad, 1, ""), Err(CardError::Keyword { .. })),
                "{bad}"
            );
        }
        assert!(matches!(
            Card::new("A", f64::NAN, ""),
            Err(CardError::NonFinite { .. })
        ));
    }

    #[test]
    fn eso_keywords_are_read() {
        let card = Card::from_record(padded(b"HIERARCH ESO DET GAIN = 2.5 / e-/ADU"));
        assert_eq!(
            (card.keyword().as_str(), card.value()),
            ("ESO DET GAIN", Some(CardValue::Real(2.5)))
        );
    }
}
