//! Division of an axis into blocks and tiles.

use std::ops::Range;

/// The columns or the rows of one block, divided into tiles. The tiles of a block share one local
/// basis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Stretch {
    /// First pixel and length of each tile, in order.
    pub(crate) tiles: Vec<(usize, usize)>,
    /// The number of pixels between the start of the block and its first tile. It is above 0 only
    /// if a plan of a region omits these pixels.
    pub(crate) lead: usize,
}

impl Stretch {
    fn new(tiles: Vec<(usize, usize)>) -> Self {
        Self { tiles, lead: 0 }
    }

    /// Returns the part of the stretch that lies in the range `part` of the axis. Its pixels are
    /// counted from the start of this range. `None` if the stretch and the range do not overlap.
    fn within(&self, part: &Range<usize>) -> Option<Self> {
        let inside = |&(start, length): &(usize, usize)| {
            let (from, to) = (start.max(part.start), (start + length).min(part.end));
            (from < to).then(|| (from - part.start, to - from))
        };
        let tiles: Vec<(usize, usize)> = self.tiles.iter().filter_map(inside).collect();
        let first = tiles.first()?.0 + part.start;
        Some(Self {
            lead: self.lead + first - self.start(),
            tiles,
        })
    }

    /// For each tile: its first pixel on the axis, its length, and the number of pixels from the
    /// block's first pixel to the tile's.
    pub(crate) fn placed(&self) -> impl Iterator<Item = (usize, usize, usize)> {
        let tiles = self.tiles.iter();
        tiles.map(|&(start, length)| (start, length, start - self.start() + self.lead))
    }

    pub(crate) fn start(&self) -> usize {
        self.tiles[0].0
    }

    pub(crate) fn end(&self) -> usize {
        let (start, length) = self.tiles[self.tiles.len() - 1];
        start + length
    }

    pub(crate) fn length(&self) -> usize {
        self.end() - self.start()
    }
}

/// Divides an axis into tiles of nearly equal length, at most `tile` pixels. Each stretch has
/// `together` tiles, the last stretch perhaps fewer.
pub(crate) fn even(length: usize, tile: usize, together: usize) -> Vec<Stretch> {
    let tiles = parts(0, length, tile);
    tiles
        .chunks(together)
        .map(|tiles| Stretch::new(tiles.to_vec()))
        .collect()
}

/// Divides an axis into stretches. A new stretch begins at each pixel in `cuts`. These pixels are
/// ascending and inside the axis. Each stretch has tiles of at most `tile` pixels. With `split`,
/// each tile is a stretch of its own.
pub(crate) fn at_cuts(length: usize, cuts: &[usize], tile: usize, split: bool) -> Vec<Stretch> {
    let starts = std::iter::once(0).chain(cuts.iter().copied());
    let ends = cuts.iter().copied().chain([length]);
    let stretches = starts
        .zip(ends)
        .map(|(start, end)| parts(start, end - start, tile));
    if split {
        stretches.flatten().map(|tile| Stretch::new(vec![tile])).collect()
    } else {
        stretches.map(Stretch::new).collect()
    }
}

/// Returns the stretches with pixels in the range `part` of the axis, and their indices. The
/// stretches are truncated to this range, and their pixels are counted from its start.
pub(crate) fn within(stretches: &[Stretch], part: &Range<usize>) -> (Vec<Stretch>, Range<usize>) {
    let first = stretches.partition_point(|stretch| stretch.end() <= part.start);
    let cut: Vec<Stretch> = stretches[first..]
        .iter()
        .map_while(|stretch| stretch.within(part))
        .collect();
    let numbers = first..first + cut.len();
    (cut, numbers)
}

/// The length of the longest tile.
pub(crate) fn longest(stretches: &[Stretch]) -> usize {
    let tiles = stretches.iter().flat_map(|stretch| &stretch.tiles);
    tiles.map(|&(_, length)| length).max().unwrap_or(1)
}

/// Divides pixels into parts of nearly equal length, at most `tile` pixels: first pixel and length.
pub(crate) fn parts(start: usize, length: usize, tile: usize) -> Vec<(usize, usize)> {
    let count = length.div_ceil(tile.max(1)).max(1);
    (0..count)
        .map(|i| (i * length / count, (i + 1) * length / count))
        .map(|(from, to)| (start + from, to - from))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_the_axis_once() {
        for stretches in [
            even(100, 33, 2),
            even(100, 1000, 3),
            even(1, 5, 1),
            at_cuts(100, &[10, 50], 20, false),
            at_cuts(100, &[10, 50], 20, true),
            at_cuts(7, &[], 3, false),
        ] {
            let mut next = 0;
            for (start, length) in stretches.iter().flat_map(|s| s.tiles.clone()) {
                assert_eq!(start, next);
                assert!(length > 0);
                next = start + length;
            }
            assert!([100, 1, 7].contains(&next));
        }
        assert_eq!(longest(&even(100, 33, 2)), 25);
        let cut = at_cuts(100, &[10, 50], 20, false);
        assert_eq!((cut.len(), cut[1].start(), cut[1].end()), (3, 10, 50));
    }

    #[test]
    fn a_part_of_the_axis_has_every_pixel_of_it_where_it_was() {
        let whole = at_cuts(100, &[10, 50], 20, false);
        for part in [0..100, 0..1, 99..100, 9..11, 10..50, 17..83, 30..31] {
            let (cut, numbers) = within(&whole, &part);
            assert_eq!(cut.len(), numbers.len());
            let mut next = 0;
            for (stretch, of_whole) in cut.iter().zip(&whole[numbers]) {
                assert_eq!(stretch.start() + part.start, of_whole.start() + stretch.lead);
                for &(start, length) in &stretch.tiles {
                    assert_eq!(start, next);
                    next = start + length;
                    let tiles = &of_whole.tiles;
                    let (from, to) = (start + part.start, next + part.start);
                    assert!(
                        tiles
                            .iter()
                            .any(|&(first, count)| first <= from && to <= first + count)
                    );
                }
            }
            assert_eq!(next, part.len());
        }
        assert_eq!(within(&whole, &(0..100)), (whole, 0..3));
    }
}
