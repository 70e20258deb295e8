//! The elbow of the cumulative-weight curve.

/// A drop from one singular value to the next by this factor is a cliff: what follows weighs nothing beside it.
const CLIFF: f64 = 1e-3;
/// Parts of the largest singular value below which a cliff is but the end of a decay, where rounding begins (of samples in single
/// precision, 6e-8 each).
const FLOOR: f64 = 1e-8;

/// The number of components at the elbow of the curve of cumulative weights `c_k = sum_{i<=k} s_i / sum_i s_i`.
///
/// * Where the singular values fall off a cliff (by more than a factor of 1000 from one to the next, in the first half
///   of the curve), the curve has a corner in the strict sense and the elbow is there: samples that span exactly six
///   modes have their elbow at six, however unequal the six are. Of several cliffs the deepest counts. One that begins below
///   1e-8 of the largest value is none: there a smooth decay ends in rounding.
/// * Otherwise the elbow is the point of the curve furthest above its chord from (0, 0) to (m, 1): "Kneedle", Satopaa,
///   Albrecht, Irwin and Raghavan 2011 (ICDCS workshops, section II), without smoothing. Since the curve is concave this
///   is the number of singular values above their mean.
///
/// `singular_values` are in descending order; 0 when all are 0 or there are none.
pub(crate) fn elbow(singular_values: &[f64]) -> usize {
    let total: f64 = singular_values.iter().sum();
    if total <= 0.0 {
        return 0;
    }
    cliff(singular_values).unwrap_or_else(|| {
        let mean = total / singular_values.len() as f64;
        singular_values.iter().take_while(|&&s| s > mean).count().max(1)
    })
}

fn cliff(singular_values: &[f64]) -> Option<usize> {
    let half = singular_values.len() / 2;
    let drop = |k: usize| singular_values[k] / singular_values[k - 1];
    (1..=half)
        .filter(|&k| singular_values[k - 1] > FLOOR * singular_values[0] && drop(k) < CLIFF)
        .min_by(|&a, &b| drop(a).total_cmp(&drop(b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cliff_is_the_elbow_however_unequal_the_modes() {
        let mut values = vec![1e-15; 60];
        values[..6].copy_from_slice(&[10.0, 3.0, 0.5, 0.01, 2e-3, 1e-3]);
        assert_eq!(elbow(&values), 6);
    }

    #[test]
    fn a_smooth_decay_bends_where_the_values_fall_below_their_mean() {
        let values: Vec<f64> = (0..50).map(|k| 0.8f64.powi(k)).collect();
        // mean 0.1, and 0.8^10 = 0.107, 0.8^11 = 0.086
        assert_eq!(elbow(&values), 11);
        // The definition itself: the furthest point above the chord.
        let total: f64 = values.iter().sum();
        let above = |k: usize| values[..k].iter().sum::<f64>() / total - k as f64 / 50.0;
        let furthest = (0..=50).max_by(|&a, &b| above(a).total_cmp(&above(b))).unwrap();
        assert_eq!(furthest, 11);
    }

    #[test]
    fn the_fall_from_a_decay_to_rounding_is_no_cliff() {
        let decay = |k: i32| if k < 20 { 0.25f64.powi(k) } else { 0.0 };
        let values: Vec<f64> = (0..60).map(decay).collect();
        // 0.25^19 = 4e-12; the mean is 4 / 3 / 60 = 0.022.
        assert_eq!(elbow(&values), 3);
        // Not so far down it is one.
        let cut: Vec<f64> = (0..60).map(|k| if k < 12 { decay(k) } else { 0.0 }).collect();
        assert_eq!(elbow(&cut), 12);
    }

    #[test]
    fn nothing_has_no_elbow() {
        assert_eq!(elbow(&[]), 0);
        assert_eq!(elbow(&[0.0, 0.0]), 0);
        assert_eq!(elbow(&[1.0]), 1);
    }
}
