//! The exact double sum, with which every other method is compared.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::ops::Range;

use ndarray::{Array2, ArrayView2, s};
use psf_types::{Anchor, FrameShape, Image, ImageView, PixelRegion, Progress, PsfModel, StampGrid};
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
/// The largest number of coefficients that a block of compared pixels keeps: 32 MiB.
const SHARED: usize = 1 << 22;

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
        // Pixels that lie close together share the PSFs of the light around them.
        let side = block_side(model);
        let block = |pixel: usize| (pixels[pixel].1 / side, pixels[pixel].0 / side);
        let mut order: Vec<usize> = (0..pixels.len()).collect();
        order.sort_by_key(|&pixel| block(pixel));
        let blocks: Vec<&[usize]> = order.chunk_by(|&a, &b| block(a) == block(b)).collect();
        let of_blocks: Vec<Result<Vec<f64>, ConvError>> = blocks
            .par_iter()
            .map(|block| {
                let mut psfs = KnownPsfs::new(model, view.field_region());
                let sums = block.iter().map(|&pixel| {
                    progress.check_cancelled()?;
                    let sum = self.pixel(&mut psfs, view.first_pixel(), light, reach, pixels[pixel])?;
                    progress.advance(1);
                    Ok(sum)
                });
                sums.collect()
            })
            .collect();
        let mut sums = vec![0.0; pixels.len()];
        for (block, of_block) in blocks.iter().zip(of_blocks) {
            for (&pixel, sum) in block.iter().zip(of_block?) {
                sums[pixel] = sum;
            }
        }
        Ok(sums)
    }

    /// A pixel of the frame, whose first pixel in the scene is `first`.
    fn pixel<T: ConvReal>(
        self,
        psfs: &mut KnownPsfs<'_>,
        first: (usize, usize),
        (light, (first_column, first_row)): (ArrayView2<'_, T>, (usize, usize)),
        reach: Reach,
        (column, row): (usize, usize),
    ) -> Result<f64, ConvError> {
        let model = psfs.model;
        let (column, row) = (column + first.0, row + first.1);
        let in_light = (column as i64 - first_column as i64, row as i64 - first_row as i64);
        let Some([(from_columns, columns), (from_rows, rows)]) =
            under(in_light, reach, model.grid(), light.dim())
        else {
            return Ok(0.0);
        };
        let stamps = model.stamps().slice_move(s![.., ..;-1, ..;-1]);
        let stamps = stamps.slice_move(s![.., from_rows, from_columns]);
        let of_output = match self.anchor {
            Anchor::Output => Some(psfs.coefficients(column, row)?.to_vec()),
            _ => None,
        };
        let mut sum = 0.0;
        let (first_column, first_row) = (first_column + columns.start, first_row + rows.start);
        let light = light.slice(s![rows, columns]);
        for ((j, i), flux) in light.indexed_iter().filter(|(_, flux)| !flux.is_zero()) {
            let coefficients = match &of_output {
                Some(coefficients) => coefficients,
                None => psfs.coefficients(first_column + i, first_row + j)?,
            };
            let values = stamps.slice(s![.., j, i]);
            let h: f64 = coefficients.iter().zip(values).map(|(a, b)| a * b).sum();
            sum += flux.as_f64() * h;
        }
        Ok(sum)
    }
}

/// The coefficients of the PSFs at pixels of the scene. Each is computed once.
struct KnownPsfs<'a> {
    model: &'a PsfModel,
    field: PixelRegion,
    known: HashMap<(usize, usize), Box<[f64]>>,
}

impl<'a> KnownPsfs<'a> {
    fn new(model: &'a PsfModel, field: PixelRegion) -> Self {
        let known = HashMap::new();
        Self { model, field, known }
    }

    fn coefficients(&mut self, column: usize, row: usize) -> Result<&[f64], ConvError> {
        Ok(match self.known.entry((column, row)) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => {
                let mut coefficients = vec![0.0; self.model.stamp_count()].into_boxed_slice();
                let at = self.field.position(column, row);
                self.model.scaled_coefficients_into(at, &mut coefficients)?;
                new.insert(coefficients)
            }
        })
    }
}

/// The side of blocks of pixels that share the PSFs of the light around them, so that their coefficients fit
/// into [`SHARED`] numbers.
fn block_side(model: &PsfModel) -> usize {
    let (ny, nx) = model.grid().dim();
    let with_margin = (SHARED / model.stamp_count().max(1)).isqrt();
    with_margin.saturating_sub(ny.max(nx)).max(1)
}

