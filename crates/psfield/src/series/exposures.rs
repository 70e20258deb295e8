//! The times of a series' exposures.

use crate::error::{ErrorKind, PsfieldError};

/// The most exposures of a series.
const MOST: usize = 1_000_000;

/// The exposures of a series: when each begins, in seconds after the start of the series, and how long
/// all of them last.
///
/// ```
/// use psfield::series::Exposures;
/// let exposures = Exposures::regular(100, 30.0, 40.0)?;
/// assert_eq!(exposures.times(2), (80.0, 110.0));
/// assert!(Exposures::regular(100, 30.0, 20.0).is_err()); // they would overlap
/// # Ok::<(), psfield::PsfieldError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Exposures {
    starts_s: Vec<f64>,
    exposure_s: f64,
}

impl Exposures {
    /// Exposures that begin at these times, in seconds.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`] without exposures or for more than a million, for an exposure time that is not
    /// above 0, or for exposures that overlap or are not in the order of time.
    pub fn new(starts_s: Vec<f64>, exposure_s: f64) -> Result<Self, PsfieldError> {
        let refused = |setting, message: String| Err(PsfieldError::of_setting(setting, message));
        if !(exposure_s > 0.0 && exposure_s.is_finite()) {
            let message =
                format!("the exposure time must be a finite number of seconds above 0, not {exposure_s}");
            return refused("exposure_s", message);
        }
        if starts_s.is_empty() {
            return refused("starts_s", "a series needs at least one exposure".to_owned());
        }
        check_count(starts_s.len()).map_err(|error| error.with_setting("starts_s"))?;
        if let Some(number) = starts_s.iter().position(|start| !start.is_finite()) {
            let message = format!(
                "exposure {number} begins at {} s: give a finite time",
                starts_s[number]
            );
            return refused("starts_s", message);
        }
        // Starts that are written in decimals may overlap by rounding.
        let rounding = 1e-9 * exposure_s;
        let overlaps = |pair: &[f64]| pair[1] < pair[0] + exposure_s - rounding;
        if let Some(before) = starts_s.windows(2).position(overlaps) {
            let (end, next) = (starts_s[before] + exposure_s, starts_s[before + 1]);
            let message = format!(
                "exposure {} begins at {next} s, before exposure {before} ends ({end} s): exposures must follow one another",
                before + 1
            );
            return refused("starts_s", message);
        }
        Ok(Self { starts_s, exposure_s })
    }

    /// `count` exposures, which begin every `cadence_s` seconds, the first at time 0.
    ///
    /// # Errors
    /// As for [`new`](Self::new).
    pub fn regular(count: usize, exposure_s: f64, cadence_s: f64) -> Result<Self, PsfieldError> {
        check_count(count)?;
        let starts = (0..count).map(|number| number as f64 * cadence_s).collect();
        Self::new(starts, exposure_s).map_err(|error| match error.setting() {
            Some("starts_s") if count > 0 => error.with_setting("cadence_s"),
            Some("starts_s") => error.with_setting("count"),
            _ => error,
        })
    }

    /// The number of exposures, at least 1.
    #[allow(clippy::len_without_is_empty, reason = "never empty")]
    pub fn len(&self) -> usize {
        self.starts_s.len()
    }

    /// The exposure time in seconds.
    pub fn exposure_s(&self) -> f64 {
        self.exposure_s
    }

    /// Start and end of an exposure in seconds.
    ///
    /// # Panics
    /// When there is no such exposure.
    pub fn times(&self, number: usize) -> (f64, f64) {
        let start = self.starts_s[number];
        (start, start + self.exposure_s)
    }
}

fn check_count(count: usize) -> Result<(), PsfieldError> {
    if count <= MOST {
        return Ok(());
    }
    let message = format!("a series has at most {MOST} exposures, not {count}");
    Err(PsfieldError::of_setting("count", message))
}

/// The start and the end of an exposure, and between them the times of a table that lie inside it.
pub(super) fn cut_at(table: &[f64], (from, to): (f64, f64)) -> Vec<f64> {
    let inside = table.iter().copied().filter(|&time| from < time && time < to);
    std::iter::once(from).chain(inside).chain([to]).collect()
}

/// Returns an error if a table does not cover all the time of an exposure.
pub(super) fn check_covered(
    what: &str,
    (first, last): (f64, f64),
    (from, to): (f64, f64),
) -> Result<(), PsfieldError> {
    let rounding = 1e-9 * (to - from);
    if first <= from + rounding && to - rounding <= last {
        return Ok(());
    }
    let message = format!(
        "{what} is known from {first} to {last} s, but an exposure lasts from {from} to {to} s: add rows for these times, or \
         leave out the exposure"
    );
    Err(PsfieldError::new(ErrorKind::Data, message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposures_follow_one_another() {
        assert!(Exposures::new(vec![0.0, 0.1, 0.2, 0.3], 0.1).is_ok());
        for (starts, exposure, setting, part) in [
            (vec![], 1.0, "starts_s", "at least one"),
            (vec![0.0, 2.0, 1.0], 0.5, "starts_s", "exposure 2 begins at 1 s"),
            (
                vec![0.0, 2.0, 2.9],
                1.0,
                "starts_s",
                "before exposure 1 ends (3 s)",
            ),
            (vec![0.0, f64::NAN], 1.0, "starts_s", "exposure 1"),
            (vec![0.0], 0.0, "exposure_s", "above 0"),
        ] {
            let error = Exposures::new(starts, exposure).unwrap_err();
            assert_eq!(error.setting(), Some(setting), "{error}");
            assert!(error.to_string().contains(part), "{error}");
        }
        let error = Exposures::regular(1 << 60, 1.0, 1.0).unwrap_err();
        assert_eq!(error.setting(), Some("count"));
        assert!(error.to_string().contains("at most 1000000 exposures"), "{error}");
        let error = Exposures::regular(3, 10.0, 9.0).unwrap_err();
        assert_eq!(error.setting(), Some("cadence_s"));
    }
}
