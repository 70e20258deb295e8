//! An exposure by rows.

use ndarray::{Array2, ArrayView1, ArrayView2};
use psf_types::{FrameShape, Image, Real};
use rayon::prelude::*;

use crate::sky::FrameSky;
use crate::{BadPixelMask, Detector, DetectorError, Exposure, ExposureReport, PhotonNoise, PixelFlags};

/// A detector made ready for a frame and a seed.
///
/// Rows may be exposed in any order and in bands of any height: the counts put together are those of the whole image.
///
/// ```
/// use detector::{Detector, DetectorParams};
/// use ndarray::{Array2, s};
/// use psf_types::{FrameShape, Image};
/// let ccd = Detector::new(DetectorParams { photon_noise: true, sky_e: 9.0, ..DetectorParams::default() })?;
/// let light = Image::new(Array2::from_elem((20, 30), 1.0_f32))?;
/// let whole = ccd.expose(&light, 7)?;
///
/// let exposer = ccd.exposer(light.shape(), 7)?;
/// let band = exposer.expose_rows(8, light.pixels().slice(s![8..13, ..]))?;
/// assert_eq!(band.counts, whole.counts().pixels().slice(s![8..13, ..]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Exposer<'a> {
    detector: &'a Detector,
    frame: FrameShape,
    seed: u64,
    sky: FrameSky,
    /// Electrons that dark current gives good and hot pixels.
    dark_e: f64,
    hot_dark_e: f64,
    columns: Vec<u8>,
    mask: Option<&'a BadPixelMask>,
}

/// Rows of an exposure.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ExposedRows<T> {
    /// Counts `[y, x]` in the detector's unit.
    pub counts: Array2<T>,
    /// Sums of [`PixelFlags`], `[y, x]`.
    pub flags: Array2<u8>,
    /// What happened in these rows.
    pub report: ExposureReport,
}

impl<'a> Exposer<'a> {
    pub(crate) fn new(detector: &'a Detector, frame: FrameShape, seed: u64) -> Result<Self, DetectorError> {
        let seconds = detector.params().exposure_s.unwrap_or(0.0);
        Ok(Self {
            detector,
            frame,
            seed,
            sky: detector.sky.over(frame)?,
            dark_e: detector.dark_e(),
            hot_dark_e: detector.bad_pixels.hot_dark_e_per_s * seconds,
            columns: detector.bad_pixels.columns(frame.nx()),
            mask: None,
        })
    }

    /// With bad pixels beside those that the detector draws.
    ///
    /// # Errors
    /// [`DetectorError::MaskShape`], and [`DetectorError::Needs`] for hot pixels without `bad_pixels.hot_dark_e_per_s`.
    pub fn with_mask(self, mask: &'a BadPixelMask) -> Result<Self, DetectorError> {
        if mask.shape() != self.frame {
            return Err(DetectorError::MaskShape {
                mask: mask.shape(),
                frame: self.frame,
            });
        }
        if mask.has_hot() && self.detector.bad_pixels.hot_dark_e_per_s == 0.0 {
            return Err(DetectorError::Needs {
                key: "a bad-pixel mask with hot pixels",
                other: "bad_pixels.hot_dark_e_per_s",
            });
        }
        Ok(Self {
            mask: Some(mask),
            ..self
        })
    }

    /// Exposes a whole image, in parallel.
    ///
    /// # Errors
    /// As [`Detector::expose`]; [`DetectorError::Rows`] or [`DetectorError::RowWidth`] for an image of another shape.
    pub fn expose<T: Real>(&self, light: &Image<T>) -> Result<Exposure<T>, DetectorError> {
        if light.shape().ny() != self.frame.ny() {
            return Err(DetectorError::Rows {
                rows: 0..light.shape().ny(),
                frame: self.frame,
            });
        }
        Exposure::new(self.expose_rows(0, light.pixels())?)
    }

    /// Exposes rows `[y, x]`, the first of which is row `first_row` of the frame, in parallel.
    ///
    /// # Errors
    /// As [`Detector::expose`]; [`DetectorError::NonFinite`] also for NaN and infinities among the rows, [`DetectorError::Rows`],
    /// [`DetectorError::RowWidth`]. Of several bad pixels the first is named.
    pub fn expose_rows<T: Real>(
        &self,
        first_row: usize,
        light: ArrayView2<'_, T>,
    ) -> Result<ExposedRows<T>, DetectorError> {
        self.check_rows(first_row, light)?;
        let nx = self.frame.nx();
        let mut counts = Array2::zeros(light.dim());
        let mut flags = Array2::zeros(light.dim());
        let tallies: Vec<Result<ExposureReport, DetectorError>> = as_rows(&mut counts, nx)
            .zip(as_rows(&mut flags, nx))
            .enumerate()
            .map(|(k, (counts, flags))| self.expose_row(first_row + k, light.row(k), counts, flags))
            .collect();
        let mut report = self.report();
        for tally in tallies {
            report.add(&tally?);
        }
        Ok(ExposedRows {
            counts,
            flags,
            report,
        })
    }

