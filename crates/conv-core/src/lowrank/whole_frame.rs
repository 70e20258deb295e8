//! What plans of all regions of a frame share.

use std::ops::Range;

use psf_types::{Anchor, FrameShape, PixelRegion, Progress, PsfModel};

use super::axis_cuts::Stretch;
use super::cost_model::CostModel;
use super::geometry::Geometry;
use super::options::PlanOptions;
use super::plan::rounding;
use super::psf_space::PsfSpace;
use super::tiling::{Tiling, best_tiling};
use crate::crop::reaching;
use crate::kernel::Reach;
use crate::{ConvError, ConvReal};

/// A scene seen through a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct View {
    pub(crate) shape: FrameShape,
    /// In pixels of the scene.
    pub(crate) frame: PixelRegion,
}

/// The vectors of a model's PSFs, and the tiles of the whole frame: they are the same for each of its regions, so that all regions have the
/// same modes.
#[derive(Debug)]
pub(crate) struct WholeFrame {
    pub(crate) view: View,
    pub(crate) space: PsfSpace,
    geometry: Geometry,
    tiling: Tiling,
    reach: Reach,
    anchor: Anchor,
}

/// What a plan takes of the whole.
pub(crate) struct Part {
    /// Columns and rows of the scene that reach the region.
    pub(crate) light: [Range<usize>; 2],
    pub(crate) geometry: Geometry,
    /// Cut to the weighted side of that geometry.
    pub(crate) tiling: Tiling,
    /// The columns and rows of the whole's blocks that it has tiles of.
    pub(crate) blocks: [Range<usize>; 2],
}

impl WholeFrame {
    /// The choice of tiles.
    pub(crate) fn new<T: ConvReal>(
        model: &PsfModel,
        view: View,
        options: PlanOptions,
        progress: &dyn Progress,
    ) -> Result<Self, ConvError> {
        let (reach, anchor) = (Reach::of(model.grid())?, options.anchor());
        let (_, geometry) = view.sides(view.frame.shape().region(), reach, anchor)?;
        let space = PsfSpace::new(model);
        let tiling = best_tiling(
            model,
            &space,
            &geometry,
            options.tolerance().max(rounding::<T>()),
            CostModel::of::<T>(),
            options.memory_bytes(),
            progress,
        )?;
        Ok(Self {
            view,
            space,
            geometry,
            tiling,
            reach,
            anchor,
        })
    }

    /// What there is of a region of the frame.
    pub(crate) fn part(&self, region: PixelRegion) -> Result<Part, ConvError> {
        let frame = self.view.frame.shape();
        if !frame.region().contains(region) {
            return Err(ConvError::RegionOutsideFrame { region, frame });
        }
        let (light, geometry) = self.view.sides(region, self.reach, self.anchor)?;
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

    /// The pixels of a block, in field positions.
    pub(crate) fn block(&self, column: usize, row: usize) -> PixelRegion {
        self.tiling.region(&self.geometry, column, row)
    }

    /// The length of the longest row of a block.
    pub(crate) fn longest_row(&self) -> usize {
        let lengths = self.tiling.columns.iter().map(Stretch::length);
        lengths.max().unwrap_or(1)
    }
}

impl View {
    /// Columns and rows of the scene that reach a region of the frame, and the two sides of the operator between them.
    fn sides(
        self,
        region: PixelRegion,
        reach: Reach,
        anchor: Anchor,
    ) -> Result<([Range<usize>; 2], Geometry), ConvError> {
        let (x0, y0) = (self.frame.x0(), self.frame.y0());
        let [columns, rows] = reaching(self.shape, region.shifted(x0, y0), reach);
        let shape = FrameShape::new(columns.len(), rows.len()).map_err(ConvError::Result)?;
        let light = PixelRegion::new(columns.start as i64 - x0, rows.start as i64 - y0, shape);
        Ok(([columns, rows], Geometry::new(light, region, reach, anchor)))
    }
}
