//! Point sources at sub-pixel positions.

use std::sync::{Arc, OnceLock};

use ndarray::{Array1, Array2, Array3, ArrayView2, ArrayViewMut2, Axis, s};
use psf_types::{
    Anchor, DataError, PixelRegion, PointSource, Position, Progress, PsfModel, StampGrid, Uncounted,
};
use rayon::prelude::*;

use super::phases::Star;
use crate::overlap::{Piece, add_in_order, shared};
use crate::sources::{check_stamps, with_slopes};
use crate::stamp_interpolator::{Kernel, MOST_TAPS, StampInterpolator, Taps, edge_reach_of, grid_reaching};
use crate::view::region;
use crate::{ConvError, ConvReal};

/// The number of sources that one task draws.
const PER_TASK: usize = 32;
/// The most tasks of [`StarPainter::at_pixels`], which each hold a sum for every pixel.
const TASKS: usize = 64;
/// [`StarPainter::at_pixels`] holds the interpolators of as many components as have so many pixels, and of one at
/// least.
const PIXELS_IN_MEMORY: usize = 1 << 25;

/// Draws stars one by one in f64, each from all components of the model. It is the reference for
/// [`crate::SourcePlan`], and supports every model and anchoring.
#[derive(Debug)]
pub struct StarPainter<'a> {
    pub(super) model: &'a PsfModel,
    pub(super) frame: PixelRegion,
    /// The painters of one [`crate::SourcePlan`] share it.
    pub(super) stamps: Arc<StarStamps>,
}

/// The interpolation of the PSFs of a model's stars.
#[derive(Debug)]
pub(super) struct StarStamps {
    /// Reaches as far beyond the stamps as their edges require ([`edge_reach_of`]).
    pub(super) kernel: Kernel,
    /// A grid at the frame's scale that holds the stamp for any position of the source in its
    /// pixel, truncated to the size of stars if there is one.
    pub(super) target: StampGrid,
    /// The interpolators of all stamps, for output-anchored painters. Computed when first needed.
    splines: Option<OnceLock<Vec<StampInterpolator>>>,
}

impl StarStamps {
    /// Checks that the stamps suit stars. The models share their stamps.
    pub(super) fn new(models: &[PsfModel], anchor: Anchor, size: Option<usize>) -> Result<Self, ConvError> {
        let grid = models[0].grid();
        check_stamps(grid, size)?;
        let beyond = models.iter().map(edge_reach_of).max();
        let kernel = Kernel::of(grid.interpolation(), beyond.unwrap_or(0));
        Ok(Self {
            kernel,
            target: target_of(grid, kernel, size).map_err(ConvError::Result)?,
            splines: (anchor == Anchor::Output).then(OnceLock::new),
        })
    }

    /// The pixels that a star may light, relative to the pixel that the star lies on.
    pub(super) fn window(&self) -> PixelRegion {
        window_of(self.target)
    }
}

/// The pixels of a grid at the frame's scale, relative to the pixel that its centre lies on.
pub(super) fn window_of(target: StampGrid) -> PixelRegion {
    let first = [target.centre_x(), target.centre_y()].map(|centre| -(centre as i64));
    region(first[0], first[1], (target.nx(), target.ny()))
}

/// A grid at the frame's scale that holds a stamp for any position of the source in its pixel, truncated to the
/// size of stars if there is one.
pub(super) fn target_of(
    grid: StampGrid,
    kernel: Kernel,
    size: Option<usize>,
) -> Result<StampGrid, DataError> {
    grid_reaching(grid, |room, side| {
        let reach = ((room + kernel.reach()) / grid.oversampling() + 0.5).ceil() as usize;
        size.map_or(reach, |size| reach.min([size / 2, size - 1 - size / 2][side]))
    })
}

