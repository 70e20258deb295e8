//! Adaptive sampling.

use std::collections::BTreeMap;
use std::sync::Arc;

use psf_types::{Progress, PsfSource};
use rayon::prelude::*;

use crate::criteria::{
    CellProbes, CellStamps, CellVariation, InterpolationError, RefinementCriterion, check_threshold,
};
use crate::draws::DrawnStamps;
use crate::mesh::{Cell, Halving, Mesh};
use crate::sampling::{CapReached, SampleError, Sampling, SamplingMethod, SamplingOutcome, SamplingReport};

/// Samples densely where the PSF varies much and sparsely where it does not.
///
/// A coarse grid over the whole field, corners and edges included, is refined cell by cell until a
/// [`RefinementCriterion`] holds in every cell. The default is an [`InterpolationError`] of 1 %
/// (relative L2). The [crate's page](crate) describes the mesh. Every PSF is drawn once: a PSF that
/// the criterion used is not drawn again when its position becomes a sample.
///
/// ```
/// use ndarray::ArrayViewMut2;
/// use psf_sample::{AdaptiveSampling, SamplingMethod};
/// use psf_types::{FrameShape, NoProgress, Position, PsfSource, SourceError, StampGrid};
///
/// /// A PSF whose flux partly moves to the next stamp pixel near the field's upper right corner.
/// struct Corner;
/// impl PsfSource for Corner {
///     fn grid(&self) -> StampGrid { StampGrid::new(3, 1).unwrap() }
///     fn field(&self) -> FrameShape { FrameShape::new(1000, 1000).unwrap() }
///     fn draw_into(
///         &self,
///         at: Position,
///         mut stamp: ArrayViewMut2<'_, f64>,
///     ) -> Result<(), SourceError> {
///         let part = 0.5 * (-at.distance(Position::of_pixel(999, 999)) / 300.0).exp();
///         stamp.assign(&ndarray::array![[0.0, 1.0 - part, part]]);
///         Ok(())
///     }
/// }
/// let sampling = AdaptiveSampling::default().sample(&Corner, &NoProgress)?;
/// assert!(sampling.report.worst <= 0.01);
/// assert!(sampling.samples.len() < 20_000);
/// # Ok::<(), psf_sample::SampleError>(())
/// ```
#[derive(Debug, Clone)]
pub struct AdaptiveSampling {
    criterion: Arc<dyn RefinementCriterion>,
    start: [usize; 2],
    max_samples: usize,
    min_cell_px: f64,
    max_aspect: f64,
}

impl AdaptiveSampling {
    /// Default number of samples along each axis of the starting grid.
    pub const DEFAULT_START: usize = 5;
    /// Default cap on the number of samples: 655 MB of 64 x 64 stamps in double precision.
    pub const DEFAULT_MAX_SAMPLES: usize = 20_000;
    /// Default size of the smallest cell in pixels.
    pub const DEFAULT_MIN_CELL_PX: f64 = 1.0;
    /// Default largest ratio of a cell's sides.
    pub const DEFAULT_MAX_ASPECT: f64 = 2.0;

    /// Adaptive sampling with a criterion and the defaults above.
    pub fn new(criterion: Arc<dyn RefinementCriterion>) -> Self {
        Self {
            criterion,
            start: [Self::DEFAULT_START; 2],
            max_samples: Self::DEFAULT_MAX_SAMPLES,
            min_cell_px: Self::DEFAULT_MIN_CELL_PX,
            max_aspect: Self::DEFAULT_MAX_ASPECT,
        }
    }

    /// Starts from `nx` x `ny` samples. Variations on a smaller scale than this grid may be missed.
    ///
    /// Along an axis of one pixel there is one sample. If the cells of the grid would be smaller
    /// than the smallest cell, the grid has fewer samples.
    ///
    /// # Errors
    /// [`SampleError::Setting`] unless both numbers are from 2 to 4096.
    pub fn with_start(self, nx: usize, ny: usize) -> Result<Self, SampleError> {
        for n in [nx, ny] {
            let name = "the number of samples along an axis of the starting grid";
            SampleError::check((2..=4096).contains(&n), name, "from 2 to 4096", n)?;
        }
        Ok(Self {
            start: [nx, ny],
            ..self
        })
    }

    /// Sets the cap on the number of samples. If the criterion needs more, sampling ends with
    /// [`SampleError::CapReached`]. If the starting grid has more, sampling ends with
    /// [`SampleError::Setting`].
    #[must_use]
    pub fn with_max_samples(self, max_samples: usize) -> Self {
        Self { max_samples, ..self }
    }

    /// Sets the size of the smallest cell: no cell is halved if its halves would be narrower than
    /// `pixels`.
    ///
    /// # Errors
    /// [`SampleError::Setting`] unless `pixels` is from 0.001 to 1e9.
    pub fn with_min_cell_px(self, pixels: f64) -> Result<Self, SampleError> {
        let (name, allowed) = ("the size of the smallest cell", "from 0.001 to 1e9 pixels");
        SampleError::check((1e-3..=1e9).contains(&pixels), name, allowed, pixels)?;
        Ok(Self {
            min_cell_px: pixels,
            ..self
        })
    }

