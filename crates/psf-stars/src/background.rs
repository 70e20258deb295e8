//! The background of a frame and its noise, and two tools that other modules use too: the median
//! and the spline.

use ndarray::{Array2, ArrayView2, Zip, s};
use psf_types::maths::{mirrored_index, spline_coefficients, spline_weights};
use rayon::prelude::*;

use crate::StarError;
use crate::error::{check, checked_setters};

/// Estimates the background on a mesh, as SExtractor does (Bertin and Arnouts 1996, section 7.1).
///
/// In each cell of the mesh, values are clipped at 3 sigma about their median until nothing
/// changes. The background is the mode, `2.5 median - 1.5 mean`. In crowded cells, where mean and
/// median differ by more than 0.3 sigma, the background is the median. The noise is the standard
/// deviation of the remaining values. A median filter over the mesh then removes the effect of
/// cells that a bright object fills. Bicubic splines interpolate both maps between the centres of
/// the cells, and beyond the outermost centres they are constant.
///
/// ```
/// use ndarray::Array2;
/// use psf_stars::BackgroundMesh;
/// let frame = Array2::from_shape_fn((128, 128), |(y, x)| 100.0 + f64::from((7 * x as u32 + 13 * y as u32) % 5));
/// let background = BackgroundMesh::new(32)?.estimate(frame.view())?;
/// assert!((background.level()[[60, 60]] - 102.0).abs() < 0.2);
/// # Ok::<(), psf_stars::StarError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BackgroundMesh {
    cell: usize,
    filter: usize,
}

impl BackgroundMesh {
    /// Default number of pixels along each side of a cell.
    pub const DEFAULT_CELL: usize = 64;
    const SMALLEST_CELL: usize = 8;

    /// A mesh of `cell` x `cell` pixels per cell with a median filter over 3 x 3 cells. Cells are
    /// larger if the frame's size is not a multiple of `cell`. A frame smaller than `cell` has one
    /// cell. Cells should be several times wider than the stars, and narrower than the changes of
    /// the sky.
    ///
    /// # Errors
    /// [`StarError::Setting`] for cells below 8 pixels.
    pub fn new(cell: usize) -> Result<Self, StarError> {
        check(
            cell >= Self::SMALLEST_CELL,
            "the background mesh",
            "at least 8 pixels",
            cell as f64,
        )?;
        Ok(Self { cell, filter: 3 })
    }

    checked_setters! {
        /// Sets the median filter to `filter` x `filter` cells. With 1 there is no filter.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is odd.
        with_filter(filter: usize) => filter, if filter % 2 == 1,
            else "the background filter", "an odd number of cells";
    }

    /// Estimates the background of `pixels` `[y, x]`. NaN pixels are ignored. A cell in which more
    /// than half of the pixels are NaN gets the median of the cells around it. If this is true of
    /// all cells, each cell is estimated from its remaining pixels.
    ///
    /// # Errors
    /// [`StarError::NoNoise`] when more than half of the cells have no noise after the median
    /// filter, or when all pixels are NaN.
    pub fn estimate(&self, pixels: ArrayView2<'_, f64>) -> Result<Background, StarError> {
        let (ny, nx) = pixels.dim();
        let (rows, columns) = ((ny / self.cell).max(1), (nx / self.cell).max(1));
        let cut = |k: usize, count: usize, n: usize| k * n / count..(k + 1) * n / count;
        let estimated = |least: f64| -> Vec<(f64, f64)> {
            let cells = (0..rows * columns).into_par_iter().map(|k| {
                let (y, x) = (cut(k / columns, rows, ny), cut(k % columns, columns, nx));
                let pixels = pixels.slice(s![y, x]);
                let good: Vec<f64> = pixels.iter().copied().filter(|v| !v.is_nan()).collect();
                if good.len() as f64 >= least * pixels.len() as f64 {
                    clipped(good)
                } else {
                    (f64::NAN, f64::NAN)
                }
            });
            cells.collect()
        };
        let mut cells = estimated(LEAST_GOOD);
        if cells.iter().all(|cell| cell.0.is_nan()) {
            cells = estimated(0.0);
        }
        let map = |of: fn(&(f64, f64)) -> f64| {
            let values = cells.iter().map(of).collect();
            let map = Array2::from_shape_vec((rows, columns), values).expect("one value per cell");
            median_filtered(&filled(map), self.filter)
        };
        let (level, rms) = (map(|c| c.0), map(|c| c.1));
        let typical_rms = median(rms.iter().copied());
        if typical_rms.is_nan() || typical_rms <= 0.0 {
            return Err(StarError::NoNoise);
        }
        // A spline may undershoot the values that it interpolates, but noise must stay above 0.
        let least = rms
            .iter()
            .copied()
            .filter(|&v| v > 0.0)
            .fold(typical_rms, f64::min);
        let level = interpolated(&level, (ny, nx));
        let mut rms = interpolated(&rms, (ny, nx));
        rms.mapv_inplace(|v| v.max(least));
        let typical_level = median(cells.iter().map(|cell| cell.0).filter(|v| !v.is_nan()));
        Ok(Background {
            level,
            rms,
            typical_level,
            typical_rms,
        })
    }
}

