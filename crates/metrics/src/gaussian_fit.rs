//! What a Gaussian fit found.

use std::f64::consts::TAU;

use serde::Serialize;

use crate::{Covariance, FWHM_PER_SIGMA};

/// What a [`GaussianFitter`](crate::GaussianFitter) found. Lengths are in pixels of the stamp, every number is finite.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GaussianFit {
    flux: f64,
    amplitude: f64,
    x_centroid: f64,
    y_centroid: f64,
    fwhm_px: f64,
    fwhm_major_px: f64,
    fwhm_minor_px: f64,
    angle_rad: f64,
    ellipticity: f64,
    background: Option<f64>,
    residual_rms: f64,
    iterations: usize,
    covariance: Covariance,
}

/// A Gaussian without its background.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ellipse {
    pub(crate) amplitude: f64,
    pub(crate) x_centroid: f64,
    pub(crate) y_centroid: f64,
    pub(crate) covariance: Covariance,
}

impl GaussianFit {
    pub(crate) fn new(
        ellipse: Ellipse,
        background: Option<f64>,
        residual_rms: f64,
        iterations: usize,
    ) -> Self {
        let c = ellipse.covariance;
        Self {
            flux: TAU * ellipse.amplitude * c.determinant().sqrt(),
            amplitude: ellipse.amplitude,
            x_centroid: ellipse.x_centroid,
            y_centroid: ellipse.y_centroid,
            fwhm_px: FWHM_PER_SIGMA * c.sigma_px(),
            fwhm_major_px: FWHM_PER_SIGMA * c.sigma_major_px(),
            fwhm_minor_px: FWHM_PER_SIGMA * c.sigma_minor_px(),
            angle_rad: c.angle_rad(),
            ellipticity: c.ellipticity(),
            background,
            residual_rms,
            iterations,
            covariance: c,
        }
    }

    /// The integral of the Gaussian, `2 pi A sigma_major sigma_minor`, in units of the stamp; without the background, with
    /// what lies beyond the window.
    pub fn flux(&self) -> f64 {
        self.flux
    }

    /// The Gaussian's value at its centre above the background.
    pub fn amplitude(&self) -> f64 {
        self.amplitude
    }

    /// Column coordinate of the centre, a 0-based index of the stamp.
    pub fn x_centroid(&self) -> f64 {
        self.x_centroid
    }

    /// Row coordinate of the centre, a 0-based index of the stamp.
    pub fn y_centroid(&self) -> f64 {
        self.y_centroid
    }

    /// Geometric mean of the two FWHM.
    pub fn fwhm_px(&self) -> f64 {
        self.fwhm_px
    }

    /// FWHM along the major axis.
    pub fn fwhm_major_px(&self) -> f64 {
        self.fwhm_major_px
    }

    /// FWHM along the minor axis.
    pub fn fwhm_minor_px(&self) -> f64 {
        self.fwhm_minor_px
    }

    /// Direction of the major axis from +x towards +y, in (-pi/2, pi/2]; 0 for a round fit.
    pub fn angle_rad(&self) -> f64 {
        self.angle_rad
    }

    /// The eccentricity `e = sqrt(1 - b^2 / a^2)` of the axes `a >= b`; not a distortion, which
    /// [`covariance`](Self::covariance) gives.
    pub fn ellipticity(&self) -> f64 {
        self.ellipticity
    }

    /// The constant background, where it was fitted.
    pub fn background(&self) -> Option<f64> {
        self.background
    }

    /// Root of the mean squared residual over the window, in units of the stamp.
    pub fn residual_rms(&self) -> f64 {
        self.residual_rms
    }

    /// Iterations that the fit took.
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// The Gaussian's covariance, with its distortion and its reduced shear.
    pub fn covariance(&self) -> Covariance {
        self.covariance
    }
}