impl<'a> StarPainter<'a> {
    /// A painter for a frame, which is a region of the scene. Sources are given in pixels of the
    /// scene. If `size` is given, each star is truncated to `size` columns and rows. The pixel that
    /// the star lies on has index `size / 2` in both.
    ///
    /// # Errors
    /// [`ConvError::PixelResponse`] if the stamps do not include the pixel response,
    /// [`ConvError::StampSize`] if `size` is 0.
    pub fn new(
        model: &'a PsfModel,
        frame: PixelRegion,
        anchor: Anchor,
        size: Option<usize>,
    ) -> Result<Self, ConvError> {
        Ok(Self {
            model,
            frame,
            stamps: Arc::new(StarStamps::new(std::slice::from_ref(model), anchor, size)?),
        })
    }

    /// Computes the sources' light in single pixels `(column, row)` of the frame. The time grows with the
    /// number of pairs of a source and a pixel that it lights. Beside it, each component is made ready for
    /// interpolation once.
    ///
    /// # Errors
    /// [`ConvError`] if a PSF that is needed has no value. A source-anchored painter needs the PSF
    /// at every source that reaches one of the pixels. An output-anchored painter needs the PSF at
    /// these pixels.
    pub fn at_pixels(
        &self,
        sources: &[PointSource],
        pixels: &[(usize, usize)],
    ) -> Result<Vec<f64>, ConvError> {
        let sorted = SortedPixels::new(pixels);
        let lights_some = |source: &&PointSource| sorted.within(self.lit(source)).next().is_some();
        let hit: Vec<&PointSource> = sources
            .par_iter()
            .filter(|source| self.reaches(source))
            .filter(lights_some)
            .collect();
        if hit.is_empty() {
            return Ok(vec![0.0; pixels.len()]);
        }
        let grid = self.model.grid();
        let at_once = (PIXELS_IN_MEMORY / grid.pixel_count()).max(1);
        let of_task = hit.len().div_ceil(TASKS);
        let (mut values, mut first) = (vec![0.0; pixels.len()], 0);
        for stamps in self.model.stamps().axis_chunks_iter(Axis(0), at_once) {
            let interpolators: Vec<StampInterpolator> = (0..stamps.len_of(Axis(0)))
                .into_par_iter()
                .map(|k| {
                    let stamp = stamps.index_axis(Axis(0), k);
                    StampInterpolator::with_kernel(stamp, grid, self.stamps.kernel)
                })
                .collect();
            let of_tasks: Vec<Vec<f64>> = hit
                .par_chunks(of_task)
                .map(|sources| {
                    let mut sums = vec![0.0; pixels.len()];
                    for source in sources {
                        let lit: Vec<_> = sorted.within(self.lit(source)).collect();
                        self.add_at_pixels((source, &lit), (&interpolators, first), pixels, &mut sums)?;
                    }
                    Ok(sums)
                })
                .collect::<Result<_, ConvError>>()?;
            for (pixel, value) in values.iter_mut().enumerate() {
                *value += of_tasks.iter().map(|sums| sums[pixel]).sum::<f64>();
            }
            first += interpolators.len();
        }
        Ok(values)
    }

