//! The geometry of scene and frame: their shapes, the conversion between scene pixels and frame
//! pixels, and the sampling of fine images. A fine image has scene pixels.

use conv_core::{ConvError, ConvReal};
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Ix2, SliceInfo, SliceInfoElem, s};
use psf_types::{DataError, FrameShape, Image, ImageView, PixelRegion, Position};

use crate::error::{ErrorKind, PsfieldError};
use crate::simulate_options::SimulateOptions;

/// The geometry of scenes of one shape, of the frame and of the computed region.
///
/// With `s` pixels of the scene along each side of a frame pixel, frame pixel `i` has its centre at
/// the coordinate `s i + (s - 1) / 2` of the scene. The stamps that convolve the scene include the
/// response of a frame pixel. For even `s`, they also include a shift of half a scene pixel. The
/// frame's image is therefore every `s`-th pixel of the convolved scene, times `s^2`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Geometry {
    /// The scene, in its own pixels.
    pub(super) shape: FrameShape,
    /// Pixels of the scene along each side of a frame pixel.
    pub(super) oversample: usize,
    /// The part of the scene that the image shows, in frame pixels counted from the scene's first
    /// pixel.
    pub(super) frame: PixelRegion,
    /// The part of the frame that is computed, in frame pixels counted from the frame's first
    /// pixel.
    pub(super) region: PixelRegion,
}

impl Geometry {
    pub(super) fn new(shape: FrameShape, options: &SimulateOptions) -> Result<Self, PsfieldError> {
        let s = options.oversample;
        if !(1..=SimulateOptions::MAX_OVERSAMPLE).contains(&s) {
            let message = format!(
                "a scene may have 1 to {} pixels along each side of a frame pixel, got {s}",
                SimulateOptions::MAX_OVERSAMPLE
            );
            return Err(PsfieldError::of_setting("oversample", message));
        }
        let (nx, ny) = (shape.nx(), shape.ny());
        let frame = match options.frame {
            Some(frame) => {
                check_frame(shape, s, frame)?;
                frame
            }
            None if nx.is_multiple_of(s) && ny.is_multiple_of(s) => FrameShape::new(nx / s, ny / s)?.region(),
            None => {
                let message = format!(
                    "the scene is {shape} pixels, but both numbers must be multiples of {s}, because {s} scene pixels lie \
                     along each side of a frame pixel: cut the scene, or choose a part of it with a frame"
                );
                return Err(PsfieldError::new(ErrorKind::Data, message).with_setting("frame"));
            }
        };
        let whole = frame.shape();
        let region = options.region.unwrap_or(whole.region());
        if !whole.region().contains(region) {
            return Err(ConvError::RegionOutsideFrame { region, frame: whole }.into());
        }
        Ok(Self {
            shape,
            oversample: s,
            frame,
            region,
        })
    }

    /// Returns whether the whole frame is computed.
    pub(super) fn is_whole(&self) -> bool {
        self.region == self.frame.shape().region()
    }

    /// Returns whether a position lies in the frame or at most `reach` frame pixels beside it. The
    /// position is in frame pixels counted from the scene's first pixel.
    pub(super) fn is_near_frame(&self, position: Position, reach: f64) -> bool {
        let inside = |v: f64, first: i64, n: usize| {
            (-0.5 - reach..n as f64 - 0.5 + reach).contains(&(v - first as f64))
        };
        let (frame, shape) = (self.frame, self.frame.shape());
        inside(position.x(), frame.x0(), shape.nx()) && inside(position.y(), frame.y0(), shape.ny())
    }

    /// Converts a region from frame pixels to pixels of the scene.
    pub(super) fn fine(&self, region: PixelRegion) -> Result<PixelRegion, DataError> {
        let (s, shape) = (self.oversample, region.shape());
        let shape = FrameShape::new(shape.nx() * s, shape.ny() * s)?;
        Ok(PixelRegion::new(
            region.x0() * s as i64,
            region.y0() * s as i64,
            shape,
        ))
    }

