//! Where to start looking for a triangle.

use std::collections::VecDeque;

use spade::handles::FixedVertexHandle;
use spade::{HasPosition, HintGenerator, Point2, Triangulation};

/// A table of nearby vertices over a square grid of cells.
///
/// The hint is a function of the position alone (spade's own generators remember the last lookup, so that a result
/// could depend, in its last bit, on what was asked before), needs no lock between threads, and costs constant time.
#[derive(Debug, Clone, Default)]
pub(crate) struct GridHints {
    origin: [f64; 2],
    per_pixel: [f64; 2],
    side: usize,
    /// A vertex in or near each cell, row by row.
    vertices: Vec<u32>,
}

const EMPTY: u32 = u32::MAX;

impl GridHints {
    fn cell(&self, position: Point2<f64>) -> usize {
        // A float to integer cast saturates; NaN becomes 0.
        let index = |v: f64, axis: usize| {
            (((v - self.origin[axis]) * self.per_pixel[axis]) as usize).min(self.side - 1)
        };
        index(position.y, 1) * self.side + index(position.x, 0)
    }

    /// Gives each empty cell the vertex of a filled one nearby.
    fn fill(&mut self) {
        let mut queue: VecDeque<usize> = (0..self.vertices.len())
            .filter(|&cell| self.vertices[cell] != EMPTY)
            .collect();
        while let Some(cell) = queue.pop_front() {
            let (row, column) = (cell / self.side, cell % self.side);
            let neighbours = [
                (row > 0).then(|| cell - self.side),
                (row + 1 < self.side).then(|| cell + self.side),
                (column > 0).then(|| cell - 1),
                (column + 1 < self.side).then(|| cell + 1),
            ];
            for neighbour in neighbours.into_iter().flatten() {
                if self.vertices[neighbour] == EMPTY {
                    self.vertices[neighbour] = self.vertices[cell];
                    queue.push_back(neighbour);
                }
            }
        }
    }
}

impl HintGenerator<f64> for GridHints {
    fn get_hint(&self, position: Point2<f64>) -> FixedVertexHandle {
        let vertex = if self.vertices.is_empty() {
            0
        } else {
            self.vertices[self.cell(position)] as usize
        };
        FixedVertexHandle::from_index(vertex)
    }

    fn notify_vertex_lookup(&self, _: FixedVertexHandle) {}

    fn notify_vertex_inserted(&mut self, _: FixedVertexHandle, _: Point2<f64>) {}

    fn notify_vertex_removed(&mut self, _: Option<Point2<f64>>, _: FixedVertexHandle, _: Point2<f64>) {}

    fn initialize_from_triangulation<TR, V>(triangulation: &TR) -> Self
    where
        TR: Triangulation<Vertex = V>,
        V: HasPosition<Scalar = f64>,
    {
        let count = triangulation.num_vertices();
        let bounds = |axis: fn(Point2<f64>) -> f64| {
            triangulation
                .vertices()
                .map(|v| axis(v.position()))
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
                    (a.min(v), b.max(v))
                })
        };
        let ((x0, x1), (y0, y1)) = (bounds(|p| p.x), bounds(|p| p.y));
        let side = (count as f64).sqrt().ceil().max(1.0) as usize;
        let per_pixel = |range: f64| if range > 0.0 { side as f64 / range } else { 0.0 };
        let mut hints = Self {
            origin: [x0, y0],
            per_pixel: [per_pixel(x1 - x0), per_pixel(y1 - y0)],
            side,
            vertices: vec![EMPTY; side * side],
        };
        for vertex in triangulation.vertices() {
            let cell = hints.cell(vertex.position());
            hints.vertices[cell] = vertex.index() as u32;
        }
        hints.fill();
        hints
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spade::DelaunayTriangulation;

    #[test]
    fn every_cell_hints_at_a_vertex_that_is_near() {
        let points = (0..400).map(|i| Point2::new(f64::from(i % 20), f64::from(i / 20)));
        let mesh: DelaunayTriangulation<Point2<f64>, (), (), (), GridHints> =
            DelaunayTriangulation::bulk_load(points.collect()).unwrap();
        let hints = GridHints::initialize_from_triangulation(&mesh);
        for i in 0..1000 {
            let p = Point2::new(f64::from(i % 32) * 0.6, f64::from(i / 32) * 0.6);
            let vertex = mesh.vertex(hints.get_hint(p)).position();
            assert!((vertex.x - p.x).hypot(vertex.y - p.y) < 2.0, "{p:?} {vertex:?}");
        }
    }

    #[test]
    fn empty_cells_and_far_positions_have_hints() {
        let points = vec![
            Point2::new(0.0, 0.0),
            Point2::new(1e-9, 0.0),
            Point2::new(0.0, 1e-9),
            Point2::new(1e7, 1e7),
        ];
        let mesh: DelaunayTriangulation<Point2<f64>, (), (), (), GridHints> =
            DelaunayTriangulation::bulk_load(points).unwrap();
        let hints = GridHints::initialize_from_triangulation(&mesh);
        for p in [
            Point2::new(5e6, 0.0),
            Point2::new(-1e50, 1e50),
            Point2::new(1e50, 1e50),
        ] {
            assert!(hints.get_hint(p).index() < 4);
        }
    }
}
