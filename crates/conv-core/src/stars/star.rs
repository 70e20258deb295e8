//! One star, ready to be drawn.

use std::ops::Range;

use psf_types::{PixelRegion, PointSource};

use super::phases::{Phase, PhasedAxis};
use crate::ConvReal;
use crate::overlap::overlap;
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
    /// The pixels that it lights.
    pub(super) columns: Range<i64>,
    pub(super) rows: Range<i64>,
    /// The coefficients that its first pixel takes first: the row, and the residue of the column.
    pub(super) first_row: usize,
    pub(super) first_residue: usize,
    /// Where its weights lie: for each tap of the rows, those of the kernels, times the star's flux.
    pub(super) weights: Range<usize>,
    /// The columns' weights.
    pub(super) taps: [T; MOST_TAPS],
}

impl<T: ConvReal> PreparedStar<T> {
    /// A star from its phases and where its weights are.
    pub(super) fn new(
        star: &Star,
        [columns, rows]: [Phase; 2],
        weights: Range<usize>,
        oversampling: usize,
    ) -> Self {
        let (column, row) = star.pixel;
        Self {
            columns: column + columns.from..column + columns.to,
            rows: row + rows.from..row + rows.to,
            first_row: rows.first_of(rows.from, oversampling),
            first_residue: columns.first_of(columns.from, oversampling),
            weights,
            taps: columns.weights.map(T::nearest),
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

    /// Whether it may light a pixel of a region of the frame.
    pub(super) fn reaches(&self, window: Window, region: PixelRegion) -> bool {
        let (column, row) = self.pixel;
        let on = |pixel: i64, (from, to): (i64, i64), start: i64, count: usize| {
            let first = pixel.saturating_add(from).saturating_sub(start);
            overlap(first, (to - from) as usize, count).is_some()
        };
        let shape = region.shape();
        self.flux != 0.0
            && on(column, window.columns, region.x0(), shape.nx())
            && on(row, window.rows, region.y0(), shape.ny())
    }

    /// Numbers of its phases.
    pub(super) fn phase_numbers(&self, [columns, rows]: &[PhasedAxis; 2]) -> (i64, i64) {
        (
            rows.phase_number(self.shift.1),
            columns.phase_number(self.shift.0),
        )
    }

    /// Columns and rows of its phases; none where no pixel is lit.
    pub(super) fn phases(&self, [columns, rows]: &[PhasedAxis; 2]) -> Option<[Phase; 2]> {
        Some([columns.phase(self.shift.0)?, rows.phase(self.shift.1)?])
    }
}
