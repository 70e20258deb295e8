//! A plan in one precision.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis, CowArray, Ix2};
use psfield::conv_core::{ConvReal, PlanOptions, PlanSummary, TileCounts};
use psfield::psf_types::{FrameShape, Image, ImageView, PixelRegion, Scene};
use psfield::{
    DeviceOptions, Gpus, Method, Placement, PsfInput, PsfieldError, SceneLayout, SceneParts, SceneSources,
    Simulation, SimulationOptions, SimulationPlan, SimulationWarning, SpotCheck,
};

use crate::interruptible::Watch;
use crate::kept_psf::KeptPsf;
use crate::sources::Sources;

/// What plans are made with.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    /// Of the scene, in its own pixels.
    pub(crate) shape: FrameShape,
    /// In pixels of the image.
    pub(crate) frame: Option<PixelRegion>,
    pub(crate) method: Method,
    pub(crate) simulation: SimulationOptions,
    pub(crate) plan: PlanOptions,
    pub(crate) device: DeviceOptions,
}

/// Plans for the scenes of one shape: that for images is made at once, those for stars and for galaxies when the first come.
pub(crate) struct Planned<T: ConvReal> {
    psf: Arc<KeptPsf>,
    settings: Settings,
    images: Prepared<T>,
    /// For scenes with galaxies, which reach in from beyond the edges: the scene with dark pixels around it.
    padded: OnceLock<Prepared<T>>,
    stars: OnceLock<Prepared<T>>,
    /// Held while one of them is made.
    making: Mutex<()>,
    /// The process that made it.
    process: u32,
}

/// A simulation and its plan.
struct Prepared<T: ConvReal> {
    simulation: Simulation,
    plan: SimulationPlan<T>,
    placement: Placement,
}

/// Extended light, and what convolves it.
type Lit<'p, 'a, T> = (&'p Prepared<T>, CowArray<'a, T, Ix2>);

/// What a simulation gives beside the image.
pub(crate) struct Outcome {
    pub(crate) tiles: TileCounts,
    pub(crate) warnings: Vec<SimulationWarning>,
}

/// The GPUs that are open, which all plans of a process share.
static GPUS: Mutex<Option<(u32, Gpus)>> = Mutex::new(None);

impl<T: ConvReal> Planned<T> {
    pub(crate) fn new(psf: Arc<KeptPsf>, settings: Settings) -> Result<Self, PsfieldError> {
        let layout = layout(&settings, psf.input(), true)?;
        let dark = SceneSources::<T>::new(layout, Vec::new(), Vec::new())?;
        Ok(Self {
            images: prepared(&psf, &settings, true, dark.scene())?,
            psf,
            settings,
            padded: OnceLock::new(),
            stars: OnceLock::new(),
            making: Mutex::new(()),
            process: std::process::id(),
        })
    }

    /// The shape of the image.
    pub(crate) fn frame_shape(&self) -> FrameShape {
        let (shape, s) = (self.settings.shape, self.settings.simulation.oversample());
        match self.settings.frame {
            Some(frame) => frame.shape(),
            None => {
                FrameShape::new((shape.nx() / s).max(1), (shape.ny() / s).max(1)).expect("at least one pixel")
            }
        }
    }

    pub(crate) fn settings(&self) -> &Settings {
        &self.settings
    }

    pub(crate) fn summary(&self) -> Option<PlanSummary> {
        self.images.plan.summary()
    }

    pub(crate) fn placement(&self) -> &Placement {
        &self.images.placement
    }

    /// The image of a scene, in `out` or new.
    pub(crate) fn simulate(
        &self,
        image: Option<ArrayView2<'_, T>>,
        sources: Sources,
        out: Option<ArrayViewMut2<'_, T>>,
        watch: &Watch,
    ) -> Result<(Option<Array2<T>>, Outcome), PsfieldError> {
        let placed = self.placed(image.is_some(), sources)?;
        let (mut made, mut out) = match out {
            Some(mut out) => {
                out.axis_iter_mut(Axis(0))
                    .into_par_iter()
                    .for_each(|mut row| row.fill(T::zero()));
                (None, Some(out))
            }
            None => (Some(self.dark()), None),
        };
        let mut tiles = TileCounts::default();
        {
            let mut target = match (&mut made, &mut out) {
                (Some(made), _) => made.view_mut(),
                (None, Some(out)) => out.view_mut(),
                (None, None) => unreachable!("one of them is there"),
            };
            if let Some((prepared, light)) = self.light(&placed, image)? {
                let dark = placed.scene().clone().with_sources(Vec::new());
                let (simulation, plan) = (&prepared.simulation, &prepared.plan);
                let light = ImageView::new(light.view())?;
                tiles = simulation.add_planned_to(plan, &dark, Some(&light), target.view_mut(), watch)?;
            }
            if !placed.scene().sources().is_empty() {
                let stars = self.stars(placed.scene())?;
                let (simulation, plan) = (&stars.simulation, &stars.plan);
                simulation.add_planned_to(plan, placed.scene(), None, target.view_mut(), watch)?;
            }
            // As the library checks its own results.
            ImageView::new(target.view())?;
        }
        let warnings = placed.warnings(self.psf.input().grid().oversampling());
        let outcome = Outcome { tiles, warnings };
        Ok((made, outcome))
    }

    /// The transpose of the operator that makes images of scenes.
    pub(crate) fn adjoint(&self, image: ArrayView2<'_, T>, watch: &Watch) -> Result<Array2<T>, PsfieldError> {
        let (simulation, plan) = (&self.images.simulation, &self.images.plan);
        let scene = simulation.adjoint_planned(plan, &ImageView::new(image)?, watch)?;
        Ok(scene.into_pixels())
    }

