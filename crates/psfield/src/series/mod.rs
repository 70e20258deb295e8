//! Series of exposures: the PSF, the pointing and the sources change with time.

mod exposures;
mod light_curves;
mod pointing;

use std::sync::Arc;

use conv_core::ConvReal;
use ndarray::{Array2, ArrayView2, s};
use psf_io::Catalog;
use psf_types::{Image, PointSource, Position, Progress, SersicSource, StateKind};

use crate::psf::QUADRATURE;
use crate::simulator::Mixtures;
use crate::{ErrorKind, Motion, Psf, PsfieldError, Scene, SimulateOptions, Simulator};

pub use exposures::Exposures;
pub use light_curves::LightCurves;
pub use pointing::{Pointing, PointingPath};

/// A series of exposures of the same field. Times are in seconds after the start of the series.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// When the exposures begin and how long they last.
    pub exposures: Exposures,
    /// Where the telescope points.
    pub pointing: Pointing,
    /// How the fluxes of sources change.
    pub light_curves: LightCurves,
}

/// Makes the images of a [`Series`]. Models and plans are used again from one exposure to the next, as
/// far as the PSFs agree.
///
/// In an exposure from `t0` to `t1`:
///
/// - **PSF**: samples with times give its mean over the exposure
///   (`a(x) = int a(x, t) dt / (t1 - t0)`, with cubics between the times). Samples with frames give the
///   PSF of the frame with the number of the exposure.
/// - **Pointing**: all light is shifted along the path of the [`Pointing`]. Sources move by the mean
///   shift, and the density of the path about its mean is convolved with the PSF ([`Psf::moved`]). The
///   pixels of a scene's image move by the nearest whole number of pixels, the rest goes into the PSF.
///   A moved source has the PSF of the detector's position to which it has moved. Changes of the PSF
///   and of the pointing within an exposure are averaged separately.
/// - **Sources**: the flux is the catalogue's times the mean factor of the light curve. A source with a
///   velocity is drawn along its trail. The catalogue gives its position at time 0.
#[derive(Debug)]
pub struct SeriesSimulator<T: ConvReal> {
    psf: Psf,
    shape: (usize, usize),
    options: SimulateOptions,
    series: Series,
    image: Option<Image<T>>,
    catalog: Catalog,
    last: Option<Last<T>>,
}

/// The PSF and the simulator of the last exposure.
#[derive(Debug)]
struct Last<T: ConvReal> {
    motion: Motion,
    moved: Mixtures<T>,
    weights: Option<Array2<f64>>,
    simulator: Arc<Simulator<T>>,
}

/// An exposure, ready to be simulated.
#[derive(Debug)]
#[non_exhaustive]
pub struct SeriesExposure<'a, T: ConvReal> {
    /// The simulator with the PSF of the exposure.
    pub simulator: Arc<Simulator<T>>,
    /// The light of the exposure, moved and with its fluxes.
    pub scene: Scene<'a, T>,
    /// The mean shift by the pointing along x and y, in pixels.
    pub shift_px: [f64; 2],
    /// Every source of the catalogue as it is in this exposure.
    pub sources: Vec<SourceInExposure>,
}

/// A source of a catalogue in an exposure.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct SourceInExposure {
    /// The row of the catalogue, counted from 0.
    pub row: usize,
    /// The mean position along x in pixels.
    pub x: f64,
    /// The mean position along y in pixels.
    pub y: f64,
    /// The flux.
    pub flux: f64,
}

impl<T: ConvReal> SeriesSimulator<T> {
    /// Takes the PSF, the settings, and the light: an image, which does not change, and a catalogue.
    /// `shape` is that of the scene `(ny, nx)`, in its own pixels.
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for a light curve of a row that the catalogue does not have, or for a path or
    /// a light curve that does not cover an exposure. [`ErrorKind::Setting`] for an exposure at a time
    /// or with a number for which the PSF is not known. The errors of [`Psf::record`].
    pub fn new(
        psf: &Psf,
        shape: (usize, usize),
        options: SimulateOptions,
        series: Series,
        (image, catalog): (Option<Image<T>>, Catalog),
    ) -> Result<Self, PsfieldError> {
        // One fit serves all exposures.
        let psf = match psf.samples() {
            Some(_) => Psf::from(psf.record()?.clone()),
            None => psf.clone(),
        };
        let rows = || catalog.rows().iter();
        let unknown = |row: &usize| !rows().any(|known| known == row);
        if let Some(row) = series.light_curves.rows().find(unknown) {
            let message = format!(
                "a light curve is that of source {row}, but the catalogue has no source in this row (counted from 0)"
            );
            return Err(PsfieldError::new(ErrorKind::Data, message));
        }
        let made = Self {
            psf,
            shape,
            options,
            series,
            image,
            catalog,
            last: None,
        };
        for number in 0..made.series.exposures.len() {
            let times = made.series.exposures.times(number);
            made.series.pointing.during(times)?;
            made.state_weights(number)?;
            for row in made.series.light_curves.rows() {
                made.series.light_curves.mean_factor(row, times)?;
            }
        }
        Ok(made)
    }

