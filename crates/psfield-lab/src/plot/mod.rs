//! Figures. Each is drawn once, as SVG and as PNG.
//!
//! All figures of psfield share the colours, axes and file formats of this module. Colours: Okabe
//! and Ito (2008) for lines, viridis for values, blue-white-red (ColorBrewer's RdBu) for
//! differences. The colours of each stay distinct for colour-blind readers and in grey.

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
