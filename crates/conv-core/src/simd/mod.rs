//! Vectors of an instruction set that is chosen at run time ([`InstructionSet`]).
//!
//! [`Isa`] is an instruction set, [`Lanes<T>`] its vectors of `T`. Code that is generic over both
//! is compiled once for each instruction set. [`SimdReal::dispatch`] chooses one at run time. Hot
//! loops run inside `vectorized!`, where the compiler may use the wide instructions. All functions
//! called there must be inlined.

mod instruction_set;
mod transpose;

pub use instruction_set::InstructionSet;

use psf_types::{LightProfile, Real};
use pulp::bytemuck::Pod;
use pulp::{Simd, WithSimd};
use rustfft::FftNum;

/// `vectorized!(simd, work)` computes an expression with all instructions of an instruction set, and
/// `vectorized!(work)` with those of the one that is used.
macro_rules! vectorized {
    ($simd:ident, $work:expr) => {
        pulp::Simd::vectorize(
            $simd,
            $crate::simd::Inlined::new(
                #[inline(always)]
                || $work,
            ),
        )
    };
    ($work:expr) => {
        <f32 as $crate::simd::SimdReal>::dispatch($crate::simd::Inlined::new(
            #[inline(always)]
            || $work,
        ))
    };
}
pub(crate) use vectorized;

/// Work for `vectorized!`.
#[derive(Debug)]
pub struct Inlined<F>(F);

impl<R, F: FnOnce() -> R> Inlined<F> {
    /// The bound `FnOnce` makes the closure one that can be called once only. Any other closure
    /// would be called through a function that is not inlined.
    #[inline(always)]
    pub fn new(work: F) -> Self {
        Self(work)
    }
}

impl<R, F: FnOnce() -> R> WithSimd for Inlined<F> {
    type Output = R;
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> R {
        (self.0)()
    }
}

impl<R, F: FnOnce() -> R> WithIsa<f32> for Inlined<F> {
    type Output = R;
    fn run<S: Lanes<f32>>(self, simd: S) -> R {
        simd.vectorize(self)
    }
}

/// The working precisions of this crate: `f32` and `f64`.
pub trait ConvReal: Real + FftNum + SimdReal {}
impl<T: Real + FftNum + SimdReal> ConvReal for T {}

/// The real and the imaginary part of a complex number, or vectors of these parts with one complex
/// number per lane.
pub(crate) type Pair<V> = [V; 2];

/// An instruction set.
pub trait Isa: Simd {
    /// Transposes a square matrix of complex values. Each pair of vectors is a row.
    #[inline(always)]
    fn transpose_f32(self, from: &[Pair<Self::f32s>], into: &mut [Pair<Self::f32s>]) {
        transpose::through_memory::<f32, _>(from, into, Self::F32_LANES);
    }

    /// Transposes a square matrix of complex values. Each pair of vectors is a row.
    #[inline(always)]
    fn transpose_f64(self, from: &[Pair<Self::f64s>], into: &mut [Pair<Self::f64s>]) {
        transpose::through_memory::<f64, _>(from, into, Self::F64_LANES);
    }
}

impl Isa for pulp::Scalar {}
#[cfg(target_arch = "aarch64")]
impl Isa for pulp::aarch64::Neon {}

