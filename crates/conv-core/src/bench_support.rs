//! Private pieces for the benches of this crate: no part of its interface.

use crate::ConvReal;
use crate::simd::{Lanes, WithIsa};
use crate::transform::TileTransform;

/// The transform of a square tile as large as it holds with a stamp, and the planes that it works in.
#[derive(Debug)]
pub struct SquareTransform<T: ConvReal> {
    fft: TileTransform<T>,
    /// Pixels along each side of the tile and of the stamp.
    sides: [usize; 2],
    plane: Buffer<T>,
    spectrum: Buffer<T>,
    kernel: Buffer<T>,
    sum: Buffer<T>,
    result: Buffer<T>,
    column: Buffer<T>,
}

/// A step of a convolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The light's spectrum.
    Forward,
    /// The stamp's.
    Kernel,
    /// Their product, added to a sum.
    Multiply,
    /// Back to pixels. Overwrites the sum.
    Inverse,
}

impl<T: ConvReal> SquareTransform<T> {
    /// Transforms of `size x size` values, a multiple of 32 without prime factors above 5, with stamps of `stamp x stamp` pixels.
    pub fn new(size: usize, stamp: usize) -> Self {
        let fft = TileTransform::new(size, size);
        let length = fft.plane_len().max(fft.spectrum_len());
        let zeros = || Buffer::zeros(length);
        let mut plane = zeros();
        for (i, value) in plane.get_mut().iter_mut().enumerate() {
            *value = T::nearest((i % 17) as f64);
        }
        Self {
            column: Buffer::zeros(fft.column_len()),
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
    pub fn run(&mut self, step: Step) {
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
        simd.vectorized(
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
        );
    }
}

/// Values that start at a cache line.
#[derive(Debug)]
struct Buffer<T> {
    values: Vec<T>,
    start: usize,
    length: usize,
}

const CACHE_LINE: usize = 64;

impl<T: ConvReal> Buffer<T> {
    fn zeros(length: usize) -> Self {
        let values = vec![T::zero(); length + CACHE_LINE / size_of::<T>()];
        let past = values.as_ptr() as usize % CACHE_LINE;
        Self {
            start: (CACHE_LINE - past) % CACHE_LINE / size_of::<T>(),
            values,
            length,
        }
    }

    fn get(&self) -> &[T] {
        &self.values[self.start..self.start + self.length]
    }

    fn get_mut(&mut self) -> &mut [T] {
        &mut self.values[self.start..self.start + self.length]
    }
}

/// Runs `work` compiled for the best instruction set of this machine; what it calls must be inlined.
pub fn vectorized<T: ConvReal>(work: impl FnMut()) {
    struct Work<F>(F);
    impl<T: ConvReal, F: FnMut()> WithIsa<T> for Work<F> {
        type Output = ();
        fn run<S: Lanes<T>>(mut self, simd: S) {
            simd.vectorized(
                #[inline(always)]
                || (self.0)(),
            );
        }
    }
    T::dispatch(Work(work));
}
