//! The exact double sum, with which every other method is compared.

use ndarray::{Array2, ArrayView2, ArrayView3, s};
use psf_types::{Anchor, FrameShape, Image, ImageView, PixelRegion, Progress, PsfModel};
use rayon::prelude::*;

use super::ConvolutionMethod;
use crate::overlap::{Piece, add_in_order, overlap};
use crate::view::{Reach, View};
use crate::{ConvError, ConvReal};

/// `F(y) = sum_x f(x) h(y - x; x)` or `sum_x f(x) h(y - x; y)`, summed in f64 pixel by pixel. The
/// [crate's page](crate) explains the symbols. Every other method is compared with this one.
///
/// A whole image costs `K` multiplications for each lit pixel and each pixel of a stamp.
/// [`Direct::at_pixels`] computes single pixels of a large image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Direct {
    anchor: Anchor,
}

/// The number of PSFs computed by one matrix product.
const PSFS_AT_ONCE: usize = 256;
/// The number of rows of sources per task.
const BAND: usize = 16;

impl Direct {
    /// The method with the given anchoring.
    pub fn new(anchor: Anchor) -> Self {
        Self { anchor }
    }

    /// Computes single pixels `(column, row)` of the image, in f64 for light of any precision.
    ///
    /// `shape` is the shape of the whole light, and `frame` is a region of it. `light` may be only
    /// a part of the whole light: an array, and the column and row of the array's first pixel. The
    /// part must hold all light that reaches the pixels. Each pixel is one step of the progress.
    ///
    /// # Errors
    /// [`ConvError`] as for [`ConvolutionMethod::convolve`], and [`ConvError::PixelOutsideFrame`].
    /// But a result that is not finite is no error here.
    #[inline(never)]
    pub fn at_pixels<T: ConvReal>(
        &self,
        model: &PsfModel,
        light: (ArrayView2<'_, T>, (usize, usize)),
        shape: FrameShape,
        frame: PixelRegion,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, ConvError> {
        progress.start(pixels.len() as u64);
        let view = View::new(shape, frame)?;
        if let Some(&(column, row)) = pixels
            .iter()
            .find(|(column, row)| *column >= frame.shape().nx() || *row >= frame.shape().ny())
        {
            return Err(ConvError::PixelOutsideFrame {
                column,
                row,
                frame: frame.shape(),
            });
        }
        let reach = Reach::of(model.grid())?;
        let sums: Vec<Result<f64, ConvError>> = pixels
            .par_iter()
            .map(|&pixel| {
                progress.check_cancelled()?;
                let sum = self.pixel(model, view, light, reach, pixel)?;
                progress.advance(1);
                Ok(sum)
            })
            .collect();
        sums.into_iter().collect()
    }

    fn pixel<T: ConvReal>(
        self,
        model: &PsfModel,
        view: View,
        (light, (first_column, first_row)): (ArrayView2<'_, T>, (usize, usize)),
        reach: Reach,
        (column, row): (usize, usize),
    ) -> Result<f64, ConvError> {
        let (field, first) = (view.field_region(), view.first_pixel());
        let (column, row) = (column + first.0, row + first.1);
        let stamps = model.stamps();
        let mut coefficients = vec![0.0; model.stamp_count()];
        if self.anchor == Anchor::Output {
            model.scaled_coefficients_into(field.position(column, row), &mut coefficients)?;
        }
        let mut sum = 0.0;
        // The loops add the light of the source at `pixel - u`, for every offset `u` of the stamp.
        for j in 0..stamps.dim().1 {
            let Some(y) = (row + reach.below)
                .checked_sub(j)
                .filter(|&y| y >= first_row && y - first_row < light.nrows())
            else {
                continue;
            };
            for i in 0..stamps.dim().2 {
                let Some(x) = (column + reach.left)
                    .checked_sub(i)
                    .filter(|&x| x >= first_column && x - first_column < light.ncols())
                else {
                    continue;
                };
                let flux = light[[y - first_row, x - first_column]].as_f64();
                if flux == 0.0 {
                    continue;
                }
                if self.anchor != Anchor::Output {
                    model.scaled_coefficients_into(field.position(x, y), &mut coefficients)?;
                }
                let h: f64 = coefficients
                    .iter()
                    .zip(stamps.slice(s![.., j, i]))
                    .map(|(a, b)| a * b)
                    .sum();
                sum += flux * h;
            }
        }
        Ok(sum)
    }

    fn scatter<T: ConvReal>(
        model: &PsfModel,
        view: View,
        light: ArrayView2<'_, T>,
        reach: Reach,
        progress: &dyn Progress,
        result: &mut Array2<f64>,
    ) -> Result<(), ConvError> {
        let (field, frame) = (view.field_region(), view.frame);
        let (ny, nx) = light.dim();
        let (height, width) = model.grid().dim();
        add_in_order(result.view_mut(), ny.div_ceil(BAND), progress, |band| {
            let rows = band * BAND..((band + 1) * BAND).min(ny);
            let lit: Vec<(usize, usize)> = rows
                .clone()
                .flat_map(|y| (0..nx).map(move |x| (x, y)))
                .filter(|&(x, y)| !light[[y, x]].is_zero())
                .collect();
            let mut values = Array2::<f64>::zeros((rows.len() + height - 1, nx + width - 1));
            for some in lit.chunks(PSFS_AT_ONCE) {
                progress.check_cancelled()?;
                let psfs = psfs(model, field, some)?;
                for (&(x, y), psf) in some.iter().zip(psfs.outer_iter()) {
                    let y_in_band = y - rows.start;
                    values
                        .slice_mut(s![y_in_band..y_in_band + height, x..x + width])
                        .scaled_add(light[[y, x]].as_f64(), &stamp_of(&psf, model));
                }
            }
            let first_column = -(reach.left as i64) - frame.x0();
            let first_row = rows.start as i64 - reach.below as i64 - frame.y0();
            Ok(if lit.is_empty() {
                Vec::new()
            } else {
                vec![Piece {
                    first_column,
                    first_row,
                    values,
                }]
            })
        })
    }

    fn gather<T: ConvReal>(
        model: &PsfModel,
        view: View,
        light: ArrayView2<'_, T>,
        reach: Reach,
        progress: &dyn Progress,
        result: &mut Array2<f64>,
    ) -> Result<(), ConvError> {
        let (field, frame) = (view.field_region(), view.frame);
        let nx = frame.shape().nx();
        // Finds the light under the mirrored stamp at a pixel of the scene: columns from x - right
        // to x + left, and rows from y - above to y + below.
        let under = |x: usize, y: usize| {
            let columns = overlap(x as i64 - reach.right as i64, model.grid().nx(), light.ncols())?;
            let rows = overlap(y as i64 - reach.above as i64, model.grid().ny(), light.nrows())?;
            Some((columns, rows))
        };
        progress.start(frame.shape().ny() as u64);
        let rows: Vec<Result<(), ConvError>> = result
            .as_slice_mut()
            .expect("row-major")
            .par_chunks_exact_mut(nx)
            .enumerate()
            .map(|(row, out)| {
                progress.check_cancelled()?;
                let y = row + frame.y0() as usize;
                let lit: Vec<(usize, usize)> = (0..nx)
                    .map(|column| (column + frame.x0() as usize, y))
                    .filter(|&(x, y)| {
                        under(x, y).is_some_and(|((_, x0, w), (_, y0, h))| {
                            light
                                .slice(s![y0..y0 + h, x0..x0 + w])
                                .iter()
                                .any(|v| !v.is_zero())
                        })
                    })
                    .collect();
                for some in lit.chunks(PSFS_AT_ONCE) {
                    progress.check_cancelled()?;
                    let psfs = psfs(model, field, some)?;
                    for (&(x, y), psf) in some.iter().zip(psfs.outer_iter()) {
                        let ((from_x, x0, w), (from_y, y0, h)) = under(x, y).expect("light reaches it");
                        let mirrored = stamp_of(&psf, model);
                        let mirrored = mirrored.slice(s![..;-1, ..;-1]);
                        let psf = mirrored.slice(s![from_y..from_y + h, from_x..from_x + w]);
                        let window = light.slice(s![y0..y0 + h, x0..x0 + w]);
                        out[x - frame.x0() as usize] =
                            psf.iter().zip(window).map(|(p, f)| p * f.as_f64()).sum();
                    }
                }
                progress.advance(1);
                Ok(())
            })
            .collect();
        rows.into_iter().collect()
    }
}

/// The PSFs at pixels `(x, y)` of the scene, `[psf, stamp pixel]`.
fn psfs(model: &PsfModel, field: PixelRegion, pixels: &[(usize, usize)]) -> Result<Array2<f64>, ConvError> {
    let count = model.stamp_count();
    let mut coefficients = Array2::zeros((pixels.len(), count));
    for (&(x, y), mut row) in pixels.iter().zip(coefficients.outer_iter_mut()) {
        model.scaled_coefficients_into(field.position(x, y), row.as_slice_mut().expect("row-major"))?;
    }
    let stamps: ArrayView3<'_, f64> = model.stamps();
    let flat = stamps
        .into_shape_with_order((count, model.grid().pixel_count()))
        .expect("row-major");
    Ok(coefficients.dot(&flat))
}

fn stamp_of<'a>(psf: &'a ndarray::ArrayView1<'_, f64>, model: &PsfModel) -> ArrayView2<'a, f64> {
    ArrayView2::from_shape(model.grid().dim(), psf.to_slice().expect("row-major")).expect("the grid's size")
}

impl<T: ConvReal> ConvolutionMethod<T> for Direct {
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
        let (view, light, reach) = View::within_reach(light, frame, model.grid())?;
        let mut result = Array2::zeros((frame.shape().ny(), frame.shape().nx()));
        match self.anchor {
            Anchor::Output => Self::gather(model, view, light, reach, progress, &mut result)?,
            _ => Self::scatter(model, view, light, reach, progress, &mut result)?,
        }
        Image::new(result.mapv(T::nearest)).map_err(ConvError::Result)
    }
}
