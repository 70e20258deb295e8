//! Random tests of a sampling that is done.

use psf_types::Position;
use statrs::function::beta::inv_beta_reg;

/// The confidence of [`fraction_limit`].
const CONFIDENCE: f64 = 0.95;

/// PSFs at random positions, predicted before they were drawn.
///
/// Tests at the places with the largest expected errors say nothing about places that no sample came
/// near. Random tests bound the part of the field in which predictions fail, whatever the field. They
/// are stratified: each of as many parts of the field of equal area holds one. Failures are then at most
/// as scattered as among independent tests (W. Hoeffding 1956, Annals of Mathematical Statistics 27, 713),
/// so limits hold.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Verification {
    /// The number of random tests that ended the sampling.
    pub tests: usize,
    /// The number of them with an error above the threshold.
    pub above: usize,
    /// The largest of their errors.
    pub worst: f64,
    /// Its position.
    pub worst_at: Position,
    /// The number of random PSFs that were drawn, those of earlier verifications included.
    pub draws: usize,
}

impl Verification {
    /// With 95 % confidence, at most this fraction of the field has errors above the threshold
    /// ([`fraction_limit`]).
    pub fn fraction_limit(&self) -> f64 {
        fraction_limit(self.above, self.tests)
    }
}

/// The upper limit of a fraction, with 95 % confidence, if `above` of `tests` random tests belong to it.
///
/// It is the `p` with `sum_{i <= above} C(tests, i) p^i (1 - p)^(tests - i) = 0.05` (C. Clopper and E.
/// Pearson 1934, Biometrika 26, 404, one-sided). For `above = 0`, it is `1 - 0.05^(1 / tests)`. 1 without
/// tests.
///
/// ```
/// let limit = psf_sample::fraction_limit(0, 16);
/// assert!((limit - 0.1707).abs() < 1e-4);
/// ```
pub fn fraction_limit(above: usize, tests: usize) -> f64 {
    if above >= tests {
        return 1.0;
    }
    inv_beta_reg((above + 1) as f64, (tests - above) as f64, CONFIDENCE)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding, and three digits of tables.
    const CLOSE: f64 = 1e-12;

    #[test]
    fn limits_are_those_of_clopper_and_pearson() {
        for tests in [1, 16, 300, 65_535] {
            let exact = 1.0 - 0.05_f64.powf(1.0 / tests as f64);
            assert!((fraction_limit(0, tests) - exact).abs() < CLOSE, "{tests}");
        }
        // One of two: p^2 = 0.95.
        assert!((fraction_limit(1, 2) - 0.95_f64.sqrt()).abs() < CLOSE);
        // qbeta(0.95, 4, 13) of R.
        assert!(
            (fraction_limit(3, 16) - 0.416_571).abs() < 1e-5,
            "{}",
            fraction_limit(3, 16)
        );
        assert_eq!((fraction_limit(16, 16), fraction_limit(0, 0)), (1.0, 1.0));
        assert!(fraction_limit(2, 16) < fraction_limit(3, 16));
    }
}
