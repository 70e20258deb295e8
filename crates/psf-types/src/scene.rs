//! Scenes: the light before the PSF.

use ndarray::ArrayView2;

use crate::{DataError, FrameShape, Image, PixelRegion, PointSource, Real};

/// The light that arrives at a frame: an image (flux in each pixel), point sources, or both.
///
/// Outside the scene there is no light but that of point sources listed there. The `frame` is the part of the scene that
/// the detector sees, the whole scene unless said otherwise; its first pixel is the origin of field positions, so the
/// light of a larger scene can come in over the frame's edges.
///
/// ```
/// use psf_types::{FrameShape, Image, PixelRegion, Scene};
/// let scene = Scene::from_image(Image::<f64>::zeros(FrameShape::new(120, 100)?));
/// let frame = PixelRegion::new(10, 10, FrameShape::new(100, 80)?);
/// let scene = scene.with_frame(frame)?;
/// assert_eq!(scene.field_region().x0(), -10);
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Scene<T = f64> {
    image: Option<Image<T>>,
    sources: Vec<PointSource>,
    shape: FrameShape,
    frame: PixelRegion,
}

impl<T: Real> Scene<T> {
    /// A scene of an image alone.
    pub fn from_image(image: Image<T>) -> Self {
        let shape = image.shape();
        Self {
            image: Some(image),
            sources: Vec::new(),
            shape,
            frame: shape.region(),
        }
    }

    /// A dark scene of the given shape, for point sources.
    pub fn dark(shape: FrameShape) -> Self {
        Self {
            image: None,
            sources: Vec::new(),
            shape,
            frame: shape.region(),
        }
    }

    /// The same scene with these point sources in place of any it had.
    #[must_use]
    pub fn with_sources(self, sources: Vec<PointSource>) -> Self {
        Self { sources, ..self }
    }

    /// The same scene seen through a frame, given in pixels of the scene.
    ///
    /// # Errors
    /// [`DataError::FrameOutsideScene`] when the frame reaches beyond the scene.
    pub fn with_frame(self, frame: PixelRegion) -> Result<Self, DataError> {
        let within = |first: i64, n: usize, limit: usize| {
            first >= 0
                && usize::try_from(first)
                    .ok()
                    .and_then(|f| f.checked_add(n))
                    .is_some_and(|end| end <= limit)
        };
        let shape = frame.shape();
        if within(frame.x0(), shape.nx(), self.shape.nx()) && within(frame.y0(), shape.ny(), self.shape.ny())
        {
            Ok(Self { frame, ..self })
        } else {
            Err(DataError::FrameOutsideScene {
                x0: frame.x0(),
                y0: frame.y0(),
                shape,
                scene: self.shape,
            })
        }
    }

    /// The image part `[y, x]`, if there is one.
    pub fn image(&self) -> Option<&Image<T>> {
        self.image.as_ref()
    }

    /// The pixels `[y, x]` of the image part, if there is one.
    pub fn pixels(&self) -> Option<ArrayView2<'_, T>> {
        self.image.as_ref().map(Image::pixels)
    }

    /// The point sources, in pixels of the scene.
    pub fn sources(&self) -> &[PointSource] {
        &self.sources
    }

    /// Shape of the whole scene.
    pub fn shape(&self) -> FrameShape {
        self.shape
    }

    /// The part of the scene that the result shows, in pixels of the scene.
    pub fn frame(&self) -> PixelRegion {
        self.frame
    }

    /// The whole scene in field positions: its first pixel is `(-x0, -y0)` of the frame.
    pub fn field_region(&self) -> PixelRegion {
        PixelRegion::new(-self.frame.x0(), -self.frame.y0(), self.shape)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_must_lie_in_the_scene() {
        let scene = Scene::<f64>::dark(FrameShape::new(10, 8).unwrap());
        let frame = |x0, y0, nx, ny| PixelRegion::new(x0, y0, FrameShape::new(nx, ny).unwrap());
        assert!(scene.clone().with_frame(frame(2, 1, 8, 7)).is_ok());
        for bad in [
            frame(-1, 0, 4, 4),
            frame(3, 0, 8, 4),
            frame(0, 2, 4, 7),
            frame(0, 0, 1 << 40, 1),
        ] {
            assert!(
                matches!(
                    scene.clone().with_frame(bad),
                    Err(DataError::FrameOutsideScene { .. })
                ),
                "{bad:?}"
            );
        }
    }
}
