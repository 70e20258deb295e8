//! A frame, the measurement of single sources in it, and the assignment of pixels to sources.

use ndarray::Array2;
use psf_types::FrameShape;
use rayon::prelude::*;

use crate::background::median;
use crate::registration::FineGrid;
use crate::source::Gaussian;
use crate::{Background, Camera, Detection, Peak, Rejection, Rejections, Saturation, Source, StarError};

/// The radius of the aperture for the signal-to-noise ratio, in FWHM.
const APERTURE_FWHM: f64 = 1.25;
/// The smallest radius of this aperture in pixels.
const APERTURE_PX: f64 = 2.0;
/// A Gaussian fit uses the pixels within this distance of the peak along each axis, in FWHM.
const FIT_FWHM: f64 = 1.5;
/// The outer radius of the ring around a star in which the background is measured, in units of the
/// inner radius, which is half a stamp.
const RING: f64 = 2.0;
/// If fewer pixels of the ring are free of other sources, the background map is better than their
/// median.
const LEAST_RING: usize = 40;
/// Two fits count as fits of one source if they are closer than this distance in pixels.
const SAME_SOURCE_PX: f64 = 1.0;

/// The radius of the aperture for stars of the given FWHM.
pub(crate) fn aperture_px(fwhm_px: f64) -> f64 {
    (APERTURE_FWHM * fwhm_px).max(APERTURE_PX)
}

/// A frame with its background.
pub(crate) struct FrameView {
    /// The values of the frame, NaN in masked pixels.
    pub(crate) pixels: Array2<f64>,
    /// The values above the background, 0 in masked pixels.
    pub(crate) excess: Array2<f64>,
    pub(crate) background: Background,
    pub(crate) saturation: Saturation,
    pub(crate) camera: Camera,
}

impl FrameView {
    pub(crate) fn shape(&self) -> FrameShape {
        let (ny, nx) = self.pixels.dim();
        FrameShape::new(nx, ny).expect("an image has a valid shape")
    }

    pub(crate) fn is_masked(&self, column: usize, row: usize) -> bool {
        self.pixels[[row, column]].is_nan()
    }

    /// The pixels `(column, row)` whose centres lie within `radius` of (`x`, `y`).
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

    /// Finds the peaks of the sources, the most significant first.
    pub(crate) fn peaks(&self, detection: &Detection) -> Result<Vec<Peak>, StarError> {
        let peaks = detection.find(self.pixels.view(), &self.background);
        if peaks.is_empty() {
            return Err(StarError::NoSamples(format!(
                "no source exceeds {} sigma of the background noise: lower the threshold",
                detection.threshold()
            )));
        }
        Ok(peaks)
    }

    /// Measures the source of each peak. [`Self::complete`] fills in the background and the
    /// distance to the nearest other source.
    pub(crate) fn measured(&self, peaks: &[Peak], fwhm_px: f64) -> Vec<Source> {
        let mut sources: Vec<Source> = peaks.par_iter().map(|p| self.measure(p, fwhm_px)).collect();
        // A fit that moved to a brighter neighbour does not measure the peak's own source.
        let neighbours = Neighbours::of(&sources);
        let slid: Vec<usize> = (0..sources.len())
            .filter(|&k| {
                let s = &sources[k];
                // More significant sources come first.
                s.fwhm_px.is_some() && neighbours.within(s.x, s.y, SAME_SOURCE_PX).any(|(j, _)| j < k)
            })
            .collect();
        for k in slid {
            let source = &mut sources[k];
            (source.x, source.y) = self.light_centre(&peaks[k]);
            (source.fwhm_px, source.e1, source.e2) = (None, None, None);
        }
        sources
    }

