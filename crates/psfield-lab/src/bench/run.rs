//! All contenders in turn, and what is measured of them.

use conv_core::{ConvReal, Direct};
use ndarray::Array2;
use psf_types::{Anchor, Image, NoProgress, Progress, PsfModel};
use psfield::{Device, GpuSeconds, Psf, PsfieldError, Scene, model_of, open_gpu};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::bench::contender::{Prepared, RunTime};
use crate::bench::{BenchCase, Contender};
use crate::memory::PeakMemory;

/// How often contenders run, where, and how their errors are measured.
#[derive(Debug, Clone, PartialEq)]
pub struct BenchOptions {
    /// Whose PSF applies.
    pub anchor: Anchor,
    /// Timed turns of each contender, after a run that warms up; 0 counts as 1.
    pub repeat: usize,
    /// Random pixels at which images are compared with the direct sum; 0 counts as 1.
    pub pixels: usize,
    /// Chooses those pixels.
    pub seed: u64,
    /// The direct sum takes part only where its products (lit pixels x stamp pixels x stamps of the model) are not more.
    pub direct_products: f64,
    /// Where [`Contender::LowRank`] and [`Contender::Auto`] run; the others, the single PSF among them, run on the processor.
    pub device: Device,
    /// The GPU: [`SimulateOptions::gpu_adapter`](psfield::SimulateOptions::gpu_adapter).
    pub gpu_adapter: Option<String>,
    /// Bytes that a plan keeps there at most: [`SimulateOptions::gpu_memory`](psfield::SimulateOptions::gpu_memory).
    pub gpu_memory: Option<u64>,
}

impl BenchOptions {
    /// Products of the direct sum that take a few seconds.
    pub const DEFAULT_DIRECT_PRODUCTS: f64 = 2e9;
    /// Timed turns of each contender.
    pub const DEFAULT_REPEAT: usize = 3;
    /// Pixels compared.
    pub const DEFAULT_PIXELS: usize = 400;
    /// The seed.
    pub const DEFAULT_SEED: u64 = 1;
}

impl Default for BenchOptions {
    fn default() -> Self {
        Self {
            anchor: Anchor::default(),
            repeat: Self::DEFAULT_REPEAT,
            pixels: Self::DEFAULT_PIXELS,
            seed: Self::DEFAULT_SEED,
            direct_products: Self::DEFAULT_DIRECT_PRODUCTS,
            device: Device::Cpu,
            gpu_adapter: None,
            gpu_memory: None,
        }
    }
}

/// One contender's figures.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BenchRow {
    /// [`Contender::method`](crate::bench::Contender::method).
    pub method: &'static str,
    /// [`Contender::setting`](crate::bench::Contender::setting).
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

/// A contender and what was measured of it so far.
struct Entry<T: ConvReal> {
    prepared: Prepared<T>,
    runs_a_turn: usize,
    runs: Vec<RunTime>,
}

/// Work shorter than this runs more than once a turn, since a clock and a scheduler disturb it more.
const TURN_SECONDS: f64 = 0.02;
const MOST_RUNS: f64 = 20.0;

