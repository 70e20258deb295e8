//! The Delaunay triangulation of the samples, made by the crate spade.

use std::collections::VecDeque;
use std::num::NonZeroU32;

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};
use spade::handles::FixedVertexHandle;
use spade::{DelaunayTriangulation, HasPosition, HintGenerator, Point2, Triangulation};

use crate::geometry::{Point, Points, cross, dot, foot_on_segment, sub};
use crate::interpolation::{WeightList, pair};

/// A vertex of the triangulation. It stores the index of its sample, because the triangulation
/// orders its vertices in its own way.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    point: Point2<f64>,
    sample: u32,
}

impl HasPosition for Node {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        self.point
    }
}

/// The data of a triangle. A sliver that was peeled off a side of the hull (see the module
/// `boundary`) holds the number of this side, counted from 1. Other triangles hold `None`.
pub(crate) type Peeled = Option<NonZeroU32>;
pub(crate) type Triangles = DelaunayTriangulation<Node, (), (), Peeled, GridHints>;

/// Triangulates points that do not lie on one line. Returns the triangulation and the index of each
/// sample's vertex in it.
pub(crate) fn triangulate(points: &Points) -> (Triangles, Vec<u32>) {
    let nodes = points.points.iter().zip(0..).map(|(p, sample)| Node {
        point: Point2::new(p[0], p[1]),
        sample,
    });
    let triangles =
        Triangles::bulk_load(nodes.collect()).expect("coordinates were checked to be in spade's range");
    let mut vertices = vec![0; points.len()];
    for vertex in triangles.vertices() {
        vertices[sample_of(vertex.data())] = vertex.index() as u32;
    }
    (triangles, vertices)
}

/// A triangle is flat if its height is below this fraction of its longest side. Its barycentric
/// coordinates would consist mostly of rounding errors.
const FLAT_HEIGHT: f64 = 1e-10;

pub(crate) fn sample_of(node: &Node) -> usize {
    node.sample as usize
}

pub(crate) fn point_of(node: &Node) -> Point {
    [node.point.x, node.point.y]
}

/// Writes the barycentric coordinates of `p`, which lies inside the triangle within rounding. None
/// is negative.
///
/// Areas are computed relative to `p`. If two corners are close to `p`, their small difference is
/// then exact. In a flat triangle the weights are instead linear along the two shorter sides.
pub(crate) fn in_triangle(corners: [Point; 3], samples: [usize; 3], p: Point, weights: &mut WeightList) {
    let edge = |i: usize| sub(corners[(i + 1) % 3], corners[i]);
    let squares = [0, 1, 2].map(|i| dot(edge(i), edge(i)));
    let longest = (1..3).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
    if cross(edge(0), edge(1)) <= FLAT_HEIGHT * squares[longest] {
        let (a, b, apex) = (longest, (longest + 1) % 3, (longest + 2) % 3);
        let along = |q: Point| dot(sub(q, corners[a]), edge(a));
        let (from, to) = if along(p) < along(corners[apex]) {
            (a, apex)
        } else {
            (apex, b)
        };
        let s = foot_on_segment(corners[from], corners[to], p);
        pair(weights, samples[from], samples[to], s);
        return;
    }
    weights.extend(samples.into_iter().zip(area_shares(corners, p)));
}

/// The area fractions of the three triangles that `p` forms with the sides. Each belongs to the
/// corner opposite its side.
pub(crate) fn area_shares(corners: [Point; 3], p: Point) -> [f64; 3] {
    let from_p = corners.map(|corner| sub(corner, p));
    let areas = [0, 1, 2].map(|i| cross(from_p[(i + 1) % 3], from_p[(i + 2) % 3]).max(0.0));
    let sum: f64 = areas.iter().sum();
    areas.map(|area| area / sum)
}

/// For each cell of a square grid, a vertex in or near the cell. From this vertex spade starts its
/// search for a position in the cell.
///
/// The start depends only on the position. spade's own generators start from the vertex found last,
/// so the last bit of a result could depend on earlier queries. This table needs no lock between
/// threads and takes constant time.
#[derive(Debug, Clone, Default)]
pub(crate) struct GridHints {
    origin: [f64; 2],
    per_pixel: [f64; 2],
    side: usize,
    /// A vertex in or near each cell, ordered row by row.
    vertices: Vec<u32>,
}

