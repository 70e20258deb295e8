//! A tile's light, looked at: what both devices do before they convolve it.

use super::job::Job;
use super::light::look;
use super::prepared::Prepared;
use super::tile_engine::TilePart;
use super::treatment::{Choice, Treatment, Ways, treat};
use super::workspace::Workspace;
use crate::simd::Lanes;
use crate::{ConvError, ConvReal};

/// Which way a job goes through the operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Direction {
    /// From the side that PSFs belong to: a tile's own light spreads.
    Scatter,
    /// To that side: the light around a tile is gathered.
    Gather,
}

/// A tile of the weighted side.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PlacedTile {
    /// Its first pixel on the weighted side.
    pub(crate) first: (usize, usize),
    /// Its place in its block, and its size.
    pub(crate) part: TilePart,
}

/// Loads a tile's light, or that around it, into `workspace.light` and decides how it is treated; nothing where it is dark. Pixels that are
/// drawn apart are no longer part of that light. A tile is also where work can be stopped.
pub(crate) fn treated<T: ConvReal, S: Lanes<T>>(
    simd: S,
    job: &Job<'_, T>,
    prepared: &mut Prepared<'_, T>,
    direction: Direction,
    tile: PlacedTile,
    ways: Ways,
    workspace: &mut Workspace<T>,
) -> Result<Option<Treatment<T>>, ConvError> {
    job.progress.still_wanted()?;
    let plan = job.plan;
    let engine = plan.engine(job.flip);
    let pitch = plan.fft.pitch();
    let (corner, size) = match direction {
        Direction::Scatter => ((tile.first.0 as i64, tile.first.1 as i64), tile.part.size),
        Direction::Gather => (
            plan.geometry.reach_from(tile.first.0, tile.first.1),
            engine.around(tile.part.size),
        ),
    };
    let seen = simd.vectorized(
        #[inline(always)]
        || {
            let corner = (corner.0, corner.1 - job.first_light as i64);
            engine.load(simd, job.light, corner, size, workspace.light.get_mut());
            look(workspace.light.get(), pitch, size.1, size.0)
        },
    );
    if seen.lit == 0 {
        return Ok(None);
    }
    let plane = workspace.light.get();
    prepared.check(tile.part, |column, row| match direction {
        Direction::Scatter => !plane[row * pitch + column].is_zero(),
        // A pixel needs its PSF where any light reaches it.
        Direction::Gather => (row..row + engine.stamp.1).any(|row| {
            let under = &plane[row * pitch + column..][..engine.stamp.0];
            under.iter().any(|v| !v.is_zero())
        }),
    })?;
    let kernels = prepared.kernel_count();
    let draw = match direction {
        Direction::Scatter => plan.cost.draw(engine.stamp, kernels),
        Direction::Gather => plan.cost.draw_gathered(engine.stamp, kernels),
    };
    let choice = Choice {
        lit_size: size,
        tile: tile.part.size,
        kernels,
        draw,
        ways,
    };
    Ok(Some(treat(plan, seen, choice, workspace)))
}
