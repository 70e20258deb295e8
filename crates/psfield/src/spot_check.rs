//! Checks an image against the direct sum at random pixels.

use psf_io::{Card, CardError};
use psf_types::{FrameShape, Image, Real};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::{Method, PsfieldError, SimulateOptions};

/// The largest relative r.m.s. rounding errors accepted. For images made by Fourier transforms,
/// errors are a few times 1e-7 (f32) and 1e-15 (f64). They are larger if the scene's light varies
/// by orders of magnitude.
const ROUNDING_F32: f64 = 1e-5;
const ROUNDING_F64: f64 = 1e-10;
/// The largest accepted ratio of the relative error at the checked pixels to the relative error of
/// the whole PSF.
const PIXELS_OVER_PSF: f64 = 3.0;

/// The difference of an image from the direct sum in f64 at random pixels, half of them where the
/// image is bright. The check measures the error that the engine adds to the model. It does not
/// measure the error of the model itself, nor the error of stamps that are too coarse to draw stars
/// between pixels.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SpotCheck {
    /// Number of pixels that were compared.
    pub pixels: usize,
    /// The seed that chose the pixels.
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
    /// True if `relative_rms` is within the limit or, if it is None, all differences are 0. None
    /// without a limit.
    pub passed: Option<bool>,
}

impl SpotCheck {
    /// The keywords of [`cards`](Self::cards).
    pub const KEYWORDS: [&str; 5] = ["PSFCHKN", "PSFCHKS", "PSFCHKM", "PSFCHKR", Self::VERDICT_KEYWORD];
    /// The keyword of the verdict.
    pub const VERDICT_KEYWORD: &str = "PSFCHKV";
    /// The verdict on an image that differs by more than its method promises.
    pub const FAILED: &str = "failed";

    /// The limit for [`judged`](Self::judged): the largest relative r.m.s. difference that a
    /// simulation with these options and the working precision `T` promises. It is the limit for
    /// rounding. Methods with a tolerance add three times the tolerance. `extended` says whether
    /// the scene has extended light. If so, the limit is None for patches and for the caller's own
    /// method, because they promise nothing.
    ///
    /// ```
    /// use psfield::{Method, SimulateOptions, SpotCheck};
    /// let mut options = SimulateOptions { tolerance: 1e-3, ..SimulateOptions::default() };
    /// let limit = SpotCheck::limit_of::<f64>(&options, true);
    /// assert!(limit.is_some_and(|limit| (1e-3..1e-2).contains(&limit)));
    /// options.method = Method::Patch(64);
    /// assert_eq!(SpotCheck::limit_of::<f64>(&options, true), None);
    /// ```
    pub fn limit_of<T: Real>(options: &SimulateOptions, extended: bool) -> Option<f64> {
        let rounding = if size_of::<T>() == 4 {
            ROUNDING_F32
        } else {
            ROUNDING_F64
        };
        match options.method {
            Method::Patch(_) | Method::Own if extended => None,
            method if method.has_plan() => Some(PIXELS_OVER_PSF * options.tolerance + rounding),
            _ => Some(rounding),
        }
    }

    /// Compares `count` pixels of an image, chosen by `seed`, with the values that `exact` returns.
    ///
    /// # Errors
    /// The errors of `exact`.
    pub fn run<T: Real>(
        image: &Image<T>,
        count: usize,
        seed: u64,
        exact: impl FnOnce(&[(usize, usize)]) -> Result<Vec<f64>, PsfieldError>,
    ) -> Result<Self, PsfieldError> {
        let mut picker = PixelPicker::new(image.shape(), count, seed);
        for row in image.pixels().outer_iter() {
            picker.pass(row.iter().map(|v| v.as_f64()));
        }
        Self::of_picked(picker, exact)
    }

    /// Compares the pixels that a [`PixelPicker`] chose from an image's rows.
    ///
    /// # Errors
    /// The errors of `exact`.
    pub fn of_picked(
        picker: PixelPicker,
        exact: impl FnOnce(&[(usize, usize)]) -> Result<Vec<f64>, PsfieldError>,
    ) -> Result<Self, PsfieldError> {
        let seed = picker.seed();
        let (picked, peak) = picker.finish();
        let pixels: Vec<(usize, usize)> = picked.iter().map(|p| (p.column, p.row)).collect();
        let exact = exact(&pixels)?;
        let difference = |(p, exact): (&PickedPixel, &f64)| (p.value - exact).abs();
        let differences: Vec<f64> = picked.iter().zip(&exact).map(difference).collect();
        let max_abs = differences.iter().copied().fold(0.0, f64::max);
        let root_mean_square =
            |values: &[f64]| (values.iter().map(|d| d * d).sum::<f64>() / values.len().max(1) as f64).sqrt();
        let (rms, whole) = (root_mean_square(&differences), root_mean_square(&exact));
        Ok(Self {
            pixels: picked.len(),
            seed,
            max_abs,
            rms,
            max_over_peak: (peak > 0.0).then(|| max_abs / peak),
            relative_rms: (whole > 0.0).then(|| rms / whole),
            limit: None,
            passed: None,
        })
    }

    /// Adds a verdict. The check passes if the relative r.m.s. difference is at most `limit`. If
    /// the direct sum is 0 at all compared pixels, the check passes only if all differences are 0.
    #[must_use]
    pub fn judged(self, limit: f64) -> Self {
        let passed = match self.relative_rms {
            Some(relative) => relative <= limit,
            None => self.max_abs == 0.0,
        };
        Self {
            limit: Some(limit),
            passed: Some(passed),
            ..self
        }
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
pub struct PixelPicker {
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
pub struct PickedPixel {
    /// Column of the image.
    pub column: usize,
    /// Row of the image.
    pub row: usize,
    /// The image's value.
    pub value: f64,
}

impl PixelPicker {
    /// Makes a picker of `count` pixels of an image with this shape.
    pub fn new(shape: FrameShape, count: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let bright_count = count / 2;
        let mut anywhere: Vec<(usize, usize)> = (0..count - bright_count)
            .map(|_| (rng.random_range(0..shape.ny()), rng.random_range(0..shape.nx())))
            .collect();
        anywhere.sort_unstable();
        Self {
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

    /// Reads the next row of the image.
    pub fn pass(&mut self, row: impl Iterator<Item = f64>) {
        let row: Vec<f64> = row.collect();
        while let Some(&(_, column)) = self
            .anywhere
            .get(self.values.len())
            .filter(|p| p.0 == self.next_row)
        {
            self.values.push(row[column]);
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

    /// Returns the pixels, sorted by rows, and the largest absolute value of the image.
    pub fn finish(self) -> (Vec<PickedPixel>, f64) {
        let anywhere = self.anywhere.into_iter().zip(self.values);
        let mut picked: Vec<PickedPixel> = anywhere
            .map(|((row, column), value)| PickedPixel { column, row, value })
            .chain(
                self.bright
                    .into_iter()
                    .map(|(row, column, value)| PickedPixel { column, row, value }),
            )
            .collect();
        picked.sort_by_key(|p| (p.row, p.column));
        (picked, self.peak)
    }

    /// The seed.
    pub fn seed(&self) -> u64 {
        self.seed
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
        let (picked, peak) = picker.finish();
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
        let (picked, peak) = picker.finish();
        assert_eq!((picked.len(), peak), (5, 0.0));
    }
}
