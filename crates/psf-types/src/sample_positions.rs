//! The positions of samples, and the wavelength, time or frame to which each sample belongs.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

use crate::frame::{DataError, FrameShape, Position};
use crate::named;

/// The quantity on which a PSF depends besides the position. Each value of it is a *state* of the
/// PSF.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum StateKind {
    /// The wavelength of the light, in micrometres.
    Wavelength,
    /// The time, in seconds.
    Time,
    /// The number of a frame (exposure).
    Frame,
    /// The number of a spectrum in a list, from 0. The PSF is that of the spectrum's detected
    /// photons, so it is a mean over wavelengths.
    Spectrum,
}

impl StateKind {
    /// The unit of the values, empty for numbers.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Wavelength => "um",
            Self::Time => "s",
            Self::Frame | Self::Spectrum => "",
        }
    }

    /// A value with its name and its unit, such as "wavelength 0.5 um".
    pub fn describe(self, value: f64) -> String {
        format!("{self} {value} {}", self.unit()).trim_end().to_owned()
    }
}

named!(
    StateKind,
    "quantity on which a PSF depends",
    "wavelength, time, frame or spectrum",
    "wavelength" => Wavelength,
    "time" => Time,
    "frame" => Frame,
    "spectrum" => Spectrum
);

/// The state of every sample: its wavelength, time, frame or spectrum.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawSampleStates", into = "RawSampleStates")]
pub struct SampleStates {
    kind: StateKind,
    /// The distinct values, in ascending order.
    values: Vec<f64>,
    /// The index of each sample's value.
    of_samples: Vec<usize>,
}

#[derive(Serialize, Deserialize)]
struct RawSampleStates {
    kind: StateKind,
    of_samples: Vec<f64>,
}

impl TryFrom<RawSampleStates> for SampleStates {
    type Error = DataError;
    fn try_from(raw: RawSampleStates) -> Result<Self, DataError> {
        Self::new(raw.kind, &raw.of_samples)
    }
}

impl From<SampleStates> for RawSampleStates {
    fn from(states: SampleStates) -> Self {
        Self {
            kind: states.kind,
            of_samples: states.per_sample().collect(),
        }
    }
}

impl SampleStates {
    /// The states of samples, from one value per sample. Equal values are one state.
    ///
    /// ```
    /// use psf_types::{SampleStates, StateKind};
    /// let states = SampleStates::new(StateKind::Wavelength, &[0.9, 0.6, 0.9])?;
    /// assert_eq!(states.values(), [0.6, 0.9]);
    /// assert_eq!(states.index_of_sample(0), 1);
    /// # Ok::<(), psf_types::DataError>(())
    /// ```
    ///
    /// # Errors
    /// [`DataError::NoSamples`], or [`DataError::Setting`] for a value that is not finite, or a
    /// wavelength that is not above 0.
    pub fn new(kind: StateKind, per_sample: &[f64]) -> Result<Self, DataError> {
        let lowest = if kind == StateKind::Wavelength {
            f64::MIN_POSITIVE
        } else {
            f64::MIN
        };
        if let Some(wrong) = per_sample.iter().find(|v| !(lowest..=f64::MAX).contains(*v)) {
            let (name, allowed) = match kind {
                StateKind::Wavelength => ("wavelength of a sample", "a finite number above 0"),
                StateKind::Time => ("time of a sample", "a finite number"),
                StateKind::Frame => ("frame of a sample", "a finite number"),
                StateKind::Spectrum => ("spectrum of a sample", "a finite number"),
            };
            return Err(DataError::setting(name, allowed, wrong));
        }
        if per_sample.is_empty() {
            return Err(DataError::NoSamples);
        }
        let mut values = per_sample.to_vec();
        values.sort_by(f64::total_cmp);
        values.dedup();
        let index = |v: &f64| values.partition_point(|known| known < v);
        let of_samples = per_sample.iter().map(index).collect();
        Ok(Self {
            kind,
            values,
            of_samples,
        })
    }

    /// The quantity that differs between the states.
    pub fn kind(&self) -> StateKind {
        self.kind
    }

