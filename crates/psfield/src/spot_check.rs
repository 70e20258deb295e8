//! Checks an image against the direct sum, at random pixels and around random sources.

use conv_core::GalaxyErrors;
use ndarray::ArrayView2;
use psf_io::{Card, CardError};
use psf_types::{FrameShape, Real};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

/// The largest relative r.m.s. rounding error that is accepted: twice the error that the
/// documentation states, because the pixels are a sample.
const ROUNDING_F32: f64 = 4e-7;
const ROUNDING_F64: f64 = 2e-14;
/// The largest rounding error of a single pixel, divided by the image's largest absolute value and
/// by the r.m.s. error above. Rounding errors are similar in all pixels of a tile.
const LARGEST_OVER_RMS: f64 = 5.0;
/// Around a source, this many pixels are compared along each side of a square.
const AROUND: usize = 7;

/// The difference of an image from the direct sum in f64. It has three parts, and an image passes
/// if all of them are within their limits:
///
/// 1. **Sources.** Around up to 32 stars, 32 galaxies and 32 pixels of the scene's image, all chosen
///    at random, 7 x 7 pixels are compared. The root of the sum of their squared differences is at
///    most the sum, over all sources that light these pixels, of tolerance times light times the L2
///    norm of the PSF. For a source that is alone, this is its tolerance.
/// 2. **Pixels.** At random pixels, half of them where the image is bright, each difference is at
///    most the same sum over the sources that light the pixel. This follows because an error in one
///    pixel is at most the error of the whole PSF.
/// 3. **R.m.s.** The r.m.s. of the differences at these pixels is at most the r.m.s. of the tolerance
///    times the norm of the PSF times `sqrt(sum of light^2)`, where the light of stars in one pixel of
///    the frame is one term. This follows from the Cauchy-Schwarz inequality if the error of the PSF
///    is nearly the same for all sources that light a pixel, and on average if the errors of different
///    sources are independent.
///
/// To each limit, rounding is added, and the light that the floor drops at most
/// ([`Simulator::dropped_light`](crate::Simulator::dropped_light)). A galaxy is compared with an
/// integral on the sky, which shares nothing with its drawing. Its limits are lower, because its
/// light is spread over many pixels, and they include the error of its image (see
/// [`conv_core::SourcePlan`]). In the r.m.s., galaxies add up as in single pixels. The check
/// measures the error that the engine adds to the model. It does not measure the error of the model
/// itself, nor the error of stamps that are too coarse to be interpolated.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SpotCheck {
    /// Number of pixels that were compared.
    pub pixels: usize,
    /// The seed that chose the pixels and sources.
    pub seed: u64,
    /// The largest absolute difference.
    pub max_abs: f64,
    /// The root mean square of the differences.
    pub rms: f64,
    /// The largest absolute difference, divided by the image's largest absolute value. None for an
    /// image of zeros.
    pub max_over_peak: Option<f64>,
    /// `rms`, divided by the root mean square of the direct sum at the same pixels. None if the
    /// direct sum is 0 at all these pixels.
    pub relative_rms: Option<f64>,
    /// The largest `relative_rms` that the method promises. None if it promises nothing.
    pub limit: Option<f64>,
    /// The largest difference in a pixel, divided by the largest that the method promises there.
    pub worst_pixel: Option<f64>,
    /// Number of stars, galaxies and pixels of the scene around which pixels were compared.
    pub sources: usize,
    /// The largest difference around a source, divided by the largest that the method promises
    /// there.
    pub worst_source: Option<f64>,
    /// True if `relative_rms` is within the limit, and `worst_pixel` and `worst_source` are at most
    /// 1. None if the method promises nothing.
    pub passed: Option<bool>,
}

/// The relative r.m.s. rounding error that is accepted.
pub(crate) fn rounding_of<T: Real>() -> f64 {
    if size_of::<T>() == 4 {
        ROUNDING_F32
    } else {
        ROUNDING_F64
    }
}

/// The errors that a pixel may have because of its sources.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Allowed {
    /// The sum of all errors.
    pub(crate) sum: f64,
    /// The part of `sum` that each pixel may have.
    pub(crate) each: f64,
    /// Errors as roots of sums of squares over all pixels, added over the sources.
    pub(crate) norm: f64,
    /// The error that is expected if the PSFs of different places add up like random numbers.
    pub(crate) root: f64,
}

