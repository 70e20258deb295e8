//! What adaptive moments found.

use serde::Serialize;

use crate::Covariance;

/// Adaptive moments, as [`AdaptiveMomentFinder`](crate::AdaptiveMomentFinder) measures them. Lengths are in pixels of the
/// stamp, every number is finite.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AdaptiveMoments {
    amplitude: f64,
    x_centroid: f64,
    y_centroid: f64,
    sigma_px: f64,
    e1: f64,
    e2: f64,
    g1: f64,
    g2: f64,
    iterations: usize,
    covariance: Covariance,
}

impl AdaptiveMoments {
    pub(crate) fn new(
        amplitude: f64,
        centroid: (f64, f64),
        covariance: Covariance,
        iterations: usize,
    ) -> Self {
        let (e, g) = (covariance.distortion(), covariance.reduced_shear());
        Self {
            amplitude,
            x_centroid: centroid.0,
            y_centroid: centroid.1,
            sigma_px: covariance.sigma_px(),
            e1: e.e1(),
            e2: e.e2(),
            g1: g.g1(),
            g2: g.g2(),
            iterations,
            covariance,
        }
    }

    /// Flux of the best-fit elliptical Gaussian, `2 sum w I`, in units of the stamp (HSM's amplitude).
    pub fn amplitude(&self) -> f64 {
        self.amplitude
    }

    /// Column coordinate of the centroid, a 0-based index of the stamp.
    pub fn x_centroid(&self) -> f64 {
        self.x_centroid
    }

    /// Row coordinate of the centroid, a 0-based index of the stamp.
    pub fn y_centroid(&self) -> f64 {
        self.y_centroid
    }

    /// The size `det(M)^(1/4)`.
    pub fn sigma_px(&self) -> f64 {
        self.sigma_px
    }

    /// Distortion along the axes of the grid.
    pub fn e1(&self) -> f64 {
        self.e1
    }

    /// Distortion along the diagonals of the grid.
    pub fn e2(&self) -> f64 {
        self.e2
    }

    /// Reduced shear along the axes of the grid.
    pub fn g1(&self) -> f64 {
        self.g1
    }

    /// Reduced shear along the diagonals of the grid.
    pub fn g2(&self) -> f64 {
        self.g2
    }

    /// Iterations that the measurement took.
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// The adaptive second moments `M`.
    pub fn covariance(&self) -> Covariance {
        self.covariance
    }
}
