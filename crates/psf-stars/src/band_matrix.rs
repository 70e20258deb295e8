//! Symmetric matrices with a band of nonzero values, and their solution.

/// A symmetric positive matrix with a band of nonzero values: its lower half, row by row.
#[derive(Debug, Clone)]
pub(crate) struct BandMatrix {
    /// Values per row: those left of the diagonal, and the diagonal.
    width: usize,
    pub(crate) values: Vec<f64>,
}

impl BandMatrix {
    pub(crate) fn new(size: usize, width: usize) -> Self {
        Self {
            width,
            values: vec![0.0; size * width],
        }
    }

    fn row(&self, row: usize) -> &[f64] {
        &self.values[row * self.width..(row + 1) * self.width]
    }

    /// Adds to a value at or left of the diagonal. A value left of the band is dropped.
    pub(crate) fn add(&mut self, row: usize, column: usize, amount: f64) {
        if row - column >= self.width {
            return;
        }
        self.values[(row + 1) * self.width - 1 + column - row] += amount;
    }

    /// Cholesky's factorisation in place. Without fill outside the band.
    pub(crate) fn factorise(&mut self) {
        let (width, size) = (self.width, self.values.len() / self.width);
        for row in 0..size {
            let (above, own) = self.values.split_at_mut(row * width);
            let first = (row + 1).saturating_sub(width);
            for column in first..row {
                let other = &above[column * width..(column + 1) * width];
                // The common columns of both rows, left of `column`.
                let shift = row - column;
                let sum = product(&own[..width - 1 - shift], &other[shift..width - 1]);
                let at = width - 1 - shift;
                own[at] = (own[at] - sum) / other[width - 1];
            }
            let power = product(&own[..width - 1], &own[..width - 1]);
            own[width - 1] = (own[width - 1] - power).sqrt();
        }
    }

    /// Solves with the factorised matrix.
    pub(crate) fn solve(&self, right: &mut [f64]) {
        let width = self.width;
        for row in 0..right.len() {
            let first = (row + 1).saturating_sub(width);
            let own = &self.row(row)[width - 1 - (row - first)..];
            let known = product(&own[..row - first], &right[first..row]);
            right[row] = (right[row] - known) / own[row - first];
        }
        for row in (0..right.len()).rev() {
            let first = (row + 1).saturating_sub(width);
            let own = &self.row(row)[width - 1 - (row - first)..];
            right[row] /= own[row - first];
            let found = right[row];
            add_to(&mut right[first..row], -found, &own[..row - first]);
        }
    }
}

pub(crate) fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Adds `factor` times a vector to another one.
pub(crate) fn add_to(to: &mut [f64], factor: f64, what: &[f64]) {
    to.iter_mut().zip(what).for_each(|(t, w)| *t += factor * w);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_solution_gives_back_the_right_side() {
        let (size, width) = (23, 6);
        let mut matrix = BandMatrix::new(size, width);
        let value = |row: usize, column: usize| ((row * 7 + column * 5) % 11) as f64 / 11.0 - 0.5;
        for row in 0..size {
            matrix.add(row, row, 4.0);
            for column in (row + 1).saturating_sub(width)..row {
                matrix.add(row, column, value(row, column));
            }
        }
        let at = |row: usize, column: usize| {
            let (low, high) = (row.min(column), row.max(column));
            match high - low {
                0 => 4.0,
                off if off < width => value(high, low),
                _ => 0.0,
            }
        };
        let truth: Vec<f64> = (0..size).map(|k| (k as f64).sin()).collect();
        let mut found: Vec<f64> = (0..size)
            .map(|row| (0..size).map(|k| at(row, k) * truth[k]).sum())
            .collect();
        matrix.factorise();
        matrix.solve(&mut found);
        assert!(found.iter().zip(truth).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}
