//! Draws a catalogue block by block. Threads draw blocks at the same time if their stars light
//! different pixels.

use std::sync::Arc;

use ndarray::{Array2, ArrayViewMut2, Axis, s};
use psf_types::{PixelRegion, PointSource, Progress, StampGrid};
use rayon::prelude::*;

use super::draw::{DrawGroup, Group};
use super::phase_norms::PhaseNorms;
use super::phased_stamps::PhasedStamps;
use super::phases::{PhasedAxis, Star};
use super::row_layout::RowLayout;
use super::spread::Spreader;
use super::star_block::StarBlock;
use crate::dropped_light::DroppedLight;
use crate::kept::Kept;
use crate::overlap::{add_values, split};
use crate::plan::PlanOptions;
use crate::simd::{Lanes, WithIsa};
use crate::sources::{BlockKey, PsfVectors, SourcePsfs, block_of, region_of};
use crate::stamp_interpolator::StampInterpolator;
use crate::working_range::{Rescaling, brightest_allowed};
use crate::{ConvError, ConvReal};

/// The parts of a plan that draws stars from local bases.
#[derive(Debug)]
pub(super) struct Phased<T> {
    pub(super) axes: [PhasedAxis; 2],
    pub(super) layout: RowLayout,
    pub(super) spreader: Arc<Spreader<T>>,
    /// Whether crowded stars may be spread.
    pub(super) may_spread: bool,
    pub(super) stamps: Arc<PhasedStamps<T>>,
    pub(super) norms: Arc<PhaseNorms>,
    pub(super) tolerance: f64,
    /// Light below it may be dropped, in flux per pixel.
    pub(super) floor: f64,
    /// Errors of PSFs up to this fraction count as rounding.
    pub(super) rounding: f64,
    pub(super) blocks: Kept<BlockKey, StarBlock<T>>,
}

/// Spread stars keep the light beyond the reach of their stamps, up to 5e-7 of their flux
/// ([`edge_reach_of`](crate::edge_reach_of)). Drawn stars do not. So stars are spread only if the
/// tolerance is at least 20 times as large.
const LEAST_SPREAD_TOLERANCE: f64 = 1e-5;

impl<T: ConvReal> Phased<T> {
    /// Prepares the stamps that the models share. `target` holds the frame's pixels that a star may
    /// light.
    pub(super) fn new(
        psfs: &SourcePsfs,
        axes: [PhasedAxis; 2],
        target: StampGrid,
    ) -> Result<Self, ConvError> {
        let layout = RowLayout::new(&axes[0]);
        let options = psfs.options();
        let tolerance = options.tolerance_in::<T>();
        let grid = psfs.model.grid();
        let stamps: Vec<StampInterpolator> = psfs
            .space()
            .stamps()
            .axis_iter(Axis(0))
            .into_par_iter()
            .map(|stamp| {
                let stamp = stamp.into_shape_with_order(grid.dim());
                let stamp = stamp.expect("the size of a stamp");
                StampInterpolator::with_kernel(stamp, grid, axes[0].kernel)
            })
            .collect();
        Ok(Self {
            spreader: Arc::new(Spreader::new(&axes, layout)),
            // Transforms do not truncate stars.
            may_spread: psfs.size().is_none() && tolerance >= LEAST_SPREAD_TOLERANCE,
            norms: Arc::new(PhaseNorms::new(&stamps, grid, target).map_err(ConvError::Result)?),
            stamps: Arc::new(PhasedStamps::new(&stamps, &axes, layout)),
            axes,
            layout,
            tolerance,
            floor: options.floor(),
            rounding: PlanOptions::rounding_in::<T>(),
            blocks: Kept::new(options.memory_bytes()),
        })
    }

    /// Shares the stamps with a plan for other models, which makes local bases of its own.
    pub(super) fn with_own_blocks(&self, options: PlanOptions) -> Self {
        Self {
            spreader: Arc::clone(&self.spreader),
            norms: Arc::clone(&self.norms),
            stamps: Arc::clone(&self.stamps),
            blocks: Kept::new(options.memory_bytes()),
            ..*self
        }
    }
}

