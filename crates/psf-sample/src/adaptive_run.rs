//! One run of adaptive sampling.

use std::collections::BTreeMap;

use psf_types::{Position, Progress, PsfSource};
use rayon::prelude::*;

use crate::draws::DrawnStamps;
use crate::mesh::{Cell, Halving, Mesh, Node};
use crate::{
    CellProbes, CellStamps, CellVariation, RefinementCriterion, SampleError, Sampling, SamplingOutcome,
    SamplingReport,
};

/// The state of one sampling.
pub(crate) struct AdaptiveRun<'a> {
    criterion: &'a dyn RefinementCriterion,
    source: &'a dyn PsfSource,
    progress: &'a dyn Progress,
    pub(crate) mesh: Mesh,
    stamps: DrawnStamps,
    assessed: BTreeMap<Cell, CellVariation>,
}

impl<'a> AdaptiveRun<'a> {
    pub(crate) fn new(
        criterion: &'a dyn RefinementCriterion,
        source: &'a dyn PsfSource,
        progress: &'a dyn Progress,
        mesh: Mesh,
    ) -> Self {
        Self {
            criterion,
            source,
            progress,
            mesh,
            stamps: DrawnStamps::default(),
            assessed: BTreeMap::new(),
        }
    }

    fn position(mesh: &Mesh, node: Node) -> Result<Position, SampleError> {
        Ok(mesh.position(node)?)
    }

    /// Indices of the 3 x 3 points of a cell that the criterion looks at.
    fn probes(&self) -> impl Iterator<Item = (usize, usize)> + Clone + use<> {
        let all = self.criterion.probes() == CellProbes::CornersAndMidpoints;
        (0..9)
            .map(|i| (i % 3, i / 3))
            .filter(move |&(column, row)| all || (column != 1 && row != 1))
    }

    /// Draws what is missing for the cells that were not looked at yet, and measures these.
    pub(crate) fn assess_new_cells(&mut self) -> Result<(), SampleError> {
        let leaves = self.mesh.leaves();
        self.assessed.retain(|cell, _| leaves.contains(cell));
        let new: Vec<Cell> = leaves
            .iter()
            .copied()
            .filter(|c| !self.assessed.contains_key(c))
            .collect();
        let probes = self.probes();
        let nodes = new
            .iter()
            .flat_map(|cell| probes.clone().map(|(column, row)| cell.node(column, row)));
        let mesh = &self.mesh;
        self.stamps
            .add(self.source, nodes, |n| Self::position(mesh, n), self.progress)?;
        let measured: Vec<CellVariation> = new
            .par_iter()
            .map(|cell| {
                let mut stamps = CellStamps {
                    stamps: Default::default(),
                };
                for (column, row) in probes.clone() {
                    stamps.stamps[row][column] = Some(self.stamps.get(cell.node(column, row)).view());
                }
                self.criterion.assess(&stamps)
            })
            .collect();
        for (cell, variation) in new.into_iter().zip(measured) {
            for value in [variation.along_x, variation.along_y] {
                // Also false for NaN. Infinity has no order among others and no meaning in a report.
                if !(value >= 0.0 && value.is_finite()) {
                    let position = Self::position(&self.mesh, cell.node(1, 1))?;
                    return Err(SampleError::Criterion { position, value });
                }
            }
            self.assessed.insert(cell, variation);
        }
        Ok(())
    }

    /// Cells that fail and can still be halved: where, how, and how badly they fail.
    pub(crate) fn failing(&self) -> Vec<(Cell, Halving, f64)> {
        let threshold = self.criterion.threshold();
        let halving = |cell, v: CellVariation| {
            let wanted = Halving {
                x: v.along_x > threshold,
                y: v.along_y > threshold,
            };
            self.mesh.allowed(cell, wanted)
        };
        self.assessed
            .iter()
            .map(|(&cell, &v)| (cell, halving(cell, v), v.largest()))
            .filter(|(_, halving, _)| halving.any())
            .collect()
    }

    /// Halves as many cells as the cap allows, the worst first.
    pub(crate) fn refine_the_worst(&mut self, mut failing: Vec<(Cell, Halving, f64)>, cap: usize) {
        failing.sort_by(|a, b| b.2.total_cmp(&a.2).then(a.0.cmp(&b.0)));
        let refined = |count: usize| {
            let mut mesh = self.mesh.clone();
            mesh.halve(failing[..count].iter().map(|&(cell, halving, _)| (cell, halving)));
            mesh
        };
        // More cells never need fewer samples: bisect.
        let (mut fits, mut too_many) = (0, failing.len());
        while too_many - fits > 1 {
            let middle = fits.midpoint(too_many);
            if refined(middle).node_count() <= cap {
                fits = middle;
            } else {
                too_many = middle;
            }
        }
        self.mesh = refined(fits);
    }

    pub(crate) fn finish(self, outcome: Option<SamplingOutcome>) -> Result<Sampling, SampleError> {
        let threshold = self.criterion.threshold();
        let unmet_cells = self.assessed.values().filter(|v| v.largest() > threshold).count();
        let report = SamplingReport {
            outcome: outcome.unwrap_or(match unmet_cells {
                0 => SamplingOutcome::Met,
                _ => SamplingOutcome::CellSizeReached,
            }),
            draws: self.stamps.count(),
            cells: self.assessed.len(),
            unmet_cells,
            worst: self.assessed.values().map(|v| v.largest()).fold(0.0, f64::max),
            threshold: Some(threshold),
        };
        let nodes = self.mesh.sorted_nodes();
        let mesh = &self.mesh;
        let samples = self
            .stamps
            .into_samples(self.source, &nodes, |n| Self::position(mesh, n))?;
        Ok(Sampling { samples, report })
    }
}
