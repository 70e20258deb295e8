//! Exposures: all steps of the [chain](crate#the-chain), applied to an image row by row.

use ndarray::{Array2, ArrayView1, ArrayView2, CowArray};
use psf_types::{FrameShape, Image, Real};
use rayon::prelude::*;
use serde::Serialize;

use crate::bad_pixels::{BadPixelMask, PixelFlags, bad_columns, mark_bad_pixels};
use crate::levels::{FrameSky, clip, convert};
use crate::noise::{add_photon_noise, add_read_noise, apply_response, thin_by_response};
use crate::{Detector, DetectorError, DetectorParams};

impl Detector {
    /// Prepares exposures of a frame with a seed. Use it to expose an image in bands of rows, or
    /// with a mask of bad pixels.
    ///
    /// # Errors
    /// [`DetectorError::NegativeSky`] for a sky that is below 0 or not finite somewhere in this
    /// frame.
    pub fn exposer(&self, frame: FrameShape, seed: u64) -> Result<Exposer<'_>, DetectorError> {
        Exposer::new(self, frame, seed)
    }

    /// Applies all steps of the [chain](crate#the-chain) to an image. A seed always gives the same
    /// counts, for any number of threads.
    ///
    /// # Errors
    /// [`DetectorError::NegativeSky`], [`DetectorError::NonFinite`] for charges beyond the range of
    /// double precision, and [`DetectorError::TooLarge`] for counts that `T` cannot hold.
    pub fn expose<T: Real>(&self, light: &Image<T>, seed: u64) -> Result<Exposure<T>, DetectorError> {
        self.exposer(light.shape(), seed)?.expose(light)
    }

    /// The noise-free image in the unit of the counts. It contains light, sky, dark charge and
    /// bias. It leaves out noise, full well, digitisation, bad pixels and the differences of the
    /// pixels' response.
    ///
    /// `(c F + sky + D t) / g + b` with the letters of the [crate's page](crate#the-chain).
    /// Negative pixels stay negative.
    ///
    /// # Errors
    /// The errors of [`expose`](Self::expose).
    pub fn truth<T: Real>(&self, light: &Image<T>) -> Result<Image<T>, DetectorError> {
        let exposer = self.exposer(light.shape(), 0)?;
        Ok(Image::new(exposer.truth_rows(0, light.pixels())?)?)
    }
}

/// Only the step of photon noise: `N ~ Poisson(S)` in every pixel, `P(N = k) = S^k exp(-S) / k!`.
///
/// The mean `S` is the image's flux, in photons or electrons in the exposure. Below a mean of 12
/// the method is Knuth's product of uniform numbers. From 12 to 1.8e19 it is the rejection method
/// PD of Ahrens and Dieter (1982, ACM Trans. Math. Softw. 8, 163). Both methods are exact. Above
/// 1.8e19 it is a rounded normal deviate of mean and variance `S`: there the spacing of doubles
/// exceeds one count, and the skewness is below 3e-10.
///
/// For the same seed, a [`Detector`] with no setting but `photon_noise` gives the same counts. A
/// mean below 0 gives minus a deviate of its size, so the mean is kept. The report counts such pixels.
///
/// ```
/// use psf_detector::PhotonNoise;
/// use psf_types::Image;
/// let expected = Image::new(ndarray::Array2::from_elem((100, 100), 4.0_f32))?;
/// let photons = PhotonNoise::new(1).apply(&expected)?;
/// assert!(photons.counts().pixels().iter().all(|n| *n >= 0.0 && n.fract() == 0.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PhotonNoise {
    seed: u64,
}

impl PhotonNoise {
    /// Photon noise with a seed.
    pub fn new(seed: u64) -> Self {
        Self { seed }
    }

    /// Draws a count for every pixel of an image of expected counts.
    ///
    /// # Errors
    /// [`DetectorError::TooLarge`] for counts that `T` cannot hold.
    pub fn apply<T: Real>(&self, expected: &Image<T>) -> Result<Exposure<T>, DetectorError> {
        Self::detector().expose(expected, self.seed)
    }

