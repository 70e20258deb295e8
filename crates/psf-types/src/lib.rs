//! The data types that pass between the stages of psfield, and the traits that several stages
//! share.
//!
//! ```text
//! PsfSource --sample--> PsfSamples --basis--> PsfBasis + SampleCoefficients --field--> CoefficientField
//!                                                                                            |
//!                                      Image --conv--> Image  <---------- PsfModel <---------+
//! ```
//!
//! # Conventions
//! * Arrays are `[y, x]`, row-major. Stacks are `[sample, y, x]`.
//! * Positions are `(x, y)` in pixels of the frame, 0-based. An integer is the centre of a pixel
//!   ([`Position`]).
//! * A stamp stores its centre, by default index `n / 2` ([`StampGrid`]). Its values are fractions
//!   of the source's flux per *frame* pixel. So a stamp oversampled `s` times holds unit flux when
//!   its values sum to `s^2`.
//! * Every type checks its invariants once, in its constructor. Serde runs the same check.

mod basis;
mod choices;
mod coefficient_field;
mod field_table;
mod frame;
mod image;
mod kriging;
mod light_profile;
pub mod maths;
mod mean_parts;
mod model;
mod progress;
mod radial_light;
mod sample_positions;
mod samples;
mod sources;
mod stamp;
mod table_row;
mod text_file;
mod wings;

pub use basis::{PsfBasis, SampleCoefficients};
pub use choices::{Anchor, Interpolation, Normalisation, OutsidePolicy, StampInterpolation, ToleranceOn};
pub use coefficient_field::{BilinearCells, CoefficientField, ErrorLimit, FieldError, RowRun, WeightedNodes};
pub use field_table::{EvaluateField, FieldTable, TableLimits};
pub use frame::{DataError, FrameShape, PixelRegion, Position, Quantity};
pub use image::{Image, ImageView, Real};
pub use kriging::{KrigingKernel, KrigingParameters};
pub use light_profile::{LightProfile, Outskirts};
pub use mean_parts::MeanParts;
pub use model::{PsfModel, PsfModelRecord};
pub use progress::{Cancelled, NoProgress, Progress, Uncounted};
pub use radial_light::RadialLight;
pub use sample_positions::{SamplePositions, SampleStates, StateKind};
pub use samples::{PsfSamples, PsfSource, SourceError};
pub use sources::{PointSource, SersicProfile, SersicSource};
pub use stamp::{Stamp, StampGrid};
pub use text_file::read_text_file;
pub use wings::{Wings, WingsRecord};
