//! Draws the stars of a crowded block by transforms.
//!
//! Each star is spread over a few pixels of *planes*, and the planes are convolved with the block's
//! kernels. There is one plane for each kernel and each pair of residues. Let `s q + r` be the
//! coefficient that contributes to pixel `X` of a star through one of its taps. This tap is added to
//! the plane of residue `r`, at pixel `X - q`. The convolution then adds coefficient `s (q + j) + r`
//! to each pixel `X + j`, as drawing does. Positions are not rounded: the taps are those of the
//! star's own sub-pixel position.

use ndarray::{ArrayView2, ArrayViewMut2, ShapeBuilder};
use psf_types::PixelRegion;

use super::draw::Group;
use super::phases::PhasedAxis;
use super::row_layout::RowLayout;
use super::star_block::StarBlock;
use crate::overlap::add_values;
use crate::plan::cost_model::{CostModel, fast_size, transform_size};
use crate::simd::{Aligned, Lanes, vectorized};
use crate::stamp_interpolator::MOST_TAPS;
use crate::transform::{TileTransform, X_STEP, Y_STEP};
use crate::workspaces::Workspaces;
use crate::{ConvError, ConvReal};

/// Blocks have at least this many columns and rows. Smaller blocks need fewer kernels. But drawing a
/// catalogue reads the kernels of all blocks, and smaller blocks have more kernels in total.
const LEAST_SIDE: usize = 224;
/// The most memory of a thread. Stamps with many pixels per frame pixel need many planes, and large
/// stamps large ones.
const MOST_BYTES: usize = 32 << 20;

/// Local bases have about so many kernels.
const USUAL_KERNELS: usize = 4;

/// The number of arrays with the size of a whole transform in a workspace.
const WHOLE_PLANES: usize = 4;

/// Spreads stars and convolves the planes, for blocks of one size.
#[derive(Debug)]
pub(super) struct Spreader<T> {
    /// The columns and rows of a block.
    pub(super) side: usize,
    fft: TileTransform<T>,
    axes: [SpreadAxis; 2],
    layout: RowLayout,
    /// The number of taps along an axis.
    taps: usize,
    workspaces: Workspaces<Workspace<T>>,
}

/// One axis of the planes.
#[derive(Debug, Clone, Copy)]
struct SpreadAxis {
    oversampling: usize,
    /// The number of coefficients of the oversampled stamp.
    kept: usize,
    /// The first pixel of the planes, relative to the block's first pixel.
    first: i64,
    /// The number of pixels of the planes.
    length: usize,
    /// The number of coefficients of a residue.
    kernel: usize,
}

impl SpreadAxis {
    /// The plane's residue and pixel for a tap of a star. `start` is a pixel of the star, relative
    /// to the block's first pixel, and `coefficient` contributes to this pixel.
    #[inline(always)]
    fn place(&self, start: i64, coefficient: usize) -> (usize, usize) {
        let (q, residue) = (coefficient / self.oversampling, coefficient % self.oversampling);
        (residue, (start - q as i64 - self.first) as usize)
    }

    /// The number of pixels that the block's stars may light.
    fn lit(&self) -> usize {
        self.length + self.kernel - 1
    }
}

/// Memory of one thread.
#[derive(Debug)]
struct Workspace<T> {
    /// `[kernel, residue in y, residue in x]`. In f64, so that the sum of very many stars in one place loses
    /// no digits.
    planes: Aligned<f64>,
    /// A kernel, or the result.
    plane: Aligned<T>,
    kernel: Aligned<T>,
    spectrum: Aligned<T>,
    sum: Aligned<T>,
    column: Aligned<T>,
}

impl<T: ConvReal> Workspace<T> {
    fn new(fft: &TileTransform<T>, kernel: usize) -> Self {
        Self {
            planes: Aligned::default(),
            plane: Aligned::zeros(fft.plane_len()),
            kernel: Aligned::zeros(fft.along_y_len(kernel)),
            spectrum: Aligned::zeros(fft.spectrum_len()),
            sum: Aligned::zeros(fft.spectrum_len()),
            column: Aligned::zeros(fft.column_len()),
        }
    }
}

