//! Which sources can serve as PSF samples.

use psf_types::FrameShape;

use crate::background::median;
use crate::error::check;
use crate::field_trend::{FieldTerms, Trend, trend};
use crate::gaussian::Gaussian;
use crate::neighbours::Neighbours;
use crate::{Rejection, Rejections, StarError};

/// Which sources serve as PSF samples: cuts, each with its reason ([`Rejection`]).
///
/// * Signal-to-noise above a limit, 10 as in the method's paper (its eq. 6).
/// * Room for the stamp: the centre at least [`with_edge_px`](Self::with_edge_px) from the frame's edge.
/// * Isolation: no other source within a radius that has more than a part of its flux.
/// * Shape: FWHM and distortion agree with those of the stars about it. What is normal is a polynomial over the field (of degree
///   0 to 2, as the number of stars allows) fitted to those sources that lie near the most frequent FWHM of bright sources, clipped in units of the
///   scatter and of each source's own error until nothing changes; the PSF may vary, a single star may not differ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Selection {
    snr: f64,
    edge_px: Option<f64>,
    isolation_px: Option<f64>,
    neighbour_flux: f64,
    shape_sigma: f64,
}

impl Selection {
    /// The signal-to-noise ratio that a star must exceed unless told otherwise.
    pub const DEFAULT_SNR: f64 = 10.0;
    /// The part of a star's flux that a neighbour may have.
    pub const DEFAULT_NEIGHBOUR_FLUX: f64 = 0.2;
    /// Sigma at which shapes are clipped.
    pub const DEFAULT_SHAPE_SIGMA: f64 = 3.0;

    /// Stars above this signal-to-noise ratio.
    ///
    /// # Errors
    /// [`StarError::Setting`] unless it is 0 or above.
    pub fn with_snr(self, snr: f64) -> Result<Self, StarError> {
        check(
            snr.is_finite() && snr >= 0.0,
            "the signal-to-noise limit",
            "a number, 0 or above",
            snr,
        )?;
        Ok(Self { snr, ..self })
    }

    /// The smallest distance of a star from the frame's edge in pixels; by default half a stamp, and not below it: a stamp has to fit.
    ///
    /// # Errors
    /// [`StarError::Setting`] unless it is 0 or above.
    pub fn with_edge_px(self, edge_px: f64) -> Result<Self, StarError> {
        check(
            edge_px.is_finite() && edge_px >= 0.0,
            "the distance from the edge",
            "a number of pixels, 0 or above",
            edge_px,
        )?;
        Ok(Self {
            edge_px: Some(edge_px),
            ..self
        })
    }

    /// The radius in pixels in which no bright neighbour may be; by default 2.5 FWHM.
    ///
    /// # Errors
    /// [`StarError::Setting`] unless it is 0 or above.
    pub fn with_isolation_px(self, isolation_px: f64) -> Result<Self, StarError> {
        check(
            isolation_px.is_finite() && isolation_px >= 0.0,
            "the isolation radius",
            "a number of pixels, 0 or above",
            isolation_px,
        )?;
        Ok(Self {
            isolation_px: Some(isolation_px),
            ..self
        })
    }

    /// The part of a star's own flux that a neighbour may have.
    ///
    /// # Errors
    /// [`StarError::Setting`] unless it is 0 or above.
    pub fn with_neighbour_flux(self, neighbour_flux: f64) -> Result<Self, StarError> {
        check(
            neighbour_flux.is_finite() && neighbour_flux >= 0.0,
            "the flux of a neighbour",
            "a part of the star's flux, 0 or above",
            neighbour_flux,
        )?;
        Ok(Self {
            neighbour_flux,
            ..self
        })
    }

    /// Sigma at which shapes are clipped.
    ///
    /// # Errors
    /// [`StarError::Setting`] unless it is at least 1.
    pub fn with_shape_sigma(self, shape_sigma: f64) -> Result<Self, StarError> {
        check(
            shape_sigma.is_finite() && shape_sigma >= 1.0,
            "the clipping of shapes",
            "a number of sigma, at least 1",
            shape_sigma,
        )?;
        Ok(Self { shape_sigma, ..self })
    }

    /// The signal-to-noise ratio that a star must exceed.
    pub fn snr(&self) -> f64 {
        self.snr
    }

    /// Refuses a distance from the edge at which no stamp has room.
    pub(crate) fn check_edge(&self, half_stamp: usize) -> Result<(), StarError> {
        match self.edge_px {
            Some(edge_px) if edge_px < half_stamp as f64 => {
                Err(StarError::EdgeInsideStamp { edge_px, half_stamp })
            }
            _ => Ok(()),
        }
    }

