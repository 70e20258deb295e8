//! The exposures of a series: for each, the scene and the simulator of its image.

use std::borrow::Cow;
use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;

use conv_core::ConvReal;
use ndarray::{Array2, ArrayView2, s};
use psf_types::{Image, Position, Progress, StateKind};

use super::Series;
use super::states::{mixed, mixed_kind, represented, weights};
use crate::error::{ErrorKind, PsfieldError};
use crate::psf::{Motion, MovingNative, Psf};
use crate::scene::Scene;
use crate::scene_light::{LayerSources, SceneLight, Source, sources_of};
use crate::simulate_options::{Method, SimulateOptions};
use crate::simulator::{Part, Setup, Simulator};

/// The most exposures that share local bases, if the PSF depends on the time. Local bases of more
/// exposures are larger.
const GROUP: usize = 32;

/// Makes the scenes and the simulators of a [`Series`]. Models and plans are used again from one exposure to
/// the next, as far as the PSFs agree.
///
/// In an exposure from `t0` to `t1`:
///
/// - **PSF**: samples with times give its mean over the exposure
///   (`a(x) = int a(x, t) dt / (t1 - t0)`, with cubics between the times). Samples with frames give the
///   PSF of the frame with the number of the exposure. The PSFs of several spectra
///   ([`Psf::for_spectra`]) do not change with time.
/// - **Pointing**: all light is shifted along the path `d(t)` of the [`Pointing`](super::Pointing). Sources
///   move by the mean shift, and the density of the path about its mean is convolved with the PSF
///   ([`Psf::moved`]). The pixels of a scene's image move by the nearest whole number of pixels, the rest
///   goes into the PSF. Outside the image there is no light.
/// - **Moving sources** are drawn along their own trail, `v t + d(t)`, with the jitter alone in the PSF.
///   The catalogue gives their positions at time 0. They are further layers of the scene.
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
/// use psfield::series::{Exposures, LightCurves, Pointing, Series, SeriesFrames};
/// use psfield::{Psf, SceneLight, SimulateOptions};
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
/// let mut light = SceneLight::new();
/// light.set_catalog(Catalog::new(vec![star], Vec::new()));
/// let options = SimulateOptions::default();
/// let mut frames = SeriesFrames::<f64>::new(&psf, (60, 70), options, series, light)?;
/// // The exposure from 20 to 30 s.
/// let exposure = frames.exposure(1, &NoProgress)?;
/// assert!((exposure.shift_px[0] - 1.25).abs() < 1e-9);
/// let image = exposure.simulator.simulate(&exposure.scene)?;
/// assert!((image.pixels().sum() - 125.0).abs() < 1e-2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct SeriesFrames<T: ConvReal> {
    psf: Psf,
    setup: Setup,
    shape: (usize, usize),
    series: Series,
    /// The catalogue, and the layers of its sources.
    light: SceneLight<T>,
    /// The images of the layers.
    images: Images<T>,
    /// The images moved by whole frame pixels, for the last exposure that needed it.
    moved_images: Option<([f64; 2], Images<T>)>,
    /// Makes the PSF of the image, if there is one and its native stamps are all that it needs.
    native: Option<MovingNative>,
    /// The PSFs of light at rest on the sky, and of moving sources, in the last exposure.
    last: [Option<LastPart<T>>; 2],
    /// The simulator of the last exposure, and the parts of its PSF.
    simulator: Option<(Arc<Simulator<T>>, Parts<T>)>,
}

/// The image of each layer.
type Images<T> = Vec<Option<Image<T>>>;

/// The parts of a simulator's PSF.
type Parts<T> = Vec<Arc<Part<T>>>;

/// The indices of [`SeriesFrames::last`].
const AT_REST: usize = 0;
const MOVING: usize = 1;

/// The PSF of the last exposure for one kind of light.
#[derive(Debug)]
struct LastPart<T: ConvReal> {
    motion: Motion,
    /// The PSF with this motion: all states, on its own pixels and on those of the scene's image.
    moved: Psf,
    on_pixels: Option<Psf>,
    /// The plans for sources with all these states, from which others get their local bases.
    all_states: Arc<Part<T>>,
    weights: Option<Array2<f64>>,
    /// The exposures that use the part's local bases.
    group: Range<usize>,
    part: Arc<Part<T>>,
    /// The PSF for the images, if it was made in another way than the part's.
    images: Option<Psf>,
}

