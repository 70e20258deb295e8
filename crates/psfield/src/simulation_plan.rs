//! Plans of simulations.

use conv_core::{ConvReal, Plan, PlanSummary, StarPlan};

/// Everything about a simulation that does not depend on the light, for any number of scenes of one shape.
#[derive(Debug)]
pub struct SimulationPlan<T: ConvReal> {
    engine: Option<Plan<T>>,
    stars: StarPlan<T>,
}

impl<T: ConvReal> SimulationPlan<T> {
    pub(crate) fn new(engine: Option<Plan<T>>, stars: StarPlan<T>) -> Self {
        Self { engine, stars }
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

    /// The plan for images in figures.
    pub fn summary(&self) -> Option<PlanSummary> {
        self.engine.as_ref().map(Plan::summary)
    }
}