/// Finds the light under the stamp turned around a pixel, in an array of light with `(ny, nx)`
/// pixels. For x and for y, returns the range of stamp pixels and the range of light. `None` if
/// there is no light.
fn under(
    (x, y): (i64, i64),
    reach: Reach,
    grid: StampGrid,
    (ny, nx): (usize, usize),
) -> Option<[(Range<usize>, Range<usize>); 2]> {
    Some([
        overlap(x - reach.right as i64, grid.nx(), nx)?,
        overlap(y - reach.above as i64, grid.ny(), ny)?,
    ])
}

/// The PSFs at pixels `(x, y)` of the scene, `[psf, stamp pixel]`.
fn psfs(model: &PsfModel, field: PixelRegion, pixels: &[(usize, usize)]) -> Result<Array2<f64>, ConvError> {
    let count = model.stamp_count();
    let mut coefficients = Array2::zeros((pixels.len(), count));
    for (&(x, y), mut row) in pixels.iter().zip(coefficients.outer_iter_mut()) {
        model.scaled_coefficients_into(field.position(x, y), row.as_slice_mut().expect("row-major"))?;
    }
    let flat = model
        .stamps()
        .into_shape_with_order((count, model.grid().pixel_count()))
        .expect("row-major");
    Ok(coefficients.dot(&flat))
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
        let field = view.field_region();
        let (height, width) = model.grid().dim();
        let gathers = self.anchor == Anchor::Output;
        // The pixels that have PSFs of their own, in pixels of the light.
        let whole = if gathers { view.frame } else { view.shape.region() };
        let nx = whole.shape().nx();
        let under = |x: usize, y: usize| under((x as i64, y as i64), reach, model.grid(), light.dim());
        let is_lit = |&(x, y): &(usize, usize)| {
            if gathers {
                under(x, y).is_some_and(|[(_, columns), (_, rows)]| {
                    light.slice(s![rows, columns]).iter().any(|v| !v.is_zero())
                })
            } else {
                !light[[y, x]].is_zero()
            }
        };
        let mut result = Array2::<f64>::zeros((frame.shape().ny(), frame.shape().nx()));
        let bands = whole.shape().ny().div_ceil(BAND);
        add_in_order(result.view_mut(), bands, progress, |band| {
            let rows = band * BAND..((band + 1) * BAND).min(whole.shape().ny());
            let (x0, y0) = (whole.x0() as usize, whole.y0() as usize + rows.start);
            let lit: Vec<(usize, usize)> = (y0..y0 + rows.len())
                .flat_map(|y| (x0..x0 + nx).map(move |x| (x, y)))
                .filter(is_lit)
                .collect();
            // The image of the band without the margin, or with it.
            let [left, below, margin_x, margin_y] = if gathers {
                [0; 4]
            } else {
                [reach.left, reach.below, width - 1, height - 1]
            };
            let mut values = Array2::<f64>::zeros((rows.len() + margin_y, nx + margin_x));
            for some in lit.chunks(PSFS_AT_ONCE) {
                progress.check_cancelled()?;
                let psfs = psfs(model, field, some)?;
                for (&(x, y), psf) in some.iter().zip(psfs.outer_iter()) {
                    let psf = psf
                        .into_shape_with_order((height, width))
                        .expect("the grid's size");
                    let (i, j) = (x - x0, y - y0);
                    if gathers {
                        let [(from_columns, columns), (from_rows, rows)] =
                            under(x, y).expect("light reaches it");
                        let turned = psf.slice(s![..;-1, ..;-1]);
                        let psf = turned.slice(s![from_rows, from_columns]);
                        let light = light.slice(s![rows, columns]);
                        values[[j, i]] = psf.iter().zip(light).map(|(p, f)| p * f.as_f64()).sum();
                    } else {
                        let mut target = values.slice_mut(s![j..j + height, i..i + width]);
                        target.scaled_add(light[[y, x]].as_f64(), &psf);
                    }
                }
            }
            let first = (
                x0 as i64 - left as i64 - view.frame.x0(),
                y0 as i64 - below as i64 - view.frame.y0(),
            );
            let piece = Piece { first, values };
            Ok(if lit.is_empty() { Vec::new() } else { vec![piece] })
        })?;
        Image::new(result.mapv(T::nearest)).map_err(ConvError::Result)
    }
}
