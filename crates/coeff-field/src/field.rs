//! The coefficient field of a method with few weights at each position.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use ndarray::{Array2, ArrayView2, ArrayViewMut3};
use psf_types::{
    BilinearCells, CoefficientField, DataError, ErrorLimit, FieldError, FrameShape, PixelRegion, Position,
    SampleCoefficients, WeightedNodes,
};

use crate::error::CoeffFieldError;
use crate::interpolation::{FieldWeights, Interpolated, OnRun, Visited, WeightList};

/// Number of pixels of a row whose coefficients are computed before they are written to the output,
/// which has one plane per component. Each plane then receives several neighbouring pixels at once.
/// Meanwhile the computed values stay in the first cache levels.
const STRETCH: usize = 32;

/// Coefficients interpolated over the field: `a_k(x) = sum_n w_n(x) v_nk`.
///
/// `w_n(x)` is the weight of node `n`, and `v_nk` is the value of component `k` at this node (see
/// [`FieldWeights`]).
/// Stores the interpolator and the values at its nodes, but nothing per pixel. Evaluating a region
/// computes each pixel's weights once for all requested components. Clones are cheap. Evaluation
/// takes no lock, so many threads can evaluate regions at once.
///
/// ```
/// use coeff_field::{Bilinear, FieldInterpolation};
/// use ndarray::{Array3, array};
/// use psf_types::{FrameShape, OutsidePolicy, PixelRegion, Position, SampleCoefficients, SamplePositions};
/// let corners = [(0, 0), (8, 0), (0, 8), (8, 8)].map(|(x, y)| Position::of_pixel(x, y));
/// let positions = SamplePositions::new(corners.to_vec(), None)?;
/// let samples = SampleCoefficients::new(array![[0.0, 0.0], [8.0, 0.0], [0.0, 8.0], [8.0, 8.0]], positions)?;
/// let field = Bilinear.interpolate(&samples, OutsidePolicy::Nearest)?;
///
/// let tile = PixelRegion::new(2, 3, FrameShape::new(4, 2)?);
/// let mut values = Array3::zeros((2, 2, 4));
/// field.evaluate_region_into(tile, 0..2, values.view_mut())?;
/// // The two components are x and y.
/// assert_eq!((values[[0, 1, 3]], values[[1, 1, 3]]), (5.0, 4.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct InterpolatedField {
    /// `[node, component]`, row-major.
    nodes: Arc<Array2<f64>>,
    weights: Arc<dyn FieldWeights>,
}

impl InterpolatedField {
    /// The field of samples with the weights that a method prepared for their positions.
    ///
    /// # Errors
    /// [`CoeffFieldError`] when the samples belong to several states, when the values at the nodes
    /// overflow, or when the weights have a wrong number of node values.
    pub fn new(
        samples: &SampleCoefficients,
        weights: Box<dyn FieldWeights>,
    ) -> Result<Self, CoeffFieldError> {
        CoeffFieldError::unless_one_state(samples.positions())?;
        let nodes = weights.node_values(samples.values())?;
        let nodes = if nodes.is_standard_layout() {
            nodes
        } else {
            nodes.as_standard_layout().into_owned()
        };
        let what = "rows of node values, one for each node";
        DataError::check_count(what, weights.node_count(), nodes.nrows())?;
        let what = "components of the nodes' values";
        DataError::check_count(what, samples.component_count(), nodes.ncols())?;
        if let Some(((node, component), &value)) = nodes.indexed_iter().find(|(_, v)| !v.is_finite()) {
            return Err(CoeffFieldError::NonFiniteNode {
                node,
                component,
                value,
            });
        }
        Ok(Self {
            nodes: Arc::new(nodes),
            weights: weights.into(),
        })
    }

