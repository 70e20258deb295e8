//! The method of Bai, Jia et al. in its original form: one whole-image convolution per basis stamp.

use std::ops::Range;

use ndarray::parallel::prelude::*;
use ndarray::{Array2, Array3, ArrayView2, ArrayViewMut3, Axis, s};
use psf_types::{
    Anchor, FieldError, FrameShape, Image, ImageView, NoProgress, PixelRegion, Progress, PsfModel,
};
use rustfft::num_complex::Complex;

use super::ConvolutionMethod;
use super::fft2::{KernelRows, RealFft2};
use crate::view::{Reach, View};
use crate::working_range::{Rescaling, take_back};
use crate::{ConvError, ConvReal};

/// `K` whole-image convolutions by FFT, exact up to rounding, and their exact adjoint.
///
/// `f` is the light, `F` the image, `B_k` a stamp of the model (1 to `K`), and `a_k` the stamp's
/// coefficient at each pixel.
///
/// - [`Anchor::Source`]: `F = sum_k (a_k f) * B_k`. The products are summed as spectra, so there is
///   only one inverse transform.
/// - [`Anchor::Output`]: `F = sum_k a_k (f * B_k)`. The spectrum of the scene is computed once.
///
/// This is the method of Bai, Jia et al. ("An Ultra-Fast Image Simulation Technique with Spatially
/// Variable PSFs"), for both anchorings. Unlike the paper, it does not store a cube of
/// coefficients: it evaluates coefficients tile by tile, for a few stamps at a time. Planes are
/// padded by the stamp's reach, so no light wraps around into the image. Memory holds the scene,
/// the image, two spectra and a group of coefficient planes. The group has as many planes as fit
/// into 512 MiB, but at least 4 and at most 16, and never more than `K`.
///
/// ```
/// use std::sync::Arc;
/// use conv_core::{BasisConvolution, ConvolutionMethod};
/// use ndarray::{Array2, Array3};
/// use psf_types::{
///     CoefficientField, FieldError, FrameShape, ImageView, NoProgress, Normalisation, Position,
///     PsfBasis, PsfModel, StampGrid,
/// };
///
/// #[derive(Debug)]
/// struct Constant;
/// impl CoefficientField for Constant {
///     fn component_count(&self) -> usize { 1 }
///     fn evaluate_into(&self, _: Position, a: &mut [f64]) -> Result<(), FieldError> {
///         a[0] = 1.0;
///         Ok(())
///     }
/// }
/// // A PSF that moves all light one pixel to the right.
/// let stamp = Array3::from_shape_vec((1, 1, 3), vec![0.0, 0.0, 1.0])?;
/// let basis = PsfBasis::new(None, stamp, StampGrid::new(3, 1)?)?;
/// let model = PsfModel::new(&basis, Arc::new(Constant), Normalisation::Keep, None)?;
/// let mut light = Array2::<f64>::zeros((4, 5));
/// light[[2, 1]] = 7.0;
/// let (light, frame) = (ImageView::new(light.view())?, FrameShape::new(5, 4)?.region());
/// let image = BasisConvolution::default().convolve(&model, &light, frame, &NoProgress)?;
/// assert!((image.pixels()[[2, 2]] - 7.0).abs() < 1e-14);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BasisConvolution {
    anchor: Anchor,
}

/// The approximate memory of the coefficient planes that are held at the same time.
const PLANE_BYTES: usize = 512 << 20;
/// The least number of coefficient planes held at the same time, even if they need more memory.
const FEWEST_PLANES: usize = 4;
/// The most coefficient planes held at the same time.
const MOST_PLANES: usize = 16;

impl BasisConvolution {
    /// The method with the given anchoring.
    pub fn new(anchor: Anchor) -> Self {
        Self { anchor }
    }

    /// The exact adjoint `A^T g` of the convolution `A f`. It maps an image `g` of the frame to a
    /// plane of the light's shape, `shape`, such that `<A f, g> = <f, A^T g>` for every light `f`.
    ///
    /// # Errors
    /// [`ConvError`] as for [`ConvolutionMethod::convolve`], and [`ConvError::FrameShape`] if
    /// `image` does not have the frame's shape.
    pub fn adjoint<T: ConvReal>(
        &self,
        model: &PsfModel,
        image: &ImageView<'_, T>,
        shape: FrameShape,
        frame: PixelRegion,
    ) -> Result<Image<T>, ConvError> {
        if image.shape() != frame.shape() {
            return Err(ConvError::FrameShape {
                expected: frame.shape(),
                got: image.shape(),
            });
        }
        let plane = Plane::new(model, View::new(shape, frame)?, true, &NoProgress)?;
        let (light, back) = Rescaling::of_pixels(image.pixels());
        let mut pixels = match self.anchor {
            Anchor::Output => plane.weight_then_convolve(frame, light.view(), shape.region())?,
            _ => plane.convolve_then_weight(frame, light.view(), shape.region())?,
        };
        take_back(&mut pixels, back);
        Image::new(pixels).map_err(ConvError::Result)
    }
}