    fn measure(&self, peak: &Peak, fwhm_px: f64) -> Source {
        let reach = ((FIT_FWHM * fwhm_px).ceil() as usize).max(3);
        let gaussian = Gaussian::fit(self.excess.view(), (peak.column, peak.row), reach, fwhm_px);
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
            .fold(f64::NAN, f64::max);
        let mut rejected = Rejections::default();
        if self.saturation.reached_by(brightest) {
            rejected.insert(Rejection::Saturated);
        }
        let mut fitted = self.disc(x, y, radius.max(reach as f64));
        if fitted.any(|(column, row)| self.is_masked(column, row)) {
            rejected.insert(Rejection::Masked);
        }
        let background_rms = self.background.rms()[[peak.row, peak.column]];
        Source {
            x,
            y,
            flux,
            snr: self.camera.snr(flux, count, background_rms),
            significance: peak.significance,
            peak: brightest,
            background: f64::NAN,
            background_rms,
            fwhm_px: gaussian.map(|g| g.fwhm_px),
            e1: gaussian.map(|g| g.e1),
            e2: gaussian.map(|g| g.e2),
            pixel_count: peak.pixel_count,
            nearest_px: None,
            sample: None,
            rejected,
        }
    }

    /// Fills in the missing values: each source's background and its distance to the nearest other
    /// source.
    pub(crate) fn complete(&self, sources: &mut [Source]) {
        let neighbours = Neighbours::of(sources);
        let (ny, nx) = self.pixels.dim();
        let pixel = |v: f64, n: usize| (v.round().max(0.0) as usize).min(n - 1);
        for (k, source) in sources.iter_mut().enumerate() {
            let at = [pixel(source.y, ny), pixel(source.x, nx)];
            (source.background, source.background_rms) =
                (self.background.level()[at], self.background.rms()[at]);
            let nearest = neighbours.nearest(source.x, source.y, |j| j != k);
            source.nearest_px = nearest.map(|(_, distance)| distance);
        }
    }

    /// The centre of the light in the 3 x 3 pixels around a peak.
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

    fn star(&self, index: usize, source: &Source, ownership: &Ownership, grid: FineGrid) -> Star {
        let (x, y) = (source.x, source.y);
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
                let usable = !self.is_masked(column, row)
                    && !self.saturation.reached_by(self.pixels[[row, column]])
                    && ownership.allows(index, source.flux, px, py);
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
            start: (x, y),
            x,
            y,
            flux: source.flux,
            offset: 0.0,
            pixels,
        }
    }

    /// The `chosen` sources as stars, with their pixels and the background around them.
    pub(crate) fn stars(
        &self,
        sources: &[Source],
        chosen: impl Fn(&Source) -> bool + Sync + Send,
        ownership: &Ownership,
        grid: FineGrid,
    ) -> Vec<Star> {
        let chosen = sources.par_iter().enumerate().filter(|(_, s)| chosen(s));
        let (mut stars, levels): (Vec<Star>, Vec<_>) = chosen
            .map(|(k, source)| {
                let level = self.level_around(k, source, ownership, grid);
                (self.star(k, source, ownership, grid), level)
            })
            .unzip();
        let of_ring = ring_part(&levels);
        for (star, (level, variance)) in stars.iter_mut().zip(levels) {
            star.offset = of_ring(level, variance);
        }
        stars
    }

    /// The background around a star minus the background map, and its variance. It is the median
    /// over a ring outside the star's stamp, from pixels that are free of other sources. It is
    /// unknown (0 with an infinite variance) if there are too few such pixels.
    ///
    /// Pixels of the stamp cannot give this level. They hold the wings of the star, and a level
    /// fitted to them would remove the wings from the PSF.
    fn level_around(
        &self,
        index: usize,
        source: &Source,
        ownership: &Ownership,
        grid: FineGrid,
    ) -> (f64, f64) {
        let (x, y, inner) = (source.x, source.y, grid.reach as f64);
        let free = |&(column, row): &(usize, usize)| {
            let (px, py) = (column as f64, row as f64);
            (px - x).hypot(py - y) > inner
                && !self.is_masked(column, row)
                && ownership.allows(index, 0.0, px, py)
        };
        let ring = self.disc(x, y, RING * inner).filter(free);
        let levels: Vec<f64> = ring.map(|(column, row)| self.excess[[row, column]]).collect();
        if levels.len() < LEAST_RING {
            return (0.0, f64::INFINITY);
        }
        let variance = MEDIAN_VARIANCE * source.background_rms.powi(2) / levels.len() as f64;
        (median(levels), variance)
    }
}

