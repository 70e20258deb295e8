//! The engine's transforms of a square tile, step by step, compared with realfft and rustfft at the
//! same size.

#[path = "common/rows_then_columns.rs"]
mod rows_then_columns;

use std::hint::black_box;

use conv_core::ConvReal;
use conv_core::internals::{Aligned, Inlined, Lanes, TileTransform, WithIsa};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rows_then_columns::RowsThenColumns;

const SIZES: [usize; 5] = [128, 192, 256, 320, 512];
const STAMP: usize = 64;

/// The transform of the largest square tile that fits with a stamp, and its planes.
struct SquareTransform<T: ConvReal> {
    fft: TileTransform<T>,
    /// Pixels along each side of the tile and of the stamp.
    sides: [usize; 2],
    plane: Aligned<T>,
    spectrum: Aligned<T>,
    kernel: Aligned<T>,
    sum: Aligned<T>,
    result: Aligned<T>,
    column: Aligned<T>,
}

/// A step of a convolution.
#[derive(Clone, Copy)]
enum Step {
    /// The light's spectrum.
    Forward,
    /// The stamp's spectrum.
    Kernel,
    /// Their product, added to a sum.
    Multiply,
    /// The inverse transform, which overwrites the sum.
    Inverse,
}

impl<T: ConvReal> SquareTransform<T> {
    /// Transforms of `size x size` values, a multiple of 32 without prime factors above 5, with
    /// stamps of `stamp x stamp` pixels.
    fn new(size: usize, stamp: usize) -> Self {
        let fft = TileTransform::new(size, size);
        let length = fft.plane_len().max(fft.spectrum_len());
        let zeros = || Aligned::zeros(length);
        let mut plane = zeros();
        for (i, value) in plane.get_mut().iter_mut().enumerate() {
            *value = T::nearest((i % 17) as f64);
        }
        Self {
            column: Aligned::zeros(fft.column_len()),
            sides: [size + 1 - stamp, stamp],
            plane,
            spectrum: zeros(),
            kernel: zeros(),
            sum: zeros(),
            result: zeros(),
            fft,
        }
    }

    /// Does a step with the best instruction set of this machine, on this thread.
    fn run(&mut self, step: Step) {
        T::dispatch(Run(self, step));
    }
}

struct Run<'a, T: ConvReal>(&'a mut SquareTransform<T>, Step);

impl<T: ConvReal> WithIsa<T> for Run<'_, T> {
    type Output = ();
    fn run<S: Lanes<T>>(self, simd: S) {
        let Self(all, step) = self;
        let [tile, stamp] = all.sides;
        let (plane, column) = (all.plane.get(), all.column.get_mut());
        simd.vectorize(Inlined::new(
            #[inline(always)]
            || match step {
                Step::Forward => all
                    .fft
                    .forward(simd, plane, (tile, tile), all.spectrum.get_mut(), column),
                Step::Kernel => all
                    .fft
                    .forward(simd, plane, (stamp, stamp), all.kernel.get_mut(), column),
                Step::Multiply => all.fft.multiply_swapped(
                    simd,
                    all.spectrum.get(),
                    all.kernel.get(),
                    all.sum.get_mut(),
                    true,
                ),
                Step::Inverse => {
                    let size = (tile + stamp - 1, tile + stamp - 1);
                    all.fft
                        .inverse_of_swapped(simd, all.sum.get_mut(), size, all.result.get_mut(), column);
                }
            },
        ));
    }
}

fn transforms<T: ConvReal>(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group(format!("transform-{}", T::NAME));
    for size in SIZES {
        group.throughput(Throughput::Elements((size * size) as u64));
        let mut ours = SquareTransform::<T>::new(size, STAMP);
        for (name, step) in [
            ("forward", Step::Forward),
            ("kernel", Step::Kernel),
            ("multiply", Step::Multiply),
            ("inverse", Step::Inverse),
        ] {
            group.bench_function(BenchmarkId::new(name, size), |bencher| {
                bencher.iter(|| black_box(&mut ours).run(step));
            });
            // New buffers, because sums would grow until they are infinite, and denormal numbers
            // are slow.
            ours = SquareTransform::new(size, STAMP);
            ours.run(Step::Forward);
            ours.run(Step::Kernel);
        }
        let mut theirs = RowsThenColumns::<T>::new(size, size + 1 - STAMP);
        group.bench_function(BenchmarkId::new("realfft-forward", size), |bencher| {
            bencher.iter(|| black_box(&mut theirs).forward());
        });
    }
    group.finish();
}

criterion_group!(benches, transforms::<f32>, transforms::<f64>);
criterion_main!(benches);
