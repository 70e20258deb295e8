//! Executions of a simulation's plans.

use conv_core::{ConvError, ConvReal, Plan, RowStream, TileCounts};
use ndarray::{Array2, ArrayViewMut2};
use psf_types::{FrameShape, Image, ImageView, PixelRegion, Progress, Scene};

use super::Simulation;
use crate::finer_scene::{FinerRows, FinerScene, spread};
use crate::{PsfieldError, SimulationPlan};

impl Simulation {
    /// The image of a scene by a plan of this simulation, and how its tiles were treated.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn run_planned<T: ConvReal>(
        &self,
        plan: &SimulationPlan<T>,
        scene: &Scene<T>,
        progress: &dyn Progress,
    ) -> Result<(Image<T>, TileCounts), PsfieldError> {
        let mut image = match plan.engine() {
            Some(engine) if self.options.oversample() == 1 => engine.dark_image(),
            _ => {
                let finer = FinerScene::new(self.options.oversample(), scene)?;
                let shape = plan.region_of(finer.stars().frame().shape()).shape();
                Array2::zeros((shape.ny(), shape.nx()))
            }
        };
        let light = scene.image().map(Image::view);
        let counts = self.add_planned_to(plan, scene, light.as_ref(), image.view_mut(), progress)?;
        Ok((Image::new(image)?, counts))
    }

    /// Adds the image of a scene to one that belongs to somebody else, from light that does. `scene` gives the shape, the frame and the point
    /// sources of the whole; its image is not looked at. `light` is `[y, x]` of the scene, or of its part that reaches the image
    /// ([`SimulationPlan::light_region`]); `image` is `[y, x]` of the frame, or of the plan's region of it, in the frame's own pixels.
    ///
    /// Nothing is copied where the pixels of each row are neighbours in memory and the scene is not finer than the frame.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`]: shapes that do not fit, light where there is no PSF, and [`ConvError::Cancelled`],
    /// after which the image is left half done. [`PsfieldError::PlanForStars`] for light where the plan is for stars alone.
    pub fn add_planned_to<T: ConvReal>(
        &self,
        plan: &SimulationPlan<T>,
        scene: &Scene<T>,
        light: Option<&ImageView<'_, T>>,
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        let finer = FinerScene::new(self.options.oversample(), scene)?;
        if let Some(engine) = plan.engine() {
            engine.check_scene(scene)?;
        }
        let region = plan.region_of(finer.stars().frame().shape());
        let expected = region.shape();
        if image.dim() != (expected.ny(), expected.nx()) {
            let got = FrameShape::new(image.ncols(), image.nrows())?;
            return Err(ConvError::FrameShape { expected, got }.into());
        }
        let counts = match (light, plan.engine()) {
            (None, _) => TileCounts::default(),
            (Some(_), None) => return Err(PsfieldError::PlanForStars),
            (Some(light), Some(engine)) if self.options.oversample() == 1 => {
                engine.add_light_to(light, image.view_mut(), progress)?
            }
            (Some(light), Some(engine)) => {
                let mut fine = engine.dark_image();
                let counts = engine.add_light_to(light, fine.view_mut(), progress)?;
                finer.add_sampled(&fine, image.view_mut());
                counts
            }
        };
        plan.stars()
            .add_to_region(finer.stars(), region, image, progress)?;
        Ok(counts)
    }

    /// Adds the stars of a scene to a region of the frame, in the frame's own pixels; what a pixel gets does not depend on the region. `plan` may be for
    /// stars alone.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`]: an image of another shape than the region, a star where there is no PSF, and [`ConvError::Cancelled`].
    pub fn add_stars_to_region<T: ConvReal>(
        &self,
        plan: &SimulationPlan<T>,
        scene: &Scene<T>,
        region: PixelRegion,
        image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<(), PsfieldError> {
        let finer = FinerScene::new(self.options.oversample(), scene)?;
        Ok(plan
            .stars()
            .add_to_region(finer.stars(), region, image, progress)?)
    }

    /// The transpose of [`Self::add_planned_to`] without stars: what each pixel of the scene gives to the scalar product of its image with `image`,
    /// `[y, x]` of the frame, or of the plan's region of it, in the frame's own pixels. `<A f, g> = <f, A^T g>` for every scene `f` without
    /// point sources; of a finer scene, `A` convolves and then samples at the centres of the frame's pixels, times their area in pixels of
    /// the scene.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`] for an image of another shape; [`PsfieldError::PlanForStars`] where the plan is for stars alone.
    pub fn adjoint_planned<T: ConvReal>(
        &self,
        plan: &SimulationPlan<T>,
        image: &ImageView<'_, T>,
        progress: &dyn Progress,
    ) -> Result<Image<T>, PsfieldError> {
        let engine = self.engine_for_image(plan, image.shape())?;
        self.on_scene_pixels(image, |image| engine.adjoint_with_progress(image, progress))
    }

    /// Adds the same transpose to a plane that belongs to somebody else, `[y, x]` of the scene or of its part that reaches the image
    /// ([`SimulationPlan::light_region`]).
    ///
    /// # Errors
    /// As [`Self::adjoint_planned`]; where it was cancelled, the plane is left half done.
    pub fn add_adjoint_planned_to<T: ConvReal>(
        &self,
        plan: &SimulationPlan<T>,
        image: &ImageView<'_, T>,
        light: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        let engine = self.engine_for_image(plan, image.shape())?;
        self.on_scene_pixels(image, |image| engine.add_adjoint_to(image, light, progress))
    }

    /// Work on an image at the pixels of the scene, where these are finer.
    fn on_scene_pixels<T: ConvReal, R>(
        &self,
        image: &ImageView<'_, T>,
        work: impl FnOnce(&ImageView<'_, T>) -> Result<R, ConvError>,
    ) -> Result<R, PsfieldError> {
        match self.options.oversample() {
            1 => Ok(work(image)?),
            finer => Ok(work(&spread(finer, image)?.view())?),
        }
    }

    /// The engine of a plan, for an image in the frame's own pixels.
    fn engine_for_image<'a, T: ConvReal>(
        &self,
        plan: &'a SimulationPlan<T>,
        got: FrameShape,
    ) -> Result<&'a Plan<T>, PsfieldError> {
        let engine = plan.engine().ok_or(PsfieldError::PlanForStars)?;
        let (fine, finer) = (engine.region().shape(), self.options.oversample());
        let expected = FrameShape::new(fine.nx() / finer, fine.ny() / finer)?;
        if got == expected {
            Ok(engine)
        } else {
            Err(ConvError::FrameShape { expected, got }.into())
        }
    }

    /// The image of a scene whose rows come and go through a stream, as by [`Self::run_planned`]; `scene` gives the shape, the frame and the point
    /// sources. A plan of a region reads the rows that reach it and writes those of the region.
    ///
    /// # Errors
    /// Those of the stream and of the convolution.
    pub fn stream<T: ConvReal, R: RowStream<T>>(
        &self,
        plan: &SimulationPlan<T>,
        scene: &Scene<T>,
        stream: &mut R,
        progress: &dyn Progress,
    ) -> Result<TileCounts, R::Error>
    where
        R::Error: From<PsfieldError>,
    {
        let finer = FinerScene::new(self.options.oversample(), scene)?;
        let engine = plan.engine().ok_or(PsfieldError::NothingToStream)?;
        let dark = scene.clone().with_sources(Vec::new());
        let mut rows = FinerRows::new(stream, &finer, plan, progress);
        engine.stream(&dark, None, &mut rows, progress)
    }
}
