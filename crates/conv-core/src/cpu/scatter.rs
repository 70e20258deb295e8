//! Scattering: light of the weighted side spreads to the other side. One side is the light, the
//! other is the image. PSFs belong to the pixels of the weighted side.

use std::sync::atomic::{AtomicUsize, Ordering};

use ndarray::{ArrayViewMut2, ShapeBuilder};
use rayon::prelude::*;

use super::ordered_image::{OrderedImage, TileResult};
use super::processor::{BlockKernels, LightPass};
use super::tile_engine::Workspace;
use super::treatment::{LitPixel, TileCounts, TileMethod, each_tile};
use crate::simd::{Lanes, WithIsa, vectorized};
use crate::{ConvError, ConvReal};

/// Spreads light of the weighted side: `output(q) += sum_p c(p) light(p) k(q - p)`, or `k(p - q)`
/// in the adjoint. The sum over the pixels `p` of a block is added for each kernel `k` of this
/// block, with the kernel's coefficients `c`.
///
/// Threads convolve blocks independently. The image receives the blocks in a fixed order
/// ([`OrderedImage`]).
pub(crate) struct Scatter<'j, 'o, T: ConvReal> {
    pub(crate) pass: LightPass<'j, T>,
    pub(crate) output: ArrayViewMut2<'o, T>,
}

impl<T: ConvReal> WithIsa<T> for Scatter<'_, '_, T> {
    type Output = Result<TileCounts, ConvError>;

    fn run<S: Lanes<T>>(self, simd: S) -> Self::Output {
        let pass = &self.pass;
        let plan = &pass.processor.plan;
        let engine = pass.tile_engine();
        let image = OrderedImage::of_pass(pass, self.output);
        let finished = AtomicUsize::new(0);
        // The number of the first block that failed. Later ones are skipped.
        let failed = AtomicUsize::new(usize::MAX);
        // Each thread takes the next block when it is free.
        let mut done: Vec<_> = image
            .blocks
            .iter()
            .enumerate()
            .par_bridge()
            .filter(|&(number, _)| number < failed.load(Ordering::Relaxed))
            .map(|(number, &block)| {
                let counts = pass.processor.with_workspace(|workspace| {
                    let mut kernels = BlockKernels::new(plan, block);
                    let mut kept = Vec::new();
                    let counts = scatter_block(simd, pass, block, &mut kernels, workspace, |result| {
                        image.add_or_keep(simd, &engine, number, result, &mut kept);
                    })?;
                    image.finish(simd, &engine, number, kept);
                    Ok::<_, ConvError>(counts)
                });
                if counts.is_err() {
                    failed.fetch_min(number, Ordering::Relaxed);
                }
                let finished = finished.fetch_add(1, Ordering::Relaxed) + 1;
                pass.progress
                    .advance(u64::from(finished.is_multiple_of(plan.tiling.columns.len())));
                (number, counts)
            })
            .collect();
        // Of several errors, returns that of the first block.
        done.sort_unstable_by_key(|&(number, _)| number);
        done.into_iter().map(|(_, counts)| counts).sum()
    }
}

/// Gives the result of each lit tile of a block to `take`.
pub(super) fn scatter_block<T: ConvReal, S: Lanes<T>>(
    simd: S,
    pass: &LightPass<'_, T>,
    block: (usize, usize),
    kernels: &mut BlockKernels<'_, T>,
    workspace: &mut Workspace<T>,
    mut take: impl FnMut(TileResult<'_, T>),
) -> Result<TileCounts, ConvError> {
    let plan = &pass.processor.plan;
    let engine = pass.tile_engine();
    each_tile(
        simd,
        pass,
        block,
        kernels,
        workspace,
        |local, treatment, workspace| {
            let reach = plan.geometry.reach_from(local.tile.first.0, local.tile.first.1);
            let (mut size, mut first) = (plan.geometry.around(local.tile.size), (0, 0));
            if let Some(method) = treatment.method {
                vectorized!(simd, {
                    match method {
                        TileMethod::Directly => engine.scatter_directly(local, workspace),
                        TileMethod::ByTransforms => engine.scatter(simd, local, workspace),
                    }
                    if let Some(back) = treatment.back {
                        for value in workspace.weighted.get_mut() {
                            *value *= back;
                        }
                    }
                });
            } else {
                (first, size) = reached(&treatment.drawn, local.tile.size.1, engine.geometry.stamp);
            }
            let (pitch, plane) = (engine.fft.pitch(), workspace.weighted.get_mut());
            if !treatment.drawn.is_empty() {
                if treatment.method.is_none() {
                    for row in plane.chunks_exact_mut(pitch).take(size.1) {
                        row[..size.0].fill(T::zero());
                    }
                }
                let shape = (size.1, size.0).strides((pitch, 1));
                let mut lit = ArrayViewMut2::from_shape(shape, plane).expect("the plane's size");
                let corner = (-(first.0 as i64), -(first.1 as i64));
                vectorized!(
                    simd,
                    engine.draw_scattered(simd, local, &treatment.drawn, &mut lit, corner)
                );
            }
            take(TileResult {
                plane: workspace.weighted.get(),
                size,
                place: (reach.0 + first.0 as i64, reach.1 + first.1 as i64),
            });
        },
    )
}

/// The rectangle that the stamps of some pixels reach: its first column and row, counted from the first
/// pixel that the tile reaches, and its columns and rows. A layer of the tile has `rows` rows.
fn reached<T>(
    pixels: &[LitPixel<T>],
    rows: usize,
    stamp: (usize, usize),
) -> ((usize, usize), (usize, usize)) {
    let along = |coordinate: &dyn Fn(&LitPixel<T>) -> usize, stamp: usize| {
        let first = pixels.iter().map(coordinate).min().unwrap_or(0);
        let last = pixels.iter().map(coordinate).max().unwrap_or(0);
        (first, last - first + stamp)
    };
    let x = along(&|pixel| pixel.1, stamp.0);
    let y = along(&|pixel| pixel.0 % rows, stamp.1);
    ((x.0, y.0), (x.1, y.1))
}
