//! Drawn stars compared with the stars of a frame: sizes, shapes, fluxes and residuals.

use metrics::Summary;
use ndarray::ArrayView2;
use psf_stars::Source;
use serde::Serialize;

/// A quantity measured for the stars of the frame and for the simulated stars.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Agreement {
    /// The values in the frame, one for each star that was measured there and in the first
    /// simulated frame.
    pub frame: Distribution,
    /// The values in all simulated frames together.
    pub simulated: Distribution,
    /// Median of the simulated stars divided by the median of the stars in the frame.
    pub median_ratio: f64,
    /// Mean absolute difference between a star in the first simulated frame and the star in the
    /// frame. It includes the noise of both.
    pub mean_absolute_error: f64,
    /// Kolmogorov-Smirnov distance of the two distributions.
    pub ks_distance: f64,
}

/// Median and quantiles.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names say it: q10 is the 0.1 quantile")]
pub struct Distribution {
    pub count: usize,
    /// The standard deviation of a normal distribution that has the same quartiles.
    pub scatter: f64,
    pub q10: f64,
    pub q25: f64,
    pub median: f64,
    pub q75: f64,
    pub q90: f64,
}

/// The distance between the quartiles of a normal distribution, in standard deviations.
const QUARTILES_PER_SIGMA: f64 = 1.349;

impl Distribution {
    pub(crate) fn of(values: &[f64]) -> Option<Self> {
        let summary = Summary::of(values.iter().copied()).ok()?;
        let quantile = |q| summary.quantile(q).ok();
        Some(Self {
            count: summary.count(),
            scatter: (quantile(0.75)? - quantile(0.25)?) / QUARTILES_PER_SIGMA,
            q10: quantile(0.1)?,
            q25: quantile(0.25)?,
            median: summary.median(),
            q75: quantile(0.75)?,
            q90: quantile(0.9)?,
        })
    }
}

impl Agreement {
    /// Compares `pairs` (a star in the frame and in the first simulated frame) and `simulated` (the
    /// stars in all simulated frames). None if there are no values.
    pub(crate) fn of(pairs: &[(f64, f64)], simulated: &[f64]) -> Option<Self> {
        let frame: Vec<f64> = pairs.iter().map(|p| p.0).collect();
        let (of_frame, of_simulated) = (Distribution::of(&frame)?, Distribution::of(simulated)?);
        let differences = pairs.iter().map(|(a, b)| (a - b).abs()).sum::<f64>();
        Some(Self {
            median_ratio: of_simulated.median / of_frame.median,
            mean_absolute_error: differences / pairs.len() as f64,
            ks_distance: kolmogorov_smirnov(&frame, simulated)?,
            frame: of_frame,
            simulated: of_simulated,
        })
    }
}

/// The stars of the frame compared with drawn stars.
///
/// Only isolated stars have a flux ratio and a reduced chi-square. These are stars that became
/// samples and have no other source within 2.5 aperture radii. The aperture radius
/// ([`aperture_px`](crate::RoundTripReport::aperture_px)) is 2.5 FWHM, at least 4 pixels.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct StarComparison {
    /// Stars that could be measured in the frame and in the first simulated frame.
    pub measured: usize,
    /// FWHM in pixels (Gaussian fit, geometric mean of the axes).
    pub fwhm_px: Agreement,
    /// Eccentricity `sqrt(1 - b^2 / a^2)` of the Gaussian fit.
    pub eccentricity: Agreement,
    /// The flux in the aperture as drawn, without noise, divided by the flux in the frame. The
    /// background of both is the median of a ring from 1.5 to 2.5 aperture radii. None if no star
    /// is isolated.
    pub flux_ratio: Option<Distribution>,
    /// The sum of `(frame - drawn)^2 / noise^2` over the pixels of a star's window, divided by the
    /// number of pixels minus 3, because x, y and flux of the star are fitted. It is near 1 if
    /// noise explains the differences. The noise is that of the background, and with a known gain
    /// also the photon noise of the drawn light. Without the gain, bright stars have higher values.
    /// None if no star is isolated.
    pub reduced_chi_square: Option<Distribution>,
}

/// Compares the light of drawn stars with a frame.
pub(crate) struct LightComparison<'a> {
    /// The frame minus its background map `[y, x]`.
    pub(crate) frame: ArrayView2<'a, f64>,
    /// The drawn light, without background and noise `[y, x]`.
    pub(crate) drawn: ArrayView2<'a, f64>,
    /// The noise of the background `[y, x]`.
    pub(crate) rms: ArrayView2<'a, f64>,
    /// Electrons per unit of the frame, for the photon noise.
    pub(crate) gain: Option<f64>,
    /// Pixels along each side of the windows for the reduced chi-square. An even number counts as
    /// the next odd number.
    pub(crate) window: usize,
    /// Radius of the apertures.
    pub(crate) aperture_px: f64,
}

