//! Checks images against the direct sum.

use conv_core::{ConvError, ConvReal, Direct, GalaxyErrors, RowStream, ScenePixelFilter};
use ndarray::{Array2, ArrayView2, s};
use psf_types::{Anchor, Image, PointSource, Position, Progress};
use rand::seq::IteratorRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::Simulator;
use super::sources::{has_sources, light_of};
use super::stream::SceneRows;
use crate::spot_check::{Allowed, rounding_of};
use crate::{Method, PixelPicker, PsfieldError, Scene, ScenePixels, SpotCheck};

/// A spot check compares the pixels around at most this many stars, galaxies, and pixels of the
/// scene's image.
const SOURCES: usize = 32;
/// Stars that are spread over planes keep the light beyond the reach of their stamps, up to this part of
/// their flux ([`conv_core::edge_reach_of`]). Stars that are drawn one by one do not.
const BEYOND_STAMPS: f64 = 5e-7;
/// Plans for stars add up at most so many stars of one place in the working precision.
const GROUP: usize = 2048;
/// The largest number of image rows whose light a streamed check keeps in memory at once.
const BAND: usize = 512;

impl<T: ConvReal> Simulator<T> {
    /// Compares `count` random pixels of an image that this simulator made of `scene`, and the pixels
    /// around random sources, with the direct sum in f64 ([`SpotCheck`]). `seed` chooses them.
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
        let mut picker = self.picker(scene, false, (count, seed));
        for row in image.pixels().outer_iter() {
            picker.pass(row.iter().map(|v| v.as_f64()));
        }
        SpotCheck::of_picked::<T>(picker, |pixels| {
            let exact = self.exact_at(scene, pixels, progress)?;
            let mut allowed = self.promised(scene.image().is_some(), pixels.len());
            if let Some(allowed) = &mut allowed {
                if let Some(image) = scene.image() {
                    let (light, first) = self.light(image, progress)?;
                    self.add_errors_of_image((light.pixels(), first), pixels, allowed)?;
                }
                self.add_errors_of_sources(scene, pixels, allowed)?;
            }
            Ok((exact, allowed))
        })
    }

    /// Compares pixels that the [`picker`](Self::picker) has chosen from the rows of a streamed
    /// image ([`stream`](Self::stream)) with the direct sum. Reads the necessary rows of the scene
    /// again.
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
        SpotCheck::of_picked::<T>(picker, |pixels| {
            let mut allowed = self.promised(true, pixels.len());
            let mut rows = SceneRows::new(vec![(self, scene.sources())], rows, progress);
            let exact = self.exact_by_rows(scene, &mut rows, pixels, allowed.as_deref_mut(), progress)?;
            if let Some(allowed) = &mut allowed {
                self.add_errors_of_sources(scene, pixels, allowed)?;
            }
            Ok((exact, allowed))
        })
    }

    /// Picks the pixels that a check of an image of `scene` compares: `count` random pixels, and
    /// the pixels around random sources. `seed` chooses them. `rows` has the meaning that it has in
    /// [`prepare`](Self::prepare). If it is true, the pixels of the scene's image are chosen without
    /// regard to their light.
    pub fn picker(&self, scene: &Scene<'_, T>, rows: bool, (count, seed): (usize, u64)) -> PixelPicker {
        let shape = self.image_shape();
        let (frame, region) = (self.geometry.frame, self.geometry.region);
        let (x0, y0) = (frame.x0() + region.x0(), frame.y0() + region.y0());
        let inside =
            |&(x, y): &(i64, i64)| (0..shape.nx() as i64).contains(&x) && (0..shape.ny() as i64).contains(&y);
        let pixel = |at: Position| (at.x().round() as i64 - x0, at.y().round() as i64 - y0);
        let stars = scene.stars().iter().map(|star| pixel(star.position()));
        let galaxies = scene.galaxies().iter().map(|galaxy| pixel(galaxy.position()));
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut sources = stars.filter(inside).sample(&mut rng, SOURCES);
        sources.extend(galaxies.filter(inside).sample(&mut rng, SOURCES));
        if let Some(image) = scene.image().filter(|image| image.shape() == self.geometry.shape) {
            // Half of these are chosen by their light.
            let mut of_scene = PixelPicker::new(image.shape(), SOURCES, seed);
            for row in image.pixels().outer_iter() {
                of_scene.pass(row.iter().map(|v| v.as_f64()));
            }
            let place = |v: usize, first: i64| (v / self.geometry.oversample) as i64 - first;
            let picked = of_scene.finish().0;
            sources.extend(
                picked
                    .iter()
                    .map(|p| (place(p.column, x0), place(p.row, y0)))
                    .filter(inside),
            );
        } else if rows {
            let any = |_| {
                (
                    rng.random_range(0..shape.nx()) as i64,
                    rng.random_range(0..shape.ny()) as i64,
                )
            };
            sources.extend((0..SOURCES).map(any));
        }
        PixelPicker::new(shape, count, seed).with_sources(&sources, shape)
    }

    /// Computes single pixels `(column, row)` of the image by the direct sum in f64.
    ///
    /// # Errors
    /// The errors of [`simulate_into`](Self::simulate_into). If the scene has an image,
    /// also [`ErrorKind::Convolution`](crate::ErrorKind::Convolution) for a pixel outside the
    /// frame.
    #[inline(never)]
    pub fn exact_at(
        &self,
        scene: &Scene<'_, T>,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        self.check_sources(scene, false)?;
        let mut sums = vec![0.0; pixels.len()];
        if let Some(image) = scene.image() {
            let (light, first) = self.light(image, progress)?;
            sums = self.image_sums((light.pixels(), first), pixels, progress)?;
        }
        self.add_source_sums(scene, pixels, &mut sums, progress)?;
        Ok(sums)
    }

    /// Computes pixels of the image of a streamed scene. The pixels are sorted by rows. Only the
    /// scene's rows that they need are in memory. If `allowed` is given, adds the errors that the
    /// scene's image may have in these pixels.
    pub(super) fn exact_by_rows<R: RowStream<T, Error = PsfieldError>>(
        &self,
        scene: &Scene<'_, T>,
        rows: &mut R,
        pixels: &[(usize, usize)],
        mut allowed: Option<&mut [Allowed]>,
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        let shape = self.geometry.shape;
        let frame = self.geometry.fine(self.geometry.frame)?;
        let reach = self.image_model()?.0.grid().ny();
        let mut sums = Vec::with_capacity(pixels.len());
        let mut rest = pixels;
        while let Some(&(_, first)) = rest.first() {
            let count = rest.partition_point(|&(_, row)| row < first + BAND);
            let of_scene = |row: usize| frame.y0() as usize + self.geometry.sampled_pixel((0, row)).1;
            let from = of_scene(first).saturating_sub(reach);
            let to = (of_scene(rest[count - 1].1 + 1) + reach).min(shape.ny());
            let mut light = Array2::zeros((to - from, shape.nx()));
            rows.read(0, from..to, light.view_mut())?;
            let part = (light.view(), (0, from));
            if let Some(allowed) = &mut allowed {
                let of_band = &mut allowed[sums.len()..sums.len() + count];
                self.add_errors_of_image(part, &rest[..count], of_band)?;
            }
            sums.extend(self.image_sums(part, &rest[..count], progress)?);
            rest = &rest[count..];
        }
        self.add_source_sums(scene, pixels, &mut sums, progress)?;
        Ok(sums)
    }

    /// Returns the direct sums at pixels of the image. `light` is a part of the scene's image,
    /// and the column and row at which it begins.
    fn image_sums(
        &self,
        light: (ArrayView2<'_, T>, (usize, usize)),
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, PsfieldError> {
        let (shape, frame) = (self.geometry.shape, self.geometry.fine(self.geometry.frame)?);
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

    /// Adds the light of stars and galaxies in pixels of the image.
    fn add_source_sums(
        &self,
        scene: &Scene<'_, T>,
        pixels: &[(usize, usize)],
        sums: &mut [f64],
        progress: &dyn Progress,
    ) -> Result<(), PsfieldError> {
        if !has_sources(scene) {
            return Ok(());
        }
        let (of_frame, sources) = (self.of_frame(pixels), self.sources()?);
        let stars = self
            .painter(&sources.model)?
            .at_pixels(scene.stars(), &of_frame)?;
        let (galaxies, frame) = (scene.galaxies(), self.geometry.frame);
        let galaxies = sources
            .galaxies
            .at_pixels(galaxies, &light_of, frame, &of_frame, progress)?;
        for ((sum, star), galaxy) in sums.iter_mut().zip(stars).zip(galaxies) {
            *sum += star + galaxy;
        }
        Ok(())
    }

    /// The errors that the method promises for some pixels, before any source is added. None for
    /// patches and for the caller's own method if the scene has an image, because they promise
    /// nothing for it.
    pub(super) fn promised(&self, of_image: bool, pixels: usize) -> Option<Vec<Allowed>> {
        let nothing = of_image && matches!(self.options.method, Method::Patch(_) | Method::Own);
        (!nothing).then(|| vec![Allowed::default(); pixels])
    }

    /// The tolerance of a plan. 0 for methods without a plan.
    fn tolerance(&self) -> Result<f64, PsfieldError> {
        Ok(self.planned()?.map_or(0.0, |options| options.tolerance()))
    }

    /// Adds the largest errors that the scene's image may have in pixels of the image. `light` is a
    /// part of the scene's image, and the column and row at which it begins.
    pub(super) fn add_errors_of_image(
        &self,
        (light, (x0, y0)): (ArrayView2<'_, T>, (usize, usize)),
        pixels: &[(usize, usize)],
        allowed: &mut [Allowed],
    ) -> Result<(), PsfieldError> {
        let (tolerance, grid) = (self.tolerance()?, self.image_model()?.0.grid());
        if tolerance == 0.0 {
            return Ok(());
        }
        let galaxies = &self.sources()?.galaxies;
        // The filter that takes the scene's pixels out increases the norm of the PSF.
        let of_filter = match self.options.scene_pixels {
            ScenePixels::Point => 1.0,
            ScenePixels::Integrated => ScenePixelFilter::LARGEST_FACTOR,
        };
        let (frame, oversample) = (self.geometry.fine(self.geometry.frame)?, self.geometry.oversample);
        let near = |at: usize, first: i64, start: usize, reach: usize, length: usize| {
            let at = at as i64 + first - start as i64;
            let within = |v: i64| v.clamp(0, length as i64) as usize;
            within(at - reach as i64)..within(at + reach as i64 + 1)
        };
        let of_frame = self.of_frame(pixels);
        for ((&pixel, &of_frame), allowed) in pixels.iter().zip(&of_frame).zip(allowed) {
            let (column, row) = self.geometry.sampled_pixel(pixel);
            let columns = near(column, frame.x0(), x0, grid.nx(), light.ncols());
            let rows = near(row, frame.y0(), y0, grid.ny(), light.nrows());
            // Where the PSF is not known, nothing is promised.
            let norm = galaxies
                .psf_norm(Position::of_pixel(of_frame.0 as i64, of_frame.1 as i64))
                .unwrap_or(f64::INFINITY);
            // An error in one pixel of the frame may be all of the error on the finer pixels.
            let error = tolerance * norm * of_filter * oversample as f64;
            let mut root = 0.0;
            for &light in light
                .slice(s![rows, columns])
                .iter()
                .filter(|light| **light != T::zero())
            {
                allowed.add_psf(error * light.as_f64().abs(), &mut root);
            }
            allowed.root += root;
        }
        Ok(())
    }

    /// Adds the largest errors that stars and galaxies may have in pixels of the image.
    pub(super) fn add_errors_of_sources(
        &self,
        scene: &Scene<'_, T>,
        pixels: &[(usize, usize)],
        allowed: &mut [Allowed],
    ) -> Result<(), PsfieldError> {
        if !has_sources(scene) {
            return Ok(());
        }
        let (of_frame, sources, tolerance) = (self.of_frame(pixels), self.sources()?, self.tolerance()?);
        let (galaxies, frame, rounding) = (&sources.galaxies, self.geometry.frame, rounding_of::<T>());
        let places = stars_by_place(scene.stars());
        let first_stars: Vec<PointSource> = places.iter().map(|place| place.first).collect();
        let mut roots = vec![0.0; pixels.len()];
        let mut failed = None;
        let painter = self.painter(&sources.model)?;
        painter.lit_pixels(&first_stars, &of_frame, |number, lit| {
            let place = &places[number];
            let (x, y) = (place.first.position().x(), place.first.position().y());
            let at = Position::new(x - frame.x0() as f64, y - frame.y0() as f64);
            match at.map_err(ConvError::Result).and_then(|at| galaxies.psf_norm(at)) {
                Ok(norm) => {
                    // Numbers of equal size that are added in one pixel may all be rounded in one
                    // direction.
                    let added = 0.25 * self.additions(place.count) as f64 * T::epsilon().as_f64();
                    let error = (tolerance + rounding + added) * norm * place.light;
                    for (pixel, is_on_stamp) in lit {
                        if is_on_stamp {
                            allowed[pixel].add_psf(error, &mut roots[pixel]);
                        } else if tolerance > 0.0 {
                            let left = (BEYOND_STAMPS * place.light).min(error);
                            allowed[pixel].add_psf(left, &mut roots[pixel]);
                        }
                    }
                }
                Err(error) => failed = Some(error),
            }
        });
        failed.map_or(Ok(()), Err)?;
        for (allowed, root) in allowed.iter_mut().zip(roots) {
            allowed.root += root;
        }
        let of_pixels = (frame, of_frame.as_slice());
        let take = |pixel: usize, errors: GalaxyErrors| allowed[pixel].add_galaxy(errors);
        Ok(galaxies.errors_at_pixels(scene.galaxies(), &light_of, of_pixels, rounding, take)?)
    }

    /// The most numbers that are added one by one for so many stars in one pixel.
    fn additions(&self, stars: usize) -> usize {
        match self.options.anchor {
            Anchor::Output => stars,
            _ => stars.min(GROUP),
        }
    }

    /// Converts pixels of the image to pixels of the frame.
    fn of_frame(&self, pixels: &[(usize, usize)]) -> Vec<(usize, usize)> {
        let region = self.geometry.region;
        let (x0, y0) = (region.x0() as usize, region.y0() as usize);
        pixels.iter().map(|&(x, y)| (x + x0, y + y0)).collect()
    }
}

/// The stars in one pixel.
struct Place {
    first: PointSource,
    /// The sum of their absolute fluxes.
    light: f64,
    count: usize,
}

/// The stars of each pixel, sorted by rows.
fn stars_by_place(stars: &[PointSource]) -> Vec<Place> {
    let pixel = |star: &PointSource| {
        (
            star.position().y().round() as i64,
            star.position().x().round() as i64,
        )
    };
    let mut sorted = stars.to_vec();
    sorted.sort_by_key(pixel);
    sorted
        .chunk_by(|a, b| pixel(a) == pixel(b))
        .map(|stars| Place {
            first: stars[0],
            light: stars.iter().map(|star| star.flux().abs()).sum(),
            count: stars.len(),
        })
        .collect()
}

/// A scene with the stars and galaxies of several scenes.
pub(super) fn with_all_sources<'a, 's, 'l: 's, T: ConvReal>(
    all: Scene<'a, T>,
    scenes: impl Iterator<Item = &'s Scene<'l, T>> + Clone,
) -> Scene<'a, T> {
    let stars: Vec<_> = scenes.clone().flat_map(Scene::stars).copied().collect();
    let galaxies: Vec<_> = scenes.flat_map(Scene::galaxies).copied().collect();
    all.with_stars(stars).with_galaxies(galaxies)
}

/// Compares the sum of the images of several scenes, each by its own simulator, with the direct sum, as
/// [`Simulator::spot_check`]. The simulators have equal settings.
pub(crate) fn spot_check_layers<'a, T: ConvReal>(
    layers: &[(&'a Simulator<T>, &'a Scene<'_, T>)],
    image: &Image<T>,
    pixels: (usize, u64),
    progress: &dyn Progress,
) -> Result<SpotCheck, PsfieldError> {
    let scenes = layers.iter().map(|(_, scene)| *scene);
    let any_image = scenes.clone().find_map(Scene::image);
    let all = any_image.map_or_else(Scene::dark, |image| Scene::from(image.view()));
    let all = with_all_sources(all, scenes);
    let first = layers[0].0;
    let mut picker = first.picker(&all, false, pixels);
    for row in image.pixels().outer_iter() {
        picker.pass(row.iter().map(|v| v.as_f64()));
    }
    SpotCheck::of_picked::<T>(picker, |pixels| {
        let mut exact = vec![0.0; pixels.len()];
        let mut allowed = first.promised(any_image.is_some(), pixels.len());
        for (simulator, scene) in layers {
            let of_layer = simulator.exact_at(scene, pixels, progress)?;
            exact
                .iter_mut()
                .zip(of_layer)
                .for_each(|(sum, value)| *sum += value);
            if let Some(allowed) = &mut allowed {
                if let Some(image) = scene.image() {
                    simulator.add_errors_of_image((image.pixels(), (0, 0)), pixels, allowed)?;
                }
                simulator.add_errors_of_sources(scene, pixels, allowed)?;
            }
        }
        Ok((exact, allowed))
    })
}
