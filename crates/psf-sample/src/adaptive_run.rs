//! The refinement of a mesh.

use std::collections::{BTreeMap, HashSet};

use ndarray::{Array2, ArrayView2};
use psf_types::{Position, Progress, PsfSource};
use rayon::prelude::*;

use crate::criteria::{CellProbes, CellStamps, CellVariation, DifferenceMeasure, RefinementCriterion};
use crate::draws::DrawnStamps;
use crate::mesh::{Cell, Halving, Mesh};
use crate::sampling::{Refinement, SampleError, Sampling, SamplingOutcome, SamplingReport};

/// The state of one adaptive sampling.
pub(crate) struct AdaptiveRun<'a> {
    criterion: &'a dyn RefinementCriterion,
    source: &'a dyn PsfSource,
    mesh: Mesh,
    pub(crate) stamps: DrawnStamps,
    assessed: BTreeMap<Cell, Assessed>,
    /// PSFs drawn at other points than those of the criterion, and the measure of their errors.
    tests: Vec<(Position, DifferenceMeasure)>,
    /// The reason why the sampling ended: [`Met`](SamplingOutcome::Met) if the criterion and all tests hold.
    pub(crate) outcome: SamplingOutcome,
}

/// Measurements in a cell.
#[derive(Debug, Clone, Copy)]
struct Assessed {
    variation: CellVariation,
    /// The middle of the cell, or the test with the largest error if that is larger.
    worst_at: Position,
}

impl<'a> AdaptiveRun<'a> {
    pub(crate) fn new(
        criterion: &'a dyn RefinementCriterion,
        source: &'a dyn PsfSource,
        mesh: Mesh,
        stamps: DrawnStamps,
    ) -> Self {
        Self {
            criterion,
            source,
            mesh,
            stamps,
            assessed: BTreeMap::new(),
            tests: Vec::new(),
            outcome: SamplingOutcome::Met,
        }
    }

    /// Adds drawn PSFs that test the interpolation: a cell is also refined where it predicts them worse
    /// than the threshold.
    pub(crate) fn add_tests(&mut self, tests: &[Position], measure: DifferenceMeasure) {
        self.tests
            .extend(tests.iter().map(|&position| (position, measure)));
        let mesh = &self.mesh;
        let holds_a_test = |cell: &Cell| tests.iter().any(|&p| mesh.place_in(*cell, p).is_some());
        self.assessed.retain(|cell, _| !holds_a_test(cell));
    }

    /// The number of PSFs drawn when the starting grid has been assessed.
    pub(crate) fn draws_of_start(&self) -> usize {
        self.draws_of(&self.mesh)
    }

    /// Refines the mesh until the criterion holds, or cells cannot be smaller. If this needs more than
    /// `max_draws` draws in all, it refines the worst cells and returns the number needed.
    pub(crate) fn refine(
        &mut self,
        max_draws: usize,
        progress: &dyn Progress,
    ) -> Result<Option<usize>, SampleError> {
        loop {
            let wanted = self.draws_of(&self.mesh);
            if wanted > max_draws {
                // A starting grid that is too large.
                self.outcome = SamplingOutcome::CapReached;
                return Ok(Some(wanted));
            }
            self.assess_new_cells(progress)?;
            let failing = self.failing();
            let mut refined = self.mesh.clone();
            refined.halve(failing.iter().map(|&(cell, halving, _)| (cell, halving)));
            let wanted = self.draws_of(&refined);
            if failing.is_empty() {
                let is_met = self.assessed.values().all(|a| self.holds(a));
                self.outcome = if is_met {
                    SamplingOutcome::Met
                } else {
                    SamplingOutcome::CellSizeReached
                };
                return Ok(None);
            }
            if wanted > max_draws {
                self.refine_the_worst(failing, max_draws);
                self.assess_new_cells(progress)?;
                self.outcome = SamplingOutcome::CapReached;
                return Ok(Some(wanted));
            }
            self.mesh = refined;
        }
    }

