//! One HDU with its mandatory keywords, the choice of an HDU, and the file that holds it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use psf_types::{DataError, through_text};
use serde::{Deserialize, Serialize};

use crate::error::{IoError, IoErrorKind, Place, invalid};
use crate::fits::card::{Card, CardValue, FromValue};
use crate::fits::header_cards::{HeaderCards, TILED_NAME};
use crate::output::temporary::Temporary;

/// The size of the blocks of a FITS file, in bytes.
pub(crate) const BLOCK: u64 = 2880;

/// The largest number of columns of a table (FITS standard 4.0, section 7.3.1).
const MOST_COLUMNS: i64 = 999;

/// The content of an HDU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HduKind {
    Image,
    BinaryTable,
    Other,
}

/// An HDU whose mandatory keywords have been checked.
#[derive(Debug)]
pub(crate) struct Hdu {
    /// The file that holds the HDU.
    pub(crate) source: FitsSource,
    /// Counted from 0.
    pub(crate) index: usize,
    pub(crate) kind: HduKind,
    pub(crate) header: HeaderCards,
    pub(crate) bitpix: i64,
    /// The lengths of the axes, `NAXIS1` first. For a compressed image these are the axes of the
    /// image, and not of the table that holds its tiles.
    pub(crate) axes: Vec<usize>,
    /// The position of the first byte of the data in the file.
    pub(crate) data_start: u64,
    /// Length of the data in bytes, without the padding to whole blocks.
    pub(crate) data_length: u64,
}

impl Hdu {
    pub(crate) fn new(source: &FitsSource, index: usize, header: HeaderCards) -> Result<Self, IoError> {
        let mut hdu = Self {
            source: source.clone(),
            index,
            kind: HduKind::Other,
            header,
            bitpix: 8,
            axes: Vec::new(),
            data_start: 0,
            data_length: 0,
        };
        hdu.kind = match (index, hdu.text("XTENSION").as_deref()) {
            (0, _) | (_, Some("IMAGE")) => HduKind::Image,
            (_, Some("BINTABLE")) => HduKind::BinaryTable,
            _ => HduKind::Other,
        };
        hdu.bitpix = hdu.structural("BITPIX", None)?;
        hdu.ensure(
            [8, 16, 32, 64, -32, -64].contains(&hdu.bitpix),
            "BITPIX",
            "must be 8, 16, 32, 64, -32 or -64",
        )?;
        let axis_count = hdu.structural("NAXIS", None)?;
        // With more axes, CFITSIO writes beyond the end of its arrays.
        hdu.ensure((0..=99).contains(&axis_count), "NAXIS", "must be 0 to 99")?;
        for axis in 1..=axis_count {
            let length = hdu.structural_count(&format!("NAXIS{axis}"), None)?;
            hdu.axes.push(length);
        }
        hdu.data_length = hdu
            .checked_length()?
            .ok_or_else(|| hdu.header_error("NAXIS", "the data would be larger than any file"))?;
        // CFITSIO allocates memory for this number of columns whenever it passes the HDU.
        hdu.ensure(
            (0..=MOST_COLUMNS).contains(&hdu.structural("TFIELDS", Some(0))?),
            "TFIELDS",
            "must be 0 to 999",
        )?;
        Ok(hdu)
    }

    /// The path of the file, for error messages.
    pub(crate) fn path(&self) -> &Path {
        &self.source.path
    }

    /// Returns whether this HDU is a binary table that holds the tiles of a compressed image. Such
    /// a table counts as the image.
    pub(crate) fn is_tiled(&self) -> bool {
        self.index > 0
            && self.value("ZIMAGE") == Some(true)
            && self.text("XTENSION").as_deref() == Some("BINTABLE")
    }

    /// Length of the data in bytes, with the padding to whole blocks.
    pub(crate) fn padded_length(&self) -> Result<u64, IoError> {
        self.data_length
            .checked_next_multiple_of(BLOCK)
            .ok_or_else(|| self.header_error("NAXIS", "the data would be larger than any file"))
    }