/// Plans and runs every contender, and the single PSF first if it is not among them.
///
/// A first run of each warms up, is measured against the direct sum and not timed; then all run in turn,
/// [`BenchOptions::repeat`] times, in each turn as often as fits into 20 ms, but not more than 20 times. All plans are held at once.
/// A plan's seconds are with what is handed to the GPU, without opening it where one was asked for.
///
/// # Errors
/// [`PsfieldError`] when the frame is larger than the field of the PSF, the model's stamps do not suit an image, a
/// convolution fails, or a GPU that was asked for cannot be used.
pub fn run<T: ConvReal>(
    case: &BenchCase<T>,
    contenders: &[Contender],
    options: &BenchOptions,
    progress: &dyn Progress,
) -> Result<BenchOutcome, PsfieldError> {
    if options.device == Device::Gpu {
        open_gpu(options.gpu_adapter.as_deref())?;
    }
    let psf = Psf::from(model_of(case.record.clone())?);
    let model = psf.model()?;
    let scene = Scene::from(&case.scene);
    let frame = case.scene.shape();
    if let Some(field) = model.field_shape()
        && (frame.nx() > field.nx() || frame.ny() > field.ny())
    {
        return Err(PsfieldError::FrameBeyondField { frame, field });
    }
    let size = [frame.nx(), frame.ny()];
    let samples = case.record.coefficients().positions().len();
    let mut outcome = BenchOutcome::default();
    let others = contenders.iter().copied().filter(|&c| c != Contender::Single);
    let mut chosen = vec![Contender::Single];
    for contender in others {
        match reason_to_skip(contender, model, &case.scene, options) {
            None => chosen.push(contender),
            Some(reason) => outcome.skipped.push(Skipped {
                method: contender.method(),
                setting: contender.setting(),
                size,
                samples,
                reason,
            }),
        }
    }
    let repeat = options.repeat.max(1);
    progress.start((1 + chosen.len() * (1 + repeat)) as u64);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let pixels: Vec<(usize, usize)> = (0..options.pixels.max(1))
        .map(|_| (rng.random_range(0..frame.nx()), rng.random_range(0..frame.ny())))
        .collect();
    let (direct, light) = (Direct::new(options.anchor), (case.scene.pixels(), (0, 0)));
    let exact = direct.at_pixels(model, light, frame, frame.region(), &pixels, &NoProgress)?;
    // `|F - E| / |E|` over the pixels; none where they are dark.
    let relative_l2 = |image: &Array2<T>| {
        let (mut error, mut norm) = (0.0, 0.0);
        for (&(x, y), exact) in pixels.iter().zip(&exact) {
            error += (image[[y, x]].as_f64() - exact).powi(2);
            norm += exact * exact;
        }
        (norm > 0.0).then(|| (error / norm).sqrt())
    };
    progress.advance(1);

    let mut image = Array2::zeros((frame.ny(), frame.nx()));
    let mut entries = Vec::with_capacity(chosen.len());
    for contender in chosen {
        let memory = PeakMemory::start();
        let mut prepared = Prepared::new(contender, case, &psf, options)?;
        let warm = prepared.run(&scene, &mut image)?;
        let runs = (TURN_SECONDS / warm.seconds.max(f64::MIN_POSITIVE)).clamp(1.0, MOST_RUNS);
        prepared.row.relative_l2 = relative_l2(&image);
        prepared.row.peak_memory_bytes = memory.bytes();
        entries.push(Entry {
            prepared,
            runs_a_turn: runs as usize,
            runs: Vec::new(),
        });
        progress.advance(1);
    }
    for _ in 0..repeat {
        for entry in &mut entries {
            for _ in 0..entry.runs_a_turn {
                entry.runs.push(entry.prepared.run(&scene, &mut image)?);
            }
            progress.advance(1);
        }
    }
    for Entry {
        prepared, mut runs, ..
    } in entries
    {
        runs.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
        let single = outcome.rows.first();
        let unit = single.map_or(runs[0].seconds, |single| single.seconds);
        outcome.rows.push(BenchRow {
            seconds: runs[0].seconds,
            seconds_median: median(&runs.iter().map(|run| run.seconds).collect::<Vec<_>>()),
            ratio_to_single: runs[0].seconds / unit,
            gpu_seconds: runs[0].gpu,
            ..prepared.row
        });
    }
    Ok(outcome)
}

/// Why a contender cannot take part.
fn reason_to_skip<T: ConvReal>(
    contender: Contender,
    model: &PsfModel,
    scene: &Image<T>,
    options: &BenchOptions,
) -> Option<String> {
    if contender != Contender::Direct {
        return None;
    }
    let lit = scene.pixels().iter().filter(|v| !v.is_zero()).count();
    let (stamp, stamps) = (model.grid().pixel_count(), model.stamp_count());
    let products = lit as f64 * stamp as f64 * stamps as f64;
    (products > options.direct_products).then(|| {
        format!(
            "{lit} lit pixels x {stamp} stamp pixels x {stamps} stamps are {products:.1e} products, more than {:.1e}",
            options.direct_products
        )
    })
}

/// Of ascending values.
fn median(sorted: &[f64]) -> f64 {
    let half = sorted.len() / 2;
    if sorted.len().is_multiple_of(2) {
        f64::midpoint(sorted[half - 1], sorted[half])
    } else {
        sorted[half]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians() {
        assert_eq!(median(&[1.0, 2.0, 9.0]), 2.0);
        assert_eq!(median(&[1.0, 2.0, 4.0, 9.0]), 3.0);
        assert_eq!(median(&[5.0]), 5.0);
    }
}