    /// Flags what can be told of each source and its neighbours, then the shapes that do not belong.
    pub(crate) fn apply(
        &self,
        candidates: &mut [Candidate],
        frame: FrameShape,
        half_stamp: usize,
        fwhm_px: f64,
    ) {
        let reach = half_stamp as f64;
        let edge = self.edge_px.unwrap_or(reach);
        let isolation = self.isolation_px.unwrap_or(ISOLATION_FWHM * fwhm_px);
        let inside = |v: f64, n: usize| (edge..=(n - 1) as f64 - edge).contains(&v);
        let neighbours = Neighbours::new(candidates.iter().map(|c| (c.x, c.y)));
        for k in 0..candidates.len() {
            let (x, y, flux) = (candidates[k].x, candidates[k].y, candidates[k].flux);
            let crowded = neighbours
                .within(x, y, isolation)
                .any(|(j, _)| j != k && candidates[j].flux > self.neighbour_flux * flux);
            let candidate = &mut candidates[k];
            let mut flag = |holds: bool, reason| {
                if holds {
                    candidate.rejected.insert(reason);
                }
            };
            flag(!(inside(x, frame.nx()) && inside(y, frame.ny())), Rejection::Edge);
            flag(crowded, Rejection::Neighbour);
            let low = candidate.snr.partial_cmp(&self.snr) != Some(std::cmp::Ordering::Greater);
            if low {
                candidate.rejected.insert(Rejection::LowSnr);
            }
            if candidate.gaussian.is_none() {
                candidate.rejected.insert(Rejection::NoFit);
            }
        }
        self.flag_shapes(candidates, frame, fwhm_px.ln());
    }

    fn flag_shapes(&self, candidates: &mut [Candidate], frame: FrameShape, mode: f64) {
        let shapes: Vec<Shape> = candidates
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
        let mut judged = Vec::new();
        for _ in 0..MOST_ROUNDS {
            judged = (0..3).map(|q| self.judge(&shapes, &kept, q, frame)).collect();
            let now: Vec<bool> = (0..shapes.len())
                .map(|k| judged.iter().all(|j: &Vec<f64>| j[k].abs() <= 1.0))
                .collect();
            if now == kept || !now.contains(&true) {
                break;
            }
            kept = now;
        }
        for (k, shape) in shapes.iter().enumerate() {
            let reasons = &mut candidates[shape.index].rejected;
            if judged[0][k] < -1.0 {
                reasons.insert(Rejection::TooSharp);
            }
            if judged[0][k] > 1.0 {
                reasons.insert(Rejection::TooBroad);
            }
            if judged[1][k].abs() > 1.0 || judged[2][k].abs() > 1.0 {
                reasons.insert(Rejection::Elongated);
            }
        }
    }

    /// How far one quantity of every source lies from the trend of the kept ones, in units of what is allowed.
    fn judge(&self, shapes: &[Shape], kept: &[bool], quantity: usize, frame: FrameShape) -> Vec<f64> {
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
        let trend: Option<Trend> = trend(&points, FieldTerms::new(degree, frame));
        let off = |s: &Shape| {
            trend
                .as_ref()
                .map_or(0.0, |t| s.values[quantity] - t.at(s.x, s.y))
        };
        let spread = 1.4826 * median(&mut good().map(|s| off(s).abs()).collect::<Vec<_>>());
        let measured = median(&mut good().map(|s| s.variances[quantity]).collect::<Vec<_>>());
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
            snr: Self::DEFAULT_SNR,
            edge_px: None,
            isolation_px: None,
            neighbour_flux: Self::DEFAULT_NEIGHBOUR_FLUX,
            shape_sigma: Self::DEFAULT_SHAPE_SIGMA,
        }
    }
}

/// A source while it is judged.
#[derive(Debug, Clone)]
pub(crate) struct Candidate {
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// In an aperture.
    pub(crate) flux: f64,
    pub(crate) snr: f64,
    pub(crate) significance: f64,
    pub(crate) peak: f64,
    pub(crate) pixel_count: usize,
    pub(crate) gaussian: Option<Gaussian>,
    pub(crate) rejected: Rejections,
}

impl Candidate {
    pub(crate) fn fwhm_px(&self) -> Option<f64> {
        self.gaussian.map(|g| g.fwhm_px)
    }
}

/// ln FWHM and the distortion, with the variances that noise gives them.
struct Shape {
    index: usize,
    x: f64,
    y: f64,
    values: [f64; 3],
    variances: [f64; 3],
}

