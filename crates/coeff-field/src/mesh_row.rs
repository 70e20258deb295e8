//! Along a row through the triangles.

use psf_types::RowRun;
use spade::handles::{FaceHandle, InnerTag};
use spade::{Point2, PositionInTriangulation, Triangulation};

use crate::WeightList;
use crate::boundary::BoundaryPiece;
use crate::geometry::{Outside, Point, cross, dot, sub};
use crate::mesh::{Mesh, Node, Peeled, area_shares, point_of, sample_of};
use crate::mesh_weights::weights_at_hull;
use crate::row::{Row, last_where};

type Face<'a> = FaceHandle<'a, InnerTag, Node, (), (), Peeled>;

/// A triangle whose height is below this part of its longest side is a sliver: its barycentric coordinates carry more
/// than 1e-12 of rounding, and are not linear to the last digits.
const SLIVER: f64 = 1e-3;

/// Finds runs of linear weights along a row, from one triangle to the next.
///
/// Walks towards each position across the edges that have it on their other side, which ends in any Delaunay triangulation
/// (H. Edelsbrunner 1990, Combinatorica 10, 251). Sides are decided without rounding, so that a run never leaves its
/// triangle.
#[derive(Debug)]
pub(crate) struct MeshRow<'a> {
    mesh: &'a Mesh,
    row: Row,
    outside: Outside,
    /// The last triangle of the walk.
    at: Option<Face<'a>>,
    first: WeightList,
    last: WeightList,
}

impl<'a> MeshRow<'a> {
    pub(crate) fn new(mesh: &'a Mesh, row: Row, outside: Outside) -> Self {
        Self {
            mesh,
            row,
            outside,
            at: None,
            first: WeightList::new(),
            last: WeightList::new(),
        }
    }

    /// The longest run from a column on that is known to be linear; none where a pixel is better looked at alone.
    pub(crate) fn run_from(&mut self, column: usize) -> Option<RowRun<'_>> {
        let p = self.row.point(column);
        let end = match self.walk_to(p) {
            Some(face) => self.in_triangle(face, column)?,
            None => self.beside_hull(column)?,
        };
        Some(RowRun {
            length: end - column,
            first: &self.first,
            last: &self.last,
        })
    }

    /// The triangle that holds `p`, on its edges too; none outside the hull.
    fn walk_to(&mut self, p: Point) -> Option<Face<'a>> {
        let mut face = self.at.or_else(|| self.start(p))?;
        let p = Point2::new(p[0], p[1]);
        loop {
            let edges = face.adjacent_edges();
            let Some(edge) = edges.iter().find(|edge| edge.side_query(p).is_on_right_side()) else {
                self.at = Some(face);
                return Some(face);
            };
            let Some(next) = edge.rev().face().as_inner() else {
                self.at = Some(face);
                return None;
            };
            face = next;
        }
    }

    /// A triangle close to `p`.
    fn start(&self, p: Point) -> Option<Face<'a>> {
        let triangles = &self.mesh.triangles;
        let beside = |edge| {
            let edge = triangles.directed_edge(edge);
            edge.face().as_inner().or_else(|| edge.rev().face().as_inner())
        };
        match triangles.locate(Point2::new(p[0], p[1])) {
            PositionInTriangulation::OnFace(face) => Some(triangles.face(face)),
            PositionInTriangulation::OnEdge(edge) | PositionInTriangulation::OutsideOfConvexHull(edge) => {
                beside(edge)
            }
            PositionInTriangulation::OnVertex(vertex) => {
                let mut edges = triangles.vertex(vertex).out_edges();
                edges.find_map(|edge| edge.face().as_inner())
            }
            PositionInTriangulation::NoTriangulation => None,
        }
    }

    /// The end of the run in the triangle that holds a column; none where its weights are not the barycentric ones, or
    /// rounded too much.
    fn in_triangle(&mut self, face: Face<'a>, column: usize) -> Option<usize> {
        let vertices = face.vertices();
        let corners = vertices.map(|v| point_of(v.data()));
        if face.data().is_some() || is_sliver(corners) {
            return None;
        }
        let last = self.last_inside(face, corners, column);
        let samples = vertices.map(|v| sample_of(v.data()));
        let ends = [column, last].map(|column| area_shares(corners, self.row.point(column)));
        self.first.clear();
        self.last.clear();
        for (corner, sample) in samples.into_iter().enumerate() {
            let [from, to] = ends.map(|shares| shares[corner]);
            // Along an edge two corners suffice.
            if from != 0.0 || to != 0.0 {
                self.first.push((sample, from));
                self.last.push((sample, to));
            }
        }
        Some(last + 1)
    }

    /// The last column in a triangle that holds an earlier one.
    fn last_inside(&self, face: Face<'a>, corners: [Point; 3], column: usize) -> usize {
        let p = self.row.point(column);
        // The row leaves through an edge that goes up, with the triangle on its left.
        let leave = [0, 1, 2]
            .into_iter()
            .filter_map(|i| {
                let edge = sub(corners[(i + 1) % 3], corners[i]);
                (edge[1] > 0.0).then(|| cross(edge, sub(p, corners[i])) / edge[1])
            })
            .fold(f64::INFINITY, f64::min);
        // A float to integer cast saturates.
        let last = column.saturating_add(leave as usize).min(self.row.length() - 1);
        let edges = face.adjacent_edges();
        let is_inside = |column: usize| {
            let q = self.row.point(column);
            let q = Point2::new(q[0], q[1]);
            edges.iter().all(|edge| !edge.side_query(q).is_on_right_side())
        };
        if last == column || is_inside(last) {
            last
        } else {
            last_where(column, last, is_inside)
        }
    }

    /// The end of the run beside the hull, where the nearest point of it decides.
    fn beside_hull(&mut self, column: usize) -> Option<usize> {
        if self.outside != Outside::Nearest {
            return None;
        }
        let here = self.piece(column)?;
        let row = self.row;
        let last = last_where(column, row.length(), |column| self.piece(column) == Some(here));
        for (column, weights) in [(column, &mut self.first), (last, &mut self.last)] {
            weights_at_hull(self.mesh, row.point(column), weights);
        }
        Some(last + 1)
    }

    /// The piece of the hull that a column outside it is nearest to.
    fn piece(&self, column: usize) -> Option<BoundaryPiece> {
        self.mesh.boundary.piece(self.row.point(column))
    }
}

fn is_sliver(corners: [Point; 3]) -> bool {
    let edge = |i: usize| sub(corners[(i + 1) % 3], corners[i]);
    let square = |i: usize| dot(edge(i), edge(i));
    cross(edge(0), edge(1)) <= SLIVER * square(0).max(square(1)).max(square(2))
}
