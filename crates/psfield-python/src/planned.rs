//! A plan in one precision.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, TryLockError};
use std::time::Duration;

use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis, CowArray, Ix2, s};
use psfield::conv_core::{ConvError, ConvReal, PlanOptions, PlanSummary, TileCounts};
use psfield::psf_types::{FrameShape, Image, ImageView, PixelRegion, Progress, Scene};
use psfield::{
    DeviceOptions, Gpus, Method, Placement, PsfInput, PsfieldError, SceneLayout, SceneParts, SceneSources,
    Simulation, SimulationOptions, SimulationPlan, SimulationWarning, SpotCheck, sersic,
};
use rayon::ThreadPool;

use crate::error::Failure;
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
    /// The part of the frame that is made, in pixels of the image counted from the frame's first; none for all of it.
    pub(crate) region: Option<PixelRegion>,
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
    padded: Later<T>,
    /// Shared by the plans for regions of a frame.
    stars: Arc<Later<T>>,
    /// The process that made it.
    process: u32,
}

/// A simulation and its plan.
struct Prepared<T: ConvReal> {
    simulation: Arc<Simulation>,
    plan: SimulationPlan<T>,
    placement: Placement,
}

/// What is made when it is first needed, and kept.
struct Later<T: ConvReal> {
    made: OnceLock<Prepared<T>>,
    /// Held while it is made, by a thread beside the pool.
    making: Mutex<()>,
}

impl<T: ConvReal> Default for Later<T> {
    fn default() -> Self {
        Self {
            made: OnceLock::new(),
            making: Mutex::new(()),
        }
    }
}

impl<T: ConvReal> Later<T> {
    fn get(
        &self,
        watch: &Watch,
        make: impl FnOnce() -> Result<Prepared<T>, Failure>,
    ) -> Result<&Prepared<T>, Failure> {
        if let Some(made) = self.made.get() {
            return Ok(made);
        }
        let _making = turn(&self.making, watch)?;
        if let Some(made) = self.made.get() {
            return Ok(made);
        }
        let made = make()?;
        Ok(self.made.get_or_init(|| made))
    }
}

/// Extended light, and the column and the row of the (padded) scene that it begins at.
type Lit<'a, T> = (CowArray<'a, T, Ix2>, (usize, usize));

/// What a scene is convolved with.
struct Needed<'p, T: ConvReal> {
    /// Its extended light.
    extended: &'p Prepared<T>,
    /// Its stars; none where there are none.
    stars: Option<&'p Prepared<T>>,
}

/// What a simulation gives beside the image.
pub(crate) struct Outcome {
    pub(crate) tiles: TileCounts,
    pub(crate) warnings: Vec<SimulationWarning>,
}

/// The GPUs that are open, which all plans of a process share.
static GPUS: Mutex<Option<(u32, Gpus)>> = Mutex::new(None);

impl<T: ConvReal> Planned<T> {
    /// Plans, as everything here on a thread beside the pool.
    pub(crate) fn new(
        psf: Arc<KeptPsf>,
        settings: Settings,
        watch: &Watch,
        pool: &ThreadPool,
    ) -> Result<Self, Failure> {
        let layout = layout(&settings, psf.input(), true)?;
        let dark = SceneSources::<T>::new(layout, Vec::new(), Vec::new())?;
        let images = Some(settings.region);
        Ok(Self {
            images: prepared(&psf, &settings, images, dark.scene(), watch, pool)?,
            psf,
            settings,
            padded: Later::default(),
            stars: Arc::default(),
            process: std::process::id(),
        })
    }