    /// Draws the counts for some rows `[y, x]` of an image that has `rows_in_all` rows. The first
    /// of the given rows is row `first_row` of the image.
    ///
    /// # Errors
    /// [`DetectorError::NonFinite`] for NaN and infinities. [`DetectorError::Rows`] for rows that
    /// are not in the image. [`DetectorError::Data`] if `rows_in_all` or the number of columns is
    /// 0. Otherwise the errors of [`apply`](Self::apply).
    pub fn apply_to_rows<T: Real>(
        &self,
        rows_in_all: usize,
        first_row: usize,
        expected: ArrayView2<'_, T>,
    ) -> Result<ExposedRows<T>, DetectorError> {
        let frame = FrameShape::new(expected.ncols(), rows_in_all)?;
        Self::detector()
            .exposer(frame, self.seed)?
            .expose_rows(first_row, expected)
    }

    fn detector() -> Detector {
        Detector::new(DetectorParams {
            photon_noise: true,
            ..DetectorParams::default()
        })
        .expect("these parameters are valid")
    }
}

/// A detector prepared for a frame and a seed.
///
/// Rows may be exposed in any order and in bands of any height. The rows of a band have the counts
/// that they have when the whole image is exposed.
///
/// ```
/// use psf_detector::{Detector, DetectorParams};
/// use ndarray::{Array2, s};
/// use psf_types::{FrameShape, Image};
/// let params = DetectorParams { photon_noise: true, sky_e: 9.0, ..DetectorParams::default() };
/// let ccd = Detector::new(params)?;
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
    /// Expected dark charge of every pixel in electrons.
    dark_e: f64,
    /// Additional dark charge of a hot pixel in electrons.
    hot_dark_e: f64,
    /// The flag of each column: 0 or [`PixelFlags::BAD_COLUMN`].
    columns: Vec<u8>,
    mask: Option<&'a BadPixelMask>,
    /// Photons `[y, x]` of sources that were drawn one by one.
    photons: Option<ArrayView2<'a, i32>>,
}

/// Rows of an exposure.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ExposedRows<T> {
    /// Counts `[y, x]` in the detector's unit.
    pub counts: Array2<T>,
    /// Sums of [`PixelFlags`], `[y, x]`.
    pub flags: Array2<u8>,
    /// The report about these rows.
    pub report: ExposureReport,
}

impl<'a> Exposer<'a> {
    pub(crate) fn new(detector: &'a Detector, frame: FrameShape, seed: u64) -> Result<Self, DetectorError> {
        let params = detector.params();
        Ok(Self {
            detector,
            frame,
            seed,
            sky: FrameSky::new(params, frame)?,
            dark_e: detector.dark_e(),
            hot_dark_e: params.bad_pixels.hot_dark_e_per_s * params.exposure_s.unwrap_or(0.0),
            columns: bad_columns(params, frame.nx()),
            mask: None,
            photons: None,
        })
    }

    /// Adds photons `[y, x]` that were drawn one by one, [`Detector::photons_per_flux`] for a flux of 1 on average.
    /// Each is detected with the probability that the pixel's response gives, so the electrons of a source are
    /// Poisson distributed about its flux times `electrons_per_flux` times the response, as those of light in the
    /// image. Later steps treat both in the same way.
    ///
    /// # Errors
    /// [`DetectorError::Rows`] or [`DetectorError::RowWidth`] for photons whose shape differs from the frame, and
    /// [`DetectorError::Needs`] for a detector without photon noise.
    pub fn with_photons(self, photons: ArrayView2<'a, i32>) -> Result<Self, DetectorError> {
        self.check_rows(0, photons)?;
        if photons.nrows() != self.frame.ny() {
            return Err(DetectorError::Rows {
                rows: 0..photons.nrows(),
                frame: self.frame,
            });
        }
        self.detector.check_photon_noise()?;
        Ok(Self {
            photons: Some(photons),
            ..self
        })
    }

