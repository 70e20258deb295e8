//! A table of a field whose coefficients take long to evaluate.

use ndarray::{Array2, ArrayView1, ArrayViewMut2, Axis};
use psf_types::{
    BilinearCells, CoefficientField, ErrorLimit, FieldError, FrameShape, PixelRegion, Position, WeightedNodes,
};
use rayon::prelude::*;

use super::allowed_errors::CellError;
use super::checked_cells::Measure;

/// Patches of a region, in each of which a field is a polynomial of degree 4 in x times one in y, up to a
/// checked error.
///
/// A patch is divided into quarters while the field at its check points differs from the polynomial by
/// more than the limit allows. Small patches with larger errors, and patches where the field lacks
/// values, hold no polynomial: there the field itself is evaluated.
#[derive(Debug)]
pub(crate) struct SmoothTable {
    region: PixelRegion,
    /// The size of undivided patches, and the number of them in a row and in a column.
    step: [f64; 2],
    counts: [usize; 2],
    /// Undivided patches first, row by row.
    patches: Vec<Patch>,
    /// `[patch, node, component]`, for patches with a polynomial.
    values: Vec<f64>,
    width: usize,
    limit: CellError,
}

#[derive(Debug, Clone, Copy)]
struct Patch {
    low: [f64; 2],
    size: [f64; 2],
    content: Content,
}

#[derive(Debug, Clone, Copy)]
enum Content {
    /// The index of the first value.
    Polynomial(usize),
    /// Four patches from this index on.
    Quarters(usize),
    /// The field itself.
    Field,
}

/// Nodes along each axis of a patch, evenly spaced from edge to edge.
const ALONG: usize = 5;
const NODES: usize = ALONG * ALONG;
/// Check points, as fractions of the patch. Errors are largest near the edges.
const CHECKS: [[f64; 2]; 6] = [
    [0.11, 0.13],
    [0.88, 0.12],
    [0.12, 0.87],
    [0.89, 0.9],
    [0.38, 0.61],
    [0.62, 0.1],
];
/// The number of patches along each axis that are checked at least.
const FEWEST: f64 = 8.0;
/// Undivided patches have at least this size in pixels.
const SMALLEST: f64 = 16.0;
/// The largest number of divisions. Along a kink, more of them would not make the field smoother.
const MOST_DIVISIONS: u32 = 3;
/// Values fill at most about this memory.
const MOST_BYTES: usize = 1 << 28;

impl SmoothTable {
    /// Tabulates a field. `scale` is that of [`psf_types::BilinearCells::Unknown`].
    pub(crate) fn new(
        field: &dyn CoefficientField,
        region: PixelRegion,
        (scale, measure): (f64, Measure<'_>),
    ) -> Self {
        let shape = region.shape();
        let sides = [shape.nx(), shape.ny()].map(|pixels| (pixels as f64 - 1.0).max(1.0));
        let counts = sides.map(|side| {
            (side / scale.max(1.0))
                .ceil()
                .max(FEWEST)
                .min((side / SMALLEST).ceil())
        });
        let step = [sides[0] / counts[0], sides[1] / counts[1]];
        let counts = counts.map(|count| count as usize);
        let (x0, y0) = (region.x0() as f64, region.y0() as f64);
        let undivided = (0..counts[1]).flat_map(|row| (0..counts[0]).map(move |column| (column, row)));
        let patches = undivided.map(|(column, row)| Patch {
            low: [x0 + column as f64 * step[0], y0 + row as f64 * step[1]],
            size: step,
            content: Content::Field,
        });
        let mut table = Self {
            region,
            step,
            counts,
            patches: patches.collect(),
            values: Vec::new(),
            width: field.component_count(),
            limit: measure.limit,
        };
        let of_patch = NODES * table.width.max(1);
        let most = MOST_BYTES / (of_patch * size_of::<f64>());
        let (mut start, mut divisions) = (0, 0);
        while start < table.patches.len() && table.patches.len() <= most {
            let end = table.patches.len();
            let tried: Vec<(Array2<f64>, bool)> = table.patches[start..end]
                .par_iter()
                .map(|patch| patch.values(field, measure))
                .collect();
            for (index, (values, fits)) in (start..end).zip(tried) {
                let Patch { low, size, .. } = table.patches[index];
                table.patches[index].content = if fits {
                    table
                        .values
                        .extend(values.rows().into_iter().take(NODES).flatten());
                    Content::Polynomial(table.values.len() - NODES * table.width)
                } else if divisions < MOST_DIVISIONS && size[0].min(size[1]) > SMALLEST {
                    let first = table.patches.len();
                    let half = size.map(|side| 0.5 * side);
                    for (right, up) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
                        table.patches.push(Patch {
                            low: [low[0] + right * half[0], low[1] + up * half[1]],
                            size: half,
                            content: Content::Field,
                        });
                    }
                    Content::Quarters(first)
                } else {
                    Content::Field
                };
            }
            start = end;
            divisions += 1;
        }
        table
    }

    /// The limit of errors with which the table was made.
    pub(crate) fn limit(&self) -> CellError {
        self.limit
    }

