//! Models with interpolations of the caller's own, which are stored as tables.

use std::iter;

use coeff_field::{CoeffFieldError, LeaveOneOut, TableOptions, tabulate, tabulate_field};
use ndarray::{ArrayView2, Axis, concatenate, s};
use psf_types::{
    EvaluateField, FrameShape, Normalisation, Position, PsfBasis, PsfModel, PsfModelRecord,
    SampleCoefficients, SamplePositions,
};

use super::Fit;
use super::report::LeaveOneOutReport;
use crate::error::{ErrorKind, PsfieldError};

/// An interpolation of the caller's own: any smooth function of the position, made from the coefficients
/// of samples. It need not be linear in the coefficients.
///
/// psfield stores it as a table ([`coeff_field::Table`]). So files can hold the model, and it can be
/// resampled.
pub struct OwnInterpolation<'a> {
    /// Its name, for files and reports.
    pub name: &'a str,
    /// Writes the coefficients at positions, `[position, component]`. If the PSF has several states, the
    /// components of the first state come first, then those of the second, and so on. It is called a few
    /// times on the calling thread, with many positions each time.
    pub evaluate: EvaluateField<'a, CoeffFieldError>,
    /// The largest error of the table ([`TABLE_ERROR`](Self::TABLE_ERROR)).
    pub table_error: f64,
    /// The coefficients of each sample `[sample, component]` as the interpolation predicts them from other
    /// samples, and the number of folds: the samples were divided into this number of parts, and each part
    /// was predicted from the others. None if no predictions were made.
    pub predictions: Option<(ArrayView2<'a, f64>, usize)>,
}

impl OwnInterpolation<'_> {
    /// The default of the largest error of a table: the relative L2 error of the PSF. If PSFs are scaled to
    /// unit flux, the relative error of the flux counts in addition. The error is checked at points.
    pub const TABLE_ERROR: f64 = 1e-5;
}

impl std::fmt::Debug for OwnInterpolation<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            name, table_error, ..
        } = self;
        f.debug_struct("OwnInterpolation")
            .field("name", name)
            .field("table_error", table_error)
            .finish_non_exhaustive()
    }
}

impl Fit {
    /// This fit with a table of an interpolation in place of its own. The basis stays the same.
    pub(crate) fn interpolated_by(&self, own: OwnInterpolation<'_>) -> Result<Self, PsfieldError> {
        let left_out = match own.predictions {
            None => LeaveOneOutReport::default(),
            Some((values, folds)) => {
                let left_out = LeaveOneOut::of_predictions(self.record.coefficients(), values)?;
                LeaveOneOutReport {
                    folds: Some(folds),
                    ..LeaveOneOutReport::new(left_out.outcomes(), &self.norms, &self.errors)
                }
            }
        };
        let record = tabulated(&self.record, own)?;
        let positions = record.coefficients().positions();
        Ok(Self {
            reason: format!(
                "{} was given, and is stored in a table of {} nodes",
                record.table_of().unwrap_or("an interpolation"),
                positions.len() / positions.state_count(),
            ),
            record: record.with_circle_error(self.record.circle_error()),
            left_out: Some(left_out),
            expected_error: None,
            ..self.clone()
        })
    }
}

/// A record with a table of an interpolation in place of the samples.
pub(crate) fn tabulated(
    record: &PsfModelRecord,
    own: OwnInterpolation<'_>,
) -> Result<PsfModelRecord, PsfieldError> {
    refuse_wings(record.wings().is_some())?;
    if !(own.table_error > 0.0 && own.table_error.is_finite()) {
        let message = format!("table_error must be above 0, got {}", own.table_error);
        return Err(PsfieldError::of_setting("table_error", message));
    }
    let samples = record.coefficients();
    let (positions, width) = (samples.positions(), samples.component_count());
    let size = RelativeError::new(record.basis(), samples.values(), record.normalisation());
    let size = |error: &[f64]| {
        let of_states = error.chunks_exact(width.max(1)).map(|error| size.of(error));
        of_states.fold(0.0, f64::max)
    };
    let options = TableOptions {
        size: &size,
        limit: own.table_error,
        samples: positions,
    };
    let states = positions.state_count();
    let (nodes, interpolation) = tabulate(width * states, own.evaluate, options)?;
    let nodes = match positions.states() {
        None => nodes,
        Some(states) => {
            let columns = |state: usize| {
                nodes
                    .values()
                    .slice_move(s![.., state * width..(state + 1) * width])
            };
            let columns: Vec<_> = (0..states.values().len()).map(columns).collect();
            let values = concatenate(Axis(0), &columns).expect("equal numbers of components");
            let (at, kind) = (nodes.positions().as_slice(), states.kind());
            let at = SamplePositions::in_every_state(at, positions.field(), kind, states.values())?;
            SampleCoefficients::new(values, at)?
        }
    };
    let (basis, outside) = (record.basis().clone(), record.outside());
    let table = PsfModelRecord::new(basis, nodes, interpolation, outside, record.normalisation())?;
    Ok(table.with_table_of(Some(own.name.to_owned())))
}

