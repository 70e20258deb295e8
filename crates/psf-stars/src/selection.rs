//! Selection of the sources that can serve as PSF samples, and the trends over the field with which
//! their shapes are compared.

use nalgebra::{DMatrix, DVector};
use psf_types::FrameShape;
use psf_types::maths::{legendre, term_count};

use crate::background::median;
use crate::error::{at_least, checked_setters};
use crate::frame::Neighbours;
use crate::{Rejection, Source, StarError};

/// Applies cuts to the sources. The sources that pass all cuts serve as PSF samples. Each cut
/// rejects sources for a reason of its own ([`Rejection`]).
///
/// * Signal-to-noise ratio above a limit. By default, the limit is as low as it takes to keep 200
///   stars, but at least 10 (Bai, Jia et al. 2025, AJ, eq. 6) and at most 50: where bright stars are
///   many, faint ones only add the light of their neighbours. If more than 2000 stars exceed 50, the
///   brightest 2000 are kept.
/// * Room for the stamp: the centre is at least [`with_edge_px`](Self::with_edge_px) from the
///   frame's edge.
/// * Isolation: no other source within a radius has more than a fraction of the star's flux.
/// * Shape: FWHM and distortion agree with their trend over the field.
///
/// The trend is a polynomial over the field, of degree 0 to 2 depending on the number of stars. It
/// is first fitted to the sources near the most frequent FWHM of bright sources. Sources that
/// deviate from it by more than 3 sigma ([`with_shape_sigma`](Self::with_shape_sigma)) are left
/// out, and the fit is repeated until nothing changes. Here sigma combines the scatter of the sources and the error of each source. So
/// the PSF may vary over the field, but a single star that deviates is rejected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Selection {
    snr: Option<f64>,
    edge_px: Option<f64>,
    isolation_px: Option<f64>,
    neighbour_flux: f64,
    shape_sigma: f64,
}

impl Selection {
    /// The lowest default signal-to-noise ratio that a star must exceed.
    pub const LEAST_SNR: f64 = 10.0;
    /// The highest default signal-to-noise ratio that a star must exceed.
    pub const AMPLE_SNR: f64 = 50.0;
    /// By default, at most this number of stars are kept, the brightest.
    pub const MANY_STARS: usize = 2000;
    /// The number of stars for which the default signal-to-noise ratio is lowered.
    pub const ENOUGH_STARS: usize = 200;
    /// Default fraction of a star's flux that a neighbour may have.
    pub const DEFAULT_NEIGHBOUR_FLUX: f64 = 0.2;
    /// Default number of sigma at which shapes are clipped.
    pub const DEFAULT_SHAPE_SIGMA: f64 = 3.0;

    checked_setters! {
        /// Sets the signal-to-noise ratio that a star must exceed.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is 0 or above.
        with_snr(snr: f64) => snr: Some, if at_least(0.0, snr),
            else "the signal-to-noise limit", "a number, 0 or above";
        /// Sets the smallest distance of a star from the frame's edge in pixels. The default is
        /// half a stamp.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is 0 or above. A distance below half a stamp is an
        /// error of [`StarSampling::run`](crate::StarSampling::run), because stamps must fit.
        with_edge_px(edge_px: f64) => edge_px: Some, if at_least(0.0, edge_px),
            else "the distance from the edge", "a number of pixels, 0 or above";
        /// Sets the radius in pixels in which there may be no bright neighbour. The default is 2.5
        /// FWHM.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is 0 or above.
        with_isolation_px(isolation_px: f64) => isolation_px: Some, if at_least(0.0, isolation_px),
            else "the isolation radius", "a number of pixels, 0 or above";
        /// Sets the fraction of a star's own flux that a neighbour may have.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is 0 or above.
        with_neighbour_flux(neighbour_flux: f64) => neighbour_flux, if at_least(0.0, neighbour_flux),
            else "the flux of a neighbour", "a fraction of the star's flux, 0 or above";
        /// Sets the number of sigma at which shapes are clipped.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is at least 1.
        with_shape_sigma(shape_sigma: f64) => shape_sigma, if at_least(1.0, shape_sigma),
            else "the limit for shapes", "a number of sigma, at least 1";
    }

