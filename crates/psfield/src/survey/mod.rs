//! Surveys: a camera, its pointings, and a catalogue of the sky, from which the frames of all detectors are made.

mod camera;
mod exposure;
mod file;
mod frames;
mod galaxy_reach;
mod observer;
mod records;

pub use camera::{CameraDetector, GeometryEntry};
pub use exposure::Footprint;
pub use file::{BandEntry, DetectorEntry, PointingEntry, SurveyFile};
pub use frames::{Survey, SurveyFrame};
pub use observer::{FrameReport, FrameStatus, Observer};
