//! Lists of weights.

/// (node, weight) pairs at one position.
pub type WeightList = Vec<(usize, f64)>;

/// Adds to a node's weight; lists are short.
pub(crate) fn add_weight(weights: &mut WeightList, node: usize, weight: f64) {
    if weight == 0.0 {
        return;
    }
    match weights.iter_mut().find(|(n, _)| *n == node) {
        Some((_, w)) => *w += weight,
        None => weights.push((node, weight)),
    }
}

/// One node alone.
pub(crate) fn single(weights: &mut WeightList, node: usize) {
    weights.clear();
    weights.push((node, 1.0));
}

/// The linear mix of two nodes, `s` of the second; a node without weight is left out.
pub(crate) fn pair(weights: &mut WeightList, first: usize, second: usize, s: f64) {
    weights.clear();
    if s != 1.0 {
        weights.push((first, 1.0 - s));
    }
    if s != 0.0 {
        weights.push((second, s));
    }
}
