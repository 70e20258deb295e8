//! Errors of preparing an interpolator and of evaluating it.

use psf_types::{DataError, FieldError, Interpolation, OutsidePolicy, Position, SamplePositions, StateKind};
use thiserror::Error;

/// The reason why coefficients cannot be interpolated. All indices are 0-based.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CoeffFieldError {
    /// A sample whose coordinates are too large for double precision geometry.
    #[error(
        "sample {sample} (0-based) at {position} is too far away: coordinates may have magnitudes up to {limit:e} pixels"
    )]
    SampleRange {
        /// Index of the sample.
        sample: usize,
        /// Its position.
        position: Position,
        /// The largest allowed magnitude of a coordinate.
        limit: f64,
    },
    /// A requested position whose coordinates are too large for double precision geometry.
    #[error("position {position} is too far away: coordinates may have magnitudes up to {limit:e} pixels")]
    QueryRange {
        /// The requested position.
        position: Position,
        /// The largest allowed magnitude of a coordinate.
        limit: f64,
    },
    /// Two samples closer to each other than double precision geometry can resolve.
    #[error("samples {first} and {second} (0-based) are too close to each other at {position}: remove one")]
    CoincidentSamples {
        /// The earlier of the two.
        first: usize,
        /// The later one.
        second: usize,
        /// Their position.
        position: Position,
    },
    /// Weights that overflow, far outside the samples.
    #[error("position {position} is so far outside the samples that this interpolator's weights overflow")]
    WeightOverflow {
        /// The requested position.
        position: Position,
    },
    /// Samples of several states, such as wavelengths, where samples of one state are needed.
    #[error("the samples belong to {count} values of the {kind}: choose one, or mix them")]
    SeveralStates {
        /// The quantity that differs.
        kind: StateKind,
        /// Number of states.
        count: usize,
    },
    /// States whose samples are at different positions, with an interpolation that needs a grid.
    #[error(
        "the samples of different values of the {kind} lie at different positions, and the interpolation {interpolation} \
         needs a regular grid: choose another interpolation, such as natural-neighbour, or take all samples at the same \
         positions"
    )]
    DifferentGrids {
        /// The quantity that differs.
        kind: StateKind,
        /// The interpolation.
        interpolation: Interpolation,
    },
    /// Samples that do not fill a regular grid.
    #[error(
        "the {samples} samples do not form a regular grid: their coordinates make {columns} columns and {rows} rows, but \
         no sample lies at column {column}, row {row} (0-based), near {position}. Choose another interpolation, such as \
         natural-neighbour"
    )]
    NotRegular {
        /// Number of samples.
        samples: usize,
        /// Number of distinct x coordinates.
        columns: usize,
        /// Number of distinct y coordinates.
        rows: usize,
        /// Column of the first node without a sample.
        column: usize,
        /// Row of the first node without a sample.
        row: usize,
        /// The position where a sample was expected.
        position: Position,
    },
    /// Two samples at one node of a regular grid, within the tolerance of the grid's coordinates.
    #[error(
        "samples {first} and {second} (0-based) share column {column}, row {row} of the regular grid: they are too close \
         to each other at {position}. Remove one of them"
    )]
    SharedNode {
        /// The earlier of the two.
        first: usize,
        /// The later one.
        second: usize,
        /// Column of the grid.
        column: usize,
        /// Row of the grid.
        row: usize,
        /// Position of the second sample.
        position: Position,
    },
    /// Fewer samples than the polynomial has terms.
    #[error(
        "a polynomial of degree {degree} needs at least {terms} samples, one per term, got {samples}: lower the degree"
    )]
    TooFewSamples {
        /// Total degree.
        degree: usize,
        /// Number of terms.
        terms: usize,
        /// Number of samples.
        samples: usize,
    },
    /// Samples placed so that they do not determine the polynomial.
    #[error(
        "the {samples} samples determine only {rank} of the {terms} terms of a polynomial of degree {degree} (they lie on \
         too few lines or curves): lower the degree"
    )]
    Undetermined {
        /// Total degree.
        degree: usize,
        /// Number of terms.
        terms: usize,
        /// Number of samples.
        samples: usize,
        /// Numerical rank of the design matrix.
        rank: usize,
    },
    /// Fewer samples than kriging needs, or samples that do not determine its trend.
    #[error(
        "kriging with a trend of {terms} terms needs more than {terms} samples that determine the trend, got {samples}: \
         choose a lower degree of the trend, or another interpolation"
    )]
    FewForKriging {
        /// Number of samples.
        samples: usize,
        /// Number of terms of the trend.
        terms: usize,
    },
    /// More samples than kriging can handle.
    #[error(
        "kriging takes at most {most} samples, got {samples}: choose another interpolation, such as natural-neighbour"
    )]
    ManyForKriging {
        /// Number of samples.
        samples: usize,
        /// The largest number.
        most: usize,
    },
    /// Nodes that are not those of a table.
    #[error(
        "the {nodes} positions are not the nodes of a table of {columns} x {rows} patches: the interpolation table is only \
         for models that psfield tabulated"
    )]
    NotATable {
        /// Number of positions.
        nodes: usize,
        /// Number of undivided patches in a row.
        columns: usize,
        /// Number of undivided patches in a column.
        rows: usize,
    },
    /// A field that is too rough for a table.
    #[error(
        "the interpolation cannot be tabulated with an error of {limit:e} in {nodes} nodes: it is too rough near {position}, \
         or jumps there. Allow a larger error of the table (table_error), or use a smoother method"
    )]
    TooRough {
        /// The allowed error.
        limit: f64,
        /// Number of nodes of the table.
        nodes: usize,
        /// A place where the error is larger.
        position: Position,
    },
    /// A parameter out of range.
    #[error("{name} must be {allowed}, got {got}")]
    Parameter {
        /// Name of the parameter.
        name: &'static str,
        /// The allowed values, in words.
        allowed: &'static str,
        /// The given value.
        got: f64,
    },
    /// An interpolation that this version does not know.
    #[error("interpolation {0} is not provided by this version")]
    UnknownInterpolation(Interpolation),
    /// An outside policy that this version does not know.
    #[error("outside policy {0} is not provided by this version")]
    UnknownOutsidePolicy(OutsidePolicy),
    /// Data that breaks a rule of its type.
    #[error(transparent)]
    Data(#[from] DataError),
    /// An interpolation that has no value at a position of a sample.
    #[error(transparent)]
    NoValue(#[from] FieldError),
    /// Node values that overflow.
    #[error("component {component} at node {node} (0-based) is {value}: the samples' values are too large")]
    NonFiniteNode {
        /// Index of the node.
        node: usize,
        /// Index of the component.
        component: usize,
        /// NaN or an infinity.
        value: f64,
    },
    /// An error of an interpolator in another crate, or of the search tree.
    #[error("the interpolator could not be prepared")]
    External(#[source] Box<dyn std::error::Error + Send + Sync>),
}

impl CoeffFieldError {
    /// Returns an error for samples of several states.
    pub(crate) fn unless_one_state(positions: &SamplePositions) -> Result<(), Self> {
        match positions.states() {
            None => Ok(()),
            Some(states) => Err(Self::SeveralStates {
                kind: states.kind(),
                count: states.values().len(),
            }),
        }
    }
}
