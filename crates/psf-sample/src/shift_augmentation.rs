//! Stamps at sub-pixel shifts, to train a basis on.

use ndarray::{Array3, Axis};
use psf_types::{Progress, PsfSource, SamplePositions};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;

use crate::SampleError;
use crate::draws::draw_shifted;

/// Draws every sample again at random sub-pixel shifts, so that a basis learns to represent shifted PSFs too.
///
/// Shifts are uniform over `-max_shift_px <= dx, dy <= max_shift_px`. Each sample has a ChaCha stream of its own, given by
/// the seed and the sample's index: the result depends neither on threads nor on the other samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShiftAugmentation {
    copies_per_sample: usize,
    max_shift_px: f64,
    seed: u64,
}

/// Shifted stamps of samples.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ShiftedStamps {
    /// The stamps `[stamp, y, x]`: all copies of the first sample, then those of the next.
    pub stamps: Array3<f64>,
    /// Of each stamp, the index of its sample and the shift (dx, dy) in frame pixels.
    pub shifts: Vec<(usize, (f64, f64))>,
}

impl ShiftAugmentation {
    /// `copies_per_sample` shifted stamps of each sample, shifted by at most `max_shift_px` frame pixels along each axis.
    ///
    /// # Errors
    /// [`SampleError::Setting`] when there are no copies or the shift is not above 0 and at most 0.5.
    pub fn new(copies_per_sample: usize, max_shift_px: f64, seed: u64) -> Result<Self, SampleError> {
        if copies_per_sample == 0 {
            return Err(SampleError::setting(
                "copies per sample",
                "at least 1",
                copies_per_sample,
            ));
        }
        if !(max_shift_px > 0.0 && max_shift_px <= 0.5) {
            return Err(SampleError::setting(
                "the largest shift",
                "above 0 and at most 0.5 pixels",
                max_shift_px,
            ));
        }
        Ok(Self {
            copies_per_sample,
            max_shift_px,
            seed,
        })
    }

    /// The shifts of one sample.
    fn shifts(self, sample: usize) -> impl Iterator<Item = (f64, f64)> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(sample as u64);
        let mut uniform = move || {
            // 53 random bits: every multiple of 2^-53 in [0, 1).
            let unit = (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
            (2.0 * unit - 1.0) * self.max_shift_px
        };
        (0..self.copies_per_sample).map(move |_| (uniform(), uniform()))
    }

    /// Draws the shifted stamps of the samples at `positions`, in parallel.
    ///
    /// # Errors
    /// [`SampleError::Draw`] when the source cannot shift, or cannot draw; [`SampleError::Stamp`] or
    /// [`SampleError::NoLight`] when what it draws is no PSF.
    pub fn draw(
        &self,
        source: &dyn PsfSource,
        positions: &SamplePositions,
        progress: &dyn Progress,
    ) -> Result<ShiftedStamps, SampleError> {
        let shifts: Vec<_> = (0..positions.len())
            .flat_map(|sample| self.shifts(sample).map(move |shift| (sample, shift)))
            .collect();
        progress.start(shifts.len() as u64);
        let (ny, nx) = source.grid().dim();
        let mut stamps = Array3::zeros((shifts.len(), ny, nx));
        let planes: Vec<_> = stamps.axis_iter_mut(Axis(0)).collect();
        let done: Vec<_> = planes
            .into_par_iter()
            .zip(&shifts)
            .map(|(mut plane, &(sample, shift))| {
                let drawn = draw_shifted(source, positions.as_slice()[sample], shift);
                progress.advance(1);
                drawn.map(|stamp| plane.assign(&stamp))
            })
            .collect();
        done.into_iter().collect::<Result<(), _>>()?;
        Ok(ShiftedStamps { stamps, shifts })
    }
}
