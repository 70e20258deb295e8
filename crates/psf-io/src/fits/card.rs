//! One card of a FITS header.

use crate::error::CardError;

/// The length of a header record, in bytes.
pub(crate) const RECORD: usize = 80;
/// A header record as stored in the file.
pub(crate) type Record = [u8; RECORD];

/// The length of the text in a COMMENT or HISTORY record.
const COMMENTARY_TEXT: usize = 72;
/// The index of the first byte of the value in a record.
const VALUE: usize = 10;

/// A card of a FITS header: one record of 80 characters, or several for a long string or a long
/// text of HISTORY or COMMENT.
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
    /// At least one record.
    records: Vec<Record>,
}

impl Card {
    /// Makes a card from its keyword, value and comment. A comment that is too long is cut. FITS
    /// headers hold printable ASCII only, so other characters are written as Rust escapes such as
    /// `\u{e9}`.
    ///
    /// # Errors
    /// [`CardError`] if FITS does not allow the keyword or the value.
    pub fn new(keyword: &str, value: impl Into<CardValue>, comment: &str) -> Result<Self, CardError> {
        if keyword.is_empty() || keyword.len() > 8 || !keyword.bytes().all(is_keyword_byte) {
            return Err(CardError::Keyword {
                keyword: keyword.to_owned(),
            });
        }
        let comment = printable(comment);
        let records = match value.into() {
            CardValue::Real(value) if !value.is_finite() => {
                let keyword = keyword.to_owned();
                return Err(CardError::NonFinite { keyword, value });
            }
            CardValue::Text(text) => text_records(keyword, &printable(&text), &comment),
            value => vec![with_comment(
                format!("{keyword:<8}= {:>20}", value.to_string()),
                &comment,
            )],
        };
        Ok(Self { records })
    }

    /// Makes a HISTORY card with as many records as it needs.
    pub fn history(text: &str) -> Self {
        Self::commentary("HISTORY", text)
    }

    /// Makes a COMMENT card with as many records as it needs.
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

    /// The value for an error message, or the whole card if it has no value.
    pub(crate) fn shown(&self) -> String {
        match self.value() {
            Some(value) => value.to_string(),
            None => self.to_string().trim_end().to_owned(),
        }
    }

    pub(crate) fn from_record(record: Record) -> Self {
        Self {
            records: vec![record],
        }
    }

    /// Returns whether a CONTINUE record may follow.
    pub(crate) fn takes_continuation(&self) -> bool {
        let start = if self.records.len() > 1 {
            Some(VALUE)
        } else {
            self.value_start()
        };
        start
            .and_then(|start| quoted(self.records.last()?[start..].trim_ascii()))
            .is_some_and(|(text, _)| text.ends_with('&'))
    }

    pub(crate) fn push_continuation(&mut self, record: Record) {
        self.records.push(record);
    }

    pub(crate) fn records(&self) -> &[Record] {
        &self.records
    }

    /// The keyword. In one of ESO's HIERARCH cards it consists of the words between HIERARCH and
    /// `=`.
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

    /// The position of the `=` of a HIERARCH card.
    fn hierarch_equals(&self) -> Option<usize> {
        let record = &self.records[0];
        (&record[..8] == b"HIERARCH")
            .then(|| record.iter().position(|&b| b == b'='))
            .flatten()
    }

    /// Returns whether the card is text without a value: COMMENT, HISTORY, a blank keyword, or a
    /// card without `= ` after its keyword.
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

    /// Returns whether the keyword has characters that FITS does not allow. CFITSIO would not write
    /// such a card.
    pub(crate) fn is_foreign(&self) -> bool {
        let keyword = self.records[0][..8].trim_ascii_end();
        !keyword.iter().copied().all(is_keyword_byte)
    }

