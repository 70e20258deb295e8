//! Disjoint parts of an image for threads to write to.

use ndarray::{ArrayViewMut2, Axis};

/// The parts of a view between ascending `(start, end)` along an axis, which do not overlap.
pub(crate) fn split<'a, T>(
    view: ArrayViewMut2<'a, T>,
    axis: usize,
    ranges: &[(usize, usize)],
) -> Vec<ArrayViewMut2<'a, T>> {
    let mut rest = view;
    let mut at = 0;
    let mut parts = Vec::with_capacity(ranges.len());
    for &(start, end) in ranges {
        let (_, tail) = rest.split_at(Axis(axis), start - at);
        let (part, tail) = tail.split_at(Axis(axis), end - start);
        parts.push(part);
        rest = tail;
        at = end;
    }
    parts
}

/// The smallest `n` such that no range overlaps the `n`-th after it: every `n`-th range may be written at once.
pub(crate) fn colours(ranges: &[(usize, usize)]) -> usize {
    let clear = |n: usize| ranges.iter().zip(ranges.iter().skip(n)).all(|(a, b)| a.1 <= b.0);
    (1..ranges.len())
        .find(|&n| clear(n))
        .unwrap_or(ranges.len().max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    #[test]
    fn parts_are_those_asked_for() {
        let mut whole = Array2::<u32>::zeros((1, 10));
        for (i, mut part) in split(whole.view_mut(), 1, &[(1, 3), (3, 4), (8, 10)])
            .into_iter()
            .enumerate()
        {
            part += i as u32 + 1;
        }
        assert_eq!(whole.as_slice().unwrap(), [0, 1, 1, 2, 0, 0, 0, 0, 3, 3]);
    }

    #[test]
    fn colours_keep_ranges_apart() {
        assert_eq!(colours(&[(0, 3), (3, 5), (5, 9)]), 1);
        assert_eq!(colours(&[(0, 4), (3, 6), (5, 9)]), 2);
        assert_eq!(colours(&[(0, 8), (1, 9), (2, 9)]), 3);
        assert_eq!(colours(&[(0, 8)]), 1);
        assert_eq!(colours(&[]), 1);
    }
}
