//! The classical method: a constant PSF in each patch.

use ndarray::{Array2, ArrayView2, Axis, s};
use psf_types::{Anchor, Image, ImageView, PixelRegion, Position, Progress, PsfModel};

use super::ConvolutionMethod;
use super::fft2::{KernelRows, RealFft2};
use crate::overlap::{Piece, add_in_order, overlap};
use crate::view::{Reach, View};
use crate::working_range::{Rescaling, take_back};
use crate::{ConvError, ConvReal};

/// Divides the frame into square patches and convolves each with the PSF of its centre. With
/// [`Anchor::Source`], the light of each patch spreads beyond the patch, and all results are added
/// (overlap-add). With [`Anchor::Output`], each patch of the image is computed from the light in
/// the patch and in a margin around it (overlap-save).
///
/// The method is not exact: the PSF jumps at every patch border. It serves for comparison. Patches
/// without light cost nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PatchConvolution {
    size: usize,
    anchor: Anchor,
}

impl PatchConvolution {
    /// Patches of `size x size` pixels, counted from the frame's first pixel. With
    /// [`Anchor::Source`], the patches continue into the light around the frame.
    ///
    /// # Errors
    /// [`ConvError::PatchSize`] if the size is 0.
    pub fn new(size: usize, anchor: Anchor) -> Result<Self, ConvError> {
        if size == 0 {
            Err(ConvError::PatchSize)
        } else {
            Ok(Self { size, anchor })
        }
    }

    /// Divides `length` pixels of an axis at the frame's first pixel, `origin`, and at every
    /// multiple of `size` pixels from there, in both directions. Returns the first pixel and the
    /// number of pixels of each part.
    fn cut(self, origin: usize, length: usize) -> Vec<(usize, usize)> {
        let first_cut = origin % self.size;
        let cuts = (first_cut..length).step_by(self.size);
        let starts: Vec<usize> = (first_cut > 0).then_some(0).into_iter().chain(cuts).collect();
        let ends = starts.iter().skip(1).copied().chain([length]);
        starts
            .iter()
            .zip(ends)
            .map(|(&start, end)| (start, end - start))
            .collect()
    }
}

impl<T: ConvReal> ConvolutionMethod<T> for PatchConvolution {
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
        let (light, back) = Rescaling::of_pixels(light);
        let patch = self.size.min(view.shape.nx().max(view.shape.ny()));
        let (height, width) = model.grid().dim();
        let work = Work {
            model,
            reach,
            fft: RealFft2::<T>::at_least(patch + height - 1, patch + width - 1),
            light: light.view(),
            field: view.field_region(),
            frame: view.frame,
        };
        // The region that is divided into patches, and the frame's first pixel in it. This region
        // is the frame if each output pixel has its own PSF, otherwise all light.
        let (region, origin) = match self.anchor {
            Anchor::Output => (view.frame, (0, 0)),
            _ => (view.shape.region(), view.first_pixel()),
        };
        let columns = self.cut(origin.0, region.shape().nx());
        let rows = self.cut(origin.1, region.shape().ny());
        let mut result = Array2::zeros((frame.shape().ny(), frame.shape().nx()));
        add_in_order(result.view_mut(), rows.len(), progress, |row| {
            let (y, height) = rows[row];
            let mut pieces = Vec::new();
            for &(x, width) in &columns {
                progress.check_cancelled()?;
                let corner = (x + region.x0() as usize, y + region.y0() as usize);
                pieces.extend(match self.anchor {
                    Anchor::Output => work.gather(corner, (width, height))?,
                    _ => work.scatter(corner, (width, height))?,
                });
            }
            Ok(pieces)
        })?;
        take_back(&mut result, back);
        Image::new(result).map_err(ConvError::Result)
    }
}

struct Work<'a, T: ConvReal> {
    model: &'a PsfModel,
    reach: Reach,
    fft: RealFft2<T>,
    light: ArrayView2<'a, T>,
    field: PixelRegion,
    frame: PixelRegion,
}

