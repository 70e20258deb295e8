//! The work for a block of tiles that does not depend on the light: the field's cells, the local
//! modes, and their coefficients. Also the multiplication of light by a mode's
//! coefficients.

mod common;

use std::hint::black_box;

use conv_core::ConvReal;
use conv_core::internals::{
    CoefficientTable, FluxRole, FunctionRows, Inlined, Lanes, LocalModes, PsfSpace, RegionCells, WithIsa,
};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use psf_types::{FrameShape, PixelRegion, PsfModel, ToleranceOn};

/// Pixels along each side of a block.
const BLOCKS: [usize; 3] = [64, 128, 256];
const FRAME: usize = 2048;
const TOLERANCE: f64 = 1e-4;

/// The steps of the work for a block of tiles.
struct BlockSteps<T: ConvReal> {
    space: PsfSpace,
    region: PixelRegion,
    tolerance: f64,
    cells: RegionCells,
    modes: LocalModes,
    role: FluxRole,
    table: CoefficientTable<T>,
}

impl<T: ConvReal> BlockSteps<T> {
    /// The steps for a region of a model's field, with each step done once.
    fn new(model: &PsfModel, region: PixelRegion, tolerance: f64) -> Self {
        let space = PsfSpace::new(std::slice::from_ref(model), ToleranceOn::default());
        let (cells, _, modes) = LocalModes::of_region(&space, region, tolerance);
        let (role, _) = FluxRole::of(model, &modes, &modes.at_corners(&cells));
        Self {
            table: CoefficientTable::new(region, role, modes.at_corners(&cells), &cells),
            space,
            region,
            tolerance,
            cells,
            modes,
            role,
        }
    }

    /// Computes the cells and the modes.
    fn cells_and_modes(&mut self) {
        (self.cells, _, self.modes) = LocalModes::of_region(&self.space, self.region, self.tolerance);
    }

    /// Tabulates the modes' coefficients over the region.
    fn coefficients(&mut self) {
        self.table = CoefficientTable::new(
            self.region,
            self.role,
            self.modes.at_corners(&self.cells),
            &self.cells,
        );
    }

    /// Multiplies the region's light `[y, x]` by the coefficient of the last mode.
    fn weigh(&self, light: &[T], weighted: &mut [T]) {
        T::dispatch(Weigh(self, light, weighted));
    }
}

struct Weigh<'a, T: ConvReal>(&'a BlockSteps<T>, &'a [T], &'a mut [T]);

impl<T: ConvReal> WithIsa<T> for Weigh<'_, T> {
    type Output = ();
    fn run<S: Lanes<T>>(self, simd: S) {
        let Self(block, light, weighted) = self;
        let nx = block.region.shape().nx();
        let last = block.table.kernel_count() - 1;
        simd.vectorize(Inlined::new(
            #[inline(always)]
            || {
                let rows = light.chunks_exact(nx).zip(weighted.chunks_exact_mut(nx));
                let mut function = FunctionRows::default();
                function.place(&block.table, 0..nx, 0..block.region.shape().ny());
                function.set(&block.table, block.role.function_of(last));
                for (row, (light, weighted)) in rows.enumerate() {
                    function.multiply(row, light, weighted);
                }
            },
        ));
    }
}

fn steps<T: ConvReal>(side: usize) -> BlockSteps<T> {
    // The region covers several cells of the grid, like the blocks of a plan.
    let region = PixelRegion::new(700, 500, FrameShape::new(side, side).expect("a valid shape"));
    BlockSteps::new(&common::model(FRAME), region, TOLERANCE)
}

fn modes(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("block");
    for side in BLOCKS {
        let mut block = steps::<f32>(side);
        group.bench_function(BenchmarkId::new("cells-and-modes", side), |bencher| {
            bencher.iter(|| black_box(&mut block).cells_and_modes());
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
