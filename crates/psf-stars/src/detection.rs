//! Detection of sources.

use ndarray::{Array2, ArrayView2, Zip};
use psf_types::maths::FWHM_PER_SIGMA;

use crate::error::{at_least, check, checked_setters};
use crate::{Background, StarError};

/// Finds sources as separate peaks of the matched-filtered significance.
///
/// The significance of a point source at a pixel is `S = sum k d / (sigma sqrt(sum k^2))`. Here `d`
/// is the frame minus its background, `sigma` the noise of the background, and `k` a Gaussian
/// kernel. This is the likelihood ratio test for a source of that shape (Stetson 1987, PASP 99,
/// 191), without the subtraction of a local mean, because the background is already subtracted.
///
/// Pixels with `S >= threshold` are joined to their eight neighbours from the brightest down. Where
/// two peaks meet at a saddle, the lower one is a separate source if it rises far enough above the
/// saddle: by [`with_prominence`](Self::with_prominence) (default 3 sigma) and by 0.5 % of the
/// higher peak. Otherwise it belongs to the higher one. Crowded stars are thus separated, and noise
/// on the flanks of a bright object is not detected as stars.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    threshold: f64,
    kernel_fwhm_px: f64,
    prominence: f64,
}

impl Detection {
    /// Default threshold in sigma.
    pub const DEFAULT_THRESHOLD: f64 = 5.0;
    /// Default FWHM of the kernel in pixels.
    pub const DEFAULT_KERNEL_FWHM_PX: f64 = 2.0;
    const DEFAULT_PROMINENCE: f64 = 3.0;

    /// Detection of sources above `threshold` sigma.
    ///
    /// # Errors
    /// [`StarError::Setting`] unless it is at least 1.
    pub fn new(threshold: f64) -> Result<Self, StarError> {
        check(
            at_least(1.0, threshold),
            "the detection threshold",
            "a number of sigma, at least 1",
            threshold,
        )?;
        Ok(Self {
            threshold,
            ..Self::default()
        })
    }

    checked_setters! {
        /// Sets the FWHM of the kernel, which should be the FWHM of the stars.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is between 0.5 and 50 pixels.
        with_kernel_fwhm_px(kernel_fwhm_px: f64) => kernel_fwhm_px, if (0.5..=50.0).contains(&kernel_fwhm_px),
            else "the FWHM of the detection kernel", "between 0.5 and 50 pixels";
        /// Sets the number of sigma by which a peak must rise above the saddle to a higher peak.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is 0 or above.
        with_prominence(prominence: f64) => prominence, if at_least(0.0, prominence),
            else "the prominence of a peak", "a number of sigma, 0 or above";
    }

    /// The threshold in sigma.
    pub fn threshold(&self) -> f64 {
        self.threshold
    }

    /// The FWHM of the kernel in pixels.
    pub fn kernel_fwhm_px(&self) -> f64 {
        self.kernel_fwhm_px
    }

    /// Finds the peaks in a frame `[y, x]`, the most significant first. NaN pixels count as
    /// background.
    ///
    /// # Panics
    /// When the background and the frame have different shapes.
    pub fn find(&self, frame: ArrayView2<'_, f64>, background: &Background) -> Vec<Peak> {
        let significance = self.significance(frame, background);
        separate_peaks(&significance, self.threshold, self.prominence)
    }

    fn significance(&self, frame: ArrayView2<'_, f64>, background: &Background) -> Array2<f64> {
        assert_eq!(
            frame.dim(),
            background.level().dim(),
            "the background must have the shape of the frame"
        );
        let sigma = self.kernel_fwhm_px / FWHM_PER_SIGMA;
        let reach = (REACH * sigma).ceil() as usize;
        let kernel: Vec<f64> = (0..=2 * reach)
            .map(|i| (-0.5 * ((i as f64 - reach as f64) / sigma).powi(2)).exp())
            .collect();
        let (ny, nx) = frame.dim();
        let excess = background.subtracted_from(frame) / background.rms();
        let along_x = filtered_rows(&excess, &kernel);
        let both = filtered_rows(
            &along_x.reversed_axes().as_standard_layout().into_owned(),
            &kernel,
        );
        // Near the edges only a part of the kernel overlaps the frame.
        let power = |n: usize| -> Vec<f64> {
            (0..n)
                .map(|i| {
                    kernel
                        .iter()
                        .enumerate()
                        .filter(|(k, _)| (reach..reach + n).contains(&(i + k)))
                        .map(|(_, w)| w * w)
                        .sum()
                })
                .collect()
        };
        let (power_x, power_y) = (power(nx), power(ny));
        Array2::from_shape_fn((ny, nx), |(y, x)| both[[x, y]] / (power_x[x] * power_y[y]).sqrt())
    }
}

impl Default for Detection {
    fn default() -> Self {
        Self {
            threshold: Self::DEFAULT_THRESHOLD,
            kernel_fwhm_px: Self::DEFAULT_KERNEL_FWHM_PX,
            prominence: Self::DEFAULT_PROMINENCE,
        }
    }
}

/// A peak of the significance.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Peak {
    /// Column of its highest pixel.
    pub column: usize,
    /// Row of its highest pixel.
    pub row: usize,
    /// Its significance in sigma.
    pub significance: f64,
    /// Pixels above the threshold that belong to it and to no other peak.
    pub pixel_count: usize,
}

/// The kernel is cut off at this number of sigma.
const REACH: f64 = 3.0;
/// A peak must also rise above its saddle by this fraction of the higher peak (like SExtractor's
/// DEBLEND_MINCONT).
const CONTRAST: f64 = 0.005;

