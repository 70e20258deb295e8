//! Interpolators that are defined on a tree of cells: they give the values at the cells' corners, which
//! are bilinear in each cell.

use std::collections::{HashMap, VecDeque};
use std::num::NonZeroUsize;
use std::ops::Range;

use ndarray::{Array2, ArrayView2};
use psf_types::{
    BilinearCells, ErrorLimit, FieldError, OutsidePolicy, PixelRegion, Position, SamplePositions,
};

use crate::error::CoeffFieldError;
use crate::geometry::{Hull, Point, Points, Row, covered_until, pixel_ranges, query, range};
use crate::interpolation::{
    FieldWeights, OnRun, Visited, WeightList, add_weight, admit, check_rows, in_runs,
};
use crate::lattice_values::{Middle, NodeValues};
use crate::search_tree::SearchTree;

/// Weights that are bilinear in the cells of a tree.
///
/// The tree covers the samples and the frame, and under the policy extend also the surroundings. A
/// cell is halved until its sides are at most [`RESOLUTION`] times the distance from its middle to the
/// third nearest sample, and no longer than the distance from a sample in it to the next sample.
///
/// Nodes are the corners of cells. But a corner of small cells on an edge of a larger cell is no node:
/// it has the value of this edge. So the field is continuous.
///
/// Nodes do not have the interpolator's own values, but those of [`NodeValues`].
///
/// # Outside the tree
/// * Nearest: the value at the nearest position of the tree.
/// * Extend: the formula of the nearest cell continues, linear in each coordinate.
/// * Error: an error, as everywhere outside the hull of the samples.
#[derive(Debug)]
pub(crate) struct Lattice {
    cells: Vec<Cell>,
    /// For each corner, its range of the list `weights`.
    corners: Vec<Range<usize>>,
    /// Nodes and their weights.
    weights: WeightList,
    values: NodeValues,
    hull: Hull,
}

/// A rectangle of the tree.
#[derive(Debug, Clone)]
struct Cell {
    /// First and last coordinate along each axis.
    sides: [(f64, f64); 2],
    content: Content,
}

#[derive(Debug, Clone)]
enum Content {
    /// Halved at a coordinate of an axis. The halves are the cells from this index on.
    Halved { axis: usize, at: f64, first: usize },
    /// The indices of the corners: those of lower y first, and of these the one of lower x first.
    Leaf([usize; 4]),
}

/// The sides of cells are at most this fraction of the distance to the third nearest sample.
const RESOLUTION: f64 = 0.8;
const NEIGHBOURS: NonZeroUsize = NonZeroUsize::new(3).expect("3 is not 0");
/// A sample counts as in a cell up to this fraction of the cell's longer side away. Otherwise it could
/// be left with corners on edges of larger cells, which are no nodes.
const NEAR: f64 = 0.25;
/// Under the policy extend, the tree reaches beyond the samples and the frame by this multiple of
/// their extent, which is the larger of their width and height.
const BEYOND: f64 = 0.5;

impl Lattice {
    /// Puts an interpolator on a tree. `weights` writes the interpolator's weights at a point
    /// under the policy, or under [`OutsidePolicy::Nearest`] if the policy is an error.
    pub(crate) fn new(
        positions: &SamplePositions,
        points: &Points,
        outside: OutsidePolicy,
        mut weights: impl FnMut(Point, &mut WeightList),
    ) -> Result<Self, CoeffFieldError> {
        let mut sides = [0, 1].map(|axis| range(&points.points, axis));
        if let Some(frame) = positions.field() {
            for ((low, high), (first, last)) in sides.iter_mut().zip(pixel_ranges(frame.region())) {
                (*low, *high) = (low.min(first), high.max(last));
            }
        }
        let extent = sides.iter().map(|(low, high)| high - low).fold(0.0, f64::max);
        let extent = if extent > 0.0 { extent } else { 1.0 };
        for (low, high) in &mut sides {
            // Samples on a line along an axis get a tree of some width. Under the policy extend, the
            // tree reaches far beyond the samples, where its cells are large.
            let beyond = match outside {
                OutsidePolicy::Extend => BEYOND * extent,
                _ if low < high => 0.0,
                _ => 0.5 * extent,
            };
            (*low, *high) = (*low - beyond, *high + beyond);
        }
        let mut lattice = Self {
            cells: vec![Cell {
                sides,
                content: Content::Leaf([0; 4]),
            }],
            corners: Vec::new(),
            weights: Vec::new(),
            values: NodeValues::default(),
            hull: Hull::new(points, outside)?,
        };
        lattice.divide(points, &SearchTree::new(points)?);
        let at = lattice.number_corners();
        let longer_edges = lattice.longer_edges(&at);
        let number_node = |corner: usize| {
            let mut own = WeightList::new();
            weights(at[corner], &mut own);
            lattice.values.own.push(own);
            vec![(lattice.values.own.len() - 1, 1.0)]
        };
        for list in joined(&longer_edges, &at, number_node) {
            let start = lattice.weights.len();
            lattice.weights.extend(list);
            lattice.corners.push(start..lattice.weights.len());
        }
        let mut middles = Vec::new();
        for (cell, corners) in lattice.leaves() {
            let middle = cell.sides.map(|(low, high)| f64::midpoint(low, high));
            let (mut own, mut of_nodes) = (WeightList::new(), WeightList::new());
            weights(middle, &mut own);
            lattice.bilinear(middle, (&cell.sides, corners), &mut of_nodes);
            let lists = corners
                .iter()
                .map(|&corner| &lattice.weights[lattice.corners[corner].clone()]);
            // Other corners lie on edges of larger cells.
            let nodes = lists.filter_map(|list| match list {
                [(node, _)] => Some(*node),
                _ => None,
            });
            middles.push(Middle {
                own,
                of_nodes,
                nodes: nodes.collect(),
            });
        }
        lattice.values.middles = middles;
        for &p in &points.points {
            let mut weights = WeightList::new();
            lattice.bilinear(p, lattice.leaf(p), &mut weights);
            lattice.values.at_samples.push(weights);
        }
        Ok(lattice)
    }

