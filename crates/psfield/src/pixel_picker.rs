//! Random pixels of an image that passes row by row.

use psf_types::FrameShape;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Picks pixels while an image passes: half of them anywhere, half where the image is bright (a pixel's chance is its absolute
/// value). The choice depends on the image and the seed alone.
#[derive(Debug, Clone)]
pub struct PixelPicker {
    /// Anywhere: `(row, column)`, ascending, and their values so far.
    anywhere: Vec<(usize, usize)>,
    values: Vec<f64>,
    /// Where it is bright: `(row, column, value)`, replaced as more light passes.
    bright: Vec<(usize, usize, f64)>,
    bright_count: usize,
    rng: ChaCha8Rng,
    seed: u64,
    next_row: usize,
    light: f64,
    peak: f64,
}

/// A pixel and its value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PickedPixel {
    /// Column of the frame.
    pub column: usize,
    /// Row of the frame.
    pub row: usize,
    /// The image's value.
    pub value: f64,
}

impl PixelPicker {
    /// A picker of `count` pixels of a frame.
    pub fn new(shape: FrameShape, count: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let bright_count = count / 2;
        let mut anywhere: Vec<(usize, usize)> = (0..count - bright_count)
            .map(|_| (rng.random_range(0..shape.ny()), rng.random_range(0..shape.nx())))
            .collect();
        anywhere.sort_unstable();
        Self {
            anywhere,
            values: Vec::new(),
            bright: Vec::new(),
            bright_count,
            rng,
            seed,
            next_row: 0,
            light: 0.0,
            peak: 0.0,
        }
    }

    /// The next row of the image passes.
    pub fn pass(&mut self, row: impl Iterator<Item = f64>) {
        let row: Vec<f64> = row.collect();
        while let Some(&(_, column)) = self
            .anywhere
            .get(self.values.len())
            .filter(|p| p.0 == self.next_row)
        {
            self.values.push(row[column]);
        }
        let mut passed = 0.0;
        let light: Vec<f64> = row
            .iter()
            .map(|v| {
                self.peak = self.peak.max(v.abs());
                passed += v.abs();
                passed
            })
            .collect();
        if passed > 0.0 && passed.is_finite() {
            self.light += passed;
            // Every pick so far gives way with the chance that this row has among all light so far.
            let chance = passed / self.light;
            let first = self.bright.is_empty();
            self.bright.resize(self.bright_count, (0, 0, 0.0));
            for pick in &mut self.bright {
                if first || self.rng.random::<f64>() < chance {
                    let at = self.rng.random::<f64>() * passed;
                    let column = light.partition_point(|&l| l <= at).min(row.len() - 1);
                    *pick = (self.next_row, column, row[column]);
                }
            }
        }
        self.next_row += 1;
    }

    /// The pixels, by rows, and the largest absolute value of the image.
    pub fn finish(self) -> (Vec<PickedPixel>, f64) {
        let anywhere = self.anywhere.into_iter().zip(self.values);
        let mut picked: Vec<PickedPixel> = anywhere
            .map(|((row, column), value)| PickedPixel { column, row, value })
            .chain(
                self.bright
                    .into_iter()
                    .map(|(row, column, value)| PickedPixel { column, row, value }),
            )
            .collect();
        picked.sort_by_key(|p| (p.row, p.column));
        (picked, self.peak)
    }

    /// The seed.
    pub fn seed(&self) -> u64 {
        self.seed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_the_pixels_are_bright_ones() {
        let shape = FrameShape::new(50, 40).unwrap();
        // Two bright pixels, one three times the other, and next to nothing elsewhere.
        let value = |row: usize, column: usize| match (row, column) {
            (7, 3) => 1e6,
            (31, 44) => -3e6,
            _ => 1e-3,
        };
        let mut picker = PixelPicker::new(shape, 4000, 1);
        (0..40).for_each(|row| picker.pass((0..50).map(|column| value(row, column))));
        let (picked, peak) = picker.finish();
        assert_eq!((picked.len(), peak), (4000, 3e6));
        assert!(picked.iter().all(|p| p.value == value(p.row, p.column)));
        let count = |at: (usize, usize)| picked.iter().filter(|p| (p.row, p.column) == at).count();
        let (one, three) = (count((7, 3)), count((31, 44)));
        assert!((1990..2030).contains(&(one + three)), "{one} {three}");
        assert!((400..600).contains(&one), "{one}");
        // The others are all over the frame.
        assert!(picked.iter().filter(|p| p.row < 20).count() > 900);
    }

    #[test]
    fn a_dark_image_has_pixels_anywhere() {
        let mut picker = PixelPicker::new(FrameShape::new(5, 2).unwrap(), 9, 3);
        (0..2).for_each(|_| picker.pass([0.0; 5].into_iter()));
        let (picked, peak) = picker.finish();
        assert_eq!((picked.len(), peak), (5, 0.0));
    }
}
