//! An image checked against the direct sum at random pixels.

use conv_core::PlanOptions;
use psf_io::{Card, CardError};
use psf_types::{Image, Real};
use serde::Serialize;

use crate::{Method, PickedPixel, PixelPicker, PsfieldError};

/// Relative r.m.s. errors of images by transforms: a few 1e-7 and 1e-15, and more where a scene's light varies by decades.
const ROUNDING_F32: f64 = 1e-5;
const ROUNDING_F64: f64 = 1e-10;
/// Single pixels may hold more of a PSF's error than the PSF as a whole.
const PIXELS_OVER_PSF: f64 = 3.0;

/// The difference of an image from the direct sum in f64 at random pixels, half of them where the image is bright: what the
/// engine adds to the model. It says nothing of the model itself, nor of stamps too coarse for the stars drawn between
/// their pixels.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SpotCheck {
    /// How many pixels were looked at.
    pub pixels: usize,
    /// The seed that chose them.
    pub seed: u64,
    /// The largest absolute difference.
    pub max_abs: f64,
    /// The root mean square of the differences.
    pub rms: f64,
    /// The largest absolute difference over the image's largest absolute value; none for a dark image.
    pub max_over_peak: Option<f64>,
    /// `rms` over the root mean square of the direct sum at the same pixels; none where all is dark.
    pub relative_rms: Option<f64>,
    /// What `relative_rms` may be, where the method promises anything.
    pub limit: Option<f64>,
    /// Whether it is.
    pub passed: Option<bool>,
}

impl SpotCheck {
    /// The keywords of [`cards`](Self::cards).
    pub const KEYWORDS: [&str; 5] = ["PSFCHKN", "PSFCHKS", "PSFCHKM", "PSFCHKR", Self::VERDICT_KEYWORD];
    /// The keyword of what the check concluded.
    pub const VERDICT_KEYWORD: &str = "PSFCHKV";
    /// Its value in an image that differs by more than its method promises.
    pub const FAILED: &str = "failed";

    /// The relative r.m.s. difference that a method with its options promises in the working precision `T`
    /// ([`judged`](Self::judged)): rounding, and the tolerance of methods that have one. None for patches of a scene that is an image
    /// (`of_image`), which promise nothing.
    ///
    /// ```
    /// use psfield::conv_core::PlanOptions;
    /// use psfield::{Method, SpotCheck};
    /// let options = PlanOptions::new(1e-3)?;
    /// let limit = SpotCheck::limit_of::<f64>(Method::Auto, options, true);
    /// assert!(limit.is_some_and(|limit| (1e-3..1e-2).contains(&limit)));
    /// assert_eq!(SpotCheck::limit_of::<f64>(Method::Patch(64), options, true), None);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn limit_of<T: Real>(method: Method, options: PlanOptions, of_image: bool) -> Option<f64> {
        let rounding = if size_of::<T>() == 4 {
            ROUNDING_F32
        } else {
            ROUNDING_F64
        };
        match (method, method.plan_options(options)) {
            (Method::Patch(_), _) if of_image => None,
            (_, Some(options)) => Some(PIXELS_OVER_PSF * options.tolerance() + rounding),
            (_, None) => Some(rounding),
        }
    }

    /// Compares `count` pixels of an image, chosen by `seed`, with what `exact` says of them.
    ///
    /// # Errors
    /// Those of `exact`.
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

    /// Compares the pixels that were picked while an image passed.
    ///
    /// # Errors
    /// Those of `exact`.
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

    /// The same with a verdict: passed where the relative r.m.s. difference is at most `limit`. Where all is dark, any difference
    /// at all is too much.
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

    /// What was found, for headers.
    ///
    /// # Errors
    /// [`CardError`] for figures that are not finite.
    pub fn cards(&self) -> Result<[Card; 5], CardError> {
        let [count, seed, largest, rms, verdict] = Self::KEYWORDS;
        let found = match self.passed {
            Some(true) => "passed",
            Some(false) => Self::FAILED,
            None => "none",
        };
        Ok([
            Card::new(count, self.pixels, "pixels checked against the direct sum")?,
            Card::new(seed, self.seed.to_string(), "seed that chose them")?,
            Card::new(largest, self.max_abs, "largest difference found")?,
            Card::new(rms, self.rms, "r.m.s. difference found")?,
            Card::new(verdict, found, "against what the method promises")?,
        ])
    }
}
