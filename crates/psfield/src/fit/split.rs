//! Divides large stamps into a core and wings.
//!
//! The core is the PSF times a window that falls smoothly from 1 to 0, and the wings are the rest. Wings vary
//! slowly over the field, so a few stamps are enough for them: their mean, and the directions in which they
//! differ most, relative to the light at each distance from the source.

use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array2, Array3, ArrayView1, ArrayView2, ArrayView3, Axis, Zip, s};
use psf_types::{
    DataError, Normalisation, PsfModelRecord, PsfSamples, SampleCoefficients, StampGrid, Wings, WingsRecord,
};
use rayon::prelude::*;
use serde::Serialize;

use crate::error::PsfieldError;

/// The half width of the core, in pixels of the stamps. If they are oversampled, it is at least so many pixels
/// of the frame.
const CORE: usize = 95;
const CORE_OF_FRAME: f64 = 32.0;
/// Stamps are divided if they are wider than the core by this factor.
const LARGER: usize = 2;
/// The window is 1 up to this part of the core's half width.
const WINDOW_FROM: f64 = 0.5;
/// It is 0 at this many pixels from the edge of the core.
const WINDOW_TO: f64 = 3.0;
/// Wings are kept on at most so many stamps.
const MOST_MODES: usize = 4;
/// They have as many as this error needs: the r.m.s. over all pixels and samples of the difference from the
/// samples' wings, relative to the light at the same distance.
const ERROR: f64 = 1e-3;
/// Stamps whose wings would have a larger error are not divided.
const LARGEST_ERROR: f64 = 2e-2;
/// Rows of stamps that a thread works on together.
const ROWS: usize = 64;
/// The flux of a sample may differ from that of the model by this much.
const FLUX_ROUNDING: f64 = 1e-9;

/// The wings that a fit has split from the samples.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct WingsReport {
    /// The columns and rows of the core's stamps, in their pixels.
    pub core_size: usize,
    /// The number of the wings' stamps.
    pub modes: usize,
    /// The r.m.s. difference of the wings from those of the samples, over all their pixels, relative to the
    /// light at the same distance from the source.
    pub error: f64,
    /// The least and the largest part of the flux that the wings hold.
    pub flux: [f64; 2],
}

/// Returns whether stamps are large enough to be divided.
pub(crate) fn splits(grid: StampGrid) -> bool {
    grid.nx().min(grid.ny()) > LARGER * (2 * half_of_core(grid) + 1)
}

fn half_of_core(grid: StampGrid) -> usize {
    CORE.max((CORE_OF_FRAME * grid.oversampling()).ceil() as usize)
}

/// Divides stamps of a grid.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Window {
    pub(crate) core: StampGrid,
    /// The window falls between these distances, in pixels of the stamps.
    pub(crate) radii: [f64; 2],
}

impl Window {
    /// The window for stamps of a grid.
    pub(crate) fn of(grid: StampGrid) -> Result<Self, DataError> {
        let half = half_of_core(grid);
        Ok(Self::on(grid.about_centre(half)?, half as f64))
    }

    /// The window for a core whose stamps reach a distance.
    pub(crate) fn on(core: StampGrid, half: f64) -> Self {
        let to = (half - WINDOW_TO).max(1.0);
        Self {
            core,
            radii: [WINDOW_FROM * to, to],
        }
    }

    /// The window at a distance.
    pub(crate) fn at(&self, radius: f64) -> f64 {
        let [from, to] = self.radii;
        let t = ((radius - from) / (to - from)).clamp(0.0, 1.0);
        1.0 - t * t * t * (10.0 + t * (6.0 * t - 15.0))
    }

    /// The window on the pixels of a grid.
    pub(crate) fn values(&self, grid: StampGrid) -> Array2<f64> {
        Array2::from_shape_fn(grid.dim(), |(j, i)| self.at(radius(grid, j, i)))
    }
}

/// The distance of a pixel from the centre, in pixels of the stamp.
pub(crate) fn radius(grid: StampGrid, row: usize, column: usize) -> f64 {
    (row as f64 - grid.centre_y()).hypot(column as f64 - grid.centre_x())
}

/// Samples' cores, and their wings.
pub(crate) struct Split {
    pub(crate) core: PsfSamples,
    pub(crate) wings: WingsRecord,
    pub(crate) report: WingsReport,
}