    /// The values at the nodes, `[node, component]`.
    pub fn node_values(&self) -> ArrayView2<'_, f64> {
        self.nodes.view()
    }

    /// The prepared interpolator.
    pub fn weights(&self) -> &dyn FieldWeights {
        self.weights.as_ref()
    }

    /// Writes `sum_n w_n v_nk` for a range of components. The terms are added in the order of the
    /// weights, so that a value does not depend on the other requested components.
    fn apply(&self, weights: &WeightList, components: &Range<usize>, sums: &mut [f64]) {
        let all = self.nodes.as_slice().expect("row-major");
        let row = |node: usize| {
            let start = node * self.nodes.ncols();
            &all[start + components.start..start + components.end]
        };
        match weights.split_first() {
            None => sums.fill(0.0),
            Some((&(node, weight), others)) => {
                for (sum, value) in sums.iter_mut().zip(row(node)) {
                    *sum = weight * value;
                }
                for &(node, weight) in others {
                    for (sum, value) in sums.iter_mut().zip(row(node)) {
                        *sum += weight * value;
                    }
                }
            }
        }
    }
}

impl CoefficientField for InterpolatedField {
    fn component_count(&self) -> usize {
        self.nodes.ncols()
    }

    /// # Panics
    /// When `coefficients.len() != self.component_count()`.
    fn evaluate_into(&self, position: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        assert_eq!(
            coefficients.len(),
            self.component_count(),
            "one coefficient per component"
        );
        let mut weights = WeightList::new();
        self.weights.weights_into(position, &mut weights)?;
        self.apply(&weights, &(0..self.component_count()), coefficients);
        Ok(())
    }

    /// # Panics
    /// When `values` is not of shape `[components.len(), ny, nx]`, or a component does not exist.
    fn evaluate_region_into(
        &self,
        region: PixelRegion,
        components: Range<usize>,
        mut values: ArrayViewMut3<'_, f64>,
    ) -> Result<(), FieldError> {
        let (nx, ny) = (region.shape().nx(), region.shape().ny());
        let planes = components.len();
        assert_eq!(values.dim(), (planes, ny, nx), "one plane per component");
        assert!(
            components.end <= self.component_count(),
            "components {components:?} were requested, but the field has {}",
            self.component_count()
        );
        let stretch = STRETCH.min(nx);
        let mut gathered = vec![0.0; stretch * planes];
        let (mut row, mut column, mut filled) = (0, 0, 0);
        let mut positions = (0..ny).flat_map(|row| (0..nx).map(move |column| region.position(column, row)));
        self.weights.weights_each(&mut positions, &mut |weights| {
            let sums = &mut gathered[filled * planes..(filled + 1) * planes];
            self.apply(weights, &components, sums);
            filled += 1;
            if filled == stretch || column + filled == nx {
                for plane in 0..planes {
                    for pixel in 0..filled {
                        values[[plane, row, column + pixel]] = gathered[pixel * planes + plane];
                    }
                }
                column += filled;
                filled = 0;
                if column == nx {
                    (row, column) = (row + 1, 0);
                }
            }
        })
    }

    fn weighted_nodes(&self) -> Option<&dyn WeightedNodes> {
        Some(self)
    }

    fn some_coefficients(&self, _: Option<FrameShape>) -> Array2<f64> {
        self.nodes.as_ref().clone()
    }

    fn bilinear_cells(&self, region: PixelRegion, error: ErrorLimit<'_>) -> BilinearCells {
        self.weights.bilinear_cells(self.nodes.view(), region, error)
    }
}

impl WeightedNodes for InterpolatedField {
    fn node_values(&self) -> Cow<'_, Array2<f64>> {
        Cow::Borrowed(&self.nodes)
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        self.weights.weights_into(position, weights)
    }

    fn weights_along_row(&self, start: (i64, i64), length: usize, visit: OnRun<'_>) -> Visited {
        self.weights.weights_along_row(start, length, visit)
    }
}

/// The result of [`FieldInterpolation::interpolate`](crate::FieldInterpolation::interpolate) for weights.
pub(crate) fn interpolated(
    samples: &SampleCoefficients,
    weights: impl FieldWeights + 'static,
) -> Interpolated {
    Ok(Arc::new(InterpolatedField::new(samples, Box::new(weights))?))
}
