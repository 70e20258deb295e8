//! Non-linear least squares in a few parameters.

use nalgebra::{SMatrix, SVector};

/// The cost `|r|^2 / 2` at a point, its gradient `J^T r` and the normal matrix `J^T J`, with the
/// residuals `r` and their Jacobian `J`. At a minimum, `hessian` holds the cost's second derivatives.
/// Elsewhere, terms of the order of the gradient may be left out.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Linearised<const N: usize> {
    pub(crate) cost: f64,
    pub(crate) gradient: SVector<f64, N>,
    pub(crate) normal: SMatrix<f64, N, N>,
    pub(crate) hessian: SMatrix<f64, N, N>,
}

/// The point at which the iteration converged.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Minimum<const N: usize> {
    pub(crate) parameters: SVector<f64, N>,
    pub(crate) at: Linearised<N>,
    pub(crate) iterations: usize,
}

/// The iteration did not converge. Holds its last point and the relative change of the model that a
/// full step would still make.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Unsettled<const N: usize> {
    pub(crate) parameters: SVector<f64, N>,
    pub(crate) iterations: usize,
    pub(crate) change: f64,
}

const MAX_ITERATIONS: usize = 300;
/// A full Gauss-Newton step that changes the model by less than this fraction of the data's norm
/// ends the iteration.
const CONVERGED: f64 = 1e-11;
/// The corresponding limit if the cost decreases no further because of its rounding errors, and
/// after [`MAX_ITERATIONS`].
const STALLED: f64 = 1e-7;
/// Newton's method begins when a full Gauss-Newton step changes the model by less than this
/// fraction of the data's norm.
const NEWTON_BELOW: f64 = 1e-2;
/// After a Newton step that failed, the next one is tried when the change has decreased by this
/// factor.
const NEWTON_RETRY: f64 = 0.1;
const FIRST_DAMPING: f64 = 1e-3;
const MAX_DAMPING: f64 = 1e14;
/// A predicted decrease below this fraction of the cost is smaller than the cost's rounding error.
const COST_ROUNDING: f64 = 1e-12;
/// Smallest pivot of the scaled normal matrix. Below it, a direction of the parameters is not
/// determined.
const SMALLEST_PIVOT: f64 = 1e-12;

impl<const N: usize> Linearised<N> {
    /// Column norms of the Jacobian: the natural scale of each parameter.
    fn scales(&self) -> SVector<f64, N> {
        self.normal
            .diagonal()
            .map(|v| if v > 0.0 { v.sqrt() } else { 1.0 })
    }

    /// Solves `(S + damping I) y = -D^-1 J^T r` with `S = D^-1 J^T J D^-1`, where `D` holds the
    /// column norms of `J`. Returns the step `D^-1 y` in the parameters, the norm of the change of
    /// the linearised model, and the predicted decrease of the cost.
    fn step(&self, damping: f64) -> Option<(SVector<f64, N>, f64, f64)> {
        let scales = self.scales();
        let matrix = self.scaled_normal() + SMatrix::identity() * damping;
        let gradient = self.gradient.component_div(&scales);
        let y = matrix.cholesky()?.solve(&-gradient);
        let slope = -gradient.dot(&y);
        let quadratic = y.dot(&(self.scaled_normal() * y));
        let step = y.component_div(&scales);
        let descent = slope - 0.5 * quadratic;
        step.iter()
            .all(|v| v.is_finite())
            .then_some((step, quadratic.max(0.0).sqrt(), descent))
    }

    /// The change of the linearised model by a full Gauss-Newton step, `|P_J r|`.
    fn full_change(&self) -> f64 {
        self.step(0.0).map_or(f64::INFINITY, |(_, change, _)| change)
    }

    /// The step of Newton's method, if the cost is convex and undamped Gauss-Newton steps converge:
    /// the second derivatives `H` satisfy `0 < H < 2 J^T J`. Elsewhere there is no step, so that fits
    /// succeed and fail as with Levenberg-Marquardt alone.
    fn newton_step(&self) -> Option<SVector<f64, N>> {
        let (scales, normal) = (self.scales(), self.scaled_normal());
        let hessian = SMatrix::<f64, N, N>::from_fn(|i, j| self.hessian[(i, j)] / (scales[i] * scales[j]));
        (normal * 2.0 - hessian).cholesky()?;
        let y = hessian.cholesky()?.solve(&-self.gradient.component_div(&scales));
        Some(y.component_div(&scales))
    }

    fn scaled_normal(&self) -> SMatrix<f64, N, N> {
        let scales = self.scales();
        SMatrix::from_fn(|i, j| self.normal[(i, j)] / (scales[i] * scales[j]))
    }

    /// Returns whether the data determine every parameter at this point.
    pub(crate) fn is_determined(&self) -> bool {
        self.scaled_normal().cholesky().is_some_and(|c| {
            c.l()
                .diagonal()
                .iter()
                .all(|pivot| pivot * pivot > SMALLEST_PIVOT)
        })
    }
}

