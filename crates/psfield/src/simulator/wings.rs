//! The wings of PSFs, through which images are convolved by a simulator of their own.

use std::ops::Range;
use std::sync::Arc;

use conv_core::{ConvReal, RowStream};
use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};
use psf_types::{FrameShape, ImageView, PixelRegion, Progress};

use super::{Part, Simulator};
use crate::error::{ErrorKind, PsfieldError};
use crate::psf::get_or_make;
use crate::scene::Scene;
use crate::simulate_options::{Device, SimulateOptions};

impl<T: ConvReal> Simulator<T> {
    /// The simulator that convolves images with the wings of the PSF. None if the PSF has none. It runs on the
    /// CPU, because a GPU has no room for the transforms of such stamps beside those of the core.
    pub(super) fn wings(&self) -> Result<Option<&Self>, PsfieldError> {
        let made = get_or_make(&self.wings, || {
            let Some(wings) = self.psf().wings()? else {
                return Ok(None);
            };
            if self.shared.images.is_some() {
                const MOVED: &str =
                    "the PSF of a moving telescope cannot have wings: take a PSF without wings";
                return Err(PsfieldError::new(ErrorKind::Setting, MOVED));
            }
            let options = SimulateOptions {
                device: Device::Cpu,
                floor: 0.0,
                ..self.options().clone()
            };
            let shape = self.scene_shape();
            let part = Arc::new(Part::new(wings));
            let mut made = Self::of_parts(vec![part], None, (shape.ny(), shape.nx()), options)?;
            made.of_wings = true;
            Ok(Some(Box::new(made)))
        })?;
        Ok(made.as_deref())
    }

    /// Returns whether the PSF of a part has wings.
    pub(super) fn has_wings(&self) -> Result<bool, PsfieldError> {
        let mut parts = self.shared.parts.iter();
        parts.try_fold(false, |found, part| Ok(found || part.psf.has_wings()?))
    }

    /// The light of a scene that falls in the wings, on the pixels of the region. None for a PSF without wings.
    pub(super) fn light_of_wings(
        &self,
        scene: &Scene<'_, T>,
        progress: &dyn Progress,
    ) -> Result<Option<Array2<T>>, PsfieldError> {
        if !self.has_wings()? {
            return Ok(None);
        }
        let mut light = self.zeros();
        if scene.has_image()
            && let Some(wings) = self.wings()?
        {
            let (layers, lights) = (scene.layers_with_image(), self.lights(scene, progress)?);
            wings.convolve_lights_into((&layers, &lights), light.view_mut(), progress)?;
        }
        self.draw_wings_into(scene, light.view_mut(), progress)?;
        Ok(Some(light))
    }
}

/// The part of light that a region of the scene holds. `first` is the column and row at which the light begins.
pub(super) fn part_of_light<'a, T: ConvReal>(
    light: &'a ImageView<'_, T>,
    first: (i64, i64),
    region: PixelRegion,
) -> Result<ImageView<'a, T>, PsfieldError> {
    let (x, y) = ((region.x0() - first.0) as usize, (region.y0() - first.1) as usize);
    let (nx, ny) = (region.shape().nx(), region.shape().ny());
    Ok(ImageView::new(
        light.pixels().slice_move(s![y..y + ny, x..x + nx]),
    )?)
}

/// Keeps the rows of the wings' image in memory.
pub(super) struct WingRows<'a, T: ConvReal, R> {
    inner: &'a mut R,
    pub(super) image: Array2<T>,
    rows: usize,
}

impl<'a, T: ConvReal, R> WingRows<'a, T, R> {
    pub(super) fn new(inner: &'a mut R, shape: FrameShape) -> Self {
        Self {
            inner,
            image: Array2::zeros((shape.ny(), shape.nx())),
            rows: 0,
        }
    }
}

impl<T: ConvReal, R: RowStream<T>> RowStream<T> for WingRows<'_, T, R> {
    type Error = R::Error;

    fn read(
        &mut self,
        layer: usize,
        rows: Range<usize>,
        light: ArrayViewMut2<'_, T>,
    ) -> Result<(), R::Error> {
        self.inner.read(layer, rows, light)
    }

    fn write(&mut self, rows: ArrayView2<'_, T>) -> Result<(), R::Error> {
        let end = self.rows + rows.nrows();
        self.image.slice_mut(s![self.rows..end, ..]).assign(&rows);
        self.rows = end;
        Ok(())
    }
}