/// An exposure, ready to be simulated: `exposure.simulator.simulate(&exposure.scene)`.
#[derive(Debug)]
#[non_exhaustive]
pub struct SeriesExposure<'a, T: ConvReal> {
    /// The simulator of this exposure's PSFs.
    pub simulator: Arc<Simulator<T>>,
    /// The light, moved by the pointing.
    pub scene: Scene<'a, T>,
    /// The mean shift by the pointing along x and y, in pixels.
    pub shift_px: [f64; 2],
    /// Every source of the catalogue as it is in this exposure, by its row.
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

impl<T: ConvReal> SeriesFrames<T> {
    /// Takes the PSF, the settings, and the light: images, which do not change, and a catalogue.
    /// `shape` is that of the scene `(ny, nx)`, in its own pixels. If the light has spectra, the PSF has a
    /// state for each ([`SceneLight::psf_of`]).
    ///
    /// # Errors
    /// [`ErrorKind::Data`] for a light curve of a row that the catalogue does not have, or for a path or
    /// a light curve that does not cover an exposure, or for an image that is read row by row.
    /// [`ErrorKind::Setting`] for an exposure at a time or with a number for which the PSF is not known, or
    /// for [`Method::Own`]. The errors of [`Psf::record`] and of
    /// [`SimulatorBuilder::build`](crate::SimulatorBuilder::build).
    pub fn new(
        psf: &Psf,
        shape: (usize, usize),
        options: SimulateOptions,
        series: Series,
        mut light: SceneLight<T>,
    ) -> Result<Self, PsfieldError> {
        if options.method == Method::Own {
            return Err(Method::refused(Method::Own));
        }
        // One fit serves all exposures.
        let psf = psf.fitted()?;
        let rows: HashSet<usize> = light.catalog().rows().iter().copied().collect();
        let unknown = |row: &usize| !rows.contains(row);
        if let Some(row) = series.light_curves.rows().find(unknown) {
            let message = format!(
                "a light curve is that of source {row}, but the catalogue has no source in this row (counted from 0)"
            );
            return Err(PsfieldError::new(ErrorKind::Data, message));
        }
        let images = light.take_images()?;
        let mut made = Self {
            setup: Setup::new(&psf, shape, options)?,
            psf,
            shape,
            series,
            light,
            images,
            moved_images: None,
            native: None,
            last: [None, None],
            simulator: None,
        };
        let mut motions = Vec::new();
        for number in 0..made.series.exposures.len() {
            let times = made.series.exposures.times(number);
            motions.push(made.motion(number)?.0);
            weights(&made.psf, &made.series.exposures, number)?;
            for row in made.series.light_curves.rows() {
                made.series.light_curves.mean_factor(row, times)?;
            }
        }
        let options = &made.setup.options;
        let kind = mixed_kind(&made.psf);
        let changes = kind.is_some() || !motions.iter().all(Motion::is_none);
        let is_native = (options.oversample, options.stamp_size) == (1, None) && options.method.has_plan();
        let one_layer = kind.is_some() || made.psf.states().is_none();
        if changes && made.has_image() && is_native && one_layer {
            made.native = MovingNative::new(&made.psf, &motions)?;
        }
        Ok(made)
    }

    /// The series.
    pub fn series(&self) -> &Series {
        &self.series
    }

    fn has_image(&self) -> bool {
        self.images.iter().any(Option::is_some)
    }

