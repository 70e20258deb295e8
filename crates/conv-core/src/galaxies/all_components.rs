//! The light of galaxies with the PSFs of all components, in f64, and the errors that a plan allows.

use ndarray::{Array1, Array2, Array3, Axis, s};
use psf_types::{Anchor, FrameShape, LightProfile, Position, ToleranceOn};
use rayon::prelude::*;

use super::far_field::farthest_edge;
use super::galaxy_drawer::{ExtendedToDraw, GalaxyDrawer, Window, window_at};
use super::kernels::Kernels;
use super::power_spectrum::Outline;
use super::real_space::{Integrator, Sky, corner_radius};
use super::window::{Drawn, Spectra, WindowDrawer};
use crate::{ConvError, ConvReal};

/// A spot check ignores this part of the light that may be left out of an image.
const IGNORED: f64 = 0.1;
/// Interpolated stamps hold light that counts up to about this many stamp pixels beyond their edges, on
/// both sides together.
const BEYOND: f64 = 6.0;
/// The least error of a galaxy's image beside that of its PSF, relative to its peak. Windows are not
/// enlarged below it.
const LEAST_ERROR: f64 = 3e-8;
/// The errors of all pixels add up to the tolerance times the flux at most. So on the ellipse through a
/// pixel, the mean error is at most that divided by the ellipse's area. An error in one pixel is at most
/// this many times larger: up to 2 times in images of galaxies of all shapes.
const CONCENTRATED: f64 = 5.0;
/// The error of the transform of a profile, relative to the flux.
const TRANSFORM: f64 = 3e-7;
/// No PSF holds more than this multiple of a source's light.
const LARGEST_PSF_FLUX: f64 = 2.0;
/// Galaxies whose light in single pixels is computed before it is added.
const GALAXIES_AT_ONCE: usize = 256;

/// The largest errors of a galaxy in a pixel.
#[derive(Debug, Clone, Copy)]
pub struct GalaxyErrors {
    /// Because of the PSF. The root of the sum of the squared errors of all pixels is at most this.
    pub psf_norm: f64,
    /// Because of the PSF, in this pixel.
    pub psf: f64,
    /// Because of windows, light that is left out, and the transform of the profile.
    pub image: f64,
}

impl<T: ConvReal> GalaxyDrawer<T> {
    /// Computes single pixels `(column, row)` of the frame, in f64, with the PSFs of all components, by
    /// integration on the sky. The time grows with the number of pairs of a galaxy and a pixel: about a
    /// millisecond if the galaxy's centre lies on the stamp around the pixel, and microseconds if it is
    /// farther away.
    pub(crate) fn at_pixels(
        &self,
        catalogue: ExtendedToDraw<'_>,
        pixels: &[(usize, usize)],
    ) -> Result<Vec<f64>, ConvError> {
        let mut sums = vec![0.0; pixels.len()];
        let count = catalogue.sources.points.len();
        if count == 0 {
            return Ok(sums);
        }
        let integrator = Integrator::new(&self.psfs.model, self.psfs.size());
        let all: Vec<usize> = (0..count).collect();
        for some in all.chunks(GALAXIES_AT_ONCE) {
            let parts: Vec<Vec<f64>> = some
                .par_iter()
                .map(|&index| self.integrals(&integrator, catalogue, index, pixels))
                .collect::<Result<_, _>>()?;
            for part in &parts {
                sums.iter_mut().zip(part).for_each(|(sum, v)| *sum += v);
            }
        }
        Ok(sums)
    }