/// Refuses the wings of a PSF, for which no table is made.
fn refuse_wings(has_wings: bool) -> Result<(), PsfieldError> {
    if has_wings {
        let message = "a PSF with wings cannot have an interpolation of your own: take a PSF without wings";
        return Err(PsfieldError::new(ErrorKind::Setting, message));
    }
    Ok(())
}

/// A table of a model whose coefficient field may be the caller's own.
pub(crate) fn table_of(model: &PsfModel) -> Result<PsfModelRecord, PsfieldError> {
    let frame = model.field_shape().ok_or_else(|| {
        const NO_FRAME: &str = "a table of a coefficient field of your own covers its frame: state the frame when you make the \
                                PsfModel";
        PsfieldError::new(ErrorKind::Format, NO_FRAME)
    })?;
    refuse_wings(model.wings().is_some())?;
    let stamps = model.stamps();
    let first = usize::from(model.is_mean_centred());
    let mean = model.is_mean_centred().then(|| model.stamp(0).to_owned());
    let basis = PsfBasis::new(mean, stamps.slice(s![first.., .., ..]).to_owned(), model.grid())?;
    let some = model.some_coefficients();
    let size = RelativeError::new(&basis, some.view(), model.normalisation());
    let options = TableOptions {
        size: &|error: &[f64]| size.of(error),
        limit: OwnInterpolation::TABLE_ERROR,
        samples: &SamplePositions::new(corners_of(frame), Some(frame))?,
    };
    let (nodes, interpolation) = tabulate_field(model.field(), options)?;
    let outside = psf_types::OutsidePolicy::default();
    let record = PsfModelRecord::new(basis, nodes, interpolation, outside, model.normalisation())?;
    Ok(record.with_table_of(Some("a coefficient field of one's own".to_owned())))
}

fn corners_of(frame: FrameShape) -> Vec<Position> {
    let last = frame.region().position(frame.nx() - 1, frame.ny() - 1);
    let first = Position::of_pixel(0, 0);
    iter::once(first).chain((last != first).then_some(last)).collect()
}

/// The relative L2 error of a PSF as a function of the error of its coefficients. If PSFs are scaled to
/// unit flux, the relative error of the flux is added.
struct RelativeError {
    /// The smallest norm of PSFs.
    norm: f64,
    /// The flux of each component, relative to the smallest flux of PSFs. Empty for PSFs that are not
    /// scaled.
    fluxes: Vec<f64>,
}

impl RelativeError {
    /// `some` are coefficients of PSFs, `[position, component]`.
    fn new(basis: &PsfBasis, some: ArrayView2<'_, f64>, normalisation: Normalisation) -> Self {
        let (count, ny, nx) = basis.components().dim();
        let flat = (count, ny * nx);
        let components = basis.components().into_shape_with_order(flat).expect("row-major");
        let mean = match basis.mean() {
            Some(mean) => mean.into_shape_with_order(ny * nx).expect("row-major").to_owned(),
            None => ndarray::Array1::zeros(ny * nx),
        };
        // |mean + sum_k a_k B_k|^2 of orthonormal components B_k
        let along = components.dot(&mean);
        let of_mean = mean.dot(&mean);
        let norms = some
            .outer_iter()
            .map(|a| (of_mean + 2.0 * a.dot(&along) + a.dot(&a)).max(0.0).sqrt());
        let norm = norms.fold(f64::INFINITY, f64::min);
        let flux_of = |stamp: f64| basis.grid().flux_of_sum(stamp);
        let of_components = components.outer_iter().map(|stamp| flux_of(stamp.sum()));
        let fluxes = match normalisation {
            Normalisation::Keep => Vec::new(),
            _ => of_components.collect(),
        };
        let of_mean = flux_of(mean.sum());
        let smallest = some
            .outer_iter()
            .map(|a| of_mean + a.iter().zip(&fluxes).map(|(a, f)| a * f).sum::<f64>())
            .fold(f64::INFINITY, f64::min);
        Self {
            norm,
            fluxes: fluxes.into_iter().map(|flux| flux / smallest).collect(),
        }
    }

