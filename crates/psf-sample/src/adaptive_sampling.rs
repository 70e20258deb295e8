//! Non-uniform sampling.

use std::sync::Arc;

use psf_types::{Progress, PsfSource};

use crate::adaptive_run::AdaptiveRun;
use crate::mesh::Mesh;
use crate::{
    CapReached, NeighbourDifference, RefinementCriterion, SampleError, Sampling, SamplingMethod,
    SamplingOutcome,
};

/// Samples densely where the PSF varies much and sparsely where it does not.
///
/// A coarse grid over the whole field, corners and edges included, is refined cell by cell until a
/// [`RefinementCriterion`] holds in every cell: by default [`NeighbourDifference`] of 1 % (relative L2). The
/// [crate's page](crate) describes the mesh. Every PSF is drawn once; one that a criterion looked at becomes a sample
/// without another drawing when its cell is split.
///
/// ```
/// use ndarray::ArrayViewMut2;
/// use psf_sample::{AdaptiveSampling, SamplingMethod};
/// use psf_types::{FrameShape, NoProgress, Position, PsfSource, SourceError, StampGrid};
///
/// /// Light that moves from one pixel to the next towards the upper right corner.
/// struct Corner;
/// impl PsfSource for Corner {
///     fn grid(&self) -> StampGrid { StampGrid::new(3, 1).unwrap() }
///     fn field(&self) -> FrameShape { FrameShape::new(1000, 1000).unwrap() }
///     fn draw_into(&self, at: Position, mut stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
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
    /// Samples along each axis of the starting grid, unless told otherwise.
    pub const DEFAULT_START: usize = 5;
    /// The cap on the number of samples, unless told otherwise: 640 MB of 64 x 64 stamps.
    pub const DEFAULT_MAX_SAMPLES: usize = 20_000;
    /// The smallest cell in pixels, unless told otherwise.
    pub const DEFAULT_MIN_CELL_PX: f64 = 1.0;
    /// The largest ratio of a cell's sides, unless told otherwise.
    pub const DEFAULT_MAX_ASPECT: f64 = 2.0;

    /// Adaptive sampling with this criterion and the defaults above.
    pub fn new(criterion: Arc<dyn RefinementCriterion>) -> Self {
        Self {
            criterion,
            start: [Self::DEFAULT_START; 2],
            max_samples: Self::DEFAULT_MAX_SAMPLES,
            min_cell_px: Self::DEFAULT_MIN_CELL_PX,
            max_aspect: Self::DEFAULT_MAX_ASPECT,
        }
    }

    /// Starts from `nx` x `ny` samples. What varies on a smaller scale than this grid may be missed.
    ///
    /// Along an axis of one pixel there is one sample; a grid finer than the smallest cell is thinned out.
    ///
    /// # Errors
    /// [`SampleError::Setting`] unless both are from 2 to 4096.
    pub fn with_start(self, nx: usize, ny: usize) -> Result<Self, SampleError> {
        for n in [nx, ny] {
            if !(2..=4096).contains(&n) {
                return Err(SampleError::setting(
                    "samples of the starting grid along an axis",
                    "from 2 to 4096",
                    n,
                ));
            }
        }
        Ok(Self {
            start: [nx, ny],
            ..self
        })
    }

    /// Ends with [`SampleError::CapReached`] when the criterion needs more than `max_samples` samples.
    #[must_use]
    pub fn with_max_samples(self, max_samples: usize) -> Self {
        Self { max_samples, ..self }
    }

    /// Halves no cell whose halves would be narrower than `pixels`.
    ///
    /// # Errors
    /// [`SampleError::Setting`] unless it is from 0.001 to 1e9.
    pub fn with_min_cell_px(self, pixels: f64) -> Result<Self, SampleError> {
        if (1e-3..=1e9).contains(&pixels) {
            Ok(Self {
                min_cell_px: pixels,
                ..self
            })
        } else {
            Err(SampleError::setting(
                "the smallest cell",
                "from 0.001 to 1e9 pixels",
                pixels,
            ))
        }
    }

    /// Lets the sides of a cell differ by this factor where the PSF varies along one axis more than along the other. More
    /// saves samples; triangulations of long cells of different size may join samples far apart, so that their error
    /// exceeds the criterion's.
    ///
    /// # Errors
    /// [`SampleError::Setting`] unless it is from 1 to 1e6.
    pub fn with_max_aspect(self, ratio: f64) -> Result<Self, SampleError> {
        if (1.0..=1e6).contains(&ratio) {
            Ok(Self {
                max_aspect: ratio,
                ..self
            })
        } else {
            Err(SampleError::setting(
                "the largest ratio of a cell's sides",
                "from 1 to 1e6",
                ratio,
            ))
        }
    }
}

impl Default for AdaptiveSampling {
    fn default() -> Self {
        Self::new(Arc::new(NeighbourDifference::default()))
    }
}

pub(crate) fn check_threshold(threshold: f64) -> Result<(), SampleError> {
    if threshold.is_finite() && threshold > 0.0 {
        Ok(())
    } else {
        Err(SampleError::setting(
            "the threshold of the criterion",
            "a finite number above 0",
            threshold,
        ))
    }
}

impl SamplingMethod for AdaptiveSampling {
    fn sample(&self, source: &dyn PsfSource, progress: &dyn Progress) -> Result<Sampling, SampleError> {
        check_threshold(self.criterion.threshold())?;
        let mesh = Mesh::new(source.field(), self.start, self.min_cell_px, self.max_aspect);
        if mesh.node_count() > self.max_samples {
            return Err(SampleError::setting(
                "the largest number of samples",
                "at least that of the starting grid",
                format!("{} for {}", self.max_samples, mesh.node_count()),
            ));
        }
        let mut run = AdaptiveRun::new(&*self.criterion, source, progress, mesh);
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