impl<T: ConvReal> Spreader<T> {
    pub(super) fn new(phased: &[PhasedAxis; 2], layout: RowLayout) -> Self {
        let axes = phased.each_ref().map(|axis| {
            let steps = axis.steps();
            SpreadAxis {
                oversampling: axis.oversampling,
                kept: axis.kept,
                first: -steps.end(),
                length: (steps.end() - steps.start()) as usize,
                kernel: axis.kept.div_ceil(axis.oversampling),
            }
        });
        // The transform's size is a fast one.
        let reach = axes.map(|axis| axis.lit()).into_iter().fold(0, usize::max);
        let side = fast_size(LEAST_SIDE + reach, Y_STEP) - reach;
        let axes = axes.map(|axis| SpreadAxis {
            length: axis.length + side,
            ..axis
        });
        let (nx, ny) = transform_size((axes[0].lit(), axes[1].lit()));
        Self {
            side,
            fft: TileTransform::new(nx, ny),
            axes,
            layout,
            taps: phased[0].kernel.tap_count(),
            workspaces: Workspaces::default(),
        }
    }

    /// The number of planes for each kernel.
    fn residues(&self) -> usize {
        self.axes[0].oversampling * self.axes[1].oversampling
    }

    /// The number of values of a plane.
    fn plane_len(&self) -> usize {
        self.axes[1].length * self.fft.pitch()
    }

    /// The columns (`axis` 0) or rows (1) of the frame that stars may light, if they lie in column or
    /// row `block` of the grid of blocks: the first, and their number.
    pub(super) fn lit(&self, axis: usize, block: i64) -> (i64, usize) {
        let axis = &self.axes[axis];
        (block * self.side as i64 + axis.first, axis.lit())
    }

    /// The numbers of colours along x and y. Stars of blocks that are so many columns or rows apart
    /// light different pixels.
    pub(super) fn colours(&self) -> [usize; 2] {
        self.axes.each_ref().map(|axis| axis.lit().div_ceil(self.side))
    }

    /// Returns whether it is faster to spread stars of these fluxes than to draw them one by one. `drawn` returns
    /// the part of its pixels on which a star is drawn.
    pub(super) fn pays(&self, fluxes: &[f64], drawn: impl Fn(&f64) -> f64, kernels: usize) -> bool {
        let Some((convolve, spread)) = self.seconds_to_spread(kernels) else {
            return false;
        };
        let (stars, whole) = (fluxes.len() as f64, self.seconds_to_draw(kernels));
        let draw = || fluxes.iter().map(|flux| whole * drawn(flux)).sum::<f64>();
        convolve < stars * whole && convolve + stars * spread < draw()
    }

    /// The seconds to draw a star on all its pixels.
    fn seconds_to_draw(&self, kernels: usize) -> f64 {
        let ([x, y], taps) = (&self.axes, self.taps);
        let products = x.kernel * y.kernel * taps * (x.oversampling.min(taps) * kernels + 1);
        CostModel::of::<T>().draw_star(products)
    }

    /// The seconds to convolve the planes of a block, and those to spread a star. `None` if the planes need too
    /// much memory.
    fn seconds_to_spread(&self, kernels: usize) -> Option<(f64, f64)> {
        let planes = kernels * self.residues();
        let sums = planes * self.plane_len() * size_of::<f64>();
        let bytes = sums + WHOLE_PLANES * self.fft.plane_len() * size_of::<T>();
        if planes == 0 || bytes > MOST_BYTES {
            return None;
        }
        let [x, y] = &self.axes;
        let (cost, size) = (CostModel::of::<T>(), transform_size((x.lit(), y.lit())));
        let convolve = cost.tile((x.length, y.length), size, planes as f64, 1)
            + planes as f64 * cost.kernel(size, (x.kernel, y.kernel));
        Some((convolve, cost.spread_star(self.taps * self.taps * kernels)))
    }

    /// The seconds that each of some stars takes on average, if so many of them lie in a block that has a usual
    /// number of kernels.
    pub(super) fn seconds_of_star(&self, stars_of_block: f64) -> f64 {
        let draw = self.seconds_to_draw(USUAL_KERNELS);
        let spread = self.seconds_to_spread(USUAL_KERNELS);
        spread.map_or(draw, |(convolve, spread)| {
            draw.min(convolve / stars_of_block + spread)
        })
    }

