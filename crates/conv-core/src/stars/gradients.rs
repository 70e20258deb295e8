//! Derivatives with respect to the fluxes and positions of stars.
//!
//! A pixel of a star is a sum over its column taps, its row taps and the kernels of its block. Here the sums
//! over the pixels of an image `g` come first: row by row, the pixels of `g` are spread to the coefficients that
//! their column taps use, with the weights of the taps and with the derivatives of these weights. The scalar
//! products with the coefficients of each kernel, added up over the rows, are then multiplied by the weights of
//! the row taps and the coefficients of the kernels, or by their derivatives.

use std::ops::Range;
use std::slice::from_ref;

use ndarray::ArrayView2;
use psf_types::PixelRegion;
use pulp::bytemuck::cast_slice;
use rayon::prelude::*;

use super::draw_blocks::{BlockDrawer, StarKey, StarsToDraw};
use super::phases::Star;
use super::row_layout::{CHUNK, RowLayout};
use super::star_block::StarBlock;
use super::star_drawer::StarDrawer;
use crate::overlap::overlap;
use crate::simd::{Aligned, Lanes, WithIsa, vectorized};
use crate::sources::{PointGradient, PsfVectors, SourcePsfs, with_unit_flux};
use crate::stamp_interpolator::MOST_TAPS;
use crate::{ConvError, ConvReal};

/// The stars of a task. They share the rows of coefficients in the cache.
const AT_ONCE: usize = 32;

impl<T: ConvReal> StarDrawer<T> {
    /// The derivatives of `sum(image * stars)`. `image` holds the pixels of a region of the frame.
    pub(crate) fn gradients(
        &self,
        psfs: &SourcePsfs,
        catalogue: StarsToDraw<'_>,
        region: PixelRegion,
        image: ArrayView2<'_, T>,
    ) -> Result<Vec<PointGradient>, ConvError> {
        let stars = with_unit_flux(catalogue.stars);
        let unit = StarsToDraw {
            stars: &stars,
            ..catalogue
        };
        let mut gradients = vec![[0.0; 3]; unit.stars.len()];
        let mut to_paint: Vec<usize> = (0..unit.stars.len()).collect();
        if let Some(phased) = &self.phased {
            let drawer = self.block_drawer(psfs, phased, unit, region);
            to_paint.clear();
            for (index, gradient) in T::dispatch(OfBlocks { drawer, image })? {
                match gradient {
                    Some(gradient) => gradients[index] = gradient,
                    None => to_paint.push(index),
                }
            }
        }
        let painter = self.painter(psfs, unit.frame);
        let painted = to_paint.par_iter().map(|&index| {
            unit.progress.check_cancelled()?;
            painter.gradient(&unit.stars[index], region, image)
        });
        let painted: Vec<[f64; 3]> = painted.collect::<Result<_, ConvError>>()?;
        for (index, gradient) in to_paint.into_iter().zip(painted) {
            gradients[index] = gradient;
        }
        let stars = catalogue.stars.iter().zip(gradients);
        Ok(stars
            .map(|(star, gradient)| PointGradient::for_flux(star.flux(), gradient))
            .collect())
    }
}

/// Computes the derivatives of the stars that the local bases represent.
struct OfBlocks<'a, T> {
    drawer: BlockDrawer<'a, T>,
    image: ArrayView2<'a, T>,
}

/// The index of a star, and its derivatives with respect to flux, x and y. `None` for a star that its block does
/// not represent within the tolerance.
type StarProducts = (usize, Option<[f64; 3]>);

/// A star of flux 1.
struct UnitStar<T> {
    index: usize,
    /// The pixels that it lights.
    columns: Range<i64>,
    rows: Range<i64>,
    /// The first row and the first column of coefficients that its first pixel uses.
    first_row: usize,
    first_column: usize,
    /// The weights of the column taps, and their derivatives with respect to x.
    column_taps: [[T; MOST_TAPS]; 2],
    /// The weights of the row taps, and their derivatives with respect to y.
    row_taps: [[f64; MOST_TAPS]; 2],
    /// The coefficients of the kernels, and their derivatives with respect to x and y.
    coefficients: [Vec<f64>; 3],
}

impl<T: ConvReal> WithIsa<T> for OfBlocks<'_, T> {
    type Output = Result<Vec<StarProducts>, ConvError>;

    fn run<S: Lanes<T>>(self, simd: S) -> Self::Output {
        let keys = self.drawer.sorted();
        let blocks = keys.chunk_by(|a, b| a.0 == b.0);
        let tasks: Vec<&[StarKey]> = blocks.flat_map(|block| block.chunks(AT_ONCE)).collect();
        let found = tasks.into_par_iter().map(|stars| {
            self.drawer.catalogue.progress.check_cancelled()?;
            let ((row, column), _) = stars[0];
            let block = self.drawer.block((i64::from(row), i64::from(column)));
            let (prepared, mut found) = self.prepare(&block, stars)?;
            let gradients = vectorized!(
                simd,
                match self.drawer.phased.axes[0].kernel.tap_count() {
                    4 => self.of_stars::<S, 4>(simd, &block, &prepared),
                    _ => self.of_stars::<S, MOST_TAPS>(simd, &block, &prepared),
                }
            );
            let some = prepared.iter().zip(gradients);
            found.extend(some.map(|(star, gradient)| (star.index, Some(gradient))));
            Ok(found)
        });
        let found: Vec<Vec<StarProducts>> = found.collect::<Result<_, ConvError>>()?;
        Ok(found.into_iter().flatten().collect())
    }
}

