//! The Delaunay triangulation of the samples.

use std::num::NonZeroU32;

use spade::handles::FixedVertexHandle;
use spade::{DelaunayTriangulation, HasPosition, Point2, PositionInTriangulation, Triangulation};

use crate::WeightList;
use crate::boundary::Boundary;
use crate::geometry::{Point, Points, Scale, cross, dot, foot_on_segment, sub};
use crate::hints::GridHints;
use crate::weight_list::{pair, single};

/// A sample as a vertex of the triangulation, which keeps its own order.
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

/// What a triangle knows: the side of the hull (counted from 1) that it was peeled off, if it was.
pub(crate) type Peeled = Option<NonZeroU32>;
pub(crate) type Triangles = DelaunayTriangulation<Node, (), (), Peeled, GridHints>;

/// A triangle whose height is below this part of its longest side is flat: its barycentric coordinates would be rounding.
const FLAT: f64 = 1e-10;

/// The triangulation, its boundary, and where a position lies in it.
#[derive(Debug)]
pub(crate) struct Mesh {
    pub(crate) triangles: Triangles,
    pub(crate) boundary: Boundary,
    pub(crate) scale: Scale,
    /// Index of each sample's vertex.
    vertices: Vec<u32>,
}

/// Where a position lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Place {
    /// In a triangle, on its edge or at a vertex.
    Inside(PositionInTriangulation),
    /// In a sliver that was peeled off this side of the hull.
    Peeled(usize),
    /// Outside the convex hull.
    Outside,
}

impl Mesh {
    /// The triangulation of points that do not lie on one line.
    pub(crate) fn new(points: &Points) -> Self {
        let mut mesh = Self::bare(points);
        mesh.boundary = Boundary::peel(&mut mesh.triangles, points.scale);
        mesh
    }

    /// The triangulation alone, for positions known to lie well inside.
    pub(crate) fn bare(points: &Points) -> Self {
        let nodes = points.points.iter().zip(0..).map(|(p, sample)| Node {
            point: Point2::new(p[0], p[1]),
            sample,
        });
        let triangles =
            Triangles::bulk_load(nodes.collect()).expect("coordinates were checked to be in spade's range");
        let mut vertices = vec![0; points.len()];
        for vertex in triangles.vertices() {
            vertices[vertex.data().sample as usize] = vertex.index() as u32;
        }
        Self {
            triangles,
            boundary: Boundary::default(),
            scale: points.scale,
            vertices,
        }
    }

    pub(crate) fn sample_count(&self) -> usize {
        self.vertices.len()
    }

    pub(crate) fn vertex_of(&self, sample: usize) -> FixedVertexHandle {
        FixedVertexHandle::from_index(self.vertices[sample] as usize)
    }

    pub(crate) fn place(&self, p: Point) -> Place {
        let located = self.triangles.locate(Point2::new(p[0], p[1]));
        match located {
            PositionInTriangulation::OnVertex(_) => Place::Inside(located),
            PositionInTriangulation::OnFace(face) => match *self.triangles.face(face).data() {
                Some(side) => Place::Peeled(side.get() as usize - 1),
                None => Place::Inside(located),
            },
            PositionInTriangulation::OnEdge(edge) => {
                let edge = self.triangles.directed_edge(edge);
                let sides = [edge, edge.rev()].map(|e| e.face().as_inner().map(|face| *face.data()));
                match sides {
                    [Some(None), _] | [_, Some(None)] => Place::Inside(located),
                    [Some(Some(side)), _] | [_, Some(Some(side))] => Place::Peeled(side.get() as usize - 1),
                    [None, None] => Place::Outside,
                }
            }
            PositionInTriangulation::OutsideOfConvexHull(_) | PositionInTriangulation::NoTriangulation => {
                Place::Outside
            }
        }
    }

    /// Weights that are linear inside each triangle; nothing outside the hull.
    pub(crate) fn barycentric(&self, p: Point, located: PositionInTriangulation, weights: &mut WeightList) {
        weights.clear();
        match located {
            PositionInTriangulation::OnVertex(vertex) => {
                single(weights, sample_of(self.triangles.vertex(vertex).data()));
            }
            PositionInTriangulation::OnEdge(edge) => {
                let corners = self.triangles.directed_edge(edge).vertices();
                let [a, b] = corners.map(|v| point_of(v.data()));
                let [first, second] = corners.map(|v| sample_of(v.data()));
                pair(weights, first, second, foot_on_segment(a, b, p));
            }
            PositionInTriangulation::OnFace(face) => {
                let corners = self.triangles.face(face).vertices();
                in_triangle(
                    corners.map(|v| point_of(v.data())),
                    corners.map(|v| sample_of(v.data())),
                    p,
                    weights,
                );
            }
            PositionInTriangulation::OutsideOfConvexHull(_) | PositionInTriangulation::NoTriangulation => {}
        }
    }
}

pub(crate) fn sample_of(node: &Node) -> usize {
    node.sample as usize
}

pub(crate) fn point_of(node: &Node) -> Point {
    [node.point.x, node.point.y]
}

/// Barycentric coordinates of `p`, which lies inside the triangle up to rounding, so that none is negative.
///
/// Areas are taken relative to `p`: where two corners are close to it, their small difference is exact. In a flat triangle
/// the weights follow the two shorter sides.
fn in_triangle(corners: [Point; 3], samples: [usize; 3], p: Point, weights: &mut WeightList) {
    let edge = |i: usize| sub(corners[(i + 1) % 3], corners[i]);
    let squares = [0, 1, 2].map(|i| dot(edge(i), edge(i)));
    let longest = (1..3).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
    if cross(edge(0), edge(1)) <= FLAT * squares[longest] {
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

/// The shares of the triangles that `p` makes with each side, by the corner opposite to it.
pub(crate) fn area_shares(corners: [Point; 3], p: Point) -> [f64; 3] {
    let from_p = corners.map(|corner| sub(corner, p));
    let areas = [0, 1, 2].map(|i| cross(from_p[(i + 1) % 3], from_p[(i + 2) % 3]).max(0.0));
    let sum: f64 = areas.iter().sum();
    areas.map(|area| area / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use psf_types::{Position, SamplePositions};

    fn mesh(points: &[Point]) -> Mesh {
        let positions = points
            .iter()
            .map(|p| Position::new(p[0], p[1]).unwrap())
            .collect();
        Mesh::new(&Points::new(&SamplePositions::new(positions, None).unwrap()).unwrap())
    }

    #[test]
    fn vertices_edges_and_faces_have_one_two_and_three_weights() {
        let mesh = mesh(&[[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]]);
        let weights = |p: Point| {
            let mut w = Vec::new();
            match mesh.place(p) {
                Place::Inside(located) => mesh.barycentric(p, located, &mut w),
                other => panic!("{other:?}"),
            }
            w.sort_unstable_by_key(|&(n, _)| n);
            w
        };
        assert_eq!(weights([4.0, 0.0]), [(1, 1.0)]);
        assert_eq!(weights([1.0, 0.0]), [(0, 0.75), (1, 0.25)]);
        assert_eq!(weights([1.0, 2.0]), [(0, 0.25), (1, 0.25), (2, 0.5)]);
        assert_eq!(mesh.place([3.0, 3.0]), Place::Outside);
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
