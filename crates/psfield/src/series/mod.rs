//! Series of exposures: the PSF, the pointing and the sources change with time.

mod exposures;
mod light_curves;
mod pointing;

use std::borrow::Cow;
use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;

use conv_core::{ConvReal, TileCounts};
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis, s};
use psf_io::Catalog;
use psf_types::{Image, NoProgress, PointSource, Position, Progress, SampleStates, SersicSource, StateKind};

use crate::psf::{MovingNative, QUADRATURE};
use crate::simulator::{Mixture, Mixtures, spot_check_layers};
use crate::{ErrorKind, Motion, Psf, PsfieldError, Scene, SimulateOptions, Simulator, SpotCheck};

pub use exposures::Exposures;
pub use light_curves::LightCurves;
pub use pointing::{Pointing, PointingPath};

/// A series of exposures of the same field. Times are in seconds after the start of the series.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// The starts and the duration of the exposures.
    pub exposures: Exposures,
    /// The motion of the pointing.
    pub pointing: Pointing,
    /// The changes of the fluxes of sources.
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
/// - **Pointing**: all light is shifted along the path `d(t)` of the [`Pointing`]. Sources move by the
///   mean shift, and the density of the path about its mean is convolved with the PSF ([`Psf::moved`]).
///   The pixels of a scene's image move by the nearest whole number of pixels, the rest goes into the
///   PSF. Outside the image there is no light.
/// - **Moving sources** are drawn along their own trail, `v t + d(t)`, with the jitter alone in the PSF.
///   The catalogue gives their positions at time 0.
/// - **Light curves**: the flux is the catalogue's times the mean factor of the light curve.
///
/// A source at rest on the sky has the PSF of its mean position on the detector, a moving source the PSF
/// of each point of its trail. Changes of the PSF, of the flux and of the pointing within an exposure are
/// averaged separately.
///
/// ```
/// use ndarray::Array3;
/// use psfield::psf_io::Catalog;
/// use psfield::psf_types::{NoProgress, PointSource, Position};
/// use psfield::{
///     Exposures, LightCurves, Pointing, Psf, Series, SeriesSimulator, SimulateOptions,
/// };
/// let stamps = Array3::from_shape_fn((1, 33, 33), |(_, y, x)| {
///     (-((y as f64 - 16.0).powi(2) + (x as f64 - 16.0).powi(2)) / 8.0).exp()
/// });
/// let psf = Psf::from_samples(stamps.view(), &[(0.0, 0.0)])?;
/// let series = Series {
///     exposures: Exposures::regular(3, 10.0, 20.0)?,
///     pointing: Pointing { drift_px_per_s: [0.05, 0.0], jitter_px: 0.3, path: None },
///     light_curves: LightCurves::new(&[0.0, 0.0], &[0.0, 100.0], &[1.0, 2.0])?,
/// };
/// let star = PointSource::new(Position::new(30.0, 25.0)?, 100.0)?;
/// let light = (None, Catalog::new(vec![star], Vec::new()));
/// let options = SimulateOptions::default();
/// let mut simulator = SeriesSimulator::<f64>::new(&psf, (60, 70), options, series, light)?;
/// // The exposure from 20 to 30 s.
/// let exposure = simulator.exposure(1, &NoProgress)?;
/// assert!((exposure.shift_px()[0] - 1.25).abs() < 1e-9);
/// assert!((exposure.simulate()?.pixels().sum() - 125.0).abs() < 1e-2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct SeriesSimulator<T: ConvReal> {
    psf: Psf,
    shape: (usize, usize),
    options: SimulateOptions,
    series: Series,
    image: Option<Image<T>>,
    /// The image moved by whole frame pixels, for the last exposure that needed it.
    moved_image: Option<([f64; 2], Image<T>)>,
    catalog: Catalog,
    /// Makes the PSF of the image, if there is one and its native stamps are all that it needs.
    native: Option<MovingNative>,
    /// For light at rest on the sky, and for moving sources.
    last: [Option<Last<T>>; 2],
}

/// The indices of [`SeriesSimulator::last`].
const AT_REST: usize = 0;
const MOVING: usize = 1;
/// The most exposures that share local bases, if the PSF depends on the time. Local bases of more
/// exposures are larger.
const GROUP: usize = 32;
/// The exposures of a group whose PSFs its local bases represent. Stars of the others are tested, too.
const REPRESENTED: usize = 4;

