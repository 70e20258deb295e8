//! Uniform sampling.

use ndarray::Array2;
use psf_types::{FrameShape, Position, Progress, PsfSource};

use crate::draws::{draw_all, into_samples};
use crate::{DifferenceMeasure, SampleError, Sampling, SamplingMethod, SamplingOutcome, SamplingReport};

/// Samples on a regular grid whose outermost positions are the pixel centres of the field's corners, 0 and `n - 1`.
///
/// ```
/// use psf_sample::UniformSampling;
/// use psf_types::FrameShape;
/// let positions = UniformSampling::new(3, 2)?.positions(FrameShape::new(101, 51)?)?;
/// assert_eq!((positions[4].x(), positions[4].y()), (50.0, 50.0));
/// # Ok::<(), psf_sample::SampleError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UniformSampling {
    nx: usize,
    ny: usize,
    measure: DifferenceMeasure,
}

impl UniformSampling {
    /// A grid of `nx` by `ny` samples.
    ///
    /// # Errors
    /// [`SampleError::Setting`] when either is 0.
    pub fn new(nx: usize, ny: usize) -> Result<Self, SampleError> {
        for n in [nx, ny] {
            if n == 0 {
                return Err(SampleError::setting("samples along an axis", "at least 1", n));
            }
        }
        Ok(Self {
            nx,
            ny,
            measure: DifferenceMeasure::default(),
        })
    }

    /// The same grid; the report measures the largest difference of neighbours in this way.
    #[must_use]
    pub fn with_measure(self, measure: DifferenceMeasure) -> Self {
        Self { measure, ..self }
    }

    /// The positions on a field, ordered by y, then x.
    ///
    /// # Errors
    /// [`SampleError::Setting`] when an axis of more than one pixel has a single sample (its two ends would not be
    /// covered), or an axis of one pixel has several.
    pub fn positions(&self, field: FrameShape) -> Result<Vec<Position>, SampleError> {
        let axis = |name, samples: usize, pixels: usize| {
            if (samples == 1) != (pixels == 1) {
                return Err(SampleError::setting(
                    name,
                    "1 for an axis of one pixel, at least 2 otherwise",
                    format!("{samples} for {pixels} pixels"),
                ));
            }
            let last = (samples - 1).max(1) as f64;
            // Multiplied first: the last one is exactly the last pixel.
            Ok((0..samples).map(move |i| (pixels - 1) as f64 * i as f64 / last))
        };
        let xs = axis("samples along x", self.nx, field.nx())?;
        let ys = axis("samples along y", self.ny, field.ny())?;
        let grid = ys.flat_map(|y| xs.clone().map(move |x| Position::new(x, y)));
        Ok(grid.collect::<Result<_, _>>()?)
    }

    fn worst_neighbours(&self, stamps: &[Array2<f64>]) -> f64 {
        let at = |x: usize, y: usize| stamps[y * self.nx + x].view();
        let mut worst = 0f64;
        for y in 0..self.ny {
            for x in 0..self.nx {
                if x + 1 < self.nx {
                    worst = worst.max(self.measure.between(at(x, y), at(x + 1, y)));
                }
                if y + 1 < self.ny {
                    worst = worst.max(self.measure.between(at(x, y), at(x, y + 1)));
                }
            }
        }
        worst
    }
}

impl SamplingMethod for UniformSampling {
    /// The report's worst value is the largest difference of neighbours along x or y.
    fn sample(&self, source: &dyn PsfSource, progress: &dyn Progress) -> Result<Sampling, SampleError> {
        let positions = self.positions(source.field())?;
        progress.start(positions.len() as u64);
        let stamps = draw_all(source, &positions, progress)?;
        let report = SamplingReport {
            outcome: SamplingOutcome::Met,
            draws: stamps.len(),
            cells: (self.nx - 1).max(1) * (self.ny - 1).max(1),
            unmet_cells: 0,
            worst: self.worst_neighbours(&stamps),
            threshold: None,
        };
        let samples = into_samples(source, positions, stamps)?;
        Ok(Sampling { samples, report })
    }
}
