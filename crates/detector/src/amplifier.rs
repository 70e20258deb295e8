//! From electrons to ADU.

use serde::{Deserialize, Serialize};

use crate::error::{above_zero, require};
use crate::{DetectorError, DetectorParams};

/// The unit of counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CountUnit {
    /// Electrons: no gain, bias or bits are given.
    Electron,
    /// Analogue-to-digital units.
    Adu,
}

impl std::fmt::Display for CountUnit {
    /// As FITS writes it: `electron` or `adu`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Electron => "electron",
            Self::Adu => "adu",
        })
    }
}

/// Counts are `electrons / gain + bias`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Amplifier {
    gain_e_per_adu: f64,
    bias_adu: f64,
}

impl Amplifier {
    pub(crate) fn new(params: &DetectorParams) -> Result<Self, DetectorError> {
        Ok(Self {
            gain_e_per_adu: above_zero("gain_e_per_adu", params.gain_e_per_adu.unwrap_or(1.0))?,
            bias_adu: require(
                "bias_adu",
                "a finite number",
                params.bias_adu.unwrap_or(0.0),
                |_| true,
            )?,
        })
    }

    pub(crate) fn counts(&self, electrons: f64) -> f64 {
        electrons / self.gain_e_per_adu + self.bias_adu
    }

    /// Electrons per unit of the counts.
    pub(crate) fn gain(&self) -> f64 {
        self.gain_e_per_adu
    }
}