    /// Spreads groups of stars of a block, and adds their light to an image, whose first pixel is
    /// `origin`. `region` holds the block's pixels.
    pub(super) fn add_stars<S: Lanes<T>>(
        &self,
        simd: S,
        (block, region): (&StarBlock<T>, PixelRegion),
        groups: impl Iterator<Item = Result<Group<T>, ConvError>>,
        image: &mut ArrayViewMut2<'_, T>,
        origin: (i64, i64),
    ) -> Result<(), ConvError> {
        let kernels = block.modes.kernel_count();
        let workspace = || Workspace::new(&self.fft, self.axes[0].kernel);
        self.workspaces.lend(workspace, |w| {
            let length = kernels * self.residues() * self.plane_len();
            w.planes.at_least(length);
            w.planes.get_mut()[..length].fill(0.0);
            let corner = (region.x0(), region.y0());
            for group in groups {
                let planes = w.planes.get_mut();
                match self.taps {
                    4 => self.spread::<4>(&group?, corner, kernels, planes),
                    _ => self.spread::<MOST_TAPS>(&group?, corner, kernels, planes),
                }
            }
            vectorized!(simd, self.convolve(simd, block, w));
            let [x, y] = &self.axes;
            let shape = (y.lit(), x.lit()).strides((self.fft.pitch(), 1));
            let lit = ArrayView2::from_shape(shape, w.plane.get()).expect("the plane's size");
            let first = (corner.0 + x.first, corner.1 + y.first);
            add_values(lit, (first.0 - origin.0, first.1 - origin.1), image);
            Ok(())
        })
    }

    /// Adds the taps of stars to the planes. `corner` is the block's first pixel.
    fn spread<const TAPS: usize>(
        &self,
        group: &Group<T>,
        corner: (i64, i64),
        kernels: usize,
        planes: &mut [f64],
    ) {
        let ([x, y], pitch) = (&self.axes, self.fft.pitch());
        for star in &group.stars {
            let mut columns = [0; TAPS];
            for (tap, column) in columns.iter_mut().enumerate() {
                let (residue, pixel) = x.place(star.columns.start - corner.0, star.first_column + tap);
                *column = residue * self.plane_len() + pixel;
            }
            let weights = &group.weights[star.weights.clone()];
            for (tap, weights) in weights.chunks_exact(kernels).enumerate() {
                let (residue, row) = y.place(star.rows.start - corner.1, star.first_row + tap);
                for (kernel, &weight) in weights.iter().enumerate() {
                    let plane = (kernel * y.oversampling + residue) * x.oversampling;
                    let row = &mut planes[plane * self.plane_len() + row * pitch..];
                    for (&column, &tap) in columns.iter().zip(&star.taps) {
                        row[column] += (weight * tap).as_f64();
                    }
                }
            }
        }
    }

    /// Convolves the planes with the kernels and adds the results up, in `workspace.plane`.
    #[inline(always)]
    fn convolve<S: Lanes<T>>(&self, simd: S, block: &StarBlock<T>, w: &mut Workspace<T>) {
        let [x, y] = &self.axes;
        let pitch = self.fft.pitch();
        let count = block.modes.kernel_count() * self.residues();
        for number in 0..count {
            let (residue_x, rest) = (number % x.oversampling, number / x.oversampling);
            let (residue_y, kernel) = (rest % y.oversampling, rest / y.oversampling);
            let mut rows = 0;
            for (row, into) in (residue_y..y.kept)
                .step_by(y.oversampling)
                .zip(w.plane.get_mut().chunks_exact_mut(pitch))
            {
                let (coefficients, padding) =
                    into[..x.kernel.next_multiple_of(X_STEP)].split_at_mut(x.kernel);
                block.copy_residue(self.layout, (row, kernel), residue_x, coefficients);
                padding.fill(T::zero());
                rows += 1;
            }
            self.fft.forward_along_y(
                simd,
                self.fft.plane(w.plane.get()),
                (rows, x.kernel),
                w.kernel.get_mut(),
                x.kernel,
                w.column.get_mut(),
            );
            let length = self.plane_len();
            let summed = &w.planes.get()[number * length..(number + 1) * length];
            for (v, &sum) in w.plane.get_mut().iter_mut().zip(summed) {
                *v = T::nearest(sum);
            }
            self.fft.forward_multiply_swapped(
                simd,
                self.fft.plane(&w.plane.get()[..length]),
                (y.length, x.length),
                (w.kernel.get(), Some(x.kernel)),
                w.sum.get_mut(),
                number > 0,
                w.spectrum.get_mut(),
                w.column.get_mut(),
            );
        }
        self.fft.inverse_of_swapped(
            simd,
            w.sum.get_mut(),
            (y.lit(), x.lit()),
            w.plane.get_mut(),
            w.column.get_mut(),
        );
    }
}
