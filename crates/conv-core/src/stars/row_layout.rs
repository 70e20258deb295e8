//! The order in which the coefficients of a kernel's row are stored.

use super::phases::PhasedAxis;

/// The layout of the coefficients of a kernel's row: `[chunk, residue, pixel]`, with the pixels of
/// the frame in chunks. With an oversampling of `s`, coefficient `s q + residue` belongs to pixel
/// `q`. The taps of a pixel are the coefficients that contribute to it, and their residues follow each
/// other.
///
/// If `s` is less than the number of taps, taps of neighbouring pixels share coefficients. Then one
/// chunk holds all pixels, so the values of a residue are neighbours. Otherwise each tap of a pixel has
/// another residue. Then residues continue beyond `s - 1`, so some coefficients are stored twice, and
/// the taps of a pixel are [`CHUNK`] values apart, wherever the first tap is.
#[derive(Debug, Clone, Copy)]
pub(super) struct RowLayout {
    pub(super) residues: usize,
    pub(super) chunk: usize,
    /// Whether taps share coefficients.
    pub(super) is_shared: bool,
    /// The number of values in a row of one kernel.
    pub(super) kernel: usize,
}

/// A whole number of vectors of any instruction set.
pub(super) const CHUNK: usize = 16;

impl RowLayout {
    pub(super) fn new(columns: &PhasedAxis) -> Self {
        let (s, taps) = (columns.oversampling, columns.kernel.tap_count());
        let pixels = columns.kept.div_ceil(s).next_multiple_of(CHUNK);
        let is_shared = s < taps;
        // Without sharing, the first tap is at residue `s` at most.
        let residues = if is_shared { s } else { s + taps };
        Self {
            residues,
            chunk: if is_shared { pixels } else { CHUNK },
            is_shared,
            kernel: pixels * residues,
        }
    }

    /// The column of the stamp's coefficients at each index of a row. `None` for values that are 0.
    pub(super) fn columns(self, columns: &PhasedAxis) -> Vec<Option<usize>> {
        let column = |at: usize| {
            let (pixel, residue) = self.place(at);
            let column = pixel * columns.oversampling + residue;
            columns.index(column).filter(|_| column < columns.kept)
        };
        (0..self.kernel).map(column).collect()
    }

    /// The pixel and the residue of the value at an index.
    fn place(self, index: usize) -> (usize, usize) {
        let (line, pixel) = (index / self.chunk, index % self.chunk);
        (line / self.residues * self.chunk + pixel, line % self.residues)
    }

    /// The index of the value of a column of coefficients.
    pub(super) fn index_of(self, column: usize, oversampling: usize) -> usize {
        let (pixel, residue) = (column / oversampling, column % oversampling);
        (pixel / self.chunk * self.residues + residue) * self.chunk + pixel % self.chunk
    }

    /// The index of the first tap of a pixel, without sharing. `residue` is that of the first tap.
    #[inline(always)]
    pub(super) fn index(self, residue: usize, pixel: usize) -> usize {
        (pixel / CHUNK * self.residues + residue) * CHUNK + pixel % CHUNK
    }

    /// The indices of the taps of the first pixel, with sharing. `first` is the coefficient of the
    /// first tap. The taps of the next pixel are one further.
    #[inline(always)]
    pub(super) fn shared_taps<const TAPS: usize>(self, first: usize) -> [usize; TAPS] {
        // Every row of a star needs them. `first` is small, so this is faster than a division.
        let (mut residue, mut pixel) = (first, 0);
        let mut taps = [0; TAPS];
        for tap in &mut taps {
            while residue >= self.residues {
                residue -= self.residues;
                pixel += 1;
            }
            *tap = residue * self.chunk + pixel;
            residue += 1;
        }
        taps
    }
}