    /// Sets the largest ratio of a cell's sides that a halving may cause. Cells become long where
    /// the PSF varies more along one axis than along the other. A larger ratio saves samples.
    /// However, a triangulation of long cells of different sizes may join samples that are far
    /// apart. Its interpolation error may then exceed the criterion's threshold.
    ///
    /// # Errors
    /// [`SampleError::Setting`] unless `ratio` is from 1 to 1e6.
    pub fn with_max_aspect(self, ratio: f64) -> Result<Self, SampleError> {
        let (name, allowed) = ("the largest ratio of a cell's sides", "from 1 to 1e6");
        SampleError::check((1.0..=1e6).contains(&ratio), name, allowed, ratio)?;
        Ok(Self {
            max_aspect: ratio,
            ..self
        })
    }
}

impl Default for AdaptiveSampling {
    fn default() -> Self {
        Self::new(Arc::new(InterpolationError::default()))
    }
}

impl SamplingMethod for AdaptiveSampling {
    fn sample(&self, source: &dyn PsfSource, progress: &dyn Progress) -> Result<Sampling, SampleError> {
        check_threshold(self.criterion.threshold())?;
        let mesh = Mesh::new(source.field(), self.start, self.min_cell_px, self.max_aspect);
        SampleError::check(
            mesh.node_count() <= self.max_samples,
            "the largest number of samples",
            "at least the number of samples of the starting grid",
            format_args!("{} for a grid of {}", self.max_samples, mesh.node_count()),
        )?;
        let mut run = AdaptiveRun {
            criterion: &*self.criterion,
            source,
            progress,
            mesh,
            stamps: DrawnStamps::default(),
            assessed: BTreeMap::new(),
        };
        loop {
            run.assess_new_cells()?;
            let failing = run.failing();
            if failing.is_empty() {
                return run.finish(None);
            }
            let mut refined = run.mesh.clone();
            refined.halve(failing.iter().map(|&(cell, halving, _)| (cell, halving)));
            if refined.node_count() > self.max_samples {
                let wanted = refined.node_count();
                run.refine_the_worst(failing, self.max_samples);
                run.assess_new_cells()?;
                let sampling = run.finish(Some(SamplingOutcome::CapReached))?;
                return Err(SampleError::CapReached(Box::new(CapReached {
                    cap: self.max_samples,
                    wanted,
                    sampling,
                })));
            }
            run.mesh = refined;
        }
    }
}

/// The state of one adaptive sampling.
struct AdaptiveRun<'a> {
    criterion: &'a dyn RefinementCriterion,
    source: &'a dyn PsfSource,
    progress: &'a dyn Progress,
    mesh: Mesh,
    stamps: DrawnStamps,
    assessed: BTreeMap<Cell, CellVariation>,
}

impl AdaptiveRun<'_> {
    /// The points of a cell that the criterion needs, as `(column, row)`, each from 0 to 2.
    fn probes(&self) -> impl Iterator<Item = (usize, usize)> + Clone + use<> {
        let all = self.criterion.probes() == CellProbes::CornersAndMidpoints;
        (0..9)
            .map(|i| (i % 3, i / 3))
            .filter(move |&(column, row)| all || (column != 1 && row != 1))
    }

    /// Draws the missing PSFs of the cells that are not measured yet, and measures these cells.
    fn assess_new_cells(&mut self) -> Result<(), SampleError> {
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
        self.stamps.add(self.source, nodes, &self.mesh, self.progress)?;
        let measured: Vec<CellVariation> = new
            .par_iter()
            .map(|cell| {
                let mut stamps = <[[Option<_>; 3]; 3]>::default();
                for (column, row) in probes.clone() {
                    stamps[row][column] = Some(self.stamps.get(cell.node(column, row)).view());
                }
                self.criterion.assess(&CellStamps { stamps })
            })
            .collect();
        for (cell, variation) in new.into_iter().zip(measured) {
            for value in [variation.along_x, variation.along_y] {
                // The comparison is also false for NaN. Infinities are refused because they cannot
                // be ranked against each other and say nothing in a report.
                if !(value >= 0.0 && value.is_finite()) {
                    let position = self.mesh.position(cell.node(1, 1))?;
                    return Err(SampleError::Criterion { position, value });
                }
            }
            self.assessed.insert(cell, variation);
        }
        Ok(())
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
            .map(|(&cell, &v)| (cell, halving(cell, v), v.largest()))
            .filter(|(_, halving, _)| halving.any())
            .collect()
    }

    /// Halves as many of the failing cells as the cap on samples allows, the worst cells first.
    fn refine_the_worst(&mut self, mut failing: Vec<(Cell, Halving, f64)>, cap: usize) {
        failing.sort_by(|a, b| b.2.total_cmp(&a.2).then(a.0.cmp(&b.0)));
        let refined = |count: usize| {
            let mut mesh = self.mesh.clone();
            mesh.halve(failing[..count].iter().map(|&(cell, halving, _)| (cell, halving)));
            mesh
        };
        // Halving more cells never gives fewer samples, so bisection finds the largest number of
        // cells that the cap allows.
        let (mut possible, mut too_many) = (0, failing.len());
        while too_many - possible > 1 {
            let middle = possible.midpoint(too_many);
            if refined(middle).node_count() <= cap {
                possible = middle;
            } else {
                too_many = middle;
            }
        }
        self.mesh = refined(possible);
    }

    fn finish(self, outcome: Option<SamplingOutcome>) -> Result<Sampling, SampleError> {
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
        let samples = self.stamps.into_samples(self.source, &self.mesh)?;
        Ok(Sampling { samples, report })
    }
}
