//! Figures: drawn once as SVG, from which the PNG is made.
//!
//! Every figure of psfield has its colours, its axes and its way to a file from here. Colours: Okabe and Ito (2008) for lines, viridis
//! for values, blue-white-red (ColorBrewer's RdBu) for differences; all three stay apart for colour-blind eyes and in grey.

mod axes;
mod colour_bar;
mod colours;
mod curve;
mod curve_chart;
mod curve_panels;
mod curves;
mod field_map;
mod figure;
mod histogram;
mod pictures;
mod positions;
mod ticks;

pub use colours::{ColourMap, SERIES};
pub use curve::{Curve, Marker};
pub use curve_panels::curve_panels;
pub use curves::{Axis, Curves, Mark};
pub use field_map::FieldMap;
pub use figure::{Figure, PlotError};
pub use histogram::{HistogramPanel, histograms};
pub use pictures::{Picture, PictureAxes, Scale, pictures};
pub use positions::positions_figure;
