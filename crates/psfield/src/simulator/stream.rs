//! Simulates scenes and images larger than memory, by bands of rows.

use std::ops::Range;

use conv_core::{ConvError, ConvReal, RowStream, TileCounts};
use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};
use psf_types::{FrameShape, Image, PixelRegion, PointSource, Progress, SersicSource};

use super::Simulator;
use crate::{PsfieldError, Scene};

impl<T: ConvReal> Simulator<T> {
    /// Makes the image of a scene that is read and written by rows. The stream reads rows of the
    /// scene's image, in scene pixels, and writes rows of the frame or of the region. The stars and
    /// galaxies are those of `scene`, whose own image is ignored. The pixels are the same bytes as
    /// those of [`simulate`](Self::simulate).
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
        let convolver = self.convolver(scene, progress)?;
        let engine = convolver.engine_for("rows can be streamed")?;
        let mut rows = SceneRows::new(self, scene, rows, progress)?;
        engine.stream(&mut rows, progress)
    }
}

/// Adds galaxies to the rows of a scene's image that are read. Samples the rows of the fine image,
/// adds stars, and writes them as rows of the frame.
pub(super) struct SceneRows<'a, T: ConvReal, R> {
    simulator: &'a Simulator<T>,
    inner: &'a mut R,
    stars: &'a [PointSource],
    galaxies: Vec<SersicSource>,
    padding: usize,
    progress: &'a dyn Progress,
    /// Rows of the fine image that were taken so far, and rows of the image that were written.
    fine_rows: usize,
    image_rows: usize,
}

impl<'a, T: ConvReal, R: RowStream<T>> SceneRows<'a, T, R> {
    pub(super) fn new(
        simulator: &'a Simulator<T>,
        scene: &'a Scene<'_, T>,
        inner: &'a mut R,
        progress: &'a dyn Progress,
    ) -> Result<Self, PsfieldError> {
        let padding = simulator.padding(scene);
        Ok(Self {
            simulator,
            inner,
            stars: scene.stars(),
            galaxies: simulator.geometry.fine_galaxies(scene.galaxies(), padding)?,
            padding,
            progress,
            fine_rows: 0,
            image_rows: 0,
        })
    }
}

impl<T: ConvReal, R: RowStream<T>> RowStream<T> for SceneRows<'_, T, R>
where
    R::Error: From<PsfieldError>,
{
    type Error = R::Error;

    fn read(&mut self, rows: Range<usize>, mut light: ArrayViewMut2<'_, T>) -> Result<(), R::Error> {
        let (p, shape) = (self.padding, self.simulator.geometry.shape);
        if p == 0 {
            self.inner.read(rows.clone(), light.view_mut())?;
        } else {
            light.fill(T::zero());
            // Rows of the image that are within the requested rows.
            let (from, to) = (rows.start.max(p), rows.end.min(p + shape.ny()));
            if from < to {
                let mut of_image = Array2::zeros((to - from, shape.nx()));
                self.inner.read(from - p..to - p, of_image.view_mut())?;
                let (rows, columns) = (from - rows.start..to - rows.start, p..p + shape.nx());
                light.slice_mut(s![rows, columns]).assign(&of_image);
            }
        }
        sersic::add_galaxies(light, (0, rows.start as i64), &self.galaxies);
        Ok(())
    }

    fn write(&mut self, rows: ArrayView2<'_, T>) -> Result<(), R::Error> {
        let geometry = &self.simulator.geometry;
        let mut shown = geometry.sampled_rows(rows, self.fine_rows);
        self.fine_rows += rows.nrows();
        if shown.nrows() > 0 {
            let shape = FrameShape::new(shown.ncols(), shown.nrows()).map_err(ConvError::Result)?;
            let (x0, y0) = (
                geometry.region.x0(),
                geometry.region.y0() + self.image_rows as i64,
            );
            let region = PixelRegion::new(x0, y0, shape);
            self.simulator
                .draw_stars_into(self.stars, region, shown.view_mut(), self.progress)?;
            self.image_rows += shown.nrows();
            let shown = Image::new(shown).map_err(ConvError::Result)?;
            self.inner.write(shown.pixels())?;
        }
        Ok(())
    }
}
