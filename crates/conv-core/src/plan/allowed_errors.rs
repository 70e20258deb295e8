//! The number of modes that the allowed errors require.

use ndarray::ArrayView1;

use super::growth_curves::TailGrowth;
use super::node_functions::{NodeFunctions, sum_of_magnitudes};
use super::norm::dot;
use super::region_cells::RegionCells;

/// An error is rounding if its norm is at most this fraction of the PSF's norm. Its flux in circles
/// is then not tested.
pub(crate) const ROUNDING_NORM: f64 = 1e-15;

/// The largest error of the coefficients in cells ([`ErrorLimit`](psf_types::ErrorLimit)).
#[derive(Debug, Clone, Copy)]
pub struct CellError {
    /// The largest size, if nothing else is known of the error.
    pub size: f64,
    /// The factor of the components' fluxes in the size. 0 if PSFs are not scaled to unit flux.
    pub flux_weight: f64,
    /// The largest size of an error whose flux in circles is measured, too.
    pub l2: f64,
    /// The largest flux of such an error in a circle. `None` if it is not limited or, of an error that
    /// occurred, if it is not known.
    pub circle: Option<f64>,
}

impl CellError {
    /// No error.
    pub(crate) const ZERO: Self = Self {
        size: 0.0,
        flux_weight: 0.0,
        l2: 0.0,
        circle: Some(0.0),
    };

    /// This error times a factor.
    pub(crate) fn times(self, factor: f64) -> Self {
        Self {
            size: factor * self.size,
            flux_weight: self.flux_weight,
            l2: factor * self.l2,
            circle: self.circle.map(|circle| factor * circle),
        }
    }

    /// Returns whether each part of this error is within that of another. Fluxes count as in this error.
    pub(crate) fn is_within(self, other: Self) -> bool {
        let in_circles = match (self.circle, other.circle) {
            (Some(own), Some(other)) => own <= other,
            (None, Some(_)) => false,
            (_, None) => true,
        };
        self.l2 <= other.l2 && other.flux_weight <= self.flux_weight && in_circles
    }
}

/// The largest errors that modes may cause, after those of the cells.
///
/// Let an unscaled PSF be off by `d`, and its flux by `f`, because of the error of a cell's
/// coefficients: `sqrt(|d|^2 + weight^2 f^2) <= e`. The cell's PSF, scaled to unit flux, then
/// differs from the model's scaled PSF `h` by at most
/// `|d| + |f| |h| <= e sqrt(1 + (|h| / weight)^2)`, divided by the flux of the cell's unscaled PSF.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AllowedErrors {
    pub(crate) tolerance: f64,
    pub(crate) cells: CellError,
    /// The largest flux in a circle of an error of norm 1. 0 if these fluxes are not bounded.
    pub(crate) largest_flux: f64,
    /// The sign of the region's mean flux.
    pub(crate) sign: f64,
}

impl AllowedErrors {
    /// The least allowed error of a PSF at a corner of the cells, divided by the sum of the
    /// weights' magnitudes there. `betas` and `fluxes` are those of the nodes and of the offset.
    pub(crate) fn least(
        &self,
        cells: &RegionCells,
        betas: ArrayView1<'_, f64>,
        fluxes: ArrayView1<'_, f64>,
    ) -> f64 {
        let last = betas.len() - 1;
        let at = |end: &[(usize, f64)], values: ArrayView1<'_, f64>| {
            end.iter().map(|&(n, w)| w * values[n]).sum::<f64>() + values[last]
        };
        let (mut least, mut most_weight) = (f64::INFINITY, 1.0_f64);
        for end in cells.corners() {
            let (beta, flux) = (at(end, betas), self.sign * at(end, fluxes));
            let by_cells = self.of_cells(beta / flux);
            let norm = self.norm(beta, by_cells);
            let flux = self.flux(flux, by_cells) / self.largest_flux;
            // Without a bound of fluxes, this is infinite or not a number.
            least = least.min(norm).min(flux);
            most_weight = most_weight.max(sum_of_magnitudes(end));
        }
        least.max(0.0) / most_weight
    }

    /// The error of an unscaled PSF because of its cell. `scaled_norm` is the norm of the cell's
    /// PSF divided by its flux. The model's PSF exceeds it by at most a factor of 1 + tolerance,
    /// because cells use at most half of the tolerance.
    #[inline(always)]
    pub(crate) fn of_cells(&self, scaled_norm: f64) -> f64 {
        let CellError {
            size, flux_weight, ..
        } = self.cells;
        if flux_weight == 0.0 || size == 0.0 {
            size
        } else {
            size * (1.0 + (scaled_norm * (1.0 + self.tolerance) / flux_weight).powi(2)).sqrt()
        }
    }

    /// The allowed norm for a PSF of at least the norm `beta`. The error is relative to the PSF of
    /// the model, which differs by the error of the cell.
    #[inline(always)]
    fn norm(&self, beta: f64, by_cells: f64) -> f64 {
        self.tolerance * beta - (1.0 + self.tolerance) * by_cells
    }

    /// The allowed flux in any circle for a PSF of the given flux.
    #[inline(always)]
    fn flux(&self, flux: f64, by_cells: f64) -> f64 {
        let in_circles = self.cells.circle.unwrap_or(self.largest_flux * by_cells);
        self.tolerance * flux - (1.0 + self.tolerance) * in_circles
    }
}

