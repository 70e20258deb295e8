//! Samples of a regular grid, each predicted from the others.

use psf_types::{OutsidePolicy, SampleCoefficients};

use crate::axis::Axis;
use crate::geometry::Outside;
use crate::grid_weights::AlongAxis;
use crate::leave_one_out::{LeaveOneOut, LeftOut, Unpredictable, prediction_error};
use crate::weight_list::add_weight;
use crate::{CoeffFieldError, RegularGrid, WeightList};

/// Without a sample the grid is no longer regular. Its row without its column, and its column without its row, still are
/// lines along which it can be predicted; the prediction is the mean of the two, or of those that lie around it.
pub(crate) fn grid_leave_one_out(
    samples: &SampleCoefficients,
    along: AlongAxis,
    outside: OutsidePolicy,
) -> Result<LeaveOneOut, CoeffFieldError> {
    let grid = RegularGrid::detect(samples.positions())?;
    let outside = Outside::try_from(outside)?;
    let in_rows = LeftOutLine::each(grid.x(), along, outside);
    let in_columns = LeftOutLine::each(grid.y(), along, outside);
    let mut outcomes: Vec<LeftOut> = Vec::new();
    outcomes.resize_with(samples.positions().len(), || LeftOut::Unpredictable {
        reason: Unpredictable::NoOthers,
    });
    for (row, in_column) in in_columns.iter().enumerate() {
        for (column, in_row) in in_rows.iter().enumerate() {
            let in_row = in_row
                .as_ref()
                .map(|line| line.of_samples(|other| grid.sample(other, row)));
            let in_column = in_column
                .as_ref()
                .map(|line| line.of_samples(|other| grid.sample(column, other)));
            let lines: Vec<LeftOutLine> = in_row.into_iter().chain(in_column).collect();
            let sample = grid.sample(column, row);
            outcomes[sample] = leave_out(samples, sample, &lines, outside);
        }
    }
    Ok(LeaveOneOut::new(outcomes))
}

/// How the other nodes of a line predict one of them.
struct LeftOutLine {
    weights: WeightList,
    between: bool,
}

impl LeftOutLine {
    /// Each line of an axis from the others; none where there are no others.
    fn each(axis: &Axis, along: AlongAxis, outside: Outside) -> Vec<Option<Self>> {
        let lines = 0..axis.lines.len();
        lines
            .map(|left_out| Self::new(axis, left_out, along, outside))
            .collect()
    }

    fn new(axis: &Axis, left_out: usize, along: AlongAxis, outside: Outside) -> Option<Self> {
        let v = axis.lines[left_out];
        let mut others = axis.clone();
        others.lines.remove(left_out);
        if others.lines.is_empty() {
            return None;
        }
        let number = |other: usize| other + usize::from(other >= left_out);
        let weights = along(&others).at(others.place(v, outside));
        Some(Self {
            weights: weights.iter().map(|(other, w)| (number(other), w)).collect(),
            between: left_out > 0 && left_out + 1 < axis.lines.len(),
        })
    }

    fn of_samples(&self, sample: impl Fn(usize) -> usize) -> Self {
        Self {
            weights: self.weights.iter().map(|&(line, w)| (sample(line), w)).collect(),
            between: self.between,
        }
    }
}

fn leave_out(
    samples: &SampleCoefficients,
    sample: usize,
    lines: &[LeftOutLine],
    outside: Outside,
) -> LeftOut {
    let any_between = lines.iter().any(|line| line.between);
    let used: Vec<&LeftOutLine> = lines.iter().filter(|line| line.between || !any_between).collect();
    if used.is_empty() {
        return LeftOut::Unpredictable {
            reason: Unpredictable::NoOthers,
        };
    }
    if !any_between && outside == Outside::Error {
        return LeftOut::Unpredictable {
            reason: Unpredictable::OutsideSamples,
        };
    }
    let mut weights = WeightList::new();
    for line in &used {
        for &(other, weight) in &line.weights {
            add_weight(&mut weights, other, weight / used.len() as f64);
        }
    }
    let error = prediction_error(samples, sample, samples.values(), &weights);
    if any_between {
        LeftOut::Predicted { error }
    } else {
        LeftOut::Extrapolated { error }
    }
}