    /// Adds a source's light to `sums`, one for each pixel, from the components of `interpolators`, which begin with
    /// component `first`.
    fn add_at_pixels(
        &self,
        (source, lit): (&PointSource, &[(usize, usize, usize)]),
        (interpolators, first): (&[StampInterpolator], usize),
        pixels: &[(usize, usize)],
        sums: &mut [f64],
    ) -> Result<(), ConvError> {
        let star = Star::new(source, self.frame);
        let (ours, target) = (self.model.grid(), self.stamps.target);
        let s = ours.oversampling();
        let taps = |length, shift: f64, centre: [f64; 2], at: &dyn Fn(usize) -> usize| {
            let coordinate = |pair| centre[0] + s * (at(pair) as f64 - centre[1] - shift);
            Taps::new(self.stamps.kernel, length, 0.0, lit.len(), coordinate)
        };
        let (dx, dy) = star.shift;
        let taps_x = taps(ours.nx(), dx, [ours.centre_x(), target.centre_x()], &|p| lit[p].2);
        let taps_y = taps(ours.ny(), dy, [ours.centre_y(), target.centre_y()], &|p| lit[p].1);
        let mut coefficients = vec![0.0; self.model.stamp_count()];
        let anchor_is_output = self.stamps.splines.is_some();
        if !anchor_is_output {
            let (x, y) = star.position;
            let position = Position::new(x, y).map_err(ConvError::Result)?;
            self.model.scaled_coefficients_into(position, &mut coefficients)?;
        }
        for (pair, &(index, _, _)) in lit.iter().enumerate() {
            if anchor_is_output {
                let (x, y) = pixels[index];
                let position = Position::of_pixel(x as i64, y as i64);
                self.model.scaled_coefficients_into(position, &mut coefficients)?;
            }
            let (x, y) = (taps_x.of(pair), taps_y.of(pair));
            let terms = interpolators.iter().zip(&coefficients[first..]);
            let psf: f64 = terms.map(|(interpolator, a)| a * interpolator.at(x, y)).sum();
            sums[index] += psf * source.flux();
        }
        Ok(())
    }

    /// Gives the index of every source that may light some pixels `(column, row)` of the frame to `take`,
    /// with the indices of these pixels, and whether they lie on the source's stamp. The others lie up to
    /// 6 pixels beyond it, where a [`SourcePlan`](crate::SourcePlan) may keep some light.
    pub fn lit_pixels(
        &self,
        sources: &[PointSource],
        pixels: &[(usize, usize)],
        mut take: impl FnMut(usize, &mut dyn Iterator<Item = (usize, bool)>),
    ) {
        let sorted = SortedPixels::new(pixels);
        for (number, source) in sources.iter().enumerate() {
            let lit = self.lit(source);
            let (nx, ny) = (lit.shape().nx(), lit.shape().ny());
            let more = MOST_TAPS;
            let around = region(
                lit.x0() - more as i64,
                lit.y0() - more as i64,
                (nx + 2 * more, ny + 2 * more),
            );
            let on = |at: usize, count: usize| (more..more + count).contains(&at);
            let mut lit = sorted
                .within(around)
                .map(|(index, j, i)| (index, on(j, ny) && on(i, nx)))
                .peekable();
            if lit.peek().is_some() {
                take(number, &mut lit);
            }
        }
    }

    /// Adds sources to a part of the image. `image` holds the pixels `[y, x]` of `region`, which is
    /// in pixels of the frame. `progress` is polled and may cancel the work. No steps are reported
    /// to it.
    ///
    /// # Errors
    /// [`ConvError::Cancelled`], and [`ConvError`] if a PSF that is needed has no value. A
    /// source-anchored painter needs the PSF at every source that reaches the region. An
    /// output-anchored painter needs the PSF at every frame pixel that such a source may light.
    ///
    /// # Panics
    /// If `image` does not have the region's shape.
    #[inline(never)]
    pub fn draw_into<S: ConvReal>(
        &self,
        sources: &[PointSource],
        region: PixelRegion,
        image: ArrayViewMut2<'_, S>,
        progress: &dyn Progress,
    ) -> Result<(), ConvError> {
        let shape = region.shape();
        assert_eq!(image.dim(), (shape.ny(), shape.nx()), "the region's shape");
        let reaches = |source: &&PointSource| {
            let star = Star::new(source, self.frame);
            self.reaches(source) && star.reaches(self.stamps.window(), region)
        };
        let tasks = sources.len().div_ceil(PER_TASK);
        add_in_order(image, tasks, &Uncounted(progress), |task| {
            let sources = sources[task * PER_TASK..].iter().take(PER_TASK).filter(reaches);
            sources
                .map(|source| {
                    let (lit, values) = self.paint(source)?;
                    let values = values.mapv(S::nearest);
                    let first = (lit.x0() - region.x0(), lit.y0() - region.y0());
                    Ok(Piece { first, values })
                })
                .collect()
        })
    }