    /// Rows of the noise-free image ([`Detector::truth`]).
    ///
    /// # Errors
    /// As [`expose_rows`](Self::expose_rows).
    pub fn truth_rows<T: Real>(
        &self,
        first_row: usize,
        light: ArrayView2<'_, T>,
    ) -> Result<Array2<T>, DetectorError> {
        self.check_rows(first_row, light)?;
        let mut truth = Array2::zeros(light.dim());
        let done: Vec<Result<(), DetectorError>> = as_rows(&mut truth, self.frame.nx())
            .enumerate()
            .map(|(k, truth)| {
                let row = first_row + k;
                let mut electrons = self.collected(row, light.row(k))?;
                for value in &mut electrons {
                    *value = self.detector.amplifier.counts(*value + self.dark_e);
                }
                store(row, &electrons, truth)
            })
            .collect();
        done.into_iter().collect::<Result<(), _>>()?;
        Ok(truth)
    }

    /// The whole chain for a row.
    fn expose_row<T: Real>(
        &self,
        row: usize,
        light: ArrayView1<'_, T>,
        counts: &mut [T],
        flags: &mut [u8],
    ) -> Result<ExposureReport, DetectorError> {
        let detector = self.detector;
        let mut report = self.report();
        let mut values = self.collected(row, light)?;
        if let Some(response) = detector.response {
            response.apply(row, &mut values);
        }
        self.mark(row, flags);
        for (value, flag) in values.iter_mut().zip(&*flags) {
            *value += self.dark_e;
            if flag & PixelFlags::HOT != 0 {
                *value += self.hot_dark_e;
            }
            if flag & PixelFlags::NO_CHARGE != 0 {
                *value = 0.0;
            }
            report.count_expected(*value);
            *value = value.max(0.0);
        }
        if detector.params().photon_noise {
            PhotonNoise::new(self.seed).catch(row, &mut values);
        }
        if let Some(full_well) = detector.full_well {
            full_well.clip(&mut values, flags);
        }
        if let Some(read_noise) = detector.read_noise {
            read_noise.add(self.seed, row, &mut values);
        }
        for value in &mut values {
            *value = detector.amplifier.counts(*value);
        }
        if let Some(converter) = detector.converter {
            report.below_zero_pixels += converter.convert(&mut values, flags);
        }
        report.count_flags(flags);
        store(row, &values, counts)?;
        Ok(report)
    }

    /// Electrons that light and sky give a row of pixels alike.
    fn collected<T: Real>(&self, row: usize, light: ArrayView1<'_, T>) -> Result<Vec<f64>, DetectorError> {
        let per_flux = self.detector.params().electrons_per_flux;
        let electrons: Vec<f64> = light
            .iter()
            .enumerate()
            .map(|(x, flux)| per_flux * flux.as_f64() + self.sky.at(x, row))
            .collect();
        match electrons.iter().position(|value| !value.is_finite()) {
            None => Ok(electrons),
            Some(x) => Err(DetectorError::NonFinite {
                index: [row, x],
                value: electrons[x],
            }),
        }
    }

    /// Flags the bad pixels of a row.
    fn mark(&self, row: usize, flags: &mut [u8]) {
        flags.copy_from_slice(&self.columns);
        self.detector.bad_pixels.mark(row, flags);
        if let Some(mask) = self.mask {
            for (flag, more) in flags.iter_mut().zip(mask.flags().row(row)) {
                *flag |= more;
            }
        }
    }

    /// A report of no pixels.
    fn report(&self) -> ExposureReport {
        ExposureReport::empty(self.seed, self.detector.params().sky_e, self.dark_e)
    }

    fn check_rows<T>(&self, first_row: usize, light: ArrayView2<'_, T>) -> Result<(), DetectorError> {
        let (ny, nx) = light.dim();
        if nx != self.frame.nx() {
            return Err(DetectorError::RowWidth {
                expected: self.frame.nx(),
                got: nx,
            });
        }
        let rows = first_row..first_row.saturating_add(ny);
        if rows.end > self.frame.ny() {
            return Err(DetectorError::Rows {
                rows,
                frame: self.frame,
            });
        }
        Ok(())
    }
}

/// The rows of an array that was just made.
fn as_rows<T: Send>(array: &mut Array2<T>, nx: usize) -> rayon::slice::ChunksMut<'_, T> {
    let values = array.as_slice_mut().expect("a new array is contiguous");
    values.par_chunks_mut(nx)
}

/// Values in the type of the image.
fn store<T: Real>(row: usize, values: &[f64], out: &mut [T]) -> Result<(), DetectorError> {
    for (x, (value, out)) in values.iter().zip(out).enumerate() {
        *out = T::nearest(*value);
        if !out.is_finite() {
            return Err(DetectorError::TooLarge {
                index: [row, x],
                value: *value,
                precision: T::NAME,
            });
        }
    }
    Ok(())
}
