//! The choice of tiles: their sizes, and whether they follow the grid cells of the coefficient
//! field. Plans of all regions of a frame use the same choice.

use std::ops::Range;

use psf_types::{Anchor, BilinearCells, ErrorLimit, FrameShape, PixelRegion, Progress, PsfModel};
use rayon::prelude::*;

use super::axis_cuts::{Stretch, at_cuts, even, longest, within};
use super::cost_model::{CostModel, sizes, transform_size};
use super::geometry::Geometry;
use super::local_modes::LocalModes;
use super::options::PlanOptions;
use super::psf_space::PsfSpace;
use crate::view::{Reach, View, region};
use crate::{ConvError, ConvReal};

/// Tiles along both axes and their transforms.
#[derive(Debug, Clone)]
pub(crate) struct Tiling {
    pub(crate) columns: Vec<Stretch>,
    pub(crate) rows: Vec<Stretch>,
    /// Columns and rows of the transforms.
    pub(crate) size: (usize, usize),
}

/// The number of blocks whose modes are counted to predict the cost of a tiling.
const SAMPLES: usize = 4;
/// The number of rows of cells of such a block that are looked at.
const SAMPLED_ROWS: usize = 5;
/// The fraction of the tolerance with which modes are counted. It makes up for the error of cells,
/// and for the PSFs that are not looked at.
const COUNTED: f64 = 0.7;
/// The largest size of transforms, as a multiple of the stamp's size. Larger transforms gain
/// nothing, because padding is already small and tiles need more modes.
const LARGEST_IN_STAMPS: usize = 10;
/// [`LARGEST_IN_STAMPS`] never limits transforms to less than this size.
const LARGEST_AT_LEAST: usize = 640;
/// Only very large stamps use transforms above this size. Such transforms exceed the caches, and
/// the memory that a GPU's threads share.
const LARGEST_BY_CHOICE: usize = 2048;
/// The smallest tile, as a fraction of the stamp's size.
const SMALLEST_IN_STAMPS: f64 = 0.4;
/// Modes are counted for blocks of areas that differ by at most about this factor.
const AREA_STEP: f64 = 4.0;
/// Modes are counted first for blocks of this area, in stamps.
const FIRST_IN_STAMPS: f64 = 4.0;
/// Smaller blocks have at least this fraction of the modes that a power of the area predicts.
const FEWEST: f64 = 0.8;
/// The number of threads for which the time of a tiling is predicted. It is a constant, so that
/// plans do not depend on the machine.
const THREADS: usize = 4;
/// The number of pixel rows that are streamed together: enough to keep threads busy.
const BAND_ROWS: usize = 1024;
/// The fraction of the plan's memory that is assumed to be for stamps. The rest is for
/// coefficients.
const STAMP_MEMORY: f64 = 0.85;
/// The numbers of tiles in each direction that are tried for a block, if blocks do not follow grid
/// cells.
const BLOCK_SIDES: [usize; 3] = [1, 2, 4];

