//! Leave-one-out for interpolators that live on the triangulation.

use psf_types::{OutsidePolicy, SampleCoefficients};
use spade::Triangulation;
use spade::handles::FixedVertexHandle;

use crate::geometry::{Outside, Point, Points};
use crate::leave_one_out::{LeaveOneOut, LeftOut, Unpredictable, judge, prediction_error};
use crate::mesh::{Mesh, sample_of};
use crate::mesh_weights::Support;
use crate::{CoeffFieldError, WeightList};

/// Up to this many samples, all others are triangulated for each one left out.
const FEW: usize = 24;

/// A method that finds weights from a triangulation alone.
pub(crate) trait LocalMethod {
    /// Weights at `p` and whether the samples cover it.
    fn weights(&self, mesh: &Mesh, p: Point, outside: Outside, weights: &mut WeightList) -> bool;
}

/// Triangulates only what surrounds the sample left out.
///
/// The triangles that fill the gap of a removed vertex, and the Voronoi cells that share out its cell, are those of its
/// Delaunay neighbours, so the neighbours alone give the prediction. On the boundary the continuation beyond the hull
/// asks for the neighbours' gradients as well, which two more rings determine.
pub(crate) fn mesh_leave_one_out(
    method: &dyn LocalMethod,
    samples: &SampleCoefficients,
    outside: OutsidePolicy,
) -> Result<LeaveOneOut, CoeffFieldError> {
    let points = Points::new(samples.positions())?;
    let outside = Outside::try_from(outside)?;
    let mut weights = WeightList::new();
    let outcome = |sample, covered, weights: &WeightList| {
        judge(
            outside,
            covered,
            prediction_error(samples, sample, samples.values(), weights),
        )
    };
    let outcomes = match Support::new(&points, outside) {
        Support::Line(line) => (0..points.len())
            .map(|sample| match line.without(sample) {
                None => LeftOut::Unpredictable {
                    reason: Unpredictable::NoOthers,
                },
                Some(others) => {
                    let covered = others.weights(points.points[sample], &mut weights);
                    outcome(sample, covered, &weights)
                }
            })
            .collect(),
        Support::Mesh(mesh) => {
            let mut on_boundary = vec![false; points.len()];
            for sample in mesh.boundary.samples() {
                on_boundary[sample] = true;
            }
            (0..points.len())
                .map(|sample| {
                    let near = surroundings(&mesh, sample, &on_boundary);
                    let local = points.subset(near.samples.iter().copied());
                    let p = points.points[sample];
                    let covered = if near.all_around {
                        method.weights(&Mesh::bare(&local), p, outside, &mut weights)
                    } else {
                        match Support::new(&local, outside) {
                            Support::Line(line) => line.weights(p, &mut weights),
                            Support::Mesh(mesh) => method.weights(&mesh, p, outside, &mut weights),
                        }
                    };
                    for (node, _) in &mut weights {
                        *node = near.samples[*node];
                    }
                    outcome(sample, covered, &weights)
                })
                .collect()
        }
    };
    Ok(LeaveOneOut::new(outcomes))
}

/// The samples that decide a prediction, without the one left out.
struct Surroundings {
    samples: Vec<usize>,
    /// They form a ring around it, away from the boundary.
    all_around: bool,
}

fn surroundings(mesh: &Mesh, sample: usize, on_boundary: &[bool]) -> Surroundings {
    let count = mesh.sample_count();
    if count <= FEW {
        return Surroundings {
            samples: (0..count).filter(|&s| s != sample).collect(),
            all_around: false,
        };
    }
    let neighbours = |vertex: FixedVertexHandle| {
        mesh.triangles
            .vertex(vertex)
            .out_edges()
            .map(|e| sample_of(e.to().data()))
    };
    let mut ring: Vec<usize> = neighbours(mesh.vertex_of(sample)).collect();
    let all_around = !on_boundary[sample] && !ring.iter().any(|&s| on_boundary[s]);
    if !all_around {
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
    // In sample order, so that ties between equally good triangulations do not hang on where the walk began.
    ring.sort_unstable();
    Surroundings {
        samples: ring,
        all_around,
    }
}
