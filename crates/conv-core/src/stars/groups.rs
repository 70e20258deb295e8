//! Stars of a block, drawn together.

use std::ops::Range;
use std::sync::Arc;

use ndarray::{ArrayViewMut2, Axis};
use psf_types::Progress;
use rayon::prelude::*;

use super::cache::BlockKey;
use super::draw::BlockDraw;
use super::phases::PhasedAxis;
use super::star::PreparedStar;
use super::star_block::{RowLayout, StarBlock};
use super::tile::Tile;
use crate::simd::{Lanes, WithIsa};
use crate::stamp_interpolator::MOST_TAPS;
use crate::{ConvError, ConvReal};

/// Rows of the image to which one task adds.
const BAND: usize = 32;

/// The order of stars: what a pixel gets depends on it, so it depends on nothing but them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct StarKey {
    pub(super) block: BlockKey,
    /// A part of the catalogue, so that no group has more stars than are prepared at a time.
    pub(super) part: usize,
    /// Stars of the same phases take the same values.
    pub(super) phases: (i64, i64),
    pub(super) index: usize,
}

/// Stars of one block.
pub(super) struct Group<T> {
    block: Arc<StarBlock<T>>,
    stars: Vec<PreparedStar<T>>,
    weights: Vec<T>,
    /// The columns and rows that they may light.
    columns: Range<i64>,
    rows: Range<i64>,
}

impl<T> Group<T> {
    pub(super) fn new(block: Arc<StarBlock<T>>, stars: Vec<PreparedStar<T>>, weights: Vec<T>) -> Self {
        Self {
            block,
            columns: hull(stars.iter().map(|star| &star.columns)),
            rows: hull(stars.iter().map(|star| &star.rows)),
            stars,
            weights,
        }
    }
}

/// Groups into an image: each into a tile of its own, and these in their order into bands of rows.
pub(super) struct DrawGroups<'a, T> {
    pub(super) axes: &'a [PhasedAxis; 2],
    pub(super) layout: RowLayout,
    pub(super) groups: &'a [Group<T>],
    /// Of the frame, from this column and row on.
    pub(super) image: ArrayViewMut2<'a, T>,
    pub(super) first: (i64, i64),
    pub(super) progress: &'a dyn Progress,
}

impl<T: ConvReal> WithIsa<T> for DrawGroups<'_, T> {
    type Output = Result<(), ConvError>;
    fn run<S: Lanes<T>>(self, simd: S) -> Self::Output {
        let Self {
            axes,
            layout,
            groups,
            mut image,
            first: (first_column, first_row),
            progress,
        } = self;
        let height = image.nrows() as i64;
        let draw = |group: &Group<T>| {
            progress.still_wanted()?;
            let rows = group.rows.start.max(first_row)..group.rows.end.min(first_row + height);
            let mut tile = Tile::dark(group.columns.clone(), rows);
            let draw = BlockDraw {
                oversampling: axes[0].oversampling(),
                layout,
                block: &group.block,
                stars: &group.stars,
                weights: &group.weights,
                progress,
            };
            simd.vectorized(
                #[inline(always)]
                || match axes[0].tap_count() {
                    4 => draw.draw::<S, 4>(simd, &mut tile),
                    _ => draw.draw::<S, MOST_TAPS>(simd, &mut tile),
                },
            )?;
            Ok(tile)
        };
        let tiles: Vec<Tile<T>> = groups.par_iter().map(draw).collect::<Result<_, ConvError>>()?;
        let bands = image
            .axis_chunks_iter_mut(Axis(0), BAND)
            .into_par_iter()
            .enumerate();
        bands.for_each(|(band, mut rows)| {
            for tile in &tiles {
                tile.add_to(&mut rows, (first_column, first_row + (band * BAND) as i64));
            }
        });
        Ok(())
    }
}

/// The smallest range that holds all ranges.
fn hull<'a>(ranges: impl Iterator<Item = &'a Range<i64>>) -> Range<i64> {
    ranges
        .cloned()
        .reduce(|a, b| a.start.min(b.start)..a.end.max(b.end))
        .unwrap_or(0..0)
}