/// Values of pixels by the direct sum, and the errors that a method promises for them.
pub(crate) type Exact = (Vec<f64>, Option<Vec<Allowed>>);

impl Allowed {
    /// Adds the error of a PSF. `root` is the root of the sum of the squared errors of this kind of
    /// source in the pixel, to which it is added.
    pub(crate) fn add_psf(&mut self, error: f64, root: &mut f64) {
        self.sum += error;
        self.norm += error;
        *root = root.hypot(error);
    }

    /// Adds light that the pixel may lack.
    pub(crate) fn add_dropped(&mut self, light: f64) {
        self.sum += light;
        self.each += light;
        self.root += light;
    }

    /// Adds the errors of a galaxy. The error of its PSF is limited in each pixel or, if that is less,
    /// by its norm.
    pub(crate) fn add_galaxy(&mut self, errors: GalaxyErrors) {
        let error = errors.psf + errors.image;
        self.sum += error;
        if errors.psf * (AROUND as f64) < errors.psf_norm {
            self.each += error;
        } else {
            self.each += errors.image;
            self.norm += errors.psf_norm;
        }
        // Galaxies that overlap see the same part of the PSF's error.
        self.root += error;
    }
}

/// The root of the sum of the squares, of values whose squares may overflow.
fn norm(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let largest = values.clone().fold(0.0, |largest: f64, v| largest.max(v.abs()));
    if largest > 0.0 && largest.is_finite() {
        largest * values.map(|v| (v / largest).powi(2)).sum::<f64>().sqrt()
    } else {
        largest
    }
}

impl SpotCheck {
    /// The keywords of [`cards`](Self::cards).
    pub const KEYWORDS: [&str; 5] = ["PSFCHKN", "PSFCHKS", "PSFCHKM", "PSFCHKR", Self::VERDICT_KEYWORD];
    /// The keyword of the verdict.
    pub const VERDICT_KEYWORD: &str = "PSFCHKV";
    /// The verdict on an image that differs by more than its method promises.
    pub const FAILED: &str = "failed";

    /// Compares the pixels that a [`PixelPicker`] chose from an image's rows. `exact` gets pixels
    /// `(column, row)` that are sorted by rows. It returns their values by the direct sum and the
    /// errors that the method promises, or None if it promises nothing.
    pub(crate) fn of_picked<T: Real, E>(
        picker: PixelPicker,
        exact: impl FnOnce(&[(usize, usize)]) -> Result<Exact, E>,
    ) -> Result<Self, E> {
        let seed = picker.seed;
        let (picked, squares, peak) = picker.finish();
        let of_squares = squares.iter().flatten();
        let mut places: Vec<(usize, usize)> = picked
            .iter()
            .chain(of_squares)
            .map(|p| (p.row, p.column))
            .collect();
        places.sort_unstable();
        places.dedup();
        let pixels: Vec<(usize, usize)> = places.iter().map(|&(row, column)| (column, row)).collect();
        let (exact, allowed) = exact(&pixels)?;
        let index = |p: &PickedPixel| places.partition_point(|&place| place < (p.row, p.column));
        let difference = |p: &PickedPixel| (p.value - exact[index(p)]).abs();
        let root_of_count = (picked.len().max(1) as f64).sqrt();
        let max_abs = picked.iter().map(difference).fold(0.0, f64::max);
        let found = norm(picked.iter().map(difference)) / root_of_count;
        let whole = norm(picked.iter().map(|p| exact[index(p)])) / root_of_count;
        let mut check = Self {
            pixels: picked.len(),
            seed,
            max_abs,
            rms: found,
            max_over_peak: (peak > 0.0).then(|| max_abs / peak),
            relative_rms: (whole > 0.0).then(|| found / whole),
            sources: squares.len(),
            ..Self::default()
        };
        let Some(allowed) = allowed else {
            return Ok(check);
        };
        let rounding = rounding_of::<T>();
        let of_pixel = LARGEST_OVER_RMS * rounding * peak;
        let over = |difference: f64, limit: f64| {
            if difference == 0.0 {
                0.0
            } else {
                difference / limit
            }
        };
        let worst_pixel = picked
            .iter()
            .map(|p| over(difference(p), allowed[index(p)].sum + of_pixel))
            .fold(0.0, f64::max);
        let worst_source = squares
            .iter()
            .map(|square| {
                let found = norm(square.iter().map(difference));
                let of = |p: &PickedPixel| allowed[index(p)];
                let together = square.iter().map(|p| of(p).norm).fold(0.0, f64::max);
                let allowed = together + norm(square.iter().map(|p| of(p).each));
                over(found, allowed + of_pixel * (square.len() as f64).sqrt())
            })
            .fold(0.0, f64::max);
        let limit = norm(picked.iter().map(|p| allowed[index(p)].root)) / root_of_count / whole + rounding;
        check.worst_pixel = Some(worst_pixel);
        check.worst_source = Some(worst_source);
        check.limit = (whole > 0.0).then_some(limit);
        let within = check.relative_rms.is_none_or(|relative| relative <= limit);
        check.passed = Some(within && worst_pixel <= 1.0 && worst_source <= 1.0);
        Ok(check)
    }

