//! A plan in one precision.

use std::sync::Arc;

use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis, CowArray, Ix2};
use psfield::conv_core::{ConvError, ConvReal, PlanSummary};
use psfield::psf_types::{FrameShape, Image, ImageView, PixelRegion, Uncounted};
use psfield::{Placement, SceneSources, SimulationWarning, SpotCheck, sersic};
use rayon::ThreadPool;

use crate::error::Failure;
use crate::interruptible::Watch;
use crate::kept_psf::KeptPsf;
use crate::later::Later;
use crate::overlap::assign_overlap;
use crate::prepared::{Part, Prepared};
use crate::settings::Settings;
use crate::sources::Sources;

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

/// Extended light, and the column and the row of the (padded) scene that it begins at.
type Lit<'a, T> = (CowArray<'a, T, Ix2>, (usize, usize));

/// What a scene is convolved with.
struct Needed<'p, T: ConvReal> {
    /// Its extended light.
    extended: &'p Prepared<T>,
    /// Its stars; none where there are none.
    stars: Option<&'p Prepared<T>>,
}

/// An image, none where it went to memory of the caller's, and what should be known of it.
pub(crate) type Simulated<T> = (Option<Array2<T>>, Vec<SimulationWarning>);

impl<T: ConvReal> Planned<T> {
    /// Plans, as everything here on a thread beside the pool.
    pub(crate) fn new(
        psf: Arc<KeptPsf>,
        settings: Settings,
        watch: &Watch,
        pool: &ThreadPool,
    ) -> Result<Self, Failure> {
        let layout = settings.layout(psf.input(), true)?;
        let dark = SceneSources::<T>::new(layout, Vec::new(), Vec::new())?;
        let part = Part::Images(settings.region);
        Ok(Self {
            images: Prepared::new(&psf, &settings, part, dark.scene(), watch, pool)?,
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
            images: Prepared::on_device(simulation, plan, &settings, watch, pool)?,
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
    ) -> Result<Simulated<T>, Failure> {
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
    ) -> Result<Simulated<T>, Failure> {
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
        if let Some((light, _)) = self.light(placed, needed.extended, image, watch)? {
            let dark = placed.scene().clone().with_sources(Vec::new());
            let light = ImageView::new(light.view()).map_err(Failure::of("scene"))?;
            let (simulation, plan) = (&needed.extended.simulation, &needed.extended.plan);
            simulation.add_planned_to(plan, &dark, Some(&light), target.view_mut(), watch)?;
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
        Ok((made, warnings))
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
        let extended = self.light(placed, needed.extended, light, watch)?;
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
            self.settings.layout(self.psf.input(), of_image)?,
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
        let make = |part| Prepared::new(&self.psf, &self.settings, part, placed.scene(), watch, pool);
        let extended = match placed.galaxies() {
            [] => &self.images,
            _ => self
                .padded
                .get(watch, || make(Part::Images(self.settings.region)))?,
        };
        let stars = match placed.scene().sources() {
            [] => None,
            _ => Some(self.stars.get(watch, || make(Part::Stars))?),
        };
        Ok(Needed { extended, stars })
    }

    /// The extended light of a scene, as its plan takes it, and the column and the row that it begins at; none where there are stars alone.
    fn light<'a>(
        &self,
        placed: &SceneSources<T>,
        prepared: &Prepared<T>,
        image: Option<ArrayView2<'a, T>>,
        watch: &Watch,
    ) -> Result<Option<Lit<'a, T>>, ConvError> {
        if placed.galaxies().is_empty() {
            // Of a region's plan it may be a part, which the plan tells by its shape.
            return Ok(image.map(|image| (image.into(), (0, 0))));
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
        // Progress counts the steps of the convolution.
        let (first, watch) = ((part.x0(), part.y0()), Uncounted(watch));
        sersic::add_galaxies_with_progress(light.view_mut(), first, placed.galaxies(), &watch)?;
        Ok(Some((light.into(), (part.x0() as usize, part.y0() as usize))))
    }

    /// Whether it lies on a GPU that another process opened, the parent of a fork.
    pub(crate) fn is_on_foreign_gpu(&self) -> bool {
        self.placement().adapter().is_some() && self.process != std::process::id()
    }
}