impl Shape {
    fn of(index: usize, candidate: &Candidate) -> Option<Self> {
        let g = candidate.gaussian?;
        // A width is known to 1 / SNR of the fit, an axis difference to sqrt(2) of that.
        let width = candidate.significance.powi(-2);
        Some(Self {
            index,
            x: g.x,
            y: g.y,
            values: [g.fwhm_px.ln(), g.e1, g.e2],
            variances: [width, 2.0 * width, 2.0 * width],
        })
    }
}

/// Sources within this of the most frequent ln FWHM start the clipping: a field-dependent PSF stays, galaxies do not.
const FIRST_GUESS: f64 = 0.25;
/// Stars differ by at least this beyond noise (pixel phase, colour), in ln FWHM and in distortion.
const SCATTER: f64 = 0.05;
/// Where they seem to differ by more, galaxies are among them.
const MOST_SCATTER: f64 = 0.08;
/// Neighbours count within so many FWHM unless told otherwise; what lies beyond is masked in the stamp.
const ISOLATION_FWHM: f64 = 2.5;
const MOST_ROUNDS: usize = 20;

/// The most frequent width among sources ordered from the brightest down, if there is any.
///
/// The one that has most others within 10 %, among the brighter quarter: bright stars share one width, where galaxies and noisy
/// fits have any. The narrower of two that have equally many.
pub(crate) fn most_frequent_width(mut widths: Vec<f64>) -> Option<f64> {
    widths.truncate((widths.len() / 4).max(BRIGHT));
    let company = |width: f64| widths.iter().filter(|w| (*w / width).ln().abs() <= ALIKE).count();
    let centre = widths
        .iter()
        .copied()
        .max_by(|a, b| company(*a).cmp(&company(*b)).then(b.total_cmp(a)))?;
    let mut alike: Vec<f64> = widths
        .iter()
        .copied()
        .filter(|w| (w / centre).ln().abs() <= ALIKE)
        .collect();
    Some(median(&mut alike))
}

/// The most frequent width comes from at least so many sources, if there are as many.
const BRIGHT: usize = 10;
/// Widths are alike within this, in ln FWHM.
const ALIKE: f64 = 0.1;

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(x: f64, y: f64, fwhm_px: f64) -> Candidate {
        Candidate {
            x,
            y,
            flux: 100.0,
            snr: 50.0,
            significance: 50.0,
            peak: 100.0,
            pixel_count: 9,
            gaussian: Some(Gaussian {
                amplitude: 10.0,
                x,
                y,
                fwhm_px,
                e1: 0.0,
                e2: 0.0,
            }),
            rejected: Rejections::default(),
        }
    }

    fn field() -> Vec<Candidate> {
        // The FWHM grows by 40 % over the field: more than any outlier here.
        (0..100)
            .map(|k| (20.0 + 20.0 * f64::from(k % 10), 20.0 + 20.0 * f64::from(k / 10)))
            .map(|(x, y)| candidate(x, y, 1.5 + 0.003 * x))
            .collect()
    }

    #[test]
    fn shapes_are_judged_against_the_local_psf() {
        let frame = FrameShape::new(220, 220).unwrap();
        let mut sources = field();
        // Normal on the right-hand side of the field, not on the left.
        for (k, fwhm) in [(40, 2.1), (49, 1.55)] {
            sources[k].gaussian.as_mut().unwrap().fwhm_px = fwhm;
        }
        sources[55].gaussian.as_mut().unwrap().e2 = 0.4;
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
        sources[22].gaussian = None;
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
        // (100, 100) has a neighbour of 21 % of its flux.
        assert_eq!(reasons(44), "neighbour");
    }

    #[test]
    fn sources_that_are_all_rejected_stay_so() {
        let mut sources = field();
        let strict = Selection::default().with_snr(1e6).unwrap();
        strict.apply(&mut sources, FrameShape::new(220, 220).unwrap(), 7, 1.8);
        assert!(sources.iter().all(|c| c.rejected.contains(Rejection::LowSnr)));
    }

    #[test]
    fn the_most_frequent_width_is_that_of_bright_stars() {
        // Stars of 2.25 pixels among galaxies, which are the more frequent ones.
        let widths = vec![
            3.28, 2.14, 2.28, 2.25, 5.8, 2.13, 4.76, 2.82, 3.66, 2.95, 3.0, 3.1, 3.05,
        ];
        let width = most_frequent_width(widths).unwrap();
        assert!((2.1..2.3).contains(&width), "{width}");
        assert_eq!(most_frequent_width(vec![]), None);
    }
}
