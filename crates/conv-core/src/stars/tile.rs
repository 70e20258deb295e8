//! What a group of stars lights.

use std::ops::Range;

use ndarray::ArrayViewMut2;

use crate::ConvReal;

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
        let shared = |from: i64, length: usize, first: i64, count: usize| {
            from.max(first)..(from + length as i64).min(first + count as i64)
        };
        let columns = shared(self.origin.0, self.width, first_column, rows.ncols());
        let height = self.values.len() / self.width.max(1);
        let shared = shared(self.origin.1, height, first_row, rows.nrows());
        if columns.is_empty() {
            return;
        }
        for y in shared {
            let first = (y - self.origin.1) as usize * self.width + (columns.start - self.origin.0) as usize;
            let mut row = rows.row_mut((y - first_row) as usize);
            let row = row.as_slice_mut().expect("images are row-major");
            let (from, to) = (columns.start - first_column, columns.end - first_column);
            let row = &mut row[from as usize..to as usize];
            for (t, v) in row.iter_mut().zip(&self.values[first..]) {
                *t += *v;
            }
        }
    }
}