    /// Writes the coefficients of the polynomial at a position. Returns false if there is none.
    fn write(&self, position: Position, values: &mut [f64]) -> bool {
        let at = [position.x(), position.y()];
        let first = [self.region.x0() as f64, self.region.y0() as f64];
        let mut root = [0; 2];
        for axis in 0..2 {
            let place = (at[axis] - first[axis]) / self.step[axis];
            if !(0.0..=self.counts[axis] as f64).contains(&place) {
                return false;
            }
            root[axis] = (place as usize).min(self.counts[axis] - 1);
        }
        let mut patch = &self.patches[root[1] * self.counts[0] + root[0]];
        loop {
            match patch.content {
                Content::Field => return false,
                Content::Quarters(first) => {
                    let upper = |axis: usize| at[axis] >= patch.low[axis] + 0.5 * patch.size[axis];
                    patch = &self.patches[first + usize::from(upper(0)) + 2 * usize::from(upper(1))];
                }
                Content::Polynomial(start) => {
                    let nodes = &self.values[start..start + NODES * self.width];
                    add_nodes(patch.place(at), nodes, values);
                    return true;
                }
            }
        }
    }
}

impl Patch {
    /// A position as fractions of the patch.
    fn place(&self, at: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| (at[axis] - self.low[axis]) / self.size[axis])
    }

    /// The coefficients at the nodes, `[node, component]`, followed by those at the check points, and
    /// whether the polynomial through the nodes fits.
    fn values(&self, field: &dyn CoefficientField, measure: Measure<'_>) -> (Array2<f64>, bool) {
        let nodes = (0..NODES).map(|i| [i % ALONG, i / ALONG].map(|n| n as f64 / (ALONG - 1) as f64));
        let at = nodes.chain(CHECKS).map(|place| {
            let [x, y] = [0, 1].map(|axis| self.low[axis] + place[axis] * self.size[axis]);
            Position::new(x, y).expect("a point of the region")
        });
        let at: Vec<Position> = at.collect();
        let mut values = Array2::zeros((at.len(), field.component_count()));
        field.evaluate_each_into(&at, values.view_mut());
        if values.iter().any(|v| !v.is_finite()) {
            return (values, false);
        }
        let mut difference = vec![0.0; values.ncols()];
        let all = values.as_slice().expect("row-major");
        let nodes = &all[..NODES * values.ncols()];
        let fits = CHECKS.iter().enumerate().all(|(i, &place)| {
            add_nodes(place, nodes, &mut difference);
            for (d, v) in difference.iter_mut().zip(values.index_axis(Axis(0), NODES + i)) {
                *d -= v;
            }
            (measure.of_size)(&difference) <= 1.0 && (measure.of_all)(&difference) <= 1.0
        });
        (values, fits)
    }
}

/// Writes the polynomial through the values at the nodes of a patch.
fn add_nodes(place: [f64; 2], nodes: &[f64], values: &mut [f64]) {
    values.fill(0.0);
    let [along_x, along_y] = place.map(weights);
    for (row, wy) in nodes.chunks_exact((ALONG * values.len()).max(1)).zip(along_y) {
        for (node, wx) in row.chunks_exact(values.len().max(1)).zip(along_x) {
            for (sum, value) in values.iter_mut().zip(node) {
                *sum += wx * wy * value;
            }
        }
    }
}

/// Lagrange's weights of evenly spaced nodes.
fn weights(place: f64) -> [f64; ALONG] {
    let at = place * (ALONG - 1) as f64;
    std::array::from_fn(|i| {
        let others = (0..ALONG).filter(|&j| j != i);
        others.map(|j| (at - j as f64) / (i as f64 - j as f64)).product()
    })
}

/// A field with its table, if there is one that is good enough.
#[derive(Debug)]
pub(crate) struct Tabulated<'a> {
    pub(crate) field: &'a dyn CoefficientField,
    pub(crate) table: Option<&'a SmoothTable>,
}

impl CoefficientField for Tabulated<'_> {
    fn component_count(&self) -> usize {
        self.field.component_count()
    }

    fn evaluate_into(&self, position: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        match self.table {
            Some(table) if table.write(position, coefficients) => Ok(()),
            _ => self.field.evaluate_into(position, coefficients),
        }
    }

    fn evaluate_each_into(&self, positions: &[Position], mut values: ArrayViewMut2<'_, f64>) {
        let Some(table) = self.table else {
            return self.field.evaluate_each_into(positions, values);
        };
        let mut found = vec![0.0; self.component_count()];
        let mut others = Vec::new();
        for (i, (&position, mut row)) in positions.iter().zip(values.outer_iter_mut()).enumerate() {
            if table.write(position, &mut found) {
                row.assign(&ArrayView1::from(&found));
            } else {
                others.push(i);
            }
        }
        let at: Vec<Position> = others.iter().map(|&i| positions[i]).collect();
        let mut of_field = Array2::zeros((at.len(), found.len()));
        self.field.evaluate_each_into(&at, of_field.view_mut());
        for (&i, row) in others.iter().zip(of_field.outer_iter()) {
            values.row_mut(i).assign(&row);
        }
    }

    fn some_coefficients(&self, frame: Option<FrameShape>) -> Array2<f64> {
        self.field.some_coefficients(frame)
    }

    fn weighted_nodes(&self) -> Option<&dyn WeightedNodes> {
        self.field.weighted_nodes()
    }

    fn bilinear_cells(&self, region: PixelRegion, error: ErrorLimit<'_>) -> BilinearCells {
        self.field.bilinear_cells(region, error)
    }
}
