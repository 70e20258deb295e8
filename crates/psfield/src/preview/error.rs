//! What cannot be shown.

use thiserror::Error;

use super::limits::FIGURES;
use crate::readable::readable;

/// Why there is no picture.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum PreviewError {
    /// Limits that are no range.
    #[error("the limits {low} and {high} are no range: two finite numbers are needed, the lower one first")]
    Range {
        /// The value at the dark end.
        low: f64,
        /// The value at the bright end.
        high: f64,
    },
    /// Percentiles that are none.
    #[error("the percentiles {low} and {high} are not two numbers from 0 to 100, the lower one first")]
    Percentiles {
        /// The lower percentile.
        low: f64,
        /// The upper percentile.
        high: f64,
    },
    /// A text that is not two numbers.
    #[error("two numbers LO,HI are needed, as in 0.5,99.5")]
    NotTwoNumbers,
    /// A name that is none of those known.
    #[error("{got:?} is none of {known}")]
    Name {
        /// The names there are.
        known: &'static str,
        /// What was given.
        got: String,
    },
    /// An image in which nothing is a number.
    #[error("none of the {pixels} pixels is a finite number: there is nothing to show")]
    NoFinitePixel {
        /// Pixels of the image.
        pixels: usize,
    },
    /// An image of one value.
    #[error("every pixel is {}: there is no contrast to show; give limits about it (--range)", readable(*value, FIGURES))]
    Constant {
        /// The value.
        value: f64,
    },
    /// Limits that a rule finds equal, though the image has contrast.
    #[error(
        "{rule} puts both limits at {}, while the pixels go from {} to {}: most of them are that value; take wider percentiles \
         (--percentile 0,100) or give limits (--range)",
        readable(*value, FIGURES),
        readable(*lowest, FIGURES),
        readable(*highest, FIGURES)
    )]
    EqualLimits {
        /// The rule, as in a sentence.
        rule: String,
        /// Both limits.
        value: f64,
        /// The lowest pixel.
        lowest: f64,
        /// The highest pixel.
        highest: f64,
    },
    /// An array that is empty or has more pixels along an axis than PNG allows.
    #[error("an image of {nx} x {ny} pixels cannot be a picture: 1 to {limit} are needed along each axis")]
    Size {
        /// Columns.
        nx: usize,
        /// Rows.
        ny: usize,
        /// The most pixels along an axis.
        limit: usize,
    },
}
