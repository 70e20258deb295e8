//! The two traits of an interpolator: its choice and its prepared form.

use std::fmt::Debug;

use ndarray::{Array2, ArrayView2};
use psf_types::{FieldError, OutsidePolicy, Position, RowRun, SampleCoefficients, SamplePositions};

use crate::leave_one_out::{self, LeaveOneOut};
use crate::row::Row;
use crate::{CoeffFieldError, WeightList};

/// An interpolation method with its parameters: prepares weights for a set of sample positions.
///
/// Implement it, with [`FieldWeights`], to bring a method of your own: everything in this crate takes
/// `&dyn FieldInterpolation`.
///
/// ```
/// use coeff_field::{CoeffFieldError, FieldInterpolation, FieldWeights, InterpolatedField, WeightList};
/// use psf_types::{
///     CoefficientField, FieldError, OutsidePolicy, Position, SampleCoefficients, SamplePositions,
/// };
///
/// /// The same mean of all samples everywhere.
/// #[derive(Debug)]
/// struct Mean;
/// #[derive(Debug)]
/// struct MeanWeights(usize);
///
/// impl FieldInterpolation for Mean {
///     fn prepare(
///         &self,
///         positions: &SamplePositions,
///         _outside: OutsidePolicy,
///     ) -> Result<Box<dyn FieldWeights>, CoeffFieldError> {
///         Ok(Box::new(MeanWeights(positions.len())))
///     }
/// }
/// impl FieldWeights for MeanWeights {
///     fn sample_count(&self) -> usize {
///         self.0
///     }
///     fn weights_into(&self, _at: Position, weights: &mut WeightList) -> Result<(), FieldError> {
///         weights.clear();
///         weights.extend((0..self.0).map(|sample| (sample, 1.0 / self.0 as f64)));
///         Ok(())
///     }
/// }
///
/// let positions = SamplePositions::new(vec![Position::of_pixel(0, 0), Position::of_pixel(8, 0)], None)?;
/// let samples = SampleCoefficients::new(ndarray::array![[1.0], [3.0]], positions)?;
/// let field = InterpolatedField::new(&samples, &Mean, OutsidePolicy::Nearest)?;
/// let mut value = [0.0];
/// field.evaluate_into(Position::of_pixel(5, 5), &mut value)?;
/// assert_eq!(value, [2.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait FieldInterpolation: Debug + Send + Sync {
    /// Prepares the interpolator for samples at `positions`.
    ///
    /// # Errors
    /// [`CoeffFieldError`] when the positions do not suit the method.
    fn prepare(
        &self,
        positions: &SamplePositions,
        outside: OutsidePolicy,
    ) -> Result<Box<dyn FieldWeights>, CoeffFieldError>;

    /// Predicts every sample from all others; see [`LeaveOneOut`].
    ///
    /// The provided method prepares the interpolator anew for each sample left out, which is slow for thousands of samples;
    /// the interpolators of this crate have shortcuts with the same result.
    ///
    /// # Errors
    /// [`CoeffFieldError`] when the method cannot serve these samples at all. A single sample that cannot be predicted is
    /// no error.
    fn leave_one_out(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<LeaveOneOut, CoeffFieldError> {
        leave_one_out::by_rebuilding(self, samples, outside)
    }
}

/// A prepared interpolator: weights of nodes at any position.
///
/// Every interpolator here is linear in the sample values, `a_k(x) = sum_n w_n(x) v_nk`, so a position's weights serve all
/// components. For most methods the nodes are the samples; a method may have other nodes (a polynomial's are its terms)
/// and says in [`node_values`](Self::node_values) how their values follow from the samples'.
pub trait FieldWeights: Debug + Send + Sync {
    /// The number of samples the interpolator was prepared for.
    fn sample_count(&self) -> usize;

    /// The number of nodes; weights name nodes below it.
    fn node_count(&self) -> usize {
        self.sample_count()
    }

