//! Kriging with every kernel, with short and long lengths, from few and from many samples.

use psfield::PsfieldError;
use psfield::coeff_field::{FieldInterpolation, Kriging, LeftOut};
use psfield::psf_types::{
    CoefficientField, KrigingKernel, KrigingParameters, OutsidePolicy, Position, SampleCoefficients,
    SamplePositions,
};

use super::models::random;
use super::{Case, Cell, Section};

const LENGTHS: [f64; 3] = [0.1, 1.0, 5.0];
const COUNTS: [usize; 2] = [30, 500];
/// The condition number that the least nugget allows. The trend takes a few of the samples.
const CONDITION: f64 = 1.3e14;
/// The number of samples that are left out and predicted by a refit.
const REFITS: usize = 16;
/// The closed form of leave-one-out errors agrees with a refit up to this part of the largest error, for
/// the largest condition number.
const AGREES: f64 = 0.3;
/// The error at samples: the nugget and rounding. A Gaussian kernel that is much longer than the
/// function's details meets 500 samples no better.
const AT_SAMPLES: f64 = 0.1;

/// A smooth function with values of -1 to 1, of positions from 0 to 1000.
fn wave(x: f64, y: f64) -> f64 {
    (0.004 * x + 0.002 * y).sin() * (0.003 * y - 0.001 * x).cos()
}

fn figures(kernel: KrigingKernel, length: f64, count: usize) -> Result<[f64; 4], PsfieldError> {
    let mut share = random(41);
    let mut positions = Vec::with_capacity(count);
    for _ in 0..count {
        positions.push(Position::new(1000.0 * share(), 1000.0 * share())?);
    }
    let samples_at = |positions: &[Position]| -> Result<SampleCoefficients, PsfieldError> {
        let values = positions.iter().map(|p| wave(p.x(), p.y())).collect::<Vec<_>>();
        let values = ndarray::Array2::from_shape_vec((positions.len(), 1), values).expect("one value each");
        Ok(SampleCoefficients::new(
            values,
            SamplePositions::new(positions.to_vec(), None)?,
        )?)
    };
    let samples = samples_at(&positions)?;
    let trend = kernel.lowest_trend().unwrap_or(0);
    let method = Kriging::new(KrigingParameters::new(kernel, [length; 2], trend, 0.0)?);
    let fit = method.fit(&samples, OutsidePolicy::Extend)?;
    let field = fit.field();
    let error_of = |field: &dyn CoefficientField, p: Position| -> Result<f64, PsfieldError> {
        let mut value = [0.0];
        field.evaluate_into(p, &mut value)?;
        Ok((value[0] - wave(p.x(), p.y())).abs())
    };
    let (mut at_samples, mut between) = (0.0_f64, 0.0_f64);
    for &p in &positions {
        at_samples = at_samples.max(error_of(field.as_ref(), p)?);
    }
    for _ in 0..200 {
        let p = Position::new(100.0 + 800.0 * share(), 100.0 + 800.0 * share())?;
        between = between.max(error_of(field.as_ref(), p)?);
    }
    let closed = method.leave_one_out(&samples, OutsidePolicy::Extend)?;
    let (mut disagree, mut largest) = (0.0_f64, f64::MIN_POSITIVE);
    for left_out in (0..count).step_by(count.div_ceil(REFITS)) {
        let others: Vec<Position> = (0..count)
            .filter(|&i| i != left_out)
            .map(|i| positions[i])
            .collect();
        let refit = method.interpolate(&samples_at(&others)?, OutsidePolicy::Extend)?;
        let expected = error_of(refit.as_ref(), positions[left_out])?;
        if let LeftOut::Predicted { error } | LeftOut::Extrapolated { error } = closed.outcomes()[left_out] {
            disagree = disagree.max((error - expected).abs());
            largest = largest.max(expected);
        }
    }
    Ok([
        count as f64 / fit.nugget(),
        at_samples,
        between,
        disagree / largest,
    ])
}

pub(super) fn section() -> Section {
    let mut cases = Vec::new();
    for kernel in KrigingKernel::ALL {
        // A radial spline has no length.
        let lengths = if kernel.lowest_trend().is_none() {
            &LENGTHS[..]
        } else {
            &[1.0]
        };
        for &length in lengths {
            for count in COUNTS {
                let name = match kernel.lowest_trend() {
                    None => format!("{kernel}, length {length}, {count} samples"),
                    Some(_) => format!("{kernel}, {count} samples"),
                };
                cases.push(Case::new(name, move || match figures(kernel, length, count) {
                    Ok([condition, at_samples, between, disagree]) => vec![
                        Cell::error(Ok(condition), CONDITION),
                        Cell::error(Ok(at_samples), AT_SAMPLES),
                        Cell::error(Ok(between), 1.0),
                        Cell::error(Ok(disagree), AGREES),
                    ],
                    Err(error) => vec![Cell::error(Err(error), 0.0)],
                }));
            }
        }
    }
    Section {
        title: "Kriging",
        story: "A smooth function of -1 to 1 at random positions in a square of 1000 pixels, without noise. Lengths\n\
            are in units of half of the square. *Condition*: the largest condition number that the nugget allows.\n\
            It is bounded by about 1e14, because closed forms of leave-one-out errors mean nothing near 1e16. *At samples*:\n\
            the largest error at the samples, because of the nugget. *Between*: the largest error at 200 other\n\
            positions, 100 pixels or more from the edge. A length that does not suit the function has large\n\
            errors. *Leave-one-out*: 16 samples are left out and predicted by a refit of the others. The largest\n\
            difference of this error from the closed form, divided by the largest error.",
        columns: &["condition", "at samples", "between", "leave-one-out"],
        cases,
    }
}