/// Stars, with positions in pixels of a scene, and the frame, which is a region of the scene.
#[derive(Clone, Copy)]
pub(crate) struct StarsToDraw<'a> {
    pub(crate) stars: &'a [PointSource],
    pub(crate) frame: PixelRegion,
    pub(crate) progress: &'a dyn Progress,
}

/// A star's block (row and column), and the star's index in the catalogue.
pub(super) type StarKey = ((i32, i32), usize);

/// Stars of a block that are prepared together.
const AT_ONCE: usize = 1 << 12;
/// The tiles of more stars than this are added up in f64 before they are added to the image, so that the sum
/// of very many stars in one place loses few digits.
const MANY: usize = 1 << 14;
/// The least number of stars for a task.
const MIN_STARS_PER_TASK: usize = 1 << 10;
/// Only the brighter tenth of a crowded block's stars may be too bright for transforms.
const FAINT: f64 = 0.9;

/// Draws a catalogue on a region of the frame. Returns the indices of stars that would exceed the
/// tolerance. They are not drawn.
///
/// Blocks whose stars may light the same pixels never run at the same time. Blocks at every n-th row
/// and every m-th column have one colour and run together. The colours run one after the other. So
/// the order of additions to a pixel is always the same, whatever the region is.
pub(super) struct DrawBlocks<'a, T> {
    pub(super) drawer: BlockDrawer<'a, T>,
    /// The pixels of the drawer's region.
    pub(super) image: ArrayViewMut2<'a, T>,
}

/// Draws the stars of one block.
pub(super) struct BlockDrawer<'a, T> {
    pub(super) psfs: &'a SourcePsfs,
    pub(super) phased: &'a Phased<T>,
    pub(super) catalogue: StarsToDraw<'a>,
    /// The pixels that a star may light, relative to its own pixel.
    pub(super) window: PixelRegion,
    /// The pixels of the frame that are drawn.
    pub(super) region: PixelRegion,
}

/// The stars of a block, and the part of the image that they may light.
struct Task<'a, T> {
    stars: &'a [StarKey],
    image: ArrayViewMut2<'a, T>,
    /// The image's first pixel, in pixels of the frame.
    origin: (i64, i64),
}

impl<T: ConvReal> WithIsa<T> for DrawBlocks<'_, T> {
    type Output = Result<Vec<usize>, ConvError>;

    fn run<S: Lanes<T>>(mut self, simd: S) -> Self::Output {
        let drawer = &self.drawer;
        let stars = drawer.sorted();
        let blocks: Vec<&[StarKey]> = stars.chunk_by(|a, b| a.0 == b.0).collect();
        let [columns, rows] = drawer.phased.spreader.colours();
        let mut missed = Vec::new();
        for colour in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            let tasks = drawer.tasks(&blocks, self.image.view_mut(), colour);
            let drawn: Vec<_> = tasks
                .into_par_iter()
                .map(|task| drawer.draw(simd, task))
                .collect();
            for of_block in drawn {
                missed.extend(of_block?);
            }
        }
        Ok(missed)
    }
}

