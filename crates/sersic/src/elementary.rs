//! Logarithm and exponential function of numbers in single precision. The compiler turns loops that
//! call them into vectors of the instruction set for which it compiles the loop. No library has
//! functions for an instruction set that is chosen at run time.

use std::f32::consts::{LN_2, SQRT_2};

const MANTISSA_BITS: u32 = 23;
/// The bits of 1.
const ONE: u32 = 127 << MANTISSA_BITS;
/// A sum with this number has no fraction, and its lowest bits are those of an integer.
const ROUND: f32 = 1.5 * (1 << MANTISSA_BITS) as f32;

/// The natural logarithm of a positive number that is not subnormal. Its error is at most 2e-7 of its
/// value, or of 1 if that is more.
#[inline(always)]
pub(crate) fn ln(x: f32) -> f32 {
    // x = m 2^e with m from about 1 / sqrt(2) to sqrt(2).
    let e = x.to_bits().wrapping_sub((1.0 / SQRT_2).to_bits()) as i32 >> MANTISSA_BITS;
    let m = f32::from_bits(x.to_bits().wrapping_sub((e << MANTISSA_BITS) as u32));
    // ln m = 2 artanh s. The next term of the series is below 1e-9.
    let s = (m - 1.0) / (m + 1.0);
    let square = s * s;
    let series = square.mul_add(2.0 / 9.0, 2.0 / 7.0);
    let series = series.mul_add(square, 2.0 / 5.0).mul_add(square, 2.0 / 3.0);
    (e as f32).mul_add(LN_2, series.mul_add(square, 2.0) * s)
}

/// The exponential function from -87 to 87. Its relative error is at most 2e-7 plus 1e-7 times the
/// argument.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    // x = (k + f) ln 2 with an integer k and f from -1/2 to 1/2.
    let rounded = x.mul_add(1.0 / LN_2, ROUND);
    let f = (rounded - ROUND).mul_add(-LN_2, x);
    // The next term of the series is below 1e-8.
    let mut series = 1.0 / 5040.0;
    for inverse in [720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0] {
        series = f.mul_add(series, 1.0 / inverse);
    }
    // Times 2^k.
    let power = (rounded.to_bits() << MANTISSA_BITS).wrapping_add(ONE);
    series * f32::from_bits(power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_are_as_accurate_as_documented() {
        for i in 0..200_000 {
            let x = (f64::from(i) * 1e-3 - 100.0).exp2() as f32;
            let exact = f64::from(x).ln();
            let error = (f64::from(ln(x)) - exact).abs() / exact.abs().max(1.0);
            assert!(error < 2e-7, "ln {x}: {error:e}");
            let x = (f64::from(i) * 8.7e-4 - 87.0) as f32;
            let error = (f64::from(exp(x)) / f64::from(x).exp() - 1.0).abs();
            assert!(error < 2e-7 + 1e-7 * f64::from(x.abs()), "exp {x}: {error:e}");
        }
        assert_eq!((ln(1.0), exp(0.0)), (0.0, 1.0));
    }
}