    /// The signal-to-noise ratio that every star must exceed.
    pub(crate) fn least_snr(&self) -> f64 {
        self.snr.unwrap_or(Self::LEAST_SNR)
    }

    /// The signal-to-noise ratio that a star must exceed, from the ratios of all stars that have not
    /// been rejected for other reasons.
    fn snr_limit(&self, mut of_stars: Vec<f64>) -> f64 {
        self.snr.unwrap_or_else(|| {
            of_stars.sort_unstable_by(|a, b| b.total_cmp(a));
            let of = |count: usize| of_stars.get(count).copied().unwrap_or(0.0);
            let enough = of(Self::ENOUGH_STARS).clamp(Self::LEAST_SNR, Self::AMPLE_SNR);
            enough.max(of(Self::MANY_STARS))
        })
    }

    /// Returns an error if stamps do not fit at the distance from the edge.
    pub(crate) fn check_edge(&self, half_stamp: usize) -> Result<(), StarError> {
        match self.edge_px {
            Some(edge_px) if edge_px < half_stamp as f64 => Err(StarError::NoSamples(format!(
                "a distance of {edge_px} pixels from the frame's edge is less than half a stamp, {half_stamp} pixels: increase the distance or choose smaller stamps"
            ))),
            _ => Ok(()),
        }
    }

    /// Adds the reasons for rejection: first by each source's own values and neighbours, then for
    /// shapes that deviate from the trend.
    pub(crate) fn apply(&self, sources: &mut [Source], frame: FrameShape, half_stamp: usize, fwhm_px: f64) {
        let reach = half_stamp as f64;
        let edge = self.edge_px.unwrap_or(reach);
        let isolation = self.isolation_px.unwrap_or(ISOLATION_FWHM * fwhm_px);
        let inside = |v: f64, n: usize| (edge..=(n - 1) as f64 - edge).contains(&v);
        let neighbours = Neighbours::of(sources);
        for k in 0..sources.len() {
            let (x, y, flux) = (sources[k].x, sources[k].y, sources[k].flux);
            let crowded = neighbours
                .within(x, y, isolation)
                .any(|(j, _)| j != k && sources[j].flux > self.neighbour_flux * flux);
            let fitted = sources[k].fwhm_px.is_some();
            let mut flag = |holds: bool, reason| {
                if holds {
                    sources[k].rejected.insert(reason);
                }
            };
            flag(!(inside(x, frame.nx()) && inside(y, frame.ny())), Rejection::Edge);
            flag(crowded, Rejection::Neighbour);
            flag(!fitted, Rejection::NoFit);
        }
        let usable = sources
            .iter()
            .filter(|s| s.rejected.is_empty() && !s.snr.is_nan());
        let limit = self.snr_limit(usable.map(|s| s.snr).collect());
        // NaN also counts as too low.
        let low = |s: &&mut Source| s.snr.is_nan() || s.snr <= limit;
        sources
            .iter_mut()
            .filter(low)
            .for_each(|s| s.rejected.insert(Rejection::LowSnr));
        self.flag_shapes(sources, frame, fwhm_px.ln());
    }

    fn flag_shapes(&self, sources: &mut [Source], frame: FrameShape, mode: f64) {
        let shapes: Vec<Shape> = sources
            .iter()
            .enumerate()
            .filter(|(_, c)| c.rejected.is_empty())
            .filter_map(|(index, c)| Shape::of(index, c))
            .collect();
        if shapes.is_empty() {
            return;
        }
        let mut kept: Vec<bool> = shapes
            .iter()
            .map(|s| (s.values[0] - mode).abs() <= FIRST_GUESS)
            .collect();
        let mut deviations = Vec::new();
        for _ in 0..MOST_ROUNDS {
            deviations = (0..3).map(|q| self.deviation(&shapes, &kept, q, frame)).collect();
            let now: Vec<bool> = (0..shapes.len())
                .map(|k| deviations.iter().all(|d: &Vec<f64>| d[k].abs() <= 1.0))
                .collect();
            if now == kept || !now.contains(&true) {
                break;
            }
            kept = now;
        }
        for (k, shape) in shapes.iter().enumerate() {
            let reasons = &mut sources[shape.index].rejected;
            if deviations[0][k] < -1.0 {
                reasons.insert(Rejection::TooSharp);
            }
            if deviations[0][k] > 1.0 {
                reasons.insert(Rejection::TooBroad);
            }
            if deviations[1][k].abs() > 1.0 || deviations[2][k].abs() > 1.0 {
                reasons.insert(Rejection::Elongated);
            }
        }
    }

