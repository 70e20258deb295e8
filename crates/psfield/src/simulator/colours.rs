//! Images of scenes whose light has several spectra.

use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use conv_core::{ConvError, ConvReal, Engine, Plan, RowStream, TileCounts};
use ndarray::{ArrayView2, ArrayViewMut2};
use psf_types::{Image, ImageView, NoProgress, Progress, PsfModel};

use super::check::{spot_check_layers, with_all_sources};
use super::flux::check_flux;
use super::sources::has_sources;
use super::stream::SceneRows;
use super::{Convolver, Mixtures, Preparation, SimulationWarning, Simulator};
use crate::device::{CpuReason, Placement};
use crate::{ErrorKind, PixelPicker, Psf, PsfieldError, Scene, SimulateOptions, SpotCheck};

/// Makes images of scenes in colour: one [`Scene`] for each spectrum, added up in one image.
///
/// The PSF has one state for each spectrum ([`Psf::for_spectra`]). The images of all scenes are
/// convolved together: the engine adds the images, weighted for each mode, and transforms the sums. So
/// colour costs no convolutions of its own. The tolerance holds for every position and every spectrum.
/// Stars and galaxies are drawn with the PSFs of their own spectra.
///
/// ```
/// use ndarray::{Array2, Array3};
/// use psfield::psf_types::{
///     Position, PsfSamples, SamplePositions, SampleStates, StampGrid, StateKind,
/// };
/// use psfield::spectra::{Bandpass, Curve};
/// use psfield::{ColourSimulator, Psf, Scene, SimulateOptions, open_spectrum};
/// // A PSF that widens with the wavelength.
/// let stamps = Array3::from_shape_fn((2, 17, 17), |(j, y, x)| {
///     let square = (y as f64 - 8.0).powi(2) + (x as f64 - 8.0).powi(2);
///     (-square / (3.0 + j as f64)).exp()
/// });
/// let wavelengths = SampleStates::new(StateKind::Wavelength, &[0.5, 0.7])?;
/// let positions = SamplePositions::with_states(vec![Position::of_pixel(0, 0); 2], None, Some(wavelengths))?;
/// let psf = Psf::from(PsfSamples::new(stamps, positions, StampGrid::new(17, 17)?)?);
///
/// let bandpass = Bandpass::new(Curve::new(vec![0.5, 0.6, 0.7], vec![0.0, 1.0, 0.0])?);
/// let spectra = [open_spectrum("blackbody:3500")?, open_spectrum("blackbody:12000")?];
/// let psf = psf.for_spectra(&bandpass, &spectra)?;
/// let simulator = ColourSimulator::<f32>::new(&psf, (40, 50), &SimulateOptions::default())?;
/// let (red, blue) = (Scene::new(Array2::ones((40, 50)))?, Scene::new(Array2::ones((40, 50)))?);
/// let image = simulator.simulate(&[red, blue])?;
/// assert!((image.pixels()[[20, 25]] - 2.0).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct ColourSimulator<T: ConvReal> {
    psf: Psf,
    /// One for each spectrum. They share their stamps.
    spectra: Vec<Simulator<T>>,
    /// The parts that the spectra share.
    shared: Mixtures<T>,
    /// The engines for the images of some spectra, by the numbers of these spectra.
    engines: Mutex<Vec<OfSpectra<T>>>,
}

/// An engine, and the numbers of the spectra whose images it convolves.
type OfSpectra<T> = (Vec<usize>, Arc<Engine<T>>);

impl<T: ConvReal> ColourSimulator<T> {
    /// Makes a simulator for scenes of `shape` `(ny, nx)`, in the scenes' own pixels. Each state of
    /// the PSF is a spectrum. Plans are made when the first scenes need them.
    ///
    /// # Errors
    /// The errors of [`SimulatorBuilder::build`](crate::SimulatorBuilder::build).
    pub fn new(psf: &Psf, shape: (usize, usize), options: &SimulateOptions) -> Result<Self, PsfieldError> {
        // The PSFs of the spectra share the stamps of these models.
        psf.models()?;
        let of_state = |psf: Psf| psf.simulator(shape).options(options.clone()).build::<T>();
        let spectra = match psf.states() {
            None => vec![of_state(psf.clone())?],
            Some(states) => {
                let values = states.values().iter();
                let made = values.map(|&value| psf.at_state(value).and_then(of_state));
                made.collect::<Result<_, _>>()?
            }
        };
        Ok(Self {
            psf: psf.clone(),
            spectra,
            shared: Mixtures::new(psf.clone()),
            engines: Mutex::new(Vec::new()),
        })
    }

    /// The simulators of the spectra, in the order of the PSF's states. They differ only in their PSF.
    pub fn spectra(&self) -> &[Simulator<T>] {
        &self.spectra
    }

