//! Positions that are spread over a field.

use psf_types::{FrameShape, Position};

/// Candidates on a field, and their distances from the nearest position chosen so far. The unit of
/// distances is the field's extent, along each axis its own.
#[derive(Debug)]
pub(crate) struct Spread {
    candidates: Vec<Position>,
    distances: Vec<f64>,
    scale: [f64; 2],
}

impl Spread {
    pub(crate) fn new(field: FrameShape, candidates: Vec<Position>) -> Self {
        let inverse = |pixels: usize| 1.0 / (pixels - 1).max(1) as f64;
        Self {
            distances: vec![f64::INFINITY; candidates.len()],
            candidates,
            scale: [inverse(field.nx()), inverse(field.ny())],
        }
    }

    /// The candidates that are not chosen.
    pub(crate) fn candidates(&self) -> Vec<Position> {
        let free = self.candidates.iter().zip(&self.distances);
        free.filter(|(_, distance)| **distance > 0.0)
            .map(|(p, _)| *p)
            .collect()
    }

    pub(crate) fn choose(&mut self, chosen: &[Position]) {
        let [x, y] = self.scale;
        for (distance, p) in self.distances.iter_mut().zip(&self.candidates) {
            for c in chosen {
                *distance = distance.min((x * (p.x() - c.x())).hypot(y * (p.y() - c.y())));
            }
        }
    }

    /// The largest distance of a candidate from the nearest chosen position.
    pub(crate) fn gap(&self) -> f64 {
        self.distances.iter().copied().fold(0.0, f64::max)
    }

    /// Chooses candidates, each the farthest from all positions chosen before it (W. Mueller 2007,
    /// Collecting Spatial Data, section 4.1, "coffee-house design"). The first are the corners, which are
    /// the farthest from the field's middle.
    pub(crate) fn take(&mut self, count: usize) -> Vec<Position> {
        let mut taken = Vec::with_capacity(count);
        while taken.len() < count {
            let farthest = (0..self.candidates.len())
                .filter(|&i| self.distances[i] > 0.0)
                .max_by(|&a, &b| self.distances[a].total_cmp(&self.distances[b]).then(b.cmp(&a)));
            let Some(next) = farthest else { break };
            taken.push(self.candidates[next]);
            self.choose(&taken[taken.len() - 1..]);
        }
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_come_first_and_gaps_shrink() {
        let field = FrameShape::new(101, 51).unwrap();
        let lattice = (0..11).flat_map(|y| (0..11).map(move |x| Position::of_pixel(10 * x, 5 * y)));
        let mut spread = Spread::new(field, lattice.collect());
        let first = spread.take(4);
        for (x, y) in [(0, 0), (100, 0), (0, 50), (100, 50)] {
            assert!(first.contains(&Position::of_pixel(x, y)), "({x}, {y})");
        }
        assert!((spread.gap() - 0.5_f64.sqrt()).abs() < 1e-15);
        assert_eq!(spread.take(1), [Position::of_pixel(50, 25)]);
        assert_eq!(spread.gap(), 0.5);
        assert_eq!(spread.candidates().len(), 121 - 5);
        assert_eq!((spread.take(1000).len(), spread.gap()), (121 - 5, 0.0));
        assert!(spread.take(1).is_empty());
    }
}
