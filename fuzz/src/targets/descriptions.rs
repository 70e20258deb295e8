//! Data read by serde: models as JSON, descriptions as TOML.

use detector::Detector;
use psf_optics::Telescope;
use psf_types::{PsfModelRecord, PsfSamples};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::limits::{within_limits, within_limits_of_plans};

/// Models and samples through serde.
pub fn records(data: &[u8]) -> usize {
    record::<PsfModelRecord>(data) + record::<PsfSamples>(data)
}

/// Checks that an accepted record is unchanged after writing and reading.
fn record<T: PartialEq + Serialize + DeserializeOwned>(data: &[u8]) -> usize {
    let Ok(value) = within_limits(|| serde_json::from_slice::<T>(data)) else {
        return 0;
    };
    let text = serde_json::to_string(&value).expect("a record can be written");
    let again: T = serde_json::from_str(&text).expect("a written record can be read");
    assert!(
        again == value,
        "the record read back differs from the record written: {text}"
    );
    1
}

/// Descriptions of telescopes, `TELESCOPE.toml`.
pub fn telescope(data: &[u8]) -> usize {
    let Ok(text) = std::str::from_utf8(data) else {
        return 0;
    };
    match within_limits_of_plans(|| Telescope::from_toml_str(text)) {
        Ok(_) => 1,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            0
        }
    }
}

/// Descriptions of detectors.
pub fn detector(data: &[u8]) -> usize {
    let Ok(text) = std::str::from_utf8(data) else {
        return 0;
    };
    match within_limits(|| Detector::from_toml_str(text)) {
        Ok(_) => 1,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            0
        }
    }
}
