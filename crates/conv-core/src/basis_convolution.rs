//! The method's own form: one whole-image convolution a basis stamp.

use ndarray::{Array2, Array3, ArrayView2, Axis};
use psf_types::{Anchor, FrameShape, Image, NoProgress, PixelRegion, Progress, PsfModel, Scene};
use rustfft::num_complex::Complex;

use crate::crop::within_reach;
use crate::fft2::RealFft2;
use crate::kernel::{KernelRows, Reach};
use crate::planes::{coefficient_planes, flux_plane};
use crate::point_sources::add_point_sources_with_progress;
use crate::working_range::{Rescaling, take_back};
use crate::{ConvError, ConvReal, ConvolutionMethod};

/// `K` whole-image convolutions by FFT, exact up to rounding, and their exact adjoint.
///
/// * [`Anchor::Source`]: `F = sum_k (a_k f) * B_k`. The products are added up as spectra, so there is one inverse transform.
/// * [`Anchor::Output`]: `F = sum_k a_k (f * B_k)`. The spectrum of the scene is computed once.
///
/// The method of Bai, Jia et al. ("An Ultra-Fast Image Simulation Technique with Spatially Variable PSFs"), in either
/// anchoring and without their coefficient cube: fields are evaluated tile by tile, a few stamps at a time. Planes are
/// padded by the stamp's reach, so nothing wraps around. In memory at once: the scene, two or three spectra and a group of
/// coefficient planes (at least 4, at most 16, about 512 MiB).
///
/// ```
/// use std::sync::Arc;
/// use conv_core::{BasisConvolution, ConvolutionMethod};
/// use ndarray::{Array2, Array3};
/// use psf_types::{CoefficientField, FieldError, Image, Normalisation, Position, PsfBasis, PsfModel, Scene, StampGrid};
///
/// #[derive(Debug)]
/// struct Constant;
/// impl CoefficientField for Constant {
///     fn component_count(&self) -> usize { 1 }
///     fn evaluate_into(&self, _: Position, a: &mut [f64]) -> Result<(), FieldError> { a[0] = 1.0; Ok(()) }
/// }
/// // A PSF that moves all light one pixel to the right.
/// let stamp = Array3::from_shape_vec((1, 1, 3), vec![0.0, 0.0, 1.0])?;
/// let basis = PsfBasis::new(None, stamp, StampGrid::new(3, 1)?)?;
/// let model = PsfModel::new(&basis, Arc::new(Constant), Normalisation::Keep, None)?;
/// let mut scene = Array2::<f64>::zeros((4, 5));
/// scene[[2, 1]] = 7.0;
/// let image = BasisConvolution::default().convolve(&model, &Scene::from_image(Image::new(scene)?))?;
/// assert!((image.pixels()[[2, 2]] - 7.0).abs() < 1e-14);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BasisConvolution {
    anchor: Anchor,
}

/// Coefficient planes in memory at once take about this much, within the bounds below.
const PLANE_BYTES: usize = 512 << 20;
const FEWEST_PLANES: usize = 4;
const MOST_PLANES: usize = 16;

impl BasisConvolution {
    /// The method with the given anchoring.
    pub fn new(anchor: Anchor) -> Self {
        Self { anchor }
    }

    /// The exact adjoint `A^T g`: from an image on the frame to a plane of the scene's shape, such that
    /// `<A f, g> = <f, A^T g>` for every scene image `f` without point sources.
    ///
    /// # Errors
    /// [`ConvError`] as for [`ConvolutionMethod::convolve`]; [`ConvError::FrameShape`] when `image` does not have the
    /// frame's shape.
    pub fn adjoint<T: ConvReal>(
        &self,
        model: &PsfModel,
        image: &Image<T>,
        scene: &Scene<T>,
    ) -> Result<Image<T>, ConvError> {
        let frame = scene.frame();
        if image.shape() != frame.shape() {
            return Err(ConvError::FrameShape {
                expected: frame.shape(),
                got: image.shape(),
            });
        }
        let whole = scene.shape().region();
        let plane = Plane::new(model, scene, true, &NoProgress)?;
        let (light, back) = Rescaling::of_pixels(image.pixels());
        let mut pixels = match self.anchor {
            Anchor::Output => plane.weight_then_convolve(frame, light.view(), whole)?,
            _ => plane.convolve_then_weight(frame, light.view(), whole)?,
        };
        take_back(&mut pixels, back);
        Image::new(pixels).map_err(ConvError::Result)
    }
}

impl<T: ConvReal> ConvolutionMethod<T> for BasisConvolution {
    fn convolve(&self, model: &PsfModel, scene: &Scene<T>) -> Result<Image<T>, ConvError> {
        self.convolve_with_progress(model, scene, &NoProgress)
    }

