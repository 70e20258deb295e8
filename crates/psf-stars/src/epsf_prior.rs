//! The expected PSF before a fit, and the weights of pixels in the fit.

use psf_types::maths::FWHM_PER_SIGMA;

use crate::frame::Star;
use crate::surface::SurfaceGrid;
use crate::{Camera, Registration};

/// The accuracy of the PSF model, as a fraction of the star's flux in a pixel. It limits the weight
/// of bright stars (PSFEx's PSF_ACCURACY).
pub(crate) const ACCURACY: f64 = 0.02;
/// The accuracy of the PSF model, as a fraction of the PSF's peak. Without it, the wings of very
/// bright stars would outweigh their cores, and errors of the spline would shift these stars.
const PEAK_ACCURACY: f64 = 1e-3;

/// The variance of a pixel that holds `signal` of a star: noise, and the accuracy of the model.
/// `peak` is the signal in the star's brightest pixel.
pub(crate) fn pixel_variance(signal: f64, peak: f64, rms: f64, camera: &Camera) -> f64 {
    camera.variance(signal, rms) + (ACCURACY * signal).powi(2) + (PEAK_ACCURACY * peak).powi(2)
}

/// The weight of a pixel for values relative to the star's flux: `F^2 / variance`.
pub(crate) fn weight(star: &Star, model: f64, peak: f64, rms: f64, camera: &Camera) -> f64 {
    let signal = star.flux * model.max(0.0);
    star.flux * star.flux / pixel_variance(signal, star.flux * peak, rms, camera)
}

/// The PSF that is expected before the fit: its coefficients, and by how much the true coefficients
/// may differ from them. For the PSF of the field, the expected PSF is a round Gaussian of the
/// stars' FWHM with the mean wings of the stars. For a star's own PSF, it is the PSF of the field
/// at the star.
///
/// The fit is the most probable PSF if the noise of the pixels and the differences from the
/// expected coefficients are Gaussian and independent. Coefficients that no pixel of any star
/// determines keep their expected values.
#[derive(Debug)]
pub(crate) struct Prior {
    /// The expected coefficients of the constant term. For the other terms they are 0.
    pub(crate) mean: Vec<f64>,
    /// Standard deviations of the true coefficients of the constant term about `mean`.
    pub(crate) spread: Vec<f64>,
    /// Standard deviations of the true coefficients of each other term.
    pub(crate) field_spread: Vec<f64>,
    /// The standard deviation of the stars' light profile in nodes, for well-sampled stars.
    pub(crate) width_nodes: Option<f64>,
}

/// The standard deviation of a coefficient is the sum of two parts. The first is this fraction of
/// the coefficient.
const OWN_PART: f64 = 0.5;
/// The second part of the standard deviation is this fraction of the peak, which allows for wings.
const PEAK_PART: f64 = 0.004;
/// [`PEAK_PART`] for the terms that vary over the field. Wings vary less than they are bright.
const FIELD_PEAK_PART: f64 = 0.001;
/// The standard deviations of the terms that vary over the field, relative to those of the constant
/// term.
const FIELD_PART: f64 = 0.5;

/// For the terms that vary over the field, the standard deviation of a second difference of
/// neighbouring coefficients is this multiple of their own standard deviation, divided by the squared
/// width of the stars in nodes: the changes of well-sampled light have no structure much finer than
/// the star. This keeps noise out of fine grids. It does not hold for the constant term, because the
/// Gaussian that is expected lacks the structure of the mean PSF, and not for undersampled stars, whose
/// pixels' edges are finer than the star.
const BEND_PART: f64 = 1.0;

/// For a star's own PSF, this fraction replaces [`OWN_PART`]. It allows for the star's colour and
/// for local distortion.
const LOCAL_PART: f64 = 0.25;