    /// Adds the bad pixels of a mask to the bad pixels that the detector draws at random. A second
    /// mask replaces the first.
    ///
    /// # Errors
    /// [`DetectorError::MaskShape`], and [`DetectorError::Needs`] for hot pixels without
    /// `bad_pixels.hot_dark_e_per_s`.
    pub fn with_mask(self, mask: &'a BadPixelMask) -> Result<Self, DetectorError> {
        if mask.shape() != self.frame {
            return Err(DetectorError::MaskShape {
                mask: mask.shape(),
                frame: self.frame,
            });
        }
        if mask.has_hot() && self.detector.params().bad_pixels.hot_dark_e_per_s == 0.0 {
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
    /// The errors of [`Detector::expose`], without [`DetectorError::NegativeSky`].
    /// [`DetectorError::Rows`] or [`DetectorError::RowWidth`] for an image whose shape differs from
    /// the frame.
    pub fn expose<T: Real>(&self, light: &Image<T>) -> Result<Exposure<T>, DetectorError> {
        if light.shape().ny() != self.frame.ny() {
            return Err(DetectorError::Rows {
                rows: 0..light.shape().ny(),
                frame: self.frame,
            });
        }
        Exposure::of_rows(self.expose_rows(0, light.pixels())?)
    }

    /// Exposes a whole image without light, in parallel: only [photons](Self::with_photons), sky and dark charge.
    ///
    /// # Errors
    /// The errors of [`expose`](Self::expose).
    pub fn expose_photons<T: Real>(&self) -> Result<Exposure<T>, DetectorError> {
        let dark = |_| None::<ArrayView1<'_, T>>;
        Exposure::of_rows(self.expose_each_row((0, self.frame.ny()), dark)?)
    }

    /// Exposes rows `[y, x]` in parallel. The first of these rows is row `first_row` of the frame.
    ///
    /// # Errors
    /// The errors of [`Detector::expose`], without [`DetectorError::NegativeSky`].
    /// [`DetectorError::NonFinite`] also for NaN and infinities in the rows.
    /// [`DetectorError::Rows`] and [`DetectorError::RowWidth`] for rows that do not fit the frame.
    /// If several pixels are invalid, the error names the first.
    pub fn expose_rows<T: Real>(
        &self,
        first_row: usize,
        light: ArrayView2<'_, T>,
    ) -> Result<ExposedRows<T>, DetectorError> {
        self.check_rows(first_row, light)?;
        self.expose_each_row((first_row, light.nrows()), |k| Some(light.row(k)))
    }

    /// Exposes so many rows from a row of the frame on. `light` gives the light of a row, counted from the first of
    /// them, or None if the row has no light.
    fn expose_each_row<'l, T: Real>(
        &self,
        (first_row, rows): (usize, usize),
        light: impl Fn(usize) -> Option<ArrayView1<'l, T>> + Sync,
    ) -> Result<ExposedRows<T>, DetectorError> {
        let nx = self.frame.nx();
        let mut counts = Array2::zeros((rows, nx));
        let mut flags = Array2::zeros((rows, nx));
        let tallies: Vec<Result<ExposureReport, DetectorError>> = as_rows(&mut counts, nx)
            .zip(as_rows(&mut flags, nx))
            .enumerate()
            .map_init(Vec::new, |values, (k, (counts, flags))| {
                self.expose_row(first_row + k, light(k), values, counts, flags)
            })
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

    /// Computes rows of the noise-free image ([`Detector::truth`]).
    ///
    /// # Errors
    /// The errors of [`expose_rows`](Self::expose_rows).
    pub fn truth_rows<T: Real>(
        &self,
        first_row: usize,
        light: ArrayView2<'_, T>,
    ) -> Result<Array2<T>, DetectorError> {
        self.check_rows(first_row, light)?;
        let mut truth = Array2::zeros(light.dim());
        let done: Vec<Result<(), DetectorError>> = as_rows(&mut truth, self.frame.nx())
            .enumerate()
            .map_init(Vec::new, |electrons, (k, truth)| {
                let row = first_row + k;
                self.collect(row, Some(light.row(k)), electrons)?;
                for value in electrons.iter_mut() {
                    *value += self.dark_e;
                }
                self.detector.amplify(electrons);
                store(row, electrons, truth)
            })
            .collect();
        done.into_iter().collect::<Result<(), _>>()?;
        Ok(truth)
    }

    /// Applies the whole chain to a row. Steps that are off do not read the row, and no flag is read or written
    /// where none can be set.
    fn expose_row<T: Real>(
        &self,
        row: usize,
        light: Option<ArrayView1<'_, T>>,
        values: &mut Vec<f64>,
        counts: &mut [T],
        flags: &mut [u8],
    ) -> Result<ExposureReport, DetectorError> {
        let (detector, params) = (self.detector, self.detector.params());
        let mut report = self.report();
        self.collect(row, light, values)?;
        if params.response_rms > 0.0 {
            apply_response(params.pattern_seed, row, params.response_rms, values);
        }
        for value in values.iter_mut() {
            *value += self.dark_e;
        }
        let may_be_bad = self.mark(row, flags);
        if may_be_bad {
            for (value, flag) in values.iter_mut().zip(&*flags) {
                if flag & PixelFlags::HOT != 0 {
                    *value += self.hot_dark_e;
                }
                if flag & PixelFlags::NO_CHARGE != 0 {
                    *value = 0.0;
                }
            }
        }
        report.count_expected(values);
        if params.photon_noise {
            add_photon_noise(self.seed, row, values);
        }
        if let Some(photons) = self.photons {
            let mut detected = CowArray::from(photons.row(row));
            if params.response_rms > 0.0 {
                let seeds = (params.pattern_seed, self.seed);
                thin_by_response(seeds, row, params.response_rms, detected.iter_mut());
            }
            for (value, count) in values.iter_mut().zip(&detected) {
                *value += f64::from(*count);
            }
            if may_be_bad {
                for (value, flag) in values.iter_mut().zip(&*flags) {
                    if flag & PixelFlags::NO_CHARGE != 0 {
                        *value = 0.0;
                    }
                }
            }
        }
        if let Some(full_well_e) = params.full_well_e {
            clip(full_well_e, values, flags);
        }
        if params.read_noise_e > 0.0 {
            add_read_noise(self.seed, row, params.read_noise_e, values);
        }
        detector.amplify(values);
        if let Some(highest) = detector.highest_count() {
            report.below_zero_pixels += convert(highest, values, flags);
        }
        if may_be_bad || detector.saturation().is_some() {
            report.count_flags(flags);
        }
        store(row, values, counts)?;
        Ok(report)
    }

    /// Computes the expected electrons from light and sky in a row of pixels with equal response, in place of what
    /// `electrons` holds.
    fn collect<T: Real>(
        &self,
        row: usize,
        light: Option<ArrayView1<'_, T>>,
        electrons: &mut Vec<f64>,
    ) -> Result<(), DetectorError> {
        let per_flux = self.detector.params().electrons_per_flux;
        electrons.clear();
        match light {
            Some(light) => electrons.extend(light.iter().map(|flux| per_flux * flux.as_f64())),
            None => electrons.resize(self.frame.nx(), 0.0),
        }
        self.sky.add_to_row(row, electrons);
        match first_not_finite(electrons) {
            None => Ok(()),
            Some(x) => Err(DetectorError::NonFinite {
                index: [row, x],
                value: electrons[x],
            }),
        }
    }

    /// Flags the bad pixels of a row, whose flags are 0. Returns whether there may be any.
    fn mark(&self, row: usize, flags: &mut [u8]) -> bool {
        let bad = self.detector.params().bad_pixels;
        if bad.bad_column_fraction > 0.0 {
            flags.copy_from_slice(&self.columns);
        }
        mark_bad_pixels(self.detector.params(), row, flags);
        if let Some(mask) = self.mask {
            for (flag, more) in flags.iter_mut().zip(mask.flags().row(row)) {
                *flag |= more;
            }
        }
        self.mask.is_some() || bad.bad_column_fraction + bad.dead_fraction + bad.hot_fraction > 0.0
    }

    /// A report that counts no pixels yet.
    fn report(&self) -> ExposureReport {
        ExposureReport {
            seed: self.seed,
            mean_sky_e: self.detector.params().sky_e,
            dark_e: self.dark_e,
            ..ExposureReport::default()
        }
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

/// The rows of a newly made array, for parallel iteration.
fn as_rows<T: Send>(array: &mut Array2<T>, nx: usize) -> rayon::slice::ChunksMut<'_, T> {
    let values = array.as_slice_mut().expect("a new array is contiguous");
    values.par_chunks_mut(nx)
}

/// Converts values to the type of the image and stores them.
fn store<T: Real>(row: usize, values: &[f64], out: &mut [T]) -> Result<(), DetectorError> {
    for (value, out) in values.iter().zip(&mut *out) {
        *out = T::nearest(*value);
    }
    match first_not_finite(out) {
        None => Ok(()),
        Some(x) => Err(DetectorError::TooLarge {
            index: [row, x],
            value: values[x],
            precision: T::NAME,
        }),
    }
}

/// The place of the first number of a row that is not finite. Reads the whole row, which is faster than to stop.
fn first_not_finite<T: Real>(row: &[T]) -> Option<usize> {
    let all_finite = row.iter().fold(true, |finite, v| finite & v.is_finite());
    if all_finite {
        return None;
    }
    row.iter().position(|v| !v.is_finite())
}

/// The counts of an exposure, with flags and a report.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure<T = f32> {
    counts: Image<T>,
    flags: Array2<u8>,
    report: ExposureReport,
}

impl<T: Real> Exposure<T> {
    fn of_rows(rows: ExposedRows<T>) -> Result<Self, DetectorError> {
        Ok(Self {
            counts: Image::new(rows.counts)?,
            flags: rows.flags,
            report: rows.report,
        })
    }

    /// The counts, in the unit of [`Detector::unit`]. Digitised counts are whole numbers.
    pub fn counts(&self) -> &Image<T> {
        &self.counts
    }

    /// Sums of [`PixelFlags`], `[y, x]`.
    pub fn flags(&self) -> ArrayView2<'_, u8> {
        self.flags.view()
    }

    /// The report about the exposure.
    pub fn report(&self) -> &ExposureReport {
        &self.report
    }

    /// Returns the counts without a copy.
    pub fn into_counts(self) -> Image<T> {
        self.counts
    }

    /// Returns the counts and the flags without a copy.
    pub fn into_counts_and_flags(self) -> (Image<T>, Array2<u8>) {
        (self.counts, self.flags)
    }
}

/// Statistics of an exposure, or of some rows of it: numbers of pixels and levels.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct ExposureReport {
    /// The seed of the noise.
    pub seed: u64,
    /// Number of exposed pixels.
    pub pixels: usize,
    /// Pixels at their full well or at the upper end of the converter.
    pub saturated_pixels: usize,
    /// Pixels that the converter set to 0 because their count was negative.
    pub below_zero_pixels: usize,
    /// Pixels whose expected charge was negative. It keeps its sign in the exposure.
    pub negative_pixels: usize,
    /// The lowest charge expected in any pixel, in electrons. It may be negative. It is 0 if there
    /// are no pixels.
    pub lowest_expected_e: f64,
    /// Pixels with any flag of [`PixelFlags::BAD`]. A pixel with several flags is counted once.
    pub bad_pixels: usize,
    /// Dead pixels.
    pub dead_pixels: usize,
    /// Hot pixels.
    pub hot_pixels: usize,
    /// Pixels of bad columns.
    pub bad_column_pixels: usize,
    /// Mean sky over the frame in electrons per pixel.
    pub mean_sky_e: f64,
    /// Dark charge of a good pixel in electrons.
    pub dark_e: f64,
}

