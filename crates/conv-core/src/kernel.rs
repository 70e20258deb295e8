//! Stamps as convolution kernels.

use ndarray::{Array2, ArrayView2};
use psf_types::StampGrid;
use rustfft::num_complex::Complex;

use crate::fft2::RealFft2;
use crate::{ConvError, ConvReal};

/// A stamp's extent around its central pixel: it reaches `left` columns to the left and `right` to the right, likewise
/// `below` (smaller row index) and `above`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Reach {
    pub(crate) left: usize,
    pub(crate) right: usize,
    pub(crate) below: usize,
    pub(crate) above: usize,
}

impl Reach {
    /// The reach of stamps that can convolve an image: at the frame's scale, centred on a pixel, pixel response included.
    pub(crate) fn of(grid: StampGrid) -> Result<Self, ConvError> {
        if grid.oversampling() != 1.0 {
            return Err(ConvError::StampScale {
                oversampling: grid.oversampling(),
            });
        }
        if !grid.pixel_response_included() {
            return Err(ConvError::PixelResponse);
        }
        let (cx, cy) = grid.whole_centre().ok_or(ConvError::StampCentre {
            x: grid.centre_x(),
            y: grid.centre_y(),
        })?;
        Ok(Self {
            left: cx,
            right: grid.nx() - 1 - cx,
            below: cy,
            above: grid.ny() - 1 - cy,
        })
    }
}

/// The row transforms of a stamp laid out for circular convolution: its central pixel at index (0, 0), what lies left and
/// below wrapped around. The columns' transforms are done where they are needed: only the stamp's own rows hold anything.
pub(crate) struct KernelRows<T> {
    /// `[spectral column, stamp row]`.
    transformed: Array2<Complex<T>>,
    below: usize,
}

impl<T: ConvReal> KernelRows<T> {
    /// The transforms of `stamp / fft.gain()`, so that a convolution needs no further normalisation.
    pub(crate) fn new(fft: &RealFft2<T>, stamp: ArrayView2<'_, f64>, reach: Reach) -> Self {
        let columns = fft.columns();
        let mut transformed = Array2::zeros((columns / 2 + 1, stamp.nrows()));
        let mut row = fft.row();
        for (j, values) in stamp.outer_iter().enumerate() {
            row.real.fill(T::zero());
            for (i, &value) in values.iter().enumerate() {
                // A stamp wider than the plane overlaps itself; the plane's size keeps the overlap off the result.
                row.real[(i + columns - reach.left) % columns] += T::nearest(value / fft.gain());
            }
            for (value, target) in fft.transform(&mut row).iter().zip(transformed.column_mut(j)) {
                *target = *value;
            }
        }
        Self {
            transformed,
            below: reach.below,
        }
    }

    /// Writes column `index` of the stamp's spectrum.
    pub(crate) fn column_into(
        &self,
        fft: &RealFft2<T>,
        index: usize,
        column: &mut [Complex<T>],
        scratch: &mut [Complex<T>],
    ) {
        let rows = fft.rows();
        column.fill(Complex::new(T::zero(), T::zero()));
        for (j, &value) in self.transformed.row(index).iter().enumerate() {
            column[(j + rows - self.below) % rows] += value;
        }
        fft.forward(column, scratch);
    }
}
