//! Gradients of the samples at a vertex of the triangulation.

use spade::Triangulation;
use spade::handles::FixedVertexHandle;

use crate::geometry::{Point, dot, sub};
use crate::mesh::{Triangles, point_of, sample_of};

/// The direct neighbours alone serve while the squares of their offsets spread at least this much across.
const SPREAD: f64 = 1e-2;
/// Offsets that spread less than this across say nothing of the slope there, which counts as 0.
const LINE: f64 = 1e-6;

/// The gradient at a vertex as a linear form: its x and y parts weigh each sample by these numbers, which sum to 0.
pub(crate) type GradientStencil = Vec<(usize, Point)>;

/// Least squares over the Delaunay neighbours: minimises `sum_j u_j [v_j - v_0 - g (x_j - x_0)]^2` with
/// `u_j = 1 / (d_j^2 + m^2)`, `d_j` the distance of neighbour `j` and `m^2` the mean of the `d_j^2`; exact for linear values.
///
/// The weights favour near neighbours, but not those in a tight cluster, whose differences would be noise. Neighbours of
/// neighbours join in where the first ring nearly lies on a line.
pub(crate) fn gradient_stencil(triangles: &Triangles, vertex: FixedVertexHandle) -> GradientStencil {
    let centre = triangles.vertex(vertex);
    let mut ring: Vec<FixedVertexHandle> = centre.out_edges().map(|e| e.to().fix()).collect();
    if axes(triangles, vertex, &ring).is_none_or(|(_, [large, small])| small < SPREAD * large) {
        let second: Vec<_> = ring
            .iter()
            .flat_map(|&v| triangles.vertex(v).out_edges().map(|e| e.to().fix()))
            .collect();
        for v in second {
            if v != vertex && !ring.contains(&v) {
                ring.push(v);
            }
        }
    }
    let Some((axis, [large, small])) = axes(triangles, vertex, &ring) else {
        return Vec::new();
    };
    let reach = mean_square(triangles, vertex, &ring);
    let across = [-axis[1], axis[0]];
    let inverse_small = if small < LINE * large { 0.0 } else { 1.0 / small };
    let origin = point_of(centre.data());
    let mut stencil = vec![(sample_of(centre.data()), [0.0; 2])];
    for v in ring {
        let node = *triangles.vertex(v).data();
        let d = sub(point_of(&node), origin);
        let w = 1.0 / (dot(d, d) + reach);
        let (u, v) = (w * dot(d, axis) / large, w * dot(d, across) * inverse_small);
        let g = [u * axis[0] + v * across[0], u * axis[1] + v * across[1]];
        stencil[0].1 = sub(stencil[0].1, g);
        stencil.push((sample_of(&node), g));
    }
    stencil
}

/// The mean of the squared distances.
fn mean_square(triangles: &Triangles, vertex: FixedVertexHandle, ring: &[FixedVertexHandle]) -> f64 {
    let origin = point_of(triangles.vertex(vertex).data());
    let squares = ring.iter().map(|&v| {
        let d = sub(point_of(triangles.vertex(v).data()), origin);
        dot(d, d)
    });
    squares.sum::<f64>() / ring.len() as f64
}

/// Principal axis and eigenvalues (larger first) of `sum u d d^T` over the ring.
fn axes(
    triangles: &Triangles,
    vertex: FixedVertexHandle,
    ring: &[FixedVertexHandle],
) -> Option<(Point, [f64; 2])> {
    let origin = point_of(triangles.vertex(vertex).data());
    let reach = mean_square(triangles, vertex, ring);
    let mut m = [0.0; 3];
    for &v in ring {
        let d = sub(point_of(triangles.vertex(v).data()), origin);
        let w = 1.0 / (dot(d, d) + reach);
        m[0] += w * d[0] * d[0];
        m[1] += w * d[0] * d[1];
        m[2] += w * d[1] * d[1];
    }
    let half_difference = 0.5 * (m[0] - m[2]);
    let radius = half_difference.hypot(m[1]);
    let centre = 0.5 * (m[0] + m[2]);
    let angle = 0.5 * m[1].atan2(half_difference);
    let (s, c) = angle.sin_cos();
    let large = centre + radius;
    // The determinant keeps the small eigenvalue's digits, the difference centre - radius would not.
    let small = ((m[0] * m[2] - m[1] * m[1]) / large).max(0.0);
    (large > 0.0 && large.is_finite()).then_some(([c, s], [large, small]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Points;
    use crate::mesh::Mesh;
    use psf_types::{Position, SamplePositions};

    /// Rounding of sums of a few terms of order one.
    const ROUNDING: f64 = 1e-12;

    fn gradient(points: &[Point], vertex: usize, values: impl Fn(Point) -> f64) -> Point {
        let positions = points
            .iter()
            .map(|p| Position::new(p[0], p[1]).unwrap())
            .collect();
        let mesh = Mesh::new(&Points::new(&SamplePositions::new(positions, None).unwrap()).unwrap());
        let stencil = gradient_stencil(&mesh.triangles, mesh.vertex_of(vertex));
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
    fn neighbours_on_a_line_call_in_the_second_ring() {
        // The neighbours of the first point lie almost on one line through it.
        let points = [[0.0, 0.0], [1.0, 1e-4], [2.0, -1e-4], [4.0, 3.0], [4.0, -3.0]];
        let g = gradient(&points, 0, |p| p[1]);
        assert!((g[1] - 1.0).abs() < 1e-6 && g[0].abs() < 1e-6, "{g:?}");
    }

    #[test]
    fn noise_between_clustered_samples_is_no_slope() {
        let points = [[0.0, 0.0], [1e-9, 0.0], [5.0, 1.0], [0.0, 4.0], [1.0, -4.0]];
        let g = gradient(&points, 0, |p| if p == points[1] { 1.0 } else { 0.0 });
        assert!(g[0].abs() < 1e-8 && g[1].abs() < 1e-8, "{g:?}");
    }

    #[test]
    fn rounded_lines_have_no_slope_across() {
        let points = [[0.0, 0.0], [1.0, 1e-5], [2.0, 0.0], [3.0, 2e-5]];
        let g = gradient(&points, 1, |p| 3.0 * p[0] + 1e9 * p[1] * p[1]);
        assert!(g[0].abs() < 4.0 && g[1].abs() < 1e-3, "{g:?}");
    }
}
