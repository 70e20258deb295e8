//! What goes through the operator of a plan.

use std::ops::Range;

use ndarray::ArrayView2;
use psf_types::Progress;

use super::plan::Plan;
use crate::ConvReal;

/// The light of one side that goes through some rows of a plan's blocks, to rows of the other side from `first_output` on.
#[derive(Clone)]
pub(crate) struct Job<'a, T: ConvReal> {
    pub(crate) plan: &'a Plan<T>,
    /// Rows of blocks.
    pub(crate) rows: Range<usize>,
    /// Whole rows of the side that the light comes from, and the first of them.
    pub(crate) light: ArrayView2<'a, T>,
    pub(crate) first_light: usize,
    pub(crate) first_output: usize,
    /// Stamps are applied turned by 180 degrees.
    pub(crate) flip: bool,
    pub(crate) progress: &'a dyn Progress,
}
