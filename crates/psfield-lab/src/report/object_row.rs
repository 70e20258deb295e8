//! The measurements of an object in its simulated and in its true image.

use metrics::{Comparison, Covariance, FWHM_PER_SIGMA, GaussianFit, GaussianFitter, MetricsError};
use ndarray::ArrayView2;
use psf_types::Position;
use serde::Serialize;

psf_types::table_row! {
    /// An object, measured in the same way in the same window of its simulated and of its true
    /// image. The fields of a failed measurement are None. `note` gives the reason if a Gaussian
    /// fit or the comparison of the two windows failed.
    #[derive(Debug, Clone, PartialEq, Default, Serialize)]
    #[non_exhaustive]
    #[allow(
        missing_docs,
        reason = "the columns of the table; the module's page defines them"
    )]
    OBJECT_COLUMNS ObjectRow {
        x: f64,
        y: f64,
        eccentricity: Option<f64>,
        eccentricity_true: Option<f64>,
        e1: Option<f64>,
        e1_true: Option<f64>,
        e2: Option<f64>,
        e2_true: Option<f64>,
        fwhm_px: Option<f64>,
        fwhm_px_true: Option<f64>,
        fwhm_rows_px: Option<f64>,
        fwhm_rows_px_true: Option<f64>,
        fwhm_columns_px: Option<f64>,
        fwhm_columns_px_true: Option<f64>,
        mae: Option<f64>,
        mse: Option<f64>,
        mae_over_mean: Option<f64>,
        relative_l2: Option<f64>,
        max_over_peak: Option<f64>,
        note: String,
    }
}

impl ObjectRow {
    /// Measures the object at `at` in two images: windows `[y, x]` of equal shape around the
    /// object, with `oversampling` pixels per frame pixel along each axis. Lengths in the row are
    /// in pixels of the frame.
    pub fn measure(
        at: Position,
        simulated: ArrayView2<'_, f64>,
        truth: ArrayView2<'_, f64>,
        oversampling: f64,
    ) -> Self {
        let mut notes = Vec::new();
        let mut fit = |image: ArrayView2<'_, f64>, which: &str| {
            let fit = GaussianFitter::elliptical().fit(image);
            fit.map_err(|e: MetricsError| notes.push(format!("Gaussian fit of the {which} image: {e}")))
                .ok()
        };
        let (ours, theirs) = (fit(simulated, "simulated"), fit(truth, "true"));
        let comparison = Comparison::of(simulated, truth)
            .map_err(|e| notes.push(format!("comparison: {e}")))
            .ok();
        let shape =
            |fit: &Option<GaussianFit>, of: fn(Covariance) -> f64| fit.as_ref().map(|f| of(f.covariance()));
        let fwhm = |fit: &Option<GaussianFit>, sigma: fn(Covariance) -> f64| {
            shape(fit, sigma).map(|pixels| FWHM_PER_SIGMA * pixels / oversampling)
        };
        let (rows, columns) = (|c: Covariance| c.xx().sqrt(), |c: Covariance| c.yy().sqrt());
        let e1 = |c: Covariance| c.distortion().e1();
        let e2 = |c: Covariance| c.distortion().e2();
        Self {
            x: at.x(),
            y: at.y(),
            eccentricity: shape(&ours, Covariance::eccentricity),
            eccentricity_true: shape(&theirs, Covariance::eccentricity),
            e1: shape(&ours, e1),
            e1_true: shape(&theirs, e1),
            e2: shape(&ours, e2),
            e2_true: shape(&theirs, e2),
            fwhm_px: fwhm(&ours, Covariance::sigma_px),
            fwhm_px_true: fwhm(&theirs, Covariance::sigma_px),
            fwhm_rows_px: fwhm(&ours, rows),
            fwhm_rows_px_true: fwhm(&theirs, rows),
            fwhm_columns_px: fwhm(&ours, columns),
            fwhm_columns_px_true: fwhm(&theirs, columns),
            mae: comparison.as_ref().map(Comparison::mae),
            mse: comparison.as_ref().map(Comparison::mse),
            mae_over_mean: comparison.as_ref().and_then(|c| c.mae_over_mean().ok()),
            relative_l2: comparison.as_ref().and_then(|c| c.relative_l2().ok()),
            max_over_peak: comparison.as_ref().and_then(|c| c.max_over_peak().ok()),
            note: notes.join("; "),
        }
    }

    /// The position of the object. None if a coordinate is not finite.
    pub fn position(&self) -> Option<Position> {
        Position::new(self.x, self.y).ok()
    }

    /// Simulated minus true eccentricity. None if one of them could not be measured.
    pub fn eccentricity_difference(&self) -> Option<f64> {
        Some(self.eccentricity? - self.eccentricity_true?)
    }

    /// Simulated minus true `e1`. None if one of them could not be measured.
    pub fn e1_difference(&self) -> Option<f64> {
        Some(self.e1? - self.e1_true?)
    }

    /// Simulated minus true `e2`. None if one of them could not be measured.
    pub fn e2_difference(&self) -> Option<f64> {
        Some(self.e2? - self.e2_true?)
    }

    /// Length of the difference of the distortions `(e1, e2)`, simulated minus true. None if one of
    /// them could not be measured.
    pub fn ellipticity_difference(&self) -> Option<f64> {
        Some(self.e1_difference()?.hypot(self.e2_difference()?))
    }

    /// Simulated minus true FWHM in pixels of the frame. None if one of them could not be measured.
    pub fn fwhm_difference_px(&self) -> Option<f64> {
        Some(self.fwhm_px? - self.fwhm_px_true?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    fn gaussian(sx: f64, sy: f64) -> Array2<f64> {
        Array2::from_shape_fn((41, 41), |(y, x)| {
            let (u, v) = ((x as f64 - 20.0) / sx, (y as f64 - 20.0) / sy);
            (-0.5 * (u * u + v * v)).exp()
        })
    }

    #[test]
    fn a_known_pair_has_its_known_differences() {
        let at = Position::of_pixel(3, 4);
        let (ours, truth) = (gaussian(3.0, 2.0), gaussian(3.0, 2.5));
        let row = ObjectRow::measure(at, ours.view(), truth.view(), 2.0);
        let e = |b: f64, a: f64| (1.0 - b * b / (a * a)).sqrt();
        let near = |got: Option<f64>, expected: f64| (got.unwrap() - expected).abs() < 1e-6;
        assert!(
            near(row.eccentricity_difference(), e(2.0, 3.0) - e(2.5, 3.0)),
            "{row:?}"
        );
        assert!(
            near(row.fwhm_rows_px, FWHM_PER_SIGMA * 1.5) && near(row.fwhm_columns_px, FWHM_PER_SIGMA * 1.0)
        );
        assert!(near(row.e1_difference(), 5.0 / 13.0 - 2.75 / 15.25));
        assert!(row.e2_difference().unwrap().abs() < 1e-9);
        assert!(row.note.is_empty() && row.mae_over_mean > Some(0.01));
        let same = ObjectRow::measure(at, truth.view(), truth.view(), 1.0);
        assert_eq!((same.mae, same.eccentricity_difference()), (Some(0.0), Some(0.0)));
    }

    #[test]
    fn what_cannot_be_measured_says_why() {
        let truth = gaussian(2.0, 2.0);
        let dark = Array2::zeros((41, 41));
        let row = ObjectRow::measure(Position::of_pixel(0, 0), dark.view(), truth.view(), 1.0);
        assert_eq!((row.eccentricity, row.eccentricity_difference()), (None, None));
        assert!(row.note.contains("simulated") && row.mae.is_some());
    }
}
