//! The choice of the treatment of a tile: the way in which the tile's light is convolved. The
//! choice depends on the light.

use std::iter::Sum;
use std::ops::AddAssign;

use super::processor::{BlockKernels, LightPass};
use super::tile_engine::{LocalTile, Workspace};
use crate::plan::Paths;
use crate::plan::geometry::{Direction, PlacedTile};
use crate::simd::{Lanes, vectorized};
use crate::working_range::{Rescaling, brightest_allowed, contrast};
use crate::{ConvError, ConvReal};

/// Statistics of the light of a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
struct TileLight {
    /// Pixels that are not zero.
    lit: usize,
    /// The largest absolute value.
    largest: f64,
    /// The sum of the absolute values.
    total: f64,
}

/// The number of independent sums, enough to fill a vector of any instruction set.
const LANES: usize = 16;

/// Collects the statistics of light, row by row.
struct Look<T> {
    lit: [u32; LANES],
    largest: [T; LANES],
    total: f64,
}

impl<T: ConvReal> Look<T> {
    fn new() -> Self {
        Self {
            lit: [0; LANES],
            largest: [T::zero(); LANES],
            total: 0.0,
        }
    }

    /// Inspects a row that is padded with zeros to whole vectors.
    #[inline(always)]
    fn add_row(&mut self, row: &[T]) {
        let (mut lit, mut largest, mut sums) = (self.lit, self.largest, [T::zero(); LANES]);
        for chunk in row.chunks_exact(LANES) {
            for i in 0..LANES {
                let value = chunk[i].abs();
                lit[i] += u32::from(value != T::zero());
                largest[i] = if value > largest[i] { value } else { largest[i] };
                sums[i] += value;
            }
        }
        (self.lit, self.largest) = (lit, largest);
        self.total += sums.iter().map(|v| v.as_f64()).sum::<f64>();
    }

    fn light(&self) -> TileLight {
        TileLight {
            lit: self.lit.iter().map(|&n| n as usize).sum(),
            largest: self.largest.iter().map(|v| v.as_f64()).fold(0.0, f64::max),
            total: self.total,
        }
    }
}

/// A pixel of the light in or around a tile: row, column and light. Rows of a layer follow those of the
/// layers before it.
pub(crate) type LitPixel<T> = (usize, usize, T);

/// Returns all lit pixels.
fn lit_pixels<T: ConvReal>(plane: &[T], pitch: usize, (rows, columns): (usize, usize)) -> Vec<LitPixel<T>> {
    let mut pixels = Vec::new();
    for (row, values) in plane.chunks(pitch).take(rows).enumerate() {
        for (n, some) in values[..columns].chunks(LANES).enumerate() {
            // Most pixels are dark, so one test per group is faster than one test per pixel.
            if some.iter().fold(false, |lit, v| lit | !v.is_zero()) {
                let lit = some.iter().enumerate().filter(|(_, v)| !v.is_zero());
                pixels.extend(lit.map(|(i, &value)| (row, n * LANES + i, value)));
            }
        }
    }
    pixels
}

/// Removes very bright pixels from a tile's light and returns them. The rounding noise of their
/// transform would hide faint light. At most `most` pixels are removed, the brightest first.
///
/// Each pixel is compared with the mean of the tile without its `most` brightest pixels. So a
/// bright galaxy of a few hundred pixels does not raise this mean.
fn take_bright<T: ConvReal>(
    plane: &mut [T],
    pitch: usize,
    (rows, columns): (usize, usize),
    light: TileLight,
    most: usize,
) -> Vec<LitPixel<T>> {
    let pixels = rows * columns;
    // In most fully lit tiles no pixel is too bright, and this quick test is enough.
    let rest = light.total - most as f64 * light.largest;
    if light.largest <= contrast::<T>() * rest / pixels as f64 {
        return Vec::new();
    }
    let (rest, lit) = match faint_light(plane, pitch, (rows, columns), most) {
        (rest, lit) if rest > 0.0 => (rest, lit),
        // No other pixels are lit. The bright pixels are compared with their own mean.
        _ => (light.total, light.lit),
    };
    let limit = brightest_allowed::<T>(rest, lit, pixels);
    let mut taken: Vec<LitPixel<T>> = Vec::new();
    if light.lit <= 1 || light.largest <= limit {
        return taken;
    }
    for (row, values) in plane.chunks(pitch).take(rows).enumerate() {
        for (column, &value) in values[..columns].iter().enumerate() {
            if value.abs().as_f64() > limit {
                taken.push((row, column, value));
            }
        }
    }
    // Keeps the brightest. The sort is stable, so pixels of equal brightness keep their order.
    taken.sort_by(|a, b| b.2.abs().as_f64().total_cmp(&a.2.abs().as_f64()));
    taken.truncate(most);
    for &(row, column, _) in &taken {
        plane[row * pitch + column] = T::zero();
    }
    taken
}

