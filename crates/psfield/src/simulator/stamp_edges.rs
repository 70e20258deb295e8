//! Stars whose light ends at the edge of their stamp although it is still bright.

use std::convert::Infallible;

use conv_core::ConvReal;
use psf_types::{FieldError, Position, PsfModel};

use super::{SimulationWarning, Simulator};
use crate::psf::get_or_make;
use crate::scene::Scene;

/// Light at a stamp's edge is not seen below this part of the frame's noise.
const UNSEEN: f64 = 1e-3;

/// The light of a star of flux 1, in flux per pixel.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct StampEdge {
    /// The largest value within a pixel of the stamp's edge.
    edge: f64,
    /// The distance of the edge from the star along x or y, in pixels of the frame.
    radius: f64,
}

impl StampEdge {
    /// The largest values of a model's PSFs at some positions, for stamps that are cut to `size` pixels of the
    /// frame along each side.
    fn of_model(model: &PsfModel, size: Option<usize>, positions: &[Position]) -> Result<Self, FieldError> {
        let grid = model.whole_grid();
        let s = grid.oversampling();
        let half = |centre: f64, count: usize| centre.min((count - 1) as f64 - centre) / s;
        let half = half(grid.centre_x(), grid.nx()).min(half(grid.centre_y(), grid.ny()));
        let radius = size.map_or(half, |size| half.min((size / 2) as f64));
        let mut found = Self {
            radius,
            ..Self::default()
        };
        let is_edge = |(j, i): (usize, usize)| {
            let (x, y) = ((i as f64 - grid.centre_x()) / s, (j as f64 - grid.centre_y()) / s);
            (radius - 1.0..=radius).contains(&x.abs().max(y.abs()))
        };
        for &position in positions {
            found.edge = if let Some(wings) = model.wings().filter(|_| size.is_none()) {
                // The core does not reach their edge, and they are too large to be computed whole.
                let mut coefficients = vec![0.0; wings.mode_count()];
                wings.field().evaluate_into(position, &mut coefficients)?;
                let stamps = wings.stamps();
                let value = |(j, i): (usize, usize)| -> f64 {
                    let modes = coefficients.iter().enumerate();
                    modes.map(|(k, b)| b * f64::from(stamps[[k, j, i]])).sum()
                };
                let (ny, nx) = grid.dim();
                let pixels = (0..ny).flat_map(|j| (0..nx).map(move |i| (j, i)));
                let edge = pixels.filter(|&at| is_edge(at)).map(|at| value(at).abs());
                edge.fold(found.edge, f64::max)
            } else {
                let psf = model.psf_at(position)?;
                let values = psf.values();
                let edge = values.indexed_iter().filter(|(at, _)| is_edge(*at));
                edge.fold(found.edge, |most, (_, v)| most.max(v.abs()))
            };
        }
        Ok(found)
    }
}

impl<T: ConvReal> Simulator<T> {
    /// The edges of the stamps that draw stars. Nothing if the PSF is not known on the frame.
    fn stamp_edge(&self) -> StampEdge {
        let Ok(plan) = self.sources(0) else {
            return StampEdge::default();
        };
        let positions = self.some_positions();
        StampEdge::of_model(plan.model(), plan.size(), &positions).unwrap_or_default()
    }

    /// Returns a warning if stamps end while stars still have light above the floor. Without a floor, the limit
    /// is a thousandth of the frame's noise. None if that is not known, either.
    pub(super) fn cut_stars(&self, scene: &Scene<'_, T>, noise: Option<f64>) -> Option<SimulationWarning> {
        let brightest = scene.stars().map(|star| star.flux().abs()).fold(0.0, f64::max);
        let limit = match self.options().floor {
            0.0 => UNSEEN * noise?,
            floor => floor,
        };
        if brightest == 0.0 {
            return None;
        }
        // Computed once, because every simulated scene asks for warnings.
        let edge = || Ok::<_, Infallible>(self.stamp_edge());
        let Ok(&StampEdge { edge, radius }) = get_or_make(&self.shared.stamp_edge, edge);
        let count = scene
            .stars()
            .filter(|star| star.flux().abs() * edge > limit)
            .count();
        (count > 0).then_some(SimulationWarning::CutStars {
            count,
            radius_px: radius,
            brightest: brightest * edge,
            limit,
        })
    }
}
