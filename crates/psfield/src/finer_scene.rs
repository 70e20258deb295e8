//! Scenes finer than the frame that shows them.

use std::ops::Range;

use conv_core::{ConvError, ConvReal, RowStream, StarPlan};
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Ix2, SliceInfo, SliceInfoElem, s};
use psf_types::{FrameShape, Image, ImageView, PixelRegion, PointSource, Position, Progress, Scene};

use crate::{PsfieldError, SimulationPlan};

/// How a scene's pixels lie on those of its frame, and its stars in pixels of the frame.
///
/// With `s` pixels of the scene along each side of a frame pixel, frame pixel `i` has its centre at `s i + (s - 1) / 2`. The engine's
/// stamps hold the response of the frame's pixel and the shift of half a pixel that an even `s` asks for, so that the frame's image
/// is every `s`-th pixel of the scene's, times `s^2`.
#[derive(Debug)]
pub(crate) struct FinerScene<T> {
    finer: usize,
    stars: Scene<T>,
}

impl<T: ConvReal> FinerScene<T> {
    pub(crate) fn new(finer: usize, scene: &Scene<T>) -> Result<Self, PsfieldError> {
        if finer == 1 {
            let stars = Scene::dark(scene.shape())
                .with_sources(scene.sources().to_vec())
                .with_frame(scene.frame())?;
            return Ok(Self { finer, stars });
        }
        let (frame, s) = (scene.frame(), finer as i64);
        let whole = |v: i64| v % s == 0;
        let (nx, ny) = (frame.shape().nx() as i64, frame.shape().ny() as i64);
        if ![frame.x0(), frame.y0(), nx, ny].into_iter().all(whole) {
            return Err(PsfieldError::FinerFrame {
                oversample: finer,
                frame,
            });
        }
        let shape = FrameShape::new(
            scene.shape().nx().div_ceil(finer),
            scene.shape().ny().div_ceil(finer),
        )?;
        let frame_shape = FrameShape::new(frame.shape().nx() / finer, frame.shape().ny() / finer)?;
        let frame = PixelRegion::new(frame.x0() / s, frame.y0() / s, frame_shape);
        let first = (s as f64 - 1.0) / 2.0;
        let of_frame = |v: f64| (v - first) / s as f64;
        let sources = scene
            .sources()
            .iter()
            .map(|star| {
                let position = Position::new(of_frame(star.position().x()), of_frame(star.position().y()))?;
                PointSource::new(position, star.flux())
            })
            .collect::<Result<_, _>>()?;
        Ok(Self {
            finer,
            stars: Scene::dark(shape).with_sources(sources).with_frame(frame)?,
        })
    }

    /// The stars alone, everything in pixels of the frame's size.
    pub(crate) fn stars(&self) -> &Scene<T> {
        &self.stars
    }

    /// The pixel of the scene's image that shows a pixel of the frame.
    pub(crate) fn sampled_pixel(&self, (column, row): (usize, usize)) -> (usize, usize) {
        let first = (self.finer - 1) / 2;
        (self.finer * column + first, self.finer * row + first)
    }

    /// A region of the frame, given in the frame's own pixels, in pixels of the scene counted from the frame's first.
    pub(crate) fn of_scene(&self, region: PixelRegion) -> Result<PixelRegion, PsfieldError> {
        let frame = self.stars.frame().shape();
        if !frame.region().contains(region) {
            return Err(ConvError::RegionOutsideFrame { region, frame }.into());
        }
        let (s, shape) = (self.finer as i64, region.shape());
        let shape = FrameShape::new(shape.nx() * self.finer, shape.ny() * self.finer)?;
        Ok(PixelRegion::new(region.x0() * s, region.y0() * s, shape))
    }

    /// Pixels of the scene in a pixel of the frame.
    pub(crate) fn pixel_area(&self) -> f64 {
        (self.finer * self.finer) as f64
    }

    /// The frame's image from that at the scene's pixels.
    pub(crate) fn sampled(&self, image: Array2<T>) -> Array2<T> {
        if self.finer == 1 {
            return image;
        }
        self.sampled_rows(image.view(), 0)
    }

