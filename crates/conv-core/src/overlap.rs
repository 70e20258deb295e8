//! Adds overlapping parts of an image in an order that does not depend on the number of threads.
//! Divides images into disjoint parts to which threads write at the same time.

use std::ops::Range;

use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis, s};
use psf_types::{PixelRegion, Progress};
use rayon::prelude::*;

use crate::{ConvError, ConvReal};

/// A rectangle of values to be added to an output. It may reach beyond the output.
pub(crate) struct Piece<T> {
    /// Column and row of the first value.
    pub(crate) first: (i64, i64),
    pub(crate) values: Array2<T>,
}

impl<T: ConvReal> Piece<T> {
    /// Adds the part of the piece that lies on the output. The output's first pixel is at
    /// `(column, row)`.
    pub(crate) fn add_to(&self, output: &mut ArrayViewMut2<'_, T>, (column, row): (i64, i64)) {
        let at = (self.first.0 - column, self.first.1 - row);
        add_values(self.values.view(), at, output);
    }
}

/// Adds values to an output, from pixel `(column, row)` of the output on. Values beyond the output
/// are ignored.
pub(crate) fn add_values<T: ConvReal>(
    values: ArrayView2<'_, T>,
    (column, row): (i64, i64),
    output: &mut ArrayViewMut2<'_, T>,
) {
    let (ny, nx) = output.dim();
    let (rows, columns) = values.dim();
    let (Some((from_rows, to_rows)), Some((from_columns, to_columns))) =
        (overlap(row, rows, ny), overlap(column, columns, nx))
    else {
        return;
    };
    let mut target = output.slice_mut(s![to_rows, to_columns]);
    let values = values.slice(s![from_rows, from_columns]);
    // Row by row, because the values of a row lie side by side in memory.
    for (mut target, values) in target.outer_iter_mut().zip(values.outer_iter()) {
        target += &values;
    }
}

/// Adds pieces to an image in order. `first` is the image's first pixel `(column, row)`. Each task
/// adds to `band` rows of the image.
pub(crate) fn add_pieces<'a, T: ConvReal>(
    pieces: impl Iterator<Item = &'a Piece<T>> + Clone + Sync,
    mut image: ArrayViewMut2<'_, T>,
    first: (i64, i64),
    band: usize,
) {
    let bands = image.axis_chunks_iter_mut(Axis(0), band).into_par_iter();
    bands.enumerate().for_each(|(number, mut rows)| {
        for piece in pieces.clone() {
            piece.add_to(&mut rows, (first.0, first.1 + (number * band) as i64));
        }
    });
}

/// Finds the pixels that two regions share. For x and for y, returns the ranges of [`overlap`] for
/// the pixels of `part` on `whole`. `None` if there are none.
pub(crate) fn shared(part: PixelRegion, whole: PixelRegion) -> Option<[(Range<usize>, Range<usize>); 2]> {
    let along = |first: i64, length: usize, start: i64, limit: usize| {
        overlap(first.saturating_sub(start), length, limit)
    };
    let (shape, of_whole) = (part.shape(), whole.shape());
    Some([
        along(part.x0(), shape.nx(), whole.x0(), of_whole.nx())?,
        along(part.y0(), shape.ny(), whole.y0(), of_whole.ny())?,
    ])
}

/// Finds the values that lie on an axis of length `limit`. There are `length` values, and the first
/// has index `first` on the axis. Returns the range of the values that lie on the axis, first among
/// the values and then on the axis. `None` if there are none.
pub(crate) fn overlap(first: i64, length: usize, limit: usize) -> Option<(Range<usize>, Range<usize>)> {
    let start = first.max(0);
    let end = first.saturating_add(length as i64).min(limit as i64);
    let range = |from: i64, to: i64| from as usize..to as usize;
    (start < end).then(|| (range(start - first, end - first), range(start, end)))
}

