//! A plan in figures.

use psf_types::{Anchor, FrameShape, PixelRegion};

use super::options::Paths;
use crate::view::in_words;

/// What a [`Plan`](crate::Plan) decided. Prints as a few lines of text.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PlanSummary {
    /// The frame.
    pub frame: FrameShape,
    /// The part of the frame that the plan makes, in pixels of the frame. Tiles and blocks are those that reach it.
    pub region: PixelRegion,
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// The tolerance asked for.
    pub tolerance: f64,
    /// The anchoring.
    pub anchor: Anchor,
    /// The paths that tiles may take.
    pub paths: Paths,
    /// Columns and rows of the largest tile.
    pub tile: (usize, usize),
    /// Columns and rows of the transforms.
    pub transform: (usize, usize),
    /// The number of tiles.
    pub tiles: usize,
    /// The number of local bases; tiles of a block share one.
    pub blocks: usize,
    /// Blocks by the number of their modes, the reference among them.
    pub blocks_by_modes: Vec<usize>,
    /// Tiles with at most this many lit pixels are drawn stamp by stamp, where the modes are the mean number.
    pub drawn_up_to: usize,
    /// Whether fully lit tiles are convolved without transforms.
    pub direct: bool,
    /// Predicted seconds of an execution on one thread where every pixel is lit.
    pub predicted_seconds: f64,
    /// Bytes kept: coefficients, and stamps.
    pub kept_bytes: (usize, usize),
    /// Blocks whose coefficients, and whose stamps, are made anew by each execution.
    pub made_anew: (usize, usize),
}

impl PlanSummary {
    /// Modes a block in the mean, the reference among them.
    pub fn mean_modes(&self) -> f64 {
        let modes: usize = self
            .blocks_by_modes
            .iter()
            .enumerate()
            .map(|(n, count)| n * count)
            .sum();
        modes as f64 / self.blocks.max(1) as f64
    }

    /// The most modes of a block.
    pub fn most_modes(&self) -> usize {
        self.blocks_by_modes.len().saturating_sub(1)
    }
}

impl std::fmt::Display for PlanSummary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mebibytes = |bytes: usize| bytes as f64 / f64::from(1 << 20);
        if self.region != self.frame.region() {
            write!(f, "{} of ", in_words(self.region))?;
        }
        writeln!(
            f,
            "{} pixels in {}, tolerance {:e}, {}-anchored",
            self.frame, self.precision, self.tolerance, self.anchor
        )?;
        writeln!(
            f,
            "{} tiles of up to {} x {} pixels in {} blocks, transforms of {} x {}",
            self.tiles, self.tile.0, self.tile.1, self.blocks, self.transform.0, self.transform.1
        )?;
        writeln!(
            f,
            "modes a block: {:.2} in the mean, {} at most",
            self.mean_modes(),
            self.most_modes()
        )?;
        match (self.paths, self.direct) {
            (Paths::Transforms, _) => writeln!(f, "lit tiles by transforms")?,
            (_, direct) => {
                let way = if direct { "the direct sum" } else { "transforms" };
                let most = self.drawn_up_to;
                writeln!(f, "lit tiles by {way}, up to {most} pixels stamp by stamp")?;
            }
        }
        write!(
            f,
            "kept: coefficients {:.1} MiB, stamps {:.1} MiB; made anew by each execution: coefficients of {} blocks, stamps of {}",
            mebibytes(self.kept_bytes.0),
            mebibytes(self.kept_bytes.1),
            self.made_anew.0,
            self.made_anew.1
        )
    }
}
