//! Vectors of the widest instruction set that the machine has, chosen at run time.
//!
//! [`Isa`] is an instruction set, [`Lanes<T>`] its vectors of `T`. Code that is generic over both is compiled once for each
//! instruction set; [`dispatch`] picks one. Hot loops run inside [`Isa::vectorized`], which is where the compiler may use the
//! wide instructions: everything called there must be inlined.

mod transpose;

use pulp::bytemuck::Pod;
use pulp::{Simd, WithSimd};

/// Real and imaginary parts of as many complex numbers as a vector has lanes.
pub(crate) type Pair<V> = [V; 2];

/// An instruction set.
pub trait Isa: Simd {
    /// Transposes a square of as many complex vectors as each has lanes.
    #[inline(always)]
    fn transpose_f32(self, from: &[Pair<Self::f32s>], into: &mut [Pair<Self::f32s>]) {
        transpose::through_memory::<f32, _>(from, into, Self::F32_LANES);
    }

    /// Transposes a square of as many complex vectors as each has lanes.
    #[inline(always)]
    fn transpose_f64(self, from: &[Pair<Self::f64s>], into: &mut [Pair<Self::f64s>]) {
        transpose::through_memory::<f64, _>(from, into, Self::F64_LANES);
    }

    /// Runs `work` compiled for this instruction set.
    #[inline(always)]
    fn vectorized<R>(self, work: impl FnOnce() -> R) -> R {
        struct Inlined<F>(F);
        impl<R, F: FnOnce() -> R> WithSimd for Inlined<F> {
            type Output = R;
            #[inline(always)]
            fn with_simd<S: Simd>(self, _: S) -> R {
                (self.0)()
            }
        }
        self.vectorize(Inlined(work))
    }
}

impl Isa for pulp::Scalar {}
#[cfg(target_arch = "aarch64")]
impl Isa for pulp::aarch64::Neon {}

/// Vectors of `T` in an instruction set.
pub trait Lanes<T>: Isa {
    /// A vector.
    type V: Copy + Pod + Send + Sync;
    /// Values a vector.
    const LANES: usize;
    fn splat(self, value: T) -> Self::V;
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a b + c`.
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// `c - a b`.
    fn neg_mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// The first values of a vector: at most as many as it has lanes, and zeros.
    fn partial_load(self, from: &[T]) -> Self::V;
    /// Stores a vector's first values: at most as many as it has lanes.
    fn partial_store(self, into: &mut [T], values: Self::V);
    /// Transposes a square of as many complex vectors as each has lanes.
    fn transpose(self, from: &[Pair<Self::V>], into: &mut [Pair<Self::V>]);
}

macro_rules! lanes {
    ($t:ty, $v:ident, $lanes:ident, $splat:ident, $add:ident, $sub:ident, $mul:ident, $mul_add:ident, $neg:ident, $load:ident, $store:ident, $transpose:ident) => {
        impl<S: Isa> Lanes<$t> for S {
            type V = S::$v;
            const LANES: usize = S::$lanes;
            #[inline(always)]
            fn splat(self, value: $t) -> S::$v {
                Simd::$splat(self, value)
            }
            #[inline(always)]
            fn add(self, a: S::$v, b: S::$v) -> S::$v {
                Simd::$add(self, a, b)
            }
            #[inline(always)]
            fn sub(self, a: S::$v, b: S::$v) -> S::$v {
                Simd::$sub(self, a, b)
            }
            #[inline(always)]
            fn mul(self, a: S::$v, b: S::$v) -> S::$v {
                Simd::$mul(self, a, b)
            }
            #[inline(always)]
            fn mul_add(self, a: S::$v, b: S::$v, c: S::$v) -> S::$v {
                Simd::$mul_add(self, a, b, c)
            }
            #[inline(always)]
            fn neg_mul_add(self, a: S::$v, b: S::$v, c: S::$v) -> S::$v {
                Simd::$neg(self, a, b, c)
            }
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
    f32,
    f32s,
    F32_LANES,
    splat_f32s,
    add_f32s,
    sub_f32s,
    mul_f32s,
    mul_add_f32s,
    negate_mul_add_f32s,
    partial_load_f32s,
    partial_store_f32s,
    transpose_f32
);
lanes!(
    f64,
    f64s,
    F64_LANES,
    splat_f64s,
    add_f64s,
    sub_f64s,
    mul_f64s,
    mul_add_f64s,
    negate_mul_add_f64s,
    partial_load_f64s,
    partial_store_f64s,
    transpose_f64
);

/// Work that is generic over the instruction set.
pub trait WithIsa<T> {
    /// What it gives.
    type Output;
    /// Does the work with the vectors of an instruction set.
    fn run<S: Lanes<T>>(self, simd: S) -> Self::Output;
}

/// A working precision that has vectors in every instruction set.
pub trait SimdReal: Pod {
    /// Runs `work` with the best instruction set of this machine.
    fn dispatch<W: WithIsa<Self>>(work: W) -> W::Output;
}

macro_rules! simd_real {
    ($t:ty) => {
        impl SimdReal for $t {
            fn dispatch<W: WithIsa<Self>>(work: W) -> W::Output {
                #[cfg(target_arch = "x86_64")]
                {
                    if let Some(simd) = pulp::x86::V4::try_new() {
                        return work.run(simd);
                    }
                    if let Some(simd) = pulp::x86::V3::try_new() {
                        return work.run(simd);
                    }
                }
                #[cfg(target_arch = "aarch64")]
                if let Some(simd) = pulp::aarch64::Neon::try_new() {
                    return work.run(simd);
                }
                work.run(pulp::Scalar)
            }
        }
    };
}

simd_real!(f32);
simd_real!(f64);

/// Runs a test with every instruction set that this machine has.
#[cfg(all(test, target_arch = "x86_64"))]
pub(crate) fn with_every_isa<T: SimdReal, W: WithIsa<T, Output = ()> + Copy>(work: W)
where
    pulp::Scalar: Lanes<T>,
    pulp::x86::V3: Lanes<T>,
    pulp::x86::V4: Lanes<T>,
{
    work.run(pulp::Scalar);
    if let Some(simd) = pulp::x86::V3::try_new() {
        work.run(simd);
    }
    if let Some(simd) = pulp::x86::V4::try_new() {
        work.run(simd);
    }
    T::dispatch(work);
}

/// Runs a test with every instruction set that this machine has.
#[cfg(all(test, not(target_arch = "x86_64")))]
pub(crate) fn with_every_isa<T: SimdReal, W: WithIsa<T, Output = ()> + Copy>(work: W)
where
    pulp::Scalar: Lanes<T>,
{
    work.run(pulp::Scalar);
    T::dispatch(work);
}