    /// Length of the data in bytes, or `None` if it overflows.
    fn checked_length(&self) -> Result<Option<u64>, IoError> {
        if self.axes.is_empty() {
            return Ok(Some(0));
        }
        let count = |keyword, default| self.structural_count(keyword, Some(default));
        let (parameters, groups) = (count("PCOUNT", 0)? as u64, count("GCOUNT", 1)? as u64);
        // In random groups the first axis has length 0 and is not counted.
        let random_groups = self.index == 0 && self.axes[0] == 0 && self.value("GROUPS") == Some(true);
        // Without a group there would be no data for the pixels that the axes promise.
        self.ensure(groups > 0 || random_groups, "GCOUNT", "must be above 0")?;
        let axes = if random_groups {
            &self.axes[1..]
        } else {
            &self.axes[..]
        };
        Ok(axes
            .iter()
            .try_fold(1_u64, |product, &n| product.checked_mul(n as u64))
            .and_then(|pixels| pixels.checked_add(parameters))
            .and_then(|values| values.checked_mul(groups))
            .and_then(|values| values.checked_mul(self.bitpix.unsigned_abs() / 8)))
    }

    /// Returns whether this is an image with pixels.
    pub(crate) fn has_pixels(&self) -> bool {
        self.kind == HduKind::Image && !self.axes.is_empty() && self.axes.iter().all(|&n| n > 0)
    }

    /// Returns whether this HDU is a binary table with a column of this name, in upper or lower case.
    pub(crate) fn has_column(&self, name: &str) -> bool {
        let mut names =
            (1..=self.value::<i64>("TFIELDS").unwrap_or(0)).map(|n| self.text(&format!("TTYPE{n}")));
        self.kind == HduKind::BinaryTable
            && names.any(|found| found.is_some_and(|found| found.trim().eq_ignore_ascii_case(name)))
    }

    pub(crate) fn is_ascii_table(&self) -> bool {
        self.text("XTENSION").as_deref() == Some("TABLE")
    }

    /// The EXTNAME. `None` if there is none, or if it is the default name for the table of a
    /// compressed image.
    pub(crate) fn name(&self) -> Option<String> {
        self.text("EXTNAME")
            .map(|name| name.trim().to_owned())
            .filter(|name| !(self.is_tiled() && name == TILED_NAME))
    }

    /// The EXTVER, or 1 without one.
    pub(crate) fn version(&self) -> i64 {
        self.value("EXTVER").unwrap_or(1)
    }

    /// Number, name and size of the HDU, for a list of choices.
    pub(crate) fn described(&self) -> String {
        let mut text = self.index.to_string();
        if let Some(name) = self.name() {
            text = format!("{text} {name:?}");
            if self.header.get("EXTVER").is_some() {
                text = format!("{text},{}", self.version());
            }
        }
        let sizes: Vec<String> = self.axes.iter().map(ToString::to_string).collect();
        match self.kind {
            HduKind::BinaryTable => format!("{text} (rows: {})", self.axes.get(1).unwrap_or(&0)),
            _ => format!("{text} ({})", sizes.join(" x ")),
        }
    }

    /// An error about this HDU.
    pub(crate) fn error(&self, kind: IoErrorKind, message: impl Into<String>) -> IoError {
        IoError::new(self.path(), kind, message).at(Place::Hdu(self.index))
    }

    /// An error about a keyword of this HDU.
    pub(crate) fn header_error(&self, keyword: &str, message: impl Into<String>) -> IoError {
        let (hdu, keyword) = (self.index, keyword.to_owned());
        self.error(IoErrorKind::Header, message)
            .at(Place::Keyword { hdu, keyword })
    }

    /// Returns an error about this keyword unless `sound` is true.
    pub(crate) fn ensure(&self, sound: bool, keyword: &str, problem: &'static str) -> Result<(), IoError> {
        if sound {
            Ok(())
        } else {
            Err(self.header_error(keyword, problem))
        }
    }

    /// Returns an error if cards with this keyword have different values. Of several cards, CFITSIO
    /// may use another one than psfield checks.
    pub(crate) fn ensure_one_value(&self, keyword: &str) -> Result<(), IoError> {
        const SEVERAL: &str =
            "the header has several cards with this keyword and different values: remove all but one";
        let cards = self.header.iter().filter(|card| card.has_keyword(keyword));
        let mut values = cards.map(Card::shown);
        let first = values.next();
        self.ensure(values.all(|value| Some(value) == first), keyword, SEVERAL)
    }

