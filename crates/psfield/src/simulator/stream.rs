//! Simulates scenes and images that are larger than the memory, in bands of rows.

use std::ops::Range;

use conv_core::{ConvError, ConvReal, RowStream, TileCounts};
use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};
use psf_types::{FrameShape, Image, PixelRegion, Progress, Uncounted};

use super::Simulator;
use super::wings::WingRows;
use crate::error::PsfieldError;
use crate::scene::Scene;
use crate::spot_check::{PixelPicker, SpotCheck};

impl<T: ConvReal> Simulator<T> {
    /// Makes the image of a scene row by row. Reads the rows of the images that the scene does not hold
    /// ([`Scene::streamed`]), in scene pixels, from `rows`, and writes the rows of the frame or of the region
    /// to `rows`. [`RowStream::read`] gets the number of the layer. The pixels are equal, bit by bit, to the
    /// pixels of the image that [`simulate`](Self::simulate) returns. If the PSF has wings, the scene is read
    /// twice, and the image of its wings is held in memory.
    ///
    /// Afterwards, `count` pixels, chosen by `seed`, are compared with the direct sum, as by
    /// [`spot_check`](Self::spot_check). For this, some rows are read again. For a `count` of 0, there is no
    /// check.
    ///
    /// # Errors
    /// The errors of the stream and of [`simulate_into`](Self::simulate_into), and
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a method without a plan.
    pub fn stream<R: RowStream<T>>(
        &self,
        scene: &Scene<'_, T>,
        rows: &mut R,
        (count, seed): (usize, u64),
        progress: &dyn Progress,
    ) -> Result<(TileCounts, Option<SpotCheck>), R::Error>
    where
        R::Error: From<PsfieldError>,
    {
        self.check_scene(scene)?;
        let layers = scene.layers_with_image();
        if layers.is_empty() {
            const NO_IMAGE: &str = "a scene without an image has no rows to be streamed";
            return Err(PsfieldError::new(crate::error::ErrorKind::Data, NO_IMAGE).into());
        }
        let mut of_wings = match self.wings()? {
            Some(wings) => Some(wings.streamed_in_memory(scene, rows, progress)?),
            None => None,
        };
        if let Some(of_wings) = &mut of_wings {
            self.draw_wings_into(scene, of_wings.view_mut(), progress)?;
        }
        let convolver = self.convolver(&layers, progress)?;
        let engine = convolver.engine_for("rows can be streamed")?;
        let mut passed = SceneRows {
            of_wings: of_wings.as_ref().map(|image| image.view()),
            draws_sources: true,
            simulator: self,
            scene,
            layers,
            inner: rows,
            picker: (count > 0).then(|| self.picker(scene, (count, seed))),
            progress,
            fine_rows: 0,
            image_rows: 0,
        };
        let counts = engine.stream(&mut passed, progress)?;
        let picker = passed.picker;
        let check = picker.map(|picker| self.checked(scene, picker, rows, &Uncounted(progress)));
        Ok((counts, check.transpose()?))
    }

    /// The image of the scene's images alone, whose rows are read from `rows`.
    fn streamed_in_memory<R: RowStream<T>>(
        &self,
        scene: &Scene<'_, T>,
        rows: &mut R,
        progress: &dyn Progress,
    ) -> Result<Array2<T>, R::Error>
    where
        R::Error: From<PsfieldError>,
    {
        let layers = scene.layers_with_image();
        let convolver = self.convolver(&layers, progress)?;
        let engine = convolver.engine_for("rows can be streamed")?;
        let mut kept = WingRows::new(rows, self.image_shape());
        let mut passed = SceneRows {
            of_wings: None,
            draws_sources: false,
            simulator: self,
            scene,
            layers,
            inner: &mut kept,
            picker: None,
            progress,
            fine_rows: 0,
            image_rows: 0,
        };
        engine.stream(&mut passed, &Uncounted(progress))?;
        Ok(kept.image)
    }
}

/// Passes rows between the caller's stream and the engine. When the engine writes rows of the fine
/// image (the convolved scene, in scene pixels), the adapter samples them once per frame pixel. It
/// adds stars and galaxies, and writes the result to the caller's stream.
struct SceneRows<'a, 's, T: ConvReal, R> {
    /// The light of the wings of the PSF, if it has any: the image of the frame or of the region.
    of_wings: Option<ArrayView2<'a, T>>,
    draws_sources: bool,
    simulator: &'a Simulator<T>,
    scene: &'a Scene<'s, T>,
    /// The numbers of the layers with an image, which are the engine's layers.
    layers: Vec<usize>,
    inner: &'a mut R,
    /// Picks pixels of the image for a check.
    picker: Option<PixelPicker>,
    progress: &'a dyn Progress,
    /// Number of rows of the fine image that the engine has written.
    fine_rows: usize,
    /// Number of rows of the frame's image that were passed on.
    image_rows: usize,
}

impl<T: ConvReal, R: RowStream<T>> RowStream<T> for SceneRows<'_, '_, T, R>
where
    R::Error: From<PsfieldError>,
{
    type Error = R::Error;

    fn read(
        &mut self,
        layer: usize,
        rows: Range<usize>,
        mut light: ArrayViewMut2<'_, T>,
    ) -> Result<(), R::Error> {
        let number = self.layers[layer];
        let Some(image) = self.scene.layers()[number].image() else {
            return self.inner.read(number, rows, light);
        };
        // The engine reads rows of the whole scene.
        let (whole, got) = (self.simulator.scene_shape(), image.shape());
        if whole != got {
            let (expected, got) = ((whole.ny(), whole.nx()), image.pixels().dim());
            let error = psf_types::DataError::ImageShape { expected, got };
            return Err(PsfieldError::from(error).into());
        }
        light.assign(&image.pixels().slice(s![rows, ..]));
        Ok(())
    }

    fn write(&mut self, rows: ArrayView2<'_, T>) -> Result<(), R::Error> {
        let geometry = &self.simulator.setup.geometry;
        let mut sampled = geometry.sampled_rows(rows, self.fine_rows);
        self.fine_rows += rows.nrows();
        if sampled.nrows() > 0 {
            let shape = FrameShape::new(sampled.ncols(), sampled.nrows()).map_err(ConvError::Result)?;
            let (x0, y0) = (
                geometry.region.x0(),
                geometry.region.y0() + self.image_rows as i64,
            );
            let region = PixelRegion::new(x0, y0, shape);
            if self.draws_sources {
                let image = sampled.view_mut();
                self.simulator
                    .draw_sources_into(self.scene, region, image, self.progress)?;
            }
            if let Some(of_wings) = self.of_wings {
                sampled += &of_wings.slice(s![self.image_rows..self.image_rows + sampled.nrows(), ..]);
            }
            self.image_rows += sampled.nrows();
            let sampled = Image::new(sampled).map_err(ConvError::Result)?;
            if let Some(picker) = &mut self.picker {
                picker.pass_rows(sampled.pixels());
            }
            self.inner.write(sampled.pixels())?;
        }
        Ok(())
    }
}
