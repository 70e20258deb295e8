//! The mesh of cells between the samples of an adaptive sampling.

use std::collections::{BTreeSet, HashSet};

use psf_types::{FrameShape, Position};

/// A point of the lattice. The lattice is a regular grid of points, fine enough for all samples
/// that the mesh may ever have. Nodes are ordered by y, then x.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Node {
    pub(crate) y: u64,
    pub(crate) x: u64,
}

/// A rectangle of the lattice: its first and last lattice point along y and x.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Cell {
    pub(crate) y: (u64, u64),
    pub(crate) x: (u64, u64),
}

/// The lattice along one axis of the field.
#[derive(Debug, Clone, Copy)]
struct Axis {
    /// Pixel coordinate of the last lattice point. The first is at 0.
    last_px: f64,
    /// Number of cells of the starting grid along this axis.
    cells: u64,
    /// Lattice steps in a cell of the starting grid.
    steps: u64,
    /// Lattice steps along the narrowest cell that may still be halved.
    halvable: u64,
}

/// Rectangular cells that cover the field. Their corners are the samples.
///
/// Cells are halved along one axis or both. The mesh stays balanced: an edge holds at most one
/// sample between its ends, at its middle. Such a "hanging node" exists where only the cell on the
/// other side of the edge is halved.
#[derive(Debug, Clone)]
pub(crate) struct Mesh {
    axes: [Axis; 2],
    max_aspect: f64,
    leaves: BTreeSet<Cell>,
    nodes: HashSet<Node>,
}

/// The axes along which a cell is halved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Halving {
    pub(crate) x: bool,
    pub(crate) y: bool,
}

impl Halving {
    pub(crate) fn any(self) -> bool {
        self.x || self.y
    }
}

impl Axis {
    fn new(pixels: usize, samples: usize, min_cell_px: f64) -> Self {
        let last_px = (pixels - 1) as f64;
        if pixels == 1 {
            // One lattice point: the cells have no extent along this axis and are never halved
            // along it.
            return Self {
                last_px,
                cells: 1,
                steps: 0,
                halvable: 1,
            };
        }
        let room = (last_px / min_cell_px).floor().max(1.0) as u64;
        let cells = (samples as u64 - 1).min(room);
        let mut levels = 0u32;
        while last_px / (cells << (levels + 1)) as f64 >= min_cell_px {
            levels += 1;
        }
        // The smallest cells are four steps wide. The lattice thus has the midpoints of their
        // edges, and the quarter points that the balancing checks.
        Self {
            last_px,
            cells,
            steps: 4 << levels,
            halvable: 8,
        }
    }

    fn coordinate(self, index: u64) -> f64 {
        if self.steps == 0 {
            0.0
        } else {
            self.last_px * index as f64 / (self.cells * self.steps) as f64
        }
    }

    fn can_halve(self, (low, high): (u64, u64)) -> bool {
        high - low >= self.halvable
    }
}

fn middle((low, high): (u64, u64)) -> u64 {
    low.midpoint(high)
}

impl Cell {
    /// The point at `column`, `row` of the cell's 3 x 3 grid of corners, edge midpoints and centre.
    pub(crate) fn node(self, column: usize, row: usize) -> Node {
        let pick = |ends: (u64, u64), i: usize| [ends.0, middle(ends), ends.1][i];
        Node {
            x: pick(self.x, column),
            y: pick(self.y, row),
        }
    }

    pub(crate) fn corners(self) -> [Node; 4] {
        [(0, 0), (2, 0), (0, 2), (2, 2)].map(|(column, row)| self.node(column, row))
    }

    fn halves(self, halving: Halving) -> Vec<Self> {
        let parts = |ends: (u64, u64), halve: bool| {
            if halve {
                vec![(ends.0, middle(ends)), (middle(ends), ends.1)]
            } else {
                vec![ends]
            }
        };
        let columns = parts(self.x, halving.x);
        parts(self.y, halving.y)
            .into_iter()
            .flat_map(|y| columns.iter().map(move |&x| Self { y, x }))
            .collect()
    }
}

