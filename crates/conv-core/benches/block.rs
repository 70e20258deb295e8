//! What a block of tiles needs before any light comes: the weights of the field's nodes, the local modes, and the weighing of
//! light by a mode's coefficients.

mod common;

use std::hint::black_box;

use conv_core::ConvReal;
use conv_core::bench_support::BlockSteps;
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use psf_types::{FrameShape, PixelRegion};

/// Pixels along each side of a block.
const BLOCKS: [usize; 3] = [64, 128, 256];
const FRAME: usize = 2048;
const TOLERANCE: f64 = 1e-4;

fn steps<T: ConvReal>(side: usize) -> BlockSteps<T> {
    // Across cells of the grid, as tiles lie.
    let region = PixelRegion::new(700, 500, FrameShape::new(side, side).expect("a valid shape"));
    BlockSteps::new(&common::model(FRAME), region, TOLERANCE)
}

fn modes(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("block");
    for side in BLOCKS {
        let mut block = steps::<f32>(side);
        group.bench_function(BenchmarkId::new("weights-along-rows", side), |bencher| {
            bencher.iter(|| black_box(&mut block).weights_along_rows());
        });
        group.bench_function(BenchmarkId::new("local-modes", side), |bencher| {
            bencher.iter(|| black_box(&mut block).local_modes());
        });
        group.bench_function(BenchmarkId::new("coefficients", side), |bencher| {
            bencher.iter(|| black_box(&mut block).coefficients());
        });
    }
    group.finish();
}

fn weighing<T: ConvReal>(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group(format!("weigh-{}", T::NAME));
    for side in BLOCKS {
        let block = steps::<T>(side);
        let light = vec![T::nearest(1.5); side * side];
        let mut weighted = light.clone();
        group.throughput(Throughput::Elements((side * side) as u64));
        group.bench_function(BenchmarkId::new("mode", side), |bencher| {
            bencher.iter(|| block.weigh(black_box(&light), &mut weighted));
        });
    }
    group.finish();
}

criterion_group!(benches, modes, weighing::<f32>, weighing::<f64>);
criterion_main!(benches);
