//! Sibson's natural neighbour interpolation.

use psf_types::{FieldError, OutsidePolicy, Position, SampleCoefficients, SamplePositions};
use spade::handles::FixedVertexHandle;
use spade::{NaturalNeighbor, Point2, PositionInTriangulation, Triangulation};

use crate::geometry::{Outside, Point, Points, dot, length, query, sub};
use crate::leave_one_out::LeaveOneOut;
use crate::mesh::{Mesh, Triangles, point_of, sample_of};
use crate::mesh_leave_one_out::{LocalMethod, mesh_leave_one_out};
use crate::mesh_weights::{InsideWeights, Support, mesh_weights};
use crate::{CoeffFieldError, FieldInterpolation, FieldWeights, WeightList};

/// A share below this much less than 0 is no rounding: the areas have cancelled.
const NEGATIVE: f64 = 1e-9;
/// How well `sum w_i x_i = x` must hold, relative to the mean distance of the neighbours ...
const MEETS_POSITION: f64 = 1e-6;
/// ... and to the largest distance, whose rounding reaches every weight.
const MEETS_POSITION_AFAR: f64 = 1e-14;

/// Sibson's natural neighbours.
///
/// The weight of a sample is the share of its Voronoi cell in the cell that a sample at the position would have
/// (R. Sibson 1981, "A brief description of natural neighbour interpolation", in *Interpreting Multivariate Data*, 21):
/// `w_i = area(cell(x) and cell_i) / area(cell(x))`. No weight is negative; linear fields are reproduced. Smooth except at
/// the samples, where it is continuous: no kinks along triangles, and no choice where samples lie on one circle.
///
/// The areas lose digits among samples much closer to each other than to the rest: slopes are reproduced to about
/// 1e-16 of the ratio of the two distances. Where less than 1e-6 is left (samples 1e-10 of the spacing apart, or positions at
/// the very hull, where the areas grow without bound), the weights of [`Delaunay`](crate::Delaunay) take their place. At
/// the hull both have the same limit; around such a cluster the two differ by a small step.
///
/// Outside the samples, in dents of the hull, and for collinear samples it does what [`Delaunay`](crate::Delaunay) does;
/// on the hull the two agree.
///
/// ```
/// use coeff_field::{InterpolatedField, NaturalNeighbour};
/// use psf_types::{CoefficientField, OutsidePolicy, Position, SampleCoefficients, SamplePositions};
/// let corners = [(0, 0), (4, 0), (0, 4), (4, 4)].map(|(x, y)| Position::of_pixel(x, y));
/// let positions = SamplePositions::new(corners.to_vec(), None)?;
/// let samples = SampleCoefficients::new(ndarray::array![[0.0], [0.0], [0.0], [1.0]], positions)?;
/// let field = InterpolatedField::new(&samples, &NaturalNeighbour, OutsidePolicy::Nearest)?;
/// let mut value = [0.0];
/// field.evaluate_into(Position::of_pixel(2, 2), &mut value)?;
/// assert!((value[0] - 0.25).abs() < 1e-15);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct NaturalNeighbour;

impl FieldInterpolation for NaturalNeighbour {
    fn prepare(
        &self,
        positions: &SamplePositions,
        outside: OutsidePolicy,
    ) -> Result<Box<dyn FieldWeights>, CoeffFieldError> {
        let outside = Outside::try_from(outside)?;
        Ok(match Support::new(&Points::new(positions)?, outside) {
            Support::Line(line) => Box::new(line),
            Support::Mesh(mesh) => Box::new(NaturalNeighbourWeights { mesh, outside }),
        })
    }

    fn leave_one_out(
        &self,
        samples: &SampleCoefficients,
        outside: OutsidePolicy,
    ) -> Result<LeaveOneOut, CoeffFieldError> {
        mesh_leave_one_out(&Self, samples, outside)
    }
}

#[derive(Debug)]
struct NaturalNeighbourWeights {
    mesh: Box<Mesh>,
    outside: Outside,
}

/// Sibson's weights, with the buffers of one thread.
struct Sibson<'a> {
    triangles: &'a Triangles,
    spade: NaturalNeighbor<'a, Triangles>,
    shares: Vec<(FixedVertexHandle, f64)>,
}

impl<'a> Sibson<'a> {
    fn new(mesh: &'a Mesh) -> Self {
        Self {
            triangles: &mesh.triangles,
            spade: mesh.triangles.natural_neighbor(),
            shares: Vec::new(),
        }
    }
}

impl InsideWeights for Sibson<'_> {
    fn inside(&mut self, p: Point, located: PositionInTriangulation, weights: &mut WeightList) -> bool {
        if !matches!(
            located,
            PositionInTriangulation::OnFace(_) | PositionInTriangulation::OnEdge(_)
        ) {
            return false;
        }
        self.spade.get_weights(Point2::new(p[0], p[1]), &mut self.shares);
        let (mut sum, mut mean, mut mean_distance, mut largest) = (0.0, [0.0; 2], 0.0_f64, 0.0_f64);
        weights.clear();
        for &(vertex, share) in &self.shares {
            // Also refuses NaN.
            if !(-NEGATIVE..=1.0 + NEGATIVE).contains(&share) {
                return false;
            }
            let share = share.max(0.0);
            if share == 0.0 {
                continue;
            }
            let node = *self.triangles.vertex(vertex).data();
            let d = sub(point_of(&node), p);
            let distance = dot(d, d).sqrt();
            mean = [mean[0] + share * d[0], mean[1] + share * d[1]];
            mean_distance += share * distance;
            largest = largest.max(distance);
            sum += share;
            weights.push((sample_of(&node), share));
        }
        let met = length(mean) <= MEETS_POSITION * mean_distance + MEETS_POSITION_AFAR * largest;
        if !met || (sum - 1.0).abs() > NEGATIVE {
            return false;
        }
        for (_, weight) in weights {
            *weight /= sum;
        }
        true
    }
}

impl LocalMethod for NaturalNeighbour {
    fn weights(&self, mesh: &Mesh, p: Point, outside: Outside, weights: &mut WeightList) -> bool {
        mesh_weights(mesh, &mut Sibson::new(mesh), p, outside, weights)
    }
}

impl NaturalNeighbourWeights {
    fn weights(
        &self,
        sibson: &mut Sibson<'_>,
        position: Position,
        weights: &mut WeightList,
    ) -> Result<(), FieldError> {
        let covered = mesh_weights(&self.mesh, sibson, query(position)?, self.outside, weights);
        if covered || self.outside != Outside::Error {
            Ok(())
        } else {
            Err(FieldError::OutsideSamples { position })
        }
    }
}

impl FieldWeights for NaturalNeighbourWeights {
    fn sample_count(&self) -> usize {
        self.mesh.sample_count()
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        self.weights(&mut Sibson::new(&self.mesh), position, weights)
    }

    fn weights_each(
        &self,
        positions: &mut dyn Iterator<Item = Position>,
        visit: &mut dyn FnMut(&WeightList),
    ) -> Result<(), FieldError> {
        let mut sibson = Sibson::new(&self.mesh);
        let mut weights = WeightList::new();
        for position in positions {
            self.weights(&mut sibson, position, &mut weights)?;
            visit(&weights);
        }
        Ok(())
    }
}
