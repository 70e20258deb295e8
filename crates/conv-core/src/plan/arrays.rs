//! A plan as plain arrays, for other software that executes it.

use ndarray::{Array3, Axis, s};
use psf_types::Anchor;
use rayon::prelude::*;

use super::Plan;
use crate::{ConvError, ConvReal};

/// A plan as plain arrays, from [`Plan::arrays`].
///
/// PSFs belong to the pixels of one side, the *weighted* side: the light that reaches the region
/// (source-anchored, [`Plan::light_region`]) or the region (output-anchored, [`Plan::region`]). Pixel
/// `(x, y)` of the weighted side and pixel `(x + reach.0 + i, y + reach.1 + j)` of the other side are
/// joined by the factor
///
/// `A = sum_k weights[k, y, x] kernels[k, j, i]`
///
/// with the weights and kernels of the block in which `(x, y)` lies. `A` is the derivative of the
/// image's pixel by the light's pixel. Pixels of a side count from its first pixel. Pixels outside a
/// side have no light.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PlanArrays<T> {
    /// The column and the row of the other side at which the reach of the weighted side's first pixel
    /// begins. Neither is above 0. The reach of the whole weighted side covers the other side.
    pub reach: (i64, i64),
    /// The blocks, row by row. They cover the weighted side, each pixel once.
    pub blocks: Vec<BlockArrays<T>>,
}

/// A block of a [`PlanArrays`].
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct BlockArrays<T> {
    /// The column and the row of the weighted side at which the block begins.
    pub first: (usize, usize),
    /// `[kernel, y, x]`: the stamps of the block's modes. They are turned by 180 degrees if the plan is
    /// output-anchored, because a pixel of the image gathers light from the opposite side.
    pub kernels: Array3<T>,
    /// `[kernel, y, x]`: the weight of each kernel at each pixel of the block. The flux of the PSF is
    /// included.
    pub weights: Array3<T>,
}

impl<T: ConvReal> Plan<T> {
    /// Returns the plan as plain arrays, with which other software can execute it. The weights take
    /// memory for each pixel and mode, much more than the plan itself.
    ///
    /// # Errors
    /// [`ConvError::Layers`] if the plan has several layers. [`ConvError::Field`] if there is a pixel
    /// without a PSF, even if no light needs this PSF.
    #[inline(never)]
    pub fn arrays(&self) -> Result<PlanArrays<T>, ConvError> {
        if self.models().len() > 1 {
            return Err(ConvError::Layers(
                "a plan of several layers needs the native engine",
            ));
        }
        let across = self.tiling.columns.len();
        let blocks = (0..self.blocks.len()).into_par_iter().with_max_len(1);
        Ok(PlanArrays {
            reach: self.geometry.reach_from(0, 0),
            blocks: blocks
                .map(|i| self.block_arrays(i % across, i / across))
                .collect::<Result<_, _>>()?,
        })
    }

    fn block_arrays(&self, column: usize, row: usize) -> Result<BlockArrays<T>, ConvError> {
        let (block, space) = (self.block(column, row), &self.whole.space);
        let (across, up) = (&self.tiling.columns[column], &self.tiling.rows[row]);
        let table = block.table_or_new(space);
        // A plan of a region may use only a part of the block.
        let columns = across.lead..across.lead + across.length();
        let rows = up.lead..up.lead + up.length();
        table.check(self.models(), |row, column| {
            rows.contains(&row) && columns.contains(&column)
        })?;
        let count = block.kernel_count();
        let mut weights = Array3::zeros((count, rows.len(), columns.len()));
        for (y, mut of_row) in weights.axis_iter_mut(Axis(1)).enumerate() {
            for (x, mut of_pixel) in of_row.axis_iter_mut(Axis(1)).enumerate() {
                let coefficients = table.pixel(rows.start + y, columns.start + x);
                for (kernel, weight) in of_pixel.iter_mut().enumerate() {
                    *weight = coefficients.weigh(kernel, T::one());
                }
            }
        }
        let (nx, ny) = self.geometry.stamp;
        let stamps = block.stamps_or_new(space).values().to_vec();
        let mut kernels = Array3::from_shape_vec((count, ny, nx), stamps).expect("the stamps of the block");
        if self.options.anchor() == Anchor::Output {
            kernels = kernels
                .slice(s![.., ..;-1, ..;-1])
                .as_standard_layout()
                .into_owned();
        }
        Ok(BlockArrays {
            first: (across.start(), up.start()),
            kernels,
            weights,
        })
    }
}