impl Default for BackgroundMesh {
    fn default() -> Self {
        Self {
            cell: Self::DEFAULT_CELL,
            filter: 3,
        }
    }
}

/// The background of a frame, in units of the frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Background {
    level: Array2<f64>,
    rms: Array2<f64>,
    typical_level: f64,
    typical_rms: f64,
}

impl Background {
    /// The background of every pixel `[y, x]`.
    pub fn level(&self) -> ArrayView2<'_, f64> {
        self.level.view()
    }

    /// The standard deviation of the background's noise at every pixel `[y, x]`, above 0.
    pub fn rms(&self) -> ArrayView2<'_, f64> {
        self.rms.view()
    }

    /// Subtracts the level from a frame `[y, x]` of the same shape. NaN pixels become 0.
    pub(crate) fn subtracted_from(&self, frame: ArrayView2<'_, f64>) -> Array2<f64> {
        let mut excess = &frame - &self.level;
        excess.mapv_inplace(|v| if v.is_nan() { 0.0 } else { v });
        excess
    }

    /// The median level over the cells of the mesh.
    pub fn typical_level(&self) -> f64 {
        self.typical_level
    }

    /// The median noise over the cells of the mesh.
    pub fn typical_rms(&self) -> f64 {
        self.typical_rms
    }
}

/// The median, or NaN if there are no values.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_unstable_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => values[n / 2],
        n => f64::midpoint(values[n / 2 - 1], values[n / 2]),
    }
}

/// The smallest fraction of good pixels (not NaN) with which a cell is estimated from its own
/// pixels. The fraction is SExtractor's. A cell with fewer good pixels gets the median of the cells
/// around it. If no cell has enough good pixels, every cell with any good pixel is estimated.
const LEAST_GOOD: f64 = 0.5;
/// Values farther from the median than this number of standard deviations are clipped.
const CLIP: f64 = 3.0;
const MOST_CLIPS: usize = 50;
/// A cell is crowded if its mean and median differ by more than this number of standard deviations
/// (SExtractor's value).
const CROWDED: f64 = 0.3;

/// Mode and standard deviation of clipped values.
fn clipped(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_unstable_by(f64::total_cmp);
    let mut kept = values.as_slice();
    let mut found = moments(kept);
    for _ in 0..MOST_CLIPS {
        let (_, median, sigma) = found;
        let first = kept.partition_point(|&v| v < median - CLIP * sigma);
        let end = kept.partition_point(|&v| v <= median + CLIP * sigma);
        if (first, end) == (0, kept.len()) || first >= end {
            break;
        }
        kept = &kept[first..end];
        found = moments(kept);
    }
    let (mean, median, sigma) = found;
    let mode = if (mean - median).abs() < CROWDED * sigma {
        2.5 * median - 1.5 * mean
    } else {
        median
    };
    (mode, sigma)
}