impl<T: ConvReal> ConvolutionMethod<T> for BasisConvolution {
    fn anchor(&self) -> Anchor {
        self.anchor
    }

    #[inline(never)]
    fn convolve(
        &self,
        model: &PsfModel,
        light: &ImageView<'_, T>,
        frame: PixelRegion,
        progress: &dyn Progress,
    ) -> Result<Image<T>, ConvError> {
        let (view, light, _) = View::within_reach(light, frame, model.grid())?;
        let (light, back) = Rescaling::of_pixels(light);
        let whole = view.shape.region();
        let plane = Plane::new(model, view, false, progress)?;
        let mut pixels = match self.anchor {
            Anchor::Output => plane.convolve_then_weight(whole, light.view(), view.frame)?,
            _ => plane.weight_then_convolve(whole, light.view(), view.frame)?,
        };
        take_back(&mut pixels, back);
        Image::new(pixels).map_err(ConvError::Result)
    }
}

/// The padded plane of the light, in which all steps take place. Regions are in pixels of the
/// light.
struct Plane<'a, T: ConvReal> {
    model: &'a PsfModel,
    reach: Reach,
    fft: RealFft2<T>,
    /// Offset from pixels of the light to field positions.
    to_field: (i64, i64),
    /// True for correlation with the stamps instead of convolution (in the adjoint).
    correlate: bool,
    /// Counts one step per stamp.
    progress: &'a dyn Progress,
}

impl<'a, T: ConvReal> Plane<'a, T> {
    fn new(
        model: &'a PsfModel,
        view: View,
        correlate: bool,
        progress: &'a dyn Progress,
    ) -> Result<Self, ConvError> {
        progress.start(model.stamp_count() as u64);
        let reach = Reach::of(model.grid())?;
        let shape = view.shape;
        // The plane is large enough that light that wraps around its edges falls only on the
        // padding.
        let fft = RealFft2::at_least(
            shape.ny() + reach.below.max(reach.above),
            shape.nx() + reach.left.max(reach.right),
        );
        let field = view.field_region();
        Ok(Self {
            model,
            reach,
            fft,
            to_field: (field.x0(), field.y0()),
            correlate,
            progress,
        })
    }

    fn field(&self, region: PixelRegion) -> PixelRegion {
        region.shifted(self.to_field.0, self.to_field.1)
    }

    /// `sum_k (a_k light / s) * B_k` on the region `output`. `s` is the flux of the unscaled PSF,
    /// or 1 if PSFs are not scaled to unit flux.
    fn weight_then_convolve(
        &self,
        input: PixelRegion,
        light: ArrayView2<'_, T>,
        output: PixelRegion,
    ) -> Result<Array2<T>, ConvError> {
        let field = self.field(input);
        let scaled =
            flux_plane(self.model, field, Some(light), self.progress)?.map(|fluxes| &light / &fluxes);
        let light = scaled.as_ref().map_or(light, |scaled| scaled.view());
        let lit_rows = lit_rows(light);
        let (first_row, first_column) = (input.y0() as usize, input.x0() as usize);
        let mut work = self.fft.spectrum();
        let mut sum = self.fft.spectrum();
        self.each_stamp(field, Some(light), |plane, kernel| {
            self.fft.rows_forward(&mut work, |row, values| {
                let Some(row) = row
                    .checked_sub(first_row)
                    .filter(|&r| r < lit_rows.len() && lit_rows[r] && !self.progress.cancelled())
                else {
                    return false;
                };
                let weighted = plane
                    .row(row)
                    .into_iter()
                    .zip(light.row(row))
                    .map(|(&a, &f)| a * f);
                values[first_column..]
                    .iter_mut()
                    .zip(weighted)
                    .for_each(|(value, w)| *value = w);
                true
            });
            let weighted = &work;
            self.fft.for_columns(&mut sum, |column| {
                if self.progress.cancelled() {
                    return;
                }
                let [light, stamp] = column.spare;
                light.copy_from_slice(weighted.row(column.index).to_slice().expect("row-major"));
                self.fft.forward(light, column.scratch);
                kernel.column_into(&self.fft, column.index, stamp, column.scratch);
                for ((sum, &f), &b) in column.values.iter_mut().zip(&*light).zip(&*stamp) {
                    *sum += f * self.conjugate(b);
                }
            });
        })?;
        self.fft
            .for_columns(&mut sum, |column| self.fft.inverse(column.values, column.scratch));
        let (first_row, first_column) = (output.y0() as usize, output.x0() as usize);
        let mut result = Array2::zeros((output.shape().ny(), output.shape().nx()));
        self.fft
            .rows_inverse(&sum, first_row, result.view_mut(), |_, out, values| {
                out.copy_from_slice(&values[first_column..first_column + out.len()]);
            });
        Ok(result)
    }

