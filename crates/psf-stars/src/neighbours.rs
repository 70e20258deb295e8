//! Points near points.

/// Points sorted by y, for searches within a radius.
#[derive(Debug)]
pub(crate) struct Neighbours {
    /// `(y, x, index)`.
    sorted: Vec<(f64, f64, usize)>,
}

impl Neighbours {
    pub(crate) fn new(points: impl Iterator<Item = (f64, f64)>) -> Self {
        let mut sorted: Vec<_> = points.enumerate().map(|(k, (x, y))| (y, x, k)).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.2.cmp(&b.2)));
        Self { sorted }
    }

    /// Indices and distances of the points within `radius`, in no particular but always the same order.
    pub(crate) fn within(&self, x: f64, y: f64, radius: f64) -> impl Iterator<Item = (usize, f64)> + '_ {
        let first = self.sorted.partition_point(|p| p.0 < y - radius);
        self.sorted[first..]
            .iter()
            .take_while(move |p| p.0 <= y + radius)
            .map(move |p| (p.2, (p.1 - x).hypot(p.0 - y)))
            .filter(move |(_, distance)| *distance <= radius)
    }

    /// The nearest point for which `counts` holds, with its distance.
    pub(crate) fn nearest(&self, x: f64, y: f64, counts: impl Fn(usize) -> bool) -> Option<(usize, f64)> {
        let from = self.sorted.partition_point(|p| p.0 < y);
        let mut best: Option<(usize, f64)> = None;
        let look = |p: &(f64, f64, usize), best: &mut Option<(usize, f64)>| {
            let closer = best.is_none_or(|(_, d)| (p.0 - y).abs() <= d);
            let distance = (p.1 - x).hypot(p.0 - y);
            // The lower index where two are equally far.
            if closer && counts(p.2) && best.is_none_or(|(k, d)| distance < d || (distance == d && p.2 < k)) {
                *best = Some((p.2, distance));
            }
            closer
        };
        for p in &self.sorted[from..] {
            if !look(p, &mut best) {
                break;
            }
        }
        for p in self.sorted[..from].iter().rev() {
            if !look(p, &mut best) {
                break;
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_those_of_a_full_search() {
        let points: Vec<(f64, f64)> = (0..200u32)
            .map(|k| (f64::from(k * 37 % 101), f64::from(k * 53 % 97)))
            .collect();
        let index = Neighbours::new(points.iter().copied());
        for (k, &(x, y)) in points.iter().enumerate().step_by(7) {
            let distance = |j: usize| (points[j].0 - x).hypot(points[j].1 - y);
            let mut found: Vec<usize> = index.within(x, y, 12.0).map(|(j, _)| j).collect();
            found.sort_unstable();
            let all: Vec<usize> = (0..200).filter(|&j| distance(j) <= 12.0).collect();
            assert_eq!(found, all);
            let (_, nearest) = index.nearest(x, y, |j| j != k).unwrap();
            let truth = (0..200)
                .filter(|&j| j != k)
                .map(distance)
                .fold(f64::INFINITY, f64::min);
            assert_eq!(nearest, truth);
        }
        assert_eq!(index.nearest(0.0, 0.0, |_| false), None);
    }
}
