//! The method of Bai, Jia et al. in its original form: one whole-image convolution per basis stamp.

use ndarray::parallel::prelude::*;
use ndarray::{Array2, Array3, ArrayView2, ArrayViewMut3, Axis, CowArray, Zip, s};
use psf_types::{
    Anchor, FieldError, FrameShape, Image, ImageView, NoProgress, PixelRegion, Progress, PsfModel,
};
use rustfft::num_traits::Zero;

use super::ConvolutionMethod;
use crate::fft2::RealFft2;
use crate::image_memory::check_shape;
use crate::view::{self, Reach, View};
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
/// the image, two or three spectra and a group of coefficient planes. The group has as many planes as fit
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
        check_shape(frame.shape(), image.pixels().dim())?;
        let view = View::new(shape, frame)?;
        let (weights_first, input, output) = (self.anchor == Anchor::Output, frame, shape.region());
        let plane = Plane::new(model, view, true, &NoProgress)?;
        plane.convolve(weights_first, (image.pixels(), input), output)
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
        let (weights_first, input, output) = (self.anchor != Anchor::Output, view.shape.region(), view.frame);
        let plane = Plane::new(model, view, false, progress)?;
        plane.convolve(weights_first, (light, input), output)
    }
}

/// The padded plane of the light, in which all steps take place. Regions are in pixels of the
/// light.
struct Plane<'a, T: ConvReal> {
    model: &'a PsfModel,
    reach: Reach,
    fft: RealFft2<'a, T>,
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
        // The plane is large enough that light that wraps around its edges falls only on the
        // padding.
        let fft = RealFft2::at_least(
            view.shape.ny() + reach.below.max(reach.above),
            view.shape.nx() + reach.left.max(reach.right),
            progress,
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

    /// Convolves the light in the region `input`. `s` is the flux of the unscaled PSF, or 1 if PSFs
    /// are not scaled to unit flux.
    ///
    /// - If `weights_first` is true: `sum_k (a_k light / s) * B_k` on the region `output`.
    /// - Otherwise: `(1 / s) sum_k a_k (light * B_k)` on this region.
    fn convolve(
        &self,
        weights_first: bool,
        (light, input): (ArrayView2<'_, T>, PixelRegion),
        output: PixelRegion,
    ) -> Result<Image<T>, ConvError> {
        let (light, back) = Rescaling::of_pixels(light);
        let corner = |region: PixelRegion| (region.x0() as usize, region.y0() as usize);
        let (from, to) = (corner(input), corner(output));
        let shape = (output.shape().ny(), output.shape().nx());
        let [mut work, mut kernel] = [self.fft.zeros(), self.fft.zeros()];
        let mut result = if weights_first {
            let field = input.shifted(self.to_field.0, self.to_field.1);
            let fluxes = flux_plane(self.model, field, Some(light.view()), self.progress)?;
            let light = fluxes.map_or(light.view().into(), |fluxes| CowArray::from(&light / &fluxes));
            let mut sum = self.fft.zeros();
            self.each_stamp(field, Some(light.view()), |weights, stamp, reach| {
                self.fft.forward((&weights * &light).view(), from, &mut work);
                self.fft.kernel(stamp, reach, &mut kernel);
                Zip::from(&mut sum)
                    .and(&work)
                    .and(&kernel)
                    .par_for_each(|sum, &f, &b| *sum += f * b);
                Ok(())
            })?;
            self.fft.inverse(&mut sum, to, shape)?
        } else {
            let field = output.shifted(self.to_field.0, self.to_field.1);
            self.fft.forward(light.view(), from, &mut work);
            let mut sum = Array2::zeros(shape);
            self.each_stamp(field, None, |weights, stamp, reach| {
                self.fft.kernel(stamp, reach, &mut kernel);
                Zip::from(&mut kernel).and(&work).par_for_each(|b, &f| *b *= f);
                let convolved = self.fft.inverse(&mut kernel, to, shape)?;
                Zip::from(&mut sum)
                    .and(weights)
                    .and(&convolved)
                    .par_for_each(|sum, &a, &v| *sum += a * v);
                Ok(())
            })?;
            if let Some(fluxes) = flux_plane(self.model, field, None, self.progress)? {
                sum /= &fluxes;
            }
            sum
        };
        take_back(&mut result, back);
        Image::new(result).map_err(ConvError::Result)
    }

    /// Calls `work` for each stamp, with the stamp's coefficients over a region of the field, the
    /// stamp and its reach. Each stamp is a step of the progress.
    fn each_stamp(
        &self,
        field: PixelRegion,
        light: Option<ArrayView2<'_, T>>,
        mut work: impl FnMut(ArrayView2<'_, T>, ArrayView2<'_, f64>, Reach) -> Result<(), ConvError>,
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
            for_tiles(field, light, planes.view_mut(), self.progress, |tile, values| {
                self.model
                    .coefficients_region_into(tile, group.clone(), values.view_mut())
            })?;
            for (plane, index) in planes.outer_iter().zip(group) {
                let stamp = self.model.stamp(index);
                if self.correlate {
                    work(plane, stamp.slice(s![..;-1, ..;-1]), self.reach.turned())?;
                } else {
                    work(plane, stamp, self.reach)?;
                }
                self.progress.check_cancelled()?;
                self.progress.advance(1);
            }
        }
        Ok(())
    }
}