    /// The same for another region of the frame, with the tiles that were chosen for this one.
    pub(crate) fn for_region(
        &self,
        region: PixelRegion,
        watch: &Watch,
        pool: &ThreadPool,
    ) -> Result<Self, Failure> {
        let settings = Settings {
            region: Some(region),
            ..self.settings.clone()
        };
        let dark = self.placed(true, Sources::default())?;
        let simulation = Arc::clone(&self.images.simulation);
        let of = &self.images.plan;
        let plan = pool.install(|| simulation.plan_for_other_region(of, dark.scene(), region, watch))?;
        Ok(Self {
            images: placed_on_device(simulation, plan, &settings, watch, pool)?,
            psf: Arc::clone(&self.psf),
            settings,
            padded: Later::default(),
            stars: Arc::clone(&self.stars),
            process: std::process::id(),
        })
    }

    /// The part of the scene whose light reaches the image, in pixels of the scene.
    pub(crate) fn light_region(&self) -> PixelRegion {
        let whole = self.settings.shape.region();
        self.images.plan.light_region().unwrap_or(whole)
    }

    /// The shape of the image.
    pub(crate) fn frame_shape(&self) -> FrameShape {
        let (shape, s) = (self.settings.shape, self.settings.simulation.oversample());
        match self.settings.region.or(self.settings.frame) {
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
        pool: &ThreadPool,
    ) -> Result<(Option<Array2<T>>, Outcome), Failure> {
        let placed = self.placed(image.is_some(), sources)?;
        let needed = self.needed(&placed, watch, pool)?;
        pool.install(|| self.convolved(&placed, &needed, image, out, watch))
    }

    fn convolved(
        &self,
        placed: &SceneSources<T>,
        needed: &Needed<'_, T>,
        image: Option<ArrayView2<'_, T>>,
        out: Option<ArrayViewMut2<'_, T>>,
        watch: &Watch,
    ) -> Result<(Option<Array2<T>>, Outcome), Failure> {
        let mut made = None;
        let mut target = match out {
            Some(mut out) => {
                out.axis_iter_mut(Axis(0))
                    .into_par_iter()
                    .for_each(|mut row| row.fill(T::zero()));
                out
            }
            None => made.insert(self.dark()).view_mut(),
        };
        let mut tiles = TileCounts::default();
        if let Some((light, _)) = self.light(placed, needed.extended, image) {
            let dark = placed.scene().clone().with_sources(Vec::new());
            let light = ImageView::new(light.view()).map_err(Failure::of("scene"))?;
            let (simulation, plan) = (&needed.extended.simulation, &needed.extended.plan);
            tiles = simulation.add_planned_to(plan, &dark, Some(&light), target.view_mut(), watch)?;
        }
        if let Some(stars) = needed.stars {
            let (simulation, plan) = (&stars.simulation, &stars.plan);
            let whole = self.frame_shape().region();
            let region = self.settings.region.unwrap_or(whole);
            simulation.add_stars_to_region(plan, placed.scene(), region, target.view_mut(), watch)?;
        }
        // As the library checks its own results.
        ImageView::new(target.view())?;
        let warnings = placed.warnings(self.psf.input().grid().oversampling());
        Ok((made, Outcome { tiles, warnings }))
    }

    /// The transpose of the operator that makes images of scenes: of the part of the scene that reaches the image.
    pub(crate) fn adjoint(&self, image: ArrayView2<'_, T>, watch: &Watch) -> Result<Array2<T>, Failure> {
        let (simulation, plan) = (&self.images.simulation, &self.images.plan);
        let image = ImageView::new(image).map_err(Failure::of("image"))?;
        if self.settings.region.is_none() {
            return Ok(simulation.adjoint_planned(plan, &image, watch)?.into_pixels());
        }
        let shape = self.light_region().shape();
        let mut light = Array2::zeros((shape.ny(), shape.nx()));
        simulation.add_adjoint_planned_to(plan, &image, light.view_mut(), watch)?;
        Ok(light)
    }

    /// An image checked against the direct sum.
    pub(crate) fn spot_check(
        &self,
        light: Option<ArrayView2<'_, T>>,
        sources: Sources,
        image: ArrayView2<'_, T>,
        chosen: (usize, u64),
        watch: &Watch,
        pool: &ThreadPool,
    ) -> Result<SpotCheck, Failure> {
        let placed = self.placed(light.is_some(), sources)?;
        let needed = self.needed(&placed, watch, pool)?;
        pool.install(|| self.checked(&placed, &needed, (light, image), chosen, watch))
    }

    fn checked(
        &self,
        placed: &SceneSources<T>,
        needed: &Needed<'_, T>,
        (light, image): (Option<ArrayView2<'_, T>>, ArrayView2<'_, T>),
        (count, seed): (usize, u64),
        watch: &Watch,
    ) -> Result<SpotCheck, Failure> {
        let anchor = self.settings.plan.anchor();
        let extended = self.light(placed, needed.extended, light);
        let check = SpotCheck::run(&Image::new(image.to_owned())?, count, seed, |pixels| {
            let mut sums = vec![0.0; pixels.len()];
            let mut add = |of: Vec<f64>| sums.iter_mut().zip(of).for_each(|(sum, value)| *sum += value);
            if let Some((light, first)) = &extended {
                let dark = placed.scene().clone().with_sources(Vec::new());
                let light = ImageView::new(light.view())?;
                let (simulation, part) = (&needed.extended.simulation, Some((&light, *first)));
                add(simulation.exact_at_part(&dark, part, anchor, pixels, watch)?);
            }
            if let Some(stars) = needed.stars {
                let simulation = &stars.simulation;
                add(simulation.exact_at_part(placed.scene(), None, anchor, pixels, watch)?);
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
    fn placed(&self, of_image: bool, sources: Sources) -> Result<SceneSources<T>, Failure> {
        Ok(SceneSources::new(
            layout(&self.settings, self.psf.input(), of_image)?,
            sources.stars,
            sources.galaxies,
        )?)
    }

    /// The plans for a scene, made now where they are needed for the first time.
    fn needed(
        &self,
        placed: &SceneSources<T>,
        watch: &Watch,
        pool: &ThreadPool,
    ) -> Result<Needed<'_, T>, Failure> {
        let make = |images| prepared(&self.psf, &self.settings, images, placed.scene(), watch, pool);
        let extended = match placed.galaxies() {
            [] => &self.images,
            _ => self.padded.get(watch, || make(Some(self.settings.region)))?,
        };
        let stars = match placed.scene().sources() {
            [] => None,
            _ => Some(self.stars.get(watch, || make(None))?),
        };
        Ok(Needed { extended, stars })
    }

    /// The extended light of a scene, as its plan takes it, and the column and the row that it begins at; none where there are stars alone.
    fn light<'a>(
        &self,
        placed: &SceneSources<T>,
        prepared: &Prepared<T>,
        image: Option<ArrayView2<'a, T>>,
    ) -> Option<Lit<'a, T>> {
        if placed.galaxies().is_empty() {
            // Of a region's plan it may be a part, which the plan tells by its shape.
            return image.map(|image| (image.into(), (0, 0)));
        }
        let part = prepared
            .plan
            .light_region()
            .unwrap_or(placed.scene().shape().region());
        let mut light = Array2::zeros((part.shape().ny(), part.shape().nx()));
        if let Some(image) = image {
            let of_scene = match image.dim() {
                whole if whole == (self.settings.shape.ny(), self.settings.shape.nx()) => (0, 0),
                _ => (self.light_region().x0(), self.light_region().y0()),
            };
            let padding = placed.padding() as i64;
            let first = (of_scene.0 + padding - part.x0(), of_scene.1 + padding - part.y0());
            assign_overlap(light.view_mut(), image, first);
        }
        sersic::add_galaxies(light.view_mut(), (part.x0(), part.y0()), placed.galaxies());
        Some((light.into(), (part.x0() as usize, part.y0() as usize)))
    }

    /// Whether it lies on a GPU that another process opened, the parent of a fork.
    pub(crate) fn is_on_foreign_gpu(&self) -> bool {
        self.placement().adapter().is_some() && self.process != std::process::id()
    }
}

/// Puts an image onto a plane, its first pixel at column and row `first` of the plane, as far as they overlap.
fn assign_overlap<T: ConvReal>(
    mut plane: ArrayViewMut2<'_, T>,
    image: ArrayView2<'_, T>,
    (x, y): (i64, i64),
) {
    // Where both begin, and for how long.
    let along = |first: i64, plane: usize, image: usize| {
        let (of_plane, of_image) = (first.clamp(0, plane as i64), (-first).clamp(0, image as i64));
        let length = (plane as i64 - of_plane).min(image as i64 - of_image).max(0);
        let range = |from: i64| from as usize..(from + length) as usize;
        (range(of_plane), range(of_image))
    };
    let (rows, image_rows) = along(y, plane.nrows(), image.nrows());
    let (columns, image_columns) = along(x, plane.ncols(), image.ncols());
    plane
        .slice_mut(s![rows, columns])
        .assign(&image.slice(s![image_rows, image_columns]));
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

/// Models and plan for images (of a region of the frame, or of all of it), or for stars.
#[allow(
    clippy::option_option,
    reason = "whether there are images, and whether of a part of the frame"
)]
fn prepared<T: ConvReal>(
    psf: &KeptPsf,
    settings: &Settings,
    images: Option<Option<PixelRegion>>,
    scene: &Scene<T>,
    watch: &Watch,
    pool: &ThreadPool,
) -> Result<Prepared<T>, Failure> {
    let parts = SceneParts {
        image: images.is_some(),
        sources: images.is_none(),
        frame: scene.frame().shape(),
    };
    let options = settings
        .method
        .plan_options(settings.plan)
        .unwrap_or(settings.plan);
    let (simulation, plan) = pool.install(|| -> Result<_, Failure> {
        let resampled = psf.input().needs_resampling(parts, settings.simulation)?;
        let simulation = Simulation::for_parts(psf.for_simulation(resampled)?, parts, settings.simulation)?;
        let dark = scene.clone().with_sources(Vec::new());
        let plan = match images {
            Some(Some(region)) => simulation.plan_for_region(&dark, region, options, watch)?,
            Some(None) => simulation.plan_for_images_with_progress(&dark, options, watch)?,
            None => simulation.plan(&dark, options)?,
        };
        Ok((simulation, plan))
    })?;
    placed_on_device(Arc::new(simulation), plan, settings, watch, pool)
}

/// A plan where it is executed.
fn placed_on_device<T: ConvReal>(
    simulation: Arc<Simulation>,
    mut plan: SimulationPlan<T>,
    settings: &Settings,
    watch: &Watch,
    pool: &ThreadPool,
) -> Result<Prepared<T>, Failure> {
    let process = std::process::id();
    let mut kept = turn(&GPUS, watch)?;
    if kept.as_ref().is_none_or(|&(of, _)| of != process) {
        // The parent's are not to be closed here.
        std::mem::forget(kept.take());
        *kept = Some((process, Gpus::default()));
    }
    let (_, gpus) = kept.as_mut().expect("just put there");
    let placement = pool.install(|| gpus.place(&mut plan, &settings.device, rayon::current_num_threads()))?;
    Ok(Prepared {
        simulation,
        plan,
        placement,
    })
}

/// How often it is asked whether somebody who waits for a lock still wants it.
const ASKED_EVERY: Duration = Duration::from_millis(2);

/// Waits for a lock as long as the work is wanted; on a thread beside the pool.
fn turn<'a, M>(mutex: &'a Mutex<M>, watch: &Watch) -> Result<MutexGuard<'a, M>, ConvError> {
    loop {
        match mutex.try_lock() {
            Ok(guard) => return Ok(guard),
            Err(TryLockError::Poisoned(poisoned)) => return Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) if watch.cancelled() => return Err(ConvError::Cancelled),
            Err(TryLockError::WouldBlock) => std::thread::sleep(ASKED_EVERY),
        }
    }
}
