//! The boundary of the triangulation. It determines the values beyond the hull, and in the slivers
//! along the hull.
//!
//! Samples along an edge of the field are rarely collinear to the last bit. A sample slightly
//! inside the hull leaves a dent, which a sliver (a long thin triangle) closes. The sliver's long
//! side joins two distant samples, so the value at the hull would ignore the sample in between.
//! Therefore slivers along the hull are peeled off: they are marked, and their weights are not
//! used. The samples behind them join the boundary, so each side of the hull has a chain of samples
//! along it. A sliver is peeled off only if the depth of its dent is at most [`MAX_DENT`] times the
//! dent's width.

use std::num::NonZeroU32;

use spade::Triangulation;
use spade::handles::{FixedDirectedEdgeHandle, FixedVertexHandle};

use crate::geometry::{Point, Scale, along, dot, foot_on_segment, length, sub};
use crate::triangles::{GradientStencil, Node, Triangles, gradient_stencil, point_of, sample_of};

/// Largest depth of a dent whose sliver is peeled off, relative to the dent's width along the side.
const MAX_DENT: f64 = 1e-3;
/// Close to a side with dents, natural neighbour weights blend into linear ones. The blending ends
/// at this multiple of the depth of the dents.
const CLEAR: f64 = 4.0;
/// The edges of a dent have slopes below `1 / SLOPE` relative to the side.
const SLOPE: f64 = 10.0;

/// The sides of the hull, counter-clockwise.
#[derive(Debug, Default)]
pub(crate) struct Boundary {
    sides: Vec<Side>,
}

/// A straight side of the hull and the samples along it.
#[derive(Debug)]
pub(crate) struct Side {
    start: Point,
    /// The vector from the start to the end. The samples of the chain are also stored relative to
    /// the start, so that large coordinates lose no digits.
    span: Point,
    direction: Point,
    chain: Vec<Link>,
    /// Largest depth of the dents, at least the rounding of coordinates. It is 0 if nothing was
    /// peeled off.
    depth: f64,
}

/// A sample of the chain along a side.
#[derive(Debug)]
pub(crate) struct Link {
    /// Distance of the sample from the start of the side, measured along the side.
    t: f64,
    offset: Point,
    pub(crate) sample: usize,
    vertex: FixedVertexHandle,
    /// Empty until [`Boundary::prepare_gradients`] fills it.
    pub(crate) gradient: GradientStencil,
}

/// The point of the hull that is nearest to a position, and the point of the chain next to it, at
/// the same distance along the side.
#[derive(Debug)]
pub(crate) struct Foot<'a> {
    /// The two samples of the chain around the point of the chain.
    pub(crate) links: [&'a Link; 2],
    /// The point of the chain, as a fraction of the way from the first of these samples to the
    /// second.
    pub(crate) s: f64,
    /// The vector from the point of the chain to the point of the hull.
    pub(crate) to_hull: Point,
    /// The vector from the point of the hull to the position.
    pub(crate) to_position: Point,
}

/// The part of the hull's outline that contains the point nearest to a position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum BoundaryPiece {
    /// The start of this side.
    Corner(usize),
    /// The part of a side (first index) between a sample of its chain (second index) and the sample
    /// before it.
    Link(usize, usize),
}

impl Boundary {
    /// Finds the sides and peels off their slivers, which are marked in the triangulation.
    pub(crate) fn peel(triangles: &mut Triangles, scale: Scale) -> Self {
        let edges = hull_edges(triangles);
        let mut on_boundary = vec![false; triangles.num_vertices()];
        for &edge in &edges {
            on_boundary[triangles.directed_edge(edge).from().index()] = true;
        }
        let mut sides = Vec::new();
        let mut first = 0;
        while first < edges.len() {
            let end = end_of_side(triangles, &edges, first, scale.rounding);
            let mut side = Side::new(triangles, edges[first], edges[end - 1]);
            let number = NonZeroU32::MIN.saturating_add(sides.len() as u32);
            for &edge in &edges[first..end] {
                side.follow(triangles, edge, number, scale.rounding, &mut on_boundary);
            }
            sides.push(side);
            first = end;
        }
        Self { sides }
    }