    fn convolve_with_progress(
        &self,
        model: &PsfModel,
        scene: &Scene<T>,
        progress: &dyn Progress,
    ) -> Result<Image<T>, ConvError> {
        let frame = scene.frame();
        let mut pixels = if scene.image().is_some() {
            let scene = within_reach(scene, Reach::of(model.grid())?);
            let (light, back) = Rescaling::of_pixels(scene.pixels().expect("it had an image"));
            let light = light.view();
            let (whole, frame) = (scene.shape().region(), scene.frame());
            let plane = Plane::new(model, &scene, false, progress)?;
            let mut pixels = match self.anchor {
                Anchor::Output => plane.convolve_then_weight(whole, light, frame)?,
                _ => plane.weight_then_convolve(whole, light, frame)?,
            };
            take_back(&mut pixels, back);
            pixels
        } else {
            Array2::zeros((frame.shape().ny(), frame.shape().nx()))
        };
        add_point_sources_with_progress(model, scene, self.anchor, &mut pixels, progress)?;
        Image::new(pixels).map_err(ConvError::Result)
    }
}

/// The padded plane of a scene, on which everything happens. Regions are in pixels of the scene.
struct Plane<'a, T: ConvReal> {
    model: &'a PsfModel,
    reach: Reach,
    fft: RealFft2<T>,
    /// From pixels of the scene to field positions.
    to_field: (i64, i64),
    /// Correlate instead of convolve.
    correlate: bool,
    /// One step a stamp.
    progress: &'a dyn Progress,
}

impl<'a, T: ConvReal> Plane<'a, T> {
    fn new(
        model: &'a PsfModel,
        scene: &Scene<T>,
        correlate: bool,
        progress: &'a dyn Progress,
    ) -> Result<Self, ConvError> {
        progress.start(model.stamp_count() as u64);
        let reach = Reach::of(model.grid())?;
        let shape = scene.shape();
        // The difference of two positions in the scene never meets a wrapped stamp value.
        let fft = RealFft2::at_least(
            shape.ny() + reach.below.max(reach.above),
            shape.nx() + reach.left.max(reach.right),
        );
        let field = scene.field_region();
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

    /// `sum_k (a_k / s light) * B_k`, on the region `output`.
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
        let mut planes = self.planes(input.shape());
        for group in groups(self.model.stamp_count(), planes.dim().0) {
            let mut planes = planes.slice_mut(ndarray::s![..group.len(), .., ..]);
            let into = planes.view_mut();
            coefficient_planes(self.model, field, group.clone(), Some(light), into, self.progress)?;
            for (plane, stamp) in planes.outer_iter().zip(group) {
                let kernel = KernelRows::new(&self.fft, self.model.stamp(stamp), self.reach);
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
                // What was skipped is not looked at.
                self.progress.still_wanted()?;
                self.progress.advance(1);
            }
        }
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

    /// `1 / s sum_k a_k (light * B_k)`, on the region `output`.
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
        let mut planes = self.planes(output.shape());
        for group in groups(self.model.stamp_count(), planes.dim().0) {
            let mut planes = planes.slice_mut(ndarray::s![..group.len(), .., ..]);
            let into = planes.view_mut();
            coefficient_planes(self.model, field, group.clone(), None, into, self.progress)?;
            for (plane, stamp) in planes.outer_iter().zip(group) {
                let kernel = KernelRows::new(&self.fft, self.model.stamp(stamp), self.reach);
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
                        for ((out, &a), &v) in out.iter_mut().zip(plane.row(row)).zip(&values[first_column..])
                        {
                            *out += a * v;
                        }
                    });
                // What was skipped is not looked at.
                self.progress.still_wanted()?;
                self.progress.advance(1);
            }
        }
        if let Some(fluxes) = flux_plane(self.model, field, None, self.progress)? {
            result /= &fluxes;
        }
        Ok(result)
    }

    fn conjugate(&self, value: Complex<T>) -> Complex<T> {
        if self.correlate { value.conj() } else { value }
    }

    fn planes(&self, shape: FrameShape) -> Array3<T> {
        let bytes = shape.pixel_count() * size_of::<T>();
        let count = (PLANE_BYTES / bytes)
            .clamp(FEWEST_PLANES, MOST_PLANES)
            .min(self.model.stamp_count());
        Array3::zeros((count, shape.ny(), shape.nx()))
    }
}

fn groups(count: usize, size: usize) -> impl Iterator<Item = std::ops::Range<usize>> {
    (0..count)
        .step_by(size)
        .map(move |first| first..(first + size).min(count))
}

fn lit_rows<T: ConvReal>(light: ArrayView2<'_, T>) -> Vec<bool> {
    light
        .axis_iter(Axis(0))
        .map(|row| row.iter().any(|v| !v.is_zero()))
        .collect()
}
