//! Summation that does not lose small terms.

/// A running sum whose rounding error does not grow with the number of terms.
///
/// Neumaier's (1974) compensated summation with Knuth's branch-free two-sum: the relative error of the result is about
/// one rounding, plus the square of the machine precision times the condition of the sum.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct CompensatedSum {
    sum: f64,
    lost: f64,
}

impl CompensatedSum {
    pub(crate) fn add(&mut self, term: f64) {
        let sum = self.sum + term;
        let taken = sum - self.sum;
        self.lost += (self.sum - (sum - taken)) + (term - taken);
        self.sum = sum;
    }

    pub(crate) fn value(self) -> f64 {
        self.sum + self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_terms_survive_large_ones() {
        let mut sum = CompensatedSum::default();
        for term in [1.0, 1e100, 1.0, -1e100] {
            sum.add(term);
        }
        assert_eq!(sum.value(), 2.0);
    }

    #[test]
    fn ten_million_tenths_are_a_million_to_one_rounding() {
        let mut sum = CompensatedSum::default();
        let mut plain = 0.0;
        for _ in 0..10_000_000 {
            sum.add(0.1);
            plain += 0.1;
        }
        assert_eq!(sum.value(), 1e6);
        assert_ne!(plain, 1e6);
    }
}