    /// Computes the gradients at the samples of uneven sides (sides with dents), or of all sides.
    pub(crate) fn prepare_gradients(&mut self, triangles: &Triangles, all: bool) {
        for side in self.sides.iter_mut().filter(|side| all || side.depth > 0.0) {
            for link in &mut side.chain {
                link.gradient = gradient_stencil(triangles, link.vertex);
            }
        }
    }

    /// The foot of `p` on the nearest side.
    pub(crate) fn nearest(&self, p: Point) -> Foot<'_> {
        self.foot(self.nearest_side(p), p)
    }

    /// The piece of the hull nearest to `p`. Returns `None` if `p` lies inside the hull, or if the
    /// nearest side is uneven and the weights are therefore not linear.
    ///
    /// All positions whose nearest piece is a given one form a half strip or a wedge, which is
    /// convex. So if two positions have the same piece, all positions between them have it too.
    pub(crate) fn piece(&self, p: Point) -> Option<BoundaryPiece> {
        let index = self.nearest_side(p);
        let side = &self.sides[index];
        if side.depth > 0.0 {
            return None;
        }
        let offset = sub(p, side.start);
        match foot_on_segment([0.0; 2], side.span, offset) {
            0.0 => Some(BoundaryPiece::Corner(index)),
            1.0 => Some(BoundaryPiece::Corner((index + 1) % self.sides.len())),
            _ => (side.depth_of(offset) < 0.0)
                .then(|| BoundaryPiece::Link(index, side.link(dot(side.nearest(offset), side.direction)))),
        }
    }

    fn nearest_side(&self, p: Point) -> usize {
        let mut best = (f64::INFINITY, 0);
        for (index, side) in self.sides.iter().enumerate() {
            let offset = sub(p, side.start);
            let distance = length(sub(side.nearest(offset), offset));
            if distance < best.0 {
                best = (distance, index);
            }
        }
        best.1
    }

    /// The foot of `p` on a side.
    pub(crate) fn foot(&self, side: usize, p: Point) -> Foot<'_> {
        let side = &self.sides[side];
        let offset = sub(p, side.start);
        let on_hull = side.nearest(offset);
        let t = dot(on_hull, side.direction);
        let right = side.link(t);
        let links = [&side.chain[right - 1], &side.chain[right]];
        let s = ((t - links[0].t) / (links[1].t - links[0].t)).clamp(0.0, 1.0);
        let on_chain = along(links[0].offset, s, sub(links[1].offset, links[0].offset));
        Foot {
            links,
            s,
            to_hull: sub(on_hull, on_chain),
            to_position: sub(offset, on_hull),
        }
    }

    /// The distance of `p` from dents, on a scale from 0 to 1. Along a side with dents, it is 0
    /// from the hull to the depth of the dents. Farther inside it grows, to 1 at [`CLEAR`] times
    /// that depth. Without dents it is 1.
    pub(crate) fn clearance(&self, p: Point) -> f64 {
        let uneven = self.sides.iter().filter(|side| side.depth > 0.0);
        uneven.fold(1.0, |least: f64, side| {
            let depths = side.depth_of(sub(p, side.start)) / side.depth;
            least.min(((depths - 1.0) / (CLEAR - 1.0)).clamp(0.0, 1.0))
        })
    }

    /// The samples along the whole boundary.
    pub(crate) fn samples(&self) -> impl Iterator<Item = usize> + '_ {
        self.sides
            .iter()
            .flat_map(|side| side.chain.iter().map(|link| link.sample))
    }
}

impl Side {
    /// A side from the start of one hull edge to the end of another. Its chain contains only the
    /// start.
    fn new(triangles: &Triangles, first: FixedDirectedEdgeHandle, last: FixedDirectedEdgeHandle) -> Self {
        let from = triangles.directed_edge(first).from();
        let (start, end) = (
            point_of(from.data()),
            point_of(triangles.directed_edge(last).to().data()),
        );
        let span = sub(end, start);
        let span_length = length(span);
        Self {
            start,
            span,
            direction: span.map(|v| v / span_length),
            chain: vec![Link {
                t: 0.0,
                offset: [0.0; 2],
                sample: sample_of(from.data()),
                vertex: from.fix(),
                gradient: Vec::new(),
            }],
            depth: 0.0,
        }
    }