    /// Returns the image of the scenes, one for each spectrum.
    ///
    /// # Errors
    /// The errors of [`simulate_into`](Self::simulate_into).
    pub fn simulate(&self, scenes: &[Scene<'_, T>]) -> Result<Image<T>, PsfieldError> {
        self.check_scenes(scenes, false)?;
        let mut image = self.spectra[0].zeros();
        self.simulate_into(scenes, image.view_mut(), &NoProgress)?;
        Ok(Image::new(image)?)
    }

    /// Adds the image of the scenes, one for each spectrum, to `image`. Scenes may lack an image.
    /// Otherwise as [`Simulator::simulate_into`].
    ///
    /// # Errors
    /// The errors of [`Simulator::simulate_into`], and [`ErrorKind::Data`] unless there is one scene
    /// for each spectrum.
    pub fn simulate_into(
        &self,
        scenes: &[Scene<'_, T>],
        mut image: ArrayViewMut2<'_, T>,
        progress: &dyn Progress,
    ) -> Result<TileCounts, PsfieldError> {
        self.check_scenes(scenes, false)?;
        let first = &self.spectra[0];
        first.check_image(&image)?;
        if !first.options.method.has_plan() {
            let mut counts = TileCounts::default();
            for (simulator, scene) in self.spectra.iter().zip(scenes) {
                counts += simulator.simulate_into(scene, image.view_mut(), progress)?;
            }
            return Ok(counts);
        }
        let mut counts = TileCounts::default();
        let images = scenes
            .iter()
            .enumerate()
            .filter_map(|(n, scene)| Some((n, scene.image()?)));
        let (used, light): (Vec<usize>, Vec<ImageView<'_, T>>) =
            images.map(|(n, image)| (n, image.view())).unzip();
        if !used.is_empty() {
            let engine = self.engine(&used, progress)?;
            counts = first.add_executed(&engine, image.view_mut(), |image| {
                engine.execute_layers(&light, image, progress)
            })?;
        }
        for (simulator, scene) in self.spectra.iter().zip(scenes) {
            simulator.draw_sources_into(
                scene.sources(),
                first.geometry.region,
                image.view_mut(),
                progress,
            )?;
        }
        Ok(counts)
    }

    /// Makes the image of scenes row by row, as [`Simulator::stream`]. Reads the rows of the images of
    /// the spectra `with_images` from `rows`: layer 0 is the image of the first of them. Takes only
    /// stars and galaxies from `scenes`.
    ///
    /// # Errors
    /// The errors of the stream and of [`simulate_into`](Self::simulate_into), and
    /// [`ErrorKind::Setting`] for a method without a plan.
    pub fn stream<R: RowStream<T>>(
        &self,
        scenes: &[Scene<'_, T>],
        with_images: &[usize],
        rows: &mut R,
        progress: &dyn Progress,
    ) -> Result<TileCounts, R::Error>
    where
        R::Error: From<PsfieldError>,
    {
        self.check_scenes(scenes, true)?;
        if !self.spectra[0].options.method.has_plan() {
            return Err(PsfieldError::needs_plan("rows can be streamed").into());
        }
        let engine = self.engine(with_images, progress)?;
        let spectra = self
            .spectra
            .iter()
            .zip(scenes.iter().map(Scene::sources))
            .collect();
        let mut rows = SceneRows::new(spectra, rows, progress);
        engine.stream(&mut rows, progress)
    }

    /// Makes the models and the plan that scenes like `scenes` need, unless they exist. The images of the
    /// spectra `streamed` will be read row by row ([`stream`](Self::stream)). The model in the result is
    /// that of the first spectrum.
    ///
    /// # Errors
    /// The errors of [`Simulator::prepare`].
    pub fn prepare(
        &self,
        scenes: &[Scene<'_, T>],
        streamed: &[usize],
        progress: &dyn Progress,
    ) -> Result<Preparation<'_>, PsfieldError> {
        self.check_scenes(scenes, !streamed.is_empty())?;
        let first = &self.spectra[0];
        let used: Vec<usize> = (0..scenes.len())
            .filter(|n| scenes[*n].image().is_some() || streamed.contains(n))
            .collect();
        if used.is_empty() || !first.options.method.has_plan() {
            return first.prepare(&scenes[0], false, progress);
        }
        let clock = Instant::now();
        let model = &self.shared.on_pixels(&self.spectra[0].options)?.models()?[0];
        let fit_seconds = clock.elapsed().as_secs_f64();
        let engine = self.engine(&used, progress)?;
        Ok(Preparation {
            model,
            plan: Some(engine.plan().summary()),
            placement: Placement::cpu(CpuReason::Spectra),
            fit_seconds,
            plan_seconds: clock.elapsed().as_secs_f64() - fit_seconds,
        })
    }

    /// Returns warnings about the sources of all scenes and about the PSF at them.
    pub fn warnings(&self, scenes: &[Scene<'_, T>]) -> Vec<SimulationWarning> {
        let mut all = Vec::new();
        for (simulator, scene) in self.spectra.iter().zip(scenes) {
            for warning in simulator.warnings(scene) {
                if !all.contains(&warning) {
                    all.push(warning);
                }
            }
        }
        all
    }

    /// Compares `count` random pixels of an image of these scenes, and the pixels around random
    /// sources, with the direct sum in f64. As [`Simulator::spot_check`].
    ///
    /// # Errors
    /// The errors of [`Simulator::exact_at`].
    pub fn spot_check(
        &self,
        scenes: &[Scene<'_, T>],
        image: &Image<T>,
        (count, seed): (usize, u64),
        progress: &dyn Progress,
    ) -> Result<SpotCheck, PsfieldError> {
        self.check_scenes(scenes, false)?;
        let layers: Vec<_> = self.spectra.iter().zip(scenes).collect();
        spot_check_layers(&layers, image, (count, seed), progress)
    }

    /// Picks the pixels of a streamed image that a check compares, as [`Simulator::picker`].
    pub fn picker(&self, scenes: &[Scene<'_, T>], pixels: (usize, u64)) -> PixelPicker {
        let all = with_all_sources(Scene::dark(), scenes.iter());
        self.spectra[0].picker(&all, true, pixels)
    }

    /// Compares pixels that the [`picker`](Self::picker) has chosen from the rows of a streamed image
    /// with the direct sum, as [`Simulator::spot_check_stream`]. `with_images` as in
    /// [`stream`](Self::stream).
    ///
    /// # Errors
    /// The errors of the stream and of [`Simulator::exact_at`].
    pub fn spot_check_stream<R: RowStream<T, Error = PsfieldError>>(
        &self,
        scenes: &[Scene<'_, T>],
        with_images: &[usize],
        rows: &mut R,
        picker: PixelPicker,
        progress: &dyn Progress,
    ) -> Result<SpotCheck, PsfieldError> {
        SpotCheck::of_picked::<T>(picker, |pixels| {
            let mut exact = vec![0.0; pixels.len()];
            let mut allowed = self.spectra[0].promised(true, pixels.len());
            for (n, (simulator, scene)) in self.spectra.iter().zip(scenes).enumerate() {
                let of_spectrum = match with_images.iter().position(|&with| with == n) {
                    Some(layer) => {
                        let mut rows = OneLayer { rows, layer };
                        let allowed = allowed.as_deref_mut();
                        simulator.exact_by_rows(scene, &mut rows, pixels, allowed, progress)?
                    }
                    None => simulator.exact_at(scene, pixels, progress)?,
                };
                exact
                    .iter_mut()
                    .zip(of_spectrum)
                    .for_each(|(sum, value)| *sum += value);
                if let Some(allowed) = &mut allowed {
                    simulator.add_errors_of_sources(scene, pixels, allowed)?;
                }
            }
            Ok((exact, allowed))
        })
    }

    fn check_scenes(&self, scenes: &[Scene<'_, T>], rows: bool) -> Result<(), PsfieldError> {
        let (expected, got) = (self.spectra.len(), scenes.len());
        if expected != got {
            let message = format!(
                "the PSF has {expected} spectra, but there are {got} scenes: give one scene for each"
            );
            return Err(PsfieldError::new(ErrorKind::Data, message));
        }
        let checked = self.spectra.iter().zip(scenes);
        for (simulator, scene) in checked {
            simulator.check_sources(scene, rows)?;
        }
        if scenes.iter().any(has_sources) && self.spectra[0].options.method.has_plan() {
            self.shared.lend_sources(&self.spectra)?;
        }
        Ok(())
    }

    /// The engine for images of some spectra.
    fn engine(&self, used: &[usize], progress: &dyn Progress) -> Result<Arc<Engine<T>>, PsfieldError> {
        let engines = || self.engines.lock().unwrap_or_else(PoisonError::into_inner);
        let known = engines()
            .iter()
            .find(|(of, _)| of == used)
            .map(|(_, engine)| Arc::clone(engine));
        if let Some(engine) = known {
            return Ok(engine);
        }
        let clock = Instant::now();
        let first = &self.spectra[0];
        let all = self.shared.on_pixels(&self.spectra[0].options)?.models()?;
        let models: Vec<PsfModel> = used.iter().map(|&n| all[n].clone()).collect();
        let options = first.planned_for(&all[0])?.expect("the method has a plan");
        for model in &models {
            check_flux(&self.psf, model, &options)?;
        }
        let geometry = &first.geometry;
        let (frame, region) = (geometry.fine(geometry.frame)?, geometry.fine(geometry.region)?);
        let plan = Plan::of_layers(&models, geometry.shape, frame, region, options, progress)?;
        let made = Convolver::of_plan(plan, &first.options, clock)?;
        let engine = Arc::new(made.engine.ok_or(ConvError::Layers("no engine was made"))?);
        engines().push((used.to_vec(), Arc::clone(&engine)));
        Ok(engine)
    }
}

/// One layer of a stream of several.
struct OneLayer<'a, R> {
    rows: &'a mut R,
    layer: usize,
}

impl<T: ConvReal, R: RowStream<T>> RowStream<T> for OneLayer<'_, R> {
    type Error = R::Error;

    fn read(&mut self, _: usize, rows: Range<usize>, light: ArrayViewMut2<'_, T>) -> Result<(), R::Error> {
        self.rows.read(self.layer, rows, light)
    }

    fn write(&mut self, rows: ArrayView2<'_, T>) -> Result<(), R::Error> {
        self.rows.write(rows)
    }
}
