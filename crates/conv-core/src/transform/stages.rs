//! One-dimensional transforms, one in every lane, in place and in scrambled order.
//!
//! Forward transforms decimate in frequency: their input is in natural order, their output
//! scrambled. Inverse transforms decimate in time: their input is scrambled, their output in
//! natural order. A product of spectra does not depend on the order, so nothing is ever sorted.

use super::butterfly::{add, butterfly, times};
use crate::ConvReal;
use crate::simd::{Lanes, Pair};

/// The stages of transforms of one length.
#[derive(Debug)]
pub(crate) struct Stages<T> {
    len: usize,
    list: Vec<Stage<T>>,
    /// `exp(-2 pi i n s / len)` for each block `s` of the second stage and all `n < len`.
    roots: Vec<Pair<T>>,
}

/// The other factor of a product: a transform, or values that are still to be transformed.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Factor<'a, V> {
    Transform(&'a [Pair<V>]),
    Values(&'a [Pair<V>]),
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
        let of_len: Vec<Pair<T>> = (0..len).map(|k| root(len, k)).collect();
        let radices = radices(len);
        let roots = (0..radices[0]).flat_map(|s| (0..len).map(move |n| n * s % len));
        let roots = roots.map(|k| of_len[k]).collect();
        let mut block = len;
        let list = radices
            .into_iter()
            .map(|radix| {
                let step = block / radix;
                let twiddles = (0..step)
                    .flat_map(|j| (1..radix).map(move |s| j * s))
                    .map(|k| of_len[k * (len / block)])
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
        Self { len, list, roots }
    }

    /// `sum_n x_n exp(-2 pi i n k / len)`, in scrambled order. Values beyond the last count as zero.
    #[inline(always)]
    pub(crate) fn forward<S: Lanes<T>>(&self, simd: S, values: &[Pair<S::V>], transform: &mut [Pair<S::V>]) {
        let transform = &mut transform[..self.len];
        self.first_stage(simd, values, transform);
        forward_stages(&self.list[1..], simd, transform);
    }

    /// Like [`forward`](Self::forward), in place. Values from index `filled` on count as zero and are not
    /// read.
    #[inline(always)]
    pub(crate) fn forward_in_place<S: Lanes<T>>(&self, simd: S, values: &mut [Pair<S::V>], filled: usize) {
        values[filled..self.len].fill([simd.splat(T::zero()); 2]);
        forward_stages(&self.list, simd, &mut values[..self.len]);
    }

    /// Transforms `values` like [`forward`](Self::forward), and multiplies the result by `factor` like
    /// [`multiply_swapped`]. `work` has room for `len` values and for one block of the second stage.
    ///
    /// After the first stage, each block goes through all other stages before the next block, so that
    /// it stays in the first-level cache.
    #[inline(always)]
    pub(crate) fn forward_multiply_swapped<S: Lanes<T>>(
        &self,
        simd: S,
        values: &[Pair<S::V>],
        factor: Factor<'_, S::V>,
        sum: &mut [Pair<S::V>],
        add: bool,
        work: &mut [Pair<S::V>],
    ) {
        let rest = &self.list[1..];
        let (last, middle) = rest.split_last().expect("at least two stages");
        let step = self.len / self.list[0].radix;
        let (work, other) = work.split_at_mut(self.len);
        self.first_stage(simd, values, work);
        let blocks = work.chunks_exact_mut(step).zip(sum.chunks_exact_mut(step));
        for (s, (block, sum)) in blocks.enumerate() {
            forward_stages(middle, simd, block);
            let factor = match factor {
                Factor::Transform(factor) => &factor[s * step..(s + 1) * step],
                Factor::Values(values) => {
                    let other = &mut other[..step];
                    self.first_block(simd, values, s, other);
                    forward_stages(rest, simd, other);
                    other
                }
            };
            match last.radix {
                3 => multiply_last::<T, S, 3>(simd, block, factor, sum, add),
                4 => multiply_last::<T, S, 4>(simd, block, factor, sum, add),
                5 => multiply_last::<T, S, 5>(simd, block, factor, sum, add),
                _ => multiply_last::<T, S, 8>(simd, block, factor, sum, add),
            }
        }
    }

    /// The number of values in a block of the first stage. If not more values are given, their transform does
    /// not depend on whether all blocks are computed together.
    pub(super) fn first_step(&self) -> usize {
        self.len / self.list[0].radix
    }

    #[inline(always)]
    fn first_stage<S: Lanes<T>>(&self, simd: S, values: &[Pair<S::V>], into: &mut [Pair<S::V>]) {
        let first = &self.list[0];
        let step = self.len / first.radix;
        if values.len() <= step {
            for (s, block) in into.chunks_exact_mut(step).enumerate() {
                self.first_block(simd, values, s, block);
            }
            return;
        }
        match first.radix {
            3 => first.forward_from3(simd, values, into),
            4 => first.forward_from4(simd, values, into),
            5 => first.forward_from5(simd, values, into),
            _ => first.forward_from8(simd, values, into),
        }
    }

    /// The result of the first stage that is block `s` of the second stage.
    #[inline(always)]
    fn first_block<S: Lanes<T>>(&self, simd: S, values: &[Pair<S::V>], s: usize, block: &mut [Pair<S::V>]) {
        let step = block.len();
        let legs = self.roots[s * self.len..(s + 1) * self.len].chunks_exact(step);
        for (leg, roots) in legs.enumerate().take(values.len().div_ceil(step).max(1)) {
            for (j, (into, &root)) in block.iter_mut().zip(roots).enumerate() {
                let product = times(simd, at(simd, values, leg * step + j), splat(simd, root));
                *into = if leg == 0 {
                    product
                } else {
                    add(simd, *into, product)
                };
            }
        }
    }

    /// The inverse transform times `len`, for values whose real and imaginary parts are swapped.
    /// The parts are swapped in the result too. The forward transform of swapped values is the
    /// swapped inverse transform times `len`, so the twiddles of the forward transform are used.
    #[inline(always)]
    pub(crate) fn inverse_of_swapped<S: Lanes<T>>(&self, simd: S, values: &mut [Pair<S::V>]) {
        let values = &mut values[..self.len];
        for stage in self.list.iter().rev() {
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

/// The forward and inverse transforms of a stage with one radix. The loops name each leg,
/// because closures may not be inlined, and calls would be slow here.
macro_rules! radix {
    (
        $forward:ident, $forward_from:ident, $inverse:ident,
        $radix:literal, $first:ident, $($leg:ident = $s:literal),+
    ) => {
        #[inline(always)]
        fn $forward<S: Lanes<T>>(&self, simd: S, values: &mut [Pair<S::V>]) {
            let step = self.block / $radix;
            for block in values.chunks_exact_mut(self.block) {
                cut!(block, step, $first, $($leg),+);
                if step == 1 {
                    let y = butterfly::<T, S, $radix>(simd, [$first[0], $($leg[0]),+]);
                    $first[0] = y[0];
                    $($leg[0] = y[$s];)+
                } else {
                    for (j, w) in self.twiddles.chunks_exact($radix - 1).enumerate().take(step) {
                        let y = butterfly::<T, S, $radix>(simd, [$first[j], $($leg[j]),+]);
                        $first[j] = y[0];
                        $($leg[j] = times(simd, y[$s], splat(simd, w[$s - 1]));)+
                    }
                }
            }
        }

        /// Like the forward transform of one block, but the values come from elsewhere.
        #[inline(always)]
        fn $forward_from<S: Lanes<T>>(&self, simd: S, values: &[Pair<S::V>], block: &mut [Pair<S::V>]) {
            let step = self.block / $radix;
            cut!(block, step, $first, $($leg),+);
            for (j, w) in self.twiddles.chunks_exact($radix - 1).enumerate().take(step) {
                let x = [at(simd, values, j), $(at(simd, values, j + $s * step)),+];
                let y = butterfly::<T, S, $radix>(simd, x);
                $first[j] = y[0];
                $($leg[j] = times(simd, y[$s], splat(simd, w[$s - 1]));)+
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
    radix!(forward3, forward_from3, inverse3, 3, a, b = 1, c = 2);
    radix!(forward4, forward_from4, inverse4, 4, a, b = 1, c = 2, d = 3);
    radix!(
        forward5,
        forward_from5,
        inverse5,
        5,
        a,
        b = 1,
        c = 2,
        d = 3,
        e = 4
    );
    radix!(
        forward8,
        forward_from8,
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

#[inline(always)]
fn forward_stages<T: ConvReal, S: Lanes<T>>(stages: &[Stage<T>], simd: S, values: &mut [Pair<S::V>]) {
    for stage in stages {
        match stage.radix {
            3 => stage.forward3(simd, values),
            4 => stage.forward4(simd, values),
            5 => stage.forward5(simd, values),
            _ => stage.forward8(simd, values),
        }
    }
}

/// The value at an index, or zero beyond the last.
#[inline(always)]
fn at<T: ConvReal, S: Lanes<T>>(simd: S, values: &[Pair<S::V>], index: usize) -> Pair<S::V> {
    if index < values.len() {
        values[index]
    } else {
        [simd.splat(T::zero()); 2]
    }
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