    /// The value, if the card has one and it is a logical value, a number or a string.
    pub fn value(&self) -> Option<CardValue> {
        let record = &self.records[0];
        let field = record[self.value_start()?..].trim_ascii();
        if field.first() != Some(&b'\'') {
            return plain_value(field);
        }
        let (mut text, _) = quoted(field)?;
        for record in &self.records[1..] {
            // If another part follows, this part ends in `&`, which does not belong to the string.
            if text.pop() != Some('&') {
                return None;
            }
            let (part, _) = quoted(record[VALUE..].trim_ascii())?;
            text.push_str(&part);
        }
        Some(CardValue::Text(text))
    }

    /// The comment after the value, or the text of a commentary card. In a string of several
    /// records, only a comment in the first record is found.
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
    /// Writes the records as stored in the file, one per line.
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

/// The value of a header card.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum CardValue {
    /// `T` or `F`.
    Logical(bool),
    /// A whole number.
    Integer(i64),
    /// A real number, written with as many digits as are needed to read the same bits back.
    Real(f64),
    /// A string. A long string is continued in CONTINUE records.
    Text(String),
}

macro_rules! card_value_from {
    ($($from:ty => $variant:ident),+) => {$(
        impl From<$from> for CardValue {
            fn from(value: $from) -> Self {
                Self::$variant(value.into())
            }
        }
    )+};
}

card_value_from!(bool => Logical, i64 => Integer, i32 => Integer, u32 => Integer, f64 => Real, f32 => Real, &str => Text, String => Text);

impl From<usize> for CardValue {
    /// A number of things in memory always fits into the `i64` of a card.
    fn from(value: usize) -> Self {
        Self::Integer(value as i64)
    }
}

impl std::fmt::Display for CardValue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Logical(value) => f.write_str(if *value { "T" } else { "F" }),
            Self::Integer(value) => write!(f, "{value}"),
            Self::Real(value) => f.write_str(&real_text(*value)),
            Self::Text(value) => write!(f, "{value:?}"),
        }
    }
}

/// A type that the value of a card may have.
pub(crate) trait FromValue: Sized {
    /// The value, or `None` if it is of another type.
    fn from_value(value: CardValue) -> Option<Self>;
}

macro_rules! from_value {
    ($($into:ty: $($variant:ident($value:ident) => $result:expr),+;)+) => {$(
        impl FromValue for $into {
            fn from_value(value: CardValue) -> Option<Self> {
                match value {
                    $(CardValue::$variant($value) => Some($result),)+
                    _ => None,
                }
            }
        }
    )+};
}

from_value! {
    bool: Logical(value) => value;
    i64: Integer(value) => value;
    f64: Real(value) => value, Integer(value) => value as f64;
    String: Text(value) => value;
}

/// Parses a logical value or a number, which a comment may follow.
fn plain_value(field: &[u8]) -> Option<CardValue> {
    let end = field.iter().position(|&b| b == b'/').unwrap_or(field.len());
    let text = std::str::from_utf8(field[..end].trim_ascii()).ok()?;
    match text {
        "T" => return Some(CardValue::Logical(true)),
        "F" => return Some(CardValue::Logical(false)),
        _ => {}
    }
    if let Ok(value) = text.parse() {
        return Some(CardValue::Integer(value));
    }
    // Rust's parser also accepts "inf" and "nan", which are not FITS numbers, and it rejects the D
    // exponents of FITS.
    let number = text
        .bytes()
        .all(|b| b.is_ascii_digit() || b"+-.EeDd".contains(&b));
    let value: f64 = number
        .then(|| text.replace(['D', 'd'], "E").parse().ok())
        .flatten()?;
    value.is_finite().then_some(CardValue::Real(value))
}

/// The shortest decimal number that is read back as the same bits. It always has a decimal point.
/// An exponent follows a capital E.
fn real_text(value: f64) -> String {
    let text = format!("{value:?}").to_uppercase();
    match text.split_once('E') {
        Some((mantissa, exponent)) if !mantissa.contains('.') => format!("{mantissa}.0E{exponent}"),
        _ => text,
    }
}

/// The largest length of the text in a record that another record continues. A quote within the
/// text is written twice and counts twice.
const CONTINUED_TEXT: usize = 67;
/// The largest length of the text in a single record, counted like [`CONTINUED_TEXT`].
const SINGLE_TEXT: usize = 68;