impl<T: ConvReal> BlockDrawer<'_, T> {
    /// The stars whose light may reach the region, and all other stars of their blocks that reach the
    /// frame, sorted by block. So the stars of a block do not depend on the region.
    pub(super) fn sorted(&self) -> Vec<StarKey> {
        let StarsToDraw { stars, frame, .. } = self.catalogue;
        let (side, whole) = (self.phased.spreader.side, frame.shape().region());
        let mut keys: Vec<StarKey> = stars
            .par_iter()
            .enumerate()
            .with_min_len(MIN_STARS_PER_TASK)
            .filter_map(|(index, source)| {
                let star = Star::new(source, frame);
                let (row, column) = block_of(star.pixel, side as i64);
                let block = (i32::try_from(row).ok()?, i32::try_from(column).ok()?);
                let is_near = self.range(0, block).is_some() && self.range(1, block).is_some();
                (is_near && star.reaches(self.window, whole)).then_some((block, index))
            })
            .collect();
        keys.par_sort_unstable();
        keys
    }

    /// The columns (`axis` 0) or rows (1) of the region that the stars of a block may light. `None` if
    /// there are none.
    fn range(&self, axis: usize, (row, column): (i32, i32)) -> Option<(usize, usize)> {
        let (block, first, length) = if axis == 0 {
            (column, self.region.x0(), self.region.shape().nx())
        } else {
            (row, self.region.y0(), self.region.shape().ny())
        };
        let (start, lit) = self.phased.spreader.lit(axis, i64::from(block));
        let within = |pixel: i64| (pixel - first).clamp(0, length as i64) as usize;
        let (start, end) = (within(start), within(start + lit as i64));
        (start < end).then_some((start, end))
    }

    /// The blocks of one colour, each with its part of the image.
    fn tasks<'t>(
        &self,
        blocks: &[&'t [StarKey]],
        image: ArrayViewMut2<'t, T>,
        (row_colour, column_colour): (usize, usize),
    ) -> Vec<Task<'t, T>> {
        let [columns, rows] = self.phased.spreader.colours();
        let has =
            |block: i32, colours: usize, colour: usize| block.rem_euclid(colours as i32) == colour as i32;
        let range = |axis, stars: &[StarKey]| self.range(axis, stars[0].0).expect("sorted() tested it");
        let of_rows: Vec<_> = blocks
            .chunk_by(|a, b| a[0].0.0 == b[0].0.0)
            .filter(|row| has(row[0][0].0.0, rows, row_colour))
            .collect();
        let ranges: Vec<_> = of_rows.iter().map(|row| range(1, row[0])).collect();
        let mut tasks = Vec::new();
        for ((row, part), (top, _)) in of_rows.iter().zip(split(image, 0, &ranges)).zip(&ranges) {
            let columns_of = row
                .iter()
                .filter(|stars| has(stars[0].0.1, columns, column_colour));
            let of_columns: Vec<&[StarKey]> = columns_of.copied().collect();
            let ranges: Vec<_> = of_columns.iter().map(|stars| range(0, stars)).collect();
            for ((stars, image), (left, _)) in of_columns.iter().zip(split(part, 1, &ranges)).zip(&ranges) {
                let origin = (self.region.x0() + *left as i64, self.region.y0() + *top as i64);
                tasks.push(Task { stars, image, origin });
            }
        }
        tasks
    }

    /// The local basis of a block.
    pub(super) fn block(&self, key: BlockKey) -> Arc<StarBlock<T>> {
        let phased = self.phased;
        let region = region_of(key, phased.spreader.side as i64);
        let directions = (self.psfs.space(), &*phased.stamps);
        let reach = (phased.floor, &phased.axes, phased.layout);
        let make = || StarBlock::new(directions, region, &phased.norms, phased.tolerance, reach);
        phased.blocks.get(key, make, StarBlock::bytes)
    }

    /// Adds the light that the stars drop at most.
    pub(super) fn add_dropped(&self, dropped: &mut DroppedLight) {
        let stars = self.sorted();
        dropped.add_all(stars.len(), |dropped, some| {
            for stars in stars[some].chunk_by(|a, b| a.0 == b.0) {
                let ((row, column), _) = stars[0];
                let block = self.block((i64::from(row), i64::from(column)));
                for &(_, index) in stars {
                    let star = Star::new(&self.catalogue.stars[index], self.catalogue.frame);
                    match &block.reach {
                        Some(reach) => reach.add_dropped(star.pixel, star.flux, dropped),
                        None => dropped.count(star.flux, 0.0),
                    }
                }
            }
        });
    }

    /// Draws the stars of a block, one by one or, if they are many, by transforms. Returns the
    /// indices of stars that would exceed the tolerance.
    fn draw<S: Lanes<T>>(&self, simd: S, task: Task<'_, T>) -> Result<Vec<usize>, ConvError> {
        self.catalogue.progress.check_cancelled()?;
        let phased = self.phased;
        let ((row, column), _) = task.stars[0];
        let key = (i64::from(row), i64::from(column));
        let region = region_of(key, phased.spreader.side as i64);
        let block = &*self.block(key);
        let (mut image, origin) = (task.image, task.origin);
        let mut stars: Vec<usize> = task.stars.iter().map(|&(_, index)| index).collect();
        let mut missed = Vec::new();
        if let Some(limit) = self.brightest_spread(block, region, &stars) {
            let flux = |index: usize| self.catalogue.stars[index].flux().abs();
            let (spread, bright): (Vec<usize>, Vec<usize>) =
                stars.into_iter().partition(|&index| flux(index) <= limit);
            stars = bright;
            // By this thread alone, because it holds a workspace: while it waited for others, it could
            // take up another block and need another workspace.
            let groups = spread.chunks(MIN_STARS_PER_TASK).map(|some| {
                let (group, of_group) = self.prepare(block, some)?;
                missed.extend(of_group);
                Ok(group)
            });
            let place = (block, region);
            phased
                .spreader
                .add_stars(simd, place, groups, &mut image, origin)?;
        }
        let phases = |&index: &usize| {
            let star = Star::new(&self.catalogue.stars[index], self.catalogue.frame);
            (star.phase_numbers(&phased.axes), index)
        };
        stars.sort_by_cached_key(phases);
        let draw = DrawGroup {
            axes: &phased.axes,
            layout: phased.layout,
            values: block.values(),
            kernels: block.modes.kernel_count(),
            reach: block.reach.as_ref(),
            region: self.region,
            progress: self.catalogue.progress,
        };
        // The pixels that the block's stars may light.
        let [(left, nx), (below, ny)] = [phased.spreader.lit(0, key.1), phased.spreader.lit(1, key.0)];
        let first = (left, below);
        let mut sum = (stars.len() > MANY).then(|| Array2::<f64>::zeros((ny, nx)));
        for some in stars.chunks(AT_ONCE) {
            let tiles: Vec<Result<_, ConvError>> = some
                .par_chunks(MIN_STARS_PER_TASK)
                .map(|some| {
                    let (group, missed) = self.prepare(block, some)?;
                    Ok((draw.tile(simd, &group)?, missed))
                })
                .collect();
            for tile in tiles {
                let (tile, of_tile) = tile?;
                match &mut sum {
                    Some(sum) => {
                        let at = (tile.first.0 - first.0, tile.first.1 - first.1);
                        for (v, row) in tile.values.outer_iter().zip(at.1..) {
                            let row = sum.index_axis_mut(Axis(0), row as usize);
                            let mut part = row.slice_move(s![at.0 as usize..at.0 as usize + v.len()]);
                            part.zip_mut_with(&v, |sum, v| *sum += v.as_f64());
                        }
                    }
                    None => tile.add_to(&mut image, origin),
                }
                missed.extend(of_tile);
            }
        }
        if let Some(sum) = sum {
            let at = (first.0 - origin.0, first.1 - origin.1);
            add_values(sum.mapv(T::nearest).view(), at, &mut image);
        }
        Ok(missed)
    }

    /// The largest flux of stars that are spread. `None` if it is faster to draw all stars one by
    /// one, or if their fluxes are extreme.
    fn brightest_spread(&self, block: &StarBlock<T>, region: PixelRegion, stars: &[usize]) -> Option<f64> {
        let kernels = block.modes.kernel_count();
        let flux = |&index: &usize| self.catalogue.stars[index].flux().abs();
        let mut fluxes: Vec<f64> = stars.iter().map(flux).collect();
        let drawn = |&flux: &f64| block.reach.as_ref().map_or(1.0, |reach| reach.part_of(flux));
        if !(self.phased.may_spread && self.phased.spreader.pays(&fluxes, drawn, kernels)) {
            return None;
        }
        let faint = (FAINT * fluxes.len() as f64) as usize;
        let (fainter, ..) = fluxes.select_nth_unstable_by(faint, f64::total_cmp);
        let total: f64 = fainter.iter().sum();
        let limit = brightest_allowed::<T>(total, faint, region.shape().pixel_count());
        let is_safe = limit.is_finite() && limit > 0.0 && Rescaling::<T>::for_largest(limit).is_none();
        is_safe.then_some(limit)
    }

    /// Computes the coefficients of the block's kernels for the PSF of a star, which `vectors` holds and `again`
    /// sets again. Returns whether they represent it within the tolerance.
    pub(super) fn project_within(
        &self,
        block: &StarBlock<T>,
        star: &Star,
        vectors: &mut PsfVectors<'_>,
        coefficients: &mut Vec<f64>,
        again: impl FnOnce(&mut PsfVectors<'_>) -> Result<(), ConvError>,
    ) -> Result<bool, ConvError> {
        let (phased, tolerance, shift) = (self.phased, self.phased.tolerance, star.shift);
        let whole = vectors.norm();
        vectors.project(&block.modes, coefficients);
        if !vectors.is_within(tolerance, whole) {
            return Ok(false);
        }
        let (error, along_mean) = (vectors.norm(), &block.along_mean);
        let norms = &phased.norms;
        if error <= phased.rounding * whole
            || norms.is_surely_within(tolerance, shift, error, coefficients, along_mean)
        {
            return Ok(true);
        }
        let error = vectors.psf.clone();
        again(vectors)?;
        Ok(norms.is_within(tolerance, shift, error.view(), vectors.psf.view()))
    }

    /// Computes the sub-pixel phases and the weights of some stars of a block. Leaves out stars that
    /// would exceed the tolerance, and returns the indices of those that reach the region.
    fn prepare(&self, block: &StarBlock<T>, stars: &[usize]) -> Result<(Group<T>, Vec<usize>), ConvError> {
        self.catalogue.progress.check_cancelled()?;
        let axes = &self.phased.axes;
        let mut vectors = self.psfs.vectors();
        let mut coefficients = Vec::with_capacity(block.modes.kernel_count());
        let taps = axes[1].kernel.tap_count();
        let mut weights = Vec::with_capacity(stars.len() * taps * block.modes.kernel_count());
        let (mut prepared, mut missed) = (Vec::with_capacity(stars.len()), Vec::new());
        for &index in stars {
            let star = Star::new(&self.catalogue.stars[index], self.catalogue.frame);
            let Some([columns, rows]) = star.phases(axes) else {
                continue;
            };
            let position = star.field_position()?;
            // Only stars that reach the region need a PSF.
            let is_needed = star.reaches(self.window, self.region);
            let scale = match vectors.set(position) {
                Err(_) if !is_needed => continue,
                scale => scale?,
            };
            let again = |vectors: &mut PsfVectors<'_>| {
                vectors.set(position)?;
                Ok(())
            };
            let within = self.project_within(block, &star, &mut vectors, &mut coefficients, again)?;
            if !within {
                missed.extend(is_needed.then_some(index));
                continue;
            }
            let reach = block
                .reach
                .as_ref()
                .filter(|reach| reach.holds_for(&coefficients, scale));
            let scale = scale * star.flux;
            let first = weights.len();
            for tap in &rows.weights[..taps] {
                weights.extend(coefficients.iter().map(|c| T::nearest(tap * c * scale)));
            }
            let level = reach.and_then(|reach| reach.level_of(star.flux));
            let phases = ([columns, rows], axes[0].oversampling);
            prepared.push(star.phased(phases, level, first..weights.len()));
        }
        let group = Group {
            stars: prepared,
            weights,
        };
        Ok((group, missed))
    }
}
