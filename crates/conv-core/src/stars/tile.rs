//! What a group of stars lights.

use std::ops::Range;

use ndarray::ArrayViewMut2;

use crate::ConvReal;
use crate::overlap::overlap;

/// What the stars of a block light.
pub(super) struct Tile<T> {
    /// The first column and the first row.
    pub(super) origin: (i64, i64),
    pub(super) width: usize,
    pub(super) values: Vec<T>,
}

impl<T: ConvReal> Tile<T> {
    /// A dark tile of some columns and rows.
    pub(super) fn dark(columns: Range<i64>, rows: Range<i64>) -> Self {
        let length = |range: &Range<i64>| (range.end - range.start).max(0) as usize;
        Self {
            origin: (columns.start, rows.start),
            width: length(&columns),
            values: vec![T::zero(); length(&columns) * length(&rows)],
        }
    }

    pub(super) fn rows(&self) -> Range<i64> {
        let height = self.values.len() / self.width.max(1);
        self.origin.1..self.origin.1 + height as i64
    }

    /// Adds the tile to some pixels of the frame, the first of which is (`first_column`, `first_row`).
    pub(super) fn add_to(&self, rows: &mut ArrayViewMut2<'_, T>, (first_column, first_row): (i64, i64)) {
        let columns = overlap(self.origin.0 - first_column, self.width, rows.ncols());
        let rows_of_tile = self.rows();
        let height = (rows_of_tile.end - rows_of_tile.start) as usize;
        let shared = overlap(rows_of_tile.start - first_row, height, rows.nrows());
        let (Some((from_column, to_column, width)), Some((from_row, to_row, height))) = (columns, shared)
        else {
            return;
        };
        for j in 0..height {
            let first = (from_row + j) * self.width + from_column;
            let mut row = rows.row_mut(to_row + j);
            let row = row.as_slice_mut().expect("images are row-major");
            for (t, v) in row[to_column..to_column + width]
                .iter_mut()
                .zip(&self.values[first..])
            {
                *t += *v;
            }
        }
    }
}