    /// Header cards with the result.
    ///
    /// # Errors
    /// [`CardError`] for differences that are not finite.
    pub fn cards(&self) -> Result<[Card; 5], CardError> {
        let [count, seed, largest, rms, verdict] = Self::KEYWORDS;
        let found = match self.passed {
            Some(true) => "passed",
            Some(false) => Self::FAILED,
            None => "none",
        };
        Ok([
            Card::new(count, self.pixels, "pixels checked against the direct sum")?,
            Card::new(seed, self.seed.to_string(), "seed that chose the checked pixels")?,
            Card::new(largest, self.max_abs, "largest difference found")?,
            Card::new(rms, self.rms, "r.m.s. difference found")?,
            Card::new(verdict, found, "is the error within the method's limit?")?,
        ])
    }
}

/// Picks random pixels of an image that is read row by row. For half of them, all pixels of the
/// image are equally probable. For the other half, the probability of a pixel is proportional to
/// its absolute value. For an image of zeros, this second half is left out. The choice depends only
/// on the image, the number of pixels and the seed.
#[derive(Debug, Clone)]
pub(crate) struct PixelPicker {
    /// The pixels around sources, in squares.
    squares: Vec<Vec<PickedPixel>>,
    /// The pixels of the first half: `(row, column)`, ascending.
    anywhere: Vec<(usize, usize)>,
    /// The values of the pixels in `anywhere` whose rows have been read.
    values: Vec<f64>,
    /// The pixels of the second half: `(row, column, value)`, replaced as more rows are read.
    bright: Vec<(usize, usize, f64)>,
    bright_count: usize,
    rng: ChaCha8Rng,
    seed: u64,
    next_row: usize,
    light: f64,
    peak: f64,
}

/// A pixel and its value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PickedPixel {
    /// Column of the image.
    pub(crate) column: usize,
    /// Row of the image.
    pub(crate) row: usize,
    /// The image's value.
    pub(crate) value: f64,
}

impl PixelPicker {
    /// Makes a picker of `count` pixels of an image with this shape.
    pub(crate) fn new(shape: FrameShape, count: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let bright_count = count / 2;
        let mut anywhere: Vec<(usize, usize)> = (0..count - bright_count)
            .map(|_| (rng.random_range(0..shape.ny()), rng.random_range(0..shape.nx())))
            .collect();
        anywhere.sort_unstable();
        Self {
            squares: Vec::new(),
            anywhere,
            values: Vec::new(),
            bright: Vec::new(),
            bright_count,
            rng,
            seed,
            next_row: 0,
            light: 0.0,
            peak: 0.0,
        }
    }

    /// Also picks the pixels in squares around sources. `sources` are columns and rows of the image
    /// of this shape. Squares that lie outside the image are left out.
    pub(crate) fn with_sources(mut self, sources: &[(i64, i64)], shape: FrameShape) -> Self {
        let near = |centre: i64, length: usize| {
            let first = centre.saturating_sub(AROUND as i64 / 2);
            first.max(0) as usize..first.saturating_add(AROUND as i64).clamp(0, length as i64) as usize
        };
        for &(column, row) in sources {
            let (columns, rows) = (near(column, shape.nx()), near(row, shape.ny()));
            let pixel = |row, column| PickedPixel {
                column,
                row,
                value: 0.0,
            };
            let square: Vec<PickedPixel> = rows
                .flat_map(|row| columns.clone().map(move |column| pixel(row, column)))
                .collect();
            if !square.is_empty() {
                self.squares.push(square);
            }
        }
        self
    }