    /// The value of a keyword that the structure of the file depends on: a whole number. For a
    /// missing keyword it is `default`. If `default` is `None`, a missing keyword is an error.
    pub(crate) fn structural(&self, keyword: &str, default: Option<i64>) -> Result<i64, IoError> {
        match (self.header.get(keyword).map(Card::value), default) {
            (Some(Some(CardValue::Integer(value))), _) => Ok(value),
            (None, Some(default)) => Ok(default),
            (None, None) => Err(self.header_error(keyword, "the keyword is missing")),
            (Some(_), _) => Err(self.header_error(keyword, "must be a whole number")),
        }
    }

    /// Works like [`structural`](Self::structural), but a negative number is an error.
    pub(crate) fn structural_count(&self, keyword: &str, default: Option<i64>) -> Result<usize, IoError> {
        let value = self.structural(keyword, default)?;
        usize::try_from(value).map_err(|_| self.header_error(keyword, "must not be negative"))
    }

    /// The axes in array order, x last.
    pub(crate) fn shape(&self) -> Vec<usize> {
        self.axes.iter().rev().copied().collect()
    }

    pub(crate) fn axes_error(&self, expected: &'static str) -> IoError {
        let got = self.shape();
        let message = format!("the axes are {got:?} (in array order, x last), but {expected} is needed");
        self.error(IoErrorKind::Axes, message)
    }

    pub(crate) fn keyword_error(&self, keyword: &str, expected: &str) -> IoError {
        let got = self.header.get(keyword).map_or_else(String::new, Card::shown);
        self.wrong_value(keyword, expected, got)
    }

    /// The error for a keyword with a wrong value.
    pub(crate) fn wrong_value(&self, keyword: &str, expected: &str, got: impl std::fmt::Display) -> IoError {
        self.header_error(keyword, format!("must be {expected}, got {got}"))
    }

    /// Returns a function for `map_err`. It turns a [`DataError`] into an error that names this
    /// keyword as its place.
    pub(crate) fn invalid_keyword(&self, keyword: &str) -> impl Fn(DataError) -> IoError + use<'_> {
        let (hdu, keyword) = (self.index, keyword.to_owned());
        let place = Place::Keyword { hdu, keyword };
        move |source| invalid(self.path())(source).at(place.clone())
    }

    /// The value of a keyword, if the keyword exists and its value has this type.
    pub(crate) fn value<T: FromValue>(&self, keyword: &str) -> Option<T> {
        self.header.value(keyword)
    }

    /// The string of a keyword, if the keyword exists and its value is a string.
    pub(crate) fn text(&self, keyword: &str) -> Option<String> {
        self.header.text(keyword)
    }

    /// The value of a keyword, if the keyword exists. A value of another type is an error.
    pub(crate) fn optional<T: FromValue>(
        &self,
        keyword: &str,
        expected: &'static str,
    ) -> Result<Option<T>, IoError> {
        let Some(card) = self.header.get(keyword) else {
            return Ok(None);
        };
        match card.value().and_then(T::from_value) {
            Some(value) => Ok(Some(value)),
            None => Err(self.keyword_error(keyword, expected)),
        }
    }

    /// The value of a keyword. A missing keyword is an error, and so is a value of another type.
    /// The error describes an allowed value by `expected`.
    pub(crate) fn required<T: FromValue>(&self, keyword: &str, expected: &'static str) -> Result<T, IoError> {
        self.optional(keyword, expected)?
            .ok_or_else(|| self.missing_keyword(keyword, expected))
    }

    pub(crate) fn optional_real(&self, keyword: &'static str) -> Result<Option<f64>, IoError> {
        self.optional(keyword, "a number")
    }

    pub(crate) fn optional_logical(&self, keyword: &'static str) -> Result<Option<bool>, IoError> {
        self.optional(keyword, "T or F")
    }

    /// The value of a keyword, which must be a whole number above 0. A missing keyword is an error.
    pub(crate) fn required_length(
        &self,
        keyword: &'static str,
        expected: &'static str,
    ) -> Result<usize, IoError> {
        usize::try_from(self.required::<i64>(keyword, expected)?)
            .ok()
            .filter(|&n| n > 0)
            .ok_or_else(|| self.keyword_error(keyword, expected))
    }

    /// The value of a string keyword, parsed as one of the choices of `T`, if the keyword exists.
    pub(crate) fn optional_choice<T: std::str::FromStr<Err = DataError>>(
        &self,
        keyword: &'static str,
        expected: &'static str,
    ) -> Result<Option<T>, IoError> {
        self.optional::<String>(keyword, expected)?
            .map(|text| text.parse().map_err(self.invalid_keyword(keyword)))
            .transpose()
    }

    /// Works like [`optional_choice`](Self::optional_choice), but a missing keyword is an error.
    pub(crate) fn required_choice<T: std::str::FromStr<Err = DataError>>(
        &self,
        keyword: &'static str,
        expected: &'static str,
    ) -> Result<T, IoError> {
        self.optional_choice(keyword, expected)?
            .ok_or_else(|| self.missing_keyword(keyword, expected))
    }

    pub(crate) fn missing_keyword(&self, keyword: &str, expected: &str) -> IoError {
        self.header_error(keyword, format!("the keyword is missing: it must be {expected}"))
    }
}

