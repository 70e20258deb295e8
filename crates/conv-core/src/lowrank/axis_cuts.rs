//! Cutting an axis into blocks and tiles.

/// A stretch of an axis whose tiles share one local basis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Stretch {
    /// First pixel and length of each tile, in order.
    pub(crate) tiles: Vec<(usize, usize)>,
}

impl Stretch {
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

/// Tiles of at most `tile` pixels and nearly equal length, `together` of them a stretch.
pub(crate) fn even(length: usize, tile: usize, together: usize) -> Vec<Stretch> {
    let tiles = parts(0, length, tile);
    tiles
        .chunks(together)
        .map(|tiles| Stretch {
            tiles: tiles.to_vec(),
        })
        .collect()
}

/// Stretches between the given cuts, which are ascending pixels inside the axis; each in tiles of at most `tile` pixels, and
/// each tile a stretch of its own where `split`.
pub(crate) fn at_cuts(length: usize, cuts: &[usize], tile: usize, split: bool) -> Vec<Stretch> {
    let starts = std::iter::once(0).chain(cuts.iter().copied());
    let ends = cuts.iter().copied().chain([length]);
    let stretches = starts
        .zip(ends)
        .map(|(start, end)| parts(start, end - start, tile));
    if split {
        stretches
            .flatten()
            .map(|tile| Stretch { tiles: vec![tile] })
            .collect()
    } else {
        stretches.map(|tiles| Stretch { tiles }).collect()
    }
}

/// The longest tile.
pub(crate) fn longest(stretches: &[Stretch]) -> usize {
    let tiles = stretches.iter().flat_map(|stretch| &stretch.tiles);
    tiles.map(|&(_, length)| length).max().unwrap_or(1)
}

fn parts(start: usize, length: usize, tile: usize) -> Vec<(usize, usize)> {
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
}
