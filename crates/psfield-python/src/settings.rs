//! What plans are made with.

use psfield::conv_core::PlanOptions;
use psfield::psf_types::{FrameShape, PixelRegion};
use psfield::{DeviceOptions, Method, PsfInput, PsfieldError, SceneLayout, SimulationOptions};

/// What plans are made with.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    /// Of the scene, in its own pixels.
    pub(crate) shape: FrameShape,
    /// In pixels of the image.
    pub(crate) frame: Option<PixelRegion>,
    /// The part of the frame that is made, in pixels of the image counted from the frame's first; none for all of it.
    pub(crate) region: Option<PixelRegion>,
    pub(crate) method: Method,
    pub(crate) simulation: SimulationOptions,
    pub(crate) plan: PlanOptions,
    pub(crate) device: DeviceOptions,
}

impl Settings {
    /// How scenes with an image, or without, lie on the frame.
    pub(crate) fn layout(&self, psf: &PsfInput, of_image: bool) -> Result<SceneLayout, PsfieldError> {
        let (shape, s) = (self.shape, self.simulation.oversample());
        let layout = if of_image {
            SceneLayout::of_image(shape, s)?
        } else {
            SceneLayout::of_frame(shape.nx() / s, shape.ny() / s, s)?
        };
        let reach = psf.reach(self.simulation.stamp_size());
        Ok(layout.with_frame(self.frame).with_reach(reach))
    }
}
