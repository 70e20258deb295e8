//! Where the telescope points during a series.

use crate::error::{ErrorKind, PsfieldError};
use crate::psf::Motion;

use super::exposures::{check_covered, cut_at};

/// By how far light is shifted on the frame because the telescope does not point exactly where it
/// should: `d(t) = drift t + path(t)`, in pixels, and fast random motion in addition.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Pointing {
    /// The drift along x and y, in pixels per second.
    pub drift_px_per_s: [f64; 2],
    /// The r.m.s. along each axis, in pixels, of normally distributed motion that is fast compared with
    /// an exposure.
    pub jitter_px: f64,
    /// The shift as a function of time.
    pub path: Option<PointingPath>,
}

/// Shifts of light on the frame at given times. Between them, the light moves along straight lines at
/// constant speed.
#[derive(Debug, Clone, PartialEq)]
pub struct PointingPath {
    times_s: Vec<f64>,
    shifts_px: Vec<[f64; 2]>,
}

impl PointingPath {
    /// Shifts along x and y in pixels, at times in seconds.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] unless there are two or more times, in ascending order, and one finite shift
    /// (x, y) for each.
    pub fn new(times_s: Vec<f64>, dx: &[f64], dy: &[f64]) -> Result<Self, PsfieldError> {
        let refused = |message: String| Err(PsfieldError::new(ErrorKind::Data, message));
        if times_s.len() < 2 || times_s.len() != dx.len() || times_s.len() != dy.len() {
            return refused(format!(
                "a path needs two or more rows of a time and two shifts, but there are {} times, {} and {} shifts",
                times_s.len(),
                dx.len(),
                dy.len()
            ));
        }
        if let Some(row) = times_s.windows(2).position(|pair| !ascending(pair)) {
            let (time, next) = (times_s[row], times_s[row + 1]);
            return refused(format!(
                "the times must ascend, but time {next} of row {} (counted from 0) follows time {time}",
                row + 1
            ));
        }
        if let Some(row) = (0..dx.len()).find(|&row| !(dx[row].is_finite() && dy[row].is_finite())) {
            return refused(format!("the shift in row {row} (counted from 0) is not finite"));
        }
        let shifts_px = dx.iter().zip(dy).map(|(&x, &y)| [x, y]).collect();
        Ok(Self { times_s, shifts_px })
    }

    fn at(&self, time: f64) -> [f64; 2] {
        let last = self.times_s.len() - 1;
        let above = self
            .times_s
            .partition_point(|&known| known <= time)
            .clamp(1, last);
        let (from, to) = (self.times_s[above - 1], self.times_s[above]);
        let part = ((time - from) / (to - from)).clamp(0.0, 1.0);
        let (a, b) = (self.shifts_px[above - 1], self.shifts_px[above]);
        [0, 1].map(|axis| (1.0 - part) * a[axis] + part * b[axis])
    }
}

/// Returns whether two finite times ascend.
pub(super) fn ascending(pair: &[f64]) -> bool {
    pair[0] < pair[1] && pair[0].is_finite() && pair[1].is_finite()
}

impl Pointing {
    /// The pointing as a source with this velocity sees it, without jitter.
    pub(super) fn with_velocity(&self, velocity: [f64; 2]) -> Self {
        let [vx, vy] = self.drift_px_per_s;
        Self {
            drift_px_per_s: [vx + velocity[0], vy + velocity[1]],
            jitter_px: 0.0,
            path: self.path.clone(),
        }
    }

    /// The motion of light between two times in seconds.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] if the path does not cover this time or a shift is not finite, and
    /// [`ErrorKind::Setting`] for a jitter below 0.
    pub fn during(&self, (from, to): (f64, f64)) -> Result<Motion, PsfieldError> {
        let known: &[f64] = self.path.as_ref().map_or(&[], |path| &path.times_s);
        if let [first, .., last] = known {
            check_covered("the path of the pointing", (*first, *last), (from, to))?;
        }
        let times = cut_at(known, (from, to));
        let at = |time: f64| {
            let of_path = self.path.as_ref().map_or([0.0, 0.0], |path| path.at(time));
            [0, 1].map(|axis| self.drift_px_per_s[axis] * time + of_path[axis])
        };
        let line = |pair: &[f64]| Ok((pair[1] - pair[0], Motion::along_line(at(pair[0]), at(pair[1]))?));
        let lines = times.windows(2).map(line);
        Motion::sequence(lines.collect::<Result<Vec<_>, PsfieldError>>()?)?.with_jitter_px(self.jitter_px)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of sums of a few numbers of order 10.
    const ROUNDING: f64 = 1e-12;

    #[test]
    fn a_path_and_a_drift_add_up() {
        let path = PointingPath::new(vec![0.0, 10.0, 30.0], &[0.0, 2.0, 2.0], &[1.0, 1.0, -3.0]).unwrap();
        let pointing = Pointing {
            drift_px_per_s: [0.1, 0.0],
            jitter_px: 0.2,
            path: Some(path),
        };
        // 0 to 10 s: mean path (1, 1). 10 to 20 s: (2, 0). Mean drift: 1.
        let motion = pointing.during((0.0, 20.0)).unwrap();
        let [x, y] = motion.mean();
        assert!(
            (x - 2.5).abs() < ROUNDING && (y - 0.5).abs() < ROUNDING,
            "{x} {y}"
        );
        // The second moment of a line of length L about its middle is L^2 / 12.
        let line = pointing.during((10.0, 20.0)).unwrap();
        let middle = line.mean();
        let along = |axis: usize| -> f64 {
            let square = |(weight, at): &(f64, [f64; 2])| weight * (at[axis] - middle[axis]).powi(2);
            line.points().iter().map(square).sum()
        };
        assert!((along(0) - 1.0 / 12.0).abs() < ROUNDING);
        assert!((along(1) - 4.0 / 12.0).abs() < ROUNDING);
        let error = pointing.during((25.0, 35.0)).unwrap_err().to_string();
        assert!(error.contains("from 0 to 30 s"), "{error}");
    }

    #[test]
    fn wrong_paths_name_the_row() {
        for (times, dx, part) in [
            (vec![0.0], vec![0.0], "two or more rows"),
            (vec![0.0, 2.0, 2.0], vec![0.0; 3], "row 2"),
            (vec![0.0, 2.0, 3.0], vec![0.0, f64::NAN, 0.0], "row 1"),
        ] {
            let zeros = vec![0.0; dx.len()];
            let error = PointingPath::new(times, &dx, &zeros).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }
}
