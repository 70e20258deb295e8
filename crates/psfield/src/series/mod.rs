//! Series of exposures: the PSF, the pointing and the sources change with time.

mod exposures;
mod frames;
mod light_curves;
mod pointing;
mod states;

pub use exposures::Exposures;
pub use frames::{SeriesExposure, SeriesFrames, SourceInExposure};
pub use light_curves::LightCurves;
pub use pointing::{Pointing, PointingPath};

/// A series of exposures of the same field. Times are in seconds after the start of the series.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// The starts and the duration of the exposures.
    pub exposures: Exposures,
    /// The motion of the pointing.
    pub pointing: Pointing,
    /// The changes of the fluxes of sources.
    pub light_curves: LightCurves,
}