impl LightComparison<'_> {
    /// Returns the flux ratio drawn / frame and the reduced chi-square of a star. None if the star
    /// is not isolated, if its flux in the frame is not positive, or if its ring for the background
    /// has no pixels on the frame.
    pub(crate) fn of(&self, star: &Source) -> Option<(f64, f64)> {
        let isolation_px = RING.1 * self.aperture_px;
        if star.nearest_px.is_some_and(|distance| distance <= isolation_px) {
            return None;
        }
        let in_frame = self.aperture_flux(self.frame, star)?;
        let ratio = self.aperture_flux(self.drawn, star)? / in_frame;

        let reach = (self.window / 2) as f64;
        let (x, y) = (star.x.round(), star.y.round());
        let (mut sum, mut count) = (0.0, 0.0);
        for ((row, column), drawn) in about(self.drawn, (x, y), reach) {
            let photons = self.gain.map_or(0.0, |gain| drawn.max(0.0) / gain);
            let variance = self.rms[[row, column]].powi(2) + photons;
            sum += (self.frame[[row, column]] - drawn).powi(2) / variance;
            count += 1.0;
        }
        (in_frame > 0.0).then_some((ratio, sum / (count - FITTED_PARAMETERS)))
    }

    /// The flux of a star in the aperture, above the median of the ring around it. None if the ring
    /// has no pixels on the frame.
    fn aperture_flux(&self, image: ArrayView2<'_, f64>, star: &Source) -> Option<f64> {
        let (inner, outer) = (RING.0 * self.aperture_px, RING.1 * self.aperture_px);
        let (mut flux, mut count, mut ring) = (0.0, 0.0, Vec::new());
        for ((row, column), value) in about(image, (star.x, star.y), outer) {
            let distance = (column as f64 - star.x).hypot(row as f64 - star.y);
            if distance <= self.aperture_px {
                flux += value;
                count += 1.0;
            } else if (inner..=outer).contains(&distance) {
                ring.push(value);
            }
        }
        Some(flux - count * Summary::of(ring).ok()?.median())
    }
}

/// Apertures have this radius in FWHM. It is at least [`LEAST_APERTURE_PX`] pixels.
const APERTURE_FWHM: f64 = 2.5;
const LEAST_APERTURE_PX: f64 = 4.0;
/// The inner and outer radius of the ring for the local background, in radii of the aperture. A
/// star is isolated if no other source lies within the outer radius.
const RING: (f64, f64) = (1.5, 2.5);
/// Position and flux of each star are fitted to the frame.
const FITTED_PARAMETERS: f64 = 3.0;

/// The radius of the aperture for stars of the given FWHM.
pub(crate) fn aperture_px(fwhm_px: f64) -> f64 {
    (APERTURE_FWHM * fwhm_px).max(LEAST_APERTURE_PX)
}

/// The pixels `((row, column), value)` within `reach` of a position along each axis.
fn about(
    image: ArrayView2<'_, f64>,
    (x, y): (f64, f64),
    reach: f64,
) -> impl Iterator<Item = ((usize, usize), f64)> {
    let range = |centre: f64, n: usize| {
        let first = (centre - reach).ceil().max(0.0) as usize;
        first..((centre + reach).floor().max(-1.0) + 1.0).min(n as f64) as usize
    };
    let (rows, columns) = (range(y, image.nrows()), range(x, image.ncols()));
    rows.flat_map(move |row| columns.clone().map(move |column| (row, column)))
        .map(move |at| (at, image[at]))
}

/// The two-sample Kolmogorov-Smirnov distance: the largest difference of the two cumulative
/// distributions. None if either is empty.
fn kolmogorov_smirnov(a: &[f64], b: &[f64]) -> Option<f64> {
    if a.is_empty() || b.is_empty() {
        return None;
    }
    let sorted = |values: &[f64]| {
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        sorted
    };
    let (a, b) = (sorted(a), sorted(b));
    let below = |values: &[f64], v: f64| values.partition_point(|x| *x <= v) as f64 / values.len() as f64;
    let distances = a.iter().chain(&b).map(|&v| (below(&a, v) - below(&b, v)).abs());
    Some(distances.fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_distances() {
        let a = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(kolmogorov_smirnov(&a, &a), Some(0.0));
        assert_eq!(kolmogorov_smirnov(&a, &[5.0, 6.0]), Some(1.0));
        assert_eq!(kolmogorov_smirnov(&a, &[4.0, 3.0, 2.5, 1.5]), Some(0.25));
        assert_eq!(kolmogorov_smirnov(&[3.0, 1.0], &[2.0]), Some(0.5));
        assert_eq!(kolmogorov_smirnov(&a, &[]), None);
    }
}
