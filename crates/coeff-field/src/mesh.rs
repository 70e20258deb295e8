//! The triangulation with its boundary, and the weights inside and outside of it. Delaunay and
//! natural neighbour interpolation share them.

use psf_types::{OutsidePolicy, SampleCoefficients};
use spade::handles::FixedVertexHandle;
use spade::{Point2, PositionInTriangulation, Triangulation};

use crate::boundary::{Boundary, Foot};
use crate::geometry::{Point, Points, Scale, foot_on_segment, known, length};
use crate::interpolation::{
    Outcomes, Unpredictable, WeightList, add_weight, outcomes_of, pair, prediction_error, single,
};
use crate::line::LineWeights;
use crate::triangles::{Triangles, in_triangle, point_of, sample_of, triangulate};

/// The triangulation and its boundary.
#[derive(Debug)]
pub(crate) struct Mesh {
    pub(crate) triangles: Triangles,
    pub(crate) boundary: Boundary,
    pub(crate) scale: Scale,
    /// Index of each sample's vertex.
    pub(crate) vertices: Vec<u32>,
}

/// The location of a position in the triangulation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Place {
    /// In a triangle, on its edge or at a vertex.
    Inside(PositionInTriangulation),
    /// In a sliver that was peeled off this side of the hull (see [`Boundary::peel`]).
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

    /// The triangulation without a boundary, for positions known to lie well inside.
    pub(crate) fn bare(points: &Points) -> Self {
        let (triangles, vertices) = triangulate(points);
        Self {
            triangles,
            boundary: Boundary::default(),
            scale: points.scale,
            vertices,
        }
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

    /// Writes weights that are linear inside each triangle, or none outside the hull.
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

/// The samples' triangulation, or their line if they are collinear.
#[derive(Debug)]
pub(crate) enum Support {
    Line(LineWeights),
    Mesh(Box<Mesh>),
}

impl Support {
    pub(crate) fn new(points: &Points, outside: OutsidePolicy) -> Self {
        if let Some(line) = LineWeights::detect(points, outside) {
            return Self::Line(line);
        }
        let mut mesh = Mesh::new(points);
        mesh.boundary
            .prepare_gradients(&mesh.triangles, outside == OutsidePolicy::Extend);
        Self::Mesh(Box::new(mesh))
    }
}

/// Writes a method's weights inside the triangulation. Returns `false` if rounding prevents that,
/// or if the method leaves the position to the linear weights.
pub(crate) type InsideWeights<'a> =
    &'a mut dyn FnMut(Point, PositionInTriangulation, &mut WeightList) -> bool;

/// Writes the weights at `p` and returns whether the samples cover it.
///
/// Inside, the weights are those of the method, or linear ones. Outside, and in the slivers peeled
/// off the hull, the value is `f(c) + g(c) (x - c)`. Here `c` is the foot on the chain of boundary
/// samples. `f` and `g` are the values and gradients of the samples, interpolated linearly along
/// the chain. In a sliver, and outside under [`OutsidePolicy::Extend`], `x` is the position itself.
/// Otherwise `x` is the nearest point of the hull. The result is continuous across the chain and
/// the hull.
///
/// Close to a side with dents, the method's weights blend into the linear ones. The Voronoi cell of
/// a position in a dent reaches farther out than the cells of the samples around it. There it
/// overlaps the cells of distant corners of the hull, however shallow the dent is, so natural
/// neighbour weights would include these corners.
pub(crate) fn mesh_weights(
    mesh: &Mesh,
    method: InsideWeights<'_>,
    p: Point,
    outside: OutsidePolicy,
    weights: &mut WeightList,
) -> bool {
    match mesh.place(p) {
        Place::Inside(located) => {
            let clearance = mesh.boundary.clearance(p);
            if clearance == 0.0 || !method(p, located, weights) {
                mesh.barycentric(p, located, weights);
            } else if clearance < 1.0 {
                let mut linear = WeightList::new();
                mesh.barycentric(p, located, &mut linear);
                for (_, weight) in &mut *weights {
                    *weight *= clearance;
                }
                for (sample, weight) in linear {
                    add_weight(weights, sample, (1.0 - clearance) * weight);
                }
            }
            true
        }
        Place::Peeled(side) => {
            beyond_chain(&mesh.boundary.foot(side, p), true, weights);
            true
        }
        Place::Outside => {
            let foot = mesh.boundary.nearest(p);
            beyond_chain(&foot, outside == OutsidePolicy::Extend, weights);
            length(foot.to_position) <= mesh.scale.covered
        }
    }
}

/// Writes the weights at the point of the hull nearest to `p`, a position outside the hull.
pub(crate) fn weights_at_hull(mesh: &Mesh, p: Point, weights: &mut WeightList) {
    beyond_chain(&mesh.boundary.nearest(p), false, weights);
}

/// Writes the weights of the value at the foot on the chain, continued by the gradients to the hull
/// or to the position.
fn beyond_chain(foot: &Foot<'_>, to_position: bool, weights: &mut WeightList) {
    let [a, b] = foot.links;
    pair(weights, a.sample, b.sample, foot.s);
    let beyond = if to_position { foot.to_position } else { [0.0; 2] };
    let d = [foot.to_hull[0] + beyond[0], foot.to_hull[1] + beyond[1]];
    for (link, share) in [(a, 1.0 - foot.s), (b, foot.s)] {
        for (sample, g) in &link.gradient {
            add_weight(weights, *sample, share * (g[0] * d[0] + g[1] * d[1]));
        }
    }
}

/// Up to this number of samples, each prediction triangulates all other samples.
const MAX_EXACT_SAMPLES: usize = 24;

/// A method that writes weights at a point of a triangulation and returns whether the samples cover
/// the point.
pub(crate) type MeshMethod = fn(&Mesh, Point, OutsidePolicy, &mut WeightList) -> bool;

/// Predicts each sample from a triangulation of its surroundings only.
///
/// When a vertex is removed, its Delaunay neighbours are the corners of the triangles that fill the
/// hole. The Voronoi cells of these neighbours divide the vertex's cell among them. So the
/// neighbours determine the weights. Their gradients depend on two more rings of neighbours. A method
/// may need gradients everywhere. On the boundary, the continuation beyond the hull always does.
pub(crate) fn mesh_leave_one_out(
    method: MeshMethod,
    needs_gradients: bool,
    samples: &SampleCoefficients,
    outside: OutsidePolicy,
) -> Outcomes {
    let points = Points::new(samples.positions())?;
    let outside = known(outside)?;
    let mut weights = WeightList::new();
    let support = Support::new(&points, outside);
    let mut on_boundary = vec![false; points.len()];
    if let Support::Mesh(mesh) = &support {
        for sample in mesh.boundary.samples() {
            on_boundary[sample] = true;
        }
    }
    Ok(outcomes_of(samples, outside, |sample| {
        let p = points.points[sample];
        let covered = match &support {
            Support::Line(line) => {
                let others = line.without(sample).ok_or(Unpredictable::NoOthers)?;
                others.weights(p, &mut weights)
            }
            Support::Mesh(mesh) => {
                let (near, all_around) = surroundings(mesh, sample, &on_boundary, needs_gradients);
                let local = points.subset(near.iter().copied());
                let covered = if all_around {
                    method(&Mesh::bare(&local), p, outside, &mut weights)
                } else {
                    match Support::new(&local, outside) {
                        Support::Line(line) => line.weights(p, &mut weights),
                        Support::Mesh(mesh) => method(&mesh, p, outside, &mut weights),
                    }
                };
                for (node, _) in &mut weights {
                    *node = near[*node];
                }
                covered
            }
        };
        let error = prediction_error(samples, sample, samples.values(), &weights);
        Ok((covered, error))
    }))
}

/// The other samples that determine the prediction of `sample`. The flag is true if they form a
/// ring around `sample`, away from the boundary.
fn surroundings(
    mesh: &Mesh,
    sample: usize,
    on_boundary: &[bool],
    needs_gradients: bool,
) -> (Vec<usize>, bool) {
    let count = mesh.vertices.len();
    if count <= MAX_EXACT_SAMPLES {
        return ((0..count).filter(|&s| s != sample).collect(), false);
    }
    let neighbours = |vertex: FixedVertexHandle| {
        mesh.triangles
            .vertex(vertex)
            .out_edges()
            .map(|e| sample_of(e.to().data()))
    };
    let mut ring: Vec<usize> = neighbours(mesh.vertex_of(sample)).collect();
    let all_around = !on_boundary[sample] && !ring.iter().any(|&s| on_boundary[s]);
    if needs_gradients || !all_around {
        let mut start = 0;
        for _ in 0..2 {
            let end = ring.len();
            for i in start..end {
                for s in neighbours(mesh.vertex_of(ring[i])) {
                    if s != sample && !ring.contains(&s) {
                        ring.push(s);
                    }
                }
            }
            start = end;
        }
    }
    // Sorted, so that the order of the neighbours in the mesh does not decide between equally good
    // triangulations.
    ring.sort_unstable();
    (ring, all_around)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::points_of;

    fn mesh(points: &[Point]) -> Mesh {
        Mesh::new(&points_of(points))
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
}