    /// The difference of one quantity of every source from the trend of the kept sources, in units
    /// of the largest allowed difference.
    fn deviation(&self, shapes: &[Shape], kept: &[bool], quantity: usize, frame: FrameShape) -> Vec<f64> {
        let good = || shapes.iter().zip(kept).filter(|(_, k)| **k).map(|(s, _)| s);
        let count = good().count();
        let degree = match count {
            60.. => 2,
            15.. => 1,
            _ => 0,
        };
        let points: Vec<_> = good()
            .map(|s| {
                let weight = 1.0 / (s.variances[quantity] + SCATTER * SCATTER);
                (s.x, s.y, s.values[quantity], weight)
            })
            .collect();
        let trend = trend(&points, FieldTerms::new(degree, frame));
        let off = |s: &Shape| trend.as_ref().map_or(0.0, |of| s.values[quantity] - of(s.x, s.y));
        let spread = 1.4826 * median(good().map(|s| off(s).abs()));
        let measured = median(good().map(|s| s.variances[quantity]));
        let scatter2 = (spread * spread - measured).clamp(SCATTER.powi(2), MOST_SCATTER.powi(2));
        shapes
            .iter()
            .map(|s| off(s) / (self.shape_sigma * (scatter2 + s.variances[quantity]).sqrt()))
            .collect()
    }
}

impl Default for Selection {
    fn default() -> Self {
        Self {
            snr: None,
            edge_px: None,
            isolation_px: None,
            neighbour_flux: Self::DEFAULT_NEIGHBOUR_FLUX,
            shape_sigma: Self::DEFAULT_SHAPE_SIGMA,
        }
    }
}

/// ln FWHM and the distortion, with their variances caused by noise.
struct Shape {
    index: usize,
    x: f64,
    y: f64,
    values: [f64; 3],
    variances: [f64; 3],
}

impl Shape {
    fn of(index: usize, source: &Source) -> Option<Self> {
        // The relative error of a width is 1 / SNR of the fit. The error of the distortion is
        // sqrt(2) times as large.
        let width = source.significance.powi(-2);
        Some(Self {
            index,
            x: source.x,
            y: source.y,
            values: [source.fwhm_px?.ln(), source.e1?, source.e2?],
            variances: [width, 2.0 * width, 2.0 * width],
        })
    }
}

/// The clipping starts with sources within this distance of the most frequent ln FWHM. This keeps
/// stars of a PSF that varies over the field, and excludes galaxies.
const FIRST_GUESS: f64 = 0.25;
/// The smallest assumed scatter of stars in ln FWHM and in distortion that does not come from noise
/// (but from pixel phase or colour).
const SCATTER: f64 = 0.05;
/// The largest assumed scatter of stars. A larger one means that galaxies are among them.
const MOST_SCATTER: f64 = 0.08;
/// Default isolation radius in FWHM. Neighbours farther away are masked in the stamp.
const ISOLATION_FWHM: f64 = 2.5;
const MOST_ROUNDS: usize = 20;

/// Returns the most frequent width, or `None` if `widths` is empty. `widths` lists the sources'
/// widths, the brightest source first.
///
/// The search is among the brightest quarter of the sources, but at least [`BRIGHT`] of them. It
/// finds the width that has the most other widths within 10 % of it, and returns the median of all
/// these widths. Of two widths with equally many others, the narrower is chosen. The search finds
/// the stars, because bright stars share one width, whereas galaxies and noisy fits have any width.
pub(crate) fn most_frequent_width(mut widths: Vec<f64>) -> Option<f64> {
    widths.truncate((widths.len() / 4).max(BRIGHT));
    let company = |width: f64| widths.iter().filter(|w| (*w / width).ln().abs() <= EQUAL).count();
    let centre = widths
        .iter()
        .copied()
        .max_by(|a, b| company(*a).cmp(&company(*b)).then(b.total_cmp(a)))?;
    let alike = widths.iter().filter(|w| (*w / centre).ln().abs() <= EQUAL);
    Some(median(alike.copied()))
}