    /// Divides cells until they are small enough.
    fn divide(&mut self, points: &Points, tree: &SearchTree) {
        let next: Vec<f64> = (0..points.len())
            .map(|sample| {
                let square = tree.square_of_kth(points.points[sample], NonZeroUsize::MIN, Some(sample));
                square.map_or(f64::INFINITY, f64::sqrt)
            })
            .collect();
        let everything: Vec<usize> = (0..points.len()).collect();
        let mut left = VecDeque::from([(0, everything)]);
        while let Some((index, samples)) = left.pop_front() {
            let sides = self.cells[index].sides;
            let [width, height] = sides.map(|(low, high)| high - low);
            let (longer, axis) = if width >= height { (width, 0) } else { (height, 1) };
            let is_near = |p: Point| {
                (0..2).all(|axis| {
                    let (low, high) = sides[axis];
                    low - NEAR * longer <= p[axis] && p[axis] <= high + NEAR * longer
                })
            };
            let samples: Vec<usize> = samples
                .into_iter()
                .filter(|&sample| is_near(points.points[sample]))
                .collect();
            let middle = sides.map(|(low, high)| f64::midpoint(low, high));
            let third = tree.square_of_kth(middle, NEIGHBOURS, None).map(f64::sqrt);
            // A single sample has no distance to others.
            let spacing = third.filter(|_| points.len() > 1).unwrap_or(f64::INFINITY);
            let is_fine =
                longer <= RESOLUTION * spacing && samples.iter().all(|&sample| longer <= next[sample]);
            let (at, (low, high)) = (middle[axis], sides[axis]);
            // A side as short as the rounding of coordinates cannot be halved.
            if is_fine || at <= low || at >= high {
                continue;
            }
            let first = self.cells.len();
            self.cells[index].content = Content::Halved { axis, at, first };
            for (half, side) in [(low, at), (at, high)].into_iter().enumerate() {
                let mut sides = sides;
                sides[axis] = side;
                self.cells.push(Cell {
                    sides,
                    content: Content::Leaf([0; 4]),
                });
                left.push_back((first + half, samples.clone()));
            }
        }
    }

    fn leaves(&self) -> impl Iterator<Item = (&Cell, &[usize; 4])> {
        self.cells.iter().filter_map(|cell| match &cell.content {
            Content::Leaf(corners) => Some((cell, corners)),
            Content::Halved { .. } => None,
        })
    }

    /// Numbers the corners of the leaves. Returns their points.
    fn number_corners(&mut self) -> Vec<Point> {
        let (mut numbers, mut at) = (HashMap::new(), Vec::new());
        for cell in &mut self.cells {
            if let Content::Leaf(corners) = &mut cell.content {
                let [x, y] = cell.sides;
                for (corner, point) in
                    corners
                        .iter_mut()
                        .zip([[x.0, y.0], [x.1, y.0], [x.0, y.1], [x.1, y.1]])
                {
                    *corner = *numbers.entry(point.map(f64::to_bits)).or_insert_with(|| {
                        at.push(point);
                        at.len() - 1
                    });
                }
            }
        }
        at
    }

