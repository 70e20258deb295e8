//! Runs all contenders in turn and measures them.

use conv_core::{ConvReal, Direct};
use metrics::{Comparison, Summary};
use ndarray::{Array1, Array2, ArrayView1};
use psf_types::{Anchor, Image, NoProgress, Progress, PsfModel, ToleranceOn};
use psfield::device::{GpuSeconds, open_gpu};
use psfield::evaluate::check_frame_on_field;
use psfield::fit::model_of;
use psfield::{Device, Psf, PsfieldError, Scene};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::bench::contender::{PlannedContender, timed_run};
use crate::bench::{BenchCase, Contender};
use crate::memory::PeakMemory;

/// Settings of a benchmark: repetitions, device, and the measurement of errors.
#[derive(Debug, Clone, PartialEq)]
pub struct BenchOptions {
    /// The position at which the PSF is evaluated: source or output pixel.
    pub anchor: Anchor,
    /// The errors that the tolerances of [`Contender::LowRank`] and [`Contender::Auto`] bound.
    pub tolerance_on: ToleranceOn,
    /// Number of timed turns of each contender, after a first run that is not timed. 0 counts as 1.
    pub repeat: usize,
    /// Number of random pixels at which images are compared with the direct sum. 0 counts as 1.
    pub pixels: usize,
    /// Seed of the random choice of these pixels.
    pub seed: u64,
    /// The direct sum takes part only if its number of products (lit pixels x stamp pixels x stamps
    /// of the model) is at most this number.
    pub direct_products: f64,
    /// The device of [`Contender::LowRank`] and [`Contender::Auto`]. The others, including the
    /// single PSF, run on the processor.
    pub device: Device,
    /// The GPU to use: a part of its name, or its backend, as in
    /// [`SimulateOptions::gpu_adapter`](psfield::SimulateOptions::gpu_adapter). None: the preferred
    /// GPU.
    pub gpu_adapter: Option<String>,
    /// Largest number of bytes that a plan keeps on the GPU, as in
    /// [`SimulateOptions::gpu_memory`](psfield::SimulateOptions::gpu_memory).
    pub gpu_memory: Option<u64>,
}

impl BenchOptions {
    /// Default of [`direct_products`](Self::direct_products). The direct sum takes a few seconds
    /// for this number of products.
    pub const DEFAULT_DIRECT_PRODUCTS: f64 = 2e9;
    /// Default number of timed turns of each contender.
    pub const DEFAULT_REPEAT: usize = 3;
    /// Default number of compared pixels.
    pub const DEFAULT_PIXELS: usize = 400;
    /// Default seed.
    pub const DEFAULT_SEED: u64 = 1;
}

impl Default for BenchOptions {
    fn default() -> Self {
        Self {
            anchor: Anchor::default(),
            tolerance_on: ToleranceOn::default(),
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

/// The results of one contender.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BenchRow {
    /// [`Contender::method`](crate::bench::Contender::method).
    pub method: &'static str,
    /// [`Contender::setting`](crate::bench::Contender::setting).
    pub setting: Option<String>,
    /// The requested tolerance. None for the methods that take no tolerance.
    pub tolerance: Option<f64>,
    /// Columns and rows of the frame.
    pub size: [usize; 2],
    /// Number of PSF samples.
    pub samples: usize,
    /// Components of the contender's model, the mean not counted.
    pub rank: usize,
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// The position at which the PSF was evaluated: source or output pixel.
    pub anchor: Anchor,
    /// Seconds to make the plan. None for methods without a plan.
    pub seconds_plan: Option<f64>,
    /// Seconds of the fastest timed run.
    pub seconds: f64,
    /// Median of the seconds of the timed runs.
    pub seconds_median: f64,
    /// [`seconds`](Self::seconds) divided by the seconds of the single PSF.
    pub ratio_to_single: f64,
    /// Relative L2 difference `|F - E| / |E|` over the compared pixels, between the image `F` and
    /// the direct sum `E` with all components. None if `E` is 0 at all these pixels.
    pub relative_l2: Option<f64>,
    /// For the methods with a plan: mean number of modes per block of tiles. Each tile needs one
    /// convolution per mode. For `basis`: number of convolutions of the whole frame. 1 for `patch`,
    /// None for `direct`.
    pub modes: Option<f64>,
    /// Columns and rows of the largest tile, or of a patch. None for `basis` and `direct`.
    pub tile: Option<[usize; 2]>,
    /// Columns and rows of the Fourier transforms of a tile. None for methods without a plan.
    pub transform: Option<[usize; 2]>,
    /// Number of threads that shared the work.
    pub threads: usize,
    /// The largest memory that the process held between the start of planning and the end of the
    /// first run. None if the system does not report it (only Linux does). It includes the plans of
    /// earlier contenders. To measure the memory of one method, run the benchmark with this method
    /// alone.
    pub peak_memory_bytes: Option<u64>,
    /// The GPU on which the contender ran: name, kind and backend. None if it ran on the processor.
    pub gpu: Option<String>,
    /// The times of the steps of the fastest run on the GPU. None if it ran on the processor.
    pub gpu_seconds: Option<GpuSeconds>,
}

/// A contender that did not run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Skipped {
    /// The method of the contender.
    pub method: &'static str,
    /// The setting of the contender.
    pub setting: Option<String>,
    /// Columns and rows of the frame.
    pub size: [usize; 2],
    /// Number of PSF samples.
    pub samples: usize,
    /// The reason why the contender did not run.
    pub reason: String,
}

/// The results of all contenders for one [`BenchCase`].
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct BenchOutcome {
    /// The single PSF first, then the others in the requested order.
    pub rows: Vec<BenchRow>,
    /// The contenders that did not run.
    pub skipped: Vec<Skipped>,
}

/// A run that takes fewer seconds is repeated within a turn. The clock and the scheduler disturb
/// short runs more than long runs.
const MIN_SECONDS_PER_TURN: f64 = 0.02;
const MOST_RUNS: f64 = 20.0;

/// Number of runs of a turn, if a run takes this number of seconds.
pub(super) fn runs_per_turn(seconds: f64) -> usize {
    (MIN_SECONDS_PER_TURN / seconds.max(f64::MIN_POSITIVE)).clamp(1.0, MOST_RUNS) as usize
}

/// Plans and runs the single PSF, then the other contenders. The direct sum is skipped if it needs
/// more than [`BenchOptions::direct_products`] products.
///
/// The first run of each contender warms up: it is not timed, but its image is compared with the
/// direct sum. Then all contenders run in turn, [`BenchOptions::repeat`] times. In each turn a
/// contender runs as often as fits into 20 ms, at least once and at most 20 times. The plans of all
/// contenders are in memory at once. The seconds of a plan include the transfer to the GPU,
/// but not the time to open a requested GPU.
///
/// # Errors
/// [`PsfieldError`] if the frame is larger than the field of the PSF, if the stamps of the model
/// are not sampled at the centres of the frame's pixels or lack the pixel response, if a
/// convolution fails, or if a requested GPU cannot be used.
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
    check_frame_on_field(frame, model.field_shape())?;
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
    progress.advance(1);