impl<T: ConvReal> OfBlocks<'_, T> {
    /// Prepares the stars that reach the region and that the block represents. Returns the others apart.
    fn prepare(
        &self,
        block: &StarBlock<T>,
        stars: &[StarKey],
    ) -> Result<(Vec<UnitStar<T>>, Vec<StarProducts>), ConvError> {
        let BlockDrawer {
            psfs,
            phased,
            catalogue,
            window,
            region,
        } = self.drawer;
        let [axis_x, axis_y] = &phased.axes;
        let (mut vectors, mut coefficients) = (psfs.vectors(), Vec::new());
        let (mut prepared, mut missed) = (Vec::with_capacity(stars.len()), Vec::new());
        for &(_, index) in stars {
            let star = Star::new(&catalogue.stars[index], catalogue.frame);
            let Some(phases) = star.phases(&phased.axes).filter(|_| star.reaches(window, region)) else {
                continue;
            };
            let psfs = vectors.with_slopes(star.field_position()?)?;
            vectors.set_vector(&psfs[0]);
            let again = |vectors: &mut PsfVectors<'_>| {
                vectors.set_vector(&psfs[0]);
                Ok(())
            };
            let drawer = &self.drawer;
            if !drawer.project_within(block, &star, &mut vectors, &mut coefficients, again)? {
                missed.push((index, None));
                continue;
            }
            let [_, along_x, along_y] = psfs;
            let of_psf = coefficients.clone();
            let [along_x, along_y] = [along_x, along_y].map(|slope| {
                vectors.set_vector(&slope);
                vectors.project(&block.modes, &mut coefficients);
                coefficients.clone()
            });
            let coefficients = [of_psf, along_x, along_y];
            let (shift, [columns, rows]) = (star.shift, &phases);
            let (taps, row_taps) = (
                [columns.weights, axis_x.slopes(shift.0)],
                [rows.weights, axis_y.slopes(shift.1)],
            );
            let placed = star.phased::<T>((phases, axis_x.oversampling), None, 0..0);
            prepared.push(UnitStar {
                index,
                columns: placed.columns,
                rows: placed.rows,
                first_row: placed.first_row,
                first_column: placed.first_column,
                column_taps: taps.map(|taps| taps.map(T::nearest)),
                row_taps,
                coefficients,
            });
        }
        Ok((prepared, missed))
    }

    /// The derivatives of some stars with respect to flux, x and y.
    #[inline(always)]
    fn of_stars<S: Lanes<T>, const TAPS: usize>(
        &self,
        simd: S,
        block: &StarBlock<T>,
        stars: &[UnitStar<T>],
    ) -> Vec<[f64; 3]> {
        let (phased, region) = (self.drawer.phased, self.drawer.region);
        let (layout, kernels) = (phased.layout, block.modes.kernel_count());
        // For each star, row tap and kernel: with the weights of the column taps, and with their derivatives.
        let length = 2 * TAPS * kernels;
        let mut sums = vec![simd.splat(T::zero()); stars.len() * length];
        let longest = stars.iter().map(|star| star.rows.end - star.rows.start).max();
        let mut row_of_image = SpreadRow::new(layout, TAPS);
        for j in 0..longest.unwrap_or(0) {
            for (star, sums) in stars.iter().zip(sums.chunks_exact_mut(length.max(1))) {
                let row = star.rows.start + j;
                let of_region = usize::try_from(row - region.y0()).ok();
                let Some(row) = of_region.filter(|&at| row < star.rows.end && at < self.image.nrows()) else {
                    continue;
                };
                let row = self.image.row(row);
                let row = row.to_slice().expect("the pixels of a row are neighbours");
                row_of_image.spread::<TAPS>(star, layout, row, region.x0());
                let first = star.first_row + j as usize * phased.axes[1].oversampling;
                let values = &block.values()[first * kernels * layout.kernel..];
                row_of_image.add_products::<S, TAPS>(simd, star, layout, values, sums);
            }
        }
        let added: Vec<f64> = sums
            .iter()
            .map(|lanes| {
                cast_slice::<S::V, T>(from_ref(lanes))
                    .iter()
                    .map(|v| v.as_f64())
                    .sum()
            })
            .collect();
        let of_stars = added.chunks_exact(length.max(1));
        let gradients = stars.iter().zip(of_stars).map(|(star, sums)| star.gradient(sums));
        gradients.collect()
    }
}

