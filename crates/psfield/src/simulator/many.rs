//! Many scenes at once.

use conv_core::{ConvReal, Operation};
use ndarray::{Array2, Array3, ArrayViewMut2};
use psf_types::{Image, ImageView, NoProgress, Progress, Uncounted};

use super::{ADJOINT, Simulator};
use crate::error::PsfieldError;
use crate::scene::Scene;

impl<T: ConvReal> Simulator<T> {
    /// Returns the images of many scenes. They are equal, bit by bit, to those of
    /// [`simulate`](Self::simulate). For many small scenes of one layer this is faster, because threads work
    /// on different scenes. Stars and galaxies are drawn scene by scene.
    ///
    /// # Errors
    /// The errors of [`simulate_into`](Self::simulate_into).
    pub fn simulate_many(&self, scenes: &[Scene<'_, T>]) -> Result<Vec<Image<T>>, PsfieldError> {
        // Check the scenes before memory is allocated.
        for scene in scenes {
            self.check_scene(scene)?;
        }
        let mut images: Vec<Array2<T>> = scenes.iter().map(|_| self.zeros()).collect();
        let views = images.iter_mut().map(|image| image.view_mut()).collect();
        self.simulate_many_into(scenes, views, &NoProgress)?;
        images.into_iter().map(|image| Ok(Image::new(image)?)).collect()
    }

    /// Adds the images of many scenes to `images`, as [`simulate_into`](Self::simulate_into) adds
    /// one. `progress` counts the scenes whose images are convolved. Stars and galaxies are drawn
    /// afterwards, scene by scene.
    ///
    /// # Errors
    /// The errors of [`simulate_into`](Self::simulate_into).
    ///
    /// # Panics
    /// If there is not one image for each scene.
    #[inline(never)]
    pub fn simulate_many_into(
        &self,
        scenes: &[Scene<'_, T>],
        mut images: Vec<ArrayViewMut2<'_, T>>,
        progress: &dyn Progress,
    ) -> Result<(), PsfieldError> {
        assert_eq!(scenes.len(), images.len(), "an image for each scene");
        for (scene, image) in scenes.iter().zip(&images) {
            self.check_scene(scene)?;
            self.check_image(image.dim())?;
        }
        let alone = |scene: &Scene<'_, T>| scene.layers().len() == 1 && scene.has_image();
        let at_once = self.setup.geometry.oversample == 1 && !scenes.is_empty() && scenes.iter().all(alone);
        let at_once = at_once && !self.has_wings()?;
        let convolver = at_once.then(|| self.convolver(&[0], progress)).transpose()?;
        let Some(engine) = convolver.as_ref().and_then(|convolver| convolver.engine.as_ref()) else {
            progress.start(scenes.len() as u64);
            for (scene, image) in scenes.iter().zip(images) {
                self.simulate_into(scene, image, &Uncounted(progress))?;
                progress.advance(1);
            }
            return Ok(());
        };
        let mut lights = Vec::with_capacity(scenes.len());
        for scene in scenes {
            lights.extend(self.lights(scene, progress)?);
        }
        let views = images.iter_mut().map(|image| image.view_mut()).collect();
        engine.execute_many(Operation::Convolve, &lights, views, progress)?;
        for (scene, image) in scenes.iter().zip(images) {
            self.draw_sources_into(scene, self.setup.geometry.region, image, &Uncounted(progress))?;
        }
        Ok(())
    }

    /// Computes [`adjoint`](Self::adjoint) for many images through a PSF of one state, `[image, y, x]`. For many
    /// small images this is faster, because threads work on different images.
    ///
    /// # Errors
    /// [`ErrorKind::Setting`](crate::ErrorKind::Setting) for a PSF of several states, and the errors of
    /// [`adjoint`](Self::adjoint).
    pub fn adjoint_many(
        &self,
        images: &[ImageView<'_, T>],
        progress: &dyn Progress,
    ) -> Result<Array3<T>, PsfieldError> {
        for image in images {
            self.check_image(image.pixels().dim())?;
        }
        if self.layer_count() > 1 {
            return Err(self.psf().several_states());
        }
        let shape = self.adjoint_shape(progress)?;
        let rows = conv_core::zeros((images.len() * shape.ny(), shape.nx()));
        let lights = rows.into_shape_with_order((images.len(), shape.ny(), shape.nx()));
        let mut lights = lights.expect("row-major");
        if self.setup.geometry.oversample > 1 || self.has_wings()? {
            progress.start(images.len() as u64);
            for (image, mut light) in images.iter().zip(lights.outer_iter_mut()) {
                light.assign(&self.adjoint(image, &Uncounted(progress))?[0].pixels());
                progress.advance(1);
            }
            return Ok(lights);
        }
        let convolver = self.convolver(&self.shared.layers_of_images(), progress)?;
        let engine = convolver.engine_for(ADJOINT)?;
        engine.execute_many(
            Operation::Adjoint,
            images,
            lights.outer_iter_mut().collect(),
            progress,
        )?;
        for light in lights.outer_iter() {
            // `new` checks that every pixel is finite.
            ImageView::new(light)?;
        }
        Ok(lights)
    }
}