impl<T: ConvReal> Work<'_, T> {
    /// Spreads the light of a patch over the patch and a margin of the stamp's reach.
    fn scatter(
        &self,
        (x, y): (usize, usize),
        (nx, ny): (usize, usize),
    ) -> Result<Option<Piece<T>>, ConvError> {
        let window = (x as i64, y as i64, nx, ny);
        let (height, width) = self.model.grid().dim();
        let whole = self.convolve(window, (x, y), (nx, ny))?;
        Ok(whole.map(|whole| Piece {
            first_column: x as i64 - self.reach.left as i64 - self.frame.x0(),
            first_row: y as i64 - self.reach.below as i64 - self.frame.y0(),
            // The plane is circular: rows below the first row of the patch are at the plane's end.
            values: Array2::from_shape_fn((ny + height - 1, nx + width - 1), |(j, i)| {
                let row = (j + self.fft.rows - self.reach.below) % self.fft.rows;
                let column = (i + self.fft.columns - self.reach.left) % self.fft.columns;
                whole[[row, column]]
            }),
        }))
    }

    /// The image of a patch, from the light of the patch and a margin of the mirrored stamp's
    /// reach.
    fn gather(
        &self,
        (x, y): (usize, usize),
        (nx, ny): (usize, usize),
    ) -> Result<Option<Piece<T>>, ConvError> {
        let (height, width) = self.model.grid().dim();
        let (right, above) = (self.reach.right, self.reach.above);
        let window = (
            x as i64 - right as i64,
            y as i64 - above as i64,
            nx + width - 1,
            ny + height - 1,
        );
        let whole = self.convolve(window, (x, y), (nx, ny))?;
        Ok(whole.map(|whole| Piece {
            first_column: x as i64 - self.frame.x0(),
            first_row: y as i64 - self.frame.y0(),
            values: whole.slice(s![above..above + ny, right..right + nx]).to_owned(),
        }))
    }

    /// The circular convolution of a window of the light with the PSF at the centre of a patch.
    /// Returns `None` if the window is dark.
    fn convolve(
        &self,
        (x, y, nx, ny): (i64, i64, usize, usize),
        corner: (usize, usize),
        patch: (usize, usize),
    ) -> Result<Option<Array2<T>>, ConvError> {
        let (Some((to_x, x, nx)), Some((to_y, y, ny))) = (
            overlap(x, nx, self.light.ncols()),
            overlap(y, ny, self.light.nrows()),
        ) else {
            return Ok(None);
        };
        let window = self.light.slice(s![y..y + ny, x..x + nx]);
        if window.iter().all(rustfft::num_traits::Zero::is_zero) {
            return Ok(None);
        }
        let psf = self.model.psf_at(self.centre(corner, patch))?;
        let kernel = KernelRows::new(&self.fft, psf.values(), self.reach);
        let mut spectrum = self.fft.spectrum();
        self.fft.rows_forward(&mut spectrum, |row, values| {
            let Some(row) = row.checked_sub(to_y).filter(|&r| r < ny) else {
                return false;
            };
            values[to_x..]
                .iter_mut()
                .zip(window.index_axis(Axis(0), row))
                .for_each(|(value, &f)| *value = f);
            true
        });
        self.fft.for_columns(&mut spectrum, |column| {
            let [stamp, _] = column.spare;
            self.fft.forward(column.values, column.scratch);
            kernel.column_into(&self.fft, column.index, stamp, column.scratch);
            column.values.iter_mut().zip(&*stamp).for_each(|(f, b)| *f *= b);
            self.fft.inverse(column.values, column.scratch);
        });
        let mut whole = Array2::zeros((self.fft.rows, self.fft.columns));
        self.fft
            .rows_inverse(&spectrum, 0, whole.view_mut(), |_, out, values| {
                out.copy_from_slice(values);
            });
        Ok(Some(whole))
    }

    /// The field position of the centre of a patch.
    fn centre(&self, (x, y): (usize, usize), (nx, ny): (usize, usize)) -> Position {
        self.field
            .position(x, y)
            .midpoint(self.field.position(x + nx - 1, y + ny - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cuts_count_from_the_frame() {
        let cut = |size, origin, length| {
            PatchConvolution::new(size, Anchor::Source)
                .unwrap()
                .cut(origin, length)
        };
        assert_eq!(cut(4, 0, 10), [(0, 4), (4, 4), (8, 2)]);
        assert_eq!(cut(4, 5, 10), [(0, 1), (1, 4), (5, 4), (9, 1)]);
        assert_eq!(cut(4, 3, 2), [(0, 2)]);
        assert_eq!(cut(100, 7, 30), [(0, 7), (7, 23)]);
    }
}
