//! Transform lengths.

/// The smallest even length of at least `n` whose prime factors are 2, 3, 5 and 7.
pub(crate) fn even_smooth_at_least(n: usize) -> usize {
    let smooth = |mut n: usize| {
        for p in [2, 3, 5, 7] {
            while n.is_multiple_of(p) {
                n /= p;
            }
        }
        n == 1
    };
    (n.max(2)..usize::MAX)
        .find(|&n| n.is_multiple_of(2) && smooth(n))
        .expect("a power of 2 is found")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths() {
        let got: Vec<_> = [0, 2, 11, 12, 129, 291, 977].map(even_smooth_at_least).into();
        assert_eq!(got, [2, 2, 12, 12, 140, 294, 980]);
    }
}
