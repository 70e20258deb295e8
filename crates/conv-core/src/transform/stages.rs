//! One-dimensional transforms, one in every lane, in place and in scrambled order.
//!
//! Forward transforms decimate in frequency: their input is in natural order, their output
//! scrambled. Inverse transforms decimate in time: their input is scrambled, their output in
//! natural order. A product of spectra does not depend on the order, so nothing is ever sorted.

use super::butterfly::{butterfly, times};
use crate::ConvReal;
use crate::simd::{Lanes, Pair};

/// The stages of transforms of one length.
#[derive(Debug)]
pub(crate) struct Stages<T> {
    len: usize,
    stages: Vec<Stage<T>>,
}

#[derive(Debug)]
struct Stage<T> {
    radix: usize,
    /// The number of values that a transform of this stage takes: `radix` times the block of the
    /// next stage.
    block: usize,
    /// `exp(-2 pi i j s / block)` for `j < block / radix`, `0 < s < radix`.
    twiddles: Vec<Pair<T>>,
}

impl<T: ConvReal> Stages<T> {
    /// Transforms of `len` values: a multiple of 16 without prime factors above 5.
    pub(crate) fn new(len: usize) -> Self {
        let mut block = len;
        let stages = radices(len)
            .into_iter()
            .map(|radix| {
                let step = block / radix;
                let twiddles = (0..step)
                    .flat_map(|j| (1..radix).map(move |s| (j, s)))
                    .map(|(j, s)| root(block, j * s))
                    .collect();
                let stage = Stage {
                    radix,
                    block,
                    twiddles,
                };
                block = step;
                stage
            })
            .collect();
        Self { len, stages }
    }

    /// `sum_n x_n exp(-2 pi i n k / len)`, in scrambled order. Values from index `filled` on count as
    /// zero and are not read.
    #[inline(always)]
    pub(crate) fn forward<S: Lanes<T>>(&self, simd: S, values: &mut [Pair<S::V>], filled: usize) {
        let values = &mut values[..self.len];
        self.forward_stages(simd, values, filled, self.stages.len());
    }

    /// Transforms `values` like [`forward`](Self::forward), and multiplies the result by `factor` like
    /// [`multiply_swapped`]. The content of `values` is undefined afterwards.
    #[inline(always)]
    pub(crate) fn forward_multiply_swapped<S: Lanes<T>>(
        &self,
        simd: S,
        values: &mut [Pair<S::V>],
        filled: usize,
        factor: &[Pair<S::V>],
        sum: &mut [Pair<S::V>],
        add: bool,
    ) {
        let (values, factor, sum) = (&mut values[..self.len], &factor[..self.len], &mut sum[..self.len]);
        let (last, first) = self.stages.split_last().expect("at least two stages");
        self.forward_stages(simd, values, filled, first.len());
        match last.radix {
            3 => multiply_last::<T, S, 3>(simd, values, factor, sum, add),
            4 => multiply_last::<T, S, 4>(simd, values, factor, sum, add),
            5 => multiply_last::<T, S, 5>(simd, values, factor, sum, add),
            _ => multiply_last::<T, S, 8>(simd, values, factor, sum, add),
        }
    }

    /// The first stages of [`forward`](Self::forward), `count` of them.
    #[inline(always)]
    fn forward_stages<S: Lanes<T>>(&self, simd: S, values: &mut [Pair<S::V>], filled: usize, count: usize) {
        let step = self.len / self.stages[0].radix;
        let only_first = filled <= step;
        let read = if only_first { step } else { self.len };
        values[filled..read].fill([simd.splat(T::zero()); 2]);
        for (index, stage) in self.stages[..count].iter().enumerate() {
            let only_first = index == 0 && only_first;
            match stage.radix {
                3 => stage.forward3(simd, values, only_first),
                4 => stage.forward4(simd, values, only_first),
                5 => stage.forward5(simd, values, only_first),
                _ => stage.forward8(simd, values, only_first),
            }
        }
    }

    /// The inverse transform times `len`, for values whose real and imaginary parts are swapped.
    /// The parts are swapped in the result too. The forward transform of swapped values is the
    /// swapped inverse transform times `len`, so the twiddles of the forward transform are used.
    #[inline(always)]
    pub(crate) fn inverse_of_swapped<S: Lanes<T>>(&self, simd: S, values: &mut [Pair<S::V>]) {
        let values = &mut values[..self.len];
        for stage in self.stages.iter().rev() {
            match stage.radix {
                3 => stage.inverse3(simd, values),
                4 => stage.inverse4(simd, values),
                5 => stage.inverse5(simd, values),
                _ => stage.inverse8(simd, values),
            }
        }
    }
}

/// Divides `$block` into legs of `$step` values, one for each name. A butterfly combines one value
/// of each leg.
macro_rules! cut {
    ($block:ident, $step:ident, $($leg:ident),+) => {
        let rest = $block;
        $(let ($leg, rest) = rest.split_at_mut($step);)+
        let _ = rest;
    };
}