/// The sum of the absolute values of the faint lit pixels, and their number. At most `most` pixels
/// are bright, and the limit between faint and bright is a power of 2.
fn faint_light<T: ConvReal>(
    plane: &[T],
    pitch: usize,
    (rows, columns): (usize, usize),
    most: usize,
) -> (f64, usize) {
    const EXPONENTS: usize = 1 << 11;
    let mut by_exponent = vec![(0_usize, 0.0_f64); EXPONENTS];
    for values in plane.chunks(pitch).take(rows) {
        for value in &values[..columns] {
            let value = value.abs().as_f64();
            if value == 0.0 {
                continue;
            }
            let bin = &mut by_exponent[(value.to_bits() >> 52) as usize % EXPONENTS];
            bin.0 += 1;
            bin.1 += value;
        }
    }
    let mut bright = 0;
    let faint = by_exponent.iter().rev().skip_while(|(count, _)| {
        bright += count;
        bright <= most
    });
    faint.fold((0.0, 0), |(total, lit), (count, sum)| (total + sum, lit + count))
}

/// The treatment of a tile.
#[derive(Debug)]
pub(crate) struct Treatment<T> {
    /// The method for the tile's light as a whole. `None` if nothing remains to be convolved.
    pub(crate) method: Option<TileMethod>,
    /// Pixels drawn stamp by stamp. If there is a method, they have been removed from the tile's
    /// light.
    pub(crate) drawn: Vec<LitPixel<T>>,
    /// The power of two that scales the result of `method` back, if the light was scaled to values
    /// near 1.
    pub(crate) back: Option<T>,
}

/// The method of convolution for the light of a tile as a whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TileMethod {
    Directly,
    ByTransforms,
}

/// Scales a tile's light to values near 1, in place, if transforms would overflow or underflow in
/// the working precision. Returns the power of two that scales the result back.
fn rescale<T: ConvReal>(light: &mut TileLight, plane: &mut [T]) -> Option<T> {
    let scale = Rescaling::<T>::for_largest(light.largest)?;
    for value in plane {
        *value *= scale.down;
    }
    light.largest *= scale.down.as_f64();
    light.total *= scale.down.as_f64();
    Some(scale.back)
}

/// Returns the method for the light in `workspace.light` as a whole, and the pixels to be drawn
/// stamp by stamp. If there are both, removes these pixels from the light. `(columns, rows)` is the
/// size of the light and `tile` the size of the tile. Drawing one pixel costs `draw` seconds.
fn choose<T: ConvReal>(
    pass: &LightPass<'_, T>,
    light: TileLight,
    (columns, rows): (usize, usize),
    tile: (usize, usize),
    (kernels, draw): (usize, f64),
    workspace: &mut Workspace<T>,
) -> (Option<TileMethod>, Vec<LitPixel<T>>) {
    let (plan, pitch) = (&pass.processor.plan, pass.processor.fft.pitch());
    if plan.options().paths() == Paths::Transforms {
        return (Some(TileMethod::ByTransforms), Vec::new());
    }
    let (seconds, direct) = plan.whole_tile(tile, kernels);
    if light.lit as f64 * draw <= seconds {
        let drawn = lit_pixels(workspace.light.get(), pitch, (rows, columns));
        return (None, drawn);
    }
    // The direct sum spreads no noise, so bright pixels stay in the tile.
    if direct && pass.direct_sums {
        return (Some(TileMethod::Directly), Vec::new());
    }
    let most = (2.0 * seconds / draw) as usize;
    let drawn = take_bright(workspace.light.get_mut(), pitch, (rows, columns), light, most);
    (Some(TileMethod::ByTransforms), drawn)
}