/// Returns the tiling with the lowest predicted cost.
fn best_tiling<T: ConvReal>(
    model: &PsfModel,
    space: &PsfSpace,
    geometry: &Geometry,
    options: PlanOptions,
    progress: &dyn Progress,
) -> Result<Tiling, ConvError> {
    let (nx, ny) = geometry.weighted_size();
    let stamp = geometry.stamp;
    let side = stamp.0.max(stamp.1);
    let whole = transform_size((nx + stamp.0 - 1, ny + stamp.1 - 1));
    let smallest = side + (SMALLEST_IN_STAMPS * side as f64) as usize;
    let largest = (LARGEST_IN_STAMPS * side).max(LARGEST_AT_LEAST);
    let largest = largest
        .max(2 * smallest)
        .min(LARGEST_BY_CHOICE.max(smallest + smallest / 4));
    let cuts = cuts(model, geometry);
    let (mut regular, mut along_cuts) = (Vec::new(), Vec::new());
    for n in sizes().filter(|&n| n >= smallest.min(whole.0.max(whole.1)) && n <= largest) {
        let tile = (
            (n + 1).saturating_sub(stamp.0).max(1),
            (n + 1).saturating_sub(stamp.1).max(1),
        );
        for together in BLOCK_SIDES {
            let columns = even(nx, tile.0, together);
            regular.push(Tiling::new(columns, even(ny, tile.1, together), stamp));
        }
        if let Some([xs, ys]) = &cuts {
            for split in [false, true] {
                let columns = at_cuts(nx, xs, tile.0, split);
                along_cuts.push(Tiling::new(columns, at_cuts(ny, ys, tile.1, split), stamp));
            }
        }
        if n >= whole.0.max(whole.1) {
            break;
        }
    }
    let fastest = |tilings| fastest::<T>(tilings, space, geometry, options, progress);
    let (regular, along_cuts) = rayon::join(|| fastest(regular), || fastest(along_cuts));
    let timed = regular?.into_iter().chain(along_cuts?);
    let best = timed.reduce(|a, b| if b.0 < a.0 { b } else { a });
    Ok(best.expect("at least one size is tried").1)
}

/// Returns the tiling with the lowest predicted cost, and this cost.
///
/// Modes and cells are counted for a few sizes of blocks only, first for blocks of [`FIRST_IN_STAMPS`]
/// stamps. In between, their numbers are interpolated, as powers of the area. Larger blocks follow while
/// one could be faster even without more modes, then smaller ones while one could be faster with
/// [`FEWEST`] of the modes that the power continued to smaller areas gives.
fn fastest<T: ConvReal>(
    mut tilings: Vec<Tiling>,
    space: &PsfSpace,
    geometry: &Geometry,
    options: PlanOptions,
    progress: &dyn Progress,
) -> Result<Option<(f64, Tiling)>, ConvError> {
    if tilings.is_empty() {
        return Ok(None);
    }
    tilings.sort_by(|a, b| a.block_area().total_cmp(&b.block_area()));
    let areas: Vec<f64> = tilings.iter().map(Tiling::block_area).collect();
    // The index of the first tiling above an area.
    let above = |area: f64| areas.partition_point(|&of_tiling| of_tiling <= area);
    let count = |i: usize| -> Result<(f64, Contents), ConvError> {
        progress.check_cancelled()?;
        Ok((areas[i], tilings[i].contents::<T>(space, geometry, options)))
    };
    let sizes = (space.mean.len(), space.models.len());
    let seconds = |i: usize, contents| tilings[i].seconds::<T>(contents, sizes, geometry, options);
    let mut best = (f64::INFINITY, 0);
    // Of equally fast tilings, takes the first.
    let mut time = |tilings: Range<usize>, low, high| {
        let timed = tilings.map(|i| (seconds(i, between(low, high, areas[i])), i));
        best = timed.fold(best, |best, timed| if timed.0 < best.0 { timed } else { best });
        best.0
    };
    let stamp_area = (geometry.stamp.0 * geometry.stamp.1) as f64;
    let first = above(FIRST_IN_STAMPS * stamp_area).max(1) - 1;
    let (mut smallest, mut end) = (areas.partition_point(|&area| area < areas[first]), first + 1);
    let mut low = count(first)?;
    let (mut second, mut high) = (low, low);
    let mut least = time(smallest..end, low, high);
    while (end..areas.len()).any(|i| seconds(i, high.1) < least) {
        let next = above(AREA_STEP * high.0).max(end + 1);
        let counted = count(next - 1)?;
        least = time(end..next, high, counted);
        if second.0 == low.0 {
            second = counted;
        }
        (high, end) = (counted, next);
    }
    let few = |i: usize, low, second| {
        let contents = between(low, second, areas[i]);
        Contents {
            kernels: FEWEST * contents.kernels,
            ..contents
        }
    };
    while (0..smallest).any(|i| seconds(i, few(i, low, second)) < least) {
        let next = areas
            .partition_point(|&area| area < low.0 / AREA_STEP)
            .min(smallest - 1);
        let counted = count(next)?;
        least = time(next..smallest, counted, low);
        (second, low, smallest) = (low, counted, next);
    }
    let (seconds, i) = best;
    Ok(Some((seconds, tilings.swap_remove(i))))
}

