//! The data that passes between the stages of psfield, and the traits that cross them.
//!
//! ```text
//! PsfSource --sample--> PsfSamples --basis--> PsfBasis + SampleCoefficients --field--> CoefficientField
//!                                                                                            |
//!                                      Scene --conv--> Image  <---------- PsfModel <---------+
//! ```
//!
//! # Conventions
//! * Arrays are `[y, x]`, row-major; stacks `[sample, y, x]`.
//! * Positions are `(x, y)` in pixels of the frame, 0-based, an integer is the centre of a pixel ([`Position`]).
//! * A stamp carries its centre, by default index `n / 2` ([`StampGrid`]). Its values are fractions of the source's flux
//!   in a *frame* pixel, so a stamp oversampled `s` times holds unit flux when its values sum to `s^2`.
//! * Every type checks its invariants once, in its constructor; serde goes through the same check.

mod check;
mod choices;
mod coefficient_field;
mod error;
mod frame;
mod image;
mod image_view;
mod point_source;
mod position;
mod progress;
mod psf_basis;
mod psf_model;
mod psf_model_record;
mod psf_samples;
mod psf_source;
mod real;
mod sample_coefficients;
mod sample_positions;
mod scene;
mod sersic_source;
mod stamp;

pub use choices::{Anchor, Interpolation, Normalisation, OutsidePolicy, StampInterpolation};
pub use coefficient_field::{CoefficientField, FieldError, RowRun};
pub use error::{DataError, Quantity};
pub use frame::{FrameShape, PixelRegion};
pub use image::Image;
pub use image_view::ImageView;
pub use point_source::PointSource;
pub use position::Position;
pub use progress::{Cancelled, NoProgress, Progress, Uncounted};
pub use psf_basis::PsfBasis;
pub use psf_model::PsfModel;
pub use psf_model_record::PsfModelRecord;
pub use psf_samples::PsfSamples;
pub use psf_source::{PsfSource, SourceError};
pub use real::Real;
pub use sample_coefficients::SampleCoefficients;
pub use sample_positions::SamplePositions;
pub use scene::Scene;
pub use sersic_source::{SersicProfile, SersicSource};
pub use stamp::{Stamp, StampGrid};