/// Divides samples, whose PSFs are already scaled as those of the model will be. None if a few stamps cannot
/// represent their wings.
pub(crate) fn split(samples: &PsfSamples) -> Result<Option<Split>, PsfieldError> {
    let grid = samples.grid();
    let window = Window::of(grid)?;
    // The centre of stamps may lie near an edge.
    let Some((column, row)) = window.core.place_in(grid) else {
        return Ok(None);
    };
    let (ny, nx) = window.core.dim();
    let of_core = window.values(window.core);
    let mut cores = samples
        .stamps()
        .slice(s![.., row..row + ny, column..column + nx])
        .to_owned();
    for mut core in cores.outer_iter_mut() {
        core *= &of_core;
    }
    let core = PsfSamples::new(cores, samples.positions().clone(), window.core)?;
    let outer = window.values(grid).mapv_into(|w| 1.0 - w);
    let stamps = samples.stamps();
    let count = samples.len();
    let mean = stamps.mean_axis(Axis(0)).expect("there are samples") * &outer;
    let norm = |sample: usize| {
        let stamp = stamps.index_axis(Axis(0), sample);
        let of_wings: f64 = stamp.iter().zip(&outer).map(|(v, w)| (v * w).powi(2)).sum();
        let of_core: f64 = core.stamp(sample).iter().map(|v| v * v).sum();
        (of_wings / of_core).sqrt()
    };
    let brightest = (0..count).into_par_iter().map(norm).reduce(|| 0.0, f64::max);
    let has_light = mean.iter().any(|&v| v as f32 != 0.0);
    if !(has_light && brightest <= Wings::LARGEST_NORM) {
        return Ok(None);
    }
    let per_light = per_light(grid, mean.view());
    let products = products(&samples.stamps(), &mean, &outer, &per_light);
    let lit = per_light.iter().filter(|v| **v > 0.0).count();
    let whole = products.trace();
    if !whole.is_finite() {
        return Ok(None);
    }
    let eigen = SymmetricEigen::new(products);
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let mut left = whole.max(0.0);
    let error = |left: f64| (left.max(0.0) / (count * lit.max(1)) as f64).sqrt();
    let mut modes = 0;
    while error(left) > ERROR && modes + 1 < MOST_MODES.min(count) {
        left -= eigen.eigenvalues[order[modes]];
        modes += 1;
    }
    if error(left) > LARGEST_ERROR {
        return Ok(None);
    }
    let mut of_wings = Array3::<f32>::zeros((modes + 1, grid.ny(), grid.nx()));
    of_wings
        .index_axis_mut(Axis(0), 0)
        .assign(&mean.mapv(|v| v as f32));
    let mut values = Array2::ones((count, modes + 1));
    for (mode, &direction) in order[..modes].iter().enumerate() {
        let weights = eigen.eigenvectors.column(direction);
        let mut sum = Array2::<f64>::zeros(grid.dim());
        for (&weight, stamp) in weights.iter().zip(stamps.outer_iter()) {
            // The weights' sum is nearly 0, because deviations add up to 0.
            Zip::from(&mut sum)
                .and(stamp)
                .and(&mean)
                .and(&outer)
                .par_for_each(|sum, v, mean, outer| *sum += weight * (v * outer - mean));
        }
        of_wings
            .index_axis_mut(Axis(0), mode + 1)
            .assign(&sum.mapv(|v| v as f32));
        for (sample, &weight) in weights.iter().enumerate() {
            values[(sample, mode + 1)] = weight;
        }
    }
    let coefficients = SampleCoefficients::new(values, samples.positions().clone())?;
    let wings = WingsRecord::new(of_wings, coefficients, grid)?;
    let fluxes = fluxes_of(&wings);
    let totals = (0..count).map(|sample| samples.flux(sample));
    let parts = fluxes.iter().zip(totals).map(|(flux, total)| flux / total);
    let report = WingsReport {
        core_size: nx,
        modes: modes + 1,
        error: error(left),
        flux: parts.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], part| {
            [least.min(part), most.max(part)]
        }),
    };
    Ok(Some(Split { core, wings, report }))
}

/// The products of the samples' deviations from the mean, relative to the light at each distance.
fn products(
    stamps: &ArrayView3<'_, f64>,
    mean: &Array2<f64>,
    outer: &Array2<f64>,
    per_light: &Array2<f64>,
) -> DMatrix<f64> {
    let count = stamps.dim().0;
    let rows: Vec<usize> = (0..mean.nrows()).collect();
    let of_rows = |rows: &[usize]| {
        let mut products = DMatrix::<f64>::zeros(count, count);
        let mut deviations = Array2::zeros((count, mean.ncols()));
        for &row in rows {
            for (mut to, stamp) in deviations.outer_iter_mut().zip(stamps.outer_iter()) {
                Zip::from(&mut to)
                    .and(stamp.row(row))
                    .and(mean.row(row))
                    .and(outer.row(row))
                    .and(per_light.row(row))
                    .for_each(|to, v, mean, outer, scale| *to = (v * outer - mean) * scale);
            }
            let of_row = deviations.dot(&deviations.t());
            for ((i, j), v) in of_row.indexed_iter() {
                products[(i, j)] += v;
            }
        }
        products
    };
    let parts: Vec<DMatrix<f64>> = rows.par_chunks(ROWS).map(of_rows).collect();
    parts
        .into_iter()
        .fold(DMatrix::zeros(count, count), |sum, part| sum + part)
}