    /// The distinct values, in ascending order: at least one.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The index of a sample's value in [`values`](Self::values).
    ///
    /// # Panics
    /// When there is no such sample.
    pub fn index_of_sample(&self, sample: usize) -> usize {
        self.of_samples[sample]
    }

    /// The value of every sample, in sample order.
    pub fn per_sample(&self) -> impl ExactSizeIterator<Item = f64> + '_ {
        self.of_samples.iter().map(|&index| self.values[index])
    }

    /// The value of a sample, with its name and unit.
    fn describe_sample(&self, sample: usize) -> String {
        self.kind.describe(self.values[self.of_samples[sample]])
    }
}

/// The positions of the samples, in order, and the shape of their field if it is known. If the PSF
/// also depends on a wavelength, a time or a frame, every sample has its state, too.
///
/// There is at least one position. No two samples of one state have the same position. If the field
/// is known, all positions lie on it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawSamplePositions")]
pub struct SamplePositions {
    positions: Vec<Position>,
    field: Option<FrameShape>,
    #[serde(skip_serializing_if = "Option::is_none")]
    states: Option<SampleStates>,
}

#[derive(Deserialize)]
struct RawSamplePositions {
    positions: Vec<Position>,
    field: Option<FrameShape>,
    states: Option<SampleStates>,
}

impl TryFrom<RawSamplePositions> for SamplePositions {
    type Error = DataError;
    fn try_from(raw: RawSamplePositions) -> Result<Self, DataError> {
        Self::with_states(raw.positions, raw.field, raw.states)
    }
}

impl SamplePositions {
    /// Positions of samples that all have the same state, on a field of the given shape if it is
    /// known. Positions may lie up to one pixel outside the field ([`FrameShape::is_near`]).
    ///
    /// # Errors
    /// [`DataError::NoSamples`], [`DataError::DuplicatePosition`] or [`DataError::OutsideField`].
    pub fn new(positions: Vec<Position>, field: Option<FrameShape>) -> Result<Self, DataError> {
        Self::with_states(positions, field, None)
    }

    /// Positions of samples, each with its state.
    ///
    /// # Errors
    /// The errors of [`new`](Self::new), [`DataError::DuplicateState`], and
    /// [`DataError::CountMismatch`] unless there is one state per position.
    pub fn with_states(
        positions: Vec<Position>,
        field: Option<FrameShape>,
        states: Option<SampleStates>,
    ) -> Result<Self, DataError> {
        if positions.is_empty() {
            return Err(DataError::NoSamples);
        }
        if let Some(states) = &states {
            let what = "states (such as wavelengths), one for each position";
            DataError::check_count(what, positions.len(), states.of_samples.len())?;
        }
        if let Some(field) = field
            && let Some(sample) = positions.iter().position(|&p| !field.is_near(p))
        {
            return Err(DataError::OutsideField {
                sample,
                position: positions[sample],
                field,
            });
        }
        let mut seen = HashMap::with_capacity(positions.len());
        for (second, &position) in positions.iter().enumerate() {
            let state = states.as_ref().map(|states| states.of_samples[second]);
            if let Some(first) = seen.insert((position.bits(), state), second) {
                return Err(match states {
                    None => DataError::DuplicatePosition {
                        first,
                        second,
                        position,
                    },
                    Some(states) => DataError::DuplicateState {
                        first,
                        second,
                        position,
                        state: states.describe_sample(second),
                    },
                });
            }
        }
        Ok(Self {
            positions,
            field,
            states,
        })
    }