/// Keeps printable ASCII and escapes all other characters.
fn printable(text: &str) -> String {
    let escaped = |c: char| match c {
        ' '..='~' => c.to_string(),
        _ => c.escape_default().to_string(),
    };
    text.chars().map(escaped).collect()
}

pub(crate) fn padded(text: &[u8]) -> Record {
    let mut record = [b' '; RECORD];
    record[..text.len()].copy_from_slice(text);
    record
}

/// Makes a record from `text`, which holds keyword and value, and from as much of `comment` as
/// there is room for.
fn with_comment(mut text: String, comment: &str) -> Record {
    if !comment.is_empty() && text.len() + 4 < RECORD {
        text.push_str(" / ");
        text.push_str(comment);
        text.truncate(RECORD);
    }
    padded(text.as_bytes())
}

pub(crate) fn text_records(keyword: &str, text: &str, comment: &str) -> Vec<Record> {
    let escaped = text.replace('\'', "''");
    if escaped.len() <= SINGLE_TEXT {
        return vec![with_comment(
            format!("{keyword:<8}= {:<20}", format!("'{escaped:<8}'")),
            comment,
        )];
    }
    // Both quotes of a doubled quote must be in one record. So this loop splits `text`, in which
    // quotes are not yet doubled, and doubles each quote when it adds it to a record.
    let mut parts = vec![String::new()];
    for c in text.chars() {
        let piece = if c == '\'' { "''".to_owned() } else { c.to_string() };
        if parts[parts.len() - 1].len() + piece.len() > CONTINUED_TEXT {
            parts.push(String::new());
        }
        parts.last_mut().expect("never empty").push_str(&piece);
    }
    let last = parts.len() - 1;
    let record = |(i, part): (usize, &String)| {
        let head = if i == 0 {
            format!("{keyword:<8}= ")
        } else {
            "CONTINUE  ".to_owned()
        };
        if i == last {
            with_comment(format!("{head}'{part}'"), comment)
        } else {
            padded(format!("{head}'{part}&'").as_bytes())
        }
    };
    parts.iter().enumerate().map(record).collect()
}

/// Parses a quoted string. Returns it without trailing blanks, and the rest of the field.
fn quoted(field: &[u8]) -> Option<(String, &[u8])> {
    let mut rest = field.strip_prefix(b"'")?;
    let mut text = Vec::new();
    loop {
        let quote = rest.iter().position(|&b| b == b'\'')?;
        text.extend_from_slice(&rest[..quote]);
        rest = &rest[quote + 1..];
        match rest.strip_prefix(b"'") {
            Some(after) => {
                text.push(b'\'');
                rest = after;
            }
            None => return Some((String::from_utf8_lossy(&text).trim_end().to_owned(), rest)),
        }
    }
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
    fn long_strings_are_continued_and_recognised() {
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

    #[test]
    fn reals_come_back_bit_by_bit() {
        for value in [0.1, -0.0, 1.0 / 3.0, 5e-324, f64::MAX, 1e16, -2.5e-7, 64.0] {
            let text = real_text(value);
            assert!(text.contains('.'), "{text} would be read as a whole number");
            match plain_value(text.as_bytes()) {
                Some(CardValue::Real(back)) => assert_eq!(back.to_bits(), value.to_bits(), "{text}"),
                other => panic!("{text} gave {other:?}"),
            }
        }
    }

    #[test]
    fn only_fits_numbers_are_numbers() {
        assert_eq!(plain_value(b"1.5D3 / comment"), Some(CardValue::Real(1500.0)));
        assert_eq!(plain_value(b"+7"), Some(CardValue::Integer(7)));
        assert_eq!(plain_value(b"F"), Some(CardValue::Logical(false)));
        for bad in [
            &b"nan"[..],
            b"inf",
            b"1E999",
            b"",
            b"/ nothing",
            b"(1.0, 2.0)",
            b"12 34",
            b"\xff",
        ] {
            assert_eq!(plain_value(bad), None, "{}", String::from_utf8_lossy(bad));
        }
    }
}
