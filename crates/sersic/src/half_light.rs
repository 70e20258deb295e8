//! The constant of Sersic profiles that makes `re` the half-light radius.

use statrs::function::gamma::{gamma_ur, ln_gamma};

/// Returns the `b` for which half of the light lies within `re`: `P(2n, b) = 1/2`, with the
/// regularised lower incomplete gamma function `P`.
pub(crate) fn half_light_constant(n: f64) -> f64 {
    // Newton's method, from the start of an asymptotic series (Ciotti and Bertin 1999, A&A 352,
    // 447), which is below the solution for small n.
    let mut b = (2.0 * n - 1.0 / 3.0 + 4.0 / (405.0 * n)).max(SMALLEST_START);
    let ln_total = ln_gamma(2.0 * n);
    for _ in 0..MOST_STEPS {
        let slope = ((2.0 * n - 1.0) * b.ln() - b - ln_total).exp();
        let last = b;
        b = (b + (gamma_ur(2.0 * n, b) - 0.5) / slope).max(0.5 * b);
        if (b - last).abs() < LAST_STEP * b {
            break;
        }
    }
    b
}

/// The least value from which Newton's method for `b` starts.
const SMALLEST_START: f64 = 0.1;
/// Steps of Newton's method end after a relative step below this one. The error is then about the
/// square of this number.
const LAST_STEP: f64 = 1e-7;
/// This number of steps is enough for `n` from 0.2 to 11.
const MOST_STEPS: usize = 6;

#[cfg(test)]
mod tests {
    use statrs::function::gamma::gamma_lr;

    use super::*;

    #[test]
    fn half_of_the_light_lies_within_the_half_light_radius() {
        // Known values: n = 0.5 is a Gaussian with b = ln 2. Values for n = 1 and 4 are from Graham
        // and Driver (2005).
        for (n, b, within) in [
            (0.5, std::f64::consts::LN_2, 1e-14),
            (1.0, 1.678_346_990_016_66, 1e-13),
            (4.0, 7.669_249_442_500_8, 1e-12),
        ] {
            let found = half_light_constant(n);
            assert!((found - b).abs() < within, "n = {n}: {found}");
        }
        for i in 0..400 {
            let n = 0.2 * 1.0101_f64.powi(i);
            let half = gamma_lr(2.0 * n, half_light_constant(n));
            assert!((half - 0.5).abs() < 1e-12, "{n}: {half}");
        }
    }
}
