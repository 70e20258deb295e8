//! Transposition of squares of vectors.

use pulp::bytemuck::{Pod, cast_slice, cast_slice_mut};

use super::Pair;

/// Transposes any square matrix, value by value.
#[inline(always)]
pub(super) fn through_memory<T: Pod, V: Pod>(from: &[Pair<V>], into: &mut [Pair<V>], side: usize) {
    let (from, into) = (cast_slice::<_, T>(from), cast_slice_mut::<_, T>(into));
    for row in 0..side {
        for part in 0..2 {
            for column in 0..side {
                into[(2 * column + part) * side + row] = from[(2 * row + part) * side + column];
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{__m256, __m256d, __m512, __m512d};

    use pulp::x86::{V3, V4};
    use pulp::{cast, f32x8, f32x16, f64x4, f64x8};

    use super::super::{Isa, Pair};

    impl Isa for V4 {
        #[inline(always)]
        fn transpose_f32(self, from: &[Pair<f32x16>], into: &mut [Pair<f32x16>]) {
            let from: &[Pair<f32x16>; 16] = from.try_into().expect("a square");
            let into: &mut [Pair<f32x16>; 16] = into.try_into().expect("a square");
            for part in 0..2 {
                let s = self.avx512f;
                let mut r: [__m512; 16] = [cast!(from[0][part]); 16];
                for i in 1..16 {
                    r[i] = cast!(from[i][part]);
                }
                // Transposes squares of 4 x 4 within quarters of 128 bits. Quarter `q` of
                // `t[4 g + c]` then holds column `4 q + c` of rows `4 g` to `4 g + 3`.
                let mut t = r;
                for g in 0..4 {
                    let (a, b, c, d) = (r[4 * g], r[4 * g + 1], r[4 * g + 2], r[4 * g + 3]);
                    let (ab0, ab1) = (s._mm512_unpacklo_ps(a, b), s._mm512_unpackhi_ps(a, b));
                    let (cd0, cd1) = (s._mm512_unpacklo_ps(c, d), s._mm512_unpackhi_ps(c, d));
                    t[4 * g] = s._mm512_shuffle_ps::<0x44>(ab0, cd0);
                    t[4 * g + 1] = s._mm512_shuffle_ps::<0xee>(ab0, cd0);
                    t[4 * g + 2] = s._mm512_shuffle_ps::<0x44>(ab1, cd1);
                    t[4 * g + 3] = s._mm512_shuffle_ps::<0xee>(ab1, cd1);
                }
                // Row `4 q + c` of the result collects the quarters `q` of all `t[4 g + c]`.
                for c in 0..4 {
                    let (t0, t1, t2, t3) = (t[c], t[4 + c], t[8 + c], t[12 + c]);
                    let low = s._mm512_shuffle_f32x4::<0x88>(t0, t1);
                    let high = s._mm512_shuffle_f32x4::<0xdd>(t0, t1);
                    let low2 = s._mm512_shuffle_f32x4::<0x88>(t2, t3);
                    let high2 = s._mm512_shuffle_f32x4::<0xdd>(t2, t3);
                    into[c][part] = cast!(s._mm512_shuffle_f32x4::<0x88>(low, low2));
                    into[8 + c][part] = cast!(s._mm512_shuffle_f32x4::<0xdd>(low, low2));
                    into[4 + c][part] = cast!(s._mm512_shuffle_f32x4::<0x88>(high, high2));
                    into[12 + c][part] = cast!(s._mm512_shuffle_f32x4::<0xdd>(high, high2));
                }
            }
        }

        #[inline(always)]
        fn transpose_f64(self, from: &[Pair<f64x8>], into: &mut [Pair<f64x8>]) {
            let from: &[Pair<f64x8>; 8] = from.try_into().expect("a square");
            let into: &mut [Pair<f64x8>; 8] = into.try_into().expect("a square");
            for part in 0..2 {
                let s = self.avx512f;
                let mut r: [__m512d; 8] = [cast!(from[0][part]); 8];
                for i in 1..8 {
                    r[i] = cast!(from[i][part]);
                }
                // Transposes squares of 2 x 2 within quarters of 128 bits. Quarter `q` of
                // `t[2 g + c]` then holds column `2 q + c` of rows `2 g` and `2 g + 1`.
                let mut t = r;
                for g in 0..4 {
                    t[2 * g] = s._mm512_unpacklo_pd(r[2 * g], r[2 * g + 1]);
                    t[2 * g + 1] = s._mm512_unpackhi_pd(r[2 * g], r[2 * g + 1]);
                }
                for c in 0..2 {
                    let (t0, t1, t2, t3) = (t[c], t[2 + c], t[4 + c], t[6 + c]);
                    let low = s._mm512_shuffle_f64x2::<0x88>(t0, t1);
                    let high = s._mm512_shuffle_f64x2::<0xdd>(t0, t1);
                    let low2 = s._mm512_shuffle_f64x2::<0x88>(t2, t3);
                    let high2 = s._mm512_shuffle_f64x2::<0xdd>(t2, t3);
                    into[c][part] = cast!(s._mm512_shuffle_f64x2::<0x88>(low, low2));
                    into[4 + c][part] = cast!(s._mm512_shuffle_f64x2::<0xdd>(low, low2));
                    into[2 + c][part] = cast!(s._mm512_shuffle_f64x2::<0x88>(high, high2));
                    into[6 + c][part] = cast!(s._mm512_shuffle_f64x2::<0xdd>(high, high2));
                }
            }
        }
    }

    impl Isa for V3 {
        #[inline(always)]
        fn transpose_f32(self, from: &[Pair<f32x8>], into: &mut [Pair<f32x8>]) {
            let from: &[Pair<f32x8>; 8] = from.try_into().expect("a square");
            let into: &mut [Pair<f32x8>; 8] = into.try_into().expect("a square");
            for part in 0..2 {
                let s = self.avx;
                let mut r: [__m256; 8] = [cast!(from[0][part]); 8];
                for i in 1..8 {
                    r[i] = cast!(from[i][part]);
                }
                let mut t = r;
                for g in 0..2 {
                    let (a, b, c, d) = (r[4 * g], r[4 * g + 1], r[4 * g + 2], r[4 * g + 3]);
                    let (ab0, ab1) = (s._mm256_unpacklo_ps(a, b), s._mm256_unpackhi_ps(a, b));
                    let (cd0, cd1) = (s._mm256_unpacklo_ps(c, d), s._mm256_unpackhi_ps(c, d));
                    t[4 * g] = s._mm256_shuffle_ps::<0x44>(ab0, cd0);
                    t[4 * g + 1] = s._mm256_shuffle_ps::<0xee>(ab0, cd0);
                    t[4 * g + 2] = s._mm256_shuffle_ps::<0x44>(ab1, cd1);
                    t[4 * g + 3] = s._mm256_shuffle_ps::<0xee>(ab1, cd1);
                }
                for c in 0..4 {
                    into[c][part] = cast!(s._mm256_permute2f128_ps::<0x20>(t[c], t[4 + c]));
                    into[4 + c][part] = cast!(s._mm256_permute2f128_ps::<0x31>(t[c], t[4 + c]));
                }
            }
        }

        #[inline(always)]
        fn transpose_f64(self, from: &[Pair<f64x4>], into: &mut [Pair<f64x4>]) {
            let from: &[Pair<f64x4>; 4] = from.try_into().expect("a square");
            let into: &mut [Pair<f64x4>; 4] = into.try_into().expect("a square");
            for part in 0..2 {
                let s = self.avx;
                let mut r: [__m256d; 4] = [cast!(from[0][part]); 4];
                for i in 1..4 {
                    r[i] = cast!(from[i][part]);
                }
                let low = [s._mm256_unpacklo_pd(r[0], r[1]), s._mm256_unpacklo_pd(r[2], r[3])];
                let high = [s._mm256_unpackhi_pd(r[0], r[1]), s._mm256_unpackhi_pd(r[2], r[3])];
                into[0][part] = cast!(s._mm256_permute2f128_pd::<0x20>(low[0], low[1]));
                into[1][part] = cast!(s._mm256_permute2f128_pd::<0x20>(high[0], high[1]));
                into[2][part] = cast!(s._mm256_permute2f128_pd::<0x31>(low[0], low[1]));
                into[3][part] = cast!(s._mm256_permute2f128_pd::<0x31>(high[0], high[1]));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Lanes, Pair, SimdReal, WithIsa, vectorized};
    use pulp::bytemuck;

    #[derive(Clone, Copy)]
    struct Check;
    impl<T: psf_types::Real + bytemuck::Pod> WithIsa<T> for Check {
        type Output = ();
        fn run<S: Lanes<T>>(self, simd: S) {
            let n = S::LANES;
            let values: Vec<T> = (0..2 * n * n).map(|i| T::nearest(i as f64)).collect();
            let from: Vec<Pair<S::V>> = bytemuck::cast_slice(&values).to_vec();
            let mut into = vec![[simd.splat(T::nan()); 2]; n];
            vectorized!(simd, simd.transpose(&from, &mut into));
            let back: Vec<T> = bytemuck::cast_slice(&into).to_vec();
            for row in 0..n {
                for part in 0..2 {
                    for column in 0..n {
                        assert_eq!(
                            back[(2 * row + part) * n + column],
                            values[(2 * column + part) * n + row],
                            "{n} lanes"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn every_instruction_set_of_this_machine_transposes() {
        f32::dispatch_to_all(Check);
        f64::dispatch_to_all(Check);
    }
}
