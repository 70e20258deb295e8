//! Which HDU of a file is meant.

use std::str::FromStr;

use psf_types::DataError;

use crate::hdu::Hdu;

/// Which HDU of a file is meant: by its number (0 for the primary, as astropy counts) or by its name.
///
/// Written as `3`, `SCI` or `SCI,2` (EXTNAME, and EXTVER after a comma); a name is the same in upper and lower case.
///
/// ```
/// use psf_io::HduChoice;
/// assert_eq!("3".parse::<HduChoice>()?, HduChoice::Number(3));
/// assert_eq!("sci,2".parse::<HduChoice>()?.to_string(), "sci,2");
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum HduChoice {
    /// Counted from 0, the primary HDU.
    Number(usize),
    /// EXTNAME, and EXTVER where given.
    Name {
        /// EXTNAME.
        name: String,
        /// EXTVER.
        version: Option<i64>,
    },
}

impl HduChoice {
    /// Whether an HDU is the one (or one of those) meant.
    pub(crate) fn matches(&self, hdu: &Hdu) -> bool {
        match self {
            Self::Number(number) => hdu.index == *number,
            Self::Name { name, version } => {
                let named = hdu
                    .text("EXTNAME")
                    .is_some_and(|own| own.trim().eq_ignore_ascii_case(name));
                named && version.is_none_or(|version| hdu.extension_version() == version)
            }
        }
    }
}

impl Hdu {
    /// EXTVER; 1 where there is none, as the standard says.
    pub(crate) fn extension_version(&self) -> i64 {
        self.structural("EXTVER", Some(1)).unwrap_or(1)
    }

    /// Number and name, for lists in errors.
    pub(crate) fn label(&self) -> String {
        let version = self.header.get("EXTVER").map(|_| self.extension_version());
        match (self.text("EXTNAME"), version) {
            (None, _) => self.index.to_string(),
            (Some(name), None) => format!("{} ({})", self.index, name.trim()),
            (Some(name), Some(version)) => format!("{} ({},{version})", self.index, name.trim()),
        }
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

impl FromStr for HduChoice {
    type Err = DataError;
    fn from_str(text: &str) -> Result<Self, DataError> {
        let refused = || DataError::Setting {
            name: "extension",
            allowed: "the number of an HDU (0 is the primary), its EXTNAME, or EXTNAME,EXTVER",
            got: text.to_owned(),
        };
        let trimmed = text.trim();
        if let Ok(number) = trimmed.parse() {
            return Ok(Self::Number(number));
        }
        let (name, version) = match trimmed.rsplit_once(',') {
            Some((name, version)) => (name, Some(version.trim().parse().map_err(|_| refused())?)),
            None => (trimmed, None),
        };
        let name = name.trim().to_owned();
        if name.is_empty() {
            return Err(refused());
        }
        Ok(Self::Name { name, version })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_forms_round_trip_and_bad_ones_are_refused() {
        for text in ["0", "12", "PSF_DATA", "sci,3"] {
            assert_eq!(text.parse::<HduChoice>().unwrap().to_string(), text);
        }
        for text in ["", " ", ",2", "SCI,", "SCI,two"] {
            assert!(text.parse::<HduChoice>().is_err(), "{text:?}");
        }
    }
}
