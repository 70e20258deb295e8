//! An image to which blocks are added in a fixed order, though threads finish them in any order.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use ndarray::ArrayViewMut2;

use super::processor::LightPass;
use super::tile_engine::TileEngine;
use crate::ConvReal;
use crate::overlap::{colours, split};
use crate::simd::{Lanes, vectorized};

/// Rows of the image that one thread at a time may add to.
const STRIP: usize = 64;

/// An image, and the blocks that are added to it.
///
/// A block whose turn has not come is kept: it waits until all earlier blocks that share pixels with
/// it are added. So the sum in a pixel does not depend on the number of threads, and no thread waits
/// for a turn. Threads take blocks in order, so that few blocks are kept: at most about one per thread.
pub(super) struct OrderedImage<'o, T> {
    /// The first of them begins at row `first` of the output.
    strips: Vec<Mutex<ArrayViewMut2<'o, T>>>,
    first: usize,
    /// Column and row of each block, in order.
    pub(super) blocks: Vec<(usize, usize)>,
    turns: Vec<Turn<T>>,
}

/// The turn of a block.
struct Turn<T> {
    /// The number of earlier blocks that share pixels with this one and are not added yet.
    earlier: AtomicUsize,
    /// The later blocks that share pixels with this one.
    later: Vec<usize>,
    /// The whole block, if it is finished and waits.
    waiting: Mutex<Option<Vec<Patch<T>>>>,
}

/// A copy of a tile's result.
pub(super) struct Patch<T> {
    plane: Vec<T>,
    size: (usize, usize),
    place: (i64, i64),
}

/// A tile's result: values with the pitch of planes, their columns and rows, and the column and row
/// of the output at which they begin.
#[derive(Clone, Copy)]
pub(super) struct TileResult<'a, T> {
    pub(super) plane: &'a [T],
    pub(super) size: (usize, usize),
    pub(super) place: (i64, i64),
}

/// Columns and rows of the blocks of a pass, in the order in which they are added. Neighbours in a row
/// do not follow each other, so that threads seldom keep blocks.
pub(super) fn order<T: ConvReal>(pass: &LightPass<'_, T>) -> Vec<(usize, usize)> {
    let columns = pass.processor.plan.extents(0);
    let step = colours(&columns);
    let count = columns.len();
    let row = |row: usize| {
        let columns = (0..step).flat_map(move |first| (first..count).step_by(step));
        columns.map(move |column| (column, row))
    };
    pass.rows.clone().flat_map(row).collect()
}

impl<'o, T: ConvReal> OrderedImage<'o, T> {
    /// The output of a pass.
    pub(super) fn of_pass(pass: &LightPass<'_, T>, output: ArrayViewMut2<'o, T>) -> Self {
        let extents = [0, 1].map(|axis| pass.processor.plan.extents(axis));
        Self::new(order(pass), &extents, (output, pass.first_output))
    }