    /// Prepares an exposure: its PSF, its plan and its light.
    ///
    /// # Errors
    /// The errors of [`Simulator::with_psf`] and [`Psf::moved`].
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
        let velocities = self.light.catalog().velocities();
        let has_trails = velocities.is_some_and(|all| all.iter().any(is_moving)) && !motion.equals(&jitter);
        self.update(AT_REST, number, motion)?;
        if has_trails {
            self.update(MOVING, number, jitter)?;
        }
        let simulator = self.simulator(has_trails, progress)?;
        let (sources, listed) = self.sources_of(times, (origin, shift_px), has_trails)?;
        let images = self.images_moved_by(origin)?;
        let mut layers = images.iter().map(Option::as_ref).chain(std::iter::repeat(None));
        let scenes = sources.0.into_iter().map(|(stars, galaxies)| {
            let image = layers.next().flatten();
            let scene = image.map_or_else(Scene::dark, Scene::from);
            scene.with_stars(stars).with_galaxies(galaxies)
        });
        Ok(SeriesExposure {
            simulator,
            scene: Scene::of_layers(scenes),
            shift_px,
            sources: listed,
        })
    }

    /// Returns the motion of light at rest on the sky during an exposure relative to an origin, this
    /// origin, and the mean shift.
    fn motion(&self, number: usize) -> Result<(Motion, [f64; 2], [f64; 2]), PsfieldError> {
        let motion = self.series.pointing.during(self.series.exposures.times(number))?;
        let shift_px = motion.mean();
        // The pixels of an image can only move by whole pixels.
        let origin = if self.has_image() {
            shift_px.map(f64::round)
        } else {
            shift_px
        };
        Ok((motion.about(origin), origin, shift_px))
    }

    /// The simulator of the parts in [`last`](Self::last). Takes over the tiles of the one before.
    fn simulator(
        &mut self,
        has_trails: bool,
        progress: &dyn Progress,
    ) -> Result<Arc<Simulator<T>>, PsfieldError> {
        let used = self.last[..=usize::from(has_trails)].iter().flatten();
        let parts: Parts<T> = used.map(|last| Arc::clone(&last.part)).collect();
        let same = |before: &[Arc<Part<T>>]| {
            before.len() == parts.len() && before.iter().zip(&parts).all(|(a, b)| Arc::ptr_eq(a, b))
        };
        let images = self.last[AT_REST].as_ref().and_then(|last| last.images.clone());
        let simulator = match self.simulator.take() {
            Some((before, of_before)) if same(&of_before) => before,
            Some((before, _)) => Arc::new(before.with_parts(parts.clone(), images, progress)?),
            None => {
                let options = self.setup.options.clone();
                Arc::new(Simulator::of_parts(parts.clone(), images, self.shape, options)?)
            }
        };
        self.simulator = Some((Arc::clone(&simulator), parts));
        Ok(simulator)
    }

    /// Makes the PSF of an exposure with this motion for light of a kind, [`AT_REST`] or [`MOVING`], unless
    /// that of the last exposure is equal.
    fn update(&mut self, kind: usize, number: usize, motion: Motion) -> Result<(), PsfieldError> {
        let weights = weights(&self.psf, &self.series.exposures, number)?;
        let before = self.last[kind].take();
        let before = before.filter(|last| last.motion.equals(&motion));
        let in_group = before.as_ref().is_some_and(|last| last.group.contains(&number));
        if in_group && before.as_ref().is_some_and(|last| last.weights == weights) {
            self.last[kind] = before;
            return Ok(());
        }
        // The PSF for images of the exposure, if native stamps are all that it needs.
        let native = match &self.native {
            Some(moving) if kind == AT_REST => moving.psf(&motion, weights.as_ref())?,
            _ => None,
        };
        let last = if let Some(last) = before {
            last
        } else {
            let images_alone = native.is_some() && self.light.catalog().rows().is_empty();
            // Images alone need no other stamps than the native ones.
            let moved = if images_alone {
                self.psf.clone()
            } else {
                self.psf.moved(&motion)?
            };
            let all_states = Arc::new(Part::new(moved.clone()));
            LastPart {
                motion,
                on_pixels: None,
                weights: None,
                group: 0..0,
                part: Arc::clone(&all_states),
                all_states,
                moved,
                images: None,
            }
        };
        self.last[kind] = Some(self.mixture((kind, number), (weights, native), in_group, last)?);
        Ok(())
    }

    /// The PSF of a mixture of the states, and its native PSF, if there is one. If it is `in_group`, it uses
    /// the local bases of the one before.
    fn mixture(
        &self,
        (kind, number): (usize, usize),
        (weights, native): (Option<Array2<f64>>, Option<Psf>),
        in_group: bool,
        mut last: LastPart<T>,
    ) -> Result<LastPart<T>, PsfieldError> {
        let has_sources = !self.light.catalog().rows().is_empty();
        let of_mixture = |psf: &Psf| match &weights {
            Some(weights) => mixed(psf, weights),
            None => Ok(psf.clone()),
        };
        last.images = match &native {
            Some(native) => Some(self.setup.on_scene_pixels(native)?),
            // The mixtures share their stamps on the scene's pixels.
            None if kind == AT_REST && self.has_image() && weights.is_some() => {
                if last.on_pixels.is_none() {
                    last.on_pixels = Some(self.setup.on_scene_pixels(&last.moved)?);
                }
                last.on_pixels.as_ref().map(of_mixture).transpose()?
            }
            None => None,
        };
        let psf = match native {
            Some(native) if !has_sources => native,
            _ => of_mixture(&last.moved)?,
        };
        if !in_group {
            last.group = self.group(kind, number, &last.motion)?;
        }
        let plans_sources = has_sources && self.setup.options.method.has_plan();
        last.part = Arc::new(match &weights {
            Some(_) if plans_sources && in_group => last.part.for_other(psf, None, &self.setup)?,
            Some(_) if plans_sources => {
                let mixtures = represented(&self.psf, &self.series.exposures, &last.group)?;
                let represented = mixtures
                    .map(|mixtures| mixed(&last.moved, &mixtures))
                    .transpose()?;
                last.all_states
                    .for_other(psf, represented.as_ref(), &self.setup)?
            }
            _ => Part::new(psf),
        });
        last.weights = weights;
        Ok(last)
    }

    /// The exposures that share local bases with an exposure: neighbours with its motion and a similar
    /// PSF.
    fn group(&self, kind: usize, number: usize, motion: &Motion) -> Result<Range<usize>, PsfieldError> {
        let mut group = number..number + 1;
        match mixed_kind(&self.psf) {
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

    /// The images of the layers, moved by whole frame pixels. What comes in from outside is dark.
    fn images_moved_by(&mut self, by: [f64; 2]) -> Result<&[Option<Image<T>>], PsfieldError> {
        if by == [0.0, 0.0] || !self.has_image() {
            return Ok(&self.images);
        }
        // The memory of images that were moved otherwise is freed first.
        let kept = self.moved_images.take().filter(|(origin, _)| *origin == by);
        let moved = if let Some(kept) = kept {
            kept
        } else {
            let pixels = by.map(|shift| (shift * self.setup.options.oversample as f64) as i64);
            let moved = |image: &Image<T>| Image::new(translated(image.pixels(), pixels));
            let moved = self
                .images
                .iter()
                .map(|image| image.as_ref().map(moved).transpose());
            (by, moved.collect::<Result<_, _>>()?)
        };
        Ok(&self.moved_images.insert(moved).1)
    }

    /// The sources of an exposure, for each layer, and a list of them. Those at rest on the sky have moved by
    /// `origin`. The list has moved by `shift_px`. If trails have PSFs of their own, they are further layers.
    fn sources_of(
        &self,
        times: (f64, f64),
        (origin, shift_px): ([f64; 2], [f64; 2]),
        has_trails: bool,
    ) -> Result<(LayerSources, Vec<SourceInExposure>), PsfieldError> {
        let (at_rest, layers) = (Motion::fixed(origin), self.images.len());
        let mut drawn = LayerSources::new(layers * (1 + usize::from(has_trails)));
        let (catalog, mut listed) = (self.light.catalog(), Vec::new());
        for (place, (source, &row)) in sources_of(catalog).zip(catalog.rows()).enumerate() {
            let (at, flux) = (
                source.position,
                source.flux * self.series.light_curves.mean_factor(row, times)?,
            );
            let velocity = catalog.velocities().map_or([0.0, 0.0], |all| all[place]);
            let moves = is_moving(&velocity);
            let trail = if moves {
                let own = self.series.pointing.with_velocity(velocity);
                let trail = own.during(times).map_err(|error| {
                    PsfieldError::new(error.kind(), format!("source {row} (counted from 0): {error}"))
                })?;
                Cow::Owned(trail)
            } else {
                Cow::Borrowed(&at_rest)
            };
            let mean = if moves { trail.mean() } else { shift_px };
            listed.push(SourceInExposure {
                row,
                x: at.x() + mean[0],
                y: at.y() + mean[1],
                flux,
            });
            if flux == 0.0 {
                continue;
            }
            let first = if moves && has_trails { layers } else { 0 };
            for (weight, [dx, dy]) in trail.points() {
                let position = Position::new(at.x() + dx, at.y() + dy)?;
                for (layer, part) in self.light.layers_of(place) {
                    let flux = part * (weight * flux);
                    drawn.push(
                        first + layer,
                        Source {
                            position,
                            flux,
                            ..source
                        },
                    )?;
                }
            }
        }
        listed.sort_by_key(|source| source.row);
        Ok((drawn, listed))
    }
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
