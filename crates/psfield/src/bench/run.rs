//! All contenders, in turn.

use conv_core::ConvReal;
use ndarray::Array2;
use psf_types::{Progress, PsfModel, Scene};

use super::peak_memory::PeakMemory;
use super::prepared::{Prepared, RunTime};
use super::reference::Reference;
use super::{BenchCase, BenchOptions, BenchOutcome, BenchRow, Contender, Skipped};
use crate::{Device, DeviceOptions, Gpus, PsfieldError, model_of};

/// A contender and what was measured of it so far.
struct Entry<T: ConvReal> {
    contender: Contender,
    prepared: Prepared<T>,
    relative_l2: Option<f64>,
    peak_memory_bytes: Option<u64>,
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
///
/// # Errors
/// [`PsfieldError`] when the frame is larger than the field of the PSF, the model's stamps do not suit an image, or a
/// convolution fails.
pub fn run<T: ConvReal>(
    case: &BenchCase<T>,
    contenders: &[Contender],
    options: &BenchOptions,
    progress: &dyn Progress,
) -> Result<BenchOutcome, PsfieldError> {
    let cpu = DeviceOptions::new(Device::Cpu);
    run_on(case, contenders, options, (&mut Gpus::default(), &cpu), progress)
}

/// The same with [`Contender::LowRank`] and [`Contender::Auto`] on a device; the others, the single PSF among them, run on the processor.
/// A plan's seconds are with what is handed to the GPU, without opening it where one was asked for.
///
/// # Errors
/// As [`run`], and as [`Gpus::place_plan`].
pub fn run_on<T: ConvReal>(
    case: &BenchCase<T>,
    contenders: &[Contender],
    options: &BenchOptions,
    (gpus, device): (&mut Gpus, &DeviceOptions),
    progress: &dyn Progress,
) -> Result<BenchOutcome, PsfieldError> {
    if let Device::Gpu { adapter } = device.device() {
        gpus.open(adapter.as_deref())?;
    }
    let model = model_of(case.record().clone())?;
    let scene = case.scene();
    let frame = scene.frame().shape();
    if let Some(field) = model.field_shape()
        && (frame.nx() > field.nx() || frame.ny() > field.ny())
    {
        return Err(PsfieldError::FrameBeyondField { frame, field });
    }
    let size = [frame.nx(), frame.ny()];
    let samples = case.record().coefficients().positions().len();
    let mut outcome = BenchOutcome::default();
    let others = contenders.iter().copied().filter(|&c| c != Contender::Single);
    let mut chosen = vec![Contender::Single];
    for contender in others {
        match reason_to_skip(contender, &model, scene, options) {
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
    let reference = Reference::new(&model, scene, options.anchor, options.pixels, options.seed)?;
    progress.advance(1);

    let mut image = Array2::zeros((frame.ny(), frame.nx()));
    let mut entries = Vec::with_capacity(chosen.len());
    for contender in chosen {
        let memory = PeakMemory::start();
        let prepared = Prepared::new(contender, case, &model, options, (gpus, device))?;
        let warm = prepared.run(scene, &mut image)?;
        let runs = (TURN_SECONDS / warm.seconds.max(f64::MIN_POSITIVE)).clamp(1.0, MOST_RUNS);
        entries.push(Entry {
            contender,
            prepared,
            relative_l2: reference.relative_l2(image.view()),
            peak_memory_bytes: memory.bytes(),
            runs_a_turn: runs as usize,
            runs: Vec::new(),
        });
        progress.advance(1);
    }
    for _ in 0..repeat {
        for entry in &mut entries {
            for _ in 0..entry.runs_a_turn {
                entry.runs.push(entry.prepared.run(scene, &mut image)?);
            }
            progress.advance(1);
        }
    }
    for entry in &mut entries {
        entry.runs.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    }
    let unit = entries[0].runs[0].seconds;
    outcome.rows = entries
        .into_iter()
        .map(|entry| BenchRow {
            method: entry.contender.method(),
            setting: entry.contender.setting(),
            tolerance: entry.contender.tolerance(),
            size,
            samples,
            rank: entry.prepared.rank,
            precision: T::NAME,
            anchor: options.anchor,
            seconds_plan: entry.prepared.seconds_plan,
            seconds: entry.runs[0].seconds,
            seconds_median: median(&entry.runs.iter().map(|run| run.seconds).collect::<Vec<_>>()),
            ratio_to_single: entry.runs[0].seconds / unit,
            relative_l2: entry.relative_l2,
            modes: entry.prepared.modes,
            tile: entry.prepared.tile,
            transform: entry.prepared.transform,
            threads: rayon::current_num_threads(),
            peak_memory_bytes: entry.peak_memory_bytes,
            gpu: entry.prepared.gpu,
            gpu_seconds: entry.runs[0].gpu,
        })
        .collect();
    Ok(outcome)
}

/// Why a contender cannot take part.
fn reason_to_skip<T: ConvReal>(
    contender: Contender,
    model: &PsfModel,
    scene: &Scene<T>,
    options: &BenchOptions,
) -> Option<String> {
    if contender != Contender::Direct {
        return None;
    }
    let lit = scene
        .pixels()
        .map_or(0, |pixels| pixels.iter().filter(|v| !v.is_zero()).count());
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
    use super::median;

    #[test]
    fn medians() {
        assert_eq!(median(&[1.0, 2.0, 9.0]), 2.0);
        assert_eq!(median(&[1.0, 2.0, 4.0, 9.0]), 3.0);
        assert_eq!(median(&[5.0]), 5.0);
    }
}