    /// The light of one galaxy in pixels of the frame. Empty if it reaches none of them.
    fn integrals(
        &self,
        integrator: &Integrator<'_>,
        catalogue: ExtendedToDraw<'_>,
        index: usize,
        pixels: &[(usize, usize)],
    ) -> Result<Vec<f64>, ConvError> {
        catalogue.progress.check_cancelled()?;
        let flux = catalogue.flux(index);
        if flux == 0.0 {
            return Ok(Vec::new());
        }
        let light = catalogue.light(index);
        let (x, y) = catalogue.position(index);
        let sky = Sky::new(light.as_ref(), IGNORED * self.shared.extent.left_out());
        let offset = |&(column, row): &(usize, usize)| (column as f64 - x, row as f64 - y);
        let lit: Vec<usize> = (0..pixels.len())
            .filter(|&pixel| integrator.reaches(&sky, offset(&pixels[pixel])))
            .collect();
        if lit.is_empty() {
            return Ok(Vec::new());
        }
        let mut values = vec![0.0; pixels.len()];
        // With the PSF of each pixel, or that of the galaxy outside its window.
        let window = window_at((x, y), self.shared.extent.side_and_reach(light.as_ref()).0);
        let (of_pixels, of_galaxy): (Vec<usize>, Vec<usize>) = lit.into_iter().partition(|&pixel| {
            self.psfs.options().anchor() == Anchor::Output && is_in(window, pixels[pixel])
        });
        if !of_galaxy.is_empty() {
            let psf = match integrator.psf(Position::new(x, y).map_err(ConvError::Result)?) {
                Ok(psf) => psf,
                Err(error) => {
                    // An image leaves out so faint light, and needs no PSF for it.
                    let drawn = Sky::new(light.as_ref(), self.shared.extent.left_out());
                    let needs = |&pixel: &usize| integrator.reaches(&drawn, offset(&pixels[pixel]));
                    return if of_galaxy.iter().any(needs) {
                        Err(error.into())
                    } else {
                        Ok(Vec::new())
                    };
                }
            };
            let offsets: Vec<(f64, f64)> = of_galaxy.iter().map(|&pixel| offset(&pixels[pixel])).collect();
            for (pixel, value) in of_galaxy.into_iter().zip(psf.images(&sky, &offsets)?) {
                values[pixel] = value * flux;
            }
        }
        for pixel in of_pixels {
            let (column, row) = pixels[pixel];
            let psf = integrator.psf(Position::of_pixel(column as i64, row as i64))?;
            values[pixel] = psf.images(&sky, &[offset(&pixels[pixel])])?[0] * flux;
        }
        Ok(values)
    }

    /// The largest errors that galaxies may have in pixels `(column, row)` of the frame. For each galaxy
    /// and each pixel that the galaxy lights, gives the index of the pixel and the errors to `take`.
    /// `rounding` is the relative rounding error of a PSF.
    ///
    /// The error of the PSF, `d`, adds at most `|c| |sum d| + |d| |I - c|` to a pixel, for the light `I`
    /// on the stamp and any constant `c` (Cauchy-Schwarz inequality). Both parts of `d` are within the
    /// tolerance: its L2 norm, and its flux if the tolerance holds on apertures.
    pub(crate) fn errors_at_pixels(
        &self,
        catalogue: ExtendedToDraw<'_>,
        pixels: &[(usize, usize)],
        rounding: f64,
        mut take: impl FnMut(usize, GalaxyErrors),
    ) -> Result<(), ConvError> {
        let (extent, tolerance) = (&self.shared.extent, self.shared.tolerance);
        let on_apertures = self.psfs.options().tolerance_on() == ToleranceOn::Aperture;
        let grid = self.psfs.model.grid();
        let [width, height] = [grid.nx(), grid.ny()].map(|n| (n as f64 + BEYOND) / grid.oversampling());
        let lit = (0..catalogue.sources.points.len()).filter(|&index| catalogue.flux(index) != 0.0);
        for galaxy in lit {
            let (x, y) = catalogue.position(galaxy);
            let (light, flux) = (catalogue.light(galaxy), catalogue.flux(galaxy).abs());
            let farthest = light.radius_beyond(IGNORED * extent.left_out());
            let drawn = light.radius_beyond(extent.left_out());
            let window = farthest_edge(extent.side_and_reach(light.as_ref()).0);
            let corner = corner_radius(light.as_ref(), 0.5 * width, 0.5 * height);
            let mut of_galaxy = None;
            for (index, &(column, row)) in pixels.iter().enumerate() {
                let (dx, dy) = (column as f64 - x, row as f64 - y);
                let radius = light.radius(dx, dy);
                let in_window = dx.abs().max(dy.abs()) <= window;
                if radius - corner > farthest && !in_window {
                    // Here a galaxy may be left out of the image, but the integral has its light.
                    take(
                        index,
                        GalaxyErrors {
                            psf_norm: 0.0,
                            psf: 0.0,
                            image: LARGEST_PSF_FLUX * light.brightness(radius - corner) * flux,
                        },
                    );
                    continue;
                }
                let (norm, psf_flux, peak) = if let Some(known) = of_galaxy {
                    known
                } else {
                    let position = Position::new(x, y).map_err(ConvError::Result)?;
                    let (norm, psf_flux) = match self.psfs.norm_and_flux(position) {
                        Err(_) if radius - corner > drawn => continue,
                        known => known?,
                    };
                    // The peak of a Gaussian PSF with this norm.
                    let peak = norm.min(2.0 * norm * norm / psf_flux);
                    *of_galaxy.insert((norm, psf_flux, peak))
                };
                let [most, least] =
                    [(radius - corner).max(0.0), radius + corner].map(|radius| light.brightness(radius));
                // The root of the number of pixels on the stamp.
                let side = (width * height).sqrt();
                let mut of_light = norm * light.squared_norm().sqrt().min(most * side);
                if on_apertures {
                    let around_mean =
                        psf_flux * f64::midpoint(most, least) + norm * 0.5 * (most - least) * side;
                    of_light = of_light.min(around_mean);
                }
                // The peak of the galaxy: the light within the core of the PSF.
                let core = (std::f64::consts::TAU * peak * light.axis_ratio()).sqrt().recip();
                let in_core = 1.0 - light.flux_beyond(core);
                let at_peak = peak * (2.0 * in_core).min(1.0);
                let spread = CONCENTRATED / (std::f64::consts::PI * light.axis_ratio() * radius * radius);
                let mut image = tolerance.max(LEAST_ERROR) * at_peak.min(spread);
                if !in_window {
                    image = image.min(psf_flux * most);
                }
                let relative = tolerance + rounding;
                take(
                    index,
                    GalaxyErrors {
                        psf_norm: relative * norm * flux,
                        psf: relative * norm.min(of_light) * flux,
                        image: (image + TRANSFORM * peak) * flux,
                    },
                );
            }
        }
        Ok(())
    }