/// Mean, median and standard deviation of sorted values, NaN if there are none.
fn moments(sorted: &[f64]) -> (f64, f64, f64) {
    let n = sorted.len();
    if n == 0 {
        return (f64::NAN, f64::NAN, f64::NAN);
    }
    let median = f64::midpoint(sorted[(n - 1) / 2], sorted[n / 2]);
    // The sums are taken about the median, so that a high background causes no cancellation.
    let (mut first, mut second) = (0.0, 0.0);
    for v in sorted {
        first += v - median;
        second += (v - median).powi(2);
    }
    let shift = first / n as f64;
    let variance = (second / n as f64 - shift * shift).max(0.0);
    (median + shift, median, variance.sqrt())
}

/// Replaces NaN by the median of the values around it, and repeats this until no NaN is left. A map
/// in which all values are NaN stays as it is.
fn filled(mut map: Array2<f64>) -> Array2<f64> {
    while map.iter().any(|v| v.is_nan()) && !map.iter().all(|v| v.is_nan()) {
        let around = median_filtered(&map, 3);
        map.zip_mut_with(&around, |v, &near| {
            if v.is_nan() {
                *v = near;
            }
        });
    }
    map
}

/// The median of `size` x `size` values around each value. NaN is ignored.
fn median_filtered(map: &Array2<f64>, size: usize) -> Array2<f64> {
    let (rows, columns) = map.dim();
    let reach = size / 2;
    Array2::from_shape_fn((rows, columns), |(j, i)| {
        let about = |k: usize, n: usize| k.saturating_sub(reach)..(k + reach + 1).min(n);
        let near = map.slice(s![about(j, rows), about(i, columns)]);
        median(near.iter().copied().filter(|v| !v.is_nan()))
    })
}

/// Interpolates from the centres of cells to pixels.
fn interpolated(map: &Array2<f64>, (ny, nx): (usize, usize)) -> Array2<f64> {
    let (rows, columns) = map.dim();
    let spline = Spline::through(map.view());
    let coordinate =
        |pixel: usize, cells: usize, n: usize| (pixel as f64 + 0.5) * cells as f64 / n as f64 - 0.5;
    let mut pixels = Array2::zeros((ny, nx));
    Zip::indexed(&mut pixels).par_for_each(|(y, x), value| {
        *value = spline.at(coordinate(x, columns, nx), coordinate(y, rows, ny));
    });
    pixels
}

/// The interpolating cubic spline of an array `[y, x]`, continued beyond its ends by mirroring
/// about the outermost values.
#[derive(Debug, Clone)]
pub(crate) struct Spline {
    coefficients: Array2<f64>,
}

impl Spline {
    pub(crate) fn through(values: ArrayView2<'_, f64>) -> Self {
        Self {
            coefficients: spline_coefficients(values),
        }
    }

