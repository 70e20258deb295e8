//! The pixels of a stamp that are measured.

use ndarray::{Array2, ArrayView2, s};
use psf_types::Real;
use serde::{Deserialize, Serialize};

use crate::MetricsError;

/// The pixels of a stamp that a measurement uses: all of them, or a square about a pixel.
///
/// A window of `size` pixels about index `c` begins at index `c - size / 2` (integer division).
/// `c` is therefore index `size / 2` of the window, which is also the default centre of a stamp of
/// that size. A window must lie entirely on the stamp. Pixels outside the window are ignored.
///
/// ```
/// use psf_metrics::Window;
/// let window = Window::central(15);
/// assert_eq!(window.ranges(64, 64)?, (25..40, 25..40)); // columns and rows 25 to 39
/// assert!(Window::about(15, 3, 30).ranges(64, 64).is_err());
/// # Ok::<(), psf_metrics::MetricsError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Window {
    /// `None` for all pixels.
    size: Option<usize>,
    /// Column and row. `None` for the middle of the stamp.
    about: Option<(usize, usize)>,
}

impl Window {
    /// A window of all pixels of a stamp.
    pub fn whole() -> Self {
        Self::default()
    }

    /// A window of `size` x `size` pixels about index `n / 2` of each axis of `n` pixels.
    pub fn central(size: usize) -> Self {
        Self {
            size: Some(size),
            about: None,
        }
    }

    /// A window of `size` x `size` pixels about the pixel in column `column` and row `row`.
    pub fn about(size: usize, column: usize, row: usize) -> Self {
        Self {
            size: Some(size),
            about: Some((column, row)),
        }
    }

    /// The columns and the rows of the window on a stamp of `nx` columns and `ny` rows.
    ///
    /// # Errors
    /// [`MetricsError::WindowOutsideStamp`] when the window does not lie entirely on the stamp.
    pub fn ranges(
        self,
        nx: usize,
        ny: usize,
    ) -> Result<(std::ops::Range<usize>, std::ops::Range<usize>), MetricsError> {
        let Some(size) = self.size else {
            return Ok((0..nx, 0..ny));
        };
        let (column, row) = self.about.unwrap_or((nx / 2, ny / 2));
        let range = |centre: usize, n: usize| {
            let first = centre.checked_sub(size / 2)?;
            let end = first.checked_add(size)?;
            (end <= n).then_some(first..end)
        };
        match (range(column, nx), range(row, ny)) {
            (Some(columns), Some(rows)) => Ok((columns, rows)),
            _ => Err(MetricsError::WindowOutsideStamp {
                size,
                column,
                row,
                nx,
                ny,
            }),
        }
    }

    /// Returns the pixels of the window in double precision. All must be finite, and the window
    /// must have at least `need` pixels along each axis.
    pub(crate) fn cut<T: Real>(self, stamp: ArrayView2<'_, T>, need: usize) -> Result<Cutout, MetricsError> {
        let (ny, nx) = stamp.dim();
        let (columns, rows) = self.ranges(nx, ny)?;
        if columns.len() < need || rows.len() < need {
            return Err(MetricsError::TooFewPixels {
                nx: columns.len(),
                ny: rows.len(),
                need,
            });
        }
        let (column_first, row_first) = (columns.start, rows.start);
        let values = stamp.slice(s![rows, columns]).mapv(T::as_f64);
        match values.indexed_iter().find(|(_, v)| !v.is_finite()) {
            Some(((row, column), &value)) => Err(MetricsError::NonFinite {
                index: vec![row_first + row, column_first + column],
                value,
            }),
            None => Ok(Cutout {
                values: values.as_standard_layout().into_owned(),
                column_first,
                row_first,
            }),
        }
    }
}

/// Pixels `[y, x]` cut from a stamp, row-major and finite, and their place on the stamp.
#[derive(Debug)]
pub(crate) struct Cutout {
    pub(crate) values: Array2<f64>,
    column_first: usize,
    row_first: usize,
}

impl Cutout {
    /// Converts a point of the cutout to indices of the stamp.
    pub(crate) fn on_stamp(&self, x: f64, y: f64) -> (f64, f64) {
        (x + self.column_first as f64, y + self.row_first as f64)
    }

    /// Returns an error unless the point (`x`, `y`) lies on a pixel of the cutout.
    pub(crate) fn check_centre(&self, x: f64, y: f64) -> Result<(), MetricsError> {
        let (rows, columns) = self.values.dim();
        let on = |v: f64, n: usize| (-0.5..=n as f64 - 0.5).contains(&v);
        if on(x, columns) && on(y, rows) {
            return Ok(());
        }
        let (x, y) = self.on_stamp(x, y);
        Err(MetricsError::CentreLeftWindow {
            x,
            y,
            column_first: self.column_first,
            column_last: self.column_first + columns - 1,
            row_first: self.row_first,
            row_last: self.row_first + rows - 1,
        })
    }

    pub(crate) fn largest(&self) -> f64 {
        self.values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// The value of largest magnitude, with its sign.
    pub(crate) fn extreme(&self) -> f64 {
        let larger = |a: f64, b: f64| if b.abs() > a.abs() { b } else { a };
        self.values.iter().copied().fold(0.0, larger)
    }

    /// The rows of pixel values.
    pub(crate) fn rows(&self) -> std::slice::ChunksExact<'_, f64> {
        let values = self.values.as_slice().expect("a cutout is row-major");
        values.chunks_exact(self.values.ncols())
    }

    /// The pixel values row by row, each with its column and row in the cutout.
    pub(crate) fn pixels(&self) -> impl Iterator<Item = (f64, f64, f64)> + '_ {
        let columns = self.values.ncols();
        self.values
            .iter()
            .enumerate()
            .map(move |(i, &v)| ((i % columns) as f64, (i / columns) as f64, v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_follow_the_stamp_centre_rule() {
        assert_eq!(Window::central(4).ranges(8, 9).unwrap(), (2..6, 2..6));
        assert_eq!(Window::central(8).ranges(8, 8).unwrap(), (0..8, 0..8));
        assert_eq!(Window::central(9).ranges(9, 9).unwrap(), (0..9, 0..9));
        assert_eq!(Window::about(3, 1, 5).ranges(9, 9).unwrap(), (0..3, 4..7));
        assert_eq!(Window::whole().ranges(5, 3).unwrap(), (0..5, 0..3));
    }

    #[test]
    fn windows_off_the_stamp_are_refused() {
        for window in [
            Window::central(9),
            Window::about(3, 0, 4),
            Window::about(3, 4, 7),
            Window::about(1, usize::MAX, 0),
            Window::about(usize::MAX, usize::MAX, 0),
        ] {
            assert!(
                matches!(
                    window.ranges(8, 8),
                    Err(MetricsError::WindowOutsideStamp { nx: 8, ny: 8, .. })
                ),
                "{window:?}"
            );
        }
    }

    #[test]
    fn only_the_window_must_be_finite() {
        let mut stamp = Array2::<f32>::zeros((7, 7));
        stamp[[0, 3]] = f32::NAN;
        assert!(Window::central(3).cut(stamp.view(), 3).is_ok());
        assert!(matches!(
            Window::whole().cut(stamp.view(), 3),
            Err(MetricsError::NonFinite { index, .. }) if index == [0, 3]
        ));
    }
}
