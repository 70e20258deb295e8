//! What makes data invalid.

use thiserror::Error;

use crate::{FrameShape, Position};

/// Which values an error speaks of, and the meaning of the index beside it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Quantity {
    /// A pixel of an image `[y, x]`.
    Pixel,
    /// A value of a stamp `[y, x]`.
    StampValue,
    /// A value of a stack of PSF samples `[sample, y, x]`.
    SampleValue,
    /// A value of the mean stamp `[y, x]`.
    MeanValue,
    /// A value of the basis stamps `[component, y, x]`.
    BasisValue,
    /// A coefficient `[sample, component]`.
    Coefficient,
}

impl std::fmt::Display for Quantity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Pixel => "pixel [y, x]",
            Self::StampValue => "stamp value [y, x]",
            Self::SampleValue => "PSF sample value [sample, y, x]",
            Self::MeanValue => "mean stamp value [y, x]",
            Self::BasisValue => "basis value [component, y, x]",
            Self::Coefficient => "coefficient [sample, component]",
        })
    }
}

/// Data that breaks an invariant of its type. Indices and counts are 0-based.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum DataError {
    /// A coordinate that is NaN or infinite.
    #[error("position ({x}, {y}) is not finite")]
    NonFinitePosition {
        /// Column coordinate.
        x: f64,
        /// Row coordinate.
        y: f64,
    },
    /// A frame without pixels.
    #[error("a frame of {nx} x {ny} pixels is empty")]
    EmptyFrame {
        /// Columns.
        nx: usize,
        /// Rows.
        ny: usize,
    },
    /// A frame that no memory holds.
    #[error("a frame of {nx} x {ny} pixels is larger than any memory")]
    FrameTooLarge {
        /// Columns.
        nx: usize,
        /// Rows.
        ny: usize,
    },
    /// A stamp without pixels.
    #[error("a stamp of {nx} x {ny} pixels is empty")]
    EmptyStamp {
        /// Columns.
        nx: usize,
        /// Rows.
        ny: usize,
    },
    /// A stamp centre off the stamp.
    #[error("the stamp centre ({x}, {y}) does not lie on the {nx} x {ny} stamp")]
    StampCentre {
        /// Column index.
        x: f64,
        /// Row index.
        y: f64,
        /// Columns of the stamp.
        nx: usize,
        /// Rows of the stamp.
        ny: usize,
    },
    /// An oversampling that is not a positive number.
    #[error("oversampling must be finite and above 0, got {got}")]
    Oversampling {
        /// The value given.
        got: f64,
    },
    /// An array whose last two axes are not the stamp's.
    #[error("the stamp array is {got:?} [y, x], its grid says {expected:?}")]
    StampShape {
        /// Shape of the grid.
        expected: (usize, usize),
        /// Shape of the array.
        got: (usize, usize),
    },
    /// An array whose shape is not the one that goes with it.
    #[error("an image of {got:?} [y, x] was given where {expected:?} is needed")]
    ImageShape {
        /// Shape needed.
        expected: (usize, usize),
        /// Shape of the array.
        got: (usize, usize),
    },
    /// NaN or infinity among the values.
    #[error("{quantity} {index:?} is {value}")]
    NonFinite {
        /// Which values.
        quantity: Quantity,
        /// Where, 0-based.
        index: Vec<usize>,
        /// NaN or an infinity.
        value: f64,
    },
    /// Two arrays that should have one row or plane for the same thing.
    #[error("{what}: expected {expected}, got {got}")]
    CountMismatch {
        /// What is counted.
        what: &'static str,
        /// The number needed.
        expected: usize,
        /// The number found.
        got: usize,
    },
    /// No samples at all.
    #[error("there are no samples: at least one is needed")]
    NoSamples,
    /// Two samples at the same place.
    #[error(
        "samples {first} and {second} (0-based) share the position {position}: remove one, or average them"
    )]
    DuplicatePosition {
        /// The earlier of the two.
        first: usize,
        /// The later one.
        second: usize,
        /// Where they are.
        position: Position,
    },
    /// A sample off the field.
    #[error(
        "sample {sample} (0-based) at {position} lies outside the field of {field} pixels (pixel centres are 0-based integers)"
    )]
    OutsideField {
        /// Index of the sample.
        sample: usize,
        /// Where it is.
        position: Position,
        /// The field.
        field: FrameShape,
    },
    /// A PSF that holds no light.
    #[error("PSF sample {sample} (0-based) has flux {flux}: a PSF must have positive flux")]
    NonPositiveFlux {
        /// Index of the sample.
        sample: usize,
        /// Its flux.
        flux: f64,
    },
    /// A basis that spans nothing.
    #[error("a basis needs a mean stamp or at least one component")]
    EmptyBasis,
    /// Basis stamps that are not orthonormal.
    #[error(
        "basis stamps {first} and {second} have the inner product {product}, expected {expected} within {tolerance:e}"
    )]
    NotOrthonormal {
        /// First component.
        first: usize,
        /// Second component.
        second: usize,
        /// Their inner product.
        product: f64,
        /// 1 on the diagonal, else 0.
        expected: f64,
        /// The tolerance applied.
        tolerance: f64,
    },
    /// A point source whose flux is NaN or infinite.
    #[error("the point source at {position} has flux {flux}")]
    SourceFlux {
        /// Where it is.
        position: Position,
        /// Its flux.
        flux: f64,
    },
    /// A galaxy whose profile is not one that can be drawn.
    #[error("{parameter} must be {allowed}, got {got}")]
    Galaxy {
        /// The parameter.
        parameter: &'static str,
        /// What is allowed, in words.
        allowed: &'static str,
        /// What was given.
        got: f64,
    },
    /// A frame that reaches beyond the scene.
    #[error("the frame (first pixel {x0}, {y0}; {shape} pixels) reaches beyond the scene of {scene} pixels")]
    FrameOutsideScene {
        /// First column.
        x0: i64,
        /// First row.
        y0: i64,
        /// Shape of the frame.
        shape: FrameShape,
        /// Shape of the scene.
        scene: FrameShape,
    },
    /// A setting that is out of range.
    #[error("{name} must be {allowed}, got {got}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// What is allowed, in words.
        allowed: &'static str,
        /// What was given.
        got: String,
    },
}
