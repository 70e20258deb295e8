//! An image checked against the direct sum at random pixels.

use psf_types::{Image, Real};
use serde::Serialize;

use crate::{PickedPixel, PixelPicker, PsfieldError};

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
}