/// Levenberg-Marquardt with the damping rule of Nielsen (1999, report IMM-REP-1999-05) and
/// Marquardt's scaling. Near the minimum, steps of Newton's method replace its own if they at least
/// halve the change below without raising the cost.
///
/// The iteration has converged when an undamped step would change the model by less than 1e-11 of
/// `data_norm`, the norm of the fitted data. This change is `|P_J r|`, the length of the projection
/// of the residuals onto the model's tangent space.
pub(crate) fn minimise<const N: usize>(
    start: SVector<f64, N>,
    data_norm: f64,
    linearise: impl Fn(&SVector<f64, N>) -> Linearised<N>,
) -> Result<Minimum<N>, Unsettled<N>> {
    let mut p = start;
    let mut at = linearise(&p);
    let mut damping = FIRST_DAMPING;
    let mut growth = 2.0;
    let mut change = f64::INFINITY;
    let mut newton_below = NEWTON_BELOW;
    let mut iterations = MAX_ITERATIONS;
    for iteration in 0..MAX_ITERATIONS {
        change = at.full_change() / data_norm;
        if change <= CONVERGED {
            iterations = iteration;
            break;
        }
        if change < newton_below {
            let newton = at.newton_step().map(|step| (p + step, linearise(&(p + step))));
            if let Some((q, there)) = newton
                && there.full_change() / data_norm < 0.5 * change
                && there.cost <= at.cost * (1.0 + COST_ROUNDING)
            {
                (p, at) = (q, there);
                continue;
            }
            newton_below = NEWTON_RETRY * change;
        }
        let trial = at.step(damping).map(|(step, _, predicted)| {
            let q = p + step;
            (q, linearise(&q), predicted)
        });
        let gain = trial.as_ref().map_or(f64::NEG_INFINITY, |(_, there, predicted)| {
            if *predicted <= COST_ROUNDING * at.cost && there.cost <= at.cost * (1.0 + COST_ROUNDING) {
                1.0
            } else {
                (at.cost - there.cost) / predicted
            }
        });
        match trial {
            // If the cost of the trial is NaN, `gain` is NaN and the trial is rejected.
            Some((q, there, _)) if gain > 0.0 => {
                (p, at) = (q, there);
                damping *= (1.0 - (2.0 * gain.min(1.0) - 1.0).powi(3)).max(1.0 / 3.0);
                growth = 2.0;
            }
            _ => {
                damping *= growth;
                growth *= 2.0;
                if damping > MAX_DAMPING {
                    iterations = iteration;
                    break;
                }
            }
        }
    }
    let parameters = p;
    if change <= STALLED {
        Ok(Minimum {
            parameters,
            at,
            iterations,
        })
    } else {
        Err(Unsettled {
            parameters,
            iterations,
            change,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn linearise<const M: usize>(residuals: [(f64, [f64; 2]); M]) -> Linearised<2> {
        let mut at = Linearised {
            cost: 0.0,
            gradient: SVector::zeros(),
            normal: SMatrix::zeros(),
            hessian: SMatrix::zeros(),
        };
        for (r, row) in residuals {
            let row = SVector::from(row);
            at.cost += 0.5 * r * r;
            at.gradient += row * r;
            at.normal += row * row.transpose();
        }
        // Gauss-Newton in place of Newton: the residuals' second derivatives are left out.
        at.hessian = at.normal;
        at
    }

    /// The iteration stops when a step changes the model by less than 1e-11 of the data's norm.
    const SOLVED: f64 = 1e-9;

    #[test]
    fn rosenbrock_valley() {
        let minimum = minimise(SVector::from([-1.2, 1.0]), 1.0, |p| {
            linearise([
                (10.0 * (p[1] - p[0] * p[0]), [-20.0 * p[0], 10.0]),
                (1.0 - p[0], [-1.0, 0.0]),
            ])
        })
        .unwrap();
        assert!(
            (minimum.parameters - SVector::from([1.0, 1.0])).norm() < SOLVED,
            "{minimum:?}"
        );
        assert!(minimum.at.is_determined());
    }

    #[test]
    fn a_sum_of_squares_without_a_minimum_does_not_converge() {
        // r = 1 + exp(-p0) decreases without limit.
        let unsettled = minimise(SVector::from([0.0, 0.0]), 1.0, |p| {
            linearise([(1.0 + (-p[0]).exp(), [-(-p[0]).exp(), 0.0]), (p[1], [0.0, 1.0])])
        })
        .unwrap_err();
        assert!(
            unsettled.parameters[0] > 10.0 && unsettled.change > 0.5,
            "{unsettled:?}"
        );
    }

    #[test]
    fn parameters_with_the_same_effect_are_undetermined() {
        let at = linearise([(1.0, [1.0, 2.0]), (0.5, [2.0, 4.0])]);
        assert!(!at.is_determined());
    }
}
