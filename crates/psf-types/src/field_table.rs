//! Tables of coefficient fields: polynomials on a tree of patches.

use std::collections::HashMap;

use ndarray::{Array2, ArrayView1, ArrayView2, ArrayViewMut2, Axis, s};

use crate::frame::Position;

/// A table of a coefficient field: patches of an area, in each of which the field is a polynomial of
/// degree 4 in x times one in y.
///
/// A patch has 5 x 5 nodes, evenly spaced from edge to edge. The polynomial through their values is
/// compared with the field at six check points. While it does not fit, the patch is divided into
/// quarters. These are checks at points, not a proof.
#[derive(Debug, Clone)]
pub struct FieldTable {
    /// The first coordinates and the lengths of the area.
    low: [f64; 2],
    side: [f64; 2],
    /// The number of undivided patches in a row and in a column.
    counts: [usize; 2],
    /// Undivided patches first, row by row.
    patches: Vec<Patch>,
    /// The nodes of each patch with a polynomial, row by row.
    of_patches: Vec<u32>,
    nodes: Vec<Place>,
    /// `[node, component]`.
    values: Vec<f64>,
    width: usize,
}

/// A function that writes the coefficients of a field at positions, `[position, component]`.
pub type EvaluateField<'a, E> = &'a mut dyn FnMut(&[Position], ArrayViewMut2<'_, f64>) -> Result<(), E>;

/// The limits of a [`FieldTable`].
#[derive(Debug, Clone, Copy)]
pub struct TableLimits {
    /// The number of undivided patches in a row and in a column, from 1 to [`FieldTable::MOST_PATCHES`].
    pub counts: [usize; 2],
    /// The largest number of divisions of a patch, at most 16.
    pub most_divisions: u32,
    /// Patches with a side of at most this many pixels are not divided.
    pub smallest: f64,
    /// No patch is divided after the table has reached this number of values.
    pub most_values: usize,
}

/// A point of the area in steps of a fine lattice, on which all nodes lie.
type Place = [u32; 2];

#[derive(Debug, Clone, Copy)]
struct Patch {
    low: Place,
    /// In steps of the lattice.
    size: u32,
    content: Content,
}

#[derive(Debug, Clone, Copy)]
enum Content {
    /// The index in [`FieldTable::of_patches`] of the first node.
    Polynomial(usize),
    /// Four patches from this index on.
    Quarters(usize),
    /// No polynomial fits.
    Missing,
}

/// The steps of the lattice along the side of an undivided patch. The nodes of a patch that was divided
/// 16 times lie on the lattice.
const STEPS: u32 = 1 << 18;
/// Nodes along each axis of a patch.
const ALONG: usize = 5;
const NODES: usize = ALONG * ALONG;
/// Check points, as fractions of a patch. Errors are largest near the edges.
const CHECKS: [[f64; 2]; 6] = [
    [0.11, 0.13],
    [0.88, 0.12],
    [0.12, 0.87],
    [0.89, 0.9],
    [0.38, 0.61],
    [0.62, 0.1],
];

impl FieldTable {
    /// The number of check points of a patch.
    pub const CHECKS: usize = CHECKS.len();

    /// The largest number of undivided patches along an axis.
    pub const MOST_PATCHES: usize = 1024;

    /// Whether a table may have these numbers of undivided patches in a row and in a column.
    fn allows(counts: [usize; 2]) -> bool {
        counts.iter().all(|n| (1..=Self::MOST_PATCHES).contains(n))
    }

    /// Tabulates a field of `width` components over the area from the first to the second corner.
    ///
    /// `evaluate` writes the field at positions, `[position, component]`, and NaN where there is no
    /// value. It is called once for each number of divisions. `fits` receives the differences
    /// `[check, component]` between field and polynomial, with [`CHECKS`](Self::CHECKS) rows for each
    /// patch, and returns for each patch whether they are small enough. Differences may be NaN. Where no
    /// polynomial fits within the limits, the table has no values.
    ///
    /// # Errors
    /// The first error of `evaluate`.
    ///
    /// # Panics
    /// If limits are outside their ranges, or `fits` does not return one value for each patch.
    pub fn new<E>(
        corners: [Position; 2],
        width: usize,
        limits: TableLimits,
        evaluate: EvaluateField<'_, E>,
        fits: &mut dyn FnMut(ArrayView2<'_, f64>) -> Vec<bool>,
    ) -> Result<Self, E> {
        assert!(
            Self::allows(limits.counts) && limits.most_divisions <= 16,
            "limits of a table"
        );
        let mut table = Self::empty(corners, limits.counts, width);
        let mut known: HashMap<Place, u32> = HashMap::new();
        let (mut start, mut divisions) = (0, 0);
        while start < table.patches.len() {
            let end = table.patches.len();
            let (first, mut at) = (table.nodes.len(), Vec::new());
            for index in start..end {
                for place in table.patches[index].nodes() {
                    known.entry(place).or_insert_with(|| {
                        at.push(table.position(place.map(f64::from)));
                        table.nodes.push(place);
                        table.nodes.len() as u32 - 1
                    });
                }
            }
            for patch in &table.patches[start..end] {
                at.extend(CHECKS.map(|check| table.position(patch.inside(check))));
            }
            let mut found = Array2::zeros((at.len(), width));
            evaluate(&at, found.view_mut())?;
            let of_nodes = table.nodes.len() - first;
            table.values.extend(found.slice(s![..of_nodes, ..]).iter());
            let mut differences = found.slice_move(s![of_nodes.., ..]);
            let lists: Vec<[u32; NODES]> = table.patches[start..end]
                .iter()
                .map(|patch| patch.nodes().map(|place| known[&place]))
                .collect();
            let mut polynomial = vec![0.0; width];
            for (nodes, mut of_patch) in lists
                .iter()
                .zip(differences.axis_chunks_iter_mut(Axis(0), CHECKS.len()))
            {
                for (check, mut difference) in CHECKS.into_iter().zip(of_patch.outer_iter_mut()) {
                    table.write_polynomial(nodes, check, &mut polynomial);
                    difference -= &ArrayView1::from(&polynomial);
                }
            }
            let fitting = fits(differences.view());
            assert_eq!(fitting.len(), end - start, "one value for each patch");
            let may_divide = divisions < limits.most_divisions && table.values.len() < limits.most_values;
            for ((index, nodes), fits) in (start..end).zip(lists).zip(fitting) {
                table.patches[index].content = if fits {
                    table.of_patches.extend(nodes);
                    Content::Polynomial(table.of_patches.len() - NODES)
                } else if may_divide && table.smallest_side(&table.patches[index]) > limits.smallest {
                    table.divide(index)
                } else {
                    Content::Missing
                };
            }
            start = end;
            divisions += 1;
        }
        Ok(table)
    }

    /// The table with these nodes. None if they are not the nodes of a table with `counts` undivided
    /// patches.
    pub fn from_nodes(
        positions: &[Position],
        values: ArrayView2<'_, f64>,
        counts: [usize; 2],
    ) -> Option<Self> {
        if !Self::allows(counts) || values.nrows() != positions.len() {
            return None;
        }
        let [(x0, x1), (y0, y1)] = Position::bounds(positions);
        let corners = [Position::new(x0, y0).ok()?, Position::new(x1, y1).ok()?];
        let mut table = Self::empty(corners, counts, values.ncols());
        let mut known: HashMap<Place, u32> = HashMap::new();
        for (node, position) in positions.iter().enumerate() {
            let place = table.on_lattice(*position).map(|v| v.round() as u32);
            known.insert(place, u32::try_from(node).ok()?);
            table.nodes.push(place);
        }
        let mut index = 0;
        while index < table.patches.len() {
            let patch = table.patches[index];
            // This point is a node of the quarters alone.
            let eighth = patch.size / (2 * (ALONG as u32 - 1));
            table.patches[index].content = if eighth > 0 && known.contains_key(&patch.low.map(|v| v + eighth))
            {
                table.divide(index)
            } else {
                for place in patch.nodes() {
                    table.of_patches.push(*known.get(&place)?);
                }
                Content::Polynomial(table.of_patches.len() - NODES)
            };
            index += 1;
        }
        table.values = values.iter().copied().collect();
        Some(table)
    }

    /// A table whose patches are not divided and have no polynomials.
    fn empty([first, last]: [Position; 2], counts: [usize; 2], width: usize) -> Self {
        let (low, high) = ([first.x(), first.y()], [last.x(), last.y()]);
        let undivided =
            (0..counts[1] as u32).flat_map(|row| (0..counts[0] as u32).map(move |column| [column, row]));
        Self {
            low,
            side: [0, 1].map(|axis| {
                if high[axis] > low[axis] {
                    high[axis] - low[axis]
                } else {
                    1.0
                }
            }),
            counts,
            patches: undivided
                .map(|place| Patch {
                    low: place.map(|v| v * STEPS),
                    size: STEPS,
                    content: Content::Missing,
                })
                .collect(),
            of_patches: Vec::new(),
            nodes: Vec::new(),
            values: Vec::new(),
            width,
        }
    }

    fn divide(&mut self, index: usize) -> Content {
        let Patch { low, size, .. } = self.patches[index];
        let first = self.patches.len();
        let half = size / 2;
        for [right, up] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
            self.patches.push(Patch {
                low: [low[0] + right * half, low[1] + up * half],
                size: half,
                content: Content::Missing,
            });
        }
        Content::Quarters(first)
    }

    /// The number of steps of the lattice along an axis.
    fn steps(&self, axis: usize) -> f64 {
        (self.counts[axis] * STEPS as usize) as f64
    }

    fn position(&self, place: [f64; 2]) -> Position {
        let [x, y] = [0, 1].map(|axis| self.low[axis] + self.side[axis] * (place[axis] / self.steps(axis)));
        Position::new(x, y).expect("a point of the area")
    }

    fn on_lattice(&self, position: Position) -> [f64; 2] {
        let at = [position.x(), position.y()];
        [0, 1].map(|axis| (at[axis] - self.low[axis]) / self.side[axis] * self.steps(axis))
    }

    /// The shorter side of a patch in pixels.
    fn smallest_side(&self, patch: &Patch) -> f64 {
        let [x, y] = [0, 1].map(|axis| self.side[axis] * (f64::from(patch.size) / self.steps(axis)));
        x.min(y)
    }

    /// The first and the last coordinates of the area.
    pub fn bounds(&self) -> [(f64, f64); 2] {
        [0, 1].map(|axis| (self.low[axis], self.low[axis] + self.side[axis]))
    }

    /// The number of components.
    pub fn component_count(&self) -> usize {
        self.width
    }

    /// The positions of all nodes, and their values `[node, component]`.
    pub fn nodes(&self) -> (Vec<Position>, ArrayView2<'_, f64>) {
        let positions = self.nodes.iter().map(|place| self.position(place.map(f64::from)));
        let shape = (self.nodes.len(), self.width);
        let values = ArrayView2::from_shape(shape, &self.values).expect("all components of each node");
        (positions.collect(), values)
    }

    /// The middle of a patch in which no polynomial fits. None if there is a polynomial everywhere.
    pub fn missing(&self) -> Option<Position> {
        let missing = self
            .patches
            .iter()
            .find(|patch| matches!(patch.content, Content::Missing));
        missing.map(|patch| self.position(patch.inside([0.5, 0.5])))
    }

    /// The shorter side in pixels of the smallest patch that overlaps a rectangle.
    pub fn smallest_patch(&self, rectangle: [(f64, f64); 2]) -> f64 {
        let corner = |end: fn((f64, f64)) -> f64| Position::new(end(rectangle[0]), end(rectangle[1])).ok();
        let ends = (corner(|axis| axis.0), corner(|axis| axis.1));
        let (Some(first), Some(last)) = ends else {
            return self.side[0].min(self.side[1]);
        };
        let (first, last) = (self.on_lattice(first), self.on_lattice(last));
        let mut smallest = f64::INFINITY;
        let mut stack: Vec<usize> = (0..self.counts[0] * self.counts[1]).collect();
        while let Some(index) = stack.pop() {
            let patch = &self.patches[index];
            let overlaps = (0..2).all(|axis| {
                let low = f64::from(patch.low[axis]);
                low <= last[axis] && first[axis] <= low + f64::from(patch.size)
            });
            match patch.content {
                _ if !overlaps => {}
                Content::Quarters(first) => stack.extend(first..first + 4),
                _ => smallest = smallest.min(self.smallest_side(patch)),
            }
        }
        smallest
    }

    /// Writes the coefficients at a position. Returns false if the table has no values there.
    ///
    /// # Panics
    /// When there is not one coefficient per component.
    pub fn write(&self, position: Position, coefficients: &mut [f64]) -> bool {
        assert_eq!(coefficients.len(), self.width, "one coefficient per component");
        let at = self.on_lattice(position);
        let mut root = [0; 2];
        for axis in 0..2 {
            if !(0.0..=self.steps(axis)).contains(&at[axis]) {
                return false;
            }
            root[axis] = ((at[axis] / f64::from(STEPS)) as usize).min(self.counts[axis] - 1);
        }
        let mut patch = &self.patches[root[1] * self.counts[0] + root[0]];
        loop {
            match patch.content {
                Content::Missing => return false,
                Content::Quarters(first) => {
                    let upper = |axis: usize| at[axis] >= f64::from(patch.low[axis] + patch.size / 2);
                    patch = &self.patches[first + usize::from(upper(0)) + 2 * usize::from(upper(1))];
                }
                Content::Polynomial(start) => {
                    let place =
                        [0, 1].map(|axis| (at[axis] - f64::from(patch.low[axis])) / f64::from(patch.size));
                    self.write_polynomial(&self.of_patches[start..start + NODES], place, coefficients);
                    return true;
                }
            }
        }
    }

    /// Writes the polynomial through the values of a patch's nodes at a point, as fractions of the patch.
    fn write_polynomial(&self, nodes: &[u32], place: [f64; 2], sums: &mut [f64]) {
        sums.fill(0.0);
        let [along_x, along_y] = place.map(weights);
        for (row, wy) in nodes.chunks_exact(ALONG).zip(along_y) {
            for (&node, wx) in row.iter().zip(along_x) {
                let values = &self.values[node as usize * self.width..][..self.width];
                for (sum, value) in sums.iter_mut().zip(values) {
                    *sum += wx * wy * value;
                }
            }
        }
    }
}

impl Patch {
    /// The places of the nodes, row by row.
    fn nodes(&self) -> [Place; NODES] {
        let step = self.size / (ALONG as u32 - 1);
        std::array::from_fn(|i| {
            let [column, row] = [i % ALONG, i / ALONG].map(|n| n as u32);
            [self.low[0] + column * step, self.low[1] + row * step]
        })
    }

    /// A point, given as fractions of the patch.
    fn inside(&self, of: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| f64::from(self.low[axis]) + of[axis] * f64::from(self.size))
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

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: TableLimits = TableLimits {
        counts: [2, 1],
        most_divisions: 8,
        smallest: 1.0,
        most_values: 1 << 20,
    };

    fn corner(x: f64, y: f64) -> Position {
        Position::new(x, y).unwrap()
    }

    /// A table of the field `[f(x, y)]`, with errors of at most 1e-6 at the check points.
    fn table_of(f: &dyn Fn(f64, f64) -> f64) -> FieldTable {
        let corners = [corner(-3.0, 2.0), corner(97.0, 52.0)];
        let mut evaluate = |at: &[Position], mut values: ArrayViewMut2<'_, f64>| {
            for (p, mut row) in at.iter().zip(values.outer_iter_mut()) {
                row[0] = f(p.x(), p.y());
            }
            Ok::<(), ()>(())
        };
        let mut fits = |differences: ArrayView2<'_, f64>| {
            let patches = differences.axis_chunks_iter(Axis(0), FieldTable::CHECKS);
            patches
                .map(|patch| patch.iter().all(|d| d.abs() <= 1e-6))
                .collect()
        };
        FieldTable::new(corners, 1, LIMITS, &mut evaluate, &mut fits).unwrap()
    }

    fn value(table: &FieldTable, x: f64, y: f64) -> Option<f64> {
        let mut value = [f64::NAN];
        table.write(corner(x, y), &mut value).then_some(value[0])
    }

    #[test]
    fn polynomials_of_degree_4_need_no_division() {
        let f = |x: f64, y: f64| 1.0 + (x / 50.0).powi(4) * (y / 30.0).powi(3);
        let table = table_of(&f);
        assert_eq!(table.nodes().0.len(), 9 * 5);
        for (x, y) in [(-3.0, 2.0), (97.0, 52.0), (47.0, 9.3), (13.7, 51.9)] {
            assert!((value(&table, x, y).unwrap() - f(x, y)).abs() < 1e-13);
        }
        assert_eq!(value(&table, 97.1, 9.0), None);
        assert_eq!(value(&table, 9.0, 1.9), None);
    }

    #[test]
    fn patches_are_small_where_the_field_is_rough() {
        let f = |x: f64, y: f64| 1.0 / (1.0 + 0.02 * ((x - 20.0).powi(2) + (y - 30.0).powi(2)));
        let table = table_of(&f);
        assert!(table.missing().is_none());
        let (rough, smooth) = ([(19.0, 21.0), (29.0, 31.0)], [(90.0, 95.0), (5.0, 7.0)]);
        assert!(4.0 * table.smallest_patch(rough) <= table.smallest_patch(smooth));
        let errors = (0..1000).map(|i| {
            let (x, y) = (-3.0 + 0.1 * f64::from(i), 2.0 + f64::from(i * 37 % 500) * 0.1);
            (value(&table, x, y).unwrap() - f(x, y)).abs()
        });
        assert!(errors.fold(0.0, f64::max) < 3e-6);
    }

    #[test]
    fn nodes_make_the_same_table_again() {
        let table = table_of(&|x, y| (0.1 * x).sin() * (0.13 * y).cos());
        let (positions, values) = table.nodes();
        let again = FieldTable::from_nodes(&positions, values, [2, 1]).unwrap();
        for i in 0..500 {
            let (x, y) = (-3.0 + 0.2 * f64::from(i), 2.0 + f64::from(i * 37 % 500) * 0.1);
            let (a, b) = (value(&table, x, y).unwrap(), value(&again, x, y).unwrap());
            assert!((a - b).abs() < 1e-14, "{x} {y}: {a} {b}");
        }
        let fewer = values.slice(s![1.., ..]);
        assert!(FieldTable::from_nodes(&positions[1..], fewer, [2, 1]).is_none());
        assert!(FieldTable::from_nodes(&positions, values, [3, 1]).is_none());
    }

    #[test]
    fn a_step_has_no_polynomial() {
        let table = table_of(&|x, _| f64::from(u8::from(x > 31.3)));
        let missing = table.missing().unwrap();
        assert!((missing.x() - 31.3).abs() < 2.0, "{missing}");
        assert!((value(&table, 80.0, 20.0).unwrap() - 1.0).abs() < 1e-14);
    }
}