    /// The error of interpolating at a position where a PSF was drawn: the larger one of the two
    /// triangulations of its cell.
    pub(crate) fn error_at(&self, position: Position, measure: DifferenceMeasure) -> f64 {
        let errors = self.mesh.leaves().iter().filter_map(|&cell| {
            let place = self.mesh.place_in(cell, position)?;
            Some(self.error_in(cell, place, position, measure))
        });
        errors.fold(0.0, f64::max)
    }

    fn error_in(&self, cell: Cell, [x, y]: [f64; 2], position: Position, measure: DifferenceMeasure) -> f64 {
        let truth = self.stamps.get(position);
        let corners = cell
            .corners()
            .map(|node| self.stamps.get(self.mesh.position(node)));
        let rising = if x >= y {
            [1.0 - x, x - y, 0.0, y]
        } else {
            [1.0 - y, 0.0, y - x, x]
        };
        let falling = if x + y <= 1.0 {
            [1.0 - x - y, x, y, 0.0]
        } else {
            [0.0, 1.0 - y, 1.0 - x, x + y - 1.0]
        };
        let error = |weights: [f64; 4]| {
            let mut sum = Array2::zeros(truth.dim());
            for (weight, corner) in weights.into_iter().zip(&corners) {
                sum.scaled_add(weight, corner);
            }
            measure.between(sum.view(), truth)
        };
        error(rising).max(error(falling))
    }

    /// The points of a cell that the criterion needs, as `(column, row)`, each from 0 to 2.
    fn probes(&self) -> impl Iterator<Item = (usize, usize)> + Clone + use<> {
        let all = self.criterion.probes() == CellProbes::CornersAndMidpoints;
        (0..9)
            .map(|i| (i % 3, i / 3))
            .filter(move |&(column, row)| all || (column != 1 && row != 1))
    }

    /// The positions that the criterion needs in the cells of a mesh that are not measured yet.
    fn positions_of(&self, mesh: &Mesh) -> Vec<Position> {
        let new = mesh.leaves().iter().filter(|c| !self.assessed.contains_key(c));
        let probes = self.probes();
        let nodes = new.flat_map(|cell| probes.clone().map(|(column, row)| cell.node(column, row)));
        let mut nodes: Vec<_> = nodes.collect();
        nodes.sort_unstable();
        nodes.dedup();
        nodes.into_iter().map(|node| mesh.position(node)).collect()
    }

    /// The number of PSFs drawn when a refinement of the mesh has been assessed.
    fn draws_of(&self, mesh: &Mesh) -> usize {
        let positions = self.positions_of(mesh);
        let new: HashSet<[u64; 2]> = positions
            .into_iter()
            .filter(|p| !self.stamps.contains(*p))
            .map(Position::bits)
            .collect();
        self.stamps.count() + new.len()
    }

    /// Draws the missing PSFs of the cells that are not measured yet, and measures these cells.
    fn assess_new_cells(&mut self, progress: &dyn Progress) -> Result<(), SampleError> {
        let leaves = self.mesh.leaves();
        self.assessed.retain(|cell, _| leaves.contains(cell));
        let positions = self.positions_of(&self.mesh);
        self.stamps.add(self.source, &positions, progress)?;
        let new = self.mesh.leaves().iter().copied();
        let new: Vec<Cell> = new.filter(|c| !self.assessed.contains_key(c)).collect();
        let measured: Vec<Assessed> = new
            .par_iter()
            .map(|&cell| self.assess(cell))
            .collect::<Result<_, _>>()?;
        self.assessed.extend(new.into_iter().zip(measured));
        Ok(())
    }

