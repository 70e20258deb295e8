//! Weights from a triangulation, inside and outside: what Delaunay and natural neighbour interpolation share.

use spade::PositionInTriangulation;

use crate::WeightList;
use crate::boundary::Foot;
use crate::geometry::{Outside, Point, Points, length};
use crate::line::LineWeights;
use crate::mesh::{Mesh, Place};
use crate::weight_list::{add_weight, pair};

/// The samples' triangulation, or their line where they have none.
#[derive(Debug)]
pub(crate) enum Support {
    Line(LineWeights),
    Mesh(Box<Mesh>),
}

impl Support {
    pub(crate) fn new(points: &Points, outside: Outside) -> Self {
        if let Some(line) = LineWeights::detect(points, outside) {
            return Self::Line(line);
        }
        let mut mesh = Mesh::new(points);
        mesh.boundary
            .prepare_gradients(&mesh.triangles, outside == Outside::Extend);
        Self::Mesh(Box::new(mesh))
    }
}

/// How a method finds weights inside the triangulation; `false` where it cannot (for rounding) or leaves it to the
/// linear weights.
pub(crate) trait InsideWeights {
    fn inside(&mut self, p: Point, located: PositionInTriangulation, weights: &mut WeightList) -> bool;
}

/// Weights at `p` and whether the samples cover it.
///
/// Inside, those of the method, or linear ones. Outside and in the slivers that were peeled off the hull, with `c` the
/// foot on the chain of boundary samples: `f(c) + g(c) (x - c)`, where `f` and the gradient `g` of the samples are linear
/// along the chain, and `x` is the position itself (in a sliver, and outside under [`Outside::Extend`]) or the nearest
/// point of the hull. All are continuous across the chain and the hull.
///
/// Close to an uneven side the method gives way to the linear weights. The Voronoi cells of samples in a dent reach out
/// far, but not for ever, and beyond them the cell of a position in the dent takes its share from the distant corners of
/// the hull, however shallow the dent is.
pub(crate) fn mesh_weights(
    mesh: &Mesh,
    method: &mut dyn InsideWeights,
    p: Point,
    outside: Outside,
    weights: &mut WeightList,
) -> bool {
    match mesh.place(p) {
        Place::Inside(located) => {
            let clearance = mesh.boundary.clearance(p);
            if clearance == 0.0 || !method.inside(p, located, weights) {
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
            beyond_chain(&foot, outside == Outside::Extend, weights);
            length(foot.to_position) <= mesh.scale.covered
        }
    }
}

/// The weights of the point of the hull that is nearest to `p`, which lies outside.
pub(crate) fn weights_at_hull(mesh: &Mesh, p: Point, weights: &mut WeightList) {
    beyond_chain(&mesh.boundary.nearest(p), false, weights);
}

/// The weights at the chain, continued to the hull or on to the position.
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
