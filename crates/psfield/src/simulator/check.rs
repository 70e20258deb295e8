//! Checks images against the direct sum, and warns of errors that the check cannot see.

use std::fmt;

use conv_core::{ConvReal, Direct, RowStream};
use ndarray::{Array2, ArrayView2};
use psf_types::{Image, PointSource, Progress};

use super::stream::SceneRows;
use super::{Simulator, has_extended_light};
use crate::{PixelPicker, PsfieldError, Scene, SpotCheck};

/// The direct sum keeps the scene of this many rows of the image in memory at once.
const BAND: usize = 512;
/// Galaxies drawn on pixels coarser than a quarter of the frame's are blurred by percents, whatever
/// their size.
const FINE_FOR_GALAXIES: usize = 4;
/// Galaxies with a smaller half-light radius, in pixels of the scene, are blurred by its pixels.
const RESOLVED_PX: f64 = 2.0;
/// Stamps with fewer pixels per frame pixel may be too coarse to be interpolated.
const FINE_ENOUGH: f64 = 2.0;
/// A star at most this far from the centre of a pixel counts as on it.
const ON_PIXEL: f64 = 1e-9;

impl<T: ConvReal> Simulator<T> {
    /// Compares `count` random pixels of an image that this simulator made of `scene` with the
    /// direct sum in f64. `seed` chooses the pixels. The check passes if the difference is within
    /// the limit of the method ([`SpotCheck::limit_of`]).
    ///
    /// # Errors
    /// The errors of [`exact_at`](Self::exact_at).
    pub fn spot_check(
        &self,
        scene: &Scene<'_, T>,
        image: &Image<T>,
        (count, seed): (usize, u64),
        progress: &dyn Progress,
    ) -> Result<SpotCheck, PsfieldError> {
        let check = SpotCheck::run(image, count, seed, |pixels| {
            self.exact_at(scene, pixels, progress)
        })?;
        Ok(self.judged(check, has_extended_light(scene)))
    }

    /// Compares pixels that were picked from the rows of a streamed image
    /// ([`stream`](Self::stream)) with the direct sum. Reads the rows of the scene that it needs
    /// once more.
    ///
    /// # Errors
    /// The errors of the stream and of [`exact_at`](Self::exact_at).
    pub fn spot_check_stream<R: RowStream<T, Error = PsfieldError>>(
        &self,
        scene: &Scene<'_, T>,
        rows: &mut R,
        picker: PixelPicker,
        progress: &dyn Progress,
    ) -> Result<SpotCheck, PsfieldError> {
        let check = SpotCheck::of_picked(picker, |pixels| {
            let mut rows = SceneRows::new(self, scene, rows, progress)?;
            self.exact_by_rows(scene, &mut rows, pixels, progress)
        })?;
        Ok(self.judged(check, true))
    }

    /// Computes single pixels `(column, row)` of the image by the direct sum in f64.
    ///
    /// # Errors
    /// The errors of [`simulate_into`](Self::simulate_into).
    #[inline(never)]
    pub fn exact_at(
        &self,
        scene: &Scene<'_, T>,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        self.check_sources(scene, false)?;
        let mut sums = vec![0.0; pixels.len()];
        if has_extended_light(scene) {
            let convolver = self.convolver(scene, progress)?;
            let (light, first) = self.light(scene, convolver, progress)?;
            sums = self.extended_sums((light.pixels(), first), convolver.padding, pixels, progress)?;
        }
        self.add_star_sums(scene.stars(), pixels, &mut sums)?;
        Ok(sums)
    }

    /// Computes pixels that are sorted by rows. Holds only the rows in memory that they need.
    fn exact_by_rows<R: RowStream<T, Error = PsfieldError>>(
        &self,
        scene: &Scene<'_, T>,
        rows: &mut R,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        let padding = self.padding(scene);
        let shape = self.geometry.padded_shape(padding)?;
        let frame = self.geometry.fine_frame(padding)?;
        let reach = self.image_model()?.0.grid().ny();
        let mut sums = Vec::with_capacity(pixels.len());
        let mut rest = pixels;
        while let Some(&(_, first)) = rest.first() {
            let count = rest.partition_point(|&(_, row)| row < first + BAND);
            let of_scene = |row: usize| frame.y0() as usize + self.geometry.sampled_pixel((0, row)).1;
            let from = of_scene(first).saturating_sub(reach);
            let to = (of_scene(rest[count - 1].1 + 1) + reach).min(shape.ny());
            let mut light = Array2::zeros((to - from, shape.nx()));
            rows.read(from..to, light.view_mut())?;
            sums.extend(self.extended_sums((light.view(), (0, from)), padding, &rest[..count], progress)?);
            rest = &rest[count..];
        }
        self.add_star_sums(scene.stars(), pixels, &mut sums)?;
        Ok(sums)
    }

