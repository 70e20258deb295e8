//! Checks images against the direct sum.

use std::ops::Range;

use conv_core::{
    ConvError, ConvReal, Direct, GalaxyErrors, RowStream, ScenePixelFilter, SourcePlan, StarPainter,
};
use ndarray::{Array2, ArrayView2, ArrayViewMut2, s};
use psf_types::{Anchor, Image, PointSource, Position, Progress, PsfModel};
use rand::seq::IteratorRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::Simulator;
use super::sources::with_extended;
use crate::error::{ErrorKind, PsfieldError};
use crate::scene::{Layer, Scene};
use crate::simulate_options::{Method, ScenePixels};
use crate::spot_check::{Allowed, PixelPicker, SpotCheck, rounding_of};

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
        let mut picker = self.picker(scene, (count, seed));
        picker.pass_rows(image.pixels());
        self.checked(scene, picker, &mut NoRows, progress)
    }

    /// Compares the picked pixels with the direct sum. Reads the images that the scene does not hold from
    /// `rows`.
    pub(super) fn checked<R: RowStream<T>>(
        &self,
        scene: &Scene<'_, T>,
        picker: PixelPicker,
        rows: &mut R,
        progress: &dyn Progress,
    ) -> Result<SpotCheck, R::Error>
    where
        R::Error: From<PsfieldError>,
    {
        SpotCheck::of_picked::<T, R::Error>(picker, |pixels| {
            let mut allowed = self.promised(scene, pixels.len());
            let exact = self.exact_by_rows(scene, rows, pixels, allowed.as_deref_mut(), progress)?;
            let dropped = self
                .dropped_light(scene)?
                .map_or(0.0, |dropped| dropped.largest());
            let each = allowed.iter_mut().flatten();
            each.for_each(|allowed| allowed.add_dropped(dropped));
            Ok((exact, allowed))
        })
    }

    /// Picks the pixels that a check of an image of `scene` compares: `count` random pixels, and
    /// the pixels around random sources. `seed` chooses them. The pixels of an image that is read by rows are
    /// chosen without regard to their light.
    pub(super) fn picker(&self, scene: &Scene<'_, T>, (count, seed): (usize, u64)) -> PixelPicker {
        let (shape, geometry) = (self.image_shape(), &self.setup.geometry);
        let (frame, region) = (geometry.frame, geometry.region);
        let (x0, y0) = (frame.x0() + region.x0(), frame.y0() + region.y0());
        let inside =
            |&(x, y): &(i64, i64)| (0..shape.nx() as i64).contains(&x) && (0..shape.ny() as i64).contains(&y);
        let pixel = |at: Position| (at.x().round() as i64 - x0, at.y().round() as i64 - y0);
        let stars = scene.stars().map(|star| pixel(star.position()));
        let profiles = scene.profiles().map(|source| source.point.position());
        let galaxies = scene.galaxies().map(|galaxy| galaxy.position());
        let galaxies = galaxies.chain(profiles).map(pixel);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut sources = stars.filter(inside).sample(&mut rng, SOURCES);
        sources.extend(galaxies.filter(inside).sample(&mut rng, SOURCES));
        let images = scene.layers().iter().filter_map(Layer::image);
        let whole: Vec<_> = images.filter(|image| image.shape() == geometry.shape).collect();
        if scene.layers().iter().any(Layer::is_streamed) {
            let any = |_| {
                (
                    rng.random_range(0..shape.nx()) as i64,
                    rng.random_range(0..shape.ny()) as i64,
                )
            };
            sources.extend((0..SOURCES).map(any));
        } else {
            for (image, seed) in whole.iter().zip(seed..) {
                // Half of these are chosen by their light.
                let mut of_scene = PixelPicker::new(image.shape(), SOURCES.div_ceil(whole.len()), seed);
                of_scene.pass_rows(image.pixels());
                let place = |v: usize, first: i64| (v / geometry.oversample) as i64 - first;
                let picked = of_scene.finish().0;
                sources.extend(
                    picked
                        .iter()
                        .map(|p| (place(p.column, x0), place(p.row, y0)))
                        .filter(inside),
                );
            }
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
        self.exact_by_rows(scene, &mut NoRows, pixels, None, progress)
    }

    /// Computes pixels by the direct sum. Reads the images that the scene does not hold from `rows`: then the
    /// pixels are sorted by rows, and only the scene's rows that they need are in memory. If `allowed` is
    /// given, adds the errors that the scene may have in these pixels.
    fn exact_by_rows<R: RowStream<T>>(
        &self,
        scene: &Scene<'_, T>,
        rows: &mut R,
        pixels: &[(usize, usize)],
        mut allowed: Option<&mut [Allowed]>,
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, R::Error>
    where
        R::Error: From<PsfieldError>,
    {
        self.check_scene(scene)?;
        let mut sums = vec![0.0; pixels.len()];
        for (number, layer) in scene.layers().iter().enumerate() {
            let has_image = layer.image().is_some() || layer.is_streamed();
            let wings = if has_image { self.wings()? } else { None };
            for part in [Some(self), wings].into_iter().flatten() {
                let allowed = allowed.as_deref_mut();
                if let Some(image) = layer.image() {
                    let (light, first) = self.light(image, scene, progress)?;
                    part.add_image(
                        number,
                        (light.pixels(), first),
                        pixels,
                        &mut sums,
                        allowed,
                        progress,
                    )?;
                } else if layer.is_streamed() {
                    part.add_streamed(number, rows, pixels, &mut sums, allowed, progress)?;
                }
            }
            if layer.has_sources() {
                self.add_source_sums((number, layer), pixels, &mut sums, progress)?;
                if let Some(allowed) = &mut allowed {
                    self.add_errors_of_sources((number, layer), pixels, allowed)?;
                }
            }
        }
        Ok(sums)
    }

    /// Adds the light of a layer's image that is read by rows.
    fn add_streamed<R: RowStream<T>>(
        &self,
        layer: usize,
        rows: &mut R,
        pixels: &[(usize, usize)],
        sums: &mut [f64],
        mut allowed: Option<&mut [Allowed]>,
        progress: &dyn Progress,
    ) -> Result<(), R::Error>
    where
        R::Error: From<PsfieldError>,
    {
        let geometry = &self.setup.geometry;
        let shape = geometry.shape;
        let frame = geometry.fine(geometry.frame).map_err(PsfieldError::from)?;
        let reach = self.image_models()?.0[layer].grid().ny();
        let mut done = 0;
        while let Some(&(_, first)) = pixels.get(done) {
            let count = pixels[done..].partition_point(|&(_, row)| row < first + BAND);
            let band = done..done + count;
            let of_scene = |row: usize| frame.y0() as usize + geometry.sampled_pixel((0, row)).1;
            let from = of_scene(first).saturating_sub(reach);
            let to = (of_scene(pixels[band.end - 1].1 + 1) + reach).min(shape.ny());
            let mut light = Array2::zeros((to - from, shape.nx()));
            rows.read(layer, from..to, light.view_mut())?;
            let (part, sums) = ((light.view(), (0, from)), &mut sums[band.clone()]);
            let allowed = allowed.as_mut().map(|allowed| &mut allowed[band.clone()]);
            self.add_image(layer, part, &pixels[band], sums, allowed, progress)?;
            done += count;
        }
        Ok(())
    }

    /// Adds the direct sums of a layer's image at pixels of the image, and the errors that it may have there.
    /// `light` is a part of the layer's image, and the column and row at which it begins.
    fn add_image(
        &self,
        layer: usize,
        light: (ArrayView2<'_, T>, (usize, usize)),
        pixels: &[(usize, usize)],
        sums: &mut [f64],
        allowed: Option<&mut [Allowed]>,
        progress: &dyn Progress,
    ) -> Result<(), PsfieldError> {
        if let Some(allowed) = allowed {
            self.add_errors_of_image(layer, light, pixels, allowed)?;
        }
        let geometry = &self.setup.geometry;
        let (shape, frame) = (geometry.shape, geometry.fine(geometry.frame)?);
        let fine: Vec<_> = pixels
            .iter()
            .map(|&pixel| geometry.sampled_pixel(pixel))
            .collect();
        let (direct, area) = (Direct::new(self.options().anchor), geometry.pixel_area());
        let model = &self.image_models()?.0[layer];
        let found = direct.at_pixels(model, light, shape, frame, &fine, progress)?;
        for (sum, value) in sums.iter_mut().zip(found) {
            *sum += value * area;
        }
        Ok(())
    }

    /// Draws stars exactly, with a reach of its own: that of a plan may be decided by other PSFs.
    fn painter<'a>(&self, plan: &'a SourcePlan<T>) -> Result<StarPainter<'a>, PsfieldError> {
        let painter = StarPainter::new(plan.model(), self.frame(), self.options().anchor, plan.size());
        Ok(painter?)
    }

    /// Adds the light of a layer's stars and galaxies in pixels of the image.
    fn add_source_sums(
        &self,
        (number, layer): (usize, &Layer<'_, T>),
        pixels: &[(usize, usize)],
        sums: &mut [f64],
        progress: &dyn Progress,
    ) -> Result<(), PsfieldError> {
        let (of_frame, plan, frame) = (self.of_frame(pixels), self.sources(number)?, self.frame());
        let stars = self.painter(plan)?.at_pixels(layer.stars(), &of_frame)?;
        let galaxies = with_extended(layer, |sources| {
            plan.extended_at_pixels(sources, frame, &of_frame, progress)
        })?;
        for ((sum, star), galaxy) in sums.iter_mut().zip(stars).zip(galaxies) {
            *sum += star + galaxy;
        }
        let (part, state) = self.shared.part_of(number);
        if let Some(wings) = part.psf.wings()? {
            let wings = wings.with_pixel_response()?;
            let painter = StarPainter::new(&wings.models()?[state], frame, Anchor::Source, plan.size())?;
            let points = with_extended(layer, |extended| plan.wing_points(layer.stars(), extended))?;
            for (sum, light) in sums.iter_mut().zip(painter.at_pixels(&points, &of_frame)?) {
                *sum += light;
            }
        }
        Ok(())
    }

    /// The errors that the method promises for some pixels, before any source is added. None for
    /// patches and for the caller's own method if the scene has an image, because they promise
    /// nothing for it.
    pub(super) fn promised(&self, scene: &Scene<'_, T>, pixels: usize) -> Option<Vec<Allowed>> {
        let method = self.options().method;
        let nothing = scene.has_image() && matches!(method, Method::Patch(_) | Method::Own);
        (!nothing).then(|| vec![Allowed::default(); pixels])
    }

    /// The tolerance of a plan. 0 for methods without a plan.
    fn tolerance(&self) -> Result<f64, PsfieldError> {
        let options = self.options().plan_options()?;
        Ok(options.map_or(0.0, |options| options.tolerance()))
    }

    /// Adds the largest errors that a layer's image may have in pixels of the image. `light` is a
    /// part of the layer's image, and the column and row at which it begins.
    fn add_errors_of_image(
        &self,
        layer: usize,
        (light, (x0, y0)): (ArrayView2<'_, T>, (usize, usize)),
        pixels: &[(usize, usize)],
        allowed: &mut [Allowed],
    ) -> Result<(), PsfieldError> {
        let (tolerance, grid) = (self.tolerance()?, self.image_models()?.0[layer].grid());
        let geometry = &self.setup.geometry;
        if tolerance == 0.0 {
            return Ok(());
        }
        let model = &self.image_models()?.0[layer];
        // The stamps of wings are too large for a plan that only tells their norm.
        let plan = if self.of_wings {
            None
        } else {
            Some(self.sources(layer)?)
        };
        // The filter that takes the scene's pixels out increases the norm of the PSF.
        let of_filter = match self.options().scene_pixels {
            ScenePixels::Point => 1.0,
            ScenePixels::Integrated => ScenePixelFilter::LARGEST_FACTOR,
        };
        let (frame, oversample) = (geometry.fine(geometry.frame)?, geometry.oversample);
        let near = |at: usize, first: i64, start: usize, reach: usize, length: usize| {
            let at = at as i64 + first - start as i64;
            let within = |v: i64| v.clamp(0, length as i64) as usize;
            within(at - reach as i64)..within(at + reach as i64 + 1)
        };
        let of_frame = self.of_frame(pixels);
        for ((&pixel, &of_frame), allowed) in pixels.iter().zip(&of_frame).zip(allowed) {
            let (column, row) = geometry.sampled_pixel(pixel);
            let columns = near(column, frame.x0(), x0, grid.nx(), light.ncols());
            let rows = near(row, frame.y0(), y0, grid.ny(), light.nrows());
            // Where the PSF is not known, nothing is promised.
            let at = Position::of_pixel(of_frame.0 as i64, of_frame.1 as i64);
            // An error in one pixel of the frame may be all of the error on the finer pixels.
            let norm = match plan {
                Some(plan) => plan.psf_norm(at).unwrap_or(f64::INFINITY) * of_filter * oversample as f64,
                None => norm_of_wings(model, at) * geometry.pixel_area(),
            };
            let error = tolerance * norm;
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

    /// Adds the largest errors that a layer's stars and galaxies may have in pixels of the image.
    pub(super) fn add_errors_of_sources(
        &self,
        (number, layer): (usize, &Layer<'_, T>),
        pixels: &[(usize, usize)],
        allowed: &mut [Allowed],
    ) -> Result<(), PsfieldError> {
        let (of_frame, plan) = (self.of_frame(pixels), self.sources(number)?);
        let tolerance = self.tolerance()?;
        let (frame, rounding) = (self.frame(), rounding_of::<T>());
        let places = stars_by_place(layer.stars());
        let first_stars: Vec<PointSource> = places.iter().map(|place| place.first).collect();
        let mut roots = vec![0.0; pixels.len()];
        let mut failed = None;
        self.painter(plan)?
            .lit_pixels(&first_stars, &of_frame, |number, lit| {
                let place = &places[number];
                let (x, y) = (place.first.position().x(), place.first.position().y());
                let at = Position::new(x - frame.x0() as f64, y - frame.y0() as f64);
                match at.map_err(ConvError::Result).and_then(|at| plan.psf_norm(at)) {
                    Ok(norm) => {
                        // Numbers of equal size that are added in one pixel may all be rounded in one
                        // direction.
                        // The most numbers that are added one by one.
                        let additions = match self.options().anchor {
                            Anchor::Output => place.count,
                            _ => place.count.min(GROUP),
                        };
                        let added = 0.25 * additions as f64 * T::epsilon().as_f64();
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
        with_extended(layer, |sources| {
            plan.errors_of_extended(sources, of_pixels, rounding, take)
        })
    }

    /// Converts pixels of the image to pixels of the frame.
    fn of_frame(&self, pixels: &[(usize, usize)]) -> Vec<(usize, usize)> {
        let region = self.setup.geometry.region;
        let (x0, y0) = (region.x0() as usize, region.y0() as usize);
        pixels.iter().map(|&(x, y)| (x + x0, y + y0)).collect()
    }
}

/// The norm of wings at a position. Their model has orthonormal stamps and no mean.
fn norm_of_wings(model: &PsfModel, at: Position) -> f64 {
    let mut coefficients = vec![0.0; model.stamp_count()];
    match model.coefficients_into(at, &mut coefficients) {
        Ok(()) => coefficients.iter().map(|b| b * b).sum::<f64>().sqrt(),
        Err(_) => f64::INFINITY,
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

/// No rows: all images are in memory.
struct NoRows;

impl<T> RowStream<T> for NoRows {
    type Error = PsfieldError;

    fn read(&mut self, _: usize, _: Range<usize>, _: ArrayViewMut2<'_, T>) -> Result<(), PsfieldError> {
        Err(PsfieldError::new(
            ErrorKind::Data,
            "the image of this scene is read row by row: it is checked by stream",
        ))
    }

    fn write(&mut self, _: ArrayView2<'_, T>) -> Result<(), PsfieldError> {
        Ok(())
    }
}
