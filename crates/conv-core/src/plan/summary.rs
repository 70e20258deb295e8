//! A plan in numbers.

use psf_types::{Anchor, FrameShape, PixelRegion, ToleranceOn};

use super::options::Paths;
use crate::view::in_words;

/// The decisions of a [`Plan`](crate::Plan). Prints as a few lines of text.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PlanSummary {
    /// The frame.
    pub frame: FrameShape,
    /// The part of the frame that the plan computes, in pixels of the frame. Only tiles and blocks
    /// that reach it are counted.
    pub region: PixelRegion,
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// The tolerance.
    pub tolerance: f64,
    /// The errors that the tolerance bounds.
    pub tolerance_on: ToleranceOn,
    /// The position at which the PSF is evaluated: source or output pixel.
    pub anchor: Anchor,
    /// The allowed methods for tiles.
    pub paths: Paths,
    /// Columns and rows of the largest tile.
    pub tile: (usize, usize),
    /// Columns and rows of the transforms.
    pub transform: (usize, usize),
    /// The number of tiles.
    pub tiles: usize,
    /// The number of blocks. The tiles of a block share one set of modes. Threads convolve blocks
    /// independently, so this is the number of tasks.
    pub blocks: usize,
    /// The number of blocks that have 0, 1, 2 ... modes, the reference included.
    pub blocks_by_modes: Vec<usize>,
    /// Tiles with at most this many lit pixels are drawn stamp by stamp. The number applies to a
    /// convolution (not its adjoint) and to a block with the mean number of modes.
    pub drawn_up_to: usize,
    /// True if the processor convolves fully lit tiles by the direct sum. A GPU always uses
    /// transforms for them.
    pub direct: bool,
    /// Predicted seconds of one execution on one thread if every pixel is lit, without the time to
    /// compute coefficients and stamps that are not kept.
    pub predicted_seconds: f64,
    /// Bytes kept for coefficients, and bytes kept for stamps.
    pub kept_bytes: (usize, usize),
    /// The number of blocks whose coefficients are not kept, and the number of blocks whose stamps
    /// are not kept. Each execution computes these again.
    pub made_anew: (usize, usize),
    /// Bytes for the coefficients and stamps of all blocks. Coefficients that are not kept count as
    /// much as the kept ones on average.
    pub all_bytes: usize,
}

impl PlanSummary {
    /// The mean number of modes per block, the reference included.
    pub fn mean_modes(&self) -> f64 {
        let modes: usize = self
            .blocks_by_modes
            .iter()
            .enumerate()
            .map(|(n, count)| n * count)
            .sum();
        modes as f64 / self.blocks.max(1) as f64
    }

    /// The largest number of modes in a block, the reference included.
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
        match self.tolerance_on {
            ToleranceOn::Aperture => writeln!(
                f,
                "guaranteed for the PSF of every position: relative L2 error and flux error in every circle within the tolerance"
            )?,
            _ => writeln!(
                f,
                "guaranteed for the PSF of every position: relative L2 error within the tolerance"
            )?,
        }
        writeln!(
            f,
            "tiles: {}, of up to {} x {} pixels; blocks: {}, each a task for one thread; \
             transforms of {} x {}",
            self.tiles, self.tile.0, self.tile.1, self.blocks, self.transform.0, self.transform.1
        )?;
        writeln!(
            f,
            "modes per block: mean {:.2}, maximum {}",
            self.mean_modes(),
            self.most_modes()
        )?;
        match (self.paths, self.direct) {
            (Paths::Transforms, _) => writeln!(f, "lit tiles: transforms")?,
            (_, direct) => {
                let method = if direct { "direct sum" } else { "transforms" };
                let most = self.drawn_up_to;
                writeln!(
                    f,
                    "tiles with at most {most} lit pixels: stamp by stamp; other lit tiles: {method}"
                )?;
            }
        }
        write!(
            f,
            "kept: coefficients {:.1} MiB, stamps {:.1} MiB; blocks computed by each execution: coefficients {}, stamps {}",
            mebibytes(self.kept_bytes.0),
            mebibytes(self.kept_bytes.1),
            self.made_anew.0,
            self.made_anew.1
        )
    }
}
