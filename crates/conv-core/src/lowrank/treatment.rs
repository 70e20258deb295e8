//! The choice of what to do with a tile.

use super::light::{Light, LitPixel, lit_pixels, take_bright};
use super::options::Paths;
use super::plan::Plan;
use super::workspace::Workspace;
use crate::ConvReal;

/// How a tile is treated.
#[derive(Debug)]
pub(crate) enum Treatment<T> {
    Dark,
    /// Stamp by stamp.
    Drawn(Vec<LitPixel<T>>),
    /// The rest of the light at once, after single pixels were taken out of it.
    Whole {
        direct: bool,
        apart: Vec<LitPixel<T>>,
    },
}

/// Decides on the light in `workspace.light`, `lit_size` columns and rows; single pixels are taken out of it. `draw` is the
/// cost of drawing one.
pub(crate) fn treat<T: ConvReal>(
    plan: &Plan<T>,
    light: Light,
    lit_size: (usize, usize),
    tile: (usize, usize),
    kernels: usize,
    draw: f64,
    workspace: &mut Workspace<T>,
) -> Treatment<T> {
    // No modes: the PSFs of the tile are zero.
    if kernels == 0 {
        return Treatment::Dark;
    }
    if plan.options.paths() == Paths::Transforms {
        return Treatment::Whole {
            direct: false,
            apart: Vec::new(),
        };
    }
    let pitch = plan.fft.pitch();
    let (whole, direct) = plan.whole_tile(tile, kernels);
    if light.lit as f64 * draw <= whole {
        return Treatment::Drawn(lit_pixels(workspace.light.get(), pitch, lit_size.1, lit_size.0));
    }
    // The direct sum spreads no noise.
    let apart = if direct {
        Vec::new()
    } else {
        let most = (2.0 * whole / draw) as usize;
        take_bright(
            workspace.light.get_mut(),
            pitch,
            (lit_size.1, lit_size.0),
            light,
            most,
        )
    };
    Treatment::Whole { direct, apart }
}
