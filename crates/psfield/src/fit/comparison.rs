//! Compares interpolations by the errors of predicting samples from each other.

use coeff_field::{Polynomial, RegularGrid};
use psf_types::{Interpolation, PsfSamples, SamplePositions};
use serde::Serialize;

use super::{Fit, FitOptions, LeaveOneOutReport, fit_basis, shifted_copies};
use crate::error::PsfieldError;

/// The leave-one-out errors of samples with one interpolation.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct InterpolationErrors {
    /// The interpolation, with all parameters.
    pub interpolation: Interpolation,
    /// The errors of predicting each sample from the others.
    pub leave_one_out: LeaveOneOutReport,
}

/// The degrees of polynomials that are compared.
const DEGREES: [usize; 4] = [2, 4, 6, 8];
/// A polynomial needs this many samples for each of its terms.
const SAMPLES_PER_TERM: f64 = 1.5;

/// Compares the interpolations that suit samples: predicts every sample from the others with each of them.
/// The best comes first. All use one basis, that of `options`, whose interpolation does not apply.
///
/// # Errors
/// The errors of [`fit()`](super::fit()).
pub fn compare_interpolations(
    samples: PsfSamples,
    options: &FitOptions,
) -> Result<Vec<InterpolationErrors>, PsfieldError> {
    let methods = methods_for(samples.positions());
    let copies = shifted_copies(&samples, options.shift_copies)?;
    let (basis, norms) = fit_basis(samples, copies, options)?;
    let mut found = Vec::with_capacity(methods.len());
    for interpolation in methods {
        let options = FitOptions {
            interpolation,
            ..*options
        };
        let fit = Fit::of_parts(basis.clone(), norms.clone(), &options)?;
        // Samples that lie on a line, for example, do not suit every method.
        if let Ok(leave_one_out) = fit.leave_one_out() {
            found.push(InterpolationErrors {
                interpolation: fit.record().interpolation(),
                leave_one_out,
            });
        }
    }
    let median = |errors: &InterpolationErrors| errors.leave_one_out.median.unwrap_or(f64::INFINITY);
    found.sort_by(|a, b| median(a).total_cmp(&median(b)));
    Ok(found)
}

/// The interpolations that suit these positions.
fn methods_for(positions: &SamplePositions) -> Vec<Interpolation> {
    let mut methods = vec![
        Interpolation::Kriging(None),
        Interpolation::NaturalNeighbour,
        Interpolation::Delaunay,
        Interpolation::InverseDistance {
            power: Interpolation::DEFAULT_POWER,
        },
        Interpolation::Nearest,
    ];
    let states = positions.state_count();
    let on_grid = (0..states).all(|state| RegularGrid::detect(&positions.of_state(state)).is_ok());
    if on_grid {
        methods.extend([Interpolation::Bilinear, Interpolation::Bicubic]);
    }
    let each = positions.len() as f64 / states as f64;
    let terms = |degree: usize| Polynomial::new(degree).map_or(usize::MAX, Polynomial::term_count);
    let enough = |degree: &usize| each >= SAMPLES_PER_TERM * terms(*degree) as f64;
    let polynomials = DEGREES.into_iter().filter(enough);
    methods.extend(polynomials.map(|degree| Interpolation::Polynomial { degree }));
    methods
}
