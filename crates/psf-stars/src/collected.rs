//! Registered stars and all sources in their final form.

use ndarray::{Array2, Array3, Axis};
use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};
use rayon::prelude::*;

use crate::frame_view::{FrameView, aperture_px};
use crate::neighbours::Neighbours;
use crate::registration::FineGrid;
use crate::selection::Candidate;
use crate::spline::Spline;
use crate::star::Star;
use crate::star_samples::rejection_counts;
use crate::{CoverageMap, RegistrationReport, Rejection, Source, StarError, StarSamples};

/// Stars with their samples `[y, x]` of unit flux and their fluxes.
pub(crate) struct Registered {
    pub(crate) samples: Vec<(Star, Array2<f64>, f64)>,
    pub(crate) grid: FineGrid,
    pub(crate) report: RegistrationReport,
}

impl FrameView {
    /// Samples and sources in their final form.
    pub(crate) fn collected(
        self,
        candidates: &[Candidate],
        registered: Registered,
        fwhm_px: f64,
    ) -> Result<StarSamples, StarError> {
        let shape = self.shape();
        let mut sources = self.sources(candidates);
        if registered.samples.is_empty() {
            let counts = rejection_counts(&sources);
            let reasons: Vec<String> = counts
                .iter()
                .map(|(reason, n)| match reason {
                    Rejection::Saturated => format!("{n} {} at {}", reason.name(), self.saturation),
                    _ => format!("{n} {}", reason.name()),
                })
                .collect();
            return Err(StarError::NoStars {
                detected: sources.len(),
                reasons: reasons.join(", "),
            });
        }
        let side = registered.grid.side();
        let mut stamps = Array3::zeros((registered.samples.len(), side, side));
        let mut positions = Vec::with_capacity(registered.samples.len());
        for (k, (star, stamp, flux)) in registered.samples.iter().enumerate() {
            stamps.index_axis_mut(Axis(0), k).assign(stamp);
            positions.push(Position::new(star.x, star.y)?);
            let source = &mut sources[star.source];
            (source.x, source.y, source.flux) = (star.x, star.y, *flux);
            source.sample = Some(k);
        }
        self.measure_psf_fluxes(&mut sources, &registered, fwhm_px);
        let coverage = CoverageMap::new(&positions, shape);
        let grid = StampGrid::new(side, side)?.with_oversampling(registered.grid.scale as f64)?;
        Ok(StarSamples {
            samples: PsfSamples::new(stamps, SamplePositions::new(positions, Some(shape))?, grid)?,
            sources,
            coverage,
            fwhm_px,
            saturation: self.saturation,
            background: self.background,
            registration: registered.report,
        })
    }

    fn sources(&self, candidates: &[Candidate]) -> Vec<Source> {
        let neighbours = Neighbours::new(candidates.iter().map(|c| (c.x, c.y)));
        let (ny, nx) = self.pixels.dim();
        candidates
            .iter()
            .enumerate()
            .map(|(k, c)| {
                let pixel = |v: f64, n: usize| (v.round().max(0.0) as usize).min(n - 1);
                let at = [pixel(c.y, ny), pixel(c.x, nx)];
                Source {
                    x: c.x,
                    y: c.y,
                    flux: c.flux,
                    snr: c.snr,
                    significance: c.significance,
                    peak: c.peak,
                    background: self.background.level()[at],
                    background_rms: self.background.rms()[at],
                    fwhm_px: c.gaussian.map(|g| g.fwhm_px),
                    e1: c.gaussian.map(|g| g.e1),
                    e2: c.gaussian.map(|g| g.e2),
                    pixel_count: c.pixel_count,
                    nearest_px: neighbours.nearest(c.x, c.y, |j| j != k).map(|(_, d)| d),
                    sample: None,
                    rejected: c.rejected,
                }
            })
            .collect()
    }

    /// Fluxes of the sources that are no samples: the nearest sample's PSF fitted to them.
    fn measure_psf_fluxes(&self, sources: &mut [Source], registered: &Registered, fwhm_px: f64) {
        let splines: Vec<Spline> = registered
            .samples
            .iter()
            .map(|(_, stamp, _)| Spline::through(stamp.view()))
            .collect();
        let nearest = Neighbours::new(registered.samples.iter().map(|(star, ..)| (star.x, star.y)));
        let grid = registered.grid;
        let (middle, scale) = (grid.middle() as f64, grid.scale as f64);
        let aperture = aperture_px(fwhm_px);
        sources
            .par_iter_mut()
            .filter(|source| source.sample.is_none())
            .for_each(|source| {
                let Some((k, _)) = nearest.nearest(source.x, source.y, |_| true) else {
                    return;
                };
                // What is left of a saturated star are its wings.
                let radius = if source.rejected.contains(Rejection::Saturated) {
                    grid.reach as f64
                } else {
                    aperture.min(grid.reach as f64)
                };
                let (mut product, mut power) = (0.0, 0.0);
                for (column, row) in self.disc(source.x, source.y, radius) {
                    if self.saturation.reached_by(self.pixels[[row, column]]) {
                        continue;
                    }
                    let at = |pixel: usize, centre: f64| middle + scale * (pixel as f64 - centre);
                    let psf = splines[k].at(at(column, source.x), at(row, source.y));
                    product += psf * self.excess[[row, column]];
                    power += psf * psf;
                }
                if power > 0.0 {
                    source.flux = product / power;
                }
            });
    }
}
