//! What an execution did.

use std::ops::AddAssign;

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
    /// Counts a tile that was convolved as a whole.
    pub(crate) fn whole(&mut self, direct: bool, modes: usize) {
        if direct {
            self.direct += 1;
        } else {
            self.transformed += 1;
            self.modes += modes;
        }
    }

    /// All tiles.
    pub fn tiles(&self) -> usize {
        self.dark + self.drawn + self.direct + self.transformed
    }
}
