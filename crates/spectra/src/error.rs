//! Errors of curves, spectra and atmospheres.

use thiserror::Error;

/// The reason why a curve, a spectrum or an atmosphere is not valid, or has no photons.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum SpectraError {
    /// A curve with fewer than two rows, or with columns of different length.
    #[error("a curve needs two or more wavelengths with one value each, got {wavelengths} and {values}")]
    TooShort {
        /// Number of wavelengths.
        wavelengths: usize,
        /// Number of values.
        values: usize,
    },
    /// Wavelengths that do not ascend.
    #[error(
        "wavelengths must ascend, but row {row} (0-based) has {next} um after {previous} um: sort the rows and remove \
         repeated wavelengths"
    )]
    NotAscending {
        /// The row of the later wavelength.
        row: usize,
        /// The wavelength before.
        previous: f64,
        /// The wavelength in this row.
        next: f64,
    },
    /// A wavelength or a value that is not allowed.
    #[error("row {row} (0-based): {what}, got {got}")]
    Value {
        /// The row.
        row: usize,
        /// The rule.
        what: &'static str,
        /// The value.
        got: f64,
    },
    /// A curve that is 0 everywhere.
    #[error("every value of the curve is 0")]
    Dark,
    /// A text that names no spectrum.
    #[error(
        "a spectrum is blackbody:KELVIN, powerlaw:INDEX or a file, with @z=REDSHIFT behind it if needed, got {0:?}"
    )]
    Name(String),
    /// A number out of range.
    #[error("{name} must be {allowed}, got {got}")]
    Setting {
        /// Name of the quantity.
        name: &'static str,
        /// The allowed values, in words.
        allowed: &'static str,
        /// The given value.
        got: f64,
    },
    /// A spectrum without light in the bandpass.
    #[error(
        "the spectrum has no light in the bandpass, which passes {} to {} um (the spectrum is known from {} to {} um): check \
         the units of both",
        .bandpass.0, .bandpass.1, .spectrum.0, .spectrum.1
    )]
    NoOverlap {
        /// The first and last wavelength with throughput, in micrometres.
        bandpass: (f64, f64),
        /// The first and last wavelength of the spectrum, in micrometres.
        spectrum: (f64, f64),
    },
    /// A spectrum that covers only a part of the bandpass.
    #[error(
        "the spectrum is known only from {} to {} um, but the bandpass passes {} to {} um: extend the spectrum, with zeros \
         where it has no light",
        .spectrum.0, .spectrum.1, .bandpass.0, .bandpass.1
    )]
    Uncovered {
        /// The first and last wavelength with throughput, in micrometres.
        bandpass: (f64, f64),
        /// The first and last wavelength of the spectrum, in micrometres.
        spectrum: (f64, f64),
    },
}

impl SpectraError {
    /// Checks a number against a rule.
    pub(crate) fn check(
        is_sound: bool,
        name: &'static str,
        allowed: &'static str,
        got: f64,
    ) -> Result<(), Self> {
        if is_sound && got.is_finite() {
            Ok(())
        } else {
            Err(Self::Setting { name, allowed, got })
        }
    }
}
