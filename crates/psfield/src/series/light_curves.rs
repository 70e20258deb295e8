//! Sources whose flux changes with time.

use std::collections::BTreeMap;

use super::exposures::check_covered;
use super::pointing::ascending;
use crate::error::{ErrorKind, PsfieldError};

/// Light curves: by which factor the flux of a source differs from that of the catalogue, as a function
/// of time. Between the times of a curve, the factor is linear. Sources without a curve are constant.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LightCurves {
    /// Times and factors, by the row of the source.
    of_rows: BTreeMap<usize, Vec<(f64, f64)>>,
}

impl LightCurves {
    /// Light curves from three columns: the row of the source in its catalogue (counted from 0), the
    /// time in seconds after the start of the series, and the factor.
    ///
    /// ```
    /// use psfield::series::LightCurves;
    /// let curves = LightCurves::new(&[4.0, 4.0], &[0.0, 100.0], &[1.0, 3.0])?;
    /// assert_eq!(curves.mean_factor(4, (0.0, 50.0))?, 1.5);
    /// assert_eq!(curves.mean_factor(5, (0.0, 50.0))?, 1.0);
    /// # Ok::<(), psfield::PsfieldError>(())
    /// ```
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for columns of different lengths, a row that is not a whole number, a factor
    /// that is not finite, times of a source that do not ascend, or a curve of one time.
    pub fn new(rows: &[f64], times_s: &[f64], factors: &[f64]) -> Result<Self, PsfieldError> {
        let refused = |message: String| Err(PsfieldError::new(ErrorKind::Data, message));
        if rows.len() != times_s.len() || rows.len() != factors.len() {
            return refused("the columns of light curves have different lengths".to_owned());
        }
        let mut of_rows: BTreeMap<usize, Vec<(f64, f64)>> = BTreeMap::new();
        for (line, (&row, (&time, &factor))) in rows.iter().zip(times_s.iter().zip(factors)).enumerate() {
            let place = format!("row {line} of the light curves (counted from 0)");
            if !(row >= 0.0 && row.fract() == 0.0 && row < 2f64.powi(53)) {
                return refused(format!(
                    "{place}: the row of a source is a whole number, 0 for the first, not {row}"
                ));
            }
            if !(factor.is_finite() && time.is_finite()) {
                return refused(format!("{place}: time and factor must be finite"));
            }
            let curve = of_rows.entry(row as usize).or_default();
            if let Some(&(before, _)) = curve.last()
                && !ascending(&[before, time])
            {
                return refused(format!(
                    "{place}: the times of source {row} must ascend, but {time} s follows {before} s"
                ));
            }
            curve.push((time, factor));
        }
        if let Some((row, _)) = of_rows.iter().find(|(_, curve)| curve.len() < 2) {
            return refused(format!(
                "the light curve of source {row} has one time: give two or more"
            ));
        }
        Ok(Self { of_rows })
    }

    /// The rows of the sources that have a curve, ascending.
    pub fn rows(&self) -> impl Iterator<Item = usize> {
        self.of_rows.keys().copied()
    }

    /// The mean factor of a source between two times in seconds. 1 for a source without a curve.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] if the curve does not cover this time.
    pub fn mean_factor(&self, row: usize, (from, to): (f64, f64)) -> Result<f64, PsfieldError> {
        let Some(curve) = self.of_rows.get(&row) else {
            return Ok(1.0);
        };
        let known = (curve[0].0, curve[curve.len() - 1].0);
        check_covered(&format!("the light curve of source {row}"), known, (from, to))?;
        let first = curve.partition_point(|&(time, _)| time <= from).max(1);
        let mut sum = 0.0;
        for pair in curve[first - 1..].windows(2) {
            let ((a, low), (b, high)) = (pair[0], pair[1]);
            let (start, end) = (a.max(from), b.min(to));
            if start >= end {
                break;
            }
            let middle = (0.5 * (start + end) - a) / (b - a);
            sum += (end - start) * ((1.0 - middle) * low + middle * high);
        }
        Ok(sum / (to - from))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_are_means_over_the_exposure() {
        let curves = LightCurves::new(
            &[1.0, 1.0, 0.0, 1.0, 0.0],
            &[0.0, 10.0, -5.0, 20.0, 50.0],
            &[0.0, 2.0, 1.0, 1.0, 1.0],
        )
        .unwrap();
        assert_eq!(curves.rows().collect::<Vec<_>>(), [0, 1]);
        // 5 to 10 s: mean 1.5. 10 to 20 s: mean 1.5.
        assert!((curves.mean_factor(1, (5.0, 20.0)).unwrap() - 1.5).abs() < 1e-14);
        assert_eq!(curves.mean_factor(0, (7.0, 9.0)).unwrap(), 1.0);
        assert_eq!(curves.mean_factor(9, (7.0, 9.0)).unwrap(), 1.0);
        let error = curves.mean_factor(1, (15.0, 25.0)).unwrap_err().to_string();
        assert!(
            error.contains("source 1") && error.contains("0 to 20 s"),
            "{error}"
        );
    }

    #[test]
    fn wrong_curves_name_the_row() {
        for (rows, times, factors, part) in [
            (vec![0.5, 0.5], vec![0.0, 1.0], vec![1.0, 1.0], "whole number"),
            (vec![-1.0, -1.0], vec![0.0, 1.0], vec![1.0, 1.0], "row 0"),
            (vec![3.0, 3.0], vec![1.0, 1.0], vec![1.0, 1.0], "must ascend"),
            (vec![3.0, 3.0], vec![0.0, 1.0], vec![1.0, f64::NAN], "row 1"),
            (vec![3.0], vec![0.0], vec![1.0], "one time"),
        ] {
            let error = LightCurves::new(&rows, &times, &factors).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }
}
