//! Point sources at sub-pixel positions.

use std::sync::{Arc, OnceLock};

use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis};
use psf_types::{Anchor, PixelRegion, PointSource, Position, Progress, PsfModel, StampGrid, Uncounted};
use rayon::prelude::*;

use super::phases::Window;
use crate::overlap::{Piece, add_in_order, overlap};
use crate::stamp_interpolator::{Kernel, StampInterpolator, edge_reach_of, grid_reaching};
use crate::{ConvError, ConvReal};

/// The number of sources that one task draws.
const PER_TASK: usize = 32;
/// The most painted sources that [`StarPainter::at_pixels`] holds in memory at a time.
const SOURCES_IN_MEMORY: usize = 1024;

/// Draws stars one by one in f64, each from all components of the model. It is the reference for
/// [`crate::StarPlan`], and supports every model and anchoring.
#[derive(Debug)]
pub struct StarPainter<'a> {
    model: &'a PsfModel,
    frame: PixelRegion,
    pub(crate) kernel: Kernel,
    /// The interpolators of all stamps, for output-anchored painters.
    pub(crate) splines: Option<StampSplines>,
    /// A grid at the frame's scale that holds the stamp for any position of the source in its
    /// pixel, truncated to the painter's `size` if there is one.
    pub(crate) target: StampGrid,
}

/// Checks that stars and galaxies can be drawn with stamps, which may be truncated to a size.
pub(crate) fn check_stamps(grid: StampGrid, size: Option<usize>) -> Result<(), ConvError> {
    if !grid.pixel_response_included() {
        return Err(ConvError::PixelResponse);
    }
    if size == Some(0) {
        return Err(ConvError::StampSize);
    }
    Ok(())
}

/// The kernel that interpolates the PSFs of a model's stars. It reaches as far beyond the stamps as
/// their edges require ([`edge_reach_of`]).
fn star_kernel(model: &PsfModel) -> Kernel {
    Kernel::of(model.grid().interpolation(), edge_reach_of(model))
}

/// The interpolators of all stamps, computed when first needed. Clones share them, so the painters
/// of one [`crate::StarPlan`] compute them once.
#[derive(Debug, Clone, Default)]
pub(crate) struct StampSplines(Arc<OnceLock<Vec<StampInterpolator>>>);