/// The most frequent width is searched among at least this many of the brightest sources, or among
/// all if there are fewer.
const BRIGHT: usize = 10;
/// Widths count as equal if their values of ln FWHM differ by at most this.
const EQUAL: f64 = 0.1;

/// The terms of a polynomial over the field, in coordinates that run from -1 to 1 over the frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct FieldTerms {
    pub(crate) degree: usize,
    frame: FrameShape,
}

impl FieldTerms {
    pub(crate) fn new(degree: usize, frame: FrameShape) -> Self {
        Self { degree, frame }
    }

    pub(crate) fn frame(self) -> FrameShape {
        self.frame
    }

    pub(crate) fn count(self) -> usize {
        term_count(self.degree)
    }

    /// Products of Legendre polynomials, `P_i(x) P_j(y)` with `i + j <= degree`. They have a
    /// similar size over the whole field.
    pub(crate) fn at(self, x: f64, y: f64) -> Vec<f64> {
        let scaled = |v: f64, n: usize| (2.0 * v - (n - 1) as f64) / n as f64;
        let (px, py) = (
            legendre(self.degree, scaled(x, self.frame.nx())),
            legendre(self.degree, scaled(y, self.frame.ny())),
        );
        (0..=self.degree)
            .flat_map(|j| (0..=self.degree - j).map(move |i| (i, j)))
            .map(|(i, j)| px[i] * py[j])
            .collect()
    }
}

