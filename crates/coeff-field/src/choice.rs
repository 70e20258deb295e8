//! The methods by name, and the choice of a method for samples.

use ndarray::{Array2, ArrayView2, Axis, concatenate, s};
use psf_types::{Interpolation, OutsidePolicy, Position, SampleCoefficients, SamplePositions};

use crate::bilinear::{Bicubic, Bilinear};
use crate::delaunay::{Delaunay, NaturalNeighbour};
use crate::error::CoeffFieldError;
use crate::grid::RegularGrid;
use crate::interpolation::{FieldInterpolation, Interpolated, LeaveOneOut, LeftOut, Outcomes};
use crate::kriging::{Kriging, NoisyKrigingFit};
use crate::neighbours::{InverseDistance, Nearest};
use crate::polynomial::Polynomial;
use crate::table::Table;

/// The local method that suits samples at these positions.
///
/// * Samples on a regular grid of at least 2 x 2: bicubic, or bilinear on exactly 2 x 2.
/// * A single sample: nearest.
/// * Otherwise: natural neighbour. It interpolates collinear samples along their line.
///
/// Of samples in several states, such as wavelengths, the positions of each state count. If they
/// suit different methods, natural neighbour is taken.
///
/// ```
/// use coeff_field::local_method;
/// use psf_types::{Interpolation, Position, SamplePositions};
/// let corners = [(0, 0), (4, 0), (0, 4), (4, 4)].map(|(x, y)| Position::of_pixel(x, y));
/// let grid = SamplePositions::new(corners.to_vec(), None)?;
/// assert_eq!(local_method(&grid), Interpolation::Bilinear);
/// let triangle = SamplePositions::new(corners[..3].to_vec(), None)?;
/// assert_eq!(local_method(&triangle), Interpolation::NaturalNeighbour);
/// # Ok::<(), psf_types::DataError>(())
/// ```
pub fn local_method(positions: &SamplePositions) -> Interpolation {
    if positions.states().is_some() {
        let of_states = (0..positions.state_count()).map(|state| local_method(&positions.of_state(state)));
        let agreed = of_states.reduce(|a, b| {
            if a == b {
                a
            } else {
                Interpolation::NaturalNeighbour
            }
        });
        return agreed.expect("at least one state");
    }
    if positions.len() == 1 {
        return Interpolation::Nearest;
    }
    match RegularGrid::detect(positions) {
        Ok(grid) if grid.xs().len() >= 2 && grid.ys().len() >= 2 => {
            if positions.len() == 4 {
                Interpolation::Bilinear
            } else {
                Interpolation::Bicubic
            }
        }
        _ => Interpolation::NaturalNeighbour,
    }
}

/// An interpolation that was chosen for samples, and the reason in words.
#[derive(Debug)]
#[non_exhaustive]
pub struct Choice {
    /// The interpolation, with all parameters.
    pub interpolation: Interpolation,
    /// The reason. Empty if the caller named the interpolation.
    pub reason: String,
    /// The samples without noise, and their errors, if they had noise and the interpolation is kriging. The
    /// interpolation is that of these samples.
    pub smoothed: Option<Smoothed>,
    /// The error that kriging expects between the samples: L2 over the components, r.m.s. over the field.
    /// None for other methods.
    pub expected_error: Option<f64>,
}

/// Samples whose noise was removed by kriging ([`NoisyKrigingFit`]).
#[derive(Debug)]
#[non_exhaustive]
pub struct Smoothed {
    /// The coefficients of the samples without noise, as predicted from all samples.
    pub samples: SampleCoefficients,
    /// The errors of predicting each sample, with its noise, from the others.
    pub left_out: LeaveOneOut,
}

impl Choice {
    /// An interpolation that the caller named.
    pub fn named(interpolation: Interpolation) -> Self {
        Self {
            interpolation,
            reason: String::new(),
            smoothed: None,
            expected_error: None,
        }
    }
}

/// Kriging is considered for at least this many samples: fewer do not tell its parameters.
const FEWEST: usize = 10;
/// Kriging is considered for at most this many samples: its time grows as their cube.
const MOST: usize = 2000;