/// Returns a function that gives the most probable level around a star from the level of its ring and
/// the variance of this level. Both the ring and the background map have errors. Those of the map
/// follow from the rings of all stars: where the rings scatter by more than their noise, the map
/// misses structure of the background, and rings count more.
fn ring_part(rings: &[(f64, f64)]) -> impl Fn(f64, f64) -> f64 + use<> {
    let known = || rings.iter().filter(|ring| ring.1.is_finite());
    // The squared level minus its noise, for the typical star.
    let squares = known().map(|(level, variance)| level * level / variance);
    let typical = NORMAL_SQUARE_MEDIAN.recip() * median(squares);
    // NaN without rings.
    let of_map = (typical - 1.0).max(0.0) * median(known().map(|ring| ring.1));
    move |level, variance| {
        if variance.is_finite() && of_map > 0.0 {
            level * of_map / (of_map + variance)
        } else {
            0.0
        }
    }
}

/// The variance of the median of Gaussian values, times their number, in units of their variance.
const MEDIAN_VARIANCE: f64 = std::f64::consts::FRAC_PI_2;
/// The median of the square of a Gaussian value of variance 1.
const NORMAL_SQUARE_MEDIAN: f64 = 0.4549;

/// A pixel near a star.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StarPixel {
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// The value above the background.
    pub(crate) value: f64,
    /// The noise of the background.
    pub(crate) rms: f64,
    /// The factor on the pixel's weight: 0 if the pixel is masked, saturated or belongs to a
    /// neighbour, below 1 for outliers, else 1.
    pub(crate) trust: f64,
}

/// A star that becomes a sample unless it is rejected later.
#[derive(Debug, Clone)]
pub(crate) struct Star {
    /// Index of its source.
    pub(crate) source: usize,
    /// The position of its Gaussian fit.
    pub(crate) start: (f64, f64),
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) flux: f64,
    /// The background around it minus the background map, as far as the ring around it is trusted.
    pub(crate) offset: f64,
    pub(crate) pixels: Vec<StarPixel>,
}

/// Pixels within this distance of a source, in FWHM, are not used for its neighbours.
const OWN_FWHM: f64 = 1.5;
/// Neighbours with less than this fraction of a star's flux do not mask its pixels.
const NEGLIGIBLE_NEIGHBOUR: f64 = 0.01;

/// The assignment of pixels to sources.
#[derive(Debug)]
pub(crate) struct Ownership {
    neighbours: Neighbours,
    fluxes: Vec<f64>,
    radius: f64,
}

impl Ownership {
    pub(crate) fn new(sources: &[Source], fwhm_px: f64) -> Self {
        Self {
            neighbours: Neighbours::of(sources),
            fluxes: sources.iter().map(|s| s.flux).collect(),
            radius: OWN_FWHM * fwhm_px,
        }
    }

    /// Returns whether the pixel at (`x`, `y`) is free of the light of sources other than `source`.
    /// `flux` is the flux of `source`. Much fainter neighbours are ignored.
    pub(crate) fn allows(&self, source: usize, flux: f64, x: f64, y: f64) -> bool {
        !self
            .neighbours
            .within(x, y, self.radius)
            .any(|(j, _)| j != source && self.fluxes[j] > NEGLIGIBLE_NEIGHBOUR * flux)
    }
}

/// Points sorted by y, for searches within a radius.
#[derive(Debug)]
pub(crate) struct Neighbours {
    /// `(y, x, index)`.
    sorted: Vec<(f64, f64, usize)>,
}