    let mut image = Array2::zeros((frame.ny(), frame.nx()));
    let mut planned = Vec::with_capacity(chosen.len());
    for contender in chosen {
        let memory = PeakMemory::start();
        let mut contender = PlannedContender::new(contender, case, &psf, options)?;
        let warm = timed_run(&contender.simulator, &scene, &mut image)?;
        contender.row.relative_l2 = relative_l2(&image, &pixels, &exact);
        contender.row.peak_memory_bytes = memory.bytes();
        planned.push((contender, runs_per_turn(warm.seconds), Vec::new()));
        progress.advance(1);
    }
    for _ in 0..repeat {
        for (contender, runs_per_turn, runs) in &mut planned {
            for _ in 0..*runs_per_turn {
                runs.push(timed_run(&contender.simulator, &scene, &mut image)?);
            }
            progress.advance(1);
        }
    }
    for (contender, _, mut runs) in planned {
        runs.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
        let single = outcome.rows.first();
        let unit = single.map_or(runs[0].seconds, |single| single.seconds);
        outcome.rows.push(BenchRow {
            seconds: runs[0].seconds,
            seconds_median: Summary::of(runs.iter().map(|run| run.seconds))?.median(),
            ratio_to_single: runs[0].seconds / unit,
            gpu_seconds: runs[0].gpu,
            ..contender.row
        });
    }
    Ok(outcome)
}

/// Returns `|F - E| / |E|` over some pixels `(column, row)`, between an image `F` and the exact
/// values `E` of these pixels. None if `E` is 0 at all of them.
pub(super) fn relative_l2<T: ConvReal>(
    image: &Array2<T>,
    pixels: &[(usize, usize)],
    exact: &[f64],
) -> Option<f64> {
    let found: Array1<T> = pixels.iter().map(|&(x, y)| image[[y, x]]).collect();
    let comparison = Comparison::of(found.view(), ArrayView1::from(exact)).ok()?;
    comparison.relative_l2().ok()
}

/// Returns the reason why a contender cannot take part, if there is one.
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
            "{lit} pixels with light x {stamp} stamp pixels x {stamps} stamps are {products:.1e} products, more than the limit of {:.1e}",
            options.direct_products
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_relative_to_the_exact_values() {
        let image = ndarray::arr2(&[[1.0, 2.0], [3.0, 4.0]]);
        let error = |pixels: &[(usize, usize)], exact: &[f64]| relative_l2(&image, pixels, exact);
        assert_eq!(error(&[(1, 0)], &[2.5]), Some(0.2));
        assert_eq!(error(&[(1, 0), (0, 1)], &[2.0, 3.0]), Some(0.0));
        assert_eq!(error(&[(1, 1)], &[0.0]), None);
    }
}
