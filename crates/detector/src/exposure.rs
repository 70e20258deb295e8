//! An exposure.

use ndarray::{Array2, ArrayView2};
use psf_types::{Image, Real};

use crate::{DetectorError, ExposedRows, ExposureReport};

/// The counts of an exposure, with what is to know of its pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure<T = f32> {
    counts: Image<T>,
    flags: Array2<u8>,
    report: ExposureReport,
}

impl<T: Real> Exposure<T> {
    pub(crate) fn new(rows: ExposedRows<T>) -> Result<Self, DetectorError> {
        Ok(Self {
            counts: Image::new(rows.counts)?,
            flags: rows.flags,
            report: rows.report,
        })
    }

    /// The counts, in the unit of [`Detector::unit`](crate::Detector::unit). Digitised ones are whole numbers.
    pub fn counts(&self) -> &Image<T> {
        &self.counts
    }

    /// Sums of [`PixelFlags`](crate::PixelFlags), `[y, x]`.
    pub fn flags(&self) -> ArrayView2<'_, u8> {
        self.flags.view()
    }

    /// What happened.
    pub fn report(&self) -> &ExposureReport {
        &self.report
    }

    /// The counts, without a copy.
    pub fn into_counts(self) -> Image<T> {
        self.counts
    }
}