    /// The pixels of the frame that a source may light. They may lie outside the frame.
    fn lit(&self, source: &PointSource) -> PixelRegion {
        Star::new(source, self.frame).lit(self.stamps.window())
    }

    fn reaches(&self, source: &PointSource) -> bool {
        let frame = self.frame.shape().region();
        Star::new(source, self.frame).reaches(self.stamps.window(), frame)
    }

    /// The pixels that a source may light, and its light there `[y, x]`.
    fn paint(&self, source: &PointSource) -> Result<(PixelRegion, Array2<f64>), ConvError> {
        let (star, lit) = (Star::new(source, self.frame), self.lit(source));
        let [x, y] = self.taps(&star, false);
        let mut values = if self.splines().is_some() {
            let [values] = self.gathered(lit, [[&x, &y]])?;
            values
        } else {
            let psf = self.model.core_at(star.field_position()?)?;
            let interpolator = self.interpolator(psf.values());
            interpolator.at_all(self.stamps.target.dim(), [&x, &y])
        };
        values.mapv_inplace(|v| v * source.flux());
        Ok((lit, values))
    }

    /// The derivatives of `sum(image * light)` with respect to the flux, x and y of a source of flux 1. `image` holds
    /// the pixels of `region`, which is in pixels of the frame.
    pub(super) fn gradient<S: ConvReal>(
        &self,
        source: &PointSource,
        region: PixelRegion,
        image: ArrayView2<'_, S>,
    ) -> Result<[f64; 3], ConvError> {
        let (star, lit) = (Star::new(source, self.frame), self.lit(source));
        let Some([(columns, on_columns), (rows, on_rows)]) = shared(lit, region) else {
            return Ok([0.0; 3]);
        };
        let [x, y] = self.taps(&star, false);
        let [slopes_x, slopes_y] = self.taps(&star, true);
        let changes = [[&slopes_x, &y], [&x, &slopes_y]];
        let light = if self.splines().is_some() {
            self.gathered(lit, [[&x, &y], changes[0], changes[1]])?
        } else {
            let psfs = with_slopes(star.field_position()?, |position| {
                let mut coefficients = Array1::zeros(self.model.stamp_count());
                let into = coefficients.as_slice_mut().expect("contiguous");
                self.model.scaled_coefficients_into(position, into)?;
                Ok(coefficients)
            })?;
            let [psf, along_x, along_y] = psfs.map(|coefficients| {
                let mut stamp = Array2::zeros(self.model.grid().dim());
                for (&a, component) in coefficients.iter().zip(self.model.stamps().outer_iter()) {
                    stamp.scaled_add(a, &component);
                }
                self.interpolator(stamp.view())
            });
            let at = |psf: &StampInterpolator, taps| psf.at_all(self.stamps.target.dim(), taps);
            let moved = |field: &StampInterpolator, change| at(field, [&x, &y]) + at(&psf, change);
            [
                at(&psf, [&x, &y]),
                moved(&along_x, changes[0]),
                moved(&along_y, changes[1]),
            ]
        };
        let image = image.slice(s![on_rows, on_columns]);
        Ok(light.map(|light| {
            let light = light.slice(s![rows.clone(), columns.clone()]);
            light.iter().zip(image).map(|(v, g)| v * g.as_f64()).sum()
        }))
    }

    fn interpolator(&self, stamp: ArrayView2<'_, f64>) -> StampInterpolator {
        StampInterpolator::with_kernel(stamp, self.model.grid(), self.stamps.kernel)
    }

    /// The interpolators of all stamps, if each pixel has a PSF of its own.
    fn splines(&self) -> Option<&[StampInterpolator]> {
        let splines = self.stamps.splines.as_ref()?;
        let stamps = self.model.stamps();
        let make = || {
            stamps
                .outer_iter()
                .map(|stamp| self.interpolator(stamp))
                .collect()
        };
        Some(splines.get_or_init(make))
    }

