//! Discrete Fourier transforms of a few values, computed in every lane of a vector.

use crate::ConvReal;
use crate::simd::{Lanes, Pair};

/// `a + b`.
#[inline(always)]
pub(super) fn add<T, S: Lanes<T>>(simd: S, a: Pair<S::V>, b: Pair<S::V>) -> Pair<S::V> {
    [simd.add(a[0], b[0]), simd.add(a[1], b[1])]
}

#[inline(always)]
fn sub<T, S: Lanes<T>>(simd: S, a: Pair<S::V>, b: Pair<S::V>) -> Pair<S::V> {
    [simd.sub(a[0], b[0]), simd.sub(a[1], b[1])]
}

/// `a - i b`.
#[inline(always)]
fn sub_i<T, S: Lanes<T>>(simd: S, a: Pair<S::V>, b: Pair<S::V>) -> Pair<S::V> {
    [simd.add(a[0], b[1]), simd.sub(a[1], b[0])]
}

/// `a + i b`.
#[inline(always)]
fn add_i<T, S: Lanes<T>>(simd: S, a: Pair<S::V>, b: Pair<S::V>) -> Pair<S::V> {
    [simd.sub(a[0], b[1]), simd.add(a[1], b[0])]
}

/// `a s + b`, with `s` real.
#[inline(always)]
fn scale_add<T, S: Lanes<T>>(simd: S, a: Pair<S::V>, s: S::V, b: Pair<S::V>) -> Pair<S::V> {
    [simd.mul_add(a[0], s, b[0]), simd.mul_add(a[1], s, b[1])]
}

/// `a w`.
#[inline(always)]
pub(crate) fn times<T, S: Lanes<T>>(simd: S, a: Pair<S::V>, w: Pair<S::V>) -> Pair<S::V> {
    [
        simd.neg_mul_add(a[1], w[1], simd.mul(a[0], w[0])),
        simd.mul_add(a[0], w[1], simd.mul(a[1], w[0])),
    ]
}

/// `sum_q x_q exp(-2 pi i q s / R)` for `s = 0 ... R - 1`.
#[inline(always)]
pub(crate) fn butterfly<T: ConvReal, S: Lanes<T>, const R: usize>(
    simd: S,
    x: [Pair<S::V>; R],
) -> [Pair<S::V>; R] {
    let mut y = x;
    match R {
        3 => {
            let (sum, difference) = (add(simd, x[1], x[2]), sub(simd, x[1], x[2]));
            let half = simd.splat(T::nearest(-0.5));
            let sine = simd.splat(T::nearest(3f64.sqrt() / 2.0));
            let middle = scale_add(simd, sum, half, x[0]);
            let turned = [simd.mul(difference[0], sine), simd.mul(difference[1], sine)];
            y[0] = add(simd, x[0], sum);
            y[1] = sub_i(simd, middle, turned);
            y[2] = add_i(simd, middle, turned);
        }
        4 => {
            let four = butterfly4(simd, [x[0], x[1], x[2], x[3]]);
            y[..4].copy_from_slice(&four);
        }
        5 => {
            let constant = |value: f64| simd.splat(T::nearest(value));
            let fifth = std::f64::consts::TAU / 5.0;
            let (c1, c2) = (constant(fifth.cos()), constant((2.0 * fifth).cos()));
            let (s1, s2) = (constant(fifth.sin()), constant((2.0 * fifth).sin()));
            let (p14, m14) = (add(simd, x[1], x[4]), sub(simd, x[1], x[4]));
            let (p23, m23) = (add(simd, x[2], x[3]), sub(simd, x[2], x[3]));
            let zero = simd.splat(T::zero());
            let first = scale_add(simd, p23, c2, scale_add(simd, p14, c1, x[0]));
            let second = scale_add(simd, p23, c1, scale_add(simd, p14, c2, x[0]));
            let first_turned = scale_add(simd, m23, s2, scale_add(simd, m14, s1, [zero; 2]));
            let second_turned = {
                let one = scale_add(simd, m14, s2, [zero; 2]);
                [
                    simd.neg_mul_add(m23[0], s1, one[0]),
                    simd.neg_mul_add(m23[1], s1, one[1]),
                ]
            };
            y[0] = add(simd, x[0], add(simd, p14, p23));
            y[1] = sub_i(simd, first, first_turned);
            y[4] = add_i(simd, first, first_turned);
            y[2] = sub_i(simd, second, second_turned);
            y[3] = add_i(simd, second, second_turned);
        }
        8 => {
            let even = butterfly4(simd, [x[0], x[2], x[4], x[6]]);
            let odd = butterfly4(simd, [x[1], x[3], x[5], x[7]]);
            let half = simd.splat(T::nearest(std::f64::consts::FRAC_1_SQRT_2));
            // `one` is odd_1 exp(-i pi / 4). `three` is the conjugate of odd_3 exp(-3 i pi / 4).
            let one = [
                simd.mul(simd.add(odd[1][0], odd[1][1]), half),
                simd.mul(simd.sub(odd[1][1], odd[1][0]), half),
            ];
            let three = [
                simd.mul(simd.sub(odd[3][1], odd[3][0]), half),
                simd.mul(simd.add(odd[3][0], odd[3][1]), half),
            ];
            y[0] = add(simd, even[0], odd[0]);
            y[4] = sub(simd, even[0], odd[0]);
            y[1] = add(simd, even[1], one);
            y[5] = sub(simd, even[1], one);
            y[2] = sub_i(simd, even[2], odd[2]);
            y[6] = add_i(simd, even[2], odd[2]);
            y[3] = [simd.add(even[3][0], three[0]), simd.sub(even[3][1], three[1])];
            y[7] = [simd.sub(even[3][0], three[0]), simd.add(even[3][1], three[1])];
        }
        _ => unreachable!("a radix of 3, 4, 5 or 8"),
    }
    y
}

#[inline(always)]
fn butterfly4<T: ConvReal, S: Lanes<T>>(simd: S, x: [Pair<S::V>; 4]) -> [Pair<S::V>; 4] {
    let (a, b) = (add(simd, x[0], x[2]), sub(simd, x[0], x[2]));
    let (c, d) = (add(simd, x[1], x[3]), sub(simd, x[1], x[3]));
    [
        add(simd, a, c),
        sub_i(simd, b, d),
        sub(simd, a, c),
        add_i(simd, b, d),
    ]
}