/// Loads the light of a tile, or the light around it, into `workspace.light`, layer after layer, and
/// chooses its treatment. Returns `None` if the light or the PSFs are zero everywhere. The progress object is polled here,
/// once per tile.
pub(crate) fn treated<T: ConvReal>(
    pass: &LightPass<'_, T>,
    kernels: &BlockKernels<'_, T>,
    tile: PlacedTile,
    workspace: &mut Workspace<T>,
) -> Result<Option<Treatment<T>>, ConvError> {
    pass.progress.check_cancelled()?;
    let (plan, direction) = (&pass.processor.plan, pass.direction());
    let engine = pass.tile_engine();
    let pitch = engine.fft.pitch();
    let [(corner, size), _] = plan.geometry.light_and_result(direction, tile);
    let layer_len = size.1 * pitch;
    if pass.light.len() > 1 {
        workspace.light.at_least(pass.light.len() * layer_len);
    }
    // All layers, as rows of one array.
    let size = (size.0, size.1 * pass.light.len());
    let mut seen = vectorized!({
        let corner = (corner.0, corner.1 - pass.first_light as i64);
        let layers = workspace.light.get_mut().chunks_mut(layer_len);
        let (mut seen, of_layer) = (Look::new(), (size.0, layer_len / pitch));
        for (light, into) in pass.light.iter().zip(layers) {
            engine.load(
                light.view(),
                corner,
                of_layer,
                into,
                #[inline(always)]
                |row| seen.add_row(row),
            );
        }
        seen.light()
    });
    if seen.lit == 0 {
        return Ok(None);
    }
    let plane = workspace.light.get();
    kernels.check(tile, &pass.layers, |layer, column, row| match direction {
        Direction::Scatter => !plane[layer * layer_len + row * pitch + column].is_zero(),
        // A pixel needs its PSF if any light reaches it.
        Direction::Gather => (row..row + engine.geometry.stamp.1).any(|row| {
            let under = &plane[row * pitch + column..][..engine.geometry.stamp.0];
            under.iter().any(|v| !v.is_zero())
        }),
    })?;
    let count = kernels.block.kernel_count();
    if count == 0 {
        return Ok(None);
    }
    let draw = plan.cost.draw(direction, engine.geometry.stamp, count);
    let back = rescale(&mut seen, workspace.light.get_mut());
    let (method, mut drawn) = choose(pass, seen, size, tile.size, (count, draw), workspace);
    if let Some(back) = back {
        // Scales the single pixels back before they are drawn: drawing a stamp has no sums that
        // could leave the range.
        for (_, _, value) in &mut drawn {
            *value *= back;
        }
    }
    Ok(Some(Treatment { method, drawn, back }))
}

/// The number of tiles for each way of convolving their light, and the work that they needed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct TileCounts {
    /// Tiles without light, or with PSFs that are zero.
    pub dark: usize,
    /// Tiles whose few lit pixels were drawn stamp by stamp.
    pub drawn: usize,
    /// Tiles convolved by the direct sum.
    pub direct: usize,
    /// Tiles convolved by transforms.
    pub transformed: usize,
    /// All pixels drawn stamp by stamp. This includes very bright pixels of transformed tiles,
    /// whose rounding noise would have hidden faint light.
    pub drawn_pixels: usize,
    /// The modes of all transformed tiles, added up. The reference counts as a mode.
    pub modes: usize,
}

impl AddAssign for TileCounts {
    fn add_assign(&mut self, other: Self) {
        self.dark += other.dark;
        self.drawn += other.drawn;
        self.direct += other.direct;
        self.transformed += other.transformed;
        self.drawn_pixels += other.drawn_pixels;
        self.modes += other.modes;
    }
}

impl Sum for TileCounts {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |mut sum, counts| {
            sum += counts;
            sum
        })
    }
}

impl TileCounts {
    pub(crate) fn count<T>(&mut self, treatment: &Treatment<T>, modes: usize) {
        self.drawn_pixels += treatment.drawn.len();
        match treatment.method {
            Some(TileMethod::Directly) => self.direct += 1,
            Some(TileMethod::ByTransforms) => {
                self.transformed += 1;
                self.modes += modes;
            }
            None => self.drawn += 1,
        }
    }