/// The mean numbers of kernels (modes and the reference) and of cells of a tiling's blocks.
#[derive(Debug, Clone, Copy)]
struct Contents {
    kernels: f64,
    cells: f64,
}

/// Interpolates the numbers of kernels and cells, as powers of the block's area.
fn between((low, few): (f64, Contents), (high, many): (f64, Contents), area: f64) -> Contents {
    let part = if low < high {
        (area / low).ln() / (high / low).ln()
    } else {
        0.0
    };
    let power = |few: f64, many: f64| few * (many / few).powf(part);
    Contents {
        kernels: power(few.kernels, many.kernels),
        cells: power(few.cells, many.cells),
    }
}

/// The first pixels of the field's cells, counted from the first pixel of the weighted side
/// ([`Geometry`]). `None` if the field has no cells, or if they are too small for tiles of their own.
fn cuts(model: &PsfModel, geometry: &Geometry) -> Option<[Vec<usize>; 2]> {
    let lines = |region| match model.field().bilinear_cells(region, ErrorLimit::ZERO) {
        BilinearCells::Lines { x, y, .. } => Some([x, y]),
        _ => None,
    };
    // All cells of a large tree take long to list, so a single pixel tells first that it has no lines.
    lines(region(geometry.weighted.x0(), geometry.weighted.y0(), (1, 1)))?;
    let [x, y] = lines(geometry.weighted)?;
    let cuts = |lines: Vec<f64>, first: i64, length: usize| {
        let pixels = lines.iter().map(|line| line.ceil() - first as f64);
        let inside = pixels.filter(|&p| p >= 1.0 && p < length as f64);
        let mut cuts: Vec<usize> = inside.map(|p| p as usize).collect();
        cuts.dedup();
        cuts
    };
    let ((nx, ny), (sx, sy)) = (geometry.weighted_size(), geometry.stamp);
    let [xs, ys] = [
        cuts(x, geometry.weighted.x0(), nx),
        cuts(y, geometry.weighted.y0(), ny),
    ];
    (nx > sx * xs.len() && ny > sy * ys.len()).then_some([xs, ys])
}

impl Tiling {
    fn new(columns: Vec<Stretch>, rows: Vec<Stretch>, stamp: (usize, usize)) -> Self {
        let at_least = (longest(&columns) + stamp.0 - 1, longest(&rows) + stamp.1 - 1);
        Self {
            columns,
            rows,
            size: transform_size(at_least),
        }
    }

    /// Returns the tiling truncated to some columns and rows of pixels. The truncated tiling counts
    /// pixels from the first of these columns and rows. Also returns the columns and rows of blocks
    /// that remain. Transforms keep their size.
    pub(crate) fn within(&self, columns: &Range<usize>, rows: &Range<usize>) -> (Self, [Range<usize>; 2]) {
        let (columns, across) = within(&self.columns, columns);
        let (rows, up) = within(&self.rows, rows);
        let size = self.size;
        (Self { columns, rows, size }, [across, up])
    }

    /// The region of a block, in pixel coordinates of the frame.
    pub(crate) fn region(&self, geometry: &Geometry, column: usize, row: usize) -> PixelRegion {
        let (x, y) = (&self.columns[column], &self.rows[row]);
        region(
            geometry.weighted.x0() + x.start() as i64,
            geometry.weighted.y0() + y.start() as i64,
            (x.length(), y.length()),
        )
    }

    /// The mean area of a block, in pixels.
    fn block_area(&self) -> f64 {
        // Stretches follow each other, from the first pixel on.
        let length = |stretches: &[Stretch]| {
            let pixels = stretches.last().map_or(0, |last| last.start() + last.length());
            pixels as f64 / stretches.len() as f64
        };
        length(&self.columns) * length(&self.rows)
    }

