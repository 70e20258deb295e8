//! A frame, and what is measured of single sources in it.

use ndarray::Array2;
use psf_types::FrameShape;
use rayon::prelude::*;

use crate::gaussian::{FitWindow, Gaussian};
use crate::neighbours::Neighbours;
use crate::ownership::Ownership;
use crate::registration::FineGrid;
use crate::selection::Candidate;
use crate::star::{Star, StarPixel};
use crate::{Background, Camera, Detection, Peak, Rejection, Rejections, Saturation, StarError};

/// The aperture's radius: in FWHM, and at least so many pixels.
const APERTURE_FWHM: f64 = 1.25;
const APERTURE_PX: f64 = 2.0;
/// Gaussian fits look this far, in FWHM.
const FIT_FWHM: f64 = 1.5;
/// Two fits closer than this are of one source, pixels.
const SAME_PX: f64 = 1.0;

/// The radius of the aperture for stars of this width.
pub(crate) fn aperture_px(fwhm_px: f64) -> f64 {
    (APERTURE_FWHM * fwhm_px).max(APERTURE_PX)
}

/// A frame with its background.
pub(crate) struct FrameView {
    pub(crate) pixels: Array2<f64>,
    pub(crate) excess: Array2<f64>,
    pub(crate) background: Background,
    pub(crate) saturation: Saturation,
    pub(crate) camera: Camera,
}

impl FrameView {
    pub(crate) fn shape(&self) -> FrameShape {
        let (ny, nx) = self.pixels.dim();
        FrameShape::new(nx, ny).expect("the shape of an image")
    }

    /// Pixels `(column, row)` whose centres lie within `radius`.
    pub(crate) fn disc(&self, x: f64, y: f64, radius: f64) -> impl Iterator<Item = (usize, usize)> + use<> {
        let (ny, nx) = self.pixels.dim();
        let range = |v: f64, n: usize| {
            let first = (v - radius).ceil().max(0.0) as usize;
            let end = ((v + radius).floor() + 1.0).clamp(0.0, n as f64) as usize;
            first..end.max(first)
        };
        let columns = range(x, nx);
        range(y, ny).flat_map(move |row| {
            columns
                .clone()
                .filter(move |&column| (column as f64 - x).hypot(row as f64 - y) <= radius)
                .map(move |column| (column, row))
        })
    }

    /// The sources, the most significant first.
    pub(crate) fn peaks(&self, detection: &Detection) -> Result<Vec<Peak>, StarError> {
        let peaks = detection.find(self.pixels.view(), &self.background);
        if peaks.is_empty() {
            return Err(StarError::NoSources {
                threshold: detection.threshold(),
            });
        }
        Ok(peaks)
    }

    pub(crate) fn measured(&self, peaks: &[Peak], fwhm_px: f64) -> Vec<Candidate> {
        let mut candidates: Vec<Candidate> = peaks.par_iter().map(|p| self.measure(p, fwhm_px)).collect();
        // A fit that slid to a brighter neighbour is not the peak's own.
        let neighbours = Neighbours::new(candidates.iter().map(|c| (c.x, c.y)));
        let slid: Vec<usize> = (0..candidates.len())
            .filter(|&k| {
                let c = &candidates[k];
                // The more significant ones come first.
                c.gaussian.is_some() && neighbours.within(c.x, c.y, SAME_PX).any(|(j, _)| j < k)
            })
            .collect();
        for k in slid {
            let at = self.light_centre(&peaks[k]);
            let candidate = &mut candidates[k];
            candidate.gaussian = None;
            (candidate.x, candidate.y) = at;
        }
        candidates
    }

    fn measure(&self, peak: &Peak, fwhm_px: f64) -> Candidate {
        let window = FitWindow {
            column: peak.column,
            row: peak.row,
            reach: ((FIT_FWHM * fwhm_px).ceil() as usize).max(3),
        };
        let gaussian = Gaussian::fit(self.excess.view(), window, fwhm_px);
        let (x, y) = gaussian.map_or_else(|| self.light_centre(peak), |g| (g.x, g.y));
        let radius = aperture_px(fwhm_px);
        let (mut flux, mut count) = (0.0, 0.0);
        for (column, row) in self.disc(x, y, radius) {
            flux += self.excess[[row, column]];
            count += 1.0;
        }
        let core = self.disc(peak.column as f64, peak.row as f64, fwhm_px.max(1.5));
        let brightest = core
            .map(|(column, row)| self.pixels[[row, column]])
            .fold(f64::NEG_INFINITY, f64::max);
        let mut rejected = Rejections::default();
        if self.saturation.reached_by(brightest) {
            rejected.insert(Rejection::Saturated);
        }
        Candidate {
            x,
            y,
            flux,
            snr: self
                .camera
                .snr(flux, count, self.background.rms()[[peak.row, peak.column]]),
            significance: peak.significance,
            peak: brightest,
            pixel_count: peak.pixel_count,
            gaussian,
            rejected,
        }
    }

    /// The centre of the light in 3 x 3 pixels.
    fn light_centre(&self, peak: &Peak) -> (f64, f64) {
        let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
        for (column, row) in self.disc(peak.column as f64, peak.row as f64, 1.5) {
            let value = self.excess[[row, column]].max(0.0);
            sum += value;
            x += value * column as f64;
            y += value * row as f64;
        }
        if sum > 0.0 {
            (x / sum, y / sum)
        } else {
            (peak.column as f64, peak.row as f64)
        }
    }

    pub(crate) fn star(
        &self,
        index: usize,
        candidate: &Candidate,
        ownership: &Ownership,
        grid: FineGrid,
    ) -> Star {
        let (x, y) = (candidate.x, candidate.y);
        let (ny, nx) = self.pixels.dim();
        let range = |v: f64, n: usize| {
            let (centre, reach) = (v.round() as i64, grid.reach as i64 + 1);
            (centre - reach).max(0) as usize..((centre + reach + 1).max(0) as usize).min(n)
        };
        let columns = range(x, nx);
        let pixels = range(y, ny)
            .flat_map(|row| columns.clone().map(move |column| (column, row)))
            .map(|(column, row)| {
                let (px, py) = (column as f64, row as f64);
                let usable = !self.saturation.reached_by(self.pixels[[row, column]])
                    && ownership.allows(index, candidate.flux, px, py);
                StarPixel {
                    x: px,
                    y: py,
                    value: self.excess[[row, column]],
                    rms: self.background.rms()[[row, column]],
                    trust: f64::from(u8::from(usable)),
                }
            })
            .collect();
        Star {
            source: index,
            x,
            y,
            flux: candidate.flux,
            offset: 0.0,
            pixels,
        }
    }
}
