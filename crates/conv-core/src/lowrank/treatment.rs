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
    /// The power of two that takes what becomes of the whole back, where it was brought near 1.
    pub(crate) back: Option<T>,
}

/// How the light of a tile is convolved at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Whole {
    Directly,
    ByTransforms,
}

/// What may be done with a tile at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ways {
    /// Transforms or the direct sum.
    Both,
    /// Transforms alone: a GPU has nothing else.
    #[cfg(feature = "gpu")]
    Transforms,
}

/// What a choice depends on besides the light and the plan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Choice {
    /// Columns and rows of the light, and of the tile.
    pub(crate) lit_size: (usize, usize),
    pub(crate) tile: (usize, usize),
    pub(crate) kernels: usize,
    /// The cost of drawing a pixel.
    pub(crate) draw: f64,
    pub(crate) ways: Ways,
}

/// Brings a tile's light near 1, in place, where transforms would carry it out of the working precision's range; returns the power of
/// two that takes the result back.
fn rescale<T: ConvReal>(light: &mut Light, plane: &mut [T]) -> Option<T> {
    let scale = Rescaling::<T>::for_largest(light.largest)?;
    for value in plane {
        *value *= scale.down;
    }
    light.largest *= scale.down.as_f64();
    light.total *= scale.down.as_f64();
    Some(scale.back)
}

/// Decides on the light in `workspace.light`; single pixels are taken out of it.
pub(crate) fn treat<T: ConvReal>(
    plan: &Plan<T>,
    mut light: Light,
    choice: Choice,
    workspace: &mut Workspace<T>,
) -> Treatment<T> {
    let back = rescale(&mut light, workspace.light.get_mut());
    let (whole, mut drawn) = choose(plan, light, choice, workspace);
    if let Some(back) = back {
        // Single pixels keep their own light: a stamp needs no sums that could leave the range.
        for (_, _, value) in &mut drawn {
            *value *= back;
        }
    }
    Treatment { whole, drawn, back }
}

/// What is done at once, and the pixels that are drawn.
fn choose<T: ConvReal>(
    plan: &Plan<T>,
    light: Light,
    choice: Choice,
    workspace: &mut Workspace<T>,
) -> (Option<Whole>, Vec<LitPixel<T>>) {
    let Choice {
        lit_size: (columns, rows),
        tile,
        kernels,
        draw,
        ways,
    } = choice;
    // No modes: the PSFs of the tile are zero.
    if kernels == 0 {
        return (None, Vec::new());
    }
    if plan.options.paths() == Paths::Transforms {
        return (Some(Whole::ByTransforms), Vec::new());
    }
    let pitch = plan.fft.pitch();
    let (seconds, direct) = plan.whole_tile(tile, kernels);
    if light.lit as f64 * draw <= seconds {
        let drawn = lit_pixels(workspace.light.get(), pitch, rows, columns);
        return (None, drawn);
    }
    // The direct sum spreads no noise.
    if direct && ways == Ways::Both {
        return (Some(Whole::Directly), Vec::new());
    }
    let most = (2.0 * seconds / draw) as usize;
    let drawn = take_bright(workspace.light.get_mut(), pitch, (rows, columns), light, most);
    (Some(Whole::ByTransforms), drawn)
}