    /// The contents of a few blocks, which are spread over rows and columns.
    fn contents<T: ConvReal>(&self, space: &PsfSpace, geometry: &Geometry, options: PlanOptions) -> Contents {
        let (across, up) = (self.columns.len(), self.rows.len());
        let samples = SAMPLES.min(across * up);
        let tolerance = options.tolerance_in::<T>();
        let (kernels, cells): (Vec<usize>, Vec<usize>) = (0..samples)
            .into_par_iter()
            .with_max_len(1)
            .map(|i| {
                let row = (2 * i + 1) * up / (2 * samples);
                let column = ((3 * i + 1) % samples * 2 + 1) * across / (2 * samples);
                let region = self.region(geometry, column.min(across - 1), row.min(up - 1));
                let cells = space.sampled_cells(region, SAMPLED_ROWS);
                let modes = LocalModes::of_exact_cells(space, &cells, COUNTED * tolerance);
                (modes.rank() + 1, space.expected_cells(region, tolerance))
            })
            .unzip();
        let mean = |numbers: Vec<usize>| numbers.iter().sum::<usize>() as f64 / samples as f64;
        Contents {
            kernels: mean(kernels),
            cells: mean(cells),
        }
    }

    /// Predicted seconds of the plan and of one execution, if every pixel is lit. `stamps` and `layers`
    /// are the numbers of stamps of the model and of layers.
    fn seconds<T: ConvReal>(
        &self,
        Contents { kernels, cells }: Contents,
        (stamps, layers): (usize, usize),
        geometry: &Geometry,
        options: PlanOptions,
    ) -> f64 {
        let cost = CostModel::of::<T>();
        let blocks = self.columns.len() * self.rows.len();
        let tiles = |stretches: &[Stretch]| stretches.iter().map(|s| s.tiles.len()).sum::<usize>();
        let (across, up) = (tiles(&self.columns), tiles(&self.rows));
        let (nx, ny) = geometry.weighted_size();
        let tile = (nx.div_ceil(across), ny.div_ceil(up));
        let tiles_a_block = (across * up) as f64 / blocks as f64;
        // Each execution computes again the stamps that do not fit into the memory.
        let bytes = cost.stamp_bytes(geometry.stamp) * kernels * blocks as f64;
        let made_anew = (1.0 - STAMP_MEMORY * options.memory_bytes() as f64 / bytes).clamp(0.0, 1.0);
        let block = kernels * cost.kernel(self.size, geometry.stamp)
            + CostModel::plan_and_expand(cells, kernels)
            + CostModel::make_stamps(geometry.stamp, stamps, kernels, made_anew)
            + tiles_a_block
                * (cost.tile(tile, self.size, kernels, layers)
                    + if tiles_a_block > 1.0 {
                        cost.read_spectra(self.size, kernels)
                    } else {
                        0.0
                    });
        self.rounds() as f64 * block
    }

    /// The number of rows of blocks that are in memory together if an image is streamed: about
    /// [`BAND_ROWS`] rows of pixels.
    pub(crate) fn band(&self) -> usize {
        let pixels: usize = self.rows.iter().map(Stretch::length).sum();
        (BAND_ROWS * self.rows.len())
            .div_ceil(pixels.max(1))
            .clamp(1, self.rows.len())
    }

    /// The number of rounds in which [`THREADS`] threads take one block each. The blocks count in four
    /// groups, so that few blocks, which leave threads idle at the end, count as slow.
    fn rounds(&self) -> usize {
        let halves = |n: usize| [n.div_ceil(2), n / 2];
        let groups = halves(self.rows.len())
            .into_iter()
            .flat_map(|rows| halves(self.columns.len()).map(|columns| rows * columns));
        groups.map(|blocks| blocks.div_ceil(THREADS)).sum()
    }
}

/// The vectors of a model's PSFs, and the tiles of the whole frame. Plans of all regions of the
/// frame share these data, so that they have the same modes.
#[derive(Debug)]
pub(crate) struct WholeFrame {
    pub(crate) view: View,
    pub(crate) space: PsfSpace,
    geometry: Geometry,
    tiling: Tiling,
    reach: Reach,
    anchor: Anchor,
}