/// Convolves each row with a symmetric kernel. Values beyond the ends are 0.
fn filtered_rows(values: &Array2<f64>, kernel: &[f64]) -> Array2<f64> {
    let (rows, columns) = values.dim();
    let reach = kernel.len() / 2;
    let mut result = Array2::zeros((rows, columns));
    Zip::indexed(result.rows_mut()).par_for_each(|j, line| {
        let from = values.row(j);
        for (i, sum) in line.into_iter().enumerate() {
            let first = i.saturating_sub(reach);
            let end = (i + reach + 1).min(columns);
            *sum = (first..end).map(|k| kernel[k + reach - i] * from[k]).sum();
        }
    });
    result
}

const NONE: u32 = u32::MAX;

/// A hill: the pixels joined to one peak so far.
struct Hill {
    peak: usize,
    pixels: usize,
    /// The hill into which this one was merged, or this hill itself.
    parent: usize,
}

fn root(hills: &mut [Hill], mut hill: usize) -> usize {
    while hills[hill].parent != hill {
        hills[hill].parent = hills[hills[hill].parent].parent;
        hill = hills[hill].parent;
    }
    hill
}

/// Finds the separate peaks of the map, by flooding it from its highest pixel down.
fn separate_peaks(map: &Array2<f64>, threshold: f64, prominence: f64) -> Vec<Peak> {
    let (ny, nx) = map.dim();
    let values = map.as_slice().expect("row-major");
    let mut order: Vec<usize> = (0..values.len()).filter(|&p| values[p] >= threshold).collect();
    // Equal values are ordered by pixel, so that the result is reproducible.
    order.sort_by(|&a, &b| values[b].total_cmp(&values[a]).then(a.cmp(&b)));
    let mut hill_of = vec![NONE; values.len()];
    let mut hills: Vec<Hill> = Vec::new();
    let mut found = Vec::new();
    let as_peak = |hill: &Hill| Peak {
        column: hill.peak % nx,
        row: hill.peak / nx,
        significance: values[hill.peak],
        pixel_count: hill.pixels,
    };
    for pixel in order {
        let (x, y) = (pixel % nx, pixel / nx);
        let mut about: Vec<usize> = Vec::with_capacity(8);
        for j in y.saturating_sub(1)..(y + 2).min(ny) {
            for i in x.saturating_sub(1)..(x + 2).min(nx) {
                let hill = hill_of[j * nx + i];
                if hill != NONE {
                    let hill = root(&mut hills, hill as usize);
                    if !about.contains(&hill) {
                        about.push(hill);
                    }
                }
            }
        }
        // Hills are numbered from the highest peak down.
        about.sort_unstable();
        let Some((&highest, lower)) = about.split_first() else {
            hill_of[pixel] = hills.len() as u32;
            hills.push(Hill {
                peak: pixel,
                pixels: 1,
                parent: hills.len(),
            });
            continue;
        };
        for &low in lower {
            let rise = values[hills[low].peak] - values[pixel];
            if rise >= prominence && rise >= CONTRAST * values[hills[highest].peak] {
                found.push(as_peak(&hills[low]));
            } else {
                hills[highest].pixels += hills[low].pixels;
            }
            hills[low].parent = highest;
        }
        hills[highest].pixels += 1;
        hill_of[pixel] = highest as u32;
    }
    found.extend(
        hills
            .iter()
            .enumerate()
            .filter(|(k, hill)| hill.parent == *k)
            .map(|(_, hill)| as_peak(hill)),
    );
    found.sort_by(|a, b| {
        b.significance
            .total_cmp(&a.significance)
            .then((a.row, a.column).cmp(&(b.row, b.column)))
    });
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hills(peaks: &[(f64, f64, f64)]) -> Array2<f64> {
        Array2::from_shape_fn((20, 40), |(y, x)| {
            peaks
                .iter()
                .map(|(px, py, height)| {
                    height * (-((x as f64 - px).powi(2) + (y as f64 - py).powi(2)) / 8.0).exp()
                })
                .sum()
        })
    }

    #[test]
    fn peaks_are_separate_where_they_rise_above_their_saddle() {
        let map = hills(&[(10.0, 10.0, 50.0), (18.0, 10.0, 30.0), (33.0, 5.0, 20.0)]);
        let found = separate_peaks(&map, 5.0, 3.0);
        let at: Vec<_> = found.iter().map(|p| (p.column, p.row)).collect();
        assert_eq!(at, [(10, 10), (18, 10), (33, 5)]);
        // A ripple on the flank is not a peak of its own.
        let rippled = hills(&[(10.0, 10.0, 50.0)]) + 1.5 * hills(&[(14.0, 10.0, 1.0)]).mapv(f64::round);
        assert_eq!(separate_peaks(&rippled, 5.0, 3.0).len(), 1);
        // A maximum below the threshold is not a peak either.
        assert_eq!(separate_peaks(&map, 25.0, 3.0).len(), 2);
    }

    #[test]
    fn a_plateau_is_one_peak_with_all_its_pixels() {
        let mut map = Array2::zeros((9, 9));
        map.slice_mut(ndarray::s![3..6, 3..6]).fill(10.0);
        let found = separate_peaks(&map, 5.0, 3.0);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].pixel_count, 9);
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        assert!(Detection::new(0.5).is_err() && Detection::new(f64::NAN).is_err());
        assert!(Detection::default().with_kernel_fwhm_px(0.1).is_err());
        assert!(Detection::default().with_prominence(-1.0).is_err());
    }
}
