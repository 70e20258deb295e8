//! Linear interpolation in Delaunay triangles.

use psf_types::{FieldError, OutsidePolicy, Position, RowRun, SampleCoefficients, SamplePositions};
use spade::PositionInTriangulation;

use crate::geometry::{Outside, Point, Points, query};
use crate::leave_one_out::LeaveOneOut;
use crate::mesh::Mesh;
use crate::mesh_leave_one_out::{LocalMethod, mesh_leave_one_out};
use crate::mesh_row::MeshRow;
use crate::mesh_weights::{InsideWeights, Support, mesh_weights};
use crate::row::Row;
use crate::{CoeffFieldError, FieldInterpolation, FieldWeights, WeightList};

/// Linear interpolation inside the triangles of the Delaunay triangulation.
///
/// A position in the triangle of samples `a, b, c` takes `w_a v_a + w_b v_b + w_c v_c` with its barycentric coordinates
/// `w_a = area(x, b, c) / area(a, b, c)` and so on: at most three weights, none negative. Linear fields are reproduced;
/// for others the error is at most `r^2 |v''| / 2` with `r` the radius of the triangle's circumcircle (S. Waldron 1998,
/// SIAM J. Numer. Anal. 35, 1191). Continuous, with kinks along the triangles' edges. Where more than three samples lie on
/// one circle, as on a regular grid, one of several equally good triangulations is taken, always the same one.
///
/// # Outside the samples
/// * Nearest: the value at the nearest point of the convex hull.
/// * Extend: `f(c) + g(c) (x - c)`, where `c` is that point and `g` the gradient of the hull's samples, each found by
///   least squares over its Delaunay neighbours with weights that fall with distance, interpolated linearly along the hull. It is
///   continuous and reproduces linear fields. (The hull triangles' own planes would jump from one triangle to the next,
///   and those triangles are often slivers.) A slope across samples that lie within about 0.001 of a line counts as 0.
/// * Error: refuses. Positions within 1e-9 of the samples' extent (at least 1e-9 pixels) still count as inside.
///
/// Samples that dent the hull by less than 0.001 of their spacing count as lying on it: inside such a dent the
/// continuation above applies, so that the boundary follows the samples and not the long thin triangles between them.
///
/// # One, two, or collinear samples
/// Linear interpolation along the line: a position takes the value at its foot on it. Positions off the line are outside.
///
/// ```
/// use coeff_field::{Delaunay, InterpolatedField};
/// use psf_types::{CoefficientField, OutsidePolicy, Position, SampleCoefficients, SamplePositions};
/// let corners = [(0, 0), (4, 0), (0, 4)].map(|(x, y)| Position::of_pixel(x, y));
/// let positions = SamplePositions::new(corners.to_vec(), None)?;
/// let samples = SampleCoefficients::new(ndarray::array![[0.0], [8.0], [4.0]], positions)?;
/// let field = InterpolatedField::new(&samples, &Delaunay, OutsidePolicy::Nearest)?;
/// let mut value = [0.0];
/// field.evaluate_into(Position::of_pixel(1, 2), &mut value)?;
/// assert_eq!(value, [4.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Delaunay;

impl FieldInterpolation for Delaunay {
    fn prepare(
        &self,
        positions: &SamplePositions,
        outside: OutsidePolicy,
    ) -> Result<Box<dyn FieldWeights>, CoeffFieldError> {
        let outside = Outside::try_from(outside)?;
        Ok(match Support::new(&Points::new(positions)?, outside) {
            Support::Line(line) => Box::new(line),
            Support::Mesh(mesh) => Box::new(DelaunayWeights { mesh, outside }),
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
struct DelaunayWeights {
    mesh: Box<Mesh>,
    outside: Outside,
}

/// Leaves everything to the linear weights.
struct Linear;

impl InsideWeights for Linear {
    fn inside(&mut self, _: Point, _: PositionInTriangulation, _: &mut WeightList) -> bool {
        false
    }
}

impl LocalMethod for Delaunay {
    fn weights(&self, mesh: &Mesh, p: Point, outside: Outside, weights: &mut WeightList) -> bool {
        mesh_weights(mesh, &mut Linear, p, outside, weights)
    }
}

impl FieldWeights for DelaunayWeights {
    fn sample_count(&self) -> usize {
        self.mesh.sample_count()
    }

    fn weights_into(&self, position: Position, weights: &mut WeightList) -> Result<(), FieldError> {
        let covered = mesh_weights(&self.mesh, &mut Linear, query(position)?, self.outside, weights);
        if covered || self.outside != Outside::Error {
            Ok(())
        } else {
            Err(FieldError::OutsideSamples { position })
        }
    }

    /// A run for each triangle that the row crosses, but for slivers; under [`Outside::Nearest`] one for each piece of the
    /// hull that it passes. Pixel by pixel elsewhere.
    fn weights_along_row(
        &self,
        start: (i64, i64),
        length: usize,
        visit: &mut dyn FnMut(RowRun<'_>),
    ) -> Result<(), FieldError> {
        let row = Row::new(start, length);
        let mut runs = MeshRow::new(&self.mesh, row, self.outside);
        let mut alone = WeightList::new();
        let mut column = 0;
        while column < length {
            column += if let Some(run) = runs.run_from(column) {
                visit(run);
                run.length
            } else {
                self.weights_into(row.position(column), &mut alone)?;
                visit(RowRun::of_pixel(&alone));
                1
            };
        }
        Ok(())
    }
}
