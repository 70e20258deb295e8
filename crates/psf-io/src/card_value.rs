//! The values of header cards.

use thiserror::Error;

/// The value of a header card.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum CardValue {
    /// `T` or `F`.
    Logical(bool),
    /// A whole number.
    Integer(i64),
    /// A real number; written with as many digits as bring back the same bits.
    Real(f64),
    /// A text; long ones go on in CONTINUE records.
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
    /// Counts of things in memory fit.
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

/// Why a header card cannot be made.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum CardError {
    /// A keyword that FITS does not allow.
    #[error("{keyword:?} is not a FITS keyword: 1 to 8 of the characters A-Z, 0-9, - and _")]
    Keyword {
        /// The keyword given.
        keyword: String,
    },
    /// A NaN or an infinity, which FITS headers cannot hold.
    #[error("{keyword} is {value}: a FITS header holds finite numbers only")]
    NonFinite {
        /// The keyword.
        keyword: String,
        /// NaN or an infinity.
        value: f64,
    },
}

/// A logical or a number before any comment.
pub(crate) fn plain_value(field: &[u8]) -> Option<CardValue> {
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
    // Rust's parser also takes "inf" and "nan", which are no FITS numbers, and does not know FITS' D exponents.
    let number = text
        .bytes()
        .all(|b| b.is_ascii_digit() || b"+-.EeDd".contains(&b));
    let value: f64 = number
        .then(|| text.replace(['D', 'd'], "E").parse().ok())
        .flatten()?;
    value.is_finite().then_some(CardValue::Real(value))
}

/// The shortest decimal number that gives the same bits, with a point and a capital E.
fn real_text(value: f64) -> String {
    let text = format!("{value:?}").to_uppercase();
    match text.split_once('E') {
        Some((mantissa, exponent)) if !mantissa.contains('.') => format!("{mantissa}.0E{exponent}"),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