/// The part of a whole frame's data that a plan of a region uses.
pub(crate) struct Part {
    /// Columns and rows of the scene that reach the region.
    pub(crate) light: [Range<usize>; 2],
    pub(crate) geometry: Geometry,
    /// The tiling, truncated to the weighted side of `geometry`.
    pub(crate) tiling: Tiling,
    /// The columns and rows of the plan's blocks among the blocks of the whole frame.
    pub(crate) blocks: [Range<usize>; 2],
}

impl WholeFrame {
    /// Chooses the tiles.
    pub(crate) fn new<T: ConvReal>(
        models: &[PsfModel],
        view: View,
        options: PlanOptions,
        progress: &dyn Progress,
    ) -> Result<Self, ConvError> {
        let model = &models[0];
        let (reach, anchor) = (Reach::of(model.grid())?, options.anchor());
        let (_, geometry) = sides(view, view.frame.shape().region(), reach, anchor)?;
        let tolerance = options.tolerance_in::<T>();
        let space = PsfSpace::new(models, options.tolerance_on()).with_tables(geometry.weighted, tolerance);
        let tiling = best_tiling::<T>(model, &space, &geometry, options, progress)?;
        Ok(Self {
            view,
            space,
            geometry,
            tiling,
            reach,
            anchor,
        })
    }

    /// The tiles with the PSFs of other models. `None` if the stamps reach other pixels.
    pub(crate) fn for_other_models<T: ConvReal>(
        &self,
        models: &[PsfModel],
        options: PlanOptions,
    ) -> Result<Option<Self>, ConvError> {
        let reach = Reach::of(models[0].grid())?;
        let space = self.space.for_other_models(models, options.tolerance_on());
        let whole = || Self {
            view: self.view,
            space: space.with_tables(self.geometry.weighted, options.tolerance_in::<T>()),
            geometry: self.geometry,
            tiling: self.tiling.clone(),
            reach,
            anchor: self.anchor,
        };
        Ok((reach == self.reach).then(whole))
    }

    /// Returns the data for a plan of a region of the frame.
    pub(crate) fn part(&self, region: PixelRegion) -> Result<Part, ConvError> {
        let frame = self.view.frame.shape();
        if !frame.region().contains(region) {
            return Err(ConvError::RegionOutsideFrame { region, frame });
        }
        let (light, geometry) = sides(self.view, region, self.reach, self.anchor)?;
        let (weighted, whole) = (geometry.weighted, self.geometry.weighted);
        let range = |first: i64, whole: i64, length: usize| {
            let first = (first - whole) as usize;
            first..first + length
        };
        let (tiling, blocks) = self.tiling.within(
            &range(weighted.x0(), whole.x0(), weighted.shape().nx()),
            &range(weighted.y0(), whole.y0(), weighted.shape().ny()),
        );
        Ok(Part {
            light,
            geometry,
            tiling,
            blocks,
        })
    }

    /// The region of a block, in pixel coordinates of the frame.
    pub(crate) fn block(&self, column: usize, row: usize) -> PixelRegion {
        self.tiling.region(&self.geometry, column, row)
    }
}

/// The columns and rows of the light that reach a region of the frame, and the geometry of the
/// operator from this light to the region.
fn sides(
    view: View,
    region: PixelRegion,
    reach: Reach,
    anchor: Anchor,
) -> Result<([Range<usize>; 2], Geometry), ConvError> {
    let (x0, y0) = (view.frame.x0(), view.frame.y0());
    let [columns, rows] = view.reaching(region.shifted(x0, y0), reach);
    let shape = FrameShape::new(columns.len(), rows.len()).map_err(ConvError::Result)?;
    let light = PixelRegion::new(columns.start as i64 - x0, rows.start as i64 - y0, shape);
    Ok(([columns, rows], Geometry::new(light, region, reach, anchor)))
}
