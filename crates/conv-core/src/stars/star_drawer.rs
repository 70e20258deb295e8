//! Draws the stars of a catalogue.

use std::sync::Arc;

use ndarray::ArrayViewMut2;
use psf_types::{Anchor, PixelRegion, PointSource, PsfModel};

use super::draw_blocks::{BlockDrawer, DrawBlocks, Phased, StarsToDraw};
use super::painter::{StarPainter, StarStamps};
use super::phases::PhasedAxis;
use crate::dropped_light::DroppedLight;
use crate::plan::cost_model::CostModel;
use crate::sources::SourcePsfs;
use crate::stamp_interpolator::Kernel;
use crate::{ConvError, ConvReal};

/// Draws stars from local bases, and those beyond the tolerance from all components. A clone has the same
/// local bases.
#[derive(Debug, Clone)]
pub(crate) struct StarDrawer<T> {
    stamps: Arc<StarStamps>,
    /// `None` if all stars are drawn from all components.
    pub(super) phased: Option<Arc<Phased<T>>>,
}

impl<T: ConvReal> StarDrawer<T> {
    /// Prepares the stamps. If `exactly`, all stars are drawn from all components.
    pub(crate) fn new(psfs: &SourcePsfs, exactly: bool) -> Result<Self, ConvError> {
        let anchor = psfs.options().anchor();
        let stamps = StarStamps::new(psfs.models(), anchor, psfs.size())?;
        let axes = PhasedAxis::both(psfs.model.grid(), stamps.kernel, stamps.window())
            .filter(|_| anchor != Anchor::Output && !exactly);
        let phased = axes
            .map(|axes| Phased::new(psfs, axes, stamps.target))
            .transpose()?;
        Ok(Self {
            phased: phased.map(Arc::new),
            stamps: Arc::new(stamps),
        })
    }

    /// A drawer with local bases of its own, for other models with these stamps.
    pub(crate) fn with_own_bases(&self, psfs: &SourcePsfs) -> Self {
        let own = |phased: &Arc<Phased<T>>| Arc::new(phased.with_own_blocks(psfs.options()));
        Self {
            stamps: Arc::clone(&self.stamps),
            phased: self.phased.as_ref().map(own),
        }
    }

    /// The interpolation of stamps, and the frame pixels that a star may light relative to its own.
    pub(crate) fn kernel_and_window(&self) -> (Kernel, PixelRegion) {
        (self.stamps.kernel, self.stamps.window())
    }

    /// Draws single stars of a frame from all components.
    pub(crate) fn painter<'a>(&self, psfs: &'a SourcePsfs, frame: PixelRegion) -> StarPainter<'a> {
        StarPainter {
            model: &psfs.model,
            frame,
            stamps: Arc::clone(&self.stamps),
        }
    }

    /// The seconds to draw one of so many stars on a frame.
    pub(crate) fn seconds_of_star(&self, model: &PsfModel, stars: usize, frame: PixelRegion) -> f64 {
        let Some(phased) = &self.phased else {
            let taps = self.stamps.kernel.tap_count();
            let products = model.stamp_count() * model.grid().pixel_count();
            return CostModel::paint_star(products + taps * taps * self.stamps.target.pixel_count());
        };
        let spreader = &phased.spreader;
        let blocks = frame.shape().pixel_count() as f64 / (spreader.side * spreader.side) as f64;
        spreader.seconds_of_star(stars as f64 / blocks)
    }

    /// About how many blocks of stars a frame has.
    pub(crate) fn block_count(&self, frame: PixelRegion) -> usize {
        self.phased.as_ref().map_or(0, |phased| {
            let blocks = [frame.shape().nx(), frame.shape().ny()].map(|n| n.div_ceil(phased.spreader.side));
            blocks[0] * blocks[1]
        })
    }

    /// Adds the light that stars drop at most, in the part of the frame that `dropped` covers.
    pub(crate) fn add_dropped(
        &self,
        psfs: &SourcePsfs,
        catalogue: StarsToDraw<'_>,
        region: PixelRegion,
        dropped: &mut DroppedLight,
    ) {
        match &self.phased {
            Some(phased) => self
                .block_drawer(psfs, phased, catalogue, region)
                .add_dropped(dropped),
            None => catalogue
                .stars
                .iter()
                .for_each(|star| dropped.count(star.flux(), 0.0)),
        }
    }

    pub(super) fn block_drawer<'a>(
        &self,
        psfs: &'a SourcePsfs,
        phased: &'a Phased<T>,
        catalogue: StarsToDraw<'a>,
        region: PixelRegion,
    ) -> BlockDrawer<'a, T> {
        BlockDrawer {
            psfs,
            phased,
            catalogue,
            window: self.stamps.window(),
            region,
        }
    }

    /// Adds stars to a part of an image, whose rows are contiguous in memory.
    pub(crate) fn draw_into(
        &self,
        psfs: &SourcePsfs,
        catalogue: StarsToDraw<'_>,
        region: PixelRegion,
        mut image: ArrayViewMut2<'_, T>,
    ) -> Result<(), ConvError> {
        let painter = self.painter(psfs, catalogue.frame);
        let Some(phased) = &self.phased else {
            return painter.draw_into(catalogue.stars, region, image, catalogue.progress);
        };
        let drawer = self.block_drawer(psfs, phased, catalogue, region);
        let mut missed = T::dispatch(DrawBlocks {
            drawer,
            image: image.view_mut(),
        })?;
        missed.sort_unstable();
        let missed: Vec<PointSource> = missed.into_iter().map(|index| catalogue.stars[index]).collect();
        painter.draw_into(&missed, region, image, catalogue.progress)
    }
}