    fn assess(&self, cell: Cell) -> Result<Assessed, SampleError> {
        let middle = self.mesh.position(cell.node(1, 1));
        let mut stamps = <[[Option<ArrayView2<'_, f64>>; 3]; 3]>::default();
        for (column, row) in self.probes() {
            let position = self.mesh.position(cell.node(column, row));
            stamps[row][column] = Some(self.stamps.get(position));
        }
        let variation = self.criterion.assess(&CellStamps { stamps });
        for value in [variation.along_x, variation.along_y] {
            // The comparison is also false for NaN. Infinities are refused because they cannot
            // be ranked against each other and say nothing in a report.
            if !(value >= 0.0 && value.is_finite()) {
                let position = middle;
                return Err(SampleError::Criterion { position, value });
            }
        }
        let mut assessed = Assessed {
            variation,
            worst_at: middle,
        };
        for &(position, measure) in &self.tests {
            let Some(place) = self.mesh.place_in(cell, position) else {
                continue;
            };
            let error = self.error_in(cell, place, position, measure);
            let CellVariation { along_x, along_y } = &mut assessed.variation;
            if error > self.criterion.threshold() && error > along_x.max(*along_y) {
                (*along_x, *along_y) = (error, error);
                assessed.worst_at = position;
            }
        }
        Ok(assessed)
    }

    fn holds(&self, assessed: &Assessed) -> bool {
        assessed.variation.largest() <= self.criterion.threshold()
    }

    /// The cells that fail the criterion and can still be halved, each with the axes to halve and
    /// the larger of its two variations.
    fn failing(&self) -> Vec<(Cell, Halving, f64)> {
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
            .map(|(&cell, a)| (cell, halving(cell, a.variation), a.variation.largest()))
            .filter(|(_, halving, _)| halving.any())
            .collect()
    }

    /// Halves as many of the failing cells as the number of draws allows, the worst cells first.
    fn refine_the_worst(&mut self, mut failing: Vec<(Cell, Halving, f64)>, max_draws: usize) {
        failing.sort_by(|a, b| b.2.total_cmp(&a.2).then(a.0.cmp(&b.0)));
        let refined = |count: usize| {
            let mut mesh = self.mesh.clone();
            mesh.halve(failing[..count].iter().map(|&(cell, halving, _)| (cell, halving)));
            mesh
        };
        // Halving more cells never needs fewer draws, so bisection finds the largest number of
        // cells that the draws allow.
        let (mut possible, mut too_many) = (0, failing.len());
        while too_many - possible > 1 {
            let middle = possible.midpoint(too_many);
            if self.draws_of(&refined(middle)) <= max_draws {
                possible = middle;
            } else {
                too_many = middle;
            }
        }
        self.mesh = refined(possible);
    }

    /// The samples at the corners of the cells.
    pub(crate) fn samples_of_mesh(self) -> Result<Sampling, SampleError> {
        let report = self.report();
        let nodes = self.mesh.sorted_nodes().into_iter();
        let positions = nodes.map(|node| self.mesh.position(node)).collect();
        let samples = self.stamps.into_samples(self.source, positions)?;
        Ok(Sampling { samples, report })
    }

    /// All PSFs drawn as samples.
    pub(crate) fn all_samples(self) -> Result<Sampling, SampleError> {
        let report = self.report();
        let samples = self.stamps.into_all_samples(self.source)?;
        Ok(Sampling { samples, report })
    }

    fn report(&self) -> SamplingReport {
        let worst = self.assessed.values();
        let worst = worst.max_by(|a, b| a.variation.largest().total_cmp(&b.variation.largest()));
        SamplingReport {
            refinement: Some(Refinement::Mesh),
            outcome: self.outcome,
            cells: self.assessed.len(),
            unmet_cells: self.assessed.values().filter(|a| !self.holds(a)).count(),
            worst: worst.map_or(0.0, |a| a.variation.largest()),
            worst_at: worst.map(|a| a.worst_at),
            threshold: Some(self.criterion.threshold()),
            ..SamplingReport::of_fixed_positions(self.stamps.count())
        }
    }
}
