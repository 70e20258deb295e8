//! Measures sizes and shapes of many stamps.

use metrics::{AdaptiveMomentFinder, AdaptiveMoments, GaussianFit, GaussianFitter, Window};
use ndarray::{ArrayView2, ArrayView3};
use psf_types::{Position, PsfSamples, Real};
use rayon::prelude::*;
use serde::Serialize;

psf_types::table_row! {
    /// The measurements of one PSF. A field is None if its measurement failed. In this case, `note`
    /// says why. `x` and `y` are the given position, None if there is none.
    ///
    /// The fields from `flux` to `eccentricity` are from the fit of an elliptical Gaussian with axes
    /// `a >= b` (`fwhm_px` is the geometric mean, `eccentricity = sqrt(1 - b^2 / a^2)`). `angle_rad` is
    /// the direction of the major axis, from +x towards +y. The fields from `e1` to `ellipticity` are
    /// from adaptive moments (`e`: distortion, `g`: reduced shear, `ellipticity = |e1 + i e2|`). Widths
    /// and `sigma_px` are in pixels of the array, but [`MeasureOptions::samples`] returns them in frame
    /// pixels.
    #[derive(Debug, Clone, PartialEq, Default, Serialize)]
    #[non_exhaustive]
    #[allow(missing_docs, reason = "the columns of the table, described above")]
    MEASUREMENT_COLUMNS Measurement {
        x: Option<f64>,
        y: Option<f64>,
        flux: Option<f64>,
        x_centroid: Option<f64>,
        y_centroid: Option<f64>,
        fwhm_px: Option<f64>,
        fwhm_major_px: Option<f64>,
        fwhm_minor_px: Option<f64>,
        angle_rad: Option<f64>,
        eccentricity: Option<f64>,
        e1: Option<f64>,
        e2: Option<f64>,
        g1: Option<f64>,
        g2: Option<f64>,
        sigma_px: Option<f64>,
        ellipticity: Option<f64>,
        note: String,
    }
}

/// Options for the measurement of PSFs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MeasureOptions {
    /// The size, in pixels along each axis, of the window to which the Gaussian is fitted. On a
    /// stamp, the window is central. On an image, it lies about the position. None: the whole stamp
    /// or, on an image, [`MeasureOptions::IMAGE_WINDOW`] pixels.
    pub window: Option<usize>,
    /// If true, a constant background is fitted too.
    pub background: bool,
}

impl MeasureOptions {
    /// The size of the window about each position of an image, in pixels, if the caller gives none.
    pub const IMAGE_WINDOW: usize = 15;

    /// Measures the stamps of samples. Widths and fluxes are converted to frame pixels: widths are
    /// divided by the oversampling, and fluxes by its square. `window` is in pixels of the stamp,
    /// and centroids are 0-based stamp indices. Adaptive moments use the whole stamp.
    pub fn samples(self, samples: &PsfSamples) -> Vec<Measurement> {
        let mut rows = self.cube(samples.stamps(), Some(samples.positions().as_slice()));
        let (grid, scale) = (samples.grid(), samples.grid().oversampling());
        for row in &mut rows {
            row.flux = row.flux.map(|flux| grid.flux_of_sum(flux));
            for length in [
                &mut row.fwhm_px,
                &mut row.fwhm_major_px,
                &mut row.fwhm_minor_px,
                &mut row.sigma_px,
            ] {
                *length = length.map(|pixels| pixels / scale);
            }
        }
        rows
    }

    /// Measures every plane of a cube `[plane, y, x]`. `positions` has one position per plane.
    /// Centroids are 0-based indices of the plane. Adaptive moments use the whole plane.
    pub fn cube<T: Real>(self, cube: ArrayView3<'_, T>, positions: Option<&[Position]>) -> Vec<Measurement> {
        let fit_window = self.window.map_or_else(Window::whole, Window::central);
        (0..cube.dim().0)
            .into_par_iter()
            .map(|plane| {
                let at = positions.map(|p| p[plane]);
                self.one(
                    cube.index_axis(ndarray::Axis(0), plane),
                    at,
                    fit_window,
                    Window::whole(),
                )
            })
            .collect()
    }

    /// Measures an image in a window about each position. Centroids are in pixels of the image.
    /// Adaptive moments use the same window, so that light outside it has no effect.
    pub fn image<T: Real>(self, image: ArrayView2<'_, T>, positions: &[Position]) -> Vec<Measurement> {
        let size = self.window.unwrap_or(Self::IMAGE_WINDOW);
        let (ny, nx) = image.dim();
        positions
            .par_iter()
            .map(|&p| {
                let index = |v: f64, n: usize| {
                    let nearest = (v + 0.5).floor();
                    (nearest >= 0.0 && nearest < n as f64).then_some(nearest as usize)
                };
                match (index(p.x(), nx), index(p.y(), ny)) {
                    (Some(column), Some(row)) => {
                        let window = Window::about(size, column, row);
                        self.one(image, Some(p), window, window)
                    }
                    _ => Measurement {
                        x: Some(p.x()),
                        y: Some(p.y()),
                        note: format!("the position {p} lies outside the image of {nx} x {ny} pixels"),
                        ..Measurement::default()
                    },
                }
            })
            .collect()
    }

    fn one<T: Real>(
        self,
        stamp: ArrayView2<'_, T>,
        at: Option<Position>,
        fit_window: Window,
        moment_window: Window,
    ) -> Measurement {
        let fit = GaussianFitter::elliptical()
            .with_background(self.background)
            .with_window(fit_window)
            .fit(stamp);
        let moments = AdaptiveMomentFinder::new()
            .with_window(moment_window)
            .measure(stamp);
        let mut notes = Vec::new();
        let fit = fit.map_err(|e| notes.push(format!("Gaussian fit: {e}"))).ok();
        let moments = moments
            .map_err(|e| notes.push(format!("adaptive moments: {e}")))
            .ok();
        let (fit, moments) = (fit.as_ref(), moments.as_ref());
        Measurement {
            x: at.map(Position::x),
            y: at.map(Position::y),
            flux: fit.map(GaussianFit::flux),
            x_centroid: fit.map(GaussianFit::x_centroid),
            y_centroid: fit.map(GaussianFit::y_centroid),
            fwhm_px: fit.map(GaussianFit::fwhm_px),
            fwhm_major_px: fit.map(GaussianFit::fwhm_major_px),
            fwhm_minor_px: fit.map(GaussianFit::fwhm_minor_px),
            angle_rad: fit.map(GaussianFit::angle_rad),
            eccentricity: fit.map(GaussianFit::eccentricity),
            e1: moments.map(AdaptiveMoments::e1),
            e2: moments.map(AdaptiveMoments::e2),
            g1: moments.map(AdaptiveMoments::g1),
            g2: moments.map(AdaptiveMoments::g2),
            sigma_px: moments.map(AdaptiveMoments::sigma_px),
            ellipticity: moments.map(AdaptiveMoments::ellipticity),
            note: notes.join("; "),
        }
    }
}

impl Measurement {
    /// Returns whether neither the Gaussian fit nor the adaptive moments gave a result.
    pub fn has_failed(&self) -> bool {
        self.flux.is_none() && self.sigma_px.is_none()
    }
}
