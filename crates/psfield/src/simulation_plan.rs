//! Plans of simulations.

use std::sync::Arc;

use conv_core::{ConvReal, Plan, PlanSummary, StarPlan};
use psf_types::{FrameShape, PixelRegion};

/// Everything about a simulation that does not depend on the light, for any number of scenes of one shape.
#[derive(Debug)]
pub struct SimulationPlan<T: ConvReal> {
    engine: Option<Plan<T>>,
    stars: Arc<StarPlan<T>>,
    region: Option<PixelRegion>,
}

impl<T: ConvReal> SimulationPlan<T> {
    pub(crate) fn new(engine: Option<Plan<T>>, stars: StarPlan<T>) -> Self {
        Self {
            engine,
            stars: Arc::new(stars),
            region: None,
        }
    }

    /// With another engine, and what was prepared for stars so far.
    pub(crate) fn with_engine(&self, engine: Plan<T>) -> Self {
        Self {
            engine: Some(engine),
            stars: Arc::clone(&self.stars),
            region: None,
        }
    }

    /// The same plan, known to be for a region.
    pub(crate) fn of_region(self, region: PixelRegion) -> Self {
        Self {
            region: Some(region),
            ..self
        }
    }

    /// The plan for images; none where scenes hold stars alone.
    pub fn engine(&self) -> Option<&Plan<T>> {
        self.engine.as_ref()
    }

    pub(crate) fn engine_mut(&mut self) -> Option<&mut Plan<T>> {
        self.engine.as_mut()
    }

    /// The plan for stars.
    pub fn stars(&self) -> &StarPlan<T> {
        &self.stars
    }

    /// The part of the frame that this plan makes, in the frame's own pixels; none for all of it.
    pub fn region(&self) -> Option<PixelRegion> {
        self.region
    }

    /// The part of a frame that this plan makes.
    pub(crate) fn region_of(&self, frame: FrameShape) -> PixelRegion {
        self.region.unwrap_or_else(|| frame.region())
    }

    /// The part of the scene whose light reaches what this plan makes, in pixels of the scene ([`Plan::light_region`]); none where scenes hold
    /// stars alone.
    pub fn light_region(&self) -> Option<PixelRegion> {
        self.engine.as_ref().map(Plan::light_region)
    }

    /// The plan for images in figures.
    pub fn summary(&self) -> Option<PlanSummary> {
        self.engine.as_ref().map(Plan::summary)
    }
}