    /// The taps, along x and y, of the pixels that a star may light, or those of their derivatives with respect to
    /// the star's position.
    fn taps(&self, star: &Star, slopes: bool) -> [Taps; 2] {
        let (ours, target, kernel) = (self.model.grid(), self.stamps.target, self.stamps.kernel);
        let s = ours.oversampling();
        let of_axis = |count, length, centre: f64, target_centre: f64, shift: f64| {
            let coordinate = |i: usize| centre + s * (i as f64 - target_centre - shift);
            if slopes {
                Taps::slopes(kernel, length, -s, count, coordinate)
            } else {
                Taps::new(kernel, length, 0.0, count, coordinate)
            }
        };
        let (dx, dy) = star.shift;
        [
            of_axis(target.nx(), ours.nx(), ours.centre_x(), target.centre_x(), dx),
            of_axis(target.ny(), ours.ny(), ours.centre_y(), target.centre_y(), dy),
        ]
    }

    /// The light of a source of flux 1 on pixels that have PSFs of their own, once for each pair of taps (along x and y).
    fn gathered<const N: usize>(
        &self,
        lit: PixelRegion,
        taps: [[&Taps; 2]; N],
    ) -> Result<[Array2<f64>; N], ConvError> {
        let (target, splines) = (self.stamps.target, self.splines().unwrap_or_default());
        let planes = taps.map(|taps| {
            // The coefficients of a pixel multiply neighbours in memory.
            let mut planes = Array3::zeros((target.ny(), target.nx(), splines.len()));
            for (mut plane, spline) in planes.axis_iter_mut(Axis(2)).zip(splines) {
                plane.assign(&spline.at_all(target.dim(), taps));
            }
            planes
        });
        let mut values = taps.map(|_| Array2::zeros(target.dim()));
        let mut coefficients = Array1::zeros(splines.len());
        for (j, i) in (0..target.ny()).flat_map(|j| (0..target.nx()).map(move |i| (j, i))) {
            let (x, y) = (lit.x0() + i as i64, lit.y0() + j as i64);
            if self.frame.shape().region().contains(region(x, y, (1, 1))) {
                let into = coefficients.as_slice_mut().expect("contiguous");
                self.model
                    .scaled_coefficients_into(Position::of_pixel(x, y), into)?;
                for (values, planes) in values.iter_mut().zip(&planes) {
                    values[[j, i]] = planes.slice(s![j, i, ..]).dot(&coefficients);
                }
            }
        }
        Ok(values)
    }
}

/// Pixels sorted by rows: row, column, and the index before sorting.
struct SortedPixels(Vec<(usize, usize, usize)>);

impl SortedPixels {
    fn new(pixels: &[(usize, usize)]) -> Self {
        let indexed = pixels.iter().enumerate();
        let mut sorted: Vec<_> = indexed
            .map(|(index, &(column, row))| (row, column, index))
            .collect();
        sorted.sort_unstable();
        Self(sorted)
    }

    /// The pixels in a rectangle: the index of each pixel, and its row and column in the rectangle.
    fn within(&self, rectangle: PixelRegion) -> impl Iterator<Item = (usize, usize, usize)> + '_ {
        let (x, y) = (rectangle.x0(), rectangle.y0());
        let (nx, ny) = (rectangle.shape().nx(), rectangle.shape().ny());
        let before = |row: i64| self.0.partition_point(|pixel| (pixel.0 as i64) < row);
        let rows = &self.0[before(y)..before(y.saturating_add(ny as i64))];
        rows.iter().filter_map(move |&(row, column, index)| {
            let i = usize::try_from(column as i64 - x).ok().filter(|&i| i < nx)?;
            Some((index, (row as i64 - y) as usize, i))
        })
    }
}
