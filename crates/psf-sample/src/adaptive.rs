//! Adaptive sampling.

use std::sync::Arc;

use psf_types::{Progress, PsfSource};

use crate::adaptive_run::AdaptiveRun;
use crate::criteria::{InterpolationError, RefinementCriterion, check_threshold};
use crate::draws::DrawnStamps;
use crate::mesh::Mesh;
use crate::sampling::{SampleError, Sampling, SamplingMethod};

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
    max_draws: usize,
    min_cell_px: f64,
    max_aspect: f64,
}

impl AdaptiveSampling {
    /// Default number of samples along each axis of the starting grid.
    pub const DEFAULT_START: usize = 5;
    /// Default number of PSFs that may be drawn: 655 MB of 64 x 64 stamps in double precision.
    pub const DEFAULT_MAX_DRAWS: usize = 20_000;
    /// Default size of the smallest cell in pixels.
    pub const DEFAULT_MIN_CELL_PX: f64 = 1.0;
    /// Default largest ratio of a cell's sides.
    pub const DEFAULT_MAX_ASPECT: f64 = 2.0;

    /// Adaptive sampling with a criterion and the defaults above.
    pub fn new(criterion: Arc<dyn RefinementCriterion>) -> Self {
        Self {
            criterion,
            start: [Self::DEFAULT_START; 2],
            max_draws: Self::DEFAULT_MAX_DRAWS,
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

    /// Sets the number of PSFs that may be drawn. If the criterion needs more, sampling ends with
    /// [`SampleError::NotMet`]. If the starting grid needs more, sampling ends with
    /// [`SampleError::Setting`].
    #[must_use]
    pub fn with_max_draws(self, max_draws: usize) -> Self {
        Self { max_draws, ..self }
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
        let mut run = AdaptiveRun::new(&*self.criterion, source, mesh, DrawnStamps::default());
        let needed = run.draws_of_start();
        SampleError::check(
            needed <= self.max_draws,
            "the largest number of draws",
            "at least the number of draws of the starting grid",
            format_args!("{} where the grid needs {needed}", self.max_draws),
        )?;
        match run.refine(self.max_draws, progress)? {
            None => run.samples_of_mesh(),
            Some(wanted) => {
                let sampling = run.samples_of_mesh()?;
                Err(SampleError::not_met(self.max_draws, Some(wanted), sampling))
            }
        }
    }
}
