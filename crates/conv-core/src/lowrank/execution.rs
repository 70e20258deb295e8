//! What an execution did.

use std::ops::AddAssign;

use super::treatment::{Treatment, Whole};

/// How many tiles were treated in which way, and what it took.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct TileCounts {
    /// Tiles without light.
    pub dark: usize,
    /// Tiles whose few lit pixels were drawn stamp by stamp.
    pub drawn: usize,
    /// Tiles convolved without transforms.
    pub direct: usize,
    /// Tiles convolved by transforms.
    pub transformed: usize,
    /// Pixels drawn stamp by stamp in all, those among them that would have drowned the rest of a tile in rounding noise.
    pub drawn_pixels: usize,
    /// Transforms of light times a mode.
    pub modes: usize,
}

impl AddAssign for TileCounts {
    fn add_assign(&mut self, other: Self) {
        self.dark += other.dark;
        self.drawn += other.drawn;
        self.direct += other.direct;
        self.transformed += other.transformed;
        self.drawn_pixels += other.drawn_pixels;
        self.modes += other.modes;
    }
}

impl TileCounts {
    /// Counts a tile.
    pub(crate) fn count<T>(&mut self, treatment: &Treatment<T>, modes: usize) {
        self.drawn_pixels += treatment.drawn.len();
        match treatment.whole {
            Some(Whole::Directly) => self.direct += 1,
            Some(Whole::ByTransforms) => {
                self.transformed += 1;
                self.modes += modes;
            }
            None if treatment.drawn.is_empty() => self.dark += 1,
            None => self.drawn += 1,
        }
    }

    /// All tiles.
    pub fn tiles(&self) -> usize {
        self.dark + self.drawn + self.direct + self.transformed
    }
}
