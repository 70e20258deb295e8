//! The PSFs of sources as weighted means of the PSFs at corners.

use std::borrow::Cow;

use ndarray::{Array2, s};
use psf_types::{FrameShape, PixelRegion, Position};

use crate::ConvError;
use crate::kept::Kept;
use crate::plan::region_cells::{Cell, RegionCells};
use crate::sources::{BlockKey, SourcePsfs, block_of, region_of};
use crate::view;

/// A PSF whose photons are drawn from a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Corner {
    /// A node of the coefficient field.
    Node(usize),
    /// A corner of a cell of a block.
    OfCell(BlockKey, usize),
    /// The position of a source, by its bits.
    Source([u64; 2]),
}

/// The cells of a block of the field, and the PSF at each corner `[corner, direction]`, not scaled to unit flux.
#[derive(Debug)]
pub(super) struct BlockCells {
    region: PixelRegion,
    cells: RegionCells,
    psfs: Array2<f64>,
}

/// Columns and rows of a block of the field.
pub(super) const BLOCK: i64 = 1024;
/// Blocks reach so many pixels beyond the field. Farther out, extrapolated PSFs may vary much.
const BEYOND_FIELD: i64 = 256;
/// The most nodes of the coefficient field that give the PSF of a source.
pub(super) const MOST_NODES: usize = 8;
/// The most cells of a block. Where there are more, each source has a table of its own.
const MOST_CELLS: usize = 1 << 14;
/// Rounding of sums of weights.
const ROUNDING: f64 = 1e-9;

/// Finds the corners of sources.
pub(super) struct Corners<'a> {
    psfs: &'a SourcePsfs,
    tolerance: f64,
    /// The values of the field's nodes, if it has any.
    nodes: Option<Cow<'a, Array2<f64>>>,
    blocks: &'a Kept<BlockKey, Option<BlockCells>>,
}

impl<'a> Corners<'a> {
    pub(super) fn new(
        psfs: &'a SourcePsfs,
        tolerance: f64,
        blocks: &'a Kept<BlockKey, Option<BlockCells>>,
    ) -> Self {
        let nodes = psfs.model.field().weighted_nodes();
        Self {
            psfs,
            tolerance,
            nodes: nodes.map(|nodes| nodes.node_values()),
            blocks,
        }
    }

    /// The number of nodes of the field, if they are the corners in the middle of the frame.
    pub(super) fn node_count(&self, frame: PixelRegion) -> Option<usize> {
        let (mut corners, mut buffer) = (Vec::new(), Vec::new());
        let middle = Position::of_pixel(frame.shape().nx() as i64 / 2, frame.shape().ny() as i64 / 2);
        let are_nodes = self.of_nodes(middle, &mut corners, &mut buffer);
        let nodes = self.nodes.as_ref().filter(|_| are_nodes.unwrap_or(false))?;
        Some(nodes.nrows())
    }

    /// The nodes of the field and their weights, if the PSF at a position is a mean of few of them.
    fn of_nodes(
        &self,
        position: Position,
        corners: &mut Vec<(Corner, f64)>,
        buffer: &mut Vec<(usize, f64)>,
    ) -> Result<bool, ConvError> {
        let Some(nodes) = self.psfs.model.field().weighted_nodes() else {
            return Ok(false);
        };
        nodes.weights_into(position, buffer)?;
        let sum: f64 = buffer.iter().map(|(_, weight)| weight).sum();
        let is_mean = (sum - 1.0).abs() <= ROUNDING && buffer.iter().all(|&(_, w)| w >= -ROUNDING);
        if !is_mean || buffer.len() > MOST_NODES {
            return Ok(false);
        }
        let used = buffer.iter().filter(|(_, weight)| *weight != 0.0);
        corners.extend(used.map(|&(node, weight)| (Corner::Node(node), weight)));
        Ok(true)
    }

    /// The corners of the PSF at a position, with their weights, in place of what `corners` holds.
    ///
    /// If the field is a weighted mean of few nodes, as in a grid or in triangles, the nodes are the corners, and
    /// the PSF is exact. Otherwise it is that of bilinear cells within the tolerance or, where these are too
    /// small, the source's own.
    pub(super) fn of(
        &self,
        position: Position,
        corners: &mut Vec<(Corner, f64)>,
        buffer: &mut Vec<(usize, f64)>,
    ) -> Result<(), ConvError> {
        corners.clear();
        if self.of_nodes(position, corners, buffer)? {
            return Ok(());
        }
        let block = block_of((position.x().floor() as i64, position.y().floor() as i64), BLOCK);
        let cells = self.blocks.get(block, || self.cells(block), |_| 0);
        let found = cells.as_ref().as_ref().and_then(|cells| cells.at(position));
        match found {
            Some(weighted) => {
                let used = weighted.into_iter().filter(|(_, weight)| *weight != 0.0);
                corners.extend(used.map(|(corner, weight)| (Corner::OfCell(block, corner), weight)));
            }
            None => corners.push((Corner::Source(position.bits()), 1.0)),
        }
        Ok(())
    }