/// Chooses the interpolation for samples, where `wanted` leaves that open.
///
/// * [`Interpolation::Auto`]: kriging or the [`local_method`], whichever predicts samples from the others
///   with the smaller error (r.m.s. over the field, at the samples that both can predict). The error that
///   kriging expects between the samples counts, too. Below 10 samples and above
///   2000, it is the local method.
/// * [`Interpolation::Kriging`] without parameters: with the parameters that suit the samples best.
/// * Any other interpolation is returned unchanged.
///
/// If all states of the samples have the same positions, their coefficients count together.
///
/// `noise` is the standard deviation of each sample's coefficients, if samples have noise. Kriging without
/// given parameters then removes the noise ([`Choice::smoothed`]).
///
/// # Errors
/// [`CoeffFieldError`] when the method does not suit the samples.
pub fn choose(
    wanted: Interpolation,
    samples: &SampleCoefficients,
    noise: Option<&[f64]>,
    outside: OutsidePolicy,
) -> Result<Choice, CoeffFieldError> {
    match wanted {
        Interpolation::Kriging(None) => {
            let joined = Joined::new(samples)?;
            Ok(joined.kriging(samples, noise, outside)?.choice)
        }
        Interpolation::Auto => best(samples, noise, outside),
        other => Ok(Choice::named(other)),
    }
}

/// Kriging of joined samples.
struct Fitted {
    choice: Choice,
    left_out: LeaveOneOut,
    expected_error: f64,
}

fn best(
    samples: &SampleCoefficients,
    noise: Option<&[f64]>,
    outside: OutsidePolicy,
) -> Result<Choice, CoeffFieldError> {
    let local = local_method(samples.positions());
    let take_local = |reason: &str| {
        Ok(Choice {
            reason: reason.to_owned(),
            ..Choice::named(local)
        })
    };
    let Ok(joined) = Joined::new(samples) else {
        return take_local("the states have samples at different positions");
    };
    let count = joined.samples.positions().len();
    if !(FEWEST..=MOST).contains(&count) {
        return take_local(&format!(
            "kriging is considered for {FEWEST} to {MOST} samples, and there are {count}"
        ));
    }
    let Ok(kriging) = joined.kriging(samples, noise, outside) else {
        return take_local("the samples do not determine the parameters of kriging");
    };
    let of_local = interpolation(local)?.leave_one_out(&joined.samples, outside)?;
    let compared = compared(&kriging.left_out, &of_local, joined.samples.positions());
    let Some([left_out, of_local]) = compared else {
        return take_local("no sample can be predicted from the others");
    };
    // Samples that are close to others say little about wide gaps.
    let of_kriging = left_out.max(kriging.expected_error);
    let reason = |better: (&str, f64), worse: (&str, f64)| {
        format!(
            "{} predicts samples from the others with an error of {:.1e} (r.m.s., in the units of the PSF), {} with {:.1e}",
            better.0, better.1, worse.0, worse.1
        )
    };
    let name = if kriging.choice.smoothed.is_some() {
        "kriging, which removes noise,"
    } else {
        "kriging"
    };
    if of_kriging < of_local {
        let reason = reason((name, of_kriging), (&local.to_string(), of_local));
        Ok(Choice {
            reason,
            ..kriging.choice
        })
    } else {
        take_local(&reason((&local.to_string(), of_local), (name, of_kriging)))
    }
}

/// The root mean square of two methods' errors at the samples that both interpolate. A sample counts as
/// the square of its distance from the next one, which is about the area of the field that it stands for.
fn compared(a: &LeaveOneOut, b: &LeaveOneOut, positions: &SamplePositions) -> Option<[f64; 2]> {
    let at = positions.as_slice();
    let area = |sample: usize| {
        let others = at.iter().enumerate().filter(|&(other, _)| other != sample);
        others
            .map(|(_, p)| p.distance(at[sample]).powi(2))
            .fold(f64::INFINITY, f64::min)
    };
    let pairs = a.outcomes().iter().zip(b.outcomes()).enumerate();
    let (mut sums, mut whole) = ([0.0; 2], 0.0);
    for (sample, pair) in pairs {
        if let (LeftOut::Predicted { error: a }, LeftOut::Predicted { error: b }) = pair {
            let area = area(sample);
            sums = [sums[0] + area * a * a, sums[1] + area * b * b];
            whole += area;
        }
    }
    (whole > 0.0).then(|| sums.map(|sum| (sum / whole).sqrt()))
}