/// The inverse of the mean light at the distance of each pixel. 0 where there is no light.
fn per_light(grid: StampGrid, mean: ArrayView2<'_, f64>) -> Array2<f64> {
    let ring = |(row, column): (usize, usize)| radius(grid, row, column).round() as usize;
    let mut rings = vec![(0.0, 0_usize); grid.nx() + grid.ny()];
    for (at, v) in mean.indexed_iter() {
        let (sum, count) = &mut rings[ring(at)];
        *sum += v.abs();
        *count += 1;
    }
    let inverse = |(sum, count): &(f64, usize)| {
        let inverse = *count as f64 / sum;
        if inverse.is_finite() { inverse } else { 0.0 }
    };
    let inverses: Vec<f64> = rings.iter().map(inverse).collect();
    Array2::from_shape_fn(mean.dim(), |at| inverses[ring(at)])
}

/// The flux of the wings at each sample.
pub(crate) fn fluxes_of(wings: &WingsRecord) -> Vec<f64> {
    let of_modes = wings.stamp_fluxes();
    let rows = wings.coefficients().values();
    let of_row = |row: ArrayView1<'_, f64>| row.iter().zip(&of_modes).map(|(b, f)| b * f).sum();
    rows.outer_iter().map(of_row).collect()
}

/// Adds wings to the model of a core, whose flux is kept. The core is scaled so that both together have the
/// `fluxes` of the samples: a component with the shape of the mean core carries what the basis and the wings
/// leave out.
pub(crate) fn joined(
    record: &PsfModelRecord,
    wings: WingsRecord,
    fluxes: impl Iterator<Item = f64>,
) -> Result<PsfModelRecord, PsfieldError> {
    let (basis, coefficients) = (record.basis(), record.coefficients());
    let grid = basis.grid();
    let flux = |stamp: ArrayView2<'_, f64>| grid.flux_of_sum(stamp.sum());
    let of_mean = basis.mean().map_or(0.0, flux);
    let of_components: Vec<f64> = basis.components().outer_iter().map(flux).collect();
    let values = coefficients.values();
    let found = values.outer_iter().zip(fluxes_of(&wings)).map(|(row, of_wings)| {
        let of_core: f64 = row.iter().zip(&of_components).map(|(a, f)| a * f).sum();
        of_mean + of_core + of_wings
    });
    let missing: Vec<f64> = fluxes.zip(found).map(|(flux, found)| flux - found).collect();
    let keep = |record: PsfModelRecord| {
        let outside = record.outside();
        record.with_policies(outside, Normalisation::Keep)
    };
    let carrier = match basis.mean() {
        Some(mean) => Some(mean.to_owned()),
        // Without a mean, the first component holds most of the light.
        None => basis
            .components()
            .outer_iter()
            .next()
            .map(|stamp| stamp.to_owned()),
    };
    let carrier = carrier.filter(|stamp| flux(stamp.view()) != 0.0);
    let is_needed = missing.iter().any(|flux| flux.abs() > FLUX_ROUNDING);
    let (Some(carrier), true) = (carrier, is_needed) else {
        return Ok(keep(record.clone()).with_wings(Some(wings))?);
    };
    let (rank, of_carrier) = (basis.rank(), flux(carrier.view()));
    let mut stamps = Array3::zeros((rank + 1, grid.ny(), grid.nx()));
    stamps.slice_mut(s![..rank, .., ..]).assign(&basis.components());
    stamps.index_axis_mut(Axis(0), rank).assign(&carrier);
    let mut with_carrier = Array2::zeros((values.nrows(), rank + 1));
    with_carrier.slice_mut(s![.., ..rank]).assign(&values);
    for (to, flux) in with_carrier.column_mut(rank).iter_mut().zip(missing) {
        *to = flux / of_carrier;
    }
    let mean = basis.mean().map(|mean| mean.to_owned());
    let (basis, values) = psf_basis::orthonormal_in_order(mean, stamps, with_carrier.view(), grid)?;
    let coefficients = SampleCoefficients::new(values, coefficients.positions().clone())?;
    let made = record
        .with_parts(basis, coefficients)?
        .with_circle_error(record.circle_error());
    Ok(keep(made).with_wings(Some(wings))?)
}
