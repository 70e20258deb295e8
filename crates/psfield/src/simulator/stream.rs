//! Simulates scenes and images that are larger than the memory, in bands of rows.

use std::ops::Range;

use conv_core::{ConvError, ConvReal, RowStream, TileCounts};
use ndarray::{ArrayView2, ArrayViewMut2};
use psf_types::{FrameShape, Image, PixelRegion, Progress};

use super::Simulator;
use crate::scene::SceneSources;
use crate::{PsfieldError, Scene};

impl<T: ConvReal> Simulator<T> {
    /// Makes the image of a scene row by row. Reads the rows of the scene's image, in scene pixels,
    /// from `rows`, and writes the rows of the frame or of the region to `rows`. Takes only the
    /// stars and galaxies from `scene`, and ignores the image in `scene`. The pixels are equal, bit
    /// by bit, to the pixels of the image that [`simulate`](Self::simulate) returns.
    ///
    /// # Errors
    /// The errors of the stream and of [`simulate_into`](Self::simulate_into), and
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a method without a plan.
    pub fn stream<R: RowStream<T>>(
        &self,
        scene: &Scene<'_, T>,
        rows: &mut R,
        progress: &dyn Progress,
    ) -> Result<TileCounts, R::Error>
    where
        R::Error: From<PsfieldError>,
    {
        self.check_sources(scene, true)?;
        let convolver = self.convolver(progress)?;
        let engine = convolver.engine_for("rows can be streamed")?;
        let mut rows = SceneRows::new(vec![(self, scene.sources())], rows, progress);
        engine.stream(&mut rows, progress)
    }
}

/// Passes rows between the caller's stream and the engine. When the engine writes rows of the fine
/// image (the convolved scene, in scene pixels), the adapter samples them once per frame pixel. It
/// adds stars and galaxies, and writes the result to the caller's stream.
pub(super) struct SceneRows<'a, T: ConvReal, R> {
    /// The simulators of all spectra, which differ only in their PSFs, and their sources.
    spectra: Vec<(&'a Simulator<T>, SceneSources<'a>)>,
    inner: &'a mut R,
    progress: &'a dyn Progress,
    /// Number of rows of the fine image that the engine has written.
    fine_rows: usize,
    /// Number of rows of the frame's image that were passed on.
    image_rows: usize,
}

impl<'a, T: ConvReal, R: RowStream<T>> SceneRows<'a, T, R> {
    pub(super) fn new(
        spectra: Vec<(&'a Simulator<T>, SceneSources<'a>)>,
        inner: &'a mut R,
        progress: &'a dyn Progress,
    ) -> Self {
        Self {
            spectra,
            inner,
            progress,
            fine_rows: 0,
            image_rows: 0,
        }
    }
}

impl<T: ConvReal, R: RowStream<T>> RowStream<T> for SceneRows<'_, T, R>
where
    R::Error: From<PsfieldError>,
{
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
        let geometry = &self.spectra[0].0.geometry;
        let mut sampled = geometry.sampled_rows(rows, self.fine_rows);
        self.fine_rows += rows.nrows();
        if sampled.nrows() > 0 {
            let shape = FrameShape::new(sampled.ncols(), sampled.nrows()).map_err(ConvError::Result)?;
            let (x0, y0) = (
                geometry.region.x0(),
                geometry.region.y0() + self.image_rows as i64,
            );
            let region = PixelRegion::new(x0, y0, shape);
            for &(simulator, sources) in &self.spectra {
                simulator.draw_sources_into(sources, region, sampled.view_mut(), self.progress)?;
            }
            self.image_rows += sampled.nrows();
            let sampled = Image::new(sampled).map_err(ConvError::Result)?;
            self.inner.write(sampled.pixels())?;
        }
        Ok(())
    }
}
