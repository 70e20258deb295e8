//! Which HDU of a file is meant.

use psf_types::DataError;

use crate::hdu::Hdu;

/// The choice of one HDU: by number, or by name and perhaps version.
///
/// As text: a whole number counts HDUs from 0, the primary, as astropy does; anything else is an `EXTNAME`, upper and lower case being
/// the same, which an `EXTVER` may follow after a comma.
///
/// ```
/// use psf_io::HduChoice;
/// assert_eq!("1".parse::<HduChoice>()?, HduChoice::Number(1));
/// let second: HduChoice = "SCI,2".parse()?;
/// assert_eq!(second, HduChoice::Name { name: "SCI".into(), version: Some(2) });
/// assert_eq!(second.to_string(), "SCI,2");
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum HduChoice {
    /// Counted from 0, the primary HDU.
    Number(usize),
    /// The first HDU with this `EXTNAME`.
    Name {
        /// The `EXTNAME`, upper or lower case.
        name: String,
        /// The `EXTVER`; an HDU without one has 1. Any when not given.
        version: Option<i64>,
    },
}

impl HduChoice {
    /// Whether an HDU is the one, or one of those, meant.
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

impl std::str::FromStr for HduChoice {
    type Err = DataError;
    fn from_str(text: &str) -> Result<Self, DataError> {
        let refused = || DataError::Setting {
            name: "an extension",
            allowed: "a number counted from 0 (the primary HDU), or NAME or NAME,VERSION",
            got: text.to_owned(),
        };
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
