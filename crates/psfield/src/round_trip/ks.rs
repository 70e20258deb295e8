//! The distance of two distributions.

/// The two-sample Kolmogorov-Smirnov distance: the largest difference of the two cumulative distributions; none where either is empty.
pub(crate) fn kolmogorov_smirnov(a: &[f64], b: &[f64]) -> Option<f64> {
    if a.is_empty() || b.is_empty() {
        return None;
    }
    let sorted = |values: &[f64]| {
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        sorted
    };
    let (a, b) = (sorted(a), sorted(b));
    let below = |values: &[f64], v: f64| values.partition_point(|x| *x <= v) as f64 / values.len() as f64;
    let distances = a.iter().chain(&b).map(|&v| (below(&a, v) - below(&b, v)).abs());
    Some(distances.fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_distances() {
        let a = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(kolmogorov_smirnov(&a, &a), Some(0.0));
        assert_eq!(kolmogorov_smirnov(&a, &[5.0, 6.0]), Some(1.0));
        assert_eq!(kolmogorov_smirnov(&a, &[4.0, 3.0, 2.5, 1.5]), Some(0.25));
        assert_eq!(kolmogorov_smirnov(&[3.0, 1.0], &[2.0]), Some(0.5));
        assert_eq!(kolmogorov_smirnov(&a, &[]), None);
    }
}
