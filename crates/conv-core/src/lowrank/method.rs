//! The engine as a convolution method.

use ndarray::Array2;
use psf_types::{Image, NoProgress, Progress, PsfModel, Scene};

use super::options::PlanOptions;
use super::plan::Plan;
use crate::stars::StarPlan;
use crate::{ConvError, ConvReal, ConvolutionMethod};

/// The fast engine, planned anew for each scene; keep a [`Plan`] for many scenes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LowRank {
    options: PlanOptions,
}

impl LowRank {
    /// The engine with a tolerance and the other options.
    pub fn new(options: PlanOptions) -> Self {
        Self { options }
    }
}

impl<T: ConvReal> ConvolutionMethod<T> for LowRank {
    fn convolve(&self, model: &PsfModel, scene: &Scene<T>) -> Result<Image<T>, ConvError> {
        self.convolve_with_progress(model, scene, &NoProgress)
    }

    fn convolve_with_progress(
        &self,
        model: &PsfModel,
        scene: &Scene<T>,
        progress: &dyn Progress,
    ) -> Result<Image<T>, ConvError> {
        if scene.image().is_none() {
            let shape = scene.frame().shape();
            let mut image = Array2::zeros((shape.ny(), shape.nx()));
            let stars = StarPlan::new(model, self.options, None)?;
            stars.add_to_region(scene, shape.region(), image.view_mut(), progress)?;
            return Image::new(image).map_err(ConvError::Result);
        }
        let plan = Plan::for_scene(model, scene, self.options)?;
        Ok(plan.execute_with_progress(scene, progress)?.0)
    }
}