    /// Sums over a part of the (padded) scene's light, which begins at the given column and row.
    fn extended_sums(
        &self,
        light: (ArrayView2<'_, T>, (usize, usize)),
        padding: usize,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        let (shape, frame) = (
            self.geometry.padded_shape(padding)?,
            self.geometry.fine_frame(padding)?,
        );
        let fine: Vec<_> = pixels
            .iter()
            .map(|&pixel| self.geometry.sampled_pixel(pixel))
            .collect();
        let (direct, area) = (Direct::new(self.options.anchor), self.geometry.pixel_area());
        let mut sums = direct.at_pixels(self.image_model()?.0, light, shape, frame, &fine, progress)?;
        for sum in &mut sums {
            *sum *= area;
        }
        Ok(sums)
    }

    fn add_star_sums(
        &self,
        stars: &[PointSource],
        pixels: &[(usize, usize)],
        sums: &mut [f64],
    ) -> Result<(), PsfieldError> {
        if stars.is_empty() {
            return Ok(());
        }
        let (x0, y0) = (
            self.geometry.region.x0() as usize,
            self.geometry.region.y0() as usize,
        );
        let of_frame: Vec<_> = pixels.iter().map(|&(x, y)| (x + x0, y + y0)).collect();
        let values = self.painter(&self.stars()?.model)?.at_pixels(stars, &of_frame)?;
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        Ok(())
    }

    fn judged(&self, check: SpotCheck, of_image: bool) -> SpotCheck {
        match SpotCheck::limit_of::<T>(&self.options, of_image) {
            Some(limit) => check.judged(limit),
            None => check,
        }
    }

    /// Returns a warning if scenes of this kind need stamps that are interpolated between their own
    /// pixels. `rows` is that of [`prepare`](Self::prepare).
    ///
    /// # Errors
    /// [`ErrorKind::Data`](crate::ErrorKind::Data) for a stamp size of 0.
    pub fn psf_warning(
        &self,
        scene: &Scene<'_, T>,
        rows: bool,
    ) -> Result<Option<SimulationWarning>, PsfieldError> {
        let (options, stars_alone) = (&self.options, !rows && !has_extended_light(scene));
        let picked =
            stars_alone || options.oversample > 1 || self.psf().native_is_exact(options.stamp_size)?;
        Ok((!picked).then_some(SimulationWarning::InterpolatedStamps))
    }

    /// Returns warnings about a scene's stars and galaxies.
    pub fn warnings(&self, scene: &Scene<'_, T>) -> Vec<SimulationWarning> {
        let mut warnings = Vec::new();
        let off = |v: f64| (v - v.round()).abs() > ON_PIXEL;
        let between = |star: &PointSource| off(star.position().x()) || off(star.position().y());
        if self.psf().grid().oversampling() < FINE_ENOUGH && scene.stars().iter().any(between) {
            warnings.push(SimulationWarning::StarsBetweenPixels);
        }
        let s = self.geometry.oversample;
        // A PSF of a single pixel blurs nothing a second time.
        let is_pixel = self.psf().grid().pixel_count() == 1;
        let blurred = scene.galaxies().iter().filter(|galaxy| {
            s < FINE_FOR_GALAXIES || galaxy.profile().half_light_radius_px() * (s as f64) < RESOLVED_PX
        });
        let count = blurred.count();
        if count > 0 && !is_pixel {
            warnings.push(SimulationWarning::BlurredGalaxies { count });
        }
        warnings
    }
}

/// Warns of an error that no check of the simulation can see. Its text says how to avoid it, where
/// that is possible.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SimulationWarning {
    /// An image is convolved with stamps that were interpolated.
    InterpolatedStamps,
    /// Stars are drawn between the pixels of stamps that are too coarse for it.
    StarsBetweenPixels,
    /// Galaxies are blurred by the pixels on which they are drawn.
    BlurredGalaxies {
        /// Number of galaxies.
        count: usize,
    },
}

impl SimulationWarning {
    /// The field of [`SimulateOptions`](crate::SimulateOptions) that avoids the error, if one does.
    pub fn setting(&self) -> Option<&'static str> {
        matches!(self, Self::BlurredGalaxies { .. }).then_some("oversample")
    }
}

impl fmt::Display for SimulationWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::InterpolatedStamps => f.write_str(
                "the PSF stamps are not sampled at the centres of the image's pixels, or lack the pixel response: they are \
                 interpolated",
            ),
            Self::StarsBetweenPixels => f.write_str(
                "stars lie between pixels, and the PSF stamps are not oversampled at least twice: the stamps are \
                 interpolated, which is wrong by percents where the PSF is under-sampled. The spot check does not see \
                 that",
            ),
            Self::BlurredGalaxies { count } => write!(
                f,
                "{count} galaxies are blurred a second time by the scene pixels on which they are drawn (by 3 % of \
                 their peak in the median, more where they are small). The spot check does not see that. Draw them on \
                 finer pixels: at least {FINE_FOR_GALAXIES} along each side of a frame pixel, and {RESOLVED_PX} per \
                 half-light radius"
            ),
        }
    }
}