/// Fits a polynomial to points `(x, y, value, weight)` by weighted least squares, if there are any.
/// Returns it as a function of the position.
fn trend(points: &[(f64, f64, f64, f64)], terms: FieldTerms) -> Option<impl Fn(f64, f64) -> f64 + use<>> {
    if points.is_empty() {
        return None;
    }
    let (mut rows, mut right) = (
        DMatrix::zeros(points.len(), terms.count()),
        DVector::zeros(points.len()),
    );
    for (k, &(x, y, value, weight)) in points.iter().enumerate() {
        let root = weight.sqrt();
        for (j, term) in terms.at(x, y).into_iter().enumerate() {
            rows[(k, j)] = root * term;
        }
        right[k] = root * value;
    }
    // Least squares by SVD. If clustered points leave terms undetermined, the solution with the
    // smallest norm is chosen.
    let found = rows.svd(true, true).solve(&right, 1e-9).ok()?;
    Some(move |x, y| terms.at(x, y).iter().zip(&found).map(|(t, c)| t * c).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rejections;

    fn candidate(x: f64, y: f64, fwhm_px: f64) -> Source {
        Source {
            x,
            y,
            flux: 100.0,
            snr: 50.0,
            significance: 50.0,
            peak: 100.0,
            background: 0.0,
            background_rms: 1.0,
            fwhm_px: Some(fwhm_px),
            e1: Some(0.0),
            e2: Some(0.0),
            pixel_count: 9,
            nearest_px: None,
            sample: None,
            rejected: Rejections::default(),
        }
    }

    fn field() -> Vec<Source> {
        // The FWHM grows by 40 % over the field, which is more than any outlier deviates here.
        (0..100)
            .map(|k| (20.0 + 20.0 * f64::from(k % 10), 20.0 + 20.0 * f64::from(k / 10)))
            .map(|(x, y)| candidate(x, y, 1.5 + 0.003 * x))
            .collect()
    }

    #[test]
    fn shapes_are_compared_with_the_local_psf() {
        let frame = FrameShape::new(220, 220).unwrap();
        let mut sources = field();
        // This FWHM is normal on the right-hand side of the field, but not on the left.
        for (k, fwhm) in [(40, 2.1), (49, 1.55)] {
            sources[k].fwhm_px = Some(fwhm);
        }
        sources[55].e2 = Some(0.4);
        Selection::default().apply(&mut sources, frame, 7, 1.8);
        let reasons = |k: usize| sources[k].rejected.to_string();
        assert_eq!(
            (reasons(40), reasons(49), reasons(55)),
            ("too-broad".into(), "too-sharp".into(), "elongated".into())
        );
        let rejected = sources.iter().filter(|c| !c.rejected.is_empty()).count();
        assert_eq!(rejected, 3);
    }

    #[test]
    fn edges_neighbours_and_noise_are_flagged() {
        let frame = FrameShape::new(220, 220).unwrap();
        let mut sources = field();
        sources[0].snr = 9.9;
        sources[11].snr = f64::NAN;
        sources[22].fwhm_px = None;
        sources.push(candidate(6.9, 100.0, 1.5));
        let mut faint = candidate(60.0, 64.0, 1.7);
        faint.flux = 19.0;
        let mut bright = candidate(100.0, 104.0, 1.8);
        bright.flux = 21.0;
        sources.extend([faint, bright]);
        Selection::default().apply(&mut sources, frame, 7, 1.8);
        let reasons = |k: usize| sources[k].rejected.to_string();
        assert_eq!(reasons(0), "low-snr");
        assert_eq!(reasons(11), "low-snr");
        assert_eq!(reasons(22), "no-fit");
        assert_eq!(reasons(100), "edge");
        assert_eq!(reasons(101), "neighbour");
        // (100, 100) has a neighbour with 21 % of its flux.
        assert_eq!(reasons(44), "neighbour");
    }

    #[test]
    fn the_limit_rises_where_bright_stars_are_many() {
        let limit = |count: usize, snr: f64| Selection::default().snr_limit(vec![snr; count]);
        assert_eq!(limit(1000, 300.0), 50.0);
        assert_eq!(limit(1000, 30.0), 30.0);
        assert_eq!(limit(199, 300.0), 10.0);
        assert_eq!(limit(1000, 3.0), 10.0);
        assert_eq!(limit(2001, 300.0), 300.0);
        let given = Selection::default().with_snr(4.0).unwrap();
        assert_eq!(given.snr_limit(vec![300.0; 1000]), 4.0);
    }

    #[test]
    fn if_all_sources_are_rejected_all_stay_rejected() {
        let mut sources = field();
        let strict = Selection::default().with_snr(1e6).unwrap();
        strict.apply(&mut sources, FrameShape::new(220, 220).unwrap(), 7, 1.8);
        assert!(sources.iter().all(|c| c.rejected.contains(Rejection::LowSnr)));
    }

    #[test]
    fn the_most_frequent_width_is_that_of_bright_stars() {
        // Stars of 2.25 pixels among galaxies, which are more numerous.
        let widths = vec![
            3.28, 2.14, 2.28, 2.25, 5.8, 2.13, 4.76, 2.82, 3.66, 2.95, 3.0, 3.1, 3.05,
        ];
        let width = most_frequent_width(widths).unwrap();
        assert!((2.1..2.3).contains(&width), "{width}");
        assert_eq!(most_frequent_width(vec![]), None);
    }

    #[test]
    fn a_parabola_is_found_exactly() {
        let frame = FrameShape::new(100, 60).unwrap();
        let truth = |x: f64, y: f64| 2.0 + 0.01 * x - 0.02 * y + 1e-4 * x * y - 2e-4 * y * y;
        let points: Vec<_> = (0..30)
            .map(|k| (f64::from(k * 37 % 100), f64::from(k * 23 % 60)))
            .map(|(x, y)| (x, y, truth(x, y), 1.0 + x))
            .collect();
        let found = trend(&points, FieldTerms::new(2, frame)).unwrap();
        for (x, y) in [(0.0, 0.0), (99.0, 59.0), (50.0, 10.0)] {
            assert!((found(x, y) - truth(x, y)).abs() < 1e-10);
        }
        assert_eq!(
            FieldTerms::new(3, frame).at(1.0, 2.0).len(),
            FieldTerms::new(3, frame).count()
        );
    }
}
