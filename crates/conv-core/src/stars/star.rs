//! One star, ready to be drawn.

use psf_types::{PixelRegion, PointSource};

use super::phases::{Phase, PhasedAxis};
use super::star_block::RowLayout;
use crate::ConvReal;
use crate::stamp_interpolator::MOST_TAPS;

/// Where a star lies and which pixels it lights.
#[derive(Debug, Clone, Copy)]
pub(super) struct Star {
    /// Its number in the catalogue.
    pub(super) index: usize,
    /// The pixel of the frame that it lies on.
    pub(super) pixel: (i64, i64),
    /// The rest of the way, in pixels.
    pub(super) shift: (f64, f64),
    /// Its field position.
    pub(super) position: (f64, f64),
    pub(super) flux: f64,
}

/// Pixels about a star's own that its stamp may light: columns and rows `from..to`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Window {
    pub(crate) columns: (i64, i64),
    pub(crate) rows: (i64, i64),
}

/// A star with its phases and the coefficients of its block's kernels.
#[derive(Debug)]
pub(super) struct PreparedStar<T> {
    pub(super) pixel: (i64, i64),
    pub(super) columns: Phase,
    pub(super) rows: Phase,
    /// For each tap of the rows, those of the kernels, times the star's flux.
    pub(super) weights: Vec<T>,
    /// Where the residues lie that the star takes: up to the last, and again from the first.
    pub(super) spans: [std::ops::Range<usize>; 2],
    /// The columns' taps: the first sum that each takes, and its weight.
    pub(super) taps: [(usize, T); MOST_TAPS],
}

impl<T: ConvReal> PreparedStar<T> {
    /// A star from its place and the weights of rows and kernels.
    pub(super) fn new(
        pixel: (i64, i64),
        [columns, rows]: [Phase; 2],
        weights: Vec<T>,
        axis: &PhasedAxis,
        layout: RowLayout,
    ) -> Self {
        let s = axis.oversampling();
        let (first, _) = columns.tap(0, s);
        let used = axis.tap_count().min(s);
        let span = |from: usize, to: usize| from * layout.residue..to * layout.residue;
        let taps = std::array::from_fn(|tap| {
            let (residue, q) = columns.tap(tap, s);
            (residue * layout.residue + q, T::nearest(columns.weights[tap]))
        });
        Self {
            pixel,
            columns,
            rows,
            weights,
            spans: [
                span(first, (first + used).min(s)),
                span(0, (first + used).saturating_sub(s)),
            ],
            taps,
        }
    }
}

impl Star {
    pub(super) fn new(index: usize, source: &PointSource, frame: PixelRegion) -> Self {
        // Positions of the field count from the frame's first pixel.
        let x = source.position().x() - frame.x0() as f64;
        let y = source.position().y() - frame.y0() as f64;
        let pixel = ((x + 0.5).floor() as i64, (y + 0.5).floor() as i64);
        Self {
            index,
            pixel,
            shift: (x - pixel.0 as f64, y - pixel.1 as f64),
            position: (x, y),
            flux: source.flux(),
        }
    }

    /// Whether it may light a row of `rows` and a column below `columns`.
    pub(super) fn reaches(&self, window: Window, columns: usize, rows: std::ops::Range<i64>) -> bool {
        let (column, row) = self.pixel;
        let on = |pixel: i64, (from, to): (i64, i64), start: i64, end: i64| {
            pixel.saturating_add(from) < end && pixel.saturating_add(to) > start
        };
        self.flux != 0.0
            && on(column, window.columns, 0, columns as i64)
            && on(row, window.rows, rows.start, rows.end)
    }

    /// Columns and rows of its phases; none where no pixel is lit.
    pub(super) fn phases(&self, axes: &[PhasedAxis; 2], window: Window) -> Option<[Phase; 2]> {
        let [columns, rows] = axes;
        Some([
            columns.phase(self.shift.0, window.columns.0, window.columns.1)?,
            rows.phase(self.shift.1, window.rows.0, window.rows.1)?,
        ])
    }
}
