//! The simulators of a plan: one or, in colour, one for each list of spectra.

use std::sync::{Arc, Mutex, PoisonError};

use ndarray::ArrayView2;
use psfield::conv_core::ConvReal;
use psfield::psf_types::{ImageView, PixelRegion};
use psfield::{Psf, PsfieldError, Scene, SceneLight, SimulateOptions, Simulator};

use crate::catalog::Sources;
use crate::colour::{Colour, light_of_scene};
use crate::error::Failure;
use crate::threads::Watch;

/// The images of a scene, `[y, x]`, and the names of their spectra.
pub(crate) type Images<'a, T> = Vec<(Option<String>, ArrayView2<'a, T>)>;

/// A plan in colour keeps the simulators of this number of lists of spectra.
const MOST_KEPT: usize = 4;

/// Makes the simulators of scenes of one shape, and keeps them.
pub(crate) struct Simulators<T: ConvReal> {
    psf: Psf,
    colour: Option<Colour>,
    /// The only one or, in colour, that of the plan's spectrum or of a flat one.
    pub(crate) first: Arc<Simulator<T>>,
    /// In colour: those that were used last, by the names of their spectra.
    kept: Mutex<Vec<Kept<T>>>,
}

type Kept<T> = (Vec<String>, Arc<Simulator<T>>);

impl<T: ConvReal> Simulators<T> {
    pub(crate) fn new(
        psf: Psf,
        shape: (usize, usize),
        options: SimulateOptions,
        colour: Option<Colour>,
    ) -> Result<Self, PsfieldError> {
        let seen = match &colour {
            Some(colour) => {
                let sed = colour.sed.clone().unwrap_or_else(|| "powerlaw:0".to_owned());
                colour.psf_of(&psf, &dark_light::<T>(&[sed]))?
            }
            None => psf.clone(),
        };
        let first = Arc::new(seen.simulator(shape).options(options).build()?);
        Ok(Self {
            kept: Mutex::new(match colour.as_ref().and_then(|colour| colour.sed.clone()) {
                Some(sed) => vec![(vec![sed], Arc::clone(&first))],
                None => Vec::new(),
            }),
            first,
            psf,
            colour,
        })
    }

    pub(crate) fn in_colour(&self) -> bool {
        self.colour.is_some()
    }

    /// Returns whether scenes without spectra of their own can be simulated.
    pub(crate) fn has_spectrum(&self) -> bool {
        self.colour.as_ref().is_none_or(|colour| colour.sed.is_some())
    }

    /// Simulators of another region of the frame, with the tiles of these.
    pub(crate) fn for_region(&self, region: PixelRegion, watch: &Watch) -> Result<Self, PsfieldError> {
        if !self.in_colour() {
            return Ok(Self::only(
                self.psf.clone(),
                self.first.for_region(region, watch)?,
            ));
        }
        let options = SimulateOptions {
            region: Some(region),
            ..self.first.options().clone()
        };
        self.others(self.psf.clone(), options, |_, before| {
            before.for_region(region, watch)
        })
    }

    /// Simulators of another PSF, with the tiles of these if possible.
    pub(crate) fn with_psf(&self, psf: &Psf, watch: &Watch) -> Result<Self, PsfieldError> {
        let Some(colour) = &self.colour else {
            return Ok(Self::only(psf.clone(), self.first.with_psf(psf.clone(), watch)?));
        };
        self.others(psf.clone(), self.first.options().clone(), |spectra, before| {
            before.with_psf(colour.psf_of(psf, &dark_light::<T>(spectra))?, watch)
        })
    }

    fn only(psf: Psf, simulator: Simulator<T>) -> Self {
        Self {
            psf,
            colour: None,
            first: Arc::new(simulator),
            kept: Mutex::default(),
        }
    }

    /// Simulators in colour with other settings or another PSF. `other` makes a simulator from the one before.
    fn others(
        &self,
        psf: Psf,
        options: SimulateOptions,
        other: impl Fn(&[String], &Simulator<T>) -> Result<Simulator<T>, PsfieldError>,
    ) -> Result<Self, PsfieldError> {
        let shape = self.first.scene_shape();
        let made = Self::new(psf, (shape.ny(), shape.nx()), options, self.colour.clone())?;
        let kept: Vec<Kept<T>> = self.kept.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let others = kept.into_iter().map(|(spectra, before)| {
            let simulator = other(&spectra, &before)?;
            Ok((spectra, Arc::new(simulator)))
        });
        let kept: Vec<Kept<T>> = others.collect::<Result<_, PsfieldError>>()?;
        let sed = self.colour.as_ref().and_then(|colour| colour.sed.clone());
        let of_plan: Vec<String> = sed.into_iter().collect();
        let of_plan = kept.iter().find(|(spectra, _)| *spectra == of_plan);
        let first = of_plan.map_or(made.first, |(_, simulator)| Arc::clone(simulator));
        let kept = Mutex::new(kept);
        Ok(Self { first, kept, ..made })
    }

    /// A scene, and the simulator of its spectra. Without colour, the scene borrows its image.
    pub(crate) fn scene<'a>(
        &self,
        images: Images<'a, T>,
        sources: &'a Sources,
    ) -> Result<(Arc<Simulator<T>>, Scene<'a, T>), Failure> {
        if !self.in_colour() {
            let scene = match images.into_iter().next() {
                Some((_, image)) => ImageView::new(image).map_err(Failure::of("scene"))?.into(),
                None => Scene::dark(),
            };
            let scene = scene.with_stars(sources.catalog.stars());
            return Ok((
                Arc::clone(&self.first),
                scene.with_galaxies(sources.catalog.galaxies()),
            ));
        }
        let light = light_of_scene(self.colour.as_ref(), images, sources)?;
        let simulator = self.of_spectra(&light)?;
        Ok((simulator, light.into_scene()?))
    }

    /// The simulator of the spectra of light, which is made unless it is kept.
    pub(crate) fn of_spectra(&self, light: &SceneLight<T>) -> Result<Arc<Simulator<T>>, PsfieldError> {
        let Some(colour) = &self.colour else {
            return Ok(Arc::clone(&self.first));
        };
        let lock = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        // Moves the simulator to the front.
        let find = |kept: &mut Vec<Kept<T>>| {
            let place = kept.iter().position(|(spectra, _)| spectra == light.spectra())?;
            kept[..=place].rotate_right(1);
            Some(Arc::clone(&kept[0].1))
        };
        if let Some(simulator) = find(&mut lock()) {
            return Ok(simulator);
        }
        let (shape, options) = (self.first.scene_shape(), self.first.options().clone());
        let psf = colour.psf_of(&self.psf, light)?;
        let made = psf.simulator((shape.ny(), shape.nx())).options(options).build()?;
        let mut kept = lock();
        // Another thread may have made it meanwhile.
        if let Some(simulator) = find(&mut kept) {
            return Ok(simulator);
        }
        let simulator = Arc::new(made);
        kept.truncate(MOST_KEPT - 1);
        kept.insert(0, (light.spectra().to_vec(), Arc::clone(&simulator)));
        Ok(simulator)
    }
}

/// Light of these spectra, for what depends on nothing else.
pub(crate) fn dark_light<T: ConvReal>(spectra: &[String]) -> SceneLight<T> {
    let mut light = SceneLight::new();
    for spectrum in spectra {
        light.add_streamed(Some(spectrum));
    }
    light
}
