//! The choice of kriging's parameters.

use ndarray::{Array2, ArrayView2};
use psf_types::{KrigingKernel, KrigingParameters};
use rayon::prelude::*;

use super::system::{Covariances, Equations, LEAST_NUGGET, compressed};
use crate::geometry::Point;

/// The lengths that are tried first, the same along x and y.
pub(super) const LENGTHS: [f64; 10] = [0.15, 0.25, 0.4, 0.6, 0.85, 1.2, 1.7, 2.5, 4.0, 7.0];
/// The nuggets that are tried first. The least one depends on the number of samples.
const NUGGETS: [f64; 6] = [0.0, 1e-8, 1e-5, 1e-3, 1e-1, 3.0];
/// Each step of the refinement changes lengths by this factor.
const STEP: f64 = 1.2;
const MOST_ROUNDS: usize = 12;
/// All parameters are tried on at most this many samples, well spread over the field.
const FIRST_SAMPLES: usize = 200;
/// They are refined on at most this many.
const MOST_SAMPLES: usize = 1000;
/// Lengths stay in this range. Covariances of longer ones are 1 up to rounding.
const RANGE: (f64, f64) = (0.02, 10.0);

/// Parameters, and what they score: smaller is better.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scored {
    pub(super) parameters: KrigingParameters,
    pub(super) score: f64,
}

/// Samples at scaled points, and their values `[sample, column]`.
pub(super) struct Samples {
    pub(super) points: Vec<Point>,
    pub(super) values: Array2<f64>,
}

/// The parameters with which the samples predict each other best.
///
/// The score is the logarithm of the density that the other samples give to a sample, in the mean over
/// samples (S. Geisser and W. Eddy 1979, JASA 74, 153; S. Sundararajan and S. Keerthi 2001, Neural
/// Computation 13, 1103), with the variance that fits best. All columns count at once. `None` if there
/// are too few samples.
pub(super) fn chosen(points: &[Point], values: ArrayView2<'_, f64>) -> Option<KrigingParameters> {
    let all = Samples {
        points: points.to_vec(),
        values: compressed(values),
    };
    let few = all.select(&all.spread(FIRST_SAMPLES));
    let first: Vec<(KrigingKernel, usize, f64)> = KrigingKernel::ALL
        .into_iter()
        .flat_map(|kernel| match kernel.lowest_trend() {
            None => LENGTHS.map(|length| (kernel, 0, length)).to_vec(),
            // A radial spline has no length.
            Some(trend) => vec![(kernel, trend, 1.0)],
        })
        .collect();
    let best = best_of(first, |(kernel, trend, length)| {
        few.best_nugget(kernel, [length; 2], trend)
    })?;
    let many = all.select(&all.spread(MOST_SAMPLES));
    let least_nugget = LEAST_NUGGET * many.points.len() as f64;
    let neighbours = |of| neighbours_of(of, least_nugget);
    refined(best.parameters, MOST_ROUNDS, neighbours, |parameters| {
        many.score(&Covariances::new(&many.points, &parameters)?, parameters)
    })
}

/// The best of some trials, which are scored in parallel.
pub(super) fn best_of<T: Send>(
    trials: Vec<T>,
    score: impl Fn(T) -> Option<Scored> + Sync + Send,
) -> Option<Scored> {
    let scored: Vec<Option<Scored>> = trials.into_par_iter().map(score).collect();
    smallest(scored.into_iter().flatten())
}

fn smallest(scored: impl Iterator<Item = Scored>) -> Option<Scored> {
    scored.min_by(|a, b| a.score.total_cmp(&b.score))
}

/// Steps to better parameters until none of the neighbours is better, at most `rounds` times.
pub(super) fn refined(
    first: KrigingParameters,
    rounds: usize,
    neighbours: impl Fn(KrigingParameters) -> Vec<KrigingParameters>,
    score: impl Fn(KrigingParameters) -> Option<Scored> + Sync + Send,
) -> Option<KrigingParameters> {
    let mut best = score(first)?;
    for _ in 0..rounds {
        match best_of(neighbours(best.parameters), &score) {
            Some(better) if better.score < best.score => best = better,
            _ => break,
        }
    }
    Some(best.parameters)
}

