//! Blocks of the field whose stars are drawn from one local basis.

use ndarray::s;
use psf_types::PixelRegion;

use super::phase_norms::{AlongMean, PhaseNorms};
use super::phased_stamps::PhasedStamps;
use super::phases::PhasedAxis;
use super::reach::{AtCorners, LEAST_LIGHT, Reach};
use super::row_layout::RowLayout;
use crate::ConvReal;
use crate::plan::local_modes::LocalModes;
use crate::plan::psf_space::PsfSpace;
use crate::simd::Aligned;

/// The local basis of a block, as interpolation coefficients that are sorted by sub-pixel phase.
#[derive(Debug)]
pub(super) struct StarBlock<T> {
    pub(super) modes: LocalModes,
    pub(super) along_mean: AlongMean,
    /// `[row, kernel, chunk, residue, pixel]`, with the rows of [`PhasedStamps`]. `kernel` counts the PSFs
    /// of the local basis. [`RowLayout`] explains the last three indices.
    values: Aligned<T>,
    /// `None` if all stars are drawn on all pixels.
    pub(super) reach: Option<Reach>,
}

/// Modes are chosen from a few rows of a block for this fraction of the tolerance, so that few
/// stars between these rows exceed the tolerance.
const MARGIN: f64 = 0.5;
/// Modes are not chosen for a tolerance below the rounding of f64.
const ROUNDING: f64 = 2e-16;

impl<T: ConvReal> StarBlock<T> {
    /// Finds the block's modes from a few of its rows. Other rows may need more modes, so every
    /// star is checked against the tolerance when it is drawn.
    pub(super) fn new(
        (space, stamps): (&PsfSpace, &PhasedStamps<T>),
        region: PixelRegion,
        norms: &PhaseNorms,
        tolerance: f64,
        (floor, axes, layout): (f64, &[PhasedAxis; 2], RowLayout),
    ) -> Self {
        let cells = space.cells_for_sources(region, tolerance);
        let mean = LocalModes::mean(space, &cells);
        let on_pixels = norms.of_mean(&mean);
        let of_modes = MARGIN * tolerance * norms.share(&mean, &on_pixels);
        let modes = LocalModes::of_exact_cells(space, &cells, of_modes.max(ROUNDING));
        let values = stamps.combined(&modes.kernels());
        let reach = (floor > 0.0).then(|| {
            let at_corners = modes.at_corners(&cells);
            let (fluxes, first) = (at_corners.column(0), at_corners.ncols() - modes.kernel_count());
            let scale = |flux: &f64| {
                if space.model().needs_flux_scaling() {
                    1.0 / flux
                } else {
                    1.0
                }
            };
            let corners = AtCorners {
                coefficients: at_corners.slice(s![.., first..]),
                scales: &fluxes.iter().map(scale).collect::<Vec<f64>>(),
            };
            Reach::new((floor, LEAST_LIGHT), values.get(), &corners, (axes, layout))
        });
        Self {
            values,
            reach: reach.flatten(),
            along_mean: on_pixels.along(&modes),
            modes,
        }
    }

    pub(super) fn bytes(&self) -> usize {
        let reach = self.reach.as_ref().map_or(0, Reach::bytes);
        size_of_val(self.values.get()) + self.along_mean.len() * size_of::<f64>() + reach
    }

    pub(super) fn values(&self) -> &[T] {
        self.values.get()
    }

    /// Copies the coefficients of one residue in a row of a kernel, from pixel 0 on.
    pub(super) fn copy_residue(
        &self,
        layout: RowLayout,
        (row, kernel): (usize, usize),
        residue: usize,
        into: &mut [T],
    ) {
        let values = &self.values()[(row * self.modes.kernel_count() + kernel) * layout.kernel..];
        for (chunk, into) in into.chunks_mut(layout.chunk).enumerate() {
            let first = (chunk * layout.residues + residue) * layout.chunk;
            into.copy_from_slice(&values[first..first + into.len()]);
        }
    }
}