    /// Repeats the positions in every state: once for each value of `kind`. The samples of the first state
    /// come first.
    ///
    /// ```
    /// use psf_types::{Position, SamplePositions, StateKind};
    /// let at = [Position::of_pixel(0, 0), Position::of_pixel(9, 0)];
    /// let positions = SamplePositions::in_every_state(&at, None, StateKind::Wavelength, &[0.5, 0.7])?;
    /// assert_eq!((positions.len(), positions.samples_of_state(1)), (4, vec![2, 3]));
    /// # Ok::<(), psf_types::DataError>(())
    /// ```
    ///
    /// # Errors
    /// The errors of [`SampleStates::new`] and [`with_states`](Self::with_states).
    pub fn in_every_state(
        positions: &[Position],
        field: Option<FrameShape>,
        kind: StateKind,
        values: &[f64],
    ) -> Result<Self, DataError> {
        let each = |&value| std::iter::repeat_n(value, positions.len());
        let per_sample: Vec<f64> = values.iter().flat_map(each).collect();
        let states = SampleStates::new(kind, &per_sample)?;
        Self::with_states(positions.repeat(values.len()), field, Some(states))
    }

    /// The positions, in sample order.
    pub fn as_slice(&self) -> &[Position] {
        &self.positions
    }

    /// Number of samples, at least 1.
    #[allow(clippy::len_without_is_empty, reason = "never empty")]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// The shape of the field, if it is known.
    pub fn field(&self) -> Option<FrameShape> {
        self.field
    }

    /// The states of the samples. None if the PSF depends on the position only.
    pub fn states(&self) -> Option<&SampleStates> {
        self.states.as_ref()
    }

    /// The number of states: 1 if the PSF depends on the position only.
    pub fn state_count(&self) -> usize {
        self.states.as_ref().map_or(1, |states| states.values.len())
    }

    /// The indices of the samples in one state, in ascending order.
    pub fn samples_of_state(&self, state: usize) -> Vec<usize> {
        let in_state = |&sample: &usize| self.states.as_ref().is_none_or(|s| s.of_samples[sample] == state);
        (0..self.len()).filter(in_state).collect()
    }

    /// The positions of the samples in one state.
    ///
    /// # Panics
    /// When there is no such state.
    #[must_use]
    pub fn of_state(&self, state: usize) -> Self {
        self.select(&self.samples_of_state(state))
            .expect("positions in a state are distinct")
    }

    /// The positions of some samples, without their states.
    ///
    /// # Errors
    /// [`DataError::NoSamples`] or [`DataError::DuplicatePosition`].
    ///
    /// # Panics
    /// When there is no such sample.
    pub fn select(&self, samples: &[usize]) -> Result<Self, DataError> {
        let positions = samples.iter().map(|&sample| self.positions[sample]).collect();
        Self::new(positions, self.field)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(columns: &[i64]) -> Vec<Position> {
        columns.iter().map(|&x| Position::of_pixel(x, 0)).collect()
    }

    #[test]
    fn a_position_may_appear_once_per_state() {
        let states = |values: &[f64]| SampleStates::new(StateKind::Wavelength, values).unwrap();
        let positions =
            SamplePositions::with_states(at(&[0, 5, 0]), None, Some(states(&[0.5, 0.5, 0.7]))).unwrap();
        assert_eq!(positions.state_count(), 2);
        assert_eq!(positions.samples_of_state(0), [0, 1]);
        assert_eq!(positions.samples_of_state(1), [2]);
        let twice = SamplePositions::with_states(at(&[0, 5, 0]), None, Some(states(&[0.5, 0.7, 0.5])));
        let message = twice.unwrap_err().to_string();
        assert!(message.contains("wavelength 0.5 um"), "{message}");
        assert!(SamplePositions::with_states(at(&[0, 5]), None, Some(states(&[0.5]))).is_err());
    }

    #[test]
    fn states_survive_serde_and_files_without_states_are_read() {
        let states = SampleStates::new(StateKind::Time, &[3.0, 1.0]).unwrap();
        let positions = SamplePositions::with_states(at(&[0, 5]), None, Some(states)).unwrap();
        let text = serde_json::to_string(&positions).unwrap();
        assert_eq!(serde_json::from_str::<SamplePositions>(&text).unwrap(), positions);
        let old = r#"{"positions": [[0.0, 0.0]], "field": null}"#;
        assert_eq!(
            serde_json::from_str::<SamplePositions>(old).unwrap().states(),
            None
        );
        assert!(
            serde_json::from_str::<SampleStates>(r#"{"kind": "Wavelength", "of_samples": [0.0]}"#).is_err()
        );
    }
}