/// Vectors of `T` in an instruction set.
pub trait Lanes<T>: Isa {
    /// A vector.
    type V: Copy + Pod + Send + Sync;
    /// The number of values in a vector.
    const LANES: usize;
    /// A vector with `value` in every lane.
    fn splat(self, value: T) -> Self::V;
    /// `a + b`.
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a - b`.
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a b`.
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a b + c`.
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// `c - a b`.
    fn neg_mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// Loads at most as many values as a vector has lanes, and sets the other lanes to zero.
    fn partial_load(self, from: &[T]) -> Self::V;
    /// Stores the first values of a vector, as many as `into` has room for.
    fn partial_store(self, into: &mut [T], values: Self::V);
    /// Transposes a square matrix of complex values. Each pair of vectors is a row.
    fn transpose(self, from: &[Pair<Self::V>], into: &mut [Pair<Self::V>]);
}

macro_rules! lanes {
    (
        $t:ty, $v:ident, $lanes:ident, $splat:ident, $load:ident, $store:ident, $transpose:ident,
        $($method:ident = $of_simd:ident($($arg:ident),+);)+
    ) => {
        impl<S: Isa> Lanes<$t> for S {
            type V = S::$v;
            const LANES: usize = S::$lanes;
            #[inline(always)]
            fn splat(self, value: $t) -> S::$v {
                Simd::$splat(self, value)
            }
            $(
                #[inline(always)]
                fn $method(self, $($arg: S::$v),+) -> S::$v {
                    Simd::$of_simd(self, $($arg),+)
                }
            )+
            #[inline(always)]
            fn partial_load(self, from: &[$t]) -> S::$v {
                Simd::$load(self, from)
            }
            #[inline(always)]
            fn partial_store(self, into: &mut [$t], values: S::$v) {
                Simd::$store(self, into, values);
            }
            #[inline(always)]
            fn transpose(self, from: &[Pair<S::$v>], into: &mut [Pair<S::$v>]) {
                Isa::$transpose(self, from, into);
            }
        }
    };
}

lanes!(
    f32, f32s, F32_LANES, splat_f32s, partial_load_f32s, partial_store_f32s, transpose_f32,
    add = add_f32s(a, b);
    sub = sub_f32s(a, b);
    mul = mul_f32s(a, b);
    mul_add = mul_add_f32s(a, b, c);
    neg_mul_add = negate_mul_add_f32s(a, b, c);
);
lanes!(
    f64, f64s, F64_LANES, splat_f64s, partial_load_f64s, partial_store_f64s, transpose_f64,
    add = add_f64s(a, b);
    sub = sub_f64s(a, b);
    mul = mul_f64s(a, b);
    mul_add = mul_add_f64s(a, b, c);
    neg_mul_add = negate_mul_add_f64s(a, b, c);
);

/// Work that is generic over the instruction set.
pub trait WithIsa<T> {
    /// The result of the work.
    type Output;
    /// Does the work with the vectors of an instruction set.
    fn run<S: Lanes<T>>(self, simd: S) -> Self::Output;
}

/// A working precision that has vectors in every instruction set.
pub trait SimdReal: Pod {
    /// Runs `work` with the instruction set that is [used](InstructionSet::used).
    fn dispatch<W: WithIsa<Self>>(work: W) -> W::Output;
    /// Computes the transform of light ([`LightProfile::transform_into`]) in this precision.
    fn transform_into(light: &dyn LightProfile, kx: f64, first_ky: f64, step: f64, values: &mut [Self]);
    /// Runs a test with every instruction set that this machine has.
    #[cfg(test)]
    fn dispatch_to_all<W: WithIsa<Self, Output = ()> + Copy>(work: W);
}

macro_rules! simd_real {
    ($t:ty, $transform_into:ident) => {
        impl SimdReal for $t {
            fn transform_into(
                light: &dyn LightProfile,
                kx: f64,
                first_ky: f64,
                step: f64,
                values: &mut [Self],
            ) {
                light.$transform_into(kx, first_ky, step, values);
            }

            fn dispatch<W: WithIsa<Self>>(work: W) -> W::Output {
                let used = InstructionSet::used();
                #[cfg(target_arch = "x86_64")]
                {
                    if used == InstructionSet::Avx512
                        && let Some(simd) = pulp::x86::V4::try_new()
                    {
                        return work.run(simd);
                    }
                    if used == InstructionSet::Avx2
                        && let Some(simd) = pulp::x86::V3::try_new()
                    {
                        return work.run(simd);
                    }
                }
                #[cfg(target_arch = "aarch64")]
                if used == InstructionSet::Neon
                    && let Some(simd) = pulp::aarch64::Neon::try_new()
                {
                    return work.run(simd);
                }
                work.run(pulp::Scalar)
            }

            #[cfg(test)]
            fn dispatch_to_all<W: WithIsa<Self, Output = ()> + Copy>(work: W) {
                work.run(pulp::Scalar);
                #[cfg(target_arch = "x86_64")]
                if let Some(simd) = pulp::x86::V3::try_new() {
                    work.run(simd);
                }
                Self::dispatch(work);
            }
        }
    };
}

simd_real!(f32, transform_into);
simd_real!(f64, transform_f64_into);

/// The scalar product of two rows, in sums that vectorise.
#[inline(always)]
pub(crate) fn sum_of_products<T: ConvReal>(a: &[T], b: &[T]) -> f64 {
    const LANES: usize = 16;
    let mut sums = [T::zero(); LANES];
    let (a, b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = a.remainder().iter().zip(b.remainder());
    let rest: f64 = rest.map(|(&a, &b)| (a * b).as_f64()).sum();
    for (a, b) in a.zip(b) {
        for ((sum, &a), &b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    sums.iter().map(|sum| sum.as_f64()).sum::<f64>() + rest
}

/// A list of values that begins at a cache line.
#[derive(Debug, Default)]
pub struct Aligned<T> {
    values: Vec<T>,
    start: usize,
    length: usize,
}

const CACHE_LINE: usize = 64;

impl<T: ConvReal> Aligned<T> {
    /// Returns `length` zeros.
    pub fn zeros(length: usize) -> Self {
        let values = vec![T::zero(); length + CACHE_LINE / size_of::<T>()];
        // A `Vec` is aligned at least to the size of a value, so `past` is a multiple of this size.
        let past = values.as_ptr() as usize % CACHE_LINE;
        Self {
            start: (CACHE_LINE - past) % CACHE_LINE / size_of::<T>(),
            values,
            length,
        }
    }

    /// The values.
    pub fn get(&self) -> &[T] {
        &self.values[self.start..self.start + self.length]
    }

    /// The values, writable.
    pub fn get_mut(&mut self) -> &mut [T] {
        &mut self.values[self.start..self.start + self.length]
    }

    /// Makes room for at least `length` values. The content of all values is undefined afterwards.
    pub(crate) fn at_least(&mut self, length: usize) {
        if self.length < length {
            *self = Self::zeros(length);
        }
    }
}
