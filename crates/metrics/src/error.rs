//! Errors of measurements.

use thiserror::Error;

/// The reason why a measurement has no result. Indices and pixel coordinates are 0-based.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum MetricsError {
    /// A window that does not lie entirely on the stamp.
    #[error(
        "a window of {size} x {size} pixels about column {column}, row {row} does not fit on a stamp of {nx} x {ny} pixels"
    )]
    WindowOutsideStamp {
        /// Side of the window in pixels.
        size: usize,
        /// Column of the window's centre.
        column: usize,
        /// Row of the window's centre.
        row: usize,
        /// Columns of the stamp.
        nx: usize,
        /// Rows of the stamp.
        ny: usize,
    },
    /// Fewer pixels along an axis than the measurement needs.
    #[error("{nx} x {ny} pixels are too few: at least {need} x {need} are needed")]
    TooFewPixels {
        /// Columns in the window.
        nx: usize,
        /// Rows in the window.
        ny: usize,
        /// Smallest number of pixels along an axis.
        need: usize,
    },
    /// NaN or infinity among the values.
    #[error("the value at index {index:?} is {value}, not a finite number")]
    NonFinite {
        /// Index in the given array, in its own order of axes.
        index: Vec<usize>,
        /// The value there.
        value: f64,
    },
    /// No Gaussian with a positive amplitude fits the pixels.
    #[error(
        "no Gaussian with a positive amplitude fits: the best amplitude is {amplitude}, the largest value {largest}"
    )]
    NoPeak {
        /// Largest value in the window.
        largest: f64,
        /// Amplitude of the best-fitting Gaussian, 0 or negative.
        amplitude: f64,
    },
    /// The total flux or the weighted flux is not positive, so that the moments are not defined.
    #[error("the flux is {flux}: moments need a positive flux")]
    NonPositiveFlux {
        /// The flux found.
        flux: f64,
    },
    /// The iteration did not converge.
    #[error(
        "no convergence after {iterations} iterations: a step still changes the model by a fraction of {change:.1e}"
    )]
    NotConverged {
        /// Number of iterations.
        iterations: usize,
        /// Relative change of the model by a step.
        change: f64,
    },
    /// The centre, at the start or during the iteration, lies outside the measured pixels.
    #[error(
        "the centre ({x}, {y}) lies outside the window of columns {column_first} to {column_last} and rows {row_first} to {row_last}"
    )]
    CentreLeftWindow {
        /// Column coordinate of the centre.
        x: f64,
        /// Row coordinate of the centre.
        y: f64,
        /// First column of the window.
        column_first: usize,
        /// Last column of the window.
        column_last: usize,
        /// First row of the window.
        row_first: usize,
        /// Last row of the window.
        row_last: usize,
    },
    /// A second-moment matrix that is not positive definite.
    #[error("the second moments xx = {xx}, xy = {xy}, yy = {yy} do not describe an ellipse")]
    DegenerateCovariance {
        /// Second moment along x.
        xx: f64,
        /// Mixed second moment.
        xy: f64,
        /// Second moment along y.
        yy: f64,
    },
    /// A width that these pixels cannot determine.
    #[error(
        "the widths (sigma {major_px} x {minor_px} pixels) are outside the range of {smallest_px} to {largest_px} pixels that this window can measure"
    )]
    WidthOutOfRange {
        /// Sigma along the major axis.
        major_px: f64,
        /// Sigma along the minor axis.
        minor_px: f64,
        /// Smallest sigma accepted.
        smallest_px: f64,
        /// Largest sigma accepted.
        largest_px: f64,
    },
    /// The weight of adaptive moments is as narrow as a single pixel, because the stamp is
    /// undersampled or the start is too narrow.
    #[error(
        "the adaptive weight is as narrow as a single pixel (sigma {sigma_px:.3} pixels): the stamp is undersampled, or the \
         starting weight is too narrow. Measure an oversampled stamp, or start with a wider weight"
    )]
    WeightCollapsed {
        /// Sigma of the weight along its minor axis when the iteration stopped.
        sigma_px: f64,
    },
    /// The pixels do not determine all parameters of the fit.
    #[error("the pixels do not determine the {parameters} parameters of the fit: enlarge the window")]
    Undetermined {
        /// Number of parameters.
        parameters: usize,
    },
    /// A shear or distortion whose length is not below 1.
    #[error("({first}, {second}) is not a valid ellipticity: its length must be below 1")]
    Ellipticity {
        /// First component.
        first: f64,
        /// Second component.
        second: f64,
    },
    /// Two arrays of unequal shape.
    #[error("the shape of the result, {result:?}, differs from the shape of the reference, {reference:?}")]
    ShapeMismatch {
        /// Shape of the result.
        result: Vec<usize>,
        /// Shape of the reference.
        reference: Vec<usize>,
    },
    /// There are no values.
    #[error("there are no values to measure")]
    Empty,
    /// A reference that is zero everywhere.
    #[error("the reference is zero everywhere: a relative error is not defined")]
    ZeroReference,
    /// A reference whose largest value is not positive.
    #[error(
        "the largest value of the reference is {peak}: an error relative to the peak needs a positive peak"
    )]
    NonPositivePeak {
        /// Largest value of the reference.
        peak: f64,
    },
    /// A reference whose mean is not positive.
    #[error("the mean of the reference is {mean}: an error relative to the mean needs a positive mean")]
    NonPositiveMean {
        /// Mean of the reference.
        mean: f64,
    },
    /// Result and reference are equal, so that the signal-to-noise ratio has no bound.
    #[error("result and reference are identical: the signal-to-noise ratio is infinite")]
    Identical,
    /// Values so large that a result, or the sum of their squares, exceeds double precision.
    #[error(
        "a result exceeds the range of double precision: the largest value or difference in the input is {largest}"
    )]
    Overflow {
        /// The window's value of largest magnitude, with its sign. For a comparison or a summary:
        /// largest absolute value or error.
        largest: f64,
    },
    /// A quantile that is not between 0 and 1.
    #[error("a quantile must be between 0 and 1, got {got}")]
    Quantile {
        /// The value that was given.
        got: f64,
    },
    /// An error in one plane of a cube.
    #[error("plane {plane} (0-based): {source}")]
    Plane {
        /// Index of the plane.
        plane: usize,
        /// The error in that plane.
        source: Box<MetricsError>,
    },
}