    /// `extents` holds the ranges that columns and rows of blocks reach on the output's side. The
    /// output begins at row `first` of this side.
    fn new(
        blocks: Vec<(usize, usize)>,
        extents: &[Vec<(usize, usize)>; 2],
        (output, first): (ArrayViewMut2<'o, T>, usize),
    ) -> Self {
        let [columns, rows] = extents.each_ref().map(|extents| sharing(extents));
        let mut numbers = vec![vec![None; rows.len()]; columns.len()];
        for (number, &(column, row)) in blocks.iter().enumerate() {
            numbers[column][row] = Some(number);
        }
        let mut turns: Vec<Turn<T>> = Vec::with_capacity(blocks.len());
        for (number, &(column, row)) in blocks.iter().enumerate() {
            let near = columns[column]
                .iter()
                .flat_map(|&c| rows[row].iter().map(move |&r| (c, r)));
            let sharing: Vec<usize> = near.filter_map(|(c, r)| numbers[c][r]).collect();
            turns.push(Turn {
                earlier: AtomicUsize::new(sharing.iter().filter(|&&other| other < number).count()),
                later: sharing.into_iter().filter(|&other| other > number).collect(),
                waiting: Mutex::new(None),
            });
        }
        let height = output.nrows();
        let strip = |first: usize| (first, (first + STRIP).min(height));
        let strips: Vec<_> = (0..height).step_by(STRIP).map(strip).collect();
        Self {
            strips: split(output, 0, &strips).into_iter().map(Mutex::new).collect(),
            first,
            blocks,
            turns,
        }
    }

    /// Adds the result of a tile of a block or, before the block's turn, keeps a copy of it.
    pub(super) fn add_or_keep<S: Lanes<T>>(
        &self,
        simd: S,
        engine: &TileEngine<'_, T>,
        block: usize,
        result: TileResult<'_, T>,
        kept: &mut Vec<Patch<T>>,
    ) {
        let TileResult { plane, size, place } = result;
        if self.turns[block].earlier.load(Ordering::Acquire) == 0 {
            self.add_patches(simd, engine, kept);
            self.add(simd, engine, result);
        } else {
            let plane = plane[..engine.fft.pitch() * size.1].to_vec();
            kept.push(Patch { plane, size, place });
        }
    }

    /// Declares a block finished. Adds what was kept of it, and later blocks that waited for it. Or
    /// lets the block wait.
    pub(super) fn finish<S: Lanes<T>>(
        &self,
        simd: S,
        engine: &TileEngine<'_, T>,
        block: usize,
        kept: Vec<Patch<T>>,
    ) {
        let mut ready = Vec::new();
        {
            let turn = &self.turns[block];
            // An earlier block first counts down, and then looks for this one here.
            let mut waiting = turn.waiting.lock().unwrap_or_else(PoisonError::into_inner);
            if turn.earlier.load(Ordering::Acquire) == 0 {
                ready.push((block, kept));
            } else {
                *waiting = Some(kept);
            }
        }
        while let Some((block, mut patches)) = ready.pop() {
            self.add_patches(simd, engine, &mut patches);
            for &later in &self.turns[block].later {
                let turn = &self.turns[later];
                if turn.earlier.fetch_sub(1, Ordering::AcqRel) == 1 {
                    let mut waiting = turn.waiting.lock().unwrap_or_else(PoisonError::into_inner);
                    ready.extend(waiting.take().map(|patches| (later, patches)));
                }
            }
        }
    }

    fn add_patches<S: Lanes<T>>(&self, simd: S, engine: &TileEngine<'_, T>, patches: &mut Vec<Patch<T>>) {
        for Patch { plane, size, place } in patches.drain(..) {
            let plane = &plane;
            self.add(simd, engine, TileResult { plane, size, place });
        }
    }

    fn add<S: Lanes<T>>(&self, simd: S, engine: &TileEngine<'_, T>, result: TileResult<'_, T>) {
        let TileResult { plane, size, place } = result;
        let row = place.1 - self.first as i64;
        let strip = |row: i64| (row.max(0) as usize / STRIP).min(self.strips.len() - 1);
        for number in strip(row)..=strip(row + size.1 as i64 - 1) {
            let strip = &self.strips[number];
            let mut strip = strip.lock().unwrap_or_else(PoisonError::into_inner);
            // The rows of the result above this strip.
            let above = (number * STRIP) as i64 - row;
            let (skipped, row) = (above.max(0) as usize, -above.min(0));
            let plane = &plane[skipped * engine.fft.pitch()..];
            let size = (size.0, size.1 - skipped);
            vectorized!(simd, engine.add(plane, size, &mut strip, (place.0, row)));
        }
    }
}

/// For each range, the indices of all ranges that share values with it, itself included.
fn sharing(ranges: &[(usize, usize)]) -> Vec<Vec<usize>> {
    let shares = |a: &(usize, usize), b: &(usize, usize)| a.0 < b.1 && b.0 < a.1;
    ranges
        .iter()
        .map(|range| (0..ranges.len()).filter(|&i| shares(range, &ranges[i])).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;
    use psf_types::{Anchor, FrameShape};
    use rand::SeedableRng;
    use rand::seq::SliceRandom;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::plan::geometry::Geometry;
    use crate::simd::{SimdReal, WithIsa};
    use crate::transform::TileTransform;
    use crate::view::Reach;

    /// Blocks of 30 pixels that reach 50, so that three neighbours share pixels, on an image of several
    /// strips.
    const BLOCKS: usize = 5;
    const SIDE: usize = 170;

    struct AddBlocks<'a> {
        /// Numbers of blocks in the order in which they are finished.
        finished: &'a [usize],
        image: &'a mut Array2<f32>,
    }

    impl WithIsa<f32> for AddBlocks<'_> {
        type Output = ();
        fn run<S: Lanes<f32>>(self, simd: S) {
            let fft = TileTransform::<f32>::new(64, 64);
            let region = FrameShape::new(SIDE, SIDE).unwrap().region();
            let reach = Reach {
                left: 10,
                right: 10,
                below: 10,
                above: 10,
            };
            let engine = TileEngine {
                fft: &fft,
                geometry: Geometry::new(region, region, reach, Anchor::Source),
                flip: false,
            };
            let range = |i: usize| (30 * i, 30 * i + 50);
            let extents = [(0..BLOCKS).map(range).collect(), (0..BLOCKS).map(range).collect()];
            let blocks: Vec<_> = (0..BLOCKS * BLOCKS).map(|i| (i % BLOCKS, i / BLOCKS)).collect();
            let image = OrderedImage::new(blocks, &extents, (self.image.view_mut(), 0));
            for &number in self.finished {
                let (column, row) = image.blocks[number];
                let mut kept = Vec::new();
                // Two tiles, whose values cancel except for rounding that depends on their order.
                for value in [1e8 * (number as f32).sin(), -1e8 * (number as f32 + 0.5).sin()] {
                    let plane = vec![value; fft.pitch() * 50];
                    let result = TileResult {
                        plane: &plane,
                        size: (50, 50),
                        place: (30 * column as i64, 30 * row as i64),
                    };
                    image.add_or_keep(simd, &engine, number, result, &mut kept);
                }
                image.finish(simd, &engine, number, kept);
            }
        }
    }

    #[test]
    fn the_image_does_not_depend_on_the_order_in_which_blocks_are_finished() {
        let sum = |finished: &[usize]| {
            let mut image = Array2::zeros((SIDE, SIDE));
            let image_of = &mut image;
            f32::dispatch(AddBlocks {
                finished,
                image: image_of,
            });
            image
        };
        let mut order: Vec<usize> = (0..BLOCKS * BLOCKS).collect();
        let expected = sum(&order);
        assert!(expected.iter().all(|v| *v != 0.0));
        order.reverse();
        assert_eq!(sum(&order), expected);
        for seed in 0..20 {
            order.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
            assert_eq!(sum(&order), expected, "{seed}");
        }
    }
}
