//! An image with fewer pixels.

use ndarray::{Array2, ArrayView2};
use psf_io::{ImageReader, IoError};

/// Number of rows read from a file at once.
const BAND: usize = 64;

/// An image of limited size. Each of its pixels is the mean of a square bin of pixels of the
/// original image.
#[derive(Debug, Clone, PartialEq)]
pub struct BinnedImage {
    pixels: Array2<f64>,
    /// Pixels of the original image along each side of a bin.
    pub factor: usize,
    /// Number of pixels of the original image that are NaN or infinite.
    pub undefined_pixels: usize,
}

impl BinnedImage {
    /// Bins an image `[y, x]`. The bins are the smallest, at least one pixel, for which the longer
    /// axis has at most `max_size` bins. The first bin starts at pixel 0. Bins at the far edges may
    /// hold fewer pixels.
    ///
    /// A bin is the mean of its finite pixels, or NaN if there are none.
    ///
    /// ```
    /// use psfield_lab::preview::BinnedImage;
    /// let image = ndarray::array![[1.0, 3.0, 5.0], [f64::NAN, 2.0, f64::NAN]];
    /// let binned = BinnedImage::of(image.view(), 2);
    /// assert_eq!(binned.pixels(), ndarray::array![[2.0, 5.0]]);
    /// assert_eq!((binned.factor, binned.undefined_pixels), (2, 2));
    /// ```
    pub fn of(image: ArrayView2<'_, f64>, max_size: usize) -> Self {
        let mut binned = Self::empty(image.dim(), max_size);
        let mut counts = Array2::zeros(binned.pixels.dim());
        binned.add(image, 0, &mut counts);
        binned.divided(&counts)
    }

    /// Bins an image in a file. The file is read in bands of rows, and may be larger than memory.
    ///
    /// # Errors
    /// [`IoError`] if the reader cannot read the rows.
    pub fn read(reader: &mut ImageReader, max_size: usize) -> Result<Self, IoError> {
        let (ny, nx) = (reader.shape().ny(), reader.shape().nx());
        let mut binned = Self::empty((ny, nx), max_size);
        let mut counts = Array2::zeros(binned.pixels.dim());
        for first in (0..ny).step_by(BAND) {
            let rows = reader.read_rows_with_undefined(first..ny.min(first + BAND))?;
            binned.add(rows.view(), first, &mut counts);
        }
        Ok(binned.divided(&counts))
    }

    fn empty((ny, nx): (usize, usize), max_size: usize) -> Self {
        let factor = ny.max(nx).div_ceil(max_size.max(1)).max(1);
        Self {
            pixels: Array2::zeros((ny.div_ceil(factor), nx.div_ceil(factor))),
            factor,
            undefined_pixels: 0,
        }
    }

    /// Adds rows of the image, the first of which is row `first`. `counts` holds the number of finite
    /// pixels in each bin.
    fn add(&mut self, rows: ArrayView2<'_, f64>, first: usize, counts: &mut Array2<u32>) {
        for (y, row) in rows.outer_iter().enumerate() {
            let y = (first + y) / self.factor;
            for (x, &value) in row.iter().enumerate() {
                let bin = [y, x / self.factor];
                if value.is_finite() {
                    self.pixels[bin] += value;
                    counts[bin] += 1;
                } else {
                    self.undefined_pixels += 1;
                }
            }
        }
    }

    /// Turns sums into means. A bin without finite pixels becomes NaN: 0 / 0.
    fn divided(mut self, counts: &Array2<u32>) -> Self {
        self.pixels
            .zip_mut_with(counts, |sum, &count| *sum /= f64::from(count));
        self
    }

    /// The means `[y, x]`.
    pub fn pixels(&self) -> ArrayView2<'_, f64> {
        self.pixels.view()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_keep_the_light() {
        let image = Array2::from_shape_fn((11, 17), |(y, x)| (x * x + 3 * y) as f64);
        for max_size in [1, 2, 5, 9, 16, 17, 400] {
            let binned = BinnedImage::of(image.view(), max_size);
            let (ny, nx) = binned.pixels().dim();
            assert!(nx.max(ny) <= max_size, "{max_size}");
            let factor = binned.factor;
            let light: f64 = binned
                .pixels()
                .indexed_iter()
                .map(|((y, x), mean)| {
                    let side = |k: usize, n: usize| factor.min(n - k * factor) as f64;
                    mean * side(y, 11) * side(x, 17)
                })
                .sum();
            assert!((light - image.sum()).abs() < 1e-9, "{max_size}: {light}");
        }
        assert_eq!(BinnedImage::of(image.view(), 17).pixels(), image);
    }
}