    /// For each corner inside the edge of a cell, the two ends of this edge. Edges on either side
    /// of a line may overlap without being equal. The field is linear along each of them, so it is
    /// linear along all of them together, and the ends are those of the whole.
    fn longer_edges(&self, at: &[Point]) -> Vec<Option<[usize; 2]>> {
        let mut ends = vec![None; at.len()];
        for axis in 0..2 {
            // The corners, line by line, and the place of each corner among them.
            let mut order: Vec<usize> = (0..at.len()).collect();
            order.sort_unstable_by(|&a, &b| {
                let along = |p: Point| [p[1 - axis], p[axis]];
                let (a, b) = (along(at[a]), along(at[b]));
                a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]))
            });
            let mut places = vec![0; at.len()];
            for (place, &corner) in order.iter().enumerate() {
                places[corner] = place;
            }
            let edges = self.leaves().flat_map(|(_, &[a, b, c, d])| match axis {
                0 => [(a, b), (c, d)],
                _ => [(a, c), (b, d)],
            });
            let edges = edges.map(|(from, to)| (places[from], places[to]));
            let mut edges: Vec<(usize, usize)> = edges.filter(|&(from, to)| to > from + 1).collect();
            edges.sort_unstable();
            let mut joined: Vec<(usize, usize)> = Vec::new();
            for (from, to) in edges {
                match joined.last_mut() {
                    Some(last) if from < last.1 => last.1 = last.1.max(to),
                    _ => joined.push((from, to)),
                }
            }
            for (from, to) in joined {
                for &corner in &order[from + 1..to] {
                    ends[corner] = Some([order[from], order[to]]);
                }
            }
        }
        ends
    }

    /// The leaf with a point, or the one nearest to it. A point on an edge belongs to the leaf with
    /// the larger coordinates.
    fn leaf(&self, p: Point) -> (&[(f64, f64); 2], &[usize; 4]) {
        let mut cell = &self.cells[0];
        loop {
            match &cell.content {
                Content::Leaf(corners) => return (&cell.sides, corners),
                Content::Halved { axis, at, first } => {
                    cell = &self.cells[first + usize::from(p[*axis] >= *at)];
                }
            }
        }
    }

    /// The point at which weights are computed: the point itself under the policy extend, otherwise
    /// the nearest one of the tree.
    fn place(&self, p: Point) -> Point {
        if self.hull.outside == OutsidePolicy::Extend {
            return p;
        }
        let sides = self.cells[0].sides;
        [0, 1].map(|axis| p[axis].clamp(sides[axis].0, sides[axis].1))
    }

    fn is_admitted(&self, p: Point) -> bool {
        self.hull.outside != OutsidePolicy::Error || self.hull.covers(p)
    }

    /// Writes the weights at a point, with the formula of a leaf.
    fn bilinear(
        &self,
        p: Point,
        (sides, corners): (&[(f64, f64); 2], &[usize; 4]),
        weights: &mut WeightList,
    ) {
        let part = |axis: usize| {
            let (low, high) = sides[axis];
            if low < high {
                (p[axis] - low) / (high - low)
            } else {
                0.0
            }
        };
        let (s, t) = (part(0), part(1));
        let products = [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t];
        weights.clear();
        for (&corner, product) in corners.iter().zip(products).filter(|&(_, w)| w != 0.0) {
            let list = self.weights[self.corners[corner].clone()].iter();
            let list = list.map(|&(sample, weight)| (sample, product * weight));
            if weights.is_empty() {
                weights.extend(list);
            } else {
                list.for_each(|(sample, weight)| add_weight(weights, sample, weight));
            }
        }
    }
}

/// The part of a cell's side in a range. `None` if the two share no more than an end. If the range
/// is a single coordinate where two cells meet, it belongs to the second cell. The end of the tree
/// belongs to its last cell.
fn overlap((low, high): (f64, f64), range: (f64, f64), tree: (f64, f64)) -> Option<(f64, f64)> {
    let (first, last) = (low.max(range.0), high.min(range.1));
    let is_point = range.0 == range.1 && first == last && (first < high || high == tree.1);
    (first < last || is_point).then_some((first, last))
}

