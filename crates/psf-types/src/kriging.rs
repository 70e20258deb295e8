//! The parameters of kriging.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::frame::DataError;
use crate::named;

/// The covariance of coefficients at two positions, as a function of the scaled distance `r`.
///
/// `r^2 = (dx / length_x)^2 + (dy / length_y)^2`, with lengths in units of half of the longer side of
/// the samples' bounding box. The last three are generalised covariances: they make the interpolation
/// a radial spline, which minimises a roughness.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum KrigingKernel {
    /// `exp(-r^2 / 2)`: fields with all derivatives.
    Gaussian,
    /// `(1 + s + s^2 / 3) exp(-s)` with `s = sqrt(5) r`: fields with two derivatives.
    Matern52,
    /// `(1 + s) exp(-s)` with `s = sqrt(3) r`: fields with one derivative.
    Matern32,
    /// `r^2 ln r`: the thin plate spline, which minimises the squared second derivatives.
    ThinPlate,
    /// `r^3`: the cubic radial spline.
    Cubic,
    /// `-r^5`: the quintic radial spline.
    Quintic,
}

impl KrigingKernel {
    /// All kernels.
    pub const ALL: [Self; 6] = [
        Self::Gaussian,
        Self::Matern52,
        Self::Matern32,
        Self::ThinPlate,
        Self::Cubic,
        Self::Quintic,
    ];

    /// The lowest degree of the trend with which this kernel is a covariance. None if it is one without
    /// a trend.
    pub fn lowest_trend(self) -> Option<usize> {
        match self {
            Self::Gaussian | Self::Matern52 | Self::Matern32 => None,
            Self::ThinPlate | Self::Cubic => Some(1),
            Self::Quintic => Some(2),
        }
    }
}

named!(
    KrigingKernel,
    "kriging kernel",
    "gaussian, matern52, matern32, thin-plate, cubic or quintic",
    "gaussian" => Gaussian, "matern52" => Matern52, "matern32" => Matern32, "thin-plate" => ThinPlate,
    "cubic" => Cubic, "quintic" => Quintic
);

/// The parameters of universal kriging: a polynomial trend, and around it a random field with a
/// covariance.
///
/// Text form: `KERNEL,LENGTH_X,LENGTH_Y,TREND,NUGGET`, such as `gaussian,0.61,0.61,2,1e-12`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KrigingParameters {
    kernel: KrigingKernel,
    lengths: [f64; 2],
    trend: usize,
    nugget: f64,
}

impl KrigingParameters {
    /// The highest degree of a trend.
    pub const MAX_TREND: usize = 3;

    /// Parameters of kriging. `lengths` are those of the [kernel](KrigingKernel) along x and y. `trend` is
    /// the total degree of the polynomial trend, 0 for a constant. `nugget` is the variance of the
    /// samples' noise, relative to the mean variance of the samples about the trend.
    ///
    /// # Errors
    /// [`DataError::Setting`] for lengths that are not from 1e-6 to 1e6, a trend above
    /// [`MAX_TREND`](Self::MAX_TREND) or below [`KrigingKernel::lowest_trend`], or a nugget that is not
    /// from 0 to 1e6.
    pub fn new(
        kernel: KrigingKernel,
        lengths: [f64; 2],
        trend: usize,
        nugget: f64,
    ) -> Result<Self, DataError> {
        for length in lengths {
            if !(1e-6..=1e6).contains(&length) {
                return Err(DataError::setting("kriging length", "from 1e-6 to 1e6", length));
            }
        }
        let lowest = kernel.lowest_trend().unwrap_or(0);
        if !(lowest..=Self::MAX_TREND).contains(&trend) {
            let allowed = match lowest {
                0 => "a degree from 0 to 3",
                1 => "a degree from 1 to 3 for this kernel",
                _ => "a degree of 2 or 3 for this kernel",
            };
            return Err(DataError::setting("kriging trend", allowed, trend));
        }
        if !(0.0..=1e6).contains(&nugget) {
            return Err(DataError::setting("kriging nugget", "from 0 to 1e6", nugget));
        }
        Ok(Self {
            kernel,
            lengths,
            trend,
            nugget,
        })
    }

    /// The covariance of coefficients at two positions.
    pub fn kernel(&self) -> KrigingKernel {
        self.kernel
    }

    /// The lengths of the kernel along x and y, in units of half of the longer side of the samples'
    /// bounding box.
    pub fn lengths(&self) -> [f64; 2] {
        self.lengths
    }

    /// The total degree of the polynomial trend.
    pub fn trend(&self) -> usize {
        self.trend
    }

    /// The variance of the samples' noise, relative to the mean variance of the samples about the trend.
    pub fn nugget(&self) -> f64 {
        self.nugget
    }
}

impl std::fmt::Display for KrigingParameters {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            kernel,
            lengths: [x, y],
            trend,
            nugget,
        } = self;
        write!(f, "{kernel},{x},{y},{trend},{nugget:e}")
    }
}

impl FromStr for KrigingParameters {
    type Err = DataError;
    fn from_str(text: &str) -> Result<Self, DataError> {
        const ALLOWED: &str = "kriging=KERNEL,LENGTH_X,LENGTH_Y,TREND,NUGGET";
        let refused = || DataError::setting("interpolation", ALLOWED, text);
        let [kernel, x, y, trend, nugget] = text.split(',').collect::<Vec<_>>()[..] else {
            return Err(refused());
        };
        let number = |text: &str| text.parse::<f64>().map_err(|_| refused());
        let trend = trend.parse().map_err(|_| refused())?;
        Self::new(kernel.parse()?, [number(x)?, number(y)?], trend, number(nugget)?)
    }
}