impl Neighbours {
    pub(crate) fn new(points: impl Iterator<Item = (f64, f64)>) -> Self {
        let mut sorted: Vec<_> = points.enumerate().map(|(k, (x, y))| (y, x, k)).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.2.cmp(&b.2)));
        Self { sorted }
    }

    pub(crate) fn of(sources: &[Source]) -> Self {
        Self::new(sources.iter().map(|s| (s.x, s.y)))
    }

    /// Indices and distances of the points within `radius`. The order is arbitrary but
    /// reproducible.
    pub(crate) fn within(&self, x: f64, y: f64, radius: f64) -> impl Iterator<Item = (usize, f64)> + '_ {
        let first = self.sorted.partition_point(|p| p.0 < y - radius);
        self.sorted[first..]
            .iter()
            .take_while(move |p| p.0 <= y + radius)
            .map(move |p| (p.2, (p.1 - x).hypot(p.0 - y)))
            .filter(move |(_, distance)| *distance <= radius)
    }

    /// The nearest point for which `counts` holds, with its distance.
    pub(crate) fn nearest(&self, x: f64, y: f64, counts: impl Fn(usize) -> bool) -> Option<(usize, f64)> {
        let from = self.sorted.partition_point(|p| p.0 < y);
        let mut best: Option<(usize, f64)> = None;
        let mut look = |p: &(f64, f64, usize)| {
            let closer = best.is_none_or(|(_, d)| (p.0 - y).abs() <= d);
            let distance = (p.1 - x).hypot(p.0 - y);
            // If two points are equally far, the one with the lower index is chosen.
            if closer && counts(p.2) && best.is_none_or(|(k, d)| distance < d || (distance == d && p.2 < k)) {
                best = Some((p.2, distance));
            }
            closer
        };
        let (before, after) = self.sorted.split_at(from);
        after.iter().take_while(|p| look(p)).for_each(drop);
        before.iter().rev().take_while(|p| look(p)).for_each(drop);
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_count_as_far_as_they_scatter_by_more_than_noise() {
        // Levels with the quantiles of a normal distribution of standard deviation `scatter`.
        let rings = |scatter: f64| -> Vec<(f64, f64)> {
            let quantiles = [-1.64, -1.04, -0.67, -0.39, -0.13, 0.13, 0.39, 0.67, 1.04, 1.64];
            quantiles.iter().map(|q| (scatter * q, 1.0)).collect()
        };
        assert_eq!(ring_part(&rings(0.9))(2.0, 1.0), 0.0);
        let half = ring_part(&rings(2f64.sqrt()))(2.0, 1.0);
        assert!((half - 1.0).abs() < 0.1, "{half}");
        assert!(ring_part(&rings(30.0))(2.0, 1.0) > 1.99);
        // Without a ring.
        assert_eq!(ring_part(&rings(30.0))(0.0, f64::INFINITY), 0.0);
        assert_eq!(ring_part(&[])(0.0, f64::INFINITY), 0.0);
    }

    #[test]
    fn neighbours_agree_with_a_full_search() {
        let points: Vec<(f64, f64)> = (0..200u32)
            .map(|k| (f64::from(k * 37 % 101), f64::from(k * 53 % 97)))
            .collect();
        let index = Neighbours::new(points.iter().copied());
        for (k, &(x, y)) in points.iter().enumerate().step_by(7) {
            let distance = |j: usize| (points[j].0 - x).hypot(points[j].1 - y);
            let mut found: Vec<usize> = index.within(x, y, 12.0).map(|(j, _)| j).collect();
            found.sort_unstable();
            let all: Vec<usize> = (0..200).filter(|&j| distance(j) <= 12.0).collect();
            assert_eq!(found, all);
            let (_, nearest) = index.nearest(x, y, |j| j != k).unwrap();
            let truth = (0..200)
                .filter(|&j| j != k)
                .map(distance)
                .fold(f64::INFINITY, f64::min);
            assert_eq!(nearest, truth);
        }
        assert_eq!(index.nearest(0.0, 0.0, |_| false), None);
    }
}