    /// The series.
    pub fn series(&self) -> &Series {
        &self.series
    }

    /// Prepares an exposure: its PSF, its plan and its light.
    ///
    /// # Errors
    /// The errors of [`Simulator::for_other_field`] and [`Psf::moved`].
    ///
    /// # Panics
    /// When there is no such exposure.
    pub fn exposure(
        &mut self,
        number: usize,
        progress: &dyn Progress,
    ) -> Result<SeriesExposure<'_, T>, PsfieldError> {
        let times = self.series.exposures.times(number);
        let motion = self.series.pointing.during(times)?;
        let shift_px = motion.mean();
        // The pixels of an image can only move by whole pixels.
        let origin = match self.image {
            Some(_) => shift_px.map(f64::round),
            None => shift_px,
        };
        let motion = motion.about(origin);
        let weights = self.state_weights(number)?;
        let simulator = self.simulator(motion, weights, progress)?;
        let mut scene = match &self.image {
            Some(image) => self.moved_image(image, origin)?,
            None => Scene::dark(),
        };
        let (stars, galaxies, sources) = self.sources_of(times, (origin, shift_px))?;
        scene = scene.with_stars(stars).with_galaxies(galaxies);
        Ok(SeriesExposure {
            simulator,
            scene,
            shift_px,
            sources,
        })
    }

    /// The simulator for the PSF with this motion and these weights of its states.
    fn simulator(
        &mut self,
        motion: Motion,
        weights: Option<Array2<f64>>,
        progress: &dyn Progress,
    ) -> Result<Arc<Simulator<T>>, PsfieldError> {
        let last = self.last.take();
        let (moved, before) = match last {
            Some(last) if last.motion.equals(&motion) && last.weights == weights => {
                let simulator = Arc::clone(&last.simulator);
                self.last = Some(last);
                return Ok(simulator);
            }
            Some(last) if last.motion.equals(&motion) => (last.moved, Some(last.simulator)),
            Some(last) => (Mixtures::new(self.psf.moved(&motion)?), Some(last.simulator)),
            None => (Mixtures::new(self.psf.moved(&motion)?), None),
        };
        let settings = (self.shape, &self.options);
        let light = (self.image.is_some(), !self.catalog.rows().is_empty());
        let made = moved.simulator(weights.as_ref(), settings, light, before.as_deref(), progress)?;
        let simulator = Arc::new(made);
        self.last = Some(Last {
            motion,
            moved,
            weights,
            simulator: Arc::clone(&simulator),
        });
        Ok(simulator)
    }

    /// The weights of the PSF's states in an exposure, `[1, state]`. None if it has no states.
    fn state_weights(&self, number: usize) -> Result<Option<Array2<f64>>, PsfieldError> {
        let Some(states) = self.psf.states() else {
            return Ok(None);
        };
        let (values, (from, to)) = (states.values(), self.series.exposures.times(number));
        let mut weights = Array2::zeros((1, values.len()));
        match states.kind() {
            StateKind::Time => {
                let known = (values[0], values[values.len() - 1]);
                exposures::check_covered("the PSF", known, (from, to))?;
                let mut times = vec![from, to];
                times.splice(
                    1..1,
                    values.iter().copied().filter(|&time| from < time && time < to),
                );
                for pair in times.windows(2) {
                    let length = pair[1] - pair[0];
                    for (node, weight) in QUADRATURE {
                        for (state, of_state) in coeff_field::state_weights(values, pair[0] + node * length) {
                            weights[(0, state)] += weight * of_state * length / (to - from);
                        }
                    }
                }
            }
            StateKind::Frame => {
                let Some(state) = values.iter().position(|&frame| frame == number as f64) else {
                    let message = format!(
                        "exposure {number} needs the PSF of frame {number}, but the PSF is known for the frames {} to {} (a PSF with \
                         times is interpolated)",
                        values[0],
                        values[values.len() - 1]
                    );
                    return Err(PsfieldError::new(ErrorKind::Setting, message));
                };
                weights[(0, state)] = 1.0;
            }
            kind => {
                let message = format!("the PSF of a series depends on the {kind}: choose one of its values");
                let setting = (kind == StateKind::Wavelength).then_some("wavelength_um");
                return Err(PsfieldError::new(ErrorKind::Setting, message).with_setting(setting));
            }
        }
        Ok(Some(weights))
    }

    /// The image of the scene, moved by whole frame pixels. What comes in from outside is dark.
    fn moved_image<'a>(&self, image: &'a Image<T>, by: [f64; 2]) -> Result<Scene<'a, T>, PsfieldError> {
        if by == [0.0, 0.0] {
            return Ok(Scene::from(image));
        }
        let pixels = by.map(|shift| (shift * self.options.oversample as f64) as i64);
        Ok(Scene::from(Image::new(translated(image.pixels(), pixels))?))
    }

    /// Stars and galaxies of an exposure, and the list of the catalogue's sources. Stars and galaxies
    /// have moved by `origin`, and the sources of the list by `shift_px`.
    #[allow(
        clippy::type_complexity,
        reason = "three lists of one walk through the catalogue"
    )]
    fn sources_of(
        &self,
        times: (f64, f64),
        (origin, shift_px): ([f64; 2], [f64; 2]),
    ) -> Result<(Vec<PointSource>, Vec<SersicSource>, Vec<SourceInExposure>), PsfieldError> {
        let (all_stars, all_galaxies) = (self.catalog.stars(), self.catalog.galaxies());
        let (mut stars, mut galaxies, mut listed) = (Vec::new(), Vec::new(), Vec::new());
        for (place, &row) in self.catalog.rows().iter().enumerate() {
            let galaxy = place
                .checked_sub(all_stars.len())
                .map(|place| all_galaxies[place]);
            let (at, flux) = match galaxy {
                Some(galaxy) => (galaxy.position(), galaxy.flux()),
                None => (all_stars[place].position(), all_stars[place].flux()),
            };
            let flux = flux * self.series.light_curves.mean_factor(row, times)?;
            let [vx, vy] = self.catalog.velocities().map_or([0.0, 0.0], |all| all[place]);
            let trail = Motion::along_line([vx * times.0, vy * times.0], [vx * times.1, vy * times.1]);
            let mean = trail.mean();
            listed.push(SourceInExposure {
                row,
                x: at.x() + mean[0] + shift_px[0],
                y: at.y() + mean[1] + shift_px[1],
                flux,
            });
            if flux == 0.0 {
                continue;
            }
            for &(weight, [dx, dy]) in trail.points() {
                let at = Position::new(at.x() + dx + origin[0], at.y() + dy + origin[1])?;
                match galaxy {
                    Some(galaxy) => galaxies.push(SersicSource::new(at, weight * flux, galaxy.profile())?),
                    None => stars.push(PointSource::new(at, weight * flux)?),
                }
            }
        }
        Ok((stars, galaxies, listed))
    }
}

/// An image moved by whole pixels (x, y), dark where nothing moves in.
fn translated<T: ConvReal>(image: ArrayView2<'_, T>, [dx, dy]: [i64; 2]) -> Array2<T> {
    let (ny, nx) = image.dim();
    let mut moved = conv_core::zeros((ny, nx));
    // The first pixels of the old and of the new image, and the number of pixels that stay inside.
    let along = |shift: i64, n: usize| {
        let shift = shift.clamp(-(n as i64), n as i64);
        let (from, to) = ((-shift).max(0) as usize, shift.max(0) as usize);
        (from, to, n - from.max(to))
    };
    let ((x, to_x, width), (y, to_y, height)) = (along(dx, nx), along(dy, ny));
    moved
        .slice_mut(s![to_y..to_y + height, to_x..to_x + width])
        .assign(&image.slice(s![y..y + height, x..x + width]));
    moved
}
