//! A PSF source whose size is any function of the field position. It records what was drawn.
#![allow(dead_code, reason = "each test file uses some of it")]

use std::sync::Mutex;

use ndarray::{Array2, ArrayView2, ArrayViewMut2};
use psf_types::{FrameShape, Position, PsfSource, SourceError, StampGrid};

/// A round Gaussian whose sigma in pixels is a function of `(x / (nx - 1), y / (ny - 1))`.
pub(crate) struct Blob {
    pub(crate) field: FrameShape,
    sigma: Box<dyn Fn(f64, f64) -> f64 + Send + Sync>,
    pub(crate) drawn: Mutex<Vec<(f64, f64)>>,
}

impl Blob {
    pub(crate) fn new(nx: usize, ny: usize, sigma: impl Fn(f64, f64) -> f64 + Send + Sync + 'static) -> Self {
        Self {
            field: FrameShape::new(nx, ny).unwrap(),
            sigma: Box::new(sigma),
            drawn: Mutex::default(),
        }
    }

    /// Returns how many PSFs were drawn and checks that none was drawn twice.
    pub(crate) fn distinct_draws(&self) -> usize {
        let mut drawn = self.drawn.lock().unwrap().clone();
        let count = drawn.len();
        drawn.sort_by(|a, b| a.partial_cmp(b).unwrap());
        drawn.dedup();
        assert_eq!(drawn.len(), count, "no position is drawn twice");
        count
    }

    pub(crate) fn at(&self, x: f64, y: f64) -> Array2<f64> {
        let mut stamp = Array2::zeros(self.grid().dim());
        self.fill(x, y, (0.0, 0.0), stamp.view_mut());
        stamp
    }

    fn fill(&self, x: f64, y: f64, (dx, dy): (f64, f64), mut stamp: ArrayViewMut2<'_, f64>) {
        let part = |v: f64, n: usize| if n == 1 { 0.0 } else { v / (n - 1) as f64 };
        let sigma = (self.sigma)(part(x, self.field.nx()), part(y, self.field.ny()));
        let norm = std::f64::consts::TAU * sigma * sigma;
        for ((j, i), v) in stamp.indexed_iter_mut() {
            let (a, b) = (i as f64 - 6.0 - dx, j as f64 - 6.0 - dy);
            *v = (-(a * a + b * b) / (2.0 * sigma * sigma)).exp() / norm;
        }
    }
}

impl PsfSource for Blob {
    fn grid(&self) -> StampGrid {
        StampGrid::new(13, 13).unwrap()
    }

    fn field(&self) -> FrameShape {
        self.field
    }

    fn draw_into(&self, position: Position, stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
        self.draw_shifted_into(position, (0.0, 0.0), stamp)
    }

    fn draw_shifted_into(
        &self,
        position: Position,
        shift: (f64, f64),
        stamp: ArrayViewMut2<'_, f64>,
    ) -> Result<(), SourceError> {
        self.drawn.lock().unwrap().push((position.x(), position.y()));
        self.fill(position.x(), position.y(), shift, stamp);
        Ok(())
    }
}

pub(crate) fn relative_l2(got: ArrayView2<'_, f64>, truth: ArrayView2<'_, f64>) -> f64 {
    let d2: f64 = got.iter().zip(&truth).map(|(a, b)| (a - b).powi(2)).sum();
    (d2 / truth.iter().map(|v| v * v).sum::<f64>()).sqrt()
}

/// Runs `run` on pools of 1, 2 and 4 threads.
pub(crate) fn on_threads<T: Send>(run: impl Fn() -> T + Sync) -> [T; 3] {
    [1, 2, 4].map(|n| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(n)
            .build()
            .unwrap()
            .install(&run)
    })
}