    /// Adds the frame's image to one that is there, from that at the scene's pixels.
    pub(crate) fn add_sampled(&self, fine: &Array2<T>, mut image: ArrayViewMut2<'_, T>) {
        let area = T::nearest(self.pixel_area());
        image.zip_mut_with(&fine.slice(samples(self.finer)), |pixel, &v| *pixel += v * area);
    }

    /// Those rows of the frame's image that rows of the scene's show, the first of which is row `first` of it.
    fn sampled_rows(&self, rows: ArrayView2<'_, T>, first: usize) -> Array2<T> {
        let (s, offset) = (self.finer, (self.finer - 1) / 2);
        let skip = (offset + s - first % s) % s;
        let area = T::nearest(self.pixel_area());
        if skip >= rows.nrows() {
            return Array2::zeros((0, self.stars.frame().shape().nx()));
        }
        rows.slice(s![skip..;s, offset..;s]).mapv(|v| v * area)
    }
}

/// The pixels of a finer image that show those of the frame's.
fn samples(finer: usize) -> SliceInfo<[SliceInfoElem; 2], Ix2, Ix2> {
    let first = (finer - 1) / 2;
    s![first..;finer, first..;finer]
}

/// The transpose of sampling: an image at the pixels of a finer scene that holds the frame's in those which show it and is dark between them.
pub(crate) fn spread<T: ConvReal>(finer: usize, image: &ImageView<'_, T>) -> Result<Image<T>, PsfieldError> {
    let (rows, columns) = image.pixels().dim();
    let area = T::nearest((finer * finer) as f64);
    let mut fine = Array2::zeros((rows * finer, columns * finer));
    fine.slice_mut(samples(finer))
        .zip_mut_with(&image.pixels(), |fine, &v| *fine = v * area);
    Ok(Image::new(fine)?)
}

/// A stream of rows of a frame behind one of a finer scene, with its stars.
pub(crate) struct FinerRows<'a, T: ConvReal, R> {
    inner: &'a mut R,
    finer: &'a FinerScene<T>,
    stars: &'a StarPlan<T>,
    /// The part of the frame whose rows they are, in the frame's own pixels.
    region: PixelRegion,
    progress: &'a dyn Progress,
    /// Rows that came, of the scene's image, and that went, of the frame's.
    came: usize,
    went: usize,
}

impl<'a, T: ConvReal, R> FinerRows<'a, T, R> {
    pub(crate) fn new(
        inner: &'a mut R,
        finer: &'a FinerScene<T>,
        plan: &'a SimulationPlan<T>,
        progress: &'a dyn Progress,
    ) -> Self {
        Self {
            inner,
            finer,
            stars: plan.stars(),
            region: plan.region_of(finer.stars().frame().shape()),
            progress,
            came: 0,
            went: 0,
        }
    }
}

impl<T: ConvReal, R: RowStream<T>> RowStream<T> for FinerRows<'_, T, R> {
    type Error = R::Error;

    fn read(&mut self, rows: Range<usize>, light: ArrayViewMut2<'_, T>) -> Result<(), R::Error> {
        self.inner.read(rows, light)
    }

    fn write(&mut self, rows: ArrayView2<'_, T>) -> Result<(), R::Error> {
        let mut shown = if self.finer.finer == 1 {
            rows.to_owned()
        } else {
            self.finer.sampled_rows(rows, self.came)
        };
        self.came += rows.nrows();
        if shown.nrows() > 0 {
            let shape = FrameShape::new(shown.ncols(), shown.nrows()).map_err(ConvError::Result)?;
            let (x0, y0) = (self.region.x0(), self.region.y0() + self.went as i64);
            let region = PixelRegion::new(x0, y0, shape);
            self.stars
                .add_to_region(self.finer.stars(), region, shown.view_mut(), self.progress)?;
            self.went += shown.nrows();
            let shown = Image::new(shown).map_err(ConvError::Result)?;
            self.inner.write(shown.pixels())?;
        }
        Ok(())
    }
}