const EMPTY: u32 = u32::MAX;

impl GridHints {
    fn cell(&self, position: Point2<f64>) -> usize {
        // A float to integer cast saturates, and NaN becomes 0.
        let index = |v: f64, axis: usize| {
            (((v - self.origin[axis]) * self.per_pixel[axis]) as usize).min(self.side - 1)
        };
        index(position.y, 1) * self.side + index(position.x, 0)
    }

    /// Copies into each empty cell the vertex of a filled cell nearby.
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

/// The gradient at a vertex as weights of samples: for each sample, the weights for the x and the y
/// part of the gradient. The weights of each part sum to 0.
pub(crate) type GradientStencil = Vec<(usize, Point)>;

/// The weight of the second derivatives themselves in the fit. It decides where neighbours do not.
const FLAT: f64 = 1e-2;
/// Neighbours closer than this fraction of the farthest neighbour's distance are left out.
const CLUSTER: f64 = 1e-3;
/// If squares along one direction are less than this fraction of those along the other, the slope
/// along the first counts as 0.
const LINE: f64 = 1e-6;

/// The gradient at a vertex: that of the parabola through its value which fits its neighbours, and
/// their neighbours, by weighted least squares. It minimises
///
/// ```text
/// sum_j u_j^2 [v_j - v_0 - g d_j - d_j Q d_j]^2 + 0.01 |Q|^2,   u_j = (1 + d_j^2)^-2
/// ```
///
/// Here `d_j` is the offset of neighbour `j`, in units of the square root of the median of their
/// squares. `Q` holds the second derivatives. So the gradient is exact for linear values, and for
/// parabolas if there are enough neighbours.
///
/// The weights favour near neighbours. But those closer than 0.001 of the distance of the farthest one
/// are left out: differences within a tight cluster are noise, and a slope of that noise would change
/// the field as far as the farthest neighbour. If all neighbours nearly lie on a line, the slope across
/// counts as 0.
pub(crate) fn gradient_stencil(triangles: &Triangles, vertex: FixedVertexHandle) -> GradientStencil {
    let around = |v: FixedVertexHandle| triangles.vertex(v).out_edges().map(|edge| edge.to().fix());
    let mut ring: Vec<FixedVertexHandle> = around(vertex).collect();
    for i in 0..ring.len() {
        for v in around(ring[i]) {
            if v != vertex && !ring.contains(&v) {
                ring.push(v);
            }
        }
    }
    let centre = *triangles.vertex(vertex).data();
    let square = |d: Point| dot(d, d);
    let neighbour = |v: FixedVertexHandle| {
        let node = *triangles.vertex(v).data();
        (sample_of(&node), sub(point_of(&node), point_of(&centre)))
    };
    let mut near: Vec<(usize, Point)> = ring.into_iter().map(neighbour).collect();
    let farthest = near.iter().map(|&(_, d)| square(d)).fold(0.0, f64::max);
    near.retain(|&(_, d)| square(d) >= CLUSTER * CLUSTER * farthest);
    let mut squares: Vec<f64> = near.iter().map(|&(_, d)| square(d)).collect();
    squares.sort_by(f64::total_cmp);
    let unit = squares[squares.len() / 2].sqrt();
    for (_, d) in &mut near {
        *d = d.map(|v| v / unit);
    }
    let weight = |d: Point| (1.0 + square(d)).powi(-2);
    let slope = |d: Point| Vector2::from(d) * weight(d);
    let bend = |d: Point| Vector3::new(d[0] * d[0], d[0] * d[1], d[1] * d[1]) * weight(d);
    let (mut slopes, mut bends, mut mixed) =
        (Matrix2::zeros(), Matrix3::identity() * FLAT, Matrix2x3::zeros());
    for &(_, d) in &near {
        slopes += slope(d) * slope(d).transpose();
        bends += bend(d) * bend(d).transpose();
        mixed += slope(d) * bend(d).transpose();
    }
    // The equations of the slopes alone, after those of the second derivatives are solved.
    let solved = mixed * bends.try_inverse().unwrap_or_default();
    let left = slopes - solved * mixed.transpose();
    let inverse = left.pseudo_inverse(LINE * left.trace()).unwrap_or_default();
    let mut stencil = vec![(sample_of(&centre), [0.0; 2])];
    for (sample, d) in near {
        let g = inverse * (slope(d) - solved * bend(d)) * (weight(d) / unit);
        stencil[0].1 = sub(stencil[0].1, [g.x, g.y]);
        stencil.push((sample, [g.x, g.y]));
    }
    stencil
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::points_of;

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

    /// Rounding of sums of a few terms of order one.
    const ROUNDING: f64 = 1e-12;

    fn gradient(points: &[Point], vertex: usize, values: impl Fn(Point) -> f64) -> Point {
        let (triangles, vertices) = triangulate(&points_of(points));
        let vertex = FixedVertexHandle::from_index(vertices[vertex] as usize);
        let stencil = gradient_stencil(&triangles, vertex);
        stencil.iter().fold([0.0; 2], |g, (sample, w)| {
            let v = values(points[*sample]);
            [g[0] + w[0] * v, g[1] + w[1] * v]
        })
    }

    #[test]
    fn linear_values_have_their_slope() {
        let points = [[0.0, 0.0], [3.0, 0.2], [0.4, 2.0], [3.0, 3.0], [1.0, 1.1]];
        for vertex in 0..points.len() {
            let g = gradient(&points, vertex, |p| 7.0 + 2.0 * p[0] - 5.0 * p[1]);
            assert!(
                (g[0] - 2.0).abs() < ROUNDING && (g[1] + 5.0).abs() < ROUNDING,
                "{g:?}"
            );
        }
    }

    #[test]
    fn neighbours_on_a_line_require_the_second_ring() {
        // The neighbours of the first point lie almost on one line through it.
        let points = [[0.0, 0.0], [1.0, 1e-4], [2.0, -1e-4], [4.0, 3.0], [4.0, -3.0]];
        let g = gradient(&points, 0, |p| p[1]);
        assert!((g[1] - 1.0).abs() < 1e-6 && g[0].abs() < 1e-6, "{g:?}");
    }

    #[test]
    fn noise_between_clustered_samples_gives_no_slope() {
        let pair = [[0.0, 0.0], [1e-9, 0.0], [5.0, 1.0], [0.0, 4.0], [1.0, -4.0]];
        // Most neighbours of the first point belong to its cluster.
        let crowd = [
            [0.0, 0.0],
            [1e-9, 0.0],
            [1e-9, 1e-9],
            [0.0, 1e-9],
            [5.0, 1.0],
            [-4.0, 1.0],
        ];
        for points in [&pair[..], &crowd] {
            let g = gradient(points, 0, |p| if p == points[1] { 1.0 } else { 0.0 });
            assert!(g[0].abs() < 1e-7 && g[1].abs() < 1e-7, "{g:?}");
        }
    }

    #[test]
    fn rounded_lines_have_no_slope_across() {
        let points = [[0.0, 0.0], [1.0, 1e-5], [2.0, 0.0], [3.0, 2e-5]];
        let g = gradient(&points, 1, |p| 3.0 * p[0] + 1e9 * p[1] * p[1]);
        assert!(g[0].abs() < 4.0 && g[1].abs() < 1e-3, "{g:?}");
    }

    #[test]
    fn flat_triangles_follow_their_short_sides() {
        let (corners, samples) = ([[0.0, 0.0], [4.0, 0.0], [1.0, 1e-14]], [7, 8, 9]);
        let mut w = Vec::new();
        in_triangle(corners, samples, [0.25, 0.0], &mut w);
        assert_eq!(w, [(7, 0.75), (9, 0.25)]);
        in_triangle(corners, samples, [2.5, 0.0], &mut w);
        assert_eq!(w, [(9, 0.5), (8, 0.5)]);
    }
}