impl Prior {
    pub(crate) fn gaussian(surface: SurfaceGrid, fwhm_px: f64) -> Self {
        let sigma2 = (fwhm_px / FWHM_PER_SIGMA).powi(2);
        // A B-spline is wider than its coefficients by a variance of a third of a squared node
        // distance.
        let scale = surface.grid.scale as f64;
        let width_nodes = (!Registration::is_undersampled(fwhm_px)).then(|| scale * sigma2.sqrt());
        let narrowed = (sigma2 - 1.0 / (3.0 * scale * scale)).max(0.3 * sigma2);
        let mut mean: Vec<f64> = surface
            .offsets()
            .map(|(x, y)| (-0.5 * (x * x + y * y) / narrowed).exp())
            .collect();
        let flux = surface.flux(&mean);
        for v in &mut mean {
            *v /= flux;
        }
        Self::about(mean, OWN_PART, width_nodes)
    }

    /// Returns the prior with the wings of `stars` in place of the wings of the Gaussian: beyond
    /// one FWHM, the mean of the stars' pixels at the same distance from their star.
    ///
    /// A real PSF has more light in its wings than a Gaussian. Faint wings have little weight in
    /// the fit of a single coefficient, so that a Gaussian prior would remove them.
    pub(crate) fn with_wings_of(
        &self,
        stars: &[Star],
        surface: SurfaceGrid,
        fwhm_px: f64,
        camera: &Camera,
    ) -> Self {
        let width = 1.0 / surface.grid.scale as f64;
        let width_nodes = self.width_nodes;
        let ring = |x: f64, y: f64| (x.hypot(y) / width).round() as usize;
        let mut mean = self.mean.clone();
        let rings = surface.offsets().map(|(x, y)| ring(x, y)).max().unwrap_or(0) + 1;
        let mut sums = vec![(0.0, 0.0); rings];
        for star in stars {
            for pixel in star.pixels.iter().filter(|p| p.trust > 0.0) {
                let (dx, dy) = (pixel.x - star.x, pixel.y - star.y);
                if let Some(place) = surface.place(dx, dy) {
                    let expected = surface.value(&mean, &place);
                    let w = pixel.trust * weight(star, expected, self.peak(), pixel.rms, camera);
                    let (sum, weights) = &mut sums[ring(dx, dy)];
                    *sum += w * (pixel.value - star.offset) / star.flux;
                    *weights += w;
                }
            }
        }
        for (v, (x, y)) in mean.iter_mut().zip(surface.offsets()) {
            let (sum, weights) = sums[ring(x, y)];
            if x.hypot(y) > fwhm_px && weights > 0.0 {
                *v = sum / weights;
            }
        }
        Self::about(mean, OWN_PART, width_nodes)
    }

    /// The factor between the certainties of a coefficient and of its second differences.
    pub(crate) fn bend_certainty(&self, is_constant: bool) -> f64 {
        match self.width_nodes {
            Some(width) if !is_constant => (BEND_PART / (width * width)).powi(-2),
            _ => 0.0,
        }
    }

    /// The largest expected coefficient.
    pub(crate) fn peak(&self) -> f64 {
        SurfaceGrid::peak(&self.mean)
    }

    /// The prior with the expected coefficients `mean`, from which the true ones may differ by
    /// `part` of their size and by [`PEAK_PART`] of the peak.
    fn about(mean: Vec<f64>, part: f64, width_nodes: Option<f64>) -> Self {
        let peak = SurfaceGrid::peak(&mean);
        let spread = |of_peak: f64| mean.iter().map(move |v| part * v.abs() + of_peak * peak);
        Self {
            spread: spread(PEAK_PART).collect(),
            field_spread: spread(FIELD_PEAK_PART).map(|s| FIELD_PART * s).collect(),
            mean,
            width_nodes,
        }
    }

    /// The prior for a star's own PSF: the PSF of the field at the star, from which it may differ a
    /// little.
    pub(crate) fn local(mean: Vec<f64>, width_nodes: Option<f64>) -> Self {
        Self::about(mean, LOCAL_PART, width_nodes)
    }
}
