//! Frames larger than memory.

use std::ops::Range;

use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};
use psf_types::{Anchor, FrameShape, Image, PixelRegion, Progress, Scene};

use super::execution::TileCounts;
use super::plan::Plan;
use crate::stars::StarPlan;
use crate::{ConvError, ConvReal};

/// Where the rows of a scene come from and those of its image go to.
pub trait RowStream<T> {
    /// What can go wrong.
    type Error: From<ConvError>;

    /// Fills `light` with the given rows of the scene, all its columns.
    ///
    /// # Errors
    /// Those of the source.
    fn read(&mut self, rows: Range<usize>, light: ArrayViewMut2<'_, T>) -> Result<(), Self::Error>;

    /// Takes the next rows of the image, in order from the first.
    ///
    /// # Errors
    /// Those of the target.
    fn write(&mut self, rows: ArrayView2<'_, T>) -> Result<(), Self::Error>;
}

impl<T: ConvReal> Plan<T> {
    /// The image of a scene that comes and goes by bands of rows, so that neither is ever in memory as a whole. The same bytes as
    /// [`execute`](Self::execute).
    ///
    /// `scene` gives the shape, the frame and the point sources, which `stars` draws where given, else the plan itself; its image part is
    /// not looked at. A plan of a region reads the rows that reach it and writes those of the region.
    ///
    /// # Errors
    /// Those of the stream, and [`ConvError`] as for [`execute`](Self::execute).
    pub fn stream<R: RowStream<T>>(
        &self,
        scene: &Scene<T>,
        stars: Option<&StarPlan<T>>,
        stream: &mut R,
        progress: &dyn Progress,
    ) -> Result<TileCounts, R::Error> {
        self.check_scene(scene)?;
        let rows_of_blocks = self.tiling.rows.len();
        progress.start(rows_of_blocks as u64);
        let (ny, nx) = (self.region.shape().ny(), self.region.shape().nx());
        let mut counts = TileCounts::default();
        // Rows of the image that are not finished yet, and the first of them.
        let mut pending = Array2::<T>::zeros((0, nx));
        let mut written = 0;
        for first in (0..rows_of_blocks).step_by(self.tiling.band()) {
            let band = first..(first + self.tiling.band()).min(rows_of_blocks);
            let light_rows = self.light_rows(band.clone());
            let light = self.read(stream, light_rows.clone())?;
            let reached = self.image_rows(band.clone());
            let next = if band.end < rows_of_blocks {
                self.image_rows(band.end..band.end + 1).start
            } else {
                ny
            };
            // From the first row that is not written to the last that this band reaches.
            let end = reached.end.max(written + pending.nrows()).max(next);
            let mut image = Array2::zeros((end - written, nx));
            image.slice_mut(s![..pending.nrows(), ..]).assign(&pending);
            // Output-anchored blocks write to their own rows alone.
            let from = if self.options.anchor() == Anchor::Output {
                reached.start
            } else {
                written
            };
            let to = if self.options.anchor() == Anchor::Output {
                reached.end
            } else {
                end
            };
            let output = image.slice_mut(s![from - written..to - written, ..]);
            counts += self.forward(band, (light.view(), light_rows.start), (output, from), progress)?;
            pending = image.slice(s![next - written.., ..]).to_owned();
            if next > written {
                let mut finished = image.slice_move(s![..next - written, ..]);
                if !scene.sources().is_empty() {
                    let stars = stars.map_or_else(|| self.stars(), Ok)?;
                    let rows = FrameShape::new(nx, next - written).map_err(ConvError::Result)?;
                    let (x0, y0) = (self.region.x0(), self.region.y0() + written as i64);
                    let region = PixelRegion::new(x0, y0, rows);
                    stars.add_to_region(scene, region, finished.view_mut(), progress)?;
                }
                let finished = Image::new(finished).map_err(ConvError::Result)?;
                stream.write(finished.pixels())?;
            }
            written = next;
        }
        Ok(counts)
    }

    /// Rows of light that a band of blocks needs, counted from the first that reaches the frame.
    fn light_rows(&self, band: Range<usize>) -> Range<usize> {
        if self.options.anchor() == Anchor::Output {
            let extents = self.row_extents();
            extents[band.start].0..extents[band.end - 1].1
        } else {
            self.tiling.rows[band.start].start()..self.tiling.rows[band.end - 1].end()
        }
    }

    /// Rows of the image that a band of blocks writes to.
    fn image_rows(&self, band: Range<usize>) -> Range<usize> {
        if self.options.anchor() == Anchor::Output {
            self.tiling.rows[band.start].start()..self.tiling.rows[band.end - 1].end()
        } else {
            let extents = self.row_extents();
            extents[band.start].0..extents[band.end - 1].1
        }
    }

    fn read<R: RowStream<T>>(&self, stream: &mut R, rows: Range<usize>) -> Result<Array2<T>, R::Error> {
        let [columns, light] = self.light.clone();
        let mut whole = Array2::zeros((rows.len(), self.shape.nx()));
        let rows = light.start + rows.start..light.start + rows.end;
        stream.read(rows, whole.view_mut())?;
        Ok(if columns.len() == whole.ncols() {
            whole
        } else {
            whole.slice(s![.., columns]).to_owned()
        })
    }
}