    fn of(&self, error: &[f64]) -> f64 {
        let norm = error.iter().map(|d| d * d).sum::<f64>().sqrt();
        let flux: f64 = error.iter().zip(&self.fluxes).map(|(d, f)| d * f).sum();
        norm / self.norm + flux.abs()
    }
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, ArrayViewMut2};
    use psf_types::{Interpolation, PsfSamples, StampGrid};

    use super::*;
    use crate::fit::{FitOptions, fit};

    /// Gaussians that widen to the right.
    fn samples() -> PsfSamples {
        let stamps = ndarray::Array3::from_shape_fn((20, 9, 9), |(j, y, x)| {
            let (dx, dy) = (x as f64 - 4.0, y as f64 - 4.0);
            (-(dx * dx + dy * dy) / (2.0 + 0.2 * (j % 5) as f64)).exp()
        });
        let at = (0..20)
            .map(|j| Position::of_pixel(j % 5 * 10, j / 5 * 10))
            .collect();
        let frame = FrameShape::new(41, 31).unwrap();
        let positions = SamplePositions::new(at, Some(frame)).unwrap();
        PsfSamples::new(stamps, positions, StampGrid::new(9, 9).unwrap()).unwrap()
    }

    #[test]
    fn an_interpolation_of_ones_own_is_stored_and_reported() {
        let fitted = fit(samples(), &FitOptions::default()).unwrap();
        let width = fitted.record().basis().rank();
        let mut evaluate = |at: &[Position], mut values: ArrayViewMut2<'_, f64>| {
            for (p, mut row) in at.iter().zip(values.outer_iter_mut()) {
                row.fill(0.01 * (0.05 * p.x()).sin());
            }
            Ok(())
        };
        let predictions = Array2::zeros((20, width));
        let own = OwnInterpolation {
            name: "a wave",
            evaluate: &mut evaluate,
            table_error: 1e-6,
            predictions: Some((predictions.view(), 5)),
        };
        let wave = fitted.interpolated_by(own).unwrap();
        let record = wave.record();
        assert!(matches!(record.interpolation(), Interpolation::Table { .. }));
        assert_eq!(record.table_of(), Some("a wave"));
        let report = wave.report().unwrap();
        assert_eq!((report.samples, report.leave_one_out.folds), (20, Some(5)));
        assert!(report.leave_one_out.predicted == 16 && report.interpolation_reason.contains("a wave"));
        let mut a = vec![0.0; width];
        let at = Position::new(17.3, 9.9).unwrap();
        let model = wave.into_model().unwrap();
        model.field().evaluate_into(at, &mut a).unwrap();
        assert!((a[0] - 0.01 * (0.05 * 17.3_f64).sin()).abs() < 1e-6);
    }

    #[test]
    fn a_relative_error_is_that_of_the_psf() {
        let fitted = fit(samples(), &FitOptions::default()).unwrap();
        let record = fitted.record();
        let a = record.coefficients().values();
        let model = crate::fit::model_of(record.clone()).unwrap();
        let size = RelativeError::new(record.basis(), a, Normalisation::Unit);
        let error: Vec<f64> = (0..a.ncols()).map(|k| 1e-6 / (k + 1) as f64).collect();
        let psf = |shift: &[f64]| {
            let mut sum = model.stamp(0).to_owned();
            for (k, (a, d)) in a.row(4).iter().zip(shift).enumerate() {
                sum.scaled_add(a + d, &model.stamp(k + 1));
            }
            &sum / sum.sum()
        };
        let (own, moved) = (psf(&vec![0.0; a.ncols()]), psf(&error));
        let norm = |a: &Array2<f64>| a.iter().map(|v| v * v).sum::<f64>().sqrt();
        let found = norm(&(&moved - &own)) / norm(&own);
        assert!(found <= size.of(&error) && size.of(&error) < 3.0 * found);
    }
}
