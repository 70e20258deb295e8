//! How much two PSFs differ.

use ndarray::ArrayView2;

/// A relative difference of two stamps `a` and `b` on the same grid; symmetric in them, 0 for equal ones.
///
/// ```
/// use ndarray::array;
/// use psf_sample::DifferenceMeasure;
/// let (a, b) = (array![[0.6, 0.4]], array![[0.5, 0.5]]);
/// assert!((DifferenceMeasure::L1.between(a.view(), b.view()) - 0.2).abs() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum DifferenceMeasure {
    /// `sum |a - b| / (sum |a| + sum |b|) * 2`: up to 2, for PSFs that do not overlap.
    L1,
    /// `||a - b||_2 / (||a||_2 + ||b||_2) * 2`: up to sqrt(2) for PSFs of equal norm that do not overlap.
    #[default]
    L2,
}

impl DifferenceMeasure {
    /// The difference of two stamps.
    ///
    /// # Panics
    /// When their shapes differ.
    pub fn between(self, a: ArrayView2<'_, f64>, b: ArrayView2<'_, f64>) -> f64 {
        self.of_pairs(a.iter().copied(), b.iter().copied(), a.dim() == b.dim())
    }

    /// The difference of `(a + b) / 2` and `c`.
    ///
    /// # Panics
    /// When the shapes differ.
    pub fn of_mean(self, [a, b]: [ArrayView2<'_, f64>; 2], c: ArrayView2<'_, f64>) -> f64 {
        let mean = a.iter().zip(b.iter()).map(|(a, b)| 0.5 * (a + b));
        self.of_pairs(mean, c.iter().copied(), a.dim() == b.dim() && b.dim() == c.dim())
    }

    fn of_pairs(self, a: impl Iterator<Item = f64>, b: impl Iterator<Item = f64>, same_shape: bool) -> f64 {
        assert!(same_shape, "stamps of one source have one shape");
        let norm = |v: f64| if self == Self::L1 { v.abs() } else { v * v };
        let (mut d, mut na, mut nb) = (0.0, 0.0, 0.0);
        for (a, b) in a.zip(b) {
            d += norm(a - b);
            na += norm(a);
            nb += norm(b);
        }
        if self == Self::L2 {
            (d, na, nb) = (d.sqrt(), na.sqrt(), nb.sqrt());
        }
        // Two empty stamps do not differ; every stamp that is drawn holds light.
        if d == 0.0 { 0.0 } else { 2.0 * d / (na + nb) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn values() {
        let (a, b) = (array![[3.0, 0.0], [0.0, 1.0]], array![[0.0, 4.0], [0.0, 1.0]]);
        let l1 = 2.0 * 7.0 / (4.0 + 5.0);
        let l2 = 2.0 * 5.0 / (10f64.sqrt() + 17f64.sqrt());
        for (measure, expected) in [(DifferenceMeasure::L1, l1), (DifferenceMeasure::L2, l2)] {
            assert!((measure.between(a.view(), b.view()) - expected).abs() < 1e-15);
            assert_eq!(
                measure.between(a.view(), b.view()),
                measure.between(b.view(), a.view())
            );
            assert_eq!(measure.between(a.view(), a.view()), 0.0);
            let scaled = measure.between((&a * 1e-3).view(), (&b * 1e-3).view());
            assert!((scaled - expected).abs() < 1e-14, "relative");
            let mean = (&a + &b) / 2.0;
            assert_eq!(measure.of_mean([a.view(), b.view()], mean.view()), 0.0);
        }
    }
}
