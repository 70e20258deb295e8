//! The mean stamp in terms of the components.

use ndarray::{Array1, ArrayView1, ArrayView2};

/// The mean stamp of a [`PsfModel`](crate::PsfModel) as a sum of the components and a rest, which is
/// orthogonal to them.
#[derive(Debug)]
pub struct MeanParts {
    /// The factor of each component.
    pub along: Vec<f64>,
    /// The norm of the rest, and the rest divided by this norm, `[stamp pixel]`. `None` if the
    /// components span the mean, or there is no mean.
    pub rest: Option<(f64, Array1<f64>)>,
}

/// The rest is ignored if its norm is below this fraction of the mean's norm.
const NEGLIGIBLE: f64 = 1e-14;
/// A second pass makes the rest orthogonal to the components if it is below this fraction of the mean.
const NO_SECOND_PASS: f64 = 0.5;

impl MeanParts {
    /// Divides a mean into its parts. `components` are orthonormal, `[component, stamp pixel]`.
    pub(crate) fn new(mean: Option<ArrayView1<'_, f64>>, components: ArrayView2<'_, f64>) -> Self {
        let mut along = vec![0.0; components.nrows()];
        let Some(mean) = mean else {
            return Self { along, rest: None };
        };
        let norm = |vector: ArrayView1<'_, f64>| vector.dot(&vector).sqrt();
        let (mut rest, whole) = (mean.to_owned(), norm(mean));
        // If the rest is much smaller than the mean, it is orthogonal to the components only after a
        // second pass (Kahan, in Parlett 1980, section 6-9).
        for _ in 0..2 {
            for (along, component) in along.iter_mut().zip(components.outer_iter()) {
                let part = component.dot(&rest);
                *along += part;
                rest.scaled_add(-part, &component);
            }
            if norm(rest.view()) >= NO_SECOND_PASS * whole {
                break;
            }
        }
        let left = norm(rest.view());
        let rest = (left > NEGLIGIBLE * whole).then(|| (left, rest / left));
        Self { along, rest }
    }
}