/// Tiles of this many rows and columns are evaluated together: the coefficients of a few stamps in
/// one tile fit in the L2 cache.
const TILE_ROWS: usize = 16;
const TILE_COLUMNS: usize = 256;

/// The flux of the unscaled PSF at each pixel of a region. `None` if the model needs no division by
/// it.
///
/// If `light` is given, the values in dark tiles are 1, and a PSF that is missing or has no positive
/// flux is an error only at lit pixels.
fn flux_plane<T: ConvReal>(
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

/// Calls `evaluate` for tiles in parallel, and stores the values in `planes` `[plane, y, x]`. If
/// `light` is given, leaves dark tiles unchanged, and a missing PSF is an error only at lit pixels.
fn for_tiles<T: ConvReal>(
    region: PixelRegion,
    light: Option<ArrayView2<'_, T>>,
    mut planes: ArrayViewMut3<'_, T>,
    progress: &dyn Progress,
    evaluate: impl Fn(PixelRegion, &mut Array3<f64>) -> Result<(), FieldError> + Sync,
) -> Result<(), ConvError> {
    let tile_work = |x: usize, y: usize, mut planes: ArrayViewMut3<'_, T>| -> Result<(), ConvError> {
        let (count, rows, columns) = planes.dim();
        let light = light.map(|light| light.slice_move(s![y..y + rows, x..x + columns]));
        if light.is_some_and(|light| light.iter().all(Zero::is_zero)) {
            return Ok(());
        }
        let part = |x: usize, y: usize, nx, ny| {
            view::region(region.x0() + x as i64, region.y0() + y as i64, (nx, ny))
        };
        let mut values = Array3::zeros((count, rows, columns));
        if let Err(error) = evaluate(part(x, y, columns, rows), &mut values) {
            // If the field lacks values only at dark pixels, that is no error. So each lit pixel is
            // evaluated separately.
            let light = light.ok_or(error)?;
            values = planes.mapv(T::as_f64);
            for ((j, i), _) in light.indexed_iter().filter(|(_, v)| !v.is_zero()) {
                let mut pixel = Array3::zeros((count, 1, 1));
                evaluate(part(x + i, y + j, 1, 1), &mut pixel)?;
                values.slice_mut(s![.., j..=j, i..=i]).assign(&pixel);
            }
        }
        planes.zip_mut_with(&values, |p, &v| *p = T::nearest(v));
        Ok(())
    };
    let strips: Vec<Result<(), ConvError>> = planes
        .axis_chunks_iter_mut(Axis(1), TILE_ROWS)
        .into_par_iter()
        .enumerate()
        .map(|(strip, mut planes)| {
            progress.check_cancelled()?;
            let mut tiles = planes.axis_chunks_iter_mut(Axis(2), TILE_COLUMNS).enumerate();
            tiles.try_for_each(|(tile, planes)| tile_work(tile * TILE_COLUMNS, strip * TILE_ROWS, planes))
        })
        .collect();
    // `collect` returns the error of the first strip that has one, not the error that occurred
    // first.
    strips.into_iter().collect()
}