/// Counts the leading coordinates to keep, so that for every PSF the other coordinates are within
/// the allowed errors: their norm and, if `growth` is given, their flux in every circle. If cells
/// may use most of the tolerance, the error is the factor by which their error must become smaller.
pub(crate) struct CountModes<'a> {
    pub(crate) cells: &'a RegionCells,
    /// Beta, flux and coordinates.
    pub(crate) table: &'a NodeFunctions,
    pub(crate) errors: AllowedErrors,
    /// The norm of the reference.
    pub(crate) reference: f64,
    /// The norm of what the coordinates leave out of a node.
    pub(crate) outside: f64,
    /// The norm of the change of a node because of its flux along components that are left out.
    pub(crate) moved: f64,
    pub(crate) growth: Option<TailGrowth>,
}

/// The usual factor in the error of [`CountModes`].
const SMALLER: f64 = 0.4;
/// The functions before the coordinates in [`CountModes::table`].
const BEFORE: usize = 2;

impl CountModes<'_> {
    #[inline(always)]
    pub(crate) fn count(mut self) -> Result<usize, f64> {
        let (width, errors) = (self.table.width, self.errors);
        let mut values = vec![0.0; self.cells.corners().len() * width];
        let mut magnitudes = Vec::with_capacity(self.cells.corners().len());
        for (corner, values) in self.cells.corners().zip(values.chunks_exact_mut(width)) {
            self.table.at(corner, values);
            magnitudes.push(sum_of_magnitudes(corner));
        }
        let rounding = ROUNDING_NORM / errors.tolerance;
        let mut needed = 0;
        for corners in self.cells.corners_of_cells() {
            // An allowed error that is linear along rows and columns is nowhere in the cell below
            // its least value at the corners.
            let (mut beta, mut flux) = (f64::INFINITY, f64::INFINITY);
            let (mut magnitude, mut scaled_norm) = (0.0_f64, 0.0_f64);
            for &corner in corners {
                let values = &values[corner * width..(corner + 1) * width];
                beta = beta.min(values[0]);
                flux = flux.min(errors.sign * values[1]);
                magnitude = magnitude.max(magnitudes[corner]);
                if errors.cells.flux_weight > 0.0 && errors.cells.size > 0.0 {
                    let rest = dot(&values[BEFORE..], &values[BEFORE..]).sqrt();
                    let rest = rest + (self.outside + self.moved) * magnitudes[corner];
                    scaled_norm = scaled_norm.max(self.reference + rest / values[1].abs());
                }
            }
            let by_cells = errors.of_cells(scaled_norm);
            let norm = errors.norm(beta, by_cells);
            let flux_allowed = errors.flux(flux, by_cells);
            if errors.cells.size > 0.0 {
                let least = 0.5 * errors.tolerance;
                // Where the flux vanishes in a cell, a small error of it has no bound.
                if errors.cells.flux_weight > 0.0 && (flux.is_nan() || flux <= 0.0) {
                    return Err(0.0);
                }
                let enough = norm >= least * beta && beta > 0.0;
                if !enough || errors.largest_flux > 0.0 && flux_allowed < least * flux {
                    return Err(SMALLER);
                }
            }
            let (left_out, moved) = (self.outside * magnitude, self.moved * magnitude);
            // The directions left out are orthogonal to the coordinates.
            let norm = (norm - moved).max(0.0);
            let norm_squared = (norm * norm - left_out * left_out).max(0.0);
            let flux = (flux_allowed - errors.largest_flux * (left_out + moved)).max(0.0);
            for &corner in corners {
                let values = &values[corner * width + BEFORE..(corner + 1) * width];
                needed = needed_beyond(needed, values, norm_squared);
                let Some(growth) = &mut self.growth else { continue };
                while needed < values.len() {
                    let tail = &values[needed..];
                    let size = dot(tail, tail);
                    if size <= rounding.powi(2) * norm_squared || growth.is_within(needed, tail, flux) {
                        break;
                    }
                    needed += 1;
                }
            }
        }
        Ok(needed)
    }
}

/// Returns the smallest number of leading values, at least `first`, so that the squared norm of the
/// others is at most `limit`.
#[inline(always)]
fn needed_beyond(first: usize, values: &[f64], limit: f64) -> usize {
    let tail = &values[first..];
    // The negated test also holds for values that are not numbers.
    if dot(tail, tail) <= limit {
        return first;
    }
    let mut sum = 0.0;
    let fits = |value: &&f64| {
        sum += *value * *value;
        sum <= limit
    };
    first + tail.len() - tail.iter().rev().take_while(fits).count()
}