    /// `(1 / s) sum_k a_k (light * B_k)` on the region `output`. `s` is the flux of the unscaled
    /// PSF, or 1 if PSFs are not scaled to unit flux.
    fn convolve_then_weight(
        &self,
        input: PixelRegion,
        light: ArrayView2<'_, T>,
        output: PixelRegion,
    ) -> Result<Array2<T>, ConvError> {
        let field = self.field(output);
        let lit_rows = lit_rows(light);
        let (first_row, first_column) = (input.y0() as usize, input.x0() as usize);
        let mut spectrum = self.fft.spectrum();
        self.fft.rows_forward(&mut spectrum, |row, values| {
            let Some(row) = row
                .checked_sub(first_row)
                .filter(|&r| r < lit_rows.len() && lit_rows[r])
            else {
                return false;
            };
            values[first_column..]
                .iter_mut()
                .zip(light.row(row))
                .for_each(|(value, &f)| *value = f);
            true
        });
        self.fft.for_columns(&mut spectrum, |column| {
            self.fft.forward(column.values, column.scratch);
        });

        let (first_row, first_column) = (output.y0() as usize, output.x0() as usize);
        let mut result = Array2::zeros((output.shape().ny(), output.shape().nx()));
        let mut work = self.fft.spectrum();
        self.each_stamp(field, None, |plane, kernel| {
            self.fft.for_columns(&mut work, |column| {
                if self.progress.cancelled() {
                    return;
                }
                let [stamp, _] = column.spare;
                kernel.column_into(&self.fft, column.index, stamp, column.scratch);
                let light = spectrum.row(column.index);
                for ((value, &f), &b) in column.values.iter_mut().zip(light).zip(&*stamp) {
                    *value = f * self.conjugate(b);
                }
                self.fft.inverse(column.values, column.scratch);
            });
            self.fft
                .rows_inverse(&work, first_row, result.view_mut(), |row, out, values| {
                    for ((out, &a), &v) in out.iter_mut().zip(plane.row(row)).zip(&values[first_column..]) {
                        *out += a * v;
                    }
                });
        })?;
        if let Some(fluxes) = flux_plane(self.model, field, None, self.progress)? {
            result /= &fluxes;
        }
        Ok(result)
    }

    fn conjugate(&self, value: Complex<T>) -> Complex<T> {
        if self.correlate { value.conj() } else { value }
    }

