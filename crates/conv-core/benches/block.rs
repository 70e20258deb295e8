//! What a block of tiles needs before any light comes: the weights of the field's nodes, the local modes, and the weighing of
//! light by a mode's coefficients.

mod common;

// The engine's own files, since what they hold is private to the crate.
#[allow(dead_code, reason = "a bench needs a part of it")]
#[allow(clippy::inline_always, reason = "what is vectorised must be inlined")]
#[path = "../src/lowrank/coefficient_table.rs"]
mod coefficient_table;
#[allow(dead_code, reason = "a bench needs a part of it")]
#[path = "../src/lowrank/local_modes.rs"]
mod local_modes;
#[allow(dead_code, reason = "a bench needs a part of it")]
#[path = "../src/lowrank/psf_space.rs"]
mod psf_space;
#[allow(dead_code, reason = "a bench needs a part of it")]
#[path = "../src/lowrank/region_runs.rs"]
mod region_runs;

use std::hint::black_box;

use conv_core::ConvReal;
use conv_core::bench_support::vectorized;
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use psf_types::{FrameShape, PixelRegion};

use coefficient_table::{CoefficientTable, FluxRole};
use local_modes::LocalModes;
use psf_space::PsfSpace;
use region_runs::RegionRuns;

/// Pixels along each side of a block.
const BLOCKS: [usize; 3] = [64, 128, 256];
const FRAME: usize = 2048;
const TOLERANCE: f64 = 1e-4;

fn region(side: usize) -> PixelRegion {
    // Across cells of the grid, as tiles lie.
    PixelRegion::new(700, 500, FrameShape::new(side, side).expect("a valid shape"))
}

fn modes(criterion: &mut Criterion) {
    let model = common::model(FRAME);
    let space = PsfSpace::new(&model);
    let mut group = criterion.benchmark_group("block");
    for side in BLOCKS {
        let region = region(side);
        group.bench_function(BenchmarkId::new("weights-along-rows", side), |bencher| {
            bencher.iter(|| black_box(RegionRuns::new(model.field(), region)));
        });
        let runs = RegionRuns::new(model.field(), region);
        group.bench_function(BenchmarkId::new("local-modes", side), |bencher| {
            bencher.iter(|| black_box(LocalModes::new(&space, &runs, TOLERANCE)));
        });
        let modes = LocalModes::new(&space, &runs, TOLERANCE);
        let (role, _) = FluxRole::of(&model, &modes, &runs);
        group.bench_function(BenchmarkId::new("coefficients", side), |bencher| {
            bencher.iter(|| black_box(CoefficientTable::<f32>::new(region, role, &modes, &runs)));
        });
    }
    group.finish();
}

fn weighing<T: ConvReal>(criterion: &mut Criterion) {
    let model = common::model(FRAME);
    let space = PsfSpace::new(&model);
    let mut group = criterion.benchmark_group(format!("weigh-{}", T::NAME));
    for side in BLOCKS {
        let runs = RegionRuns::new(model.field(), region(side));
        let modes = LocalModes::new(&space, &runs, TOLERANCE);
        let (role, _) = FluxRole::of(&model, &modes, &runs);
        let table = CoefficientTable::<T>::new(region(side), role, &modes, &runs);
        let last = table.kernel_count() - 1;
        let ramp: Vec<T> = (0..side).map(|i| T::nearest(i as f64)).collect();
        let light = vec![T::nearest(1.5); side * side];
        let mut weighted = light.clone();
        group.throughput(Throughput::Elements((side * side) as u64));
        group.bench_function(BenchmarkId::new("mode", side), |bencher| {
            bencher.iter(|| {
                vectorized::<T>(
                    #[inline(always)]
                    || {
                        let rows = light.chunks_exact(side).zip(weighted.chunks_exact_mut(side));
                        for (row, (light, weighted)) in rows.enumerate() {
                            table.weigh(last, row, 0, light, &ramp, weighted);
                        }
                    },
                );
                black_box(&mut weighted);
            });
        });
    }
    group.finish();
}

criterion_group!(benches, modes, weighing::<f32>, weighing::<f64>);
criterion_main!(benches);