    /// The index of the second of the two links around a distance along the side.
    fn link(&self, t: f64) -> usize {
        self.chain
            .partition_point(|link| link.t <= t)
            .clamp(1, self.chain.len() - 1)
    }

    /// The point of the side that is nearest to an offset.
    fn nearest(&self, offset: Point) -> Point {
        match foot_on_segment([0.0; 2], self.span, offset) {
            1.0 => self.span,
            s => self.span.map(|v| s * v),
        }
    }

    /// Extends the chain along one hull edge. Marks the slivers behind the edge, and leads the
    /// chain around them.
    fn follow(
        &mut self,
        triangles: &mut Triangles,
        edge: FixedDirectedEdgeHandle,
        number: NonZeroU32,
        rounding: f64,
        on_boundary: &mut [bool],
    ) {
        let mut ahead = vec![edge];
        while let Some(edge) = ahead.pop() {
            let handle = triangles.directed_edge(edge);
            let offset = |node: &Node| sub(point_of(node), self.start);
            if let Some(apex) = handle.opposite_vertex()
                && !on_boundary[apex.index()]
                && let Some(depth) = self.dent([handle.from(), handle.to(), apex].map(|v| offset(v.data())))
            {
                let face = handle.face().fix().as_inner().expect("an apex needs a face");
                ahead.push(handle.next().rev().fix());
                ahead.push(handle.prev().rev().fix());
                on_boundary[apex.index()] = true;
                self.depth = self.depth.max(depth).max(rounding.max(f64::MIN_POSITIVE));
                *triangles.face_data_mut(face) = Some(number);
            } else {
                let to = handle.to();
                let offset = offset(to.data());
                self.chain.push(Link {
                    t: dot(offset, self.direction),
                    offset,
                    sample: sample_of(to.data()),
                    vertex: to.fix(),
                    gradient: Vec::new(),
                });
            }
        }
    }

    /// The distance of an offset from the side, positive inside the hull.
    fn depth_of(&self, offset: Point) -> f64 {
        dot(offset, [-self.direction[1], self.direction[0]])
    }

    /// The depth of `apex`, if the triangle on the edge from `from` to `to` only closes a dent.
    /// Otherwise `None`.
    fn dent(&self, [from, to, apex]: [Point; 3]) -> Option<f64> {
        let [t0, t1, t] = [from, to, apex].map(|offset| dot(offset, self.direction));
        let depth = self.depth_of(apex).abs();
        let step = (t - t0).min(t1 - t);
        (depth <= MAX_DENT * (t1 - t0) && step > SLOPE * depth && step > 0.0).then_some(depth)
    }
}

/// The edges of the hull, counter-clockwise and with a triangle on their left. The first edge
/// starts at a vertex that is certainly a corner.
fn hull_edges(triangles: &Triangles) -> Vec<FixedDirectedEdgeHandle> {
    let mut edges: Vec<_> = triangles.convex_hull().map(|edge| edge.rev().fix()).collect();
    edges.reverse();
    let from = |edge: FixedDirectedEdgeHandle| point_of(triangles.directed_edge(edge).from().data());
    let corner = (0..edges.len())
        .min_by(|&a, &b| {
            let (a, b) = (from(edges[a]), from(edges[b]));
            a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]))
        })
        .unwrap_or(0);
    edges.rotate_left(corner);
    edges
}

/// The end of the side that starts at the hull edge `first`: the index after its last edge. The
/// edges of a side form a straight line within rounding.
fn end_of_side(
    triangles: &Triangles,
    edges: &[FixedDirectedEdgeHandle],
    first: usize,
    rounding: f64,
) -> usize {
    let to = |edge: usize| point_of(triangles.directed_edge(edges[edge]).to().data());
    let start = point_of(triangles.directed_edge(edges[first]).from().data());
    let mut end = first + 1;
    // The last edge of the hull ends where the first one starts, which gives no direction.
    while end < edges.len() && to(end) != start {
        let span = sub(to(end), start);
        let span = span.map(|v| v / length(span));
        let mut previous = 0.0;
        let straight = (first..=end).all(|edge| {
            let d = sub(to(edge), start);
            let t = dot(d, span);
            let forward = t > previous;
            previous = t;
            forward && dot(d, [-span[1], span[0]]).abs() <= rounding
        });
        if !straight {
            break;
        }
        end += 1;
    }
    end
}