/// The number of sets of pieces computed in parallel. It limits the number of pieces in memory.
const PIECE_SETS_AT_ONCE: usize = 16;

/// Computes `count` sets of pieces in parallel and adds them to the output in order. Each set is
/// one step of the progress.
pub(crate) fn add_in_order<T: ConvReal>(
    mut output: ArrayViewMut2<'_, T>,
    count: usize,
    progress: &dyn Progress,
    make: impl Fn(usize) -> Result<Vec<Piece<T>>, ConvError> + Sync,
) -> Result<(), ConvError> {
    progress.start(count as u64);
    for first in (0..count).step_by(PIECE_SETS_AT_ONCE) {
        let made: Vec<Result<Vec<Piece<T>>, ConvError>> = (first..(first + PIECE_SETS_AT_ONCE).min(count))
            .into_par_iter()
            .map(|number| {
                progress.check_cancelled()?;
                make(number)
            })
            .collect();
        for pieces in made {
            for piece in pieces? {
                piece.add_to(&mut output, (0, 0));
            }
            progress.advance(1);
        }
    }
    Ok(())
}

/// Returns the parts of a view in some ranges `(start, end)` along an axis. The ranges are
/// ascending and do not overlap.
pub(crate) fn split<'a, T>(
    view: ArrayViewMut2<'a, T>,
    axis: usize,
    ranges: &[(usize, usize)],
) -> Vec<ArrayViewMut2<'a, T>> {
    let mut rest = view;
    let mut at = 0;
    let mut parts = Vec::with_capacity(ranges.len());
    for &(start, end) in ranges {
        let (_, tail) = rest.split_at(Axis(axis), start - at);
        let (part, tail) = tail.split_at(Axis(axis), end - start);
        parts.push(part);
        rest = tail;
        at = end;
    }
    parts
}

/// The number of colours: the smallest `n` such that no range overlaps the `n`-th range after it.
/// Every `n`-th range gets one colour, and threads may write to these ranges at the same time.
pub(crate) fn colours(ranges: &[(usize, usize)]) -> usize {
    let clear = |n: usize| ranges.iter().zip(ranges.iter().skip(n)).all(|(a, b)| a.1 <= b.0);
    (1..ranges.len())
        .find(|&n| clear(n))
        .unwrap_or(ranges.len().max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_are_cut_at_every_edge() {
        let add = |column, row| {
            let mut output = Array2::<f64>::zeros((3, 4));
            let (first, values) = ((column, row), Array2::ones((2, 2)));
            Piece { first, values }.add_to(&mut output.view_mut(), (0, 0));
            output.sum()
        };
        assert_eq!(add(0, 0), 4.0);
        assert_eq!(add(-1, 0), 2.0);
        assert_eq!(add(3, 2), 1.0);
        assert_eq!(add(-1, -1), 1.0);
        for (column, row) in [(-2, 0), (4, 0), (0, 3), (0, -2), (100, -100)] {
            assert_eq!(add(column, row), 0.0);
        }
    }

    #[test]
    fn parts_are_those_asked_for() {
        let mut whole = Array2::<u32>::zeros((1, 10));
        for (i, mut part) in split(whole.view_mut(), 1, &[(1, 3), (3, 4), (8, 10)])
            .into_iter()
            .enumerate()
        {
            part += i as u32 + 1;
        }
        assert_eq!(whole.as_slice().unwrap(), [0, 1, 1, 2, 0, 0, 0, 0, 3, 3]);
    }

    #[test]
    fn colours_keep_ranges_apart() {
        assert_eq!(colours(&[(0, 3), (3, 5), (5, 9)]), 1);
        assert_eq!(colours(&[(0, 4), (3, 6), (5, 9)]), 2);
        assert_eq!(colours(&[(0, 8), (1, 9), (2, 9)]), 3);
        assert_eq!(colours(&[(0, 8)]), 1);
        assert_eq!(colours(&[]), 1);
    }
}
