//! Coefficients and fluxes over whole planes, tile by tile.

use std::ops::Range;

use ndarray::parallel::prelude::*;
use ndarray::{Array2, Array3, ArrayView2, ArrayViewMut3, Axis, s};
use psf_types::{FieldError, FrameShape, PixelRegion, PsfModel};

use crate::ConvReal;

/// Tiles of this many rows and columns are evaluated at once: a few stamps' coefficients of one fit in the L2 cache.
const TILE_ROWS: usize = 16;
const TILE_COLUMNS: usize = 256;

/// Writes the coefficients of a range of stamps over a region, `[stamp, y, x]`, before the division by the flux.
///
/// Where `light` is given, tiles without any light are left at 0.
pub(crate) fn coefficient_planes<T: ConvReal>(
    model: &PsfModel,
    region: PixelRegion,
    stamps: Range<usize>,
    light: Option<ArrayView2<'_, T>>,
    planes: ArrayViewMut3<'_, T>,
) -> Result<(), FieldError> {
    for_tiles(region, light, planes, |tile, values| {
        model.coefficients_region_into(tile, stamps.clone(), values.view_mut())
    })
}

/// The flux of the unscaled PSF over a region, or nothing where it is 1 everywhere.
///
/// Where `light` is given, tiles without any light are left at 1.
pub(crate) fn flux_plane<T: ConvReal>(
    model: &PsfModel,
    region: PixelRegion,
    light: Option<ArrayView2<'_, T>>,
) -> Result<Option<Array2<T>>, FieldError> {
    if !model.needs_flux_scaling() {
        return Ok(None);
    }
    let shape = region.shape();
    let mut plane = Array3::ones((1, shape.ny(), shape.nx()));
    for_tiles(region, light, plane.view_mut(), |tile, values| {
        model.flux_region_into(tile, values.index_axis_mut(Axis(0), 0))
    })?;
    Ok(Some(plane.index_axis_move(Axis(0), 0)))
}

/// Evaluates tiles in parallel in double precision and stores them in `planes` `[plane, y, x]`.
fn for_tiles<T: ConvReal>(
    region: PixelRegion,
    light: Option<ArrayView2<'_, T>>,
    mut planes: ArrayViewMut3<'_, T>,
    evaluate: impl Fn(PixelRegion, &mut Array3<f64>) -> Result<(), FieldError> + Sync,
) -> Result<(), FieldError> {
    let (count, _, nx) = planes.dim();
    let strip_work = |strip: usize, mut planes: ArrayViewMut3<'_, T>| {
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
            let shape = FrameShape::new(columns, rows).expect("tiles are not empty");
            let mut values = Array3::zeros((count, rows, columns));
            evaluate(
                PixelRegion::new(region.x0() + x as i64, region.y0() + y as i64, shape),
                &mut values,
            )?;
            planes
                .slice_mut(s![.., .., x..x + columns])
                .zip_mut_with(&values, |p, &v| *p = T::nearest(v));
        }
        Ok(())
    };
    let strips: Vec<Result<(), FieldError>> = planes
        .axis_chunks_iter_mut(Axis(1), TILE_ROWS)
        .into_par_iter()
        .enumerate()
        .map(|(strip, planes)| strip_work(strip, planes))
        .collect();
    // The first error in reading order, whichever thread met one first.
    strips.into_iter().collect()
}