    /// The number of all tiles.
    pub fn tiles(&self) -> usize {
        self.dark + self.drawn + self.direct + self.transformed
    }
}

/// Inspects the tiles of a block one by one and calls `convolve` for each lit tile whose PSFs are not
/// zero, with its light in `workspace.light`.
pub(crate) fn each_tile<T: ConvReal, S: Lanes<T>>(
    simd: S,
    pass: &LightPass<'_, T>,
    (column, row): (usize, usize),
    kernels: &mut BlockKernels<'_, T>,
    workspace: &mut Workspace<T>,
    mut convolve: impl FnMut(LocalTile<'_, T>, &Treatment<T>, &mut Workspace<T>),
) -> Result<TileCounts, ConvError> {
    let plan = &pass.processor.plan;
    let mut counts = TileCounts::default();
    let (across, up) = (&plan.tiling.columns[column], &plan.tiling.rows[row]);
    // The only tile of a block transforms each kernel itself, if this changes no bit of the result.
    let is_alone = across.tiles.len() * up.tiles.len() == 1 && !kernels.are_shared;
    let is_narrow = pass.processor.fft.is_narrow(plan.geometry.stamp.0);
    let transforms_kernels = pass.direction() == Direction::Scatter && is_alone && is_narrow;
    for (y, rows, below) in up.placed() {
        for (x, columns, left) in across.placed() {
            let tile = PlacedTile {
                first: (x, y),
                corner: (left, below),
                size: (columns, rows),
            };
            let Some(treatment) = treated(pass, kernels, tile, workspace)? else {
                counts.dark += 1;
                continue;
            };
            counts.count(&treatment, kernels.block.kernel_count());
            if treatment.method == Some(TileMethod::ByTransforms) && !transforms_kernels {
                kernels.transform(simd, &pass.tile_engine(), workspace);
            }
            let local = LocalTile {
                tile,
                layers: (pass.layers.start, pass.layers.len()),
                table: kernels.table(),
                stamps: kernels.stamps(),
                transforms_kernels,
            };
            convolve(local, &treatment, workspace);
        }
    }
    Ok(counts)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn look(plane: &[f32], pitch: usize, (rows, columns): (usize, usize)) -> TileLight {
        let mut look = Look::new();
        for row in plane.chunks(pitch).take(rows) {
            look.add_row(&row[..columns.next_multiple_of(LANES).min(pitch)]);
        }
        look.light()
    }

    #[test]
    fn bright_pixels_are_taken_until_the_rest_is_even() {
        let (pitch, rows, columns) = (48, 30, 20);
        let mut plane = vec![0.0_f32; pitch * rows];
        for row in 0..rows {
            for column in 0..columns {
                plane[row * pitch + column] = 1.0;
            }
        }
        plane[3 * pitch + 4] = 1e8;
        plane[5 * pitch + 6] = -1e5;
        let light = look(&plane, pitch, (rows, columns));
        assert_eq!((light.lit, light.largest), (600, 1e8));
        let taken = take_bright(&mut plane, pitch, (rows, columns), light, 10);
        assert_eq!(taken, [(3, 4, 1e8), (5, 6, -1e5)]);
        let light = look(&plane, pitch, (rows, columns));
        assert_eq!((light.lit, light.largest, light.total), (598, 1.0, 598.0));
        // A bright galaxy does not raise the mean that it is compared with. Pixels beyond the
        // number that may be drawn stay in the tile.
        for row in 10..14 {
            plane[row * pitch + 2..row * pitch + 5].fill(1e7);
        }
        let light = look(&plane, pitch, (rows, columns));
        let mut copy = plane.clone();
        assert_eq!(
            take_bright(&mut copy, pitch, (rows, columns), light, 20).len(),
            12
        );
        assert_eq!(look(&copy, pitch, (rows, columns)).largest, 1.0);
        assert!(take_bright(&mut plane, pitch, (rows, columns), light, 8).len() <= 8);
        for row in 10..14 {
            plane[row * pitch + 2..row * pitch + 5].fill(1.0);
        }
        let light = look(&plane, pitch, (rows, columns));
        assert!(take_bright(&mut plane, pitch, (rows, columns), light, 10).is_empty());
        assert_eq!(lit_pixels(&plane, pitch, (rows, columns)).len(), light.lit);
    }
}