    /// Reads the next rows of the image.
    pub(crate) fn pass_rows<T: Real>(&mut self, rows: ArrayView2<'_, T>) {
        for row in rows.outer_iter() {
            self.pass(row.iter().map(|v| v.as_f64()));
        }
    }

    /// Reads the next row of the image.
    fn pass(&mut self, row: impl Iterator<Item = f64>) {
        let row: Vec<f64> = row.collect();
        while let Some(&(_, column)) = self
            .anywhere
            .get(self.values.len())
            .filter(|p| p.0 == self.next_row)
        {
            self.values.push(row[column]);
        }
        for pixel in self
            .squares
            .iter_mut()
            .flatten()
            .filter(|p| p.row == self.next_row)
        {
            pixel.value = row[pixel.column];
        }
        let mut passed = 0.0;
        let light: Vec<f64> = row
            .iter()
            .map(|v| {
                self.peak = self.peak.max(v.abs());
                passed += v.abs();
                passed
            })
            .collect();
        if passed > 0.0 && passed.is_finite() {
            self.light += passed;
            // Replaces each bright pick, with a probability equal to the row's share of all light
            // so far. The new pick is a pixel of this row, chosen in proportion to its light.
            let chance = passed / self.light;
            let first = self.bright.is_empty();
            self.bright.resize(self.bright_count, (0, 0, 0.0));
            for pick in &mut self.bright {
                if first || self.rng.random::<f64>() < chance {
                    let at = self.rng.random::<f64>() * passed;
                    let column = light.partition_point(|&l| l <= at).min(row.len() - 1);
                    *pick = (self.next_row, column, row[column]);
                }
            }
        }
        self.next_row += 1;
    }

    /// Returns the random pixels, sorted by rows, the squares around sources, and the largest
    /// absolute value of the image.
    pub(crate) fn finish(self) -> (Vec<PickedPixel>, Vec<Vec<PickedPixel>>, f64) {
        let anywhere = self.anywhere.into_iter().zip(self.values);
        let anywhere = anywhere.map(|((row, column), value)| (row, column, value));
        let mut picked: Vec<PickedPixel> = anywhere
            .chain(self.bright)
            .map(|(row, column, value)| PickedPixel { column, row, value })
            .collect();
        picked.sort_by_key(|p| (p.row, p.column));
        (picked, self.squares, self.peak)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_the_pixels_are_bright_ones() {
        let shape = FrameShape::new(50, 40).unwrap();
        // Two bright pixels, one three times as bright as the other, and almost no light elsewhere.
        let value = |row: usize, column: usize| match (row, column) {
            (7, 3) => 1e6,
            (31, 44) => -3e6,
            _ => 1e-3,
        };
        let mut picker = PixelPicker::new(shape, 4000, 1);
        (0..40).for_each(|row| picker.pass((0..50).map(|column| value(row, column))));
        let (picked, _, peak) = picker.finish();
        assert_eq!((picked.len(), peak), (4000, 3e6));
        assert!(picked.iter().all(|p| p.value == value(p.row, p.column)));
        let count = |at: (usize, usize)| picked.iter().filter(|p| (p.row, p.column) == at).count();
        let (one, three) = (count((7, 3)), count((31, 44)));
        assert!((1990..2030).contains(&(one + three)), "{one} {three}");
        assert!((400..600).contains(&one), "{one}");
        // The other pixels lie all over the image.
        assert!(picked.iter().filter(|p| p.row < 20).count() > 900);
    }

    #[test]
    fn a_dark_image_has_pixels_anywhere() {
        let mut picker = PixelPicker::new(FrameShape::new(5, 2).unwrap(), 9, 3);
        (0..2).for_each(|_| picker.pass([0.0; 5].into_iter()));
        let (picked, _, peak) = picker.finish();
        assert_eq!((picked.len(), peak), (5, 0.0));
    }
}