/// The coefficients of all states side by side, at the positions that they share.
struct Joined {
    samples: SampleCoefficients,
    /// For each state, the sample at each position.
    of_states: Vec<Vec<usize>>,
}

impl Joined {
    /// # Errors
    /// [`CoeffFieldError::SeveralStates`] for states with samples at different positions.
    fn new(samples: &SampleCoefficients) -> Result<Self, CoeffFieldError> {
        let positions = samples.positions();
        if positions.states().is_none() {
            return Ok(Self {
                samples: samples.clone(),
                of_states: vec![(0..positions.len()).collect()],
            });
        }
        let all = positions.as_slice();
        let shared = positions.of_state(0);
        let mut of_states = Vec::with_capacity(positions.state_count());
        for state in 0..positions.state_count() {
            let own = positions.samples_of_state(state);
            let place = |wanted: &Position| own.iter().copied().find(|&j| all[j].bits() == wanted.bits());
            let order: Option<Vec<usize>> = shared.as_slice().iter().map(place).collect();
            match order {
                Some(order) if order.len() == own.len() => of_states.push(order),
                _ => CoeffFieldError::unless_one_state(positions)?,
            }
        }
        let columns: Vec<Array2<f64>> = of_states
            .iter()
            .map(|order| samples.values().select(Axis(0), order))
            .collect();
        let views: Vec<_> = columns.iter().map(|of_state| of_state.view()).collect();
        let values = concatenate(Axis(1), &views).expect("one row for each position");
        Ok(Self {
            samples: SampleCoefficients::new(values, shared)?,
            of_states,
        })
    }

    /// Values of the joined samples, for each of the samples.
    fn apart(&self, values: ArrayView2<'_, f64>, samples: &SampleCoefficients) -> Array2<f64> {
        let width = samples.component_count();
        let mut apart = Array2::zeros(samples.values().dim());
        for (state, order) in self.of_states.iter().enumerate() {
            let columns = values.slice(s![.., state * width..(state + 1) * width]);
            for (row, &sample) in columns.outer_iter().zip(order) {
                apart.row_mut(sample).assign(&row);
            }
        }
        apart
    }

    /// Kriging with the parameters that suit the samples best.
    fn kriging(
        &self,
        samples: &SampleCoefficients,
        noise: Option<&[f64]>,
        outside: OutsidePolicy,
    ) -> Result<Fitted, CoeffFieldError> {
        let (parameters, left_out, smoothed, expected_error) = match noise {
            None => {
                let kriging = Kriging::default().fit(&self.samples, outside)?;
                let left_out = kriging.leave_one_out(&self.samples, outside)?;
                (kriging.parameters(), left_out, None, kriging.expected_rms_error())
            }
            Some(noise) => {
                let kriging = NoisyKrigingFit::new(&self.samples, &self.noise(noise))?;
                let values = self.apart(kriging.samples().values(), samples);
                let predictions = self.apart(kriging.predictions(), samples);
                let smoothed = Smoothed {
                    samples: SampleCoefficients::new(values, samples.positions().clone())?,
                    left_out: LeaveOneOut::of_predictions(samples, predictions.view())?,
                };
                let left_out = kriging.leave_one_out(&self.samples)?;
                (
                    kriging.parameters(),
                    left_out,
                    Some(smoothed),
                    kriging.expected_rms_error(),
                )
            }
        };
        Ok(Fitted {
            choice: Choice {
                smoothed,
                expected_error: Some(expected_error / (self.of_states.len() as f64).sqrt()),
                ..Choice::named(Interpolation::Kriging(Some(parameters)))
            },
            left_out,
            expected_error,
        })
    }

    /// The noise of each position: the r.m.s. over its states.
    fn noise(&self, of_samples: &[f64]) -> Vec<f64> {
        let at = |row: usize| {
            let squares = self.of_states.iter().map(|order| of_samples[order[row]].powi(2));
            (squares.sum::<f64>() / self.of_states.len() as f64).sqrt()
        };
        (0..self.samples.positions().len()).map(at).collect()
    }
}