impl<T> UnitStar<T> {
    /// The derivatives with respect to flux, x and y, from the sums `[row tap, kernel, 2]` of
    /// [`SpreadRow::add_products`].
    fn gradient(&self, sums: &[f64]) -> [f64; 3] {
        let [psf, along_x, along_y] = &self.coefficients;
        let mut gradient = [0.0; 3];
        let row_taps = self.row_taps[0].iter().zip(&self.row_taps[1]);
        for (sums, (weight, slope)) in sums.chunks_exact((2 * psf.len()).max(1)).zip(row_taps) {
            for (kernel, sums) in sums.chunks_exact(2).enumerate() {
                let (c, [sum, of_slopes]) = (psf[kernel], [sums[0], sums[1]]);
                gradient[0] += weight * c * sum;
                gradient[1] += weight * (c * of_slopes + along_x[kernel] * sum);
                gradient[2] += (slope * c + weight * along_y[kernel]) * sum;
            }
        }
        gradient
    }
}

/// A row of the image, spread to the coefficients that the pixels of a star use.
struct SpreadRow<T> {
    /// The pixels from the star's first column on, in whole chunks.
    pixels: Vec<T>,
    /// With the weights of the column taps, and with their derivatives. In the order of a kernel's row or, if taps
    /// share no coefficients, only those that are used: `[chunk, tap, pixel]`.
    spread: [Aligned<T>; 2],
    /// The number of columns.
    columns: usize,
}

impl<T: ConvReal> SpreadRow<T> {
    fn new(layout: RowLayout, taps: usize) -> Self {
        let chunks = layout.kernel / layout.residues / CHUNK;
        let length = layout.kernel.max(chunks * taps * CHUNK);
        Self {
            pixels: vec![T::zero(); chunks * CHUNK],
            spread: [Aligned::zeros(length), Aligned::zeros(length)],
            columns: 0,
        }
    }

    /// Spreads a row of the image, whose first pixel is `first`.
    #[inline(always)]
    fn spread<const TAPS: usize>(&mut self, star: &UnitStar<T>, layout: RowLayout, row: &[T], first: i64) {
        self.columns = (star.columns.end - star.columns.start) as usize;
        self.pixels.fill(T::zero());
        if let Some((of_row, of_star)) = overlap(first - star.columns.start, row.len(), self.columns) {
            self.pixels[of_star].copy_from_slice(&row[of_row]);
        }
        for (spread, taps) in self.spread.iter_mut().zip(&star.column_taps) {
            let spread = spread.get_mut();
            if layout.is_shared {
                spread.fill(T::zero());
                let firsts: [usize; TAPS] = layout.shared_taps(star.first_column);
                for (first, &weight) in firsts.into_iter().zip(taps) {
                    let to = &mut spread[first..first + self.columns];
                    to.iter_mut()
                        .zip(&self.pixels)
                        .for_each(|(to, &g)| *to += weight * g);
                }
                continue;
            }
            let chunks = spread.chunks_exact_mut(TAPS * CHUNK);
            for (spread, pixels) in chunks.zip(self.pixels.chunks_exact(CHUNK)) {
                for (to, &weight) in spread.chunks_exact_mut(CHUNK).zip(taps) {
                    to.iter_mut().zip(pixels).for_each(|(to, &g)| *to = weight * g);
                }
            }
        }
    }

    /// Adds the products with the coefficients `[row tap, kernel, value of a row]` to the sums `[row tap, kernel, 2]`,
    /// lane by lane.
    #[inline(always)]
    fn add_products<S: Lanes<T>, const TAPS: usize>(
        &self,
        simd: S,
        star: &UnitStar<T>,
        layout: RowLayout,
        values: &[T],
        sums: &mut [S::V],
    ) {
        let (chunks, length) = if layout.is_shared {
            (1, layout.kernel)
        } else {
            (self.columns.div_ceil(CHUNK), TAPS * CHUNK)
        };
        // Two rows at a time, so that the processor need not wait for each sum. The number of taps is even.
        let pairs = values.chunks_exact(2 * layout.kernel);
        for (values, sums) in pairs.zip(sums.chunks_exact_mut(4)) {
            let [mut a, mut b, mut c, mut d] = [sums[0], sums[1], sums[2], sums[3]];
            for chunk in 0..chunks {
                let at = if layout.is_shared {
                    0
                } else {
                    layout.index(star.first_column, chunk * CHUNK)
                };
                let of_row =
                    |row: usize| cast_slice::<T, S::V>(&values[row * layout.kernel + at..][..length]);
                let [weights, slopes] = self.spread.each_ref().map(
                    #[inline(always)]
                    |spread| cast_slice::<T, S::V>(&spread.get()[chunk * length..][..length]),
                );
                let rows = of_row(0).iter().zip(of_row(1));
                for ((&first, &second), (&weight, &slope)) in rows.zip(weights.iter().zip(slopes)) {
                    a = simd.mul_add(first, weight, a);
                    b = simd.mul_add(first, slope, b);
                    c = simd.mul_add(second, weight, c);
                    d = simd.mul_add(second, slope, d);
                }
            }
            sums.copy_from_slice(&[a, b, c, d]);
        }
    }
}