impl ExposureReport {
    /// Adds the statistics of other rows of the same exposure.
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

    /// Counts the pixels of a row with their expected charges.
    pub(crate) fn count_expected(&mut self, electrons: &[f64]) {
        // Several minima at a time, one for each place in a chunk.
        const TOGETHER: usize = 8;
        let mut lowest = [f64::INFINITY; TOGETHER];
        for chunk in electrons.chunks(TOGETHER) {
            for (lowest, &value) in lowest.iter_mut().zip(chunk) {
                *lowest = if value < *lowest { value } else { *lowest };
            }
        }
        let lowest = lowest.into_iter().fold(f64::INFINITY, f64::min);
        self.add(&Self {
            pixels: electrons.len(),
            lowest_expected_e: lowest,
            negative_pixels: if lowest < 0.0 {
                electrons.iter().filter(|value| **value < 0.0).count()
            } else {
                0
            },
            ..Self::default()
        });
    }

    /// Counts the flags of pixels that `count_expected` has already counted.
    pub(crate) fn count_flags(&mut self, flags: &[u8]) {
        let with = |bits: u8| flags.iter().filter(|&flag| flag & bits != 0).count();
        self.saturated_pixels += with(PixelFlags::SATURATED);
        self.bad_pixels += with(PixelFlags::BAD);
        self.dead_pixels += with(PixelFlags::DEAD);
        self.hot_pixels += with(PixelFlags::HOT);
        self.bad_column_pixels += with(PixelFlags::BAD_COLUMN);
    }
}