    /// Draws light on the window of a galaxy with the PSF of all components, given as a vector of
    /// `PsfSpace` times the galaxy's flux. `drawn` holds lights, the galaxy's own first, and their centres. The light
    /// of other windows, at the distances of the period, is not yet subtracted. Each window is given to `take`. With [`Anchor::Output`], pixels
    /// outside the frame are dark.
    pub(super) fn exact_windows(
        &self,
        psf: &Array1<f64>,
        flux: f64,
        drawn: &[(&dyn LightProfile, (f64, f64))],
        (x0, y0, side): Window,
        frame: FrameShape,
        mut take: impl FnMut(Array2<f64>),
    ) -> Result<(), ConvError> {
        let mut drawer = WindowDrawer::<f64>::new(side);
        let mut plane = |spectra: &Spectra<f64>, coefficients: &[f64], outline: &Outline, number: usize| {
            let (light, centre) = drawn[number];
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
            let outline = kernels.power.outline(drawn[0].0, accuracy);
            let spectra = stamps.spectra_of(&kernels, side, stamps.band_number(outline.radius()));
            (spectra, outline)
        };
        if self.psfs.options().anchor() != Anchor::Output {
            let (spectra, outline) = transformed(psf.to_owned().insert_axis(Axis(0)), &[1.0]);
            (0..drawn.len()).for_each(|number| take(plane(&spectra, &[1.0], &outline, number)));
            return Ok(());
        }
        // Each pixel of the frame has its own PSF, in which any component may be as large as the
        // largest one here.
        let largest = psf.iter().fold(0.0_f64, |largest, c| largest.max(c.abs()));
        let (spectra, outline) = transformed(Array2::eye(count), &vec![largest; count]);
        let mut of_pixels = Array3::zeros((side, side, count));
        let mut vectors = self.psfs.vectors();
        for (j, i) in (0..side).flat_map(|j| (0..side).map(move |i| (j, i))) {
            let (x, y) = (x0 + i as i64, y0 + j as i64);
            if (0..frame.nx() as i64).contains(&x) && (0..frame.ny() as i64).contains(&y) {
                let scale = vectors.set(Position::of_pixel(x, y))?;
                of_pixels.slice_mut(s![j, i, ..]).assign(&(scale * &vectors.psf));
            }
        }
        for number in 0..drawn.len() {
            let mut values = Array2::zeros((side, side));
            for (k, of_component) in of_pixels.axis_iter(Axis(2)).enumerate() {
                let mut unit = vec![0.0; count];
                unit[k] = flux;
                values += &(&of_component * &plane(&spectra, &unit, &outline, number));
            }
            take(values);
        }
        Ok(())
    }
}

fn is_in((x0, y0, side): Window, (column, row): (usize, usize)) -> bool {
    let within = |at: usize, first: i64| (first..first + side as i64).contains(&(at as i64));
    within(column, x0) && within(row, y0)
}