/// Chooses one HDU by number, or by name and optional version.
///
/// Text form: a whole number counts HDUs from 0 (the primary), as in astropy. A text that is not a
/// number is an `EXTNAME`, in upper or lower case. A comma and an `EXTVER` may follow it.
///
/// ```
/// use psf_io::HduChoice;
/// assert_eq!("1".parse::<HduChoice>()?, HduChoice::Number(1));
/// let second: HduChoice = "SCI,2".parse()?;
/// assert_eq!(second, HduChoice::Name { name: "SCI".into(), version: Some(2) });
/// assert_eq!(second.to_string(), "SCI,2");
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum HduChoice {
    /// An HDU number, counted from 0 (the primary HDU).
    Number(usize),
    /// The first HDU with this `EXTNAME`, and with this `EXTVER` if a version is given.
    Name {
        /// The `EXTNAME`, upper or lower case.
        name: String,
        /// The `EXTVER`, or `None` for any. An HDU without an `EXTVER` has version 1.
        version: Option<i64>,
    },
}

impl HduChoice {
    /// Returns whether the choice matches this HDU. A name may match several HDUs.
    pub(crate) fn matches(&self, hdu: &Hdu) -> bool {
        match self {
            Self::Number(number) => hdu.index == *number,
            Self::Name { name, version } => {
                hdu.name().is_some_and(|n| n.trim().eq_ignore_ascii_case(name))
                    && version.is_none_or(|version| hdu.version() == version)
            }
        }
    }
}

through_text!(HduChoice);

impl std::str::FromStr for HduChoice {
    type Err = DataError;
    fn from_str(text: &str) -> Result<Self, DataError> {
        const ALLOWED: &str = "a number counted from 0 (the primary HDU), or NAME or NAME,VERSION";
        let refused = || DataError::setting("the choice of an HDU", ALLOWED, text);
        let trimmed = text.trim();
        if let Ok(number) = trimmed.parse() {
            return Ok(Self::Number(number));
        }
        let (name, version) = match trimmed.rsplit_once(',') {
            Some((name, version)) => (name.trim(), Some(version.trim().parse().map_err(|_| refused())?)),
            None => (trimmed, None),
        };
        if name.is_empty() || name.parse::<f64>().is_ok() {
            return Err(refused());
        }
        Ok(Self::Name {
            name: name.to_owned(),
            version,
        })
    }
}

impl std::fmt::Display for HduChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Name { name, version: None } => f.write_str(name),
            Self::Name {
                name,
                version: Some(version),
            } => write!(f, "{name},{version}"),
        }
    }
}

/// A FITS file that can be read at any position: the file itself, or an unpacked copy. The copy is
/// removed when the last clone of this value is dropped.
#[derive(Debug, Clone)]
pub(crate) struct FitsSource {
    path: PathBuf,
    unpacked: Option<Arc<Temporary>>,
}

impl FitsSource {
    /// Uses the file itself, or an unpacked copy of it.
    pub(crate) fn new(path: &Path, copy: Option<Temporary>) -> Self {
        Self {
            path: path.to_owned(),
            unpacked: copy.map(Arc::new),
        }
    }

    /// The path for error messages.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The file to open.
    pub(crate) fn file(&self) -> &Path {
        self.unpacked.as_ref().map_or(&self.path, |copy| copy.path())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_that_name_no_hdu_are_refused() {
        for bad in ["", "-1", "1.5", ",2", "SCI,", "SCI,two", "3,1"] {
            assert!(bad.parse::<HduChoice>().is_err(), "{bad}");
        }
        for good in ["0", "12", "SCI", "sci 2", "A,B,-3"] {
            assert_eq!(good.parse::<HduChoice>().unwrap().to_string(), good);
        }
    }
}
