//! Single pixels by the direct sum.

use conv_core::{ConvReal, Direct};
use ndarray::ArrayView2;
use psf_types::{Anchor, ImageView, NoProgress, Progress, Scene};

use super::Simulation;
use crate::PsfieldError;
use crate::finer_scene::FinerScene;

impl Simulation {
    /// Single pixels `(column, row)` of the image by the direct sum in double precision.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn exact_at<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        anchor: Anchor,
        pixels: &[(usize, usize)],
    ) -> Result<Vec<f64>, PsfieldError> {
        let part = scene.pixels().map(|light| (light, (0, 0)));
        self.exact_sums(scene, part, (anchor, pixels), &NoProgress)
    }

    /// The same from light that belongs to somebody else: all of the scene's, or a part of it that reaches the pixels, with the column and the row
    /// of the scene that it begins at. `scene` gives the shape, the frame and the point sources. One step a pixel.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn exact_at_part<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        part: Option<(&ImageView<'_, T>, (usize, usize))>,
        anchor: Anchor,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        let light = part.map(|(light, first)| (light.pixels(), first));
        self.exact_sums(scene, light, (anchor, pixels), progress)
    }

    /// The same where only some rows of the scene's image are at hand, with the number of the first of them: all that reach the
    /// pixels ([`Self::rows_reaching`]). `scene` gives the shape, the frame and the point sources.
    ///
    /// # Errors
    /// [`PsfieldError::Convolution`].
    pub fn exact_at_rows<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        rows: Option<(ArrayView2<'_, T>, usize)>,
        anchor: Anchor,
        pixels: &[(usize, usize)],
    ) -> Result<Vec<f64>, PsfieldError> {
        let part = rows.map(|(light, first_row)| (light, (0, first_row)));
        self.exact_sums(scene, part, (anchor, pixels), &NoProgress)
    }

    /// The values of single pixels from a part of the light and the column and row that it begins at.
    fn exact_sums<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        part: Option<(ArrayView2<'_, T>, (usize, usize))>,
        (anchor, pixels): (Anchor, &[(usize, usize)]),
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        let finer = FinerScene::new(self.options.oversample(), scene)?;
        let dark = Scene::<T>::dark(scene.shape()).with_frame(scene.frame())?;
        let of_scene: Vec<(usize, usize)> = pixels.iter().map(|&pixel| finer.sampled_pixel(pixel)).collect();
        let mut sums = if part.is_some() {
            Direct::new(anchor).at_pixels_of_part(&self.model, &dark, part, &of_scene, progress)?
        } else {
            vec![0.0; pixels.len()]
        };
        let stars = self
            .painter(finer.stars(), anchor)?
            .at_pixels(finer.stars().sources(), pixels)?;
        for (sum, star) in sums.iter_mut().zip(stars) {
            *sum = *sum * finer.pixel_area() + star;
        }
        Ok(sums)
    }

    /// The rows of a scene that reach some rows of the image.
    pub fn rows_reaching<T: ConvReal>(
        &self,
        scene: &Scene<T>,
        rows: std::ops::RangeInclusive<usize>,
    ) -> std::ops::Range<usize> {
        let reach = self.model.grid().ny();
        let of_scene = |row: usize| scene.frame().y0() as usize + row * self.options.oversample();
        let last = of_scene(rows.end() + 1) + reach;
        of_scene(*rows.start()).saturating_sub(reach)..last.min(scene.shape().ny())
    }
}
