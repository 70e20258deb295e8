//! Figures. Each drawing gives an SVG and a PNG.
//!
//! All figures of psfield share the colours, axes and file formats of this module. Lines have the
//! colours of Okabe and Ito (2008). Images of the sky are grey, other values have the colours of
//! viridis, and differences are blue, white and red (ColorBrewer's RdBu). Colour-blind readers can
//! tell these colours apart.

mod axes;
mod canvas;
mod colours;
mod curves;
mod figure;
mod histogram;
mod maps;
mod pictures;

pub use colours::{SERIES, Scale};
pub use curves::{Axis, Curve, Curves, Mark, Marker, curve_panels};
pub use figure::{Figure, PlotError};
pub use histogram::{Histogram, HistogramPanel, histograms};
pub use maps::{FieldMap, positions_figure};
pub use pictures::{Picture, PictureAxes, pictures};