/// The forward and the inverse transform of a stage with one radix. The loops name each leg,
/// because closures may not be inlined, and calls would be slow here.
macro_rules! radix {
    ($forward:ident, $inverse:ident, $radix:literal, $first:ident, $($leg:ident = $s:literal),+) => {
        /// If `only_first` is true, the other legs are not read and count as zero.
        #[inline(always)]
        fn $forward<S: Lanes<T>>(&self, simd: S, values: &mut [Pair<S::V>], only_first: bool) {
            let step = self.block / $radix;
            for block in values.chunks_exact_mut(self.block) {
                cut!(block, step, $first, $($leg),+);
                if step == 1 {
                    let y = butterfly::<T, S, $radix>(simd, [$first[0], $($leg[0]),+]);
                    $first[0] = y[0];
                    $($leg[0] = y[$s];)+
                } else if only_first {
                    for (j, w) in self.twiddles.chunks_exact($radix - 1).enumerate().take(step) {
                        let x = $first[j];
                        $($leg[j] = times(simd, x, splat(simd, w[$s - 1]));)+
                    }
                } else {
                    for (j, w) in self.twiddles.chunks_exact($radix - 1).enumerate().take(step) {
                        let y = butterfly::<T, S, $radix>(simd, [$first[j], $($leg[j]),+]);
                        $first[j] = y[0];
                        $($leg[j] = times(simd, y[$s], splat(simd, w[$s - 1]));)+
                    }
                }
            }
        }

        #[inline(always)]
        fn $inverse<S: Lanes<T>>(&self, simd: S, values: &mut [Pair<S::V>]) {
            let step = self.block / $radix;
            for block in values.chunks_exact_mut(self.block) {
                cut!(block, step, $first, $($leg),+);
                if step == 1 {
                    let y = butterfly::<T, S, $radix>(simd, [$first[0], $($leg[0]),+]);
                    $first[0] = y[0];
                    $($leg[0] = y[$s];)+
                } else {
                    for (j, w) in self.twiddles.chunks_exact($radix - 1).enumerate().take(step) {
                        let x = [$first[j], $(times(simd, $leg[j], splat(simd, w[$s - 1]))),+];
                        let y = butterfly::<T, S, $radix>(simd, x);
                        $first[j] = y[0];
                        $($leg[j] = y[$s];)+
                    }
                }
            }
        }
    };
}

impl<T: ConvReal> Stage<T> {
    radix!(forward3, inverse3, 3, a, b = 1, c = 2);
    radix!(forward4, inverse4, 4, a, b = 1, c = 2, d = 3);
    radix!(forward5, inverse5, 5, a, b = 1, c = 2, d = 3, e = 4);
    radix!(
        forward8,
        inverse8,
        8,
        a,
        b = 1,
        c = 2,
        d = 3,
        e = 4,
        f = 5,
        g = 6,
        h = 7
    );
}

/// The last stage of a forward transform, whose values are not stored but multiplied by `factor`.
#[inline(always)]
fn multiply_last<T: ConvReal, S: Lanes<T>, const R: usize>(
    simd: S,
    values: &[Pair<S::V>],
    factor: &[Pair<S::V>],
    sum: &mut [Pair<S::V>],
    add: bool,
) {
    let blocks = values.chunks_exact(R).zip(factor.chunks_exact(R));
    for ((block, factor), sum) in blocks.zip(sum.chunks_exact_mut(R)) {
        let block: &[Pair<S::V>; R] = block.try_into().expect("a block");
        multiply_swapped(simd, &butterfly::<T, S, R>(simd, *block), factor, sum, add);
    }
}

/// The product of two spectra, with real and imaginary parts swapped. The product is added to `sum`
/// if `add` is true, otherwise it replaces `sum`.
#[inline(always)]
pub(super) fn multiply_swapped<T: ConvReal, S: Lanes<T>>(
    simd: S,
    a: &[Pair<S::V>],
    b: &[Pair<S::V>],
    sum: &mut [Pair<S::V>],
    add: bool,
) {
    if add {
        for ((sum, a), b) in sum.iter_mut().zip(a).zip(b) {
            let imaginary = simd.mul_add(a[0], b[1], sum[0]);
            let real = simd.mul_add(a[0], b[0], sum[1]);
            *sum = [
                simd.mul_add(a[1], b[0], imaginary),
                simd.neg_mul_add(a[1], b[1], real),
            ];
        }
    } else {
        for ((sum, a), b) in sum.iter_mut().zip(a).zip(b) {
            let [real, imaginary] = times(simd, *a, *b);
            *sum = [imaginary, real];
        }
    }
}

#[inline(always)]
fn splat<T: ConvReal, S: Lanes<T>>(simd: S, w: Pair<T>) -> Pair<S::V> {
    [simd.splat(w[0]), simd.splat(w[1])]
}

/// `exp(-2 pi i k / n)`.
pub(crate) fn root<T: ConvReal>(n: usize, k: usize) -> Pair<T> {
    let angle = -std::f64::consts::TAU * (k % n) as f64 / n as f64;
    [T::nearest(angle.cos()), T::nearest(angle.sin())]
}

/// The radices of the stages, in order.
fn radices(len: usize) -> Vec<usize> {
    let mut rest = len;
    let mut radices = Vec::new();
    for odd in [5, 3] {
        while rest.is_multiple_of(odd) {
            radices.push(odd);
            rest /= odd;
        }
    }
    assert!(
        rest.is_power_of_two() && rest >= 16,
        "{len} is no length of a transform"
    );
    // Uses few stages, because each passes over all values. Most are of radix 8. Stages of 4 come before
    // them: the first stage can skip zeros, and with a smaller radix it can do so more often.
    let fours = [0, 2, 1][rest.trailing_zeros() as usize % 3];
    radices.resize(radices.len() + fours, 4);
    while radices.iter().product::<usize>() < len {
        radices.push(8);
    }
    radices
}