    /// An image checked against the direct sum.
    pub(crate) fn spot_check(
        &self,
        light: Option<ArrayView2<'_, T>>,
        sources: Sources,
        image: ArrayView2<'_, T>,
        (count, seed): (usize, u64),
    ) -> Result<SpotCheck, PsfieldError> {
        let placed = self.placed(light.is_some(), sources)?;
        let anchor = self.settings.plan.anchor();
        let extended = self.light(&placed, light)?;
        let check = SpotCheck::run(&Image::new(image.to_owned())?, count, seed, |pixels| {
            let mut sums = vec![0.0; pixels.len()];
            let mut add = |of: Vec<f64>| sums.iter_mut().zip(of).for_each(|(sum, value)| *sum += value);
            if let Some((prepared, light)) = &extended {
                let dark = placed.scene().clone().with_sources(Vec::new());
                let rows = Some((light.view(), 0));
                add(prepared.simulation.exact_at_rows(&dark, rows, anchor, pixels)?);
            }
            if !placed.scene().sources().is_empty() {
                let stars = self.stars(placed.scene())?;
                add(stars
                    .simulation
                    .exact_at_rows(placed.scene(), None, anchor, pixels)?);
            }
            Ok(sums)
        })?;
        let limit = SpotCheck::limit_of::<T>(self.settings.method, self.settings.plan, extended.is_some());
        Ok(match limit {
            Some(limit) => check.judged(limit),
            None => check,
        })
    }

    fn dark(&self) -> Array2<T> {
        match self.images.plan.engine() {
            // Its memory has been written to by all threads.
            Some(engine) if self.settings.simulation.oversample() == 1 => engine.dark_image(),
            _ => {
                let shape = self.frame_shape();
                Array2::zeros((shape.ny(), shape.nx()))
            }
        }
    }

    /// Sources on the scene.
    fn placed(&self, of_image: bool, sources: Sources) -> Result<SceneSources<T>, PsfieldError> {
        SceneSources::new(
            layout(&self.settings, self.psf.input(), of_image)?,
            sources.stars,
            sources.galaxies,
        )
    }

    /// The extended light of a scene and what convolves it; none where there are stars alone.
    fn light<'a>(
        &self,
        placed: &SceneSources<T>,
        image: Option<ArrayView2<'a, T>>,
    ) -> Result<Option<Lit<'_, 'a, T>>, PsfieldError> {
        let light = match image {
            Some(image) => placed.light_of(image)?,
            None if placed.galaxies().is_empty() => return Ok(None),
            None => {
                let shape = placed.scene().shape();
                let mut light = Array2::zeros((shape.ny(), shape.nx()));
                placed.add_galaxies(light.view_mut(), 0);
                light.into()
            }
        };
        let prepared = if placed.padding() == 0 {
            &self.images
        } else {
            self.kept(&self.padded, || {
                prepared(&self.psf, &self.settings, true, placed.scene())
            })?
        };
        Ok(Some((prepared, light)))
    }

    fn stars(&self, scene: &Scene<T>) -> Result<&Prepared<T>, PsfieldError> {
        self.kept(&self.stars, || prepared(&self.psf, &self.settings, false, scene))
    }

    fn kept<'a>(
        &self,
        place: &'a OnceLock<Prepared<T>>,
        make: impl FnOnce() -> Result<Prepared<T>, PsfieldError>,
    ) -> Result<&'a Prepared<T>, PsfieldError> {
        let _making = self.making.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kept) = place.get() {
            return Ok(kept);
        }
        let made = make()?;
        Ok(place.get_or_init(|| made))
    }

    /// Whether it lies on a GPU that another process opened, the parent of a fork.
    pub(crate) fn is_on_foreign_gpu(&self) -> bool {
        self.placement().adapter().is_some() && self.process != std::process::id()
    }
}

fn layout(settings: &Settings, psf: &PsfInput, of_image: bool) -> Result<SceneLayout, PsfieldError> {
    let (shape, s) = (settings.shape, settings.simulation.oversample());
    let layout = if of_image {
        SceneLayout::of_image(shape, s)?
    } else {
        SceneLayout::of_frame(shape.nx() / s, shape.ny() / s, s)?
    };
    let reach = psf.reach(settings.simulation.stamp_size());
    Ok(layout.with_frame(settings.frame).with_reach(reach))
}

/// Models and plan for images, or for stars.
fn prepared<T: ConvReal>(
    psf: &KeptPsf,
    settings: &Settings,
    image: bool,
    scene: &Scene<T>,
) -> Result<Prepared<T>, PsfieldError> {
    let parts = SceneParts {
        image,
        sources: !image,
        frame: scene.frame().shape(),
    };
    let options = settings
        .method
        .plan_options(settings.plan)
        .unwrap_or(settings.plan);
    let resampled = psf.input().needs_resampling(parts, settings.simulation)?;
    let simulation = Simulation::for_parts(psf.for_simulation(resampled)?, parts, settings.simulation)?;
    let dark = scene.clone().with_sources(Vec::new());
    let mut plan = if image {
        simulation.plan_for_images(&dark, options)?
    } else {
        simulation.plan(&dark, options)?
    };
    let process = std::process::id();
    let mut kept = GPUS.lock().unwrap_or_else(PoisonError::into_inner);
    if kept.as_ref().is_none_or(|&(of, _)| of != process) {
        // The parent's are not to be closed here.
        std::mem::forget(kept.take());
        *kept = Some((process, Gpus::default()));
    }
    let (_, gpus) = kept.as_mut().expect("just put there");
    let placement = gpus.place(&mut plan, &settings.device, rayon::current_num_threads())?;
    Ok(Prepared {
        simulation,
        plan,
        placement,
    })
}