/// The PSF and the simulator of the last exposure.
#[derive(Debug)]
struct Last<T: ConvReal> {
    motion: Motion,
    moved: Mixtures<T>,
    weights: Option<Array2<f64>>,
    /// The exposures that use the simulator's local bases.
    group: Range<usize>,
    simulator: Arc<Simulator<T>>,
}

/// An exposure, ready to be simulated.
#[derive(Debug)]
pub struct SeriesExposure<'a, T: ConvReal> {
    /// Light at rest on the sky, and moving sources, if there are any.
    layers: Vec<(Arc<Simulator<T>>, Scene<'a, T>)>,
    shift_px: [f64; 2],
    sources: Vec<SourceInExposure>,
}

impl<'a, T: ConvReal> SeriesExposure<'a, T> {
    /// The simulator of the light that is at rest on the sky.
    pub fn simulator(&self) -> &Simulator<T> {
        &self.layers[0].0
    }

    /// The light that is at rest on the sky, moved by the pointing.
    pub fn scene(&self) -> &Scene<'a, T> {
        &self.layers[0].1
    }

    /// The mean shift by the pointing along x and y, in pixels.
    pub fn shift_px(&self) -> [f64; 2] {
        self.shift_px
    }

    /// Every source of the catalogue as it is in this exposure: stars, then galaxies.
    pub fn sources(&self) -> &[SourceInExposure] {
        &self.sources
    }

    /// Returns the image of the exposure.
    ///
    /// # Errors
    /// The errors of [`Simulator::simulate_into`].
    pub fn simulate(&self) -> Result<Image<T>, PsfieldError> {
        let mut image = self.simulator().zeros();
        self.simulate_into(image.view_mut(), &NoProgress)?;
        Ok(Image::new(image)?)
    }

    /// Adds the image of the exposure to `image`, as [`Simulator::simulate_into`].
    ///
    /// # Errors
    /// The errors of [`Simulator::simulate_into`].
    pub fn simulate_into(
        &self,
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        let mut counts = TileCounts::default();
        for (simulator, scene) in &self.layers {
            counts += simulator.simulate_into(scene, image.view_mut(), progress)?;
        }
        Ok(counts)
    }

    /// Compares an image of this exposure with the direct sum, as [`Simulator::spot_check`].
    ///
    /// # Errors
    /// The errors of [`Simulator::exact_at`].
    pub fn spot_check(
        &self,
        image: &Image<T>,
        pixels: (usize, u64),
        progress: &dyn Progress,
    ) -> Result<SpotCheck, PsfieldError> {
        let layers: Vec<_> = self
            .layers
            .iter()
            .map(|(simulator, scene)| (&**simulator, scene))
            .collect();
        spot_check_layers(&layers, image, pixels, progress)
    }
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
        let psf = psf.fitted()?;
        let rows: HashSet<usize> = catalog.rows().iter().copied().collect();
        let unknown = |row: &usize| !rows.contains(row);
        if let Some(row) = series.light_curves.rows().find(unknown) {
            let message = format!(
                "a light curve is that of source {row}, but the catalogue has no source in this row (counted from 0)"
            );
            return Err(PsfieldError::new(ErrorKind::Data, message));
        }
        let mut made = Self {
            psf,
            shape,
            options,
            series,
            image,
            moved_image: None,
            catalog,
            native: None,
            last: [None, None],
        };
        let mut motions = Vec::new();
        for number in 0..made.series.exposures.len() {
            let times = made.series.exposures.times(number);
            motions.push(made.motion(number)?.0);
            made.state_weights(number)?;
            for row in made.series.light_curves.rows() {
                made.series.light_curves.mean_factor(row, times)?;
            }
        }
        let SimulateOptions {
            oversample,
            stamp_size,
            method,
            ..
        } = &made.options;
        let changes = made.psf.states().is_some() || !motions.iter().all(Motion::is_none);
        if changes && made.image.is_some() && (*oversample, *stamp_size) == (1, None) && method.has_plan() {
            made.native = MovingNative::new(&made.psf, &motions)?;
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
        let (motion, origin, shift_px) = self.motion(number)?;
        // Moving sources have trails of their own.
        let jitter = Motion::fixed([0.0, 0.0]).with_jitter_px(self.series.pointing.jitter_px)?;
        let is_still = motion.equals(&jitter);
        let at_rest = self.simulator(AT_REST, number, motion, progress)?;
        let velocities = self.catalog.velocities();
        let moving = match velocities.is_some_and(|all| all.iter().any(is_moving)) {
            false => None,
            true if is_still => Some(Arc::clone(&at_rest)),
            true => Some(self.simulator(MOVING, number, jitter, progress)?),
        };
        let mut drawn = self.sources_of(times, (origin, shift_px))?;
        let image = self.image_moved_by(origin)?;
        let [stars, trails] = drawn.stars;
        let [galaxies, galaxy_trails] = drawn.galaxies;
        let mut layers = vec![(at_rest, image.with_stars(stars).with_galaxies(galaxies))];
        if let Some(moving) = moving {
            layers.push((
                moving,
                Scene::dark().with_stars(trails).with_galaxies(galaxy_trails),
            ));
        }
        drawn.listed.sort_by_key(|source| source.row);
        Ok(SeriesExposure {
            layers,
            shift_px,
            sources: drawn.listed,
        })
    }

    /// Returns the motion of light at rest on the sky during an exposure relative to an origin, this
    /// origin, and the mean shift.
    fn motion(&self, number: usize) -> Result<(Motion, [f64; 2], [f64; 2]), PsfieldError> {
        let motion = self.series.pointing.during(self.series.exposures.times(number))?;
        let shift_px = motion.mean();
        // The pixels of an image can only move by whole pixels.
        let origin = match self.image {
            Some(_) => shift_px.map(f64::round),
            None => shift_px,
        };
        Ok((motion.about(origin), origin, shift_px))
    }

    /// The simulator of an exposure, for the PSF with this motion. `kind` is [`AT_REST`] or [`MOVING`].
    fn simulator(
        &mut self,
        kind: usize,
        number: usize,
        motion: Motion,
        progress: &dyn Progress,
    ) -> Result<Arc<Simulator<T>>, PsfieldError> {
        let weights = self.state_weights(number)?;
        let (mut before, mut kept) = (None, None);
        if let Some(last) = self.last[kind].take() {
            let is_equal = last.motion.equals(&motion);
            if is_equal && last.weights == weights && last.group.contains(&number) {
                let simulator = Arc::clone(&last.simulator);
                self.last[kind] = Some(last);
                return Ok(simulator);
            }
            before = Some(last.simulator);
            kept = is_equal.then_some((last.moved, last.group));
        }
        let native = match &self.native {
            Some(moving) if kind == AT_REST => moving.psf(&motion, weights.as_ref())?,
            _ => None,
        };
        let images_alone = native.is_some() && self.catalog.rows().is_empty();
        let (moved, group) = match kept {
            Some((moved, group)) => (moved, Some(group).filter(|group| group.contains(&number))),
            // Images alone need no other stamps than the native ones.
            None if images_alone => (Mixtures::new(self.psf.clone()), None),
            None => (Mixtures::new(self.psf.moved(&motion)?), None),
        };
        let (group, represented) = if let Some(group) = group {
            (group, None)
        } else {
            let group = self.group(kind, number, &motion)?;
            let represented = self.represented(&group)?;
            (group, represented)
        };
        let mixture = Mixture {
            weights: weights.clone(),
            native,
            represented,
        };
        let settings = (self.shape, &self.options);
        let light = (
            kind == AT_REST && self.image.is_some(),
            !self.catalog.rows().is_empty(),
        );
        let made = moved.simulator(&mixture, settings, light, before.as_deref(), progress)?;
        let simulator = Arc::new(made);
        self.last[kind] = Some(Last {
            motion,
            moved,
            weights,
            group,
            simulator: Arc::clone(&simulator),
        });
        Ok(simulator)
    }

    /// The exposures that share local bases with an exposure: neighbours with its motion and a similar
    /// PSF.
    fn group(&self, kind: usize, number: usize, motion: &Motion) -> Result<Range<usize>, PsfieldError> {
        let mut group = number..number + 1;
        match self.psf.states().map(SampleStates::kind) {
            None => return Ok(0..self.series.exposures.len()),
            Some(StateKind::Time) => {}
            // PSFs of different frames may have nothing in common.
            Some(_) => return Ok(group),
        }
        // Groups of similar lengths.
        let exposures = self.series.exposures.len();
        let groups = exposures.div_ceil(GROUP);
        let start = |group: usize| (group * exposures).div_ceil(groups);
        let own = number * groups / exposures;
        let (first, last) = (start(own), start(own + 1));
        if kind == MOVING {
            return Ok(first..last);
        }
        while group.start > first && self.motion(group.start - 1)?.0.equals(motion) {
            group.start -= 1;
        }
        while group.end < last && self.motion(group.end)?.0.equals(motion) {
            group.end += 1;
        }
        Ok(group)
    }

    /// The mixtures `[mixture, state]` that the local bases of a group represent. None if the PSF has no
    /// states.
    fn represented(&self, group: &Range<usize>) -> Result<Option<Array2<f64>>, PsfieldError> {
        let count = group.len().min(REPRESENTED);
        let chosen = (0..count).map(|i| group.start + i * (group.len() - 1) / (count - 1).max(1));
        let weights = chosen.map(|number| self.state_weights(number));
        let Some(weights) = weights.collect::<Result<Option<Vec<_>>, _>>()? else {
            return Ok(None);
        };
        let rows: Vec<_> = weights.iter().map(|row| row.view()).collect();
        Ok(Some(
            ndarray::concatenate(Axis(0), &rows).expect("one weight for each state"),
        ))
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
                for pair in exposures::cut_at(values, (from, to)).windows(2) {
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
    fn image_moved_by(&mut self, by: [f64; 2]) -> Result<Scene<'_, T>, PsfieldError> {
        let Some(image) = &self.image else {
            return Ok(Scene::dark());
        };
        if by == [0.0, 0.0] {
            return Ok(Scene::from(image));
        }
        // The memory of an image that was moved otherwise is freed first.
        let kept = self.moved_image.take().filter(|(origin, _)| *origin == by);
        let moved = if let Some(kept) = kept {
            kept
        } else {
            let pixels = by.map(|shift| (shift * self.options.oversample as f64) as i64);
            (by, Image::new(translated(image.pixels(), pixels))?)
        };
        Ok(Scene::from(&self.moved_image.insert(moved).1))
    }

    /// The sources of an exposure. Those at rest on the sky have moved by `origin`. The list has moved by
    /// `shift_px`.
    fn sources_of(
        &self,
        times: (f64, f64),
        (origin, shift_px): ([f64; 2], [f64; 2]),
    ) -> Result<DrawnSources, PsfieldError> {
        let (all_stars, all_galaxies) = (self.catalog.stars(), self.catalog.galaxies());
        let at_rest = Motion::fixed(origin);
        let mut drawn = DrawnSources::default();
        for (place, &row) in self.catalog.rows().iter().enumerate() {
            let galaxy = place
                .checked_sub(all_stars.len())
                .map(|place| all_galaxies[place]);
            let (at, flux) = match galaxy {
                Some(galaxy) => (galaxy.position(), galaxy.flux()),
                None => (all_stars[place].position(), all_stars[place].flux()),
            };
            let flux = flux * self.series.light_curves.mean_factor(row, times)?;
            let velocity = self.catalog.velocities().map_or([0.0, 0.0], |all| all[place]);
            let (kind, trail) = if is_moving(&velocity) {
                let own = self.series.pointing.with_velocity(velocity);
                let trail = own.during(times).map_err(|error| {
                    PsfieldError::new(error.kind(), format!("source {row} (counted from 0): {error}"))
                })?;
                (1, Cow::Owned(trail))
            } else {
                (0, Cow::Borrowed(&at_rest))
            };
            let mean = if kind == 1 { trail.mean() } else { shift_px };
            drawn.listed.push(SourceInExposure {
                row,
                x: at.x() + mean[0],
                y: at.y() + mean[1],
                flux,
            });
            if flux == 0.0 {
                continue;
            }
            for (weight, [dx, dy]) in trail.points() {
                let at = Position::new(at.x() + dx, at.y() + dy)?;
                match galaxy {
                    Some(galaxy) => {
                        drawn.galaxies[kind].push(SersicSource::new(at, weight * flux, galaxy.profile())?);
                    }
                    None => drawn.stars[kind].push(PointSource::new(at, weight * flux)?),
                }
            }
        }
        Ok(drawn)
    }
}

/// The sources of an exposure: at rest on the sky, and the points of trails.
#[derive(Debug, Default)]
struct DrawnSources {
    stars: [Vec<PointSource>; 2],
    galaxies: [Vec<SersicSource>; 2],
    listed: Vec<SourceInExposure>,
}

fn is_moving(velocity: &[f64; 2]) -> bool {
    *velocity != [0.0, 0.0]
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
