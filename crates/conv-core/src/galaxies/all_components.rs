//! The light of galaxies with the PSFs of all components, in f64, and the errors that a plan allows.

use ndarray::{Array1, Array2, Axis};
use psf_types::{Anchor, FrameShape, LightProfile, PixelRegion, Position, Progress, SersicSource};
use rayon::prelude::*;

use super::extent::{FRACTION, RELATIVE_ERROR};
use super::far_field::{BlockWeights, farthest_edge};
use super::galaxy_plan::{Catalogue, GalaxyPlan, Light, Window, window_at};
use super::kernels::Kernels;
use super::power_spectrum::Outline;
use super::window::{Drawn, Spectra, WindowDrawer};
use crate::stars::StarVectors;
use crate::{ConvError, ConvReal};

/// Galaxies whose light in single pixels is computed before it is added.
const GALAXIES_AT_ONCE: usize = 256;
/// The L2 norm of a PSF over the frame's pixels depends on the sub-pixel position. It is at most
/// about this multiple of the norm over all pixels of the stamp, divided by the oversampling.
const OF_PHASES: f64 = 1.5;

impl<T: ConvReal> GalaxyPlan<T> {
    /// Computes single pixels `(column, row)` of the frame, in f64, with the PSFs of all components.
    ///
    /// # Errors
    /// The errors of [`draw_into`](Self::draw_into), without those of an image.
    pub fn at_pixels(
        &self,
        galaxies: &[SersicSource],
        light: &(dyn Fn(&SersicSource) -> Light + Sync),
        frame: PixelRegion,
        pixels: &[(usize, usize)],
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, ConvError> {
        let catalogue = Catalogue {
            galaxies,
            light,
            frame,
            progress,
        };
        let mut sums = vec![0.0; pixels.len()];
        let all: Vec<usize> = (0..galaxies.len()).collect();
        for some in all.chunks(GALAXIES_AT_ONCE) {
            let parts: Vec<Vec<f64>> = some
                .par_iter()
                .map(|&index| self.exact_at(catalogue, index, pixels))
                .collect::<Result<_, _>>()?;
            for part in &parts {
                sums.iter_mut().zip(part).for_each(|(sum, v)| *sum += v);
            }
        }
        Ok(sums)
    }

    /// The largest errors that the images of galaxies may have in a pixel, because of the tolerance
    /// and of windows and outskirts. For each galaxy and each pixel `(column, row)` of the frame
    /// that the galaxy lights, gives the index of the pixel and the error to `take`.
    ///
    /// # Errors
    /// [`ConvError`] if the PSF has no value at a galaxy that lights one of the pixels.
    pub fn errors_at_pixels(
        &self,
        galaxies: &[SersicSource],
        light: &dyn Fn(&SersicSource) -> Light,
        frame: PixelRegion,
        pixels: &[(usize, usize)],
        mut take: impl FnMut(usize, f64),
    ) -> Result<(), ConvError> {
        for galaxy in galaxies.iter().filter(|galaxy| galaxy.flux() != 0.0) {
            let at = galaxy.position();
            let (x, y) = (at.x() - frame.x0() as f64, at.y() - frame.y0() as f64);
            let light = light(galaxy);
            let (side, reach) = self.shared.extent.side_and_reach(light.as_ref());
            let reach = reach.unwrap_or(farthest_edge(side));
            let mut of_window = None;
            for (index, &(column, row)) in pixels.iter().enumerate() {
                let (dx, dy) = (column as f64 - x, row as f64 - y);
                let distance = dx.abs().max(dy.abs());
                if distance > reach {
                    continue;
                }
                let error = if distance <= farthest_edge(side) {
                    let norm = match of_window {
                        Some(norm) => norm,
                        None => self.psf_norm(Position::new(x, y).map_err(ConvError::Result)?)?,
                    };
                    of_window = Some(norm);
                    (1.0 + FRACTION) * self.shared.tolerance * norm
                } else {
                    let mut brightness = [0.0];
                    light.add_blurred([0.0; 3], 1.0, &[[dx as f32, dy as f32]], &mut brightness);
                    RELATIVE_ERROR[1] * brightness[0] + self.shared.extent.left_out() / reach.powi(2)
                };
                take(index, error * galaxy.flux().abs());
            }
        }
        Ok(())
    }

    /// An upper limit of the L2 norm of the PSF of a source of flux 1 on the pixels of the frame,
    /// for any sub-pixel position. Positions are in pixels of the frame.
    ///
    /// # Errors
    /// [`ConvError`] if the PSF has no value at the position.
    pub fn psf_norm(&self, position: Position) -> Result<f64, ConvError> {
        let mut vectors = StarVectors::new(&self.model, self.space());
        let scale = vectors.set(position)?;
        Ok(OF_PHASES * vectors.norm() * scale / self.model.grid().oversampling())
    }

    /// The light of one galaxy in pixels of the frame. Empty if it reaches none of them.
    fn exact_at(
        &self,
        catalogue: Catalogue<'_>,
        index: usize,
        pixels: &[(usize, usize)],
    ) -> Result<Vec<f64>, ConvError> {
        catalogue.progress.check_cancelled()?;
        let galaxy = &catalogue.galaxies[index];
        let light = (catalogue.light)(galaxy);
        let (x, y) = catalogue.position(index);
        let (side, reach) = self.shared.extent.side_and_reach(light.as_ref());
        let farthest = reach.unwrap_or(farthest_edge(side));
        let near = |&(column, row): &(usize, usize)| {
            (column as f64 - x).abs() <= farthest && (row as f64 - y).abs() <= farthest
        };
        if galaxy.flux() == 0.0 || !pixels.iter().any(near) {
            return Ok(Vec::new());
        }
        let position = Position::new(x, y).map_err(ConvError::Result)?;
        let window = window_at((x, y), side);
        let mut vectors = StarVectors::new(&self.model, self.space());
        let scale = vectors.set(position)? * galaxy.flux();
        let psf = vectors.psf * scale;
        let place = |&(column, row): &(usize, usize)| {
            let inside =
                |at: usize, first: i64| usize::try_from(at as i64 - first).ok().filter(|&i| i < side);
            Some((inside(row, window.1)?, inside(column, window.0)?))
        };
        let mut drawn = None;
        if pixels.iter().any(|pixel| place(pixel).is_some()) {
            let centre = (x - window.0 as f64, y - window.1 as f64);
            let frame = catalogue.frame.shape();
            drawn = Some(self.exact_window(&psf, galaxy.flux(), light.as_ref(), window, centre, frame)?);
        }
        let outside = reach.and_then(|reach| {
            let moments = self.stamps().moments_of(psf.view());
            self.far_light(moments, light, (x, y), window, reach)
        });
        if let (Some(values), Some(outside)) = (&mut drawn, &outside) {
            outside.subtract_repeated(&BlockWeights::new(side), 0, values);
        }
        Ok(pixels
            .iter()
            .map(|pixel| match (place(pixel), &drawn, &outside) {
                (Some(place), Some(values), _) => values[place],
                (None, _, Some(outside)) if near(pixel) => {
                    let mut value = [0.0];
                    let offset = outside.offset((pixel.0 as f64, pixel.1 as f64));
                    outside.add_at(&[offset], &mut value);
                    value[0]
                }
                _ => 0.0,
            })
            .collect())
    }

    /// Draws a galaxy on its window with the PSF of all components, given as a vector of
    /// `PsfSpace` times the galaxy's flux. The light of other windows, at the distances of the
    /// period, is not yet subtracted. With [`Anchor::Output`], pixels outside the frame are dark.
    pub(super) fn exact_window(
        &self,
        psf: &Array1<f64>,
        flux: f64,
        light: &dyn LightProfile,
        (x0, y0, side): Window,
        centre: (f64, f64),
        frame: FrameShape,
    ) -> Result<Array2<f64>, ConvError> {
        let mut drawer = WindowDrawer::<f64>::new(side);
        let mut plane = |spectra: &Spectra<f64>, coefficients: &[f64], outline: &Outline| {
            let drawn = Drawn {
                spectra,
                light,
                centre,
                coefficients,
                outline,
            };
            drawer.draw(&drawn, 0..side)
        };
        let (count, psf, stamps) = (psf.len(), psf.view(), self.stamps());
        let transformed = |directions: Array2<f64>, largest: &[f64]| {
            let accuracy = self.shared.extent.accuracy();
            let kernels = Kernels::new(stamps, directions, largest, psf, accuracy);
            let outline = kernels.power.outline(light);
            let spectra = stamps.spectra_of(&kernels, side, stamps.band_number(outline.radius()));
            (spectra, outline)
        };
        if self.shared.options.anchor() != Anchor::Output {
            let (spectra, outline) = transformed(psf.to_owned().insert_axis(Axis(0)), &[1.0]);
            return Ok(plane(&spectra, &[1.0], &outline));
        }
        // Each pixel of the frame has its own PSF, in which any component may be as large as the
        // largest one here.
        let largest = psf.iter().fold(0.0_f64, |largest, c| largest.max(c.abs()));
        let (spectra, outline) = transformed(Array2::eye(count), &vec![largest; count]);
        let planes: Vec<Array2<f64>> = (0..count)
            .map(|k| {
                let mut unit = vec![0.0; count];
                unit[k] = flux;
                plane(&spectra, &unit, &outline)
            })
            .collect();
        let mut values = Array2::zeros((side, side));
        let mut vectors = StarVectors::new(&self.model, self.space());
        for ((j, i), value) in values.indexed_iter_mut() {
            let (x, y) = (x0 + i as i64, y0 + j as i64);
            if !(0..frame.nx() as i64).contains(&x) || !(0..frame.ny() as i64).contains(&y) {
                continue;
            }
            let scale = vectors.set(Position::of_pixel(x, y))?;
            let sum: f64 = vectors
                .psf
                .iter()
                .zip(&planes)
                .map(|(a, plane)| a * plane[[j, i]])
                .sum();
            *value = scale * sum;
        }
        Ok(values)
    }
}
