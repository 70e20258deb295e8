//! The classical method: a constant PSF in each patch.

use ndarray::{Array2, ArrayView2, s};
use psf_types::{Anchor, Image, ImageView, PixelRegion, Position, Progress, PsfModel};
use rustfft::num_traits::Zero;

use super::ConvolutionMethod;
use crate::fft2::RealFft2;
use crate::overlap::{Piece, add_in_order, shared};
use crate::view::{Reach, View, region};
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
        let inner = (origin % self.size..length).step_by(self.size);
        let mut cuts: Vec<usize> = [0].into_iter().chain(inner).chain([length]).collect();
        cuts.dedup();
        cuts.windows(2).map(|cut| (cut[0], cut[1] - cut[0])).collect()
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
            anchor: self.anchor,
            reach,
            fft: RealFft2::<T>::at_least(patch + height - 1, patch + width - 1, progress),
            light: light.view(),
            view,
        };
        // The region that is divided into patches, and the frame's first pixel in it. This region
        // is the frame if each output pixel has its own PSF, otherwise all light.
        let (whole, origin) = match self.anchor {
            Anchor::Output => (view.frame, (0, 0)),
            _ => (view.shape.region(), view.first_pixel()),
        };
        let columns = self.cut(origin.0, whole.shape().nx());
        let rows = self.cut(origin.1, whole.shape().ny());
        let mut result = Array2::zeros((frame.shape().ny(), frame.shape().nx()));
        add_in_order(result.view_mut(), rows.len(), progress, |row| {
            let (y, height) = rows[row];
            let mut pieces = Vec::new();
            for &(x, width) in &columns {
                progress.check_cancelled()?;
                let corner = (whole.x0() + x as i64, whole.y0() + y as i64);
                pieces.extend(work.convolve(region(corner.0, corner.1, (width, height)))?);
            }
            Ok(pieces)
        })?;
        take_back(&mut result, back);
        Image::new(result).map_err(ConvError::Result)
    }
}

struct Work<'a, T: ConvReal> {
    model: &'a PsfModel,
    anchor: Anchor,
    reach: Reach,
    fft: RealFft2<'a, T>,
    light: ArrayView2<'a, T>,
    view: View,
}

impl<T: ConvReal> Work<'_, T> {
    /// Convolves the light of a patch, or the light that reaches it, with the PSF at the patch's
    /// centre. Returns `None` if this light is dark.
    fn convolve(&self, patch: PixelRegion) -> Result<Option<Piece<T>>, ConvError> {
        let gathers = self.anchor == Anchor::Output;
        // The patch and a margin, which fill the plane of the transforms.
        let reach = if gathers { self.reach.turned() } else { self.reach };
        let (height, width) = self.model.grid().dim();
        let plane = region(
            patch.x0() - reach.left as i64,
            patch.y0() - reach.below as i64,
            (patch.shape().nx() + width - 1, patch.shape().ny() + height - 1),
        );
        let (from, to) = if gathers { (plane, patch) } else { (patch, plane) };
        let in_plane = |x: i64, y: i64| ((x - plane.x0()) as usize, (y - plane.y0()) as usize);
        let whole = region(0, 0, (self.light.ncols(), self.light.nrows()));
        let Some([(_, columns), (_, rows)]) = shared(from, whole) else {
            return Ok(None);
        };
        let corner = in_plane(columns.start as i64, rows.start as i64);
        let light = self.light.slice(s![rows, columns]);
        if light.iter().all(Zero::is_zero) {
            return Ok(None);
        }
        let psf = self.model.core_at(self.centre(patch))?;
        let [mut spectrum, mut kernel] = [self.fft.zeros(), self.fft.zeros()];
        self.fft.forward(light, corner, &mut spectrum);
        self.fft.kernel(psf.values(), self.reach, &mut kernel);
        spectrum *= &kernel;
        let shape = (to.shape().ny(), to.shape().nx());
        let corner = in_plane(to.x0(), to.y0());
        let values = self.fft.inverse(&mut spectrum, corner, shape)?;
        let first = (to.x0() - self.view.frame.x0(), to.y0() - self.view.frame.y0());
        Ok(Some(Piece { first, values }))
    }

    /// The field position of the centre of a patch.
    fn centre(&self, patch: PixelRegion) -> Position {
        let field = patch.shifted(-self.view.frame.x0(), -self.view.frame.y0());
        let (nx, ny) = (patch.shape().nx(), patch.shape().ny());
        field.position(0, 0).midpoint(field.position(nx - 1, ny - 1))
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