impl Mesh {
    /// The starting grid of `start` samples along x and y. Its outermost samples lie on the pixel
    /// centres of the field's corners. It has fewer samples if its cells would otherwise be smaller
    /// than `min_cell_px`.
    pub(crate) fn new(field: FrameShape, start: [usize; 2], min_cell_px: f64, max_aspect: f64) -> Self {
        let axes = [
            Axis::new(field.nx(), start[0], min_cell_px),
            Axis::new(field.ny(), start[1], min_cell_px),
        ];
        let ends = |axis: Axis| (0..axis.cells).map(move |i| (i * axis.steps, (i + 1) * axis.steps));
        let leaves: BTreeSet<Cell> = ends(axes[1])
            .flat_map(|y| ends(axes[0]).map(move |x| Cell { y, x }))
            .collect();
        let nodes = leaves.iter().flat_map(|c| c.corners()).collect();
        Self {
            axes,
            max_aspect,
            leaves,
            nodes,
        }
    }

    /// The cells, in a fixed order.
    pub(crate) fn leaves(&self) -> &BTreeSet<Cell> {
        &self.leaves
    }

    #[cfg(test)]
    fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// The samples, ordered by y, then x.
    pub(crate) fn sorted_nodes(&self) -> Vec<Node> {
        let mut nodes: Vec<_> = self.nodes.iter().copied().collect();
        nodes.sort_unstable();
        nodes
    }

    /// Nodes of the lattice that divide each axis into `intervals` parts of equal width, or up to twice
    /// as many. Fewer if the lattice has fewer. They are ordered by y, then x.
    pub(crate) fn lattice(&self, intervals: u64) -> Vec<Node> {
        let along = |axis: Axis| {
            let last = axis.cells * axis.steps;
            let mut step = 1;
            while axis.steps.is_multiple_of(2 * step) && last / (2 * step) >= intervals {
                step *= 2;
            }
            (0..=last / step).map(move |i| i * step)
        };
        let rows = along(self.axes[1]);
        rows.flat_map(|y| along(self.axes[0]).map(move |x| Node { y, x }))
            .collect()
    }

    /// The place of a position in a cell, from 0 to 1 along x and y. `None` if it lies outside.
    pub(crate) fn place_in(&self, cell: Cell, position: Position) -> Option<[f64; 2]> {
        let along = |axis: Axis, ends: (u64, u64), at: f64| {
            let (low, high) = (axis.coordinate(ends.0), axis.coordinate(ends.1));
            let place = if high > low {
                (at - low) / (high - low)
            } else {
                0.0
            };
            (low <= at && at <= high).then_some(place)
        };
        let x = along(self.axes[0], cell.x, position.x())?;
        Some([x, along(self.axes[1], cell.y, position.y())?])
    }

    /// The position of a node on the field.
    pub(crate) fn position(&self, node: Node) -> Position {
        let position = Position::new(self.axes[0].coordinate(node.x), self.axes[1].coordinate(node.y));
        position.expect("coordinates on a frame are finite")
    }

    /// The axes of `wanted` along which the cell can be halved. If there is only one such axis and
    /// the cell's halves would be too long, adds the other axis if it can be halved too.
    pub(crate) fn allowed(&self, cell: Cell, wanted: Halving) -> Halving {
        let size =
            |i: usize, ends: (u64, u64)| self.axes[i].coordinate(ends.1) - self.axes[i].coordinate(ends.0);
        let (width, height) = (size(0, cell.x), size(1, cell.y));
        let (can_x, can_y) = (self.axes[0].can_halve(cell.x), self.axes[1].can_halve(cell.y));
        let (x, y) = (wanted.x && can_x, wanted.y && can_y);
        Halving {
            x: x || (y && can_x && width > self.max_aspect * height / 2.0),
            y: y || (x && can_y && height > self.max_aspect * width / 2.0),
        }
    }

    /// Halves the given cells, and then other cells until the mesh is balanced.
    pub(crate) fn halve(&mut self, cells: impl IntoIterator<Item = (Cell, Halving)>) {
        for (cell, halving) in cells {
            self.replace(cell, halving);
        }
        loop {
            let unbalanced: Vec<_> = self
                .leaves
                .iter()
                .map(|&cell| (cell, self.allowed(cell, self.crowded(cell))))
                .filter(|(_, halving)| halving.any())
                .collect();
            if unbalanced.is_empty() {
                return;
            }
            for (cell, halving) in unbalanced {
                self.replace(cell, halving);
            }
        }
    }

