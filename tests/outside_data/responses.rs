//! Responses of an operator to single pixels, with light everywhere: its columns (source-anchored)
//! or its rows (output-anchored).

use libtest_mimic::Failed;
use ndarray::{Array2, ArrayView2};
use psfield::conv_core::{ConvReal, Engine, Operation};
use psfield::psf_types::{Anchor, ImageView, NoProgress, Position, PsfModel};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::slice::from_ref;

/// A pixel and its exact PSF.
struct Probe {
    pixel: (usize, usize),
    psf: Array2<f64>,
}

/// Random pixels with their exact PSFs, in batches whose stamps do not overlap. The operator is
/// linear, so one execution measures all responses of a batch.
pub(crate) struct Probes {
    batches: Vec<Vec<Probe>>,
    centre: (usize, usize),
    anchor: Anchor,
}

/// Errors of the responses of some pixels.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ResponseErrors {
    /// The largest `||response - psf|| / ||psf||`.
    pub(crate) largest: f64,
    /// The mean of `||response - psf|| / ||psf||`.
    pub(crate) mean: f64,
    /// The number of responses that exceed the limit.
    pub(crate) violations: usize,
    /// The largest response outside all stamps, divided by the light added to a pixel.
    pub(crate) stray: f64,
}

/// Attempts to place a pixel before a batch counts as full.
const ATTEMPTS: usize = 400;

impl Probes {
    /// `count` pixels of a frame, from a uniform distribution.
    pub(crate) fn random(
        model: &PsfModel,
        (nx, ny): (usize, usize),
        count: usize,
        anchor: Anchor,
    ) -> Result<Self, Failed> {
        let mut rng = ChaCha8Rng::seed_from_u64(20);
        let grid = model.grid();
        let centre = grid.whole_centre().ok_or("the stamps have no central pixel")?;
        let mut batches: Vec<Vec<Probe>> = Vec::new();
        let mut left = count;
        while left > 0 {
            let mut batch: Vec<Probe> = Vec::new();
            for _ in 0..ATTEMPTS {
                let pixel = (rng.random_range(0..nx), rng.random_range(0..ny));
                let apart = |p: &Probe| {
                    p.pixel.0.abs_diff(pixel.0) >= grid.nx() || p.pixel.1.abs_diff(pixel.1) >= grid.ny()
                };
                if left > 0 && batch.iter().all(apart) {
                    let psf = model.psf_at(Position::of_pixel(pixel.0 as i64, pixel.1 as i64))?;
                    batch.push(Probe {
                        pixel,
                        psf: psf.into_values(),
                    });
                    left -= 1;
                }
            }
            batches.push(batch);
        }
        Ok(Self {
            batches,
            centre,
            anchor,
        })
    }

    /// The first `count` pixels, one per batch.
    pub(crate) fn one_by_one(self, count: usize) -> Self {
        let batches = self.batches.into_iter().flatten().take(count);
        Self {
            batches: batches.map(|probe| vec![probe]).collect(),
            ..self
        }
    }

    /// Compares `(F(f + more at a pixel) - F(f)) / more` with the exact PSF of the pixel. `F` is
    /// the operator of the engine, or its transpose if it is output-anchored.
    pub(crate) fn measure<T: ConvReal>(
        &self,
        engine: &Engine<T>,
        light: &Array2<T>,
        more: f64,
        limit: f64,
    ) -> Result<ResponseErrors, Failed> {
        let before = self.apply(engine, light)?;
        let mut found = ResponseErrors::default();
        let mut count = 0;
        for batch in &self.batches {
            let mut lit = light.clone();
            for probe in batch {
                lit[[probe.pixel.1, probe.pixel.0]] += T::nearest(more);
            }
            let after = self.apply(engine, &lit)?;
            let mut response = after.mapv(T::as_f64) - before.mapv(T::as_f64);
            for probe in batch {
                let at = [probe.pixel.1, probe.pixel.0];
                // This differs from `more` if the precision cannot hold the sum.
                let added = lit[at].as_f64() - light[at].as_f64();
                let error = self.take_out(probe, added, &mut response);
                found.largest = found.largest.max(error);
                found.mean += error;
                found.violations += usize::from(error > limit);
                count += 1;
            }
            let stray = response.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            found.stray = found.stray.max(stray / more);
        }
        found.mean /= f64::from(count);
        Ok(found)
    }

    fn apply<T: ConvReal>(&self, engine: &Engine<T>, light: &Array2<T>) -> Result<Array2<T>, Failed> {
        let mut image = engine.plan().zeros();
        let (light, into) = (ImageView::new(light.view())?, image.view_mut());
        match self.anchor {
            Anchor::Output => {
                engine.execute(Operation::Adjoint, from_ref(&light), vec![into], &NoProgress)?
            }
            _ => engine.execute(Operation::Convolve, from_ref(&light), vec![into], &NoProgress)?,
        };
        Ok(image)
    }

    /// The error of a pixel's response relative to its whole PSF. Sets the pixels of that response
    /// to zero.
    fn take_out(&self, probe: &Probe, added: f64, response: &mut Array2<f64>) -> f64 {
        let (ny, nx) = response.dim();
        let mut error = 0.0;
        for ((j, i), &exact) in probe.psf.indexed_iter() {
            // A row of the operator is the PSF turned by 180 degrees.
            let place = |at: usize, index: usize, centre: usize| match self.anchor {
                Anchor::Output => (at + centre).checked_sub(index),
                _ => (at + index).checked_sub(centre),
            };
            let (x, y) = (
                place(probe.pixel.0, i, self.centre.0),
                place(probe.pixel.1, j, self.centre.1),
            );
            if let (Some(x), Some(y)) = (x.filter(|&x| x < nx), y.filter(|&y| y < ny)) {
                error += (response[[y, x]] / added - exact).powi(2);
                response[[y, x]] = 0.0;
            }
        }
        error.sqrt() / norm(probe.psf.view())
    }
}

/// Positive light on every pixel, around 1.
pub(crate) fn lit_everywhere<T: ConvReal>(nx: usize, ny: usize, seed: u64) -> Array2<T> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Array2::from_shape_simple_fn((ny, nx), || T::nearest(rng.random_range(0.5..1.5)))
}

/// The L2 norm.
pub(crate) fn norm(values: ArrayView2<'_, f64>) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}
