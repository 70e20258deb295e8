//! Curves over the wavelength, linear between their rows.

use crate::error::SpectraError;

/// Values at ascending wavelengths, linear in between.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    wavelengths_um: Vec<f64>,
    values: Vec<f64>,
}

impl Curve {
    /// A curve from its rows. Wavelengths are in micrometres.
    ///
    /// # Errors
    /// [`SpectraError`] for fewer than two rows, wavelengths that do not ascend or are not above 0,
    /// values that are negative or not finite, or a curve that is 0 everywhere.
    pub fn new(wavelengths_um: Vec<f64>, values: Vec<f64>) -> Result<Self, SpectraError> {
        if wavelengths_um.len() < 2 || wavelengths_um.len() != values.len() {
            let (wavelengths, values) = (wavelengths_um.len(), values.len());
            return Err(SpectraError::TooShort { wavelengths, values });
        }
        for (row, (&wavelength, &value)) in wavelengths_um.iter().zip(&values).enumerate() {
            let checks = [
                (
                    wavelength,
                    wavelength > 0.0,
                    "a wavelength must be finite and above 0",
                ),
                (value, value >= 0.0, "a value must be finite and 0 or more"),
            ];
            for (got, is_sound, what) in checks {
                if !(is_sound && got.is_finite()) {
                    return Err(SpectraError::Value { row, what, got });
                }
            }
        }
        if let Some(row) = wavelengths_um.windows(2).position(|pair| pair[0] >= pair[1]) {
            return Err(SpectraError::NotAscending {
                row: row + 1,
                previous: wavelengths_um[row],
                next: wavelengths_um[row + 1],
            });
        }
        if values.iter().all(|&v| v == 0.0) {
            return Err(SpectraError::Dark);
        }
        Ok(Self {
            wavelengths_um,
            values,
        })
    }

    /// The wavelengths, ascending, in micrometres.
    pub fn wavelengths_um(&self) -> &[f64] {
        &self.wavelengths_um
    }

    /// The values, one for each wavelength.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The value at a wavelength. 0 outside the rows.
    pub fn at(&self, wavelength_um: f64) -> f64 {
        let above = self.wavelengths_um.partition_point(|&w| w <= wavelength_um);
        let last = self.wavelengths_um.len() - 1;
        if above == 0 || wavelength_um > self.wavelengths_um[last] {
            return 0.0;
        }
        let row = above.min(last) - 1;
        let (a, b) = (self.wavelengths_um[row], self.wavelengths_um[row + 1]);
        let t = (wavelength_um - a) / (b - a);
        (1.0 - t) * self.values[row] + t * self.values[row + 1]
    }

    /// The first and the last wavelength.
    pub(crate) fn range(&self) -> (f64, f64) {
        (
            self.wavelengths_um[0],
            self.wavelengths_um[self.wavelengths_um.len() - 1],
        )
    }
}

/// The fraction of photons that the atmosphere, the telescope, the filter and the detector let pass,
/// as a function of the wavelength. Its scale does not matter.
#[derive(Debug, Clone, PartialEq)]
pub struct Bandpass(Curve);

impl Bandpass {
    /// A bandpass from the curve of its throughput.
    pub fn new(throughput: Curve) -> Self {
        Self(throughput)
    }

    /// The throughput.
    pub fn throughput(&self) -> &Curve {
        &self.0
    }

    /// The range outside which nothing passes, in micrometres.
    ///
    /// ```
    /// use spectra::{Bandpass, Curve};
    /// let curve = Curve::new(vec![0.4, 0.5, 0.6, 0.7, 0.8], vec![0.0, 0.0, 1.0, 0.0, 0.0])?;
    /// assert_eq!(Bandpass::new(curve).range_um(), (0.5, 0.7));
    /// # Ok::<(), spectra::SpectraError>(())
    /// ```
    pub fn range_um(&self) -> (f64, f64) {
        let (wavelengths, values) = (&self.0.wavelengths_um, &self.0.values);
        let first = values.iter().position(|&v| v > 0.0).expect("a curve has light");
        let last = values.iter().rposition(|&v| v > 0.0).expect("a curve has light");
        (
            wavelengths[first.saturating_sub(1)],
            wavelengths[(last + 1).min(wavelengths.len() - 1)],
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_are_linear_between_rows_and_zero_outside() {
        let curve = Curve::new(vec![0.5, 0.6, 0.8], vec![1.0, 3.0, 0.0]).unwrap();
        for (at, expected) in [
            (0.4, 0.0),
            (0.5, 1.0),
            (0.55, 2.0),
            (0.7, 1.5),
            (0.8, 0.0),
            (0.9, 0.0),
        ] {
            assert!((curve.at(at) - expected).abs() < 1e-12, "{at}");
        }
    }

    #[test]
    fn rows_that_break_a_rule_are_named() {
        let message = |w: &[f64], v: &[f64]| Curve::new(w.to_vec(), v.to_vec()).unwrap_err().to_string();
        for (wavelengths, values, part) in [
            (&[0.5][..], &[1.0][..], "two or more wavelengths"),
            (&[0.5, 0.6], &[1.0], "got 2 and 1"),
            (
                &[0.5, 0.7, 0.6],
                &[1.0; 3],
                "row 2 (0-based) has 0.6 um after 0.7 um",
            ),
            (&[0.5, 0.5], &[1.0; 2], "remove repeated"),
            (&[-0.5, 0.5], &[1.0; 2], "row 0 (0-based): a wavelength must be"),
            (&[0.5, 0.6], &[1.0, -1.0], "row 1 (0-based): a value must be"),
            (&[0.5, 0.6], &[0.0; 2], "every value of the curve is 0"),
        ] {
            let found = message(wavelengths, values);
            assert!(found.contains(part), "{found}");
        }
    }
}