    /// Values at the nodes `[node, component]` from values at the samples `[sample, component]`: the same by default.
    ///
    /// # Errors
    /// [`CoeffFieldError::CountMismatch`] when there is not one row a sample.
    fn node_values(&self, sample_values: ArrayView2<'_, f64>) -> Result<Array2<f64>, CoeffFieldError> {
        check_rows(self.sample_count(), sample_values)?;
        Ok(sample_values.to_owned())
    }

    /// Replaces the content of `weights` with the (node, weight) pairs at `position`; no node appears twice.
    ///
    /// The result depends on nothing but the position.
    ///
    /// # Errors
    /// [`FieldError`] where there is no value.
    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError>;

    /// The x and the y coordinates of the lines between which all weights are bilinear or constant, where there are such cells:
    /// [`CoefficientField::grid_lines`](psf_types::CoefficientField::grid_lines).
    fn grid_lines(&self) -> Option<[Vec<f64>; 2]> {
        None
    }

    /// Calls `visit` with the weights at each of `positions` in turn: the same weights as
    /// [`weights_into`](Self::weights_into), for interpolators that work faster in sequence.
    ///
    /// # Errors
    /// [`FieldError`] at the first position without a value.
    fn weights_each(
        &self,
        positions: &mut dyn Iterator<Item = Position>,
        visit: &mut dyn FnMut(&WeightList),
    ) -> Result<(), FieldError> {
        let mut weights = WeightList::new();
        for position in positions {
            self.weights_into(position, &mut weights)?;
            visit(&weights);
        }
        Ok(())
    }

    /// Visits the weights along a row of pixels, `length` pixels from `(x, y)` on, in runs along which every node's weight is
    /// linear in x: [`CoefficientField::weights_along_row`](psf_types::CoefficientField::weights_along_row).
    ///
    /// A pixel's weights are those of [`weights_into`](Self::weights_into) but for rounding. The provided method visits
    /// pixel by pixel.
    ///
    /// ```
    /// use coeff_field::{Bilinear, FieldInterpolation};
    /// use psf_types::{OutsidePolicy, Position, SamplePositions};
    /// let corners = [(0, 0), (4, 0), (0, 4), (4, 4)].map(|(x, y)| Position::of_pixel(x, y));
    /// let positions = SamplePositions::new(corners.to_vec(), None)?;
    /// let weights = Bilinear.prepare(&positions, OutsidePolicy::Nearest)?;
    /// let mut runs = Vec::new();
    /// weights.weights_along_row((-2, 0), 10, &mut |run| runs.push((run.length, run.last.to_vec())))?;
    /// // Beside the cell on the left, in it with both its lines, and on the right.
    /// assert_eq!(runs, [(2, vec![(0, 1.0)]), (5, vec![(1, 1.0)]), (3, vec![(1, 1.0)])]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`FieldError`] at the first pixel without a value, when all pixels before it have been visited.
    fn weights_along_row(
        &self,
        start: (i64, i64),
        length: usize,
        visit: &mut dyn FnMut(RowRun<'_>),
    ) -> Result<(), FieldError> {
        pixel_by_pixel(self, Row::new(start, length), visit)
    }
}

/// A row in runs of one pixel.
pub(crate) fn pixel_by_pixel<W: FieldWeights + ?Sized>(
    weights: &W,
    row: Row,
    visit: &mut dyn FnMut(RowRun<'_>),
) -> Result<(), FieldError> {
    let mut positions = (0..row.length()).map(|column| row.position(column));
    weights.weights_each(&mut positions, &mut |weights| visit(RowRun::of_pixel(weights)))
}

pub(crate) fn check_rows(samples: usize, values: ArrayView2<'_, f64>) -> Result<(), CoeffFieldError> {
    if values.nrows() == samples {
        Ok(())
    } else {
        Err(CoeffFieldError::CountMismatch {
            what: "rows of sample values, one for each sample",
            expected: samples,
            got: values.nrows(),
        })
    }
}