    /// Returns the pixel of the frame's fine image from which a pixel of the region is sampled. The
    /// pixel of the region counts from the region's first pixel, and the result from the frame's.
    pub(super) fn sampled_pixel(&self, (column, row): (usize, usize)) -> (usize, usize) {
        let (x0, y0) = (self.region.x0() as usize, self.region.y0() as usize);
        let of = |v: usize| self.oversample * v + self.offset();
        (of(column + x0), of(row + y0))
    }

    /// The number of scene pixels in a frame pixel.
    pub(super) fn pixel_area(&self) -> f64 {
        (self.oversample * self.oversample) as f64
    }

    /// The index, along either axis, of the first pixel of a fine image that is sampled.
    pub(super) fn offset(&self) -> usize {
        (self.oversample - 1) / 2
    }

    /// The pixels of a fine image that are sampled.
    fn samples(&self) -> SliceInfo<[SliceInfoElem; 2], Ix2, Ix2> {
        let (first, step) = (self.offset(), self.oversample);
        s![first..;step, first..;step]
    }

    /// Samples a fine image once for each frame pixel, and adds the result to `image`.
    pub(super) fn add_sampled<T: ConvReal>(&self, fine: ArrayView2<'_, T>, mut image: ArrayViewMut2<'_, T>) {
        let area = T::nearest(self.pixel_area());
        image.zip_mut_with(&fine.slice(self.samples()), |pixel, &v| *pixel += v * area);
    }

    /// Returns the rows of the frame's image that are sampled from some rows of the fine image.
    /// `first` is the index of the first of `rows` in the fine image.
    pub(super) fn sampled_rows<T: ConvReal>(&self, rows: ArrayView2<'_, T>, first: usize) -> Array2<T> {
        let (s, offset) = (self.oversample, self.offset());
        if s == 1 {
            return rows.to_owned();
        }
        let skip = (offset + s - first % s) % s;
        let area = T::nearest(self.pixel_area());
        if skip >= rows.nrows() {
            return Array2::zeros((0, self.region.shape().nx()));
        }
        rows.slice(s![skip..;s, offset..;s]).mapv(|v| v * area)
    }

    /// The transpose of sampling. Returns a fine image with the frame's values at the sampled
    /// pixels, and 0 elsewhere.
    pub(super) fn spread<T: ConvReal>(&self, image: &ImageView<'_, T>) -> Result<Image<T>, PsfieldError> {
        let (rows, columns) = image.pixels().dim();
        let area = T::nearest(self.pixel_area());
        let mut fine = Array2::zeros((rows * self.oversample, columns * self.oversample));
        fine.slice_mut(self.samples())
            .zip_mut_with(&image.pixels(), |fine, &v| *fine = v * area);
        Ok(Image::new(fine)?)
    }
}

/// Checks that a frame, in frame pixels, lies on a scene, in scene pixels.
fn check_frame(shape: FrameShape, oversample: usize, frame: PixelRegion) -> Result<(), PsfieldError> {
    let (nx, ny) = (frame.shape().nx(), frame.shape().ny());
    let place = |v: i64| v.checked_mul(oversample as i64);
    let length = |n: usize| n.checked_mul(oversample);
    let fine = (place(frame.x0()), place(frame.y0()), length(nx), length(ny));
    let (Some(x0), Some(y0), Some(nx), Some(ny)) = fine else {
        let (x0, y0) = (frame.x0(), frame.y0());
        let message = format!("the frame of {nx} x {ny} pixels at ({x0}, {y0}) lies outside any scene");
        return Err(PsfieldError::of_setting("frame", message));
    };
    let fine = PixelRegion::new(x0, y0, FrameShape::new(nx, ny)?);
    if shape.region().contains(fine) {
        return Ok(());
    }
    let outside = DataError::FrameOutsideScene {
        x0: fine.x0(),
        y0: fine.y0(),
        shape: fine.shape(),
        scene: shape,
    };
    Err(PsfieldError::of_setting("frame", outside.to_string()).because(outside))
}
