//! Outcomes of measurements.

use psfield::PsfieldError;
use psfield::error::error_text;

/// A measured result and its limit.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// An error and the largest allowed error.
    Error {
        /// The measured error.
        got: f64,
        /// The limit.
        limit: f64,
    },
    /// The program refused the input with a message.
    Refused {
        /// The whole message.
        message: String,
        /// The text that the message must contain. `None` if the program should have accepted the
        /// input.
        expected: Option<&'static str>,
    },
    /// There is nothing to measure, for this reason.
    NotApplicable(&'static str),
}

/// The outcome in one column.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell(pub Outcome);

impl Cell {
    /// The outcome of a calculation that must succeed, from its error.
    pub(crate) fn error(got: Result<f64, PsfieldError>, limit: f64) -> Self {
        Self(match got {
            Ok(got) => Outcome::Error { got, limit },
            Err(error) => Outcome::Refused {
                message: error_text(&error),
                expected: None,
            },
        })
    }

    /// The outcome of a calculation that must be refused with a message that contains `words`.
    pub(crate) fn refusal(got: Result<f64, PsfieldError>, words: &'static str) -> Self {
        Self(match got {
            // A success fails this limit, whatever its error.
            Ok(got) => Outcome::Error { got, limit: -1.0 },
            Err(error) => Outcome::Refused {
                message: error_text(&error),
                expected: Some(words),
            },
        })
    }

    /// A cell without a measurement.
    pub(crate) fn not_applicable(reason: &'static str) -> Self {
        Self(Outcome::NotApplicable(reason))
    }

    /// The reason why the cell fails, if it does. NaN is above every limit.
    pub fn failure(&self) -> Option<String> {
        match &self.0 {
            Outcome::Error { got, limit } if *limit < 0.0 => Some(format!(
                "the input must be refused, but gave an error of {got:.1e}"
            )),
            Outcome::Error { got, limit } => {
                (got > limit || got.is_nan()).then(|| format!("{got:.1e} is above the limit of {limit:.0e}"))
            }
            Outcome::Refused {
                message,
                expected: None,
            } => Some(format!("refused: {message}")),
            Outcome::Refused {
                message,
                expected: Some(words),
            } => (!message.contains(words))
                .then(|| format!("the message of the refusal does not contain '{words}': {message}")),
            Outcome::NotApplicable(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_and_unwanted_success_fail() {
        assert!(Cell::error(Ok(f64::NAN), 1.0).failure().is_some());
        assert!(Cell::error(Ok(2.0), 1.0).failure().is_some());
        assert!(Cell::error(Ok(1.0), 1.0).failure().is_none());
        assert!(Cell::refusal(Ok(0.0), "words").failure().is_some());
    }
}