    /// The cells of a block, with the first pixels of the blocks after it. `None` if they are too many.
    fn cells(&self, block: BlockKey) -> Option<BlockCells> {
        let space = self.psfs.space();
        let own = region_of(block, BLOCK);
        let field = self.psfs.model.field_shape();
        let along = |first: i64, pixels: Option<usize>| {
            let (mut start, mut end) = (first, first + BLOCK + 1);
            if let Some(pixels) = pixels {
                start = start.max(-BEYOND_FIELD);
                end = end.min(pixels as i64 + BEYOND_FIELD);
            }
            (start < end).then(|| (start, (end - start) as usize))
        };
        let (x, nx) = along(own.x0(), field.map(FrameShape::nx))?;
        let (y, ny) = along(own.y0(), field.map(FrameShape::ny))?;
        let region = view::region(x, y, (nx, ny));
        if space.expected_cells(region, self.tolerance) > MOST_CELLS {
            return None;
        }
        let cells = space.cells(region, space.error_of_cells(region, self.tolerance));
        if cells.corners().len() > MOST_CELLS {
            return None;
        }
        let rows = space.rows(&cells);
        let offset = rows.row(rows.nrows() - 1);
        let mut psfs = Array2::zeros((cells.corners().len(), rows.ncols()));
        for (mut psf, weights) in psfs.outer_iter_mut().zip(cells.corners()) {
            psf.assign(&offset);
            for &(node, weight) in weights {
                psf.scaled_add(weight, &rows.row(node));
            }
        }
        Some(BlockCells { region, cells, psfs })
    }

    /// The vectors of the PSFs at corners `[corner, direction]`, not scaled to unit flux.
    pub(super) fn psfs(&self, corners: &[Corner]) -> Result<Array2<f64>, ConvError> {
        let space = self.psfs.space();
        let mut vectors = self.psfs.vectors();
        let mut psfs = Array2::zeros((corners.len(), space.mean.len()));
        for (mut psf, corner) in psfs.outer_iter_mut().zip(corners) {
            match *corner {
                Corner::Node(node) => {
                    let nodes = self.nodes.as_ref().expect("a field with nodes");
                    psf.assign(&space.mean);
                    let mut along_components = psf.slice_mut(s![space.first_component()..]);
                    along_components += &nodes.row(node);
                }
                Corner::OfCell(block, corner) => {
                    let cells = self.blocks.get(block, || self.cells(block), |_| 0);
                    let cells: &Option<BlockCells> = &cells;
                    psf.assign(&cells.as_ref().expect("found before").psfs.row(corner));
                }
                Corner::Source(bits) => {
                    let [x, y] = bits.map(f64::from_bits);
                    vectors.set(Position::new(x, y).map_err(ConvError::Result)?)?;
                    psf.assign(&vectors.psf);
                }
            }
        }
        Ok(psfs)
    }
}

impl BlockCells {
    /// The corners of the cell at a position, and their weights.
    fn at(&self, position: Position) -> Option<[(usize, f64); 4]> {
        let x = position.x() - self.region.x0() as f64;
        let y = position.y() - self.region.y0() as f64;
        if x < 0.0 || y < 0.0 {
            return None;
        }
        let cells = &self.cells;
        let mut band = cells
            .bands
            .iter()
            .position(|band| band.rows.contains(&(y as usize)))?;
        // A cell may end between its last pixel and the next one.
        if cells
            .cells_of(&cells.bands[band])
            .iter()
            .all(|cell| cell.sides[1].1 < y)
        {
            band = (band + 1).min(cells.bands.len() - 1);
        }
        let of_band = cells.cells_of(&cells.bands[band]);
        let first = of_band
            .iter()
            .position(|cell| cell.columns.contains(&(x as usize)))?;
        let next = of_band.get(first + 1).filter(|_| of_band[first].sides[0].1 < x);
        let Cell { sides, corners, .. } = next.unwrap_or(&of_band[first]);
        let [a, b, c, d] = (*corners)?;
        let along = |(low, high): (f64, f64), at: f64| {
            if high > low {
                ((at - low) / (high - low)).clamp(0.0, 1.0)
            } else {
                0.0
            }
        };
        let (u, v) = (along(sides[0], x), along(sides[1], y));
        Some([
            (a, (1.0 - u) * (1.0 - v)),
            (b, u * (1.0 - v)),
            (c, (1.0 - u) * v),
            (d, u * v),
        ])
    }
}