impl StampSplines {
    fn of(&self, model: &PsfModel, kernel: Kernel) -> &[StampInterpolator] {
        self.0.get_or_init(|| {
            let stamps = model.stamps();
            let splines = stamps.axis_iter(Axis(0));
            splines
                .map(|stamp| StampInterpolator::with_kernel(stamp, model.grid(), kernel))
                .collect()
        })
    }
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
        Self::with_kernel(model, frame, anchor, size, star_kernel(model))
    }

    /// A painter with a kernel that was computed by [`star_kernel`].
    pub(crate) fn with_kernel(
        model: &'a PsfModel,
        frame: PixelRegion,
        anchor: Anchor,
        size: Option<usize>,
        kernel: Kernel,
    ) -> Result<Self, ConvError> {
        let grid = model.grid();
        check_stamps(grid, size)?;
        let splines = (anchor == Anchor::Output).then(StampSplines::default);
        let reach = |room: f64, side: usize| {
            let reach = ((room + kernel.reach()) / grid.oversampling() + 0.5).ceil() as usize;
            size.map_or(reach, |size| reach.min([size / 2, size - 1 - size / 2][side]))
        };
        let target = grid_reaching(grid, reach).map_err(ConvError::Result)?;
        Ok(Self {
            model,
            frame,
            kernel,
            splines,
            target,
        })
    }

    /// The pixels that a star may light, relative to the pixel that the star lies on.
    pub(crate) fn window(&self) -> Window {
        let axis = |centre: f64, count: usize| (-(centre as i64), count as i64 - centre as i64);
        Window {
            columns: axis(self.target.centre_x(), self.target.nx()),
            rows: axis(self.target.centre_y(), self.target.ny()),
        }
    }

    /// Computes the sources' light in single pixels `(column, row)` of the frame.
    ///
    /// # Errors
    /// [`ConvError`] if a PSF that is needed has no value. A source-anchored painter needs the PSF
    /// at every source that reaches one of the pixels. An output-anchored painter needs the PSF at
    /// every frame pixel that such a source may light.
    pub fn at_pixels(
        &self,
        sources: &[PointSource],
        pixels: &[(usize, usize)],
    ) -> Result<Vec<f64>, ConvError> {
        let sorted = SortedPixels::new(pixels);
        let lit = |source: &PointSource| sorted.within(self.lit(source));
        let hit = |source: &&PointSource| self.reaches(source) && lit(source).next().is_some();
        let hit: Vec<&PointSource> = sources.par_iter().filter(hit).collect();
        let mut values = vec![0.0; pixels.len()];
        for some in hit.chunks(SOURCES_IN_MEMORY) {
            let painted: Vec<Result<_, ConvError>> =
                some.par_iter().map(|source| self.paint(source)).collect();
            for (source, painted) in some.iter().zip(painted) {
                let (_, stamp) = painted?;
                for (index, j, i) in lit(source) {
                    values[index] += stamp[[j, i]];
                }
            }
        }
        Ok(values)
    }

    /// Gives every source that may light some pixels `(column, row)` of the frame to `take`, with
    /// the indices of these pixels.
    pub fn lit_pixels<'s>(
        &self,
        sources: &'s [PointSource],
        pixels: &[(usize, usize)],
        mut take: impl FnMut(&'s PointSource, &mut dyn Iterator<Item = usize>),
    ) {
        let sorted = SortedPixels::new(pixels);
        for source in sources.iter().filter(|source| self.reaches(source)) {
            let mut lit = sorted
                .within(self.lit(source))
                .map(|(index, ..)| index)
                .peekable();
            if lit.peek().is_some() {
                take(source, &mut lit);
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
        let reaches = |source: &&PointSource| self.reaches(source) && self.lights(source, region);
        let tasks = sources.len().div_ceil(PER_TASK);
        add_in_order(image, tasks, &Uncounted(progress), |task| {
            let sources = sources[task * PER_TASK..].iter().take(PER_TASK).filter(reaches);
            sources
                .map(|source| {
                    let (lit, values) = self.paint(source)?;
                    let values = values.mapv(S::nearest);
                    Ok(Piece {
                        first_column: lit.0 - region.x0(),
                        first_row: lit.1 - region.y0(),
                        values,
                    })
                })
                .collect()
        })
    }

    /// The pixel that a source lies on, counted from the frame's first pixel. It may lie outside
    /// the frame.
    fn pixel(&self, source: &PointSource) -> (i64, i64) {
        let pixel = |v: f64, origin: i64| ((v + 0.5).floor() as i64).saturating_sub(origin);
        (
            pixel(source.position().x(), self.frame.x0()),
            pixel(source.position().y(), self.frame.y0()),
        )
    }

    /// First column, first row, columns and rows of the pixels that a source may light, in pixels
    /// of the frame.
    fn lit(&self, source: &PointSource) -> (i64, i64, usize, usize) {
        let (column, row) = self.pixel(source);
        let first_column = column.saturating_sub(self.target.centre_x() as i64);
        let first_row = row.saturating_sub(self.target.centre_y() as i64);
        (first_column, first_row, self.target.nx(), self.target.ny())
    }

    fn reaches(&self, source: &PointSource) -> bool {
        self.lights(source, self.frame.shape().region()) && source.flux() != 0.0
    }

    /// Returns whether a source may light pixels of a region of the frame.
    fn lights(&self, source: &PointSource, region: PixelRegion) -> bool {
        let (x, y, nx, ny) = self.lit(source);
        let on = |first: i64, length: usize, start: i64, count: usize| {
            overlap(first.saturating_sub(start), length, count).is_some()
        };
        let shape = region.shape();
        on(x, nx, region.x0(), shape.nx()) && on(y, ny, region.y0(), shape.ny())
    }

    /// The first pixel of the source's window and the light in the window `[y, x]`.
    fn paint(&self, source: &PointSource) -> Result<((i64, i64), Array2<f64>), ConvError> {
        let (first_column, first_row, nx, ny) = self.lit(source);
        let (column, row) = self.pixel(source);
        // Field positions count from the frame's first pixel.
        let x = source.position().x() - self.frame.x0() as f64;
        let y = source.position().y() - self.frame.y0() as f64;
        let shift = (x - column as f64, y - row as f64);
        let mut values = match &self.splines {
            None => {
                let position = Position::new(x, y).map_err(ConvError::Result)?;
                let psf = self.model.psf_at(position)?;
                let stamp = StampInterpolator::with_kernel(psf.values(), self.model.grid(), self.kernel);
                stamp.resample(shift, self.target)
            }
            Some(splines) => {
                let mut values = Array2::zeros((ny, nx));
                let planes: Vec<Array2<f64>> = splines
                    .of(self.model, self.kernel)
                    .iter()
                    .map(|s| s.resample(shift, self.target))
                    .collect();
                let planes: Vec<ArrayView2<'_, f64>> = planes.iter().map(|p| p.view()).collect();
                let mut coefficients = vec![0.0; planes.len()];
                let shape = self.frame.shape();
                let (Some((i0, _, w)), Some((j0, _, h))) = (
                    overlap(first_column, nx, shape.nx()),
                    overlap(first_row, ny, shape.ny()),
                ) else {
                    return Ok(((first_column, first_row), values));
                };
                for j in j0..j0 + h {
                    for i in i0..i0 + w {
                        let pixel = Position::of_pixel(first_column + i as i64, first_row + j as i64);
                        self.model.scaled_coefficients_into(pixel, &mut coefficients)?;
                        values[[j, i]] = coefficients.iter().zip(&planes).map(|(a, p)| a * p[[j, i]]).sum();
                    }
                }
                values
            }
        };
        values.mapv_inplace(|v| v * source.flux());
        Ok(((first_column, first_row), values))
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

    /// The pixels in a rectangle: the index of each pixel, and its row and column in the rectangle,
    /// which is given by its first column, first row, columns and rows.
    fn within(
        &self,
        (x, y, nx, ny): (i64, i64, usize, usize),
    ) -> impl Iterator<Item = (usize, usize, usize)> + '_ {
        let before = |row: i64| self.0.partition_point(|pixel| (pixel.0 as i64) < row);
        let rows = &self.0[before(y)..before(y.saturating_add(ny as i64))];
        rows.iter().filter_map(move |&(row, column, index)| {
            let i = usize::try_from(column as i64 - x).ok().filter(|&i| i < nx)?;
            Some((index, (row as i64 - y) as usize, i))
        })
    }
}
