//! The choice of what to do with a tile.

use super::light::{Light, LitPixel, lit_pixels, take_bright};
use super::options::Paths;
use super::plan::Plan;
use super::workspace::Workspace;
use crate::ConvReal;
use crate::working_range::Rescaling;

/// How a tile is treated.
#[derive(Debug)]
pub(crate) struct Treatment<T> {
    /// Its light at once, directly or by transforms.
    pub(crate) whole: Option<Whole>,
    /// Pixels drawn stamp by stamp, which are not part of that light.
    pub(crate) drawn: Vec<LitPixel<T>>,
}

/// How the light of a tile is convolved at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Whole {
    Directly,
    ByTransforms,
}

/// Brings a tile's light near 1, in place, where transforms would carry it out of the working precision's range; returns the power of
/// two that takes the result back.
pub(crate) fn rescale<T: ConvReal>(light: &mut Light, plane: &mut [T]) -> Option<T> {
    let scale = Rescaling::<T>::for_largest(light.largest)?;
    for value in plane {
        *value *= scale.down;
    }
    light.largest *= scale.down.as_f64();
    light.total *= scale.down.as_f64();
    Some(scale.back)
}

impl<T: ConvReal> Treatment<T> {
    /// Gives single pixels their own light back: a stamp needs no sums that could leave the range.
    pub(crate) fn take_back(&mut self, back: T) {
        for (_, _, value) in &mut self.drawn {
            *value *= back;
        }
    }
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
        return Treatment {
            whole: None,
            drawn: Vec::new(),
        };
    }
    if plan.options.paths() == Paths::Transforms {
        return Treatment {
            whole: Some(Whole::ByTransforms),
            drawn: Vec::new(),
        };
    }
    let pitch = plan.fft.pitch();
    let (seconds, direct) = plan.whole_tile(tile, kernels);
    if light.lit as f64 * draw <= seconds {
        return Treatment {
            whole: None,
            drawn: lit_pixels(workspace.light.get(), pitch, lit_size.1, lit_size.0),
        };
    }
    // The direct sum spreads no noise.
    let (whole, drawn) = if direct {
        (Whole::Directly, Vec::new())
    } else {
        let most = (2.0 * seconds / draw) as usize;
        let size = (lit_size.1, lit_size.0);
        (
            Whole::ByTransforms,
            take_bright(workspace.light.get_mut(), pitch, size, light, most),
        )
    };
    Treatment {
        whole: Some(whole),
        drawn,
    }
}