    fn replace(&mut self, cell: Cell, halving: Halving) {
        self.leaves.remove(&cell);
        for part in cell.halves(halving) {
            self.leaves.insert(part);
            self.nodes.extend(part.corners());
        }
    }

    /// The axes along which an edge of the cell holds samples other than its ends and its middle.
    fn crowded(&self, cell: Cell) -> Halving {
        let quarters = |ends: (u64, u64)| [(ends.0, middle(ends)), (middle(ends), ends.1)].map(middle);
        let at = |x, y| self.nodes.contains(&Node { y, x });
        let crowded = |ends: (u64, u64), is_node: &dyn Fn(u64) -> bool| {
            ends.1 > ends.0 && quarters(ends).into_iter().any(is_node)
        };
        Halving {
            x: crowded(cell.x, &|x| at(x, cell.y.0) || at(x, cell.y.1)),
            y: crowded(cell.y, &|y| at(cell.x.0, y) || at(cell.x.1, y)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOTH: Halving = Halving { x: true, y: true };

    fn mesh(nx: usize, ny: usize, start: usize, aspect: f64) -> Mesh {
        Mesh::new(FrameShape::new(nx, ny).unwrap(), [start, start], 1.0, aspect)
    }

    fn area(mesh: &Mesh) -> f64 {
        let size = |i: usize, e: (u64, u64)| mesh.axes[i].coordinate(e.1) - mesh.axes[i].coordinate(e.0);
        mesh.leaves.iter().map(|c| size(0, c.x) * size(1, c.y)).sum()
    }

    #[test]
    fn the_starting_grid_reaches_the_corners_exactly() {
        let mesh = mesh(9232, 9216, 5, 2.0);
        assert_eq!((mesh.node_count(), mesh.leaves.len()), (25, 16));
        let nodes = mesh.sorted_nodes();
        let at = |i: usize| mesh.position(nodes[i]);
        assert_eq!((at(0).x(), at(0).y()), (0.0, 0.0));
        assert_eq!((at(4).x(), at(4).y()), (9231.0, 0.0));
        assert_eq!((at(24).x(), at(24).y()), (9231.0, 9215.0));
    }

    #[test]
    fn repeated_halving_of_a_corner_keeps_the_balance_and_ends_at_a_pixel() {
        let mut mesh = mesh(130, 130, 3, 2.0);
        let mut rounds = 0;
        loop {
            let corner = *mesh.leaves.iter().next().unwrap();
            let halving = mesh.allowed(corner, BOTH);
            if !halving.any() {
                break;
            }
            mesh.halve([(corner, halving)]);
            rounds += 1;
            assert!((area(&mesh) - 129.0 * 129.0).abs() < 1e-9, "cells tile the field");
            assert!(mesh.leaves.iter().all(|&c| !mesh.crowded(c).any()), "balanced");
        }
        // 64.5 pixels halved 6 times is 1.008.
        assert_eq!(rounds, 6);
        assert!(
            mesh.node_count() < 120,
            "{} nodes: balancing must not refine the whole mesh",
            mesh.node_count()
        );
    }

    #[test]
    fn cells_keep_their_aspect() {
        let mut mesh = mesh(101, 101, 2, 2.0);
        let whole = *mesh.leaves.iter().next().unwrap();
        let x_alone = Halving { x: true, y: false };
        assert_eq!(mesh.allowed(whole, x_alone), x_alone);
        mesh.halve([(whole, x_alone)]);
        let half = *mesh.leaves.iter().next().unwrap();
        assert_eq!(
            mesh.allowed(half, x_alone),
            BOTH,
            "a cell of 1/4 by 1 would be too long"
        );
    }

    #[test]
    fn a_frame_of_one_row_is_a_line_of_cells() {
        let mut mesh = mesh(33, 1, 5, 2.0);
        assert_eq!((mesh.node_count(), mesh.leaves.len()), (5, 4));
        let first = *mesh.leaves.iter().next().unwrap();
        let halving = mesh.allowed(first, BOTH);
        assert_eq!(halving, Halving { x: true, y: false });
        mesh.halve([(first, halving)]);
        assert_eq!((mesh.node_count(), mesh.leaves.len()), (6, 5));
    }
}
