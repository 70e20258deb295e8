//! Coefficients and fluxes over whole planes, tile by tile.

use std::ops::Range;

use ndarray::parallel::prelude::*;
use ndarray::{Array2, Array3, ArrayView2, ArrayViewMut3, Axis, s};
use psf_types::{FieldError, FrameShape, PixelRegion, Progress, PsfModel};

use crate::{ConvError, ConvReal};

/// Tiles of this many rows and columns are evaluated at once: a few stamps' coefficients of one fit in the L2 cache.
const TILE_ROWS: usize = 16;
const TILE_COLUMNS: usize = 256;

/// Writes the coefficients of a range of stamps over a region, `[stamp, y, x]`, before the division by the flux.
///
/// Where `light` is given, tiles without any light are left as they are, and where the field has no value only lit
/// pixels need one.
pub(crate) fn coefficient_planes<T: ConvReal>(
    model: &PsfModel,
    region: PixelRegion,
    stamps: Range<usize>,
    light: Option<ArrayView2<'_, T>>,
    planes: ArrayViewMut3<'_, T>,
    progress: &dyn Progress,
) -> Result<(), ConvError> {
    for_tiles(region, light, planes, progress, |tile, values| {
        model.coefficients_region_into(tile, stamps.clone(), values.view_mut())
    })
}

/// The flux of the unscaled PSF over a region, or nothing where it is 1 everywhere.
///
/// Where `light` is given, tiles without any light are left at 1, and only lit pixels need a flux.
pub(crate) fn flux_plane<T: ConvReal>(
    model: &PsfModel,
    region: PixelRegion,
    light: Option<ArrayView2<'_, T>>,
    progress: &dyn Progress,
) -> Result<Option<Array2<T>>, ConvError> {
    if !model.needs_flux_scaling() {
        return Ok(None);
    }
    let shape = region.shape();
    let mut plane = Array3::ones((1, shape.ny(), shape.nx()));
    for_tiles(region, light, plane.view_mut(), progress, |tile, values| {
        model.flux_region_into(tile, values.index_axis_mut(Axis(0), 0))
    })?;
    Ok(Some(plane.index_axis_move(Axis(0), 0)))
}

fn region_of(whole: PixelRegion, x: usize, y: usize, nx: usize, ny: usize) -> PixelRegion {
    let shape = FrameShape::new(nx, ny).expect("parts of a region are not empty");
    PixelRegion::new(whole.x0() + x as i64, whole.y0() + y as i64, shape)
}

/// Evaluates tiles in parallel in double precision and stores them in `planes` `[plane, y, x]`.
fn for_tiles<T: ConvReal>(
    region: PixelRegion,
    light: Option<ArrayView2<'_, T>>,
    mut planes: ArrayViewMut3<'_, T>,
    progress: &dyn Progress,
    evaluate: impl Fn(PixelRegion, &mut Array3<f64>) -> Result<(), FieldError> + Sync,
) -> Result<(), ConvError> {
    let (count, _, nx) = planes.dim();
    let strip_work = |strip: usize, mut planes: ArrayViewMut3<'_, T>| {
        progress.still_wanted()?;
        let (y, rows) = (strip * TILE_ROWS, planes.dim().1);
        for x in (0..nx).step_by(TILE_COLUMNS) {
            let columns = TILE_COLUMNS.min(nx - x);
            if light.is_some_and(|f| {
                f.slice(s![y..y + rows, x..x + columns])
                    .iter()
                    .all(rustfft::num_traits::Zero::is_zero)
            }) {
                continue;
            }
            let tile = region_of(region, x, y, columns, rows);
            let mut values = Array3::zeros((count, rows, columns));
            if let Err(error) = evaluate(tile, &mut values) {
                // Perhaps only where it is dark: then nobody needs what cannot be evaluated.
                let Some(light) = light else {
                    return Err(error.into());
                };
                values = planes.slice(s![.., .., x..x + columns]).mapv(T::as_f64);
                let lit = light.slice(s![y..y + rows, x..x + columns]);
                for ((j, i), _) in lit.indexed_iter().filter(|(_, v)| !v.is_zero()) {
                    let mut pixel = Array3::zeros((count, 1, 1));
                    evaluate(region_of(tile, i, j, 1, 1), &mut pixel)?;
                    values.slice_mut(s![.., j..=j, i..=i]).assign(&pixel);
                }
            }
            planes
                .slice_mut(s![.., .., x..x + columns])
                .zip_mut_with(&values, |p, &v| *p = T::nearest(v));
        }
        Ok(())
    };
    let strips: Vec<Result<(), ConvError>> = planes
        .axis_chunks_iter_mut(Axis(1), TILE_ROWS)
        .into_par_iter()
        .enumerate()
        .map(|(strip, planes)| strip_work(strip, planes))
        .collect();
    // The first error in reading order, whichever thread met one first.
    strips.into_iter().collect()
}
