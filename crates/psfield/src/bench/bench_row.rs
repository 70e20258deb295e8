//! What was measured.

use psf_types::Anchor;
use serde::Serialize;

use crate::GpuSeconds;

/// One contender's figures.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BenchRow {
    /// [`Contender::method`](super::Contender::method).
    pub method: &'static str,
    /// [`Contender::setting`](super::Contender::setting).
    pub setting: Option<String>,
    /// The tolerance asked for, of the methods that take one.
    pub tolerance: Option<f64>,
    /// Columns and rows of the frame.
    pub size: [usize; 2],
    /// Samples of the PSF.
    pub samples: usize,
    /// Components of the model that the contender convolves with, the mean not counted.
    pub rank: usize,
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// Whose PSF applies.
    pub anchor: Anchor,
    /// Seconds to plan, once; none for methods that prepare nothing.
    pub seconds_plan: Option<f64>,
    /// Seconds of the fastest run.
    pub seconds: f64,
    /// Median seconds of the runs.
    pub seconds_median: f64,
    /// [`seconds`](Self::seconds) over those of the single PSF.
    pub ratio_to_single: f64,
    /// Relative L2 difference from the direct sum over the whole model, `|F - E| / |E|` over the pixels compared; none where those
    /// are dark.
    pub relative_l2: Option<f64>,
    /// Convolutions a tile, in the mean; of the whole frame for `basis`; none for `direct`.
    pub modes: Option<f64>,
    /// Columns and rows of the largest tile, where there are tiles.
    pub tile: Option<[usize; 2]>,
    /// Columns and rows of a tile's transforms, where a plan chose them.
    pub transform: Option<[usize; 2]>,
    /// Threads that shared the work.
    pub threads: usize,
    /// The most memory that the process held from before the plan to the end of the first run, where the system tells (Linux): the plans
    /// made before and what they left are in it, so that a method's own figure is that of a run without others.
    pub peak_memory_bytes: Option<u64>,
    /// The GPU that it ran on: name, kind and backend. None on the processor.
    pub gpu: Option<String>,
    /// Where the time of the fastest run went on the GPU.
    pub gpu_seconds: Option<GpuSeconds>,
}

/// A contender that did not run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Skipped {
    /// Its method.
    pub method: &'static str,
    /// Its setting.
    pub setting: Option<String>,
    /// Columns and rows of the frame.
    pub size: [usize; 2],
    /// Samples of the PSF.
    pub samples: usize,
    /// Why.
    pub reason: String,
}

/// What came of a case.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct BenchOutcome {
    /// The single PSF first, then the others in the order asked for.
    pub rows: Vec<BenchRow>,
    /// What did not run.
    pub skipped: Vec<Skipped>,
}