    /// Calls `work` for each stamp, with the stamp's coefficients over a region of the field and
    /// the stamp's kernel. Each stamp is a step of the progress. After a cancellation the results
    /// of `work` are not used.
    fn each_stamp(
        &self,
        field: PixelRegion,
        light: Option<ArrayView2<'_, T>>,
        mut work: impl FnMut(ArrayView2<'_, T>, &KernelRows<T>),
    ) -> Result<(), ConvError> {
        let (shape, stamps) = (field.shape(), self.model.stamp_count());
        let bytes = shape.pixel_count() * size_of::<T>();
        let at_once = (PLANE_BYTES / bytes)
            .clamp(FEWEST_PLANES, MOST_PLANES)
            .min(stamps);
        let mut planes = Array3::zeros((at_once, shape.ny(), shape.nx()));
        for first in (0..stamps).step_by(at_once) {
            let group = first..(first + at_once).min(stamps);
            let mut planes = planes.slice_mut(s![..group.len(), .., ..]);
            let into = planes.view_mut();
            coefficient_planes(self.model, field, group.clone(), light, into, self.progress)?;
            for (plane, stamp) in planes.outer_iter().zip(group) {
                let kernel = KernelRows::new(&self.fft, self.model.stamp(stamp), self.reach);
                work(plane, &kernel);
                self.progress.check_cancelled()?;
                self.progress.advance(1);
            }
        }
        Ok(())
    }
}

fn lit_rows<T: ConvReal>(light: ArrayView2<'_, T>) -> Vec<bool> {
    light
        .axis_iter(Axis(0))
        .map(|row| row.iter().any(|v| !v.is_zero()))
        .collect()
}

/// Tiles of this many rows and columns are evaluated together: the coefficients of a few stamps in
/// one tile fit in the L2 cache.
const TILE_ROWS: usize = 16;
const TILE_COLUMNS: usize = 256;

/// Writes the coefficients of a range of stamps over a region, `[stamp, y, x]`, before the division
/// by the flux.
///
/// If `light` is given, dark tiles are left unchanged, and a missing PSF is an error only at lit
/// pixels.
pub(crate) fn coefficient_planes<T: ConvReal>(
    model: &PsfModel,
    region: PixelRegion,
    stamps: Range<usize>,
    light: Option<ArrayView2<'_, T>>,
    planes: ArrayViewMut3<'_, T>,
    progress: &dyn Progress,
) -> Result<(), ConvError> {
    for_tiles(region, light, planes, progress, |tile, values| {
        model.coefficients_region_into(tile, stamps.clone(), values.view_mut())
    })
}

/// The flux of the unscaled PSF at each pixel of a region. `None` if the model needs no division by
/// it.
///
/// If `light` is given, the values in dark tiles are 1, and a PSF that is missing or has no positive
/// flux is an error only at lit pixels.
pub(crate) fn flux_plane<T: ConvReal>(
    model: &PsfModel,
    region: PixelRegion,
    light: Option<ArrayView2<'_, T>>,
    progress: &dyn Progress,
) -> Result<Option<Array2<T>>, ConvError> {
    if !model.needs_flux_scaling() {
        return Ok(None);
    }
    let shape = region.shape();
    let mut plane = Array3::ones((1, shape.ny(), shape.nx()));
    for_tiles(region, light, plane.view_mut(), progress, |tile, values| {
        model.flux_region_into(tile, values.index_axis_mut(Axis(0), 0))
    })?;
    Ok(Some(plane.index_axis_move(Axis(0), 0)))
}

fn region_of(whole: PixelRegion, x: usize, y: usize, nx: usize, ny: usize) -> PixelRegion {
    let shape = FrameShape::new(nx, ny).expect("parts of a region are not empty");
    PixelRegion::new(whole.x0() + x as i64, whole.y0() + y as i64, shape)
}

/// Calls `evaluate` for tiles in parallel, and stores the values in `planes` `[plane, y, x]`. Skips
/// dark tiles if `light` is given.
fn for_tiles<T: ConvReal>(
    region: PixelRegion,
    light: Option<ArrayView2<'_, T>>,
    mut planes: ArrayViewMut3<'_, T>,
    progress: &dyn Progress,
    evaluate: impl Fn(PixelRegion, &mut Array3<f64>) -> Result<(), FieldError> + Sync,
) -> Result<(), ConvError> {
    let (count, _, nx) = planes.dim();
    let strip_work = |strip: usize, mut planes: ArrayViewMut3<'_, T>| {
        progress.check_cancelled()?;
        let (y, rows) = (strip * TILE_ROWS, planes.dim().1);
        for x in (0..nx).step_by(TILE_COLUMNS) {
            let columns = TILE_COLUMNS.min(nx - x);
            if light.is_some_and(|f| {
                f.slice(s![y..y + rows, x..x + columns])
                    .iter()
                    .all(rustfft::num_traits::Zero::is_zero)
            }) {
                continue;
            }
            let tile = region_of(region, x, y, columns, rows);
            let mut values = Array3::zeros((count, rows, columns));
            if let Err(error) = evaluate(tile, &mut values) {
                // If the field lacks values only at dark pixels, that is no error. So each lit
                // pixel is evaluated separately.
                let Some(light) = light else {
                    return Err(error.into());
                };
                values = planes.slice(s![.., .., x..x + columns]).mapv(T::as_f64);
                let lit = light.slice(s![y..y + rows, x..x + columns]);
                for ((j, i), _) in lit.indexed_iter().filter(|(_, v)| !v.is_zero()) {
                    let mut pixel = Array3::zeros((count, 1, 1));
                    evaluate(region_of(tile, i, j, 1, 1), &mut pixel)?;
                    values.slice_mut(s![.., j..=j, i..=i]).assign(&pixel);
                }
            }
            planes
                .slice_mut(s![.., .., x..x + columns])
                .zip_mut_with(&values, |p, &v| *p = T::nearest(v));
        }
        Ok(())
    };
    let strips: Vec<Result<(), ConvError>> = planes
        .axis_chunks_iter_mut(Axis(1), TILE_ROWS)
        .into_par_iter()
        .enumerate()
        .map(|(strip, planes)| strip_work(strip, planes))
        .collect();
    // `collect` returns the error of the first strip that has one, not the error that occurred
    // first.
    strips.into_iter().collect()
}
