//! What happened in an exposure.

use serde::Serialize;

use crate::PixelFlags;

/// Counts of pixels and levels of an exposure, or of some rows of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ExposureReport {
    /// The seed of the noise.
    pub seed: u64,
    /// Pixels exposed.
    pub pixels: usize,
    /// Pixels at their full well or at the upper end of the converter.
    pub saturated_pixels: usize,
    /// Pixels that the converter cut at 0.
    pub below_zero_pixels: usize,
    /// Pixels that expected less than no charge and were taken as dark.
    pub negative_pixels: usize,
    /// The lowest charge expected in any pixel, in electrons, negative ones as they were; 0 without pixels.
    pub lowest_expected_e: f64,
    /// Pixels with any flag of [`PixelFlags::BAD`].
    pub bad_pixels: usize,
    /// Dead pixels among them.
    pub dead_pixels: usize,
    /// Hot pixels among them.
    pub hot_pixels: usize,
    /// Pixels of bad columns among them.
    pub bad_column_pixels: usize,
    /// Mean sky over the frame in electrons a pixel.
    pub mean_sky_e: f64,
    /// Dark charge of a good pixel in electrons.
    pub dark_e: f64,
}

impl ExposureReport {
    pub(crate) fn empty(seed: u64, mean_sky_e: f64, dark_e: f64) -> Self {
        Self {
            seed,
            pixels: 0,
            saturated_pixels: 0,
            below_zero_pixels: 0,
            negative_pixels: 0,
            lowest_expected_e: 0.0,
            bad_pixels: 0,
            dead_pixels: 0,
            hot_pixels: 0,
            bad_column_pixels: 0,
            mean_sky_e,
            dark_e,
        }
    }

    /// Adds what happened in other rows of the same exposure.
    pub fn add(&mut self, other: &Self) {
        self.lowest_expected_e = match (self.pixels, other.pixels) {
            (0, _) => other.lowest_expected_e,
            (_, 0) => self.lowest_expected_e,
            _ => self.lowest_expected_e.min(other.lowest_expected_e),
        };
        self.pixels += other.pixels;
        self.saturated_pixels += other.saturated_pixels;
        self.below_zero_pixels += other.below_zero_pixels;
        self.negative_pixels += other.negative_pixels;
        self.bad_pixels += other.bad_pixels;
        self.dead_pixels += other.dead_pixels;
        self.hot_pixels += other.hot_pixels;
        self.bad_column_pixels += other.bad_column_pixels;
    }

    /// A pixel with its expected charge.
    pub(crate) fn count_expected(&mut self, electrons: f64) {
        self.lowest_expected_e = if self.pixels == 0 {
            electrons
        } else {
            self.lowest_expected_e.min(electrons)
        };
        self.pixels += 1;
        self.negative_pixels += usize::from(electrons < 0.0);
    }

    /// The flags of pixels that are counted already.
    pub(crate) fn count_flags(&mut self, flags: &[u8]) {
        let with = |bits: u8| flags.iter().filter(|&flag| flag & bits != 0).count();
        self.saturated_pixels += with(PixelFlags::SATURATED);
        self.bad_pixels += with(PixelFlags::BAD);
        self.dead_pixels += with(PixelFlags::DEAD);
        self.hot_pixels += with(PixelFlags::HOT);
        self.bad_column_pixels += with(PixelFlags::BAD_COLUMN);
    }
}