impl Samples {
    /// At most `count` of the samples, ascending. Each of them was the one farthest from those chosen before
    /// it.
    pub(super) fn spread(&self, count: usize) -> Vec<usize> {
        if self.points.len() <= count {
            return (0..self.points.len()).collect();
        }
        let square = |a: Point, b: Point| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
        let mut nearest: Vec<f64> = self.points.iter().map(|&p| square(p, [-1.0, -1.0])).collect();
        let mut chosen = Vec::with_capacity(count);
        // The first is the one in the corner.
        let mut next = (0..nearest.len())
            .min_by(|&a, &b| nearest[a].total_cmp(&nearest[b]))
            .unwrap_or(0);
        nearest.fill(f64::INFINITY);
        while chosen.len() < count {
            chosen.push(next);
            for (distance, &p) in nearest.iter_mut().zip(&self.points) {
                *distance = distance.min(square(p, self.points[next]));
            }
            let farthest =
                (0..nearest.len()).max_by(|&a, &b| nearest[a].total_cmp(&nearest[b]).then(b.cmp(&a)));
            next = farthest.unwrap_or(0);
        }
        chosen.sort_unstable();
        chosen
    }

    pub(super) fn select(&self, chosen: &[usize]) -> Self {
        Self {
            points: chosen.iter().map(|&i| self.points[i]).collect(),
            values: self.values.select(ndarray::Axis(0), chosen),
        }
    }

    /// Tries several nuggets.
    fn best_nugget(&self, kernel: KrigingKernel, lengths: [f64; 2], trend: usize) -> Option<Scored> {
        let parameters = KrigingParameters::new(kernel, lengths, trend, 0.0).ok()?;
        let covariances = Covariances::new(&self.points, &parameters)?;
        let scored = NUGGETS.into_iter().filter_map(|nugget| {
            let parameters = KrigingParameters::new(kernel, lengths, trend, nugget).ok()?;
            self.score(&covariances, parameters)
        });
        smallest(scored)
    }

    fn score(&self, covariances: &Covariances, parameters: KrigingParameters) -> Option<Scored> {
        let equations = Equations::new(covariances, parameters.nugget())?;
        let precisions = equations.precisions();
        let duals = equations.solve(self.values.view()).duals;
        let count = precisions.len() as f64;
        let (mut squares, mut logarithms) = (0.0, 0.0);
        for (dual, precision) in duals.outer_iter().zip(&precisions) {
            squares += dual.dot(&dual) / precision;
            logarithms -= precision.ln();
        }
        // Equal samples have no errors.
        let score = (squares / count).max(f64::MIN_POSITIVE).ln() + logarithms / count;
        score.is_finite().then_some(Scored { parameters, score })
    }
}

/// Parameters of which one differs.
pub(super) fn neighbours_of(parameters: KrigingParameters, least_nugget: f64) -> Vec<KrigingParameters> {
    let (kernel, lengths) = (parameters.kernel(), parameters.lengths());
    let (trend, nugget) = (parameters.trend(), parameters.nugget());
    let mut found = Vec::new();
    // The scale of a radial spline has no effect, only its stretch.
    let scales = kernel.lowest_trend().is_none();
    let steps = [
        (STEP, STEP),
        (1.0 / STEP, 1.0 / STEP),
        (STEP, 1.0),
        (1.0 / STEP, 1.0),
        (1.0, STEP),
        (1.0, 1.0 / STEP),
    ];
    for (x, y) in steps.into_iter().filter(|(x, y)| scales || x != y) {
        let lengths = [lengths[0] * x, lengths[1] * y].map(|v| rounded(v.clamp(RANGE.0, RANGE.1)));
        found.extend(KrigingParameters::new(kernel, lengths, trend, nugget).ok());
    }
    let trends = [trend.checked_sub(1), Some(trend + 1)].into_iter().flatten();
    for trend in trends.filter(|&trend| trend < KrigingParameters::MAX_TREND) {
        found.extend(KrigingParameters::new(kernel, lengths, trend, nugget).ok());
    }
    let nuggets = if nugget <= least_nugget {
        vec![10.0 * least_nugget]
    } else {
        vec![0.1 * nugget, 10.0 * nugget]
    };
    for nugget in nuggets {
        let nugget = if nugget <= least_nugget {
            0.0
        } else {
            rounded(nugget)
        };
        found.extend(KrigingParameters::new(kernel, lengths, trend, nugget).ok());
    }
    found
}

/// A number with three digits, which reads well.
fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}
