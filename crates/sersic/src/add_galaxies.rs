//! Galaxies onto an image.

use ndarray::{ArrayView2, ArrayViewMut2, s};
use psf_types::{Cancelled, NoProgress, Progress, Real, SersicSource};
use rayon::prelude::*;

use crate::profile::Profile;
use crate::tile::{Rules, TILE, Tile};

/// Tiles are made in parallel, this many at a time, so that only so many are in memory.
const AT_ONCE: usize = 64;

/// Adds galaxies to an image `[y, x]` whose first pixel is the pixel `(x0, y0) = first_pixel` of the scene in which the galaxies'
/// positions count (0-based, an integer is the centre of a pixel).
///
/// Each pixel gets the flux that falls on its area. Galaxies may lie partly or wholly off the image. A galaxy's flux is that to infinite
/// radius: what lies off the image is not made up for. Accuracy: see the [crate's page](crate).
///
/// An image drawn in parts, each with its own first pixel, is the image drawn at once; the number of threads changes nothing. Memory:
/// some tiles of 128 x 128 pixels. Time grows with the number of galaxies times the number of tiles that their light reaches;
/// galaxies of `re` 3 pixels take about 1 ms each on one core, most of it for the pixels within some 50 pixels of the centre.
pub fn add_galaxies<T: Real>(
    image: ArrayViewMut2<'_, T>,
    first_pixel: (i64, i64),
    galaxies: &[SersicSource],
) {
    add_galaxies_with_progress(image, first_pixel, galaxies, &NoProgress)
        .expect("whoever is told nothing stops nothing");
}

/// [`add_galaxies`], which tells how far it has come, in tiles, and asks whether it is still wanted, every few milliseconds.
///
/// # Errors
/// [`Cancelled`]: some of the light may have been added.
pub fn add_galaxies_with_progress<T: Real>(
    mut image: ArrayViewMut2<'_, T>,
    first_pixel: (i64, i64),
    galaxies: &[SersicSource],
    progress: &dyn Progress,
) -> Result<(), Cancelled> {
    let (ny, nx) = image.dim();
    if nx == 0 || ny == 0 {
        return Ok(());
    }
    let profiles: Vec<Profile> = galaxies
        .par_iter()
        .filter(|galaxy| galaxy.flux() != 0.0)
        .map(|galaxy| progress.still_wanted().map(|()| Profile::new(galaxy)))
        .collect::<Result<_, Cancelled>>()?;
    if profiles.is_empty() {
        return Ok(());
    }
    let rules = Rules::new();
    // Tiles lie the same in the scene wherever the image begins.
    let tiles_along = |first: i64, length: usize| {
        let tile = TILE as i64;
        let start = first.div_euclid(tile) * tile;
        (start..first + length as i64).step_by(TILE)
    };
    let corners: Vec<(i64, i64)> = tiles_along(first_pixel.1, ny)
        .flat_map(|y| tiles_along(first_pixel.0, nx).map(move |x| (x, y)))
        .collect();
    progress.start(corners.len() as u64);
    for some in corners.chunks(AT_ONCE) {
        let drawn: Vec<Vec<f64>> = some
            .par_iter()
            .map(|&(x, y)| {
                let mut tile = Tile::new(&rules, x, y);
                for galaxy in &profiles {
                    tile.add(galaxy, progress)?;
                }
                progress.advance(1);
                Ok(tile.into_pixels())
            })
            .collect::<Result<_, Cancelled>>()?;
        for (&(x, y), pixels) in some.iter().zip(drawn) {
            add_tile(&mut image, x - first_pixel.0, y - first_pixel.1, &pixels);
        }
    }
    Ok(())
}

/// Adds the part of a tile that lies on the image.
fn add_tile<T: Real>(image: &mut ArrayViewMut2<'_, T>, column: i64, row: i64, pixels: &[f64]) {
    let tile = ArrayView2::from_shape((TILE, TILE), pixels).expect("a tile's pixels");
    let overlap = |first: i64, length: usize| {
        let start = first.max(0);
        let end = (first + TILE as i64).min(length as i64);
        (
            start as usize..end as usize,
            (start - first) as usize..(end - first) as usize,
        )
    };
    let (ny, nx) = image.dim();
    let ((to_rows, from_rows), (to_columns, from_columns)) = (overlap(row, ny), overlap(column, nx));
    let mut target = image.slice_mut(s![to_rows, to_columns]);
    target.zip_mut_with(&tile.slice(s![from_rows, from_columns]), |pixel, &light| {
        *pixel += T::nearest(light);
    });
}