/// Returns the interpolation method that `choice` names. [`Auto`] chooses a method when it receives
/// the samples.
///
/// ```
/// use coeff_field::interpolation;
/// use psf_types::Interpolation;
/// let choice: Interpolation = "polynomial=3".parse()?;
/// println!("{:?}", interpolation(choice)?);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`CoeffFieldError::Parameter`] for a parameter out of range,
/// [`CoeffFieldError::UnknownInterpolation`] for a choice that this version does not know.
pub fn interpolation(choice: Interpolation) -> Result<Box<dyn FieldInterpolation>, CoeffFieldError> {
    Ok(match choice {
        Interpolation::Auto => Box::new(Auto),
        Interpolation::Kriging(None) => Box::new(Kriging::default()),
        Interpolation::Kriging(Some(parameters)) => Box::new(Kriging::new(parameters)),
        Interpolation::Delaunay => Box::new(Delaunay),
        Interpolation::NaturalNeighbour => Box::new(NaturalNeighbour),
        Interpolation::InverseDistance { power } => {
            Box::new(InverseDistance::new(power, InverseDistance::DEFAULT_NEIGHBOURS)?)
        }
        Interpolation::Bilinear => Box::new(Bilinear),
        Interpolation::Bicubic => Box::new(Bicubic),
        Interpolation::Polynomial { degree } => Box::new(Polynomial::new(degree)?),
        Interpolation::Nearest => Box::new(Nearest),
        Interpolation::Table { columns, rows } => Box::new(Table::new(columns, rows)?),
        other => return Err(CoeffFieldError::UnknownInterpolation(other)),
    })
}

/// The method that [`choose`] selects for the given samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Auto;

impl FieldInterpolation for Auto {
    fn interpolate(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Interpolated {
        let chosen = choose(Interpolation::Auto, samples, None, outside)?;
        interpolation(chosen.interpolation)?.interpolate(samples, outside)
    }

    /// Selects the method once, for all samples. This method then predicts each sample from the
    /// others.
    fn leave_one_out(&self, samples: &SampleCoefficients, outside: OutsidePolicy) -> Outcomes {
        let chosen = choose(Interpolation::Auto, samples, None, outside)?;
        interpolation(chosen.interpolation)?.leave_one_out(samples, outside)
    }
}

#[cfg(test)]
mod tests {

    use super::*;

    #[test]
    fn the_local_method_suits_the_positions() {
        let choose = |points: &[(i64, i64)]| {
            let positions = points.iter().map(|&(x, y)| Position::of_pixel(x, y)).collect();
            local_method(&SamplePositions::new(positions, None).unwrap())
        };
        assert_eq!(choose(&[(1, 1)]), Interpolation::Nearest);
        assert_eq!(choose(&[(0, 0), (5, 0)]), Interpolation::NaturalNeighbour);
        assert_eq!(choose(&[(0, 0), (5, 5), (9, 9)]), Interpolation::NaturalNeighbour);
        assert_eq!(choose(&[(0, 0), (5, 0), (0, 1), (5, 1)]), Interpolation::Bilinear);
        let lines = [(0, 0), (5, 0), (9, 0), (0, 1), (5, 1), (9, 1)];
        assert_eq!(choose(&lines), Interpolation::Bicubic);
    }

    #[test]
    fn every_choice_has_its_method() {
        for (text, name) in [
            ("auto", "Auto"),
            ("kriging", "Kriging { parameters: None }"),
            ("delaunay", "Delaunay"),
            ("natural-neighbour", "NaturalNeighbour"),
            ("idw=3", "InverseDistance { power: 3.0, neighbours: 6 }"),
            ("bilinear", "Bilinear"),
            ("bicubic", "Bicubic"),
            ("polynomial=4", "Polynomial { degree: 4 }"),
            ("nearest", "Nearest"),
            ("table=8,4", "Table { columns: 8, rows: 4 }"),
        ] {
            assert_eq!(
                format!("{:?}", interpolation(text.parse().unwrap()).unwrap()),
                name
            );
        }
        assert!(interpolation(Interpolation::InverseDistance { power: f64::NAN }).is_err());
        assert!(interpolation(Interpolation::Polynomial { degree: 99 }).is_err());
    }
}