    /// The value at column `x` and row `y`. A position off the array is moved to the array's edge.
    pub(crate) fn at(&self, x: f64, y: f64) -> f64 {
        let (rows, columns) = self.coefficients.dim();
        let near = |t: f64, n: usize| {
            let t = t.clamp(0.0, (n - 1) as f64);
            (t.floor() as i64 - 1, spline_weights(t - t.floor()))
        };
        let ((first_x, along_x), (first_y, along_y)) = (near(x, columns), near(y, rows));
        let mut sum = 0.0;
        for (j, wy) in along_y.iter().enumerate() {
            let row = self.coefficients.row(mirrored_index(first_y + j as i64, rows));
            let line: f64 = along_x
                .iter()
                .enumerate()
                .map(|(i, wx)| wx * row[mirrored_index(first_x + i as i64, columns)])
                .sum();
            sum += wy * line;
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn sky(slope: f64, sigma: f64) -> Array2<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        Array2::from_shape_fn((256, 320), |(y, x)| {
            let noise: f64 = StandardNormal.sample(&mut rng);
            1000.0 + slope * (x as f64 + 0.5 * y as f64) + sigma * noise
        })
    }

    /// The mode of a cell of 4096 values has an error of at most 2.5 sigma / 64.
    const LEVEL: f64 = 0.1;
    /// A 3-sigma clip reduces sigma by 1.4 %.
    const RMS: f64 = 0.03;

    #[test]
    fn a_sloping_sky_under_stars() {
        let (slope, sigma) = (0.05, 4.0);
        let mut frame = sky(slope, sigma);
        for k in 0..60usize {
            let (y, x) = (3 + (k * 37) % 250, 3 + (k * 71) % 314);
            frame
                .slice_mut(s![y - 1..y + 2, x - 1..x + 2])
                .mapv_inplace(|v| v + 800.0);
        }
        let found = BackgroundMesh::default().estimate(frame.view()).unwrap();
        for (y, x) in [(128, 160), (60, 100), (200, 250)] {
            let truth = 1000.0 + slope * (x as f64 + 0.5 * y as f64);
            let off = (found.level()[[y, x]] - truth).abs() / sigma;
            assert!(off < 2.0 * LEVEL, "{off} sigma at {x}, {y}");
        }
        // The slope within a cell adds to the noise: 64 pixels x 0.05 / sqrt(12).
        let within = (sigma * sigma + 1.25 * (64.0 * slope).powi(2) / 12.0).sqrt();
        assert!(
            (found.typical_rms() / within - 1.0).abs() < RMS,
            "{}",
            found.typical_rms()
        );
    }

    #[test]
    fn a_cell_with_few_good_pixels_takes_the_background_around_it() {
        let slope = 0.05;
        let mut frame = sky(slope, 4.0);
        // A masked galaxy, of which a part is left over.
        frame.slice_mut(s![128.., 128..192]).fill(f64::NAN);
        frame.slice_mut(s![140..150, 140..180]).fill(3000.0);
        let mesh = BackgroundMesh::default().with_filter(1).unwrap();
        let found = mesh.estimate(frame.view()).unwrap();
        for (y, x) in [(160, 160), (224, 160)] {
            let truth = 1000.0 + slope * (x as f64 + 0.5 * y as f64);
            let off = (found.level()[[y, x]] - truth).abs();
            assert!(off < 64.0 * slope, "{off} at {x}, {y}: more than a cell away");
        }
        // If all cells have few good pixels, these must do.
        let mut sparse = sky(0.0, 4.0);
        sparse.slice_mut(s![..;3, ..]).fill(f64::NAN);
        sparse.slice_mut(s![1..;3, ..]).fill(f64::NAN);
        let found = mesh.estimate(sparse.view()).unwrap();
        assert!((found.typical_level() - 1000.0).abs() < 4.0 * LEVEL);
    }

    #[test]
    fn a_flat_frame_has_no_noise() {
        let flat = Array2::from_elem((100, 100), 7.0);
        assert_eq!(
            BackgroundMesh::default().estimate(flat.view()),
            Err(StarError::NoNoise)
        );
        assert!(BackgroundMesh::new(4).is_err() && BackgroundMesh::default().with_filter(2).is_err());
    }

    #[test]
    fn a_frame_smaller_than_a_cell_is_one_cell() {
        let frame = sky(0.0, 1.0).slice(s![..20, ..30]).to_owned();
        let found = BackgroundMesh::default().estimate(frame.view()).unwrap();
        assert!(
            found
                .level()
                .iter()
                .all(|v| (v - found.typical_level()).abs() < 1e-9)
        );
    }

    #[test]
    fn a_spline_passes_through_the_values_of_any_shape() {
        for (ny, nx) in [(1, 1), (1, 4), (2, 3), (9, 6)] {
            let values = Array2::from_shape_fn((ny, nx), |(y, x)| ((5 * y + 3 * x) % 7) as f64 - 2.0);
            let spline = Spline::through(values.view());
            for ((y, x), value) in values.indexed_iter() {
                assert!((spline.at(x as f64, y as f64) - value).abs() < 1e-13);
            }
        }
    }
}
