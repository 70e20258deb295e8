//! How a scene lies on its frame.

use psf_types::{FrameShape, PixelRegion};

use crate::{PsfieldError, SimulationOptions};

/// The shape of a scene, how fine it is, the part of it that the image shows, and how far beyond its edges light comes from.
///
/// The scene may be finer than the image: `oversample` x `oversample` of its pixels are one of the image. The frame is given in pixels of
/// the image all the same.
///
/// ```
/// use psfield::SceneLayout;
/// use psfield::psf_types::{FrameShape, PixelRegion};
/// // An image of 400 x 300 pixels, 2 x 2 of which are one of the result.
/// let layout = SceneLayout::of_image(FrameShape::new(400, 300)?, 2)?
///     .with_frame(Some(PixelRegion::new(10, 20, FrameShape::new(100, 100)?)))
///     .with_reach(17);
/// assert_eq!(layout.shape().nx(), 400);
/// assert_eq!(SceneLayout::of_frame(200, 150, 2)?.shape(), layout.shape());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SceneLayout {
    pub(crate) shape: FrameShape,
    /// Whether the shape is that of an image.
    pub(crate) of_image: bool,
    pub(crate) oversample: usize,
    pub(crate) frame: Option<PixelRegion>,
    pub(crate) reach: usize,
}

impl SceneLayout {
    /// The largest scene without an image, 4 GiB in f32; a larger number is a slip.
    pub const MAX_PIXELS: usize = 1 << 30;

    /// A scene with an image of this shape, in its own pixels.
    ///
    /// # Errors
    /// [`PsfieldError::Oversample`] as [`SimulationOptions::with_oversample`].
    pub fn of_image(shape: FrameShape, oversample: usize) -> Result<Self, PsfieldError> {
        SimulationOptions::default().with_oversample(oversample)?;
        Ok(Self {
            shape,
            of_image: true,
            oversample,
            frame: None,
            reach: 0,
        })
    }

    /// A scene without an image for a frame of `nx` x `ny` pixels.
    ///
    /// # Errors
    /// [`PsfieldError::Oversample`] as [`SimulationOptions::with_oversample`], [`PsfieldError::SceneTooLarge`] beyond
    /// [`MAX_PIXELS`](Self::MAX_PIXELS), [`PsfieldError::Data`] for no pixels at all.
    pub fn of_frame(nx: usize, ny: usize, oversample: usize) -> Result<Self, PsfieldError> {
        let s = SimulationOptions::default()
            .with_oversample(oversample)?
            .oversample();
        let pixels = nx.checked_mul(ny).and_then(|n| n.checked_mul(s * s));
        if pixels.is_none_or(|pixels| pixels > Self::MAX_PIXELS) {
            return Err(PsfieldError::SceneTooLarge { nx, ny });
        }
        let shape = FrameShape::new(nx.saturating_mul(s), ny.saturating_mul(s))?;
        Ok(Self {
            of_image: false,
            ..Self::of_image(shape, oversample)?
        })
    }

    /// Seen through this frame, in pixels of the image; none: the whole scene. It is checked where sources are placed
    /// ([`SceneSources::new`](crate::SceneSources::new)).
    #[must_use]
    pub fn with_frame(self, frame: Option<PixelRegion>) -> Self {
        Self { frame, ..self }
    }

    /// Galaxies lend their light to so many pixels of the image beyond the scene, whence it comes in: those that the PSF reaches
    /// ([`PsfInput::reach`](crate::PsfInput::reach)).
    #[must_use]
    pub fn with_reach(self, reach: usize) -> Self {
        Self { reach, ..self }
    }

    /// Shape of the scene in its own pixels.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }

    /// Pixels of the scene along each side of a pixel of the image.
    pub fn oversample(&self) -> usize {
        self.oversample
    }

    /// The frame in pixels of the scene.
    pub(crate) fn frame_in_scene(&self) -> Result<PixelRegion, PsfieldError> {
        let (shape, s) = (self.shape, self.oversample);
        let Some(frame) = self.frame else {
            return if shape.nx().is_multiple_of(s) && shape.ny().is_multiple_of(s) {
                Ok(shape.region())
            } else {
                Err(PsfieldError::UnevenScene { shape, oversample: s })
            };
        };
        let place = |v: i64| v.checked_mul(s as i64);
        let length = |n: usize| n.checked_mul(s);
        let (nx, ny) = (frame.shape().nx(), frame.shape().ny());
        match (place(frame.x0()), place(frame.y0()), length(nx), length(ny)) {
            (Some(x0), Some(y0), Some(nx), Some(ny)) => {
                Ok(PixelRegion::new(x0, y0, FrameShape::new(nx, ny)?))
            }
            _ => Err(PsfieldError::FrameOffAnyScene { frame }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_checked_before_memory_is_taken() {
        let side = 1 << 15;
        assert!(SceneLayout::of_frame(side, side, 1).is_ok());
        for (nx, ny, s) in [(side, side, 2), (side, side + 1, 1), (usize::MAX, 3, 1)] {
            let refused = SceneLayout::of_frame(nx, ny, s);
            assert!(
                matches!(refused, Err(PsfieldError::SceneTooLarge { .. })),
                "{nx} x {ny}"
            );
        }
        for (nx, ny) in [(0, 5), (5, 0), (0, usize::MAX)] {
            assert!(matches!(
                SceneLayout::of_frame(nx, ny, 2),
                Err(PsfieldError::Data(_))
            ));
        }
        for s in [0, SimulationOptions::MAX_OVERSAMPLE + 1] {
            assert!(matches!(
                SceneLayout::of_frame(5, 5, s),
                Err(PsfieldError::Oversample { .. })
            ));
        }
    }
}
