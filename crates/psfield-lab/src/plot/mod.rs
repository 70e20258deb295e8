//! Figures with axes, as SVG.
//!
//! A [`Chart`] has two axes and what lies between them: curves, histograms, an image, or values over
//! a field. [`Figure::new`] draws charts next to each other, with one legend for all of them.
//!
//! All figures of psfield share the colours, axes and sizes of this module. Lines have the colours
//! of Okabe and Ito (2008). Images of the sky are grey, other values have the colours of viridis,
//! and differences are blue, white and red (ColorBrewer's RdBu). Colour-blind readers can tell these
//! colours apart.

mod axis;
mod chart;
mod colours;
mod fields;
mod figure;
mod histogram;

pub use axis::Axis;
pub use chart::{Chart, Curve, Mark, Marker};
pub use colours::{SERIES, Scale};
pub use figure::Figure;
pub(crate) use figure::escaped;
pub use histogram::Histogram;