/// The weights at each corner. A corner inside a longer edge has the weights of this edge, from one
/// end to the other. `own` returns the weights at any other corner.
fn joined(
    longer_edges: &[Option<[usize; 2]>],
    at: &[Point],
    mut own: impl FnMut(usize) -> WeightList,
) -> Vec<WeightList> {
    let mut lists: Vec<Option<WeightList>> = vec![None; at.len()];
    // The ends of an edge may themselves lie inside an edge, across to the first. They are computed
    // before it.
    let mut waiting: Vec<usize> = (0..at.len()).rev().collect();
    let mut is_asked = vec![false; at.len()];
    while let Some(&corner) = waiting.last() {
        if lists[corner].is_none() {
            lists[corner] = match longer_edges[corner] {
                None => Some(own(corner)),
                Some(ends) => match ends.map(|end| lists[end].as_ref()) {
                    [Some(first), Some(last)] => {
                        let points = [ends[0], corner, ends[1]].map(|corner| at[corner]);
                        Some(between(points, first, last))
                    }
                    // Where rounding makes edges end on each other, one corner gets its own
                    // weights.
                    _ if is_asked[corner] => Some(own(corner)),
                    lists => {
                        is_asked[corner] = true;
                        let missing = ends.into_iter().zip(lists).filter(|(_, list)| list.is_none());
                        waiting.extend(missing.map(|(end, _)| end));
                        continue;
                    }
                },
            };
        }
        waiting.pop();
    }
    lists.into_iter().flatten().collect()
}

/// The weights at the second of three points on a line, from those at the other two.
fn between([from, p, to]: [Point; 3], first: &WeightList, last: &WeightList) -> WeightList {
    let axis = usize::from(from[0] == to[0]);
    let part = (p[axis] - from[axis]) / (to[axis] - from[axis]);
    let mut list = WeightList::new();
    for (of_end, part) in [(first, 1.0 - part), (last, part)] {
        for &(sample, weight) in of_end {
            add_weight(&mut list, sample, part * weight);
        }
    }
    list
}

impl FieldWeights for Lattice {
    fn sample_count(&self) -> usize {
        self.values.at_samples.len()
    }

    fn node_count(&self) -> usize {
        self.values.own.len()
    }

    fn node_values(&self, sample_values: ArrayView2<'_, f64>) -> Result<Array2<f64>, CoeffFieldError> {
        check_rows(self.sample_count(), sample_values)?;
        Ok(self.values.at_nodes(sample_values))
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        let p = query(position)?;
        admit(self.is_admitted(p), self.hull.outside, position)?;
        let at = self.place(p);
        self.bilinear(at, self.leaf(at), weights);
        Ok(())
    }

    fn bilinear_cells(
        &self,
        _: ArrayView2<'_, f64>,
        region: PixelRegion,
        _: ErrorLimit<'_>,
    ) -> BilinearCells {
        let ranges = pixel_ranges(region);
        let tree = self.cells[0].sides;
        // Beyond the tree, the leaves at its edge continue.
        let in_tree = [0, 1].map(|axis| {
            let clamp = |v: f64| v.clamp(tree[axis].0, tree[axis].1);
            (clamp(ranges[axis].0), clamp(ranges[axis].1))
        });
        let mut lines = vec![tree[1].0, tree[1].1];
        let (mut leaves, mut left) = (Vec::new(), vec![0]);
        while let Some(index) = left.pop() {
            let cell = &self.cells[index];
            let overlap = [0, 1].map(|axis| overlap(cell.sides[axis], in_tree[axis], tree[axis]));
            let [Some(x), Some(y)] = overlap else { continue };
            match &cell.content {
                Content::Halved { axis, at, first } => {
                    if *axis == 1 {
                        lines.push(*at);
                    }
                    left.extend(*first..first + 2);
                }
                Content::Leaf(_) => leaves.push([x, y]),
            }
        }
        if in_tree == ranges && self.hull.outside != OutsidePolicy::Error {
            return BilinearCells::Rectangles(leaves);
        }
        lines.retain(|&line| ranges[1].0 <= line && line <= ranges[1].1);
        lines.sort_by(f64::total_cmp);
        lines.dedup();
        BilinearCells::Bands(lines)
    }

    /// Visits one run for each leaf that the row crosses.
    fn weights_along_row(&self, start: (i64, i64), length: usize, visit: OnRun<'_>) -> Visited {
        let row = Row::new(start, length);
        let is_admitted = |column| self.is_admitted(row.point(column));
        let weights_into =
            |column, weights: &mut WeightList| self.weights_into(row.position(column), weights);
        let end_of = |column| {
            let (p, tree) = (row.point(column), self.cells[0].sides[0]);
            let is_clamped = self.hull.outside != OutsidePolicy::Extend;
            let until = match self.leaf(self.place(p)).0[0].1 {
                _ if is_clamped && p[0] < tree.0 => tree.0,
                // The last leaf of the row: its edge belongs to it.
                end if end == tree.1 && is_clamped && p[0] <= end => end.floor() + 1.0,
                end if end == tree.1 => f64::INFINITY,
                end => end,
            };
            covered_until(column, row.first_from(until, column), is_admitted)
        };
        in_runs(row, weights_into, end_of, visit)
    }
}
