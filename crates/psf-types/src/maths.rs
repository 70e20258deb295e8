//! Mathematics that several stages share: cubic B-splines, Legendre polynomials, quadrature, convex hulls.

use ndarray::{Array2, ArrayView2, Axis};

/// The full width at half maximum of a Gaussian, in units of its sigma: `2 sqrt(2 ln 2)`.
pub const FWHM_PER_SIGMA: f64 = 2.354_820_045_030_949_3;

/// Maps any index to the range 0 to `length - 1`, for a line of `length` values that is mirrored
/// about its outermost values: `... 2 1 | 0 1 2 ... n-1 | n-2 n-3 ...`.
#[inline]
pub fn mirrored_index(index: i64, length: usize) -> usize {
    if length == 1 {
        return 0;
    }
    let last = length as i64 - 1;
    let folded = index.rem_euclid(2 * last);
    folded.min(2 * last - folded) as usize
}

/// The coefficients of the cubic B-spline through values `[y, x]`. Beyond the edges, the values are
/// mirrored ([`mirrored_index`]).
///
/// The value of the spline at `i + u` (`0 <= u <= 1`) along an axis is the sum of the coefficients
/// at `i - 1` to `i + 2` with the weights [`spline_weights`]`(u)`. The recursive filter is from
/// Unser, Aldroubi and Eden 1993 (IEEE Trans. Signal Process. 41, 834).
///
/// ```
/// use ndarray::array;
/// use psf_types::maths::{spline_coefficients, spline_weights};
/// let c = spline_coefficients(array![[1.0, 4.0, 9.0, 16.0]].view());
/// let at_1: f64 = spline_weights(0.0).iter().zip(c.row(0)).map(|(w, c)| w * c).sum();
/// assert!((at_1 - 4.0).abs() < 1e-14);
/// ```
pub fn spline_coefficients(values: ArrayView2<'_, f64>) -> Array2<f64> {
    let mut coefficients = values.as_standard_layout().into_owned();
    for axis in [Axis(0), Axis(1)] {
        for mut lane in coefficients.lanes_mut(axis) {
            let mut line = lane.to_vec();
            spline_prefilter(&mut line);
            lane.iter_mut().zip(line).for_each(|(c, v)| *c = v);
        }
    }
    coefficients
}

/// Converts values to B-spline coefficients along one line, in place.
fn spline_prefilter(line: &mut [f64]) {
    let n = line.len();
    if n == 1 {
        return;
    }
    let pole = 3f64.sqrt() - 2.0;
    // The causal filter starts from the sum over the mirrored line, whose period is 2n - 2.
    let (mut start, mut power) = (0.0, 1.0);
    for k in 0..2 * n - 2 {
        start += power * line[mirrored_index(k as i64, n)];
        power *= pole;
        if power == 0.0 {
            break;
        }
    }
    line[0] = start / (1.0 - power);
    for k in 1..n {
        line[k] += pole * line[k - 1];
    }
    line[n - 1] = pole / (pole * pole - 1.0) * (line[n - 1] + pole * line[n - 2]);
    for k in (0..n - 1).rev() {
        line[k] = pole * (line[k + 1] - line[k]);
    }
    for c in line {
        *c *= 6.0;
    }
}

/// The weights of the four B-spline coefficients around a coordinate. `u` (0 to 1) is the distance
/// from the second coefficient to the coordinate.
#[inline]
pub fn spline_weights(u: f64) -> [f64; 4] {
    let v = 1.0 - u;
    [
        v * v * v / 6.0,
        2.0 / 3.0 - u * u * (2.0 - u) / 2.0,
        2.0 / 3.0 - v * v * (2.0 - v) / 2.0,
        u * u * u / 6.0,
    ]
}

/// The derivatives of [`spline_weights`] with respect to `u`.
#[inline]
pub fn spline_slopes(u: f64) -> [f64; 4] {
    let v = 1.0 - u;
    [
        -v * v / 2.0,
        u * (1.5 * u - 2.0),
        -v * (1.5 * v - 2.0),
        u * u / 2.0,
    ]
}

/// The Legendre polynomials `P_0(t)` to `P_degree(t)`, by Bonnet's recurrence
/// `(n+1) P_{n+1} = (2n+1) t P_n - n P_{n-1}`.
pub fn legendre(degree: usize, t: f64) -> Vec<f64> {
    let mut values = Vec::with_capacity(2 + degree);
    values.extend([1.0, t]);
    for n in 1..degree {
        let k = n as f64;
        values.push(((2.0 * k + 1.0) * t * values[n] - k * values[n - 1]) / (k + 1.0));
    }
    values.truncate(degree + 1);
    values
}

/// The nodes and weights of the rule of Gauss and Legendre with `N` nodes on 0 to 1, which is exact for
/// polynomials of degree `2 N - 1`. The nodes ascend.
///
/// The roots of the Legendre polynomial are found from the largest one on, by Newton's method without the
/// roots that are known already (H. J. Maehly 1954, ZAMP 5, 260).
///
/// ```
/// use psf_types::maths::gauss_legendre;
/// const RULE: [(f64, f64); 3] = gauss_legendre();
/// let fifth: f64 = RULE.iter().map(|(t, weight)| weight * t.powi(5)).sum();
/// assert!((fifth - 1.0 / 6.0).abs() < 1e-15);
/// ```
pub const fn gauss_legendre<const N: usize>() -> [(f64, f64); N] {
    const MOST_STEPS: usize = 100;
    let mut roots = [0.0; N];
    let mut rule = [(0.0, 0.0); N];
    // The roots below the middle are the negatives of those above it.
    let mut k = 0;
    while k < N.div_ceil(2) {
        let mut t = 1.0;
        let mut step = 0;
        while step < MOST_STEPS {
            let (value, slope) = legendre_and_slope(N, t);
            let mut known = 0.0;
            let mut j = 0;
            while j < k {
                known += 1.0 / (t - roots[j]);
                j += 1;
            }
            t -= value / (slope - value * known);
            step += 1;
        }
        if 2 * k + 1 == N {
            t = 0.0;
        }
        roots[k] = t;
        let (_, slope) = legendre_and_slope(N, t);
        let weight = 1.0 / ((1.0 - t * t) * slope * slope);
        rule[N - 1 - k] = (0.5 + 0.5 * t, weight);
        rule[k] = (0.5 - 0.5 * t, weight);
        k += 1;
    }
    rule
}

/// `P_degree(t)` and its derivative, by Bonnet's recurrence.
const fn legendre_and_slope(degree: usize, t: f64) -> (f64, f64) {
    let (mut before, mut value) = ((0.0, 0.0), (1.0, 0.0));
    let mut n = 0;
    while n < degree {
        let k = n as f64;
        let next = (
            ((2.0 * k + 1.0) * t * value.0 - k * before.0) / (k + 1.0),
            ((2.0 * k + 1.0) * (value.0 + t * value.1) - k * before.1) / (k + 1.0),
        );
        (before, value) = (value, next);
        n += 1;
    }
    value
}

/// The smallest multiple of `step` of at least `at_least` whose quotient by `step` has no prime factor above
/// `prime` (5 or 7), so that Fourier transforms of this size are fast.
///
/// ```
/// assert_eq!(psf_types::maths::smooth_size(97, 2, 7), 98);
/// ```
///
/// # Panics
/// For a step of 0.
pub fn smooth_size(at_least: usize, step: usize, prime: usize) -> usize {
    let is_smooth = |mut n: usize| {
        for p in [2, 3, 5, 7].into_iter().filter(|&p| p <= prime) {
            while n.is_multiple_of(p) {
                n /= p;
            }
        }
        n == 1
    };
    let mut quotient = at_least.div_ceil(step).max(1);
    while !is_smooth(quotient) {
        quotient += 1;
    }
    quotient * step
}

/// The number of terms of a polynomial in x and y of a total degree.
pub fn term_count(degree: usize) -> usize {
    (degree + 1) * (degree + 2) / 2
}

/// The index along each axis of value number `i` of an array of this shape, in row-major order.
pub fn unravel(mut i: usize, shape: &[usize]) -> Vec<usize> {
    let mut index = vec![0; shape.len()];
    for (along, &n) in index.iter_mut().zip(shape).rev() {
        *along = i % n;
        i /= n;
    }
    index
}

/// `sin(pi t) / (pi t)`.
#[inline]
pub fn sinc(t: f64) -> f64 {
    let angle = std::f64::consts::PI * t;
    if angle == 0.0 { 1.0 } else { angle.sin() / angle }
}

/// Twice the area of the triangle `a b c`. It is positive when `c` lies left of the direction from
/// `a` to `b`.
#[inline]
pub fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// The convex hull of points `[x, y]` in the plane.
///
/// ```
/// use psf_types::maths::ConvexHull;
/// let hull = ConvexHull::new(&[[0.0, 0.0], [1.0, 1.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]);
/// assert_eq!(hull.corners(), [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]);
/// assert_eq!(hull.area(), 4.0);
/// assert!(hull.contains([2.0, 0.5]) && !hull.contains([2.1, 0.5]));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ConvexHull {
    corners: Vec<[f64; 2]>,
    indices: Vec<usize>,
}

impl ConvexHull {
    /// The hull by Andrew's monotone chain (A. M. Andrew 1979, Inf. Process. Lett. 9, 216).
    pub fn new(points: &[[f64; 2]]) -> Self {
        let p = points;
        let mut order: Vec<usize> = (0..p.len()).collect();
        order.sort_by(|&a, &b| p[a][0].total_cmp(&p[b][0]).then(p[a][1].total_cmp(&p[b][1])));
        order.dedup_by(|b, a| p[*a] == p[*b]);
        let mut chain: Vec<usize> = Vec::new();
        let mut grow = |base: usize, point: usize| {
            while let [.., a, b] = chain[base..]
                && turn(p[b], p[point], p[a]) <= 0.0
            {
                chain.pop();
            }
            chain.push(point);
            chain.len() - 1
        };
        let base = order.iter().fold(0, |_, &point| grow(0, point));
        for &point in order.iter().rev().skip(1) {
            grow(base, point);
        }
        if chain.len() > 1 {
            chain.pop();
        }
        Self {
            corners: chain.iter().map(|&point| p[point]).collect(),
            indices: chain,
        }
    }

    /// The corners, counter-clockwise from the leftmost one. A hull of points on a line has two
    /// corners, and a hull of a single point has one. No three corners lie on a line.
    pub fn corners(&self) -> &[[f64; 2]] {
        &self.corners
    }

    /// The indices of the corners in the given list of points.
    pub fn indices(&self) -> &[usize] {
        &self.indices
    }

    /// The area. It is 0 for points on a line.
    pub fn area(&self) -> f64 {
        let c = &self.corners;
        let edges = (0..c.len()).map(|k| (c[k], c[(k + 1) % c.len()]));
        edges.map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>() / 2.0
    }

    /// Returns whether a point lies in the hull or on its edge, by bisection over the triangles
    /// that share the first corner. A hull without area contains only its corners.
    pub fn contains(&self, p: [f64; 2]) -> bool {
        let c = &self.corners;
        if c.len() < 3 {
            return c.contains(&p);
        }
        let left_of = |a: [f64; 2], b: [f64; 2]| turn(a, b, p) >= 0.0;
        let (mut low, mut high) = (1, c.len() - 1);
        if !left_of(c[0], c[low]) || !left_of(c[high], c[0]) {
            return false;
        }
        while high - low > 1 {
            let middle = usize::midpoint(low, high);
            if left_of(c[0], c[middle]) {
                low = middle;
            } else {
                high = middle;
            }
        }
        left_of(c[low], c[high])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_sizes_are_the_smallest_ones() {
        let even = |n| smooth_size(n, 2, 7);
        assert_eq!(
            [0, 2, 11, 97, 1055, 2079, 9248].map(even),
            [2, 2, 12, 98, 1080, 2100, 9408]
        );
        assert_eq!([7, 49, 50].map(|n| smooth_size(n, 1, 5)), [8, 50, 50]);
        assert_eq!(smooth_size(29, 4, 5), 32);
    }

    fn is_exact<const N: usize>() {
        let rule = gauss_legendre::<N>();
        assert!(rule.is_sorted_by(|a, b| a.0 < b.0));
        for degree in 0..2 * N {
            let sum: f64 = rule
                .iter()
                .map(|(t, weight)| weight * t.powi(degree as i32))
                .sum();
            assert!(
                (sum - 1.0 / (degree + 1) as f64).abs() < 1e-15,
                "{N} nodes, degree {degree}"
            );
        }
    }

    /// Abramowitz and Stegun 1964, table 25.4, on 0 to 1, and the exactness of the rules.
    #[test]
    fn rules_of_gauss_and_legendre_are_those_of_the_table() {
        let table = [
            (0.019_855_071_751_231_856, 0.050_614_268_145_188_13),
            (0.101_666_761_293_186_64, 0.111_190_517_226_687_24),
            (0.237_233_795_041_835_5, 0.156_853_322_938_943_65),
            (0.408_282_678_752_175_1, 0.181_341_891_689_181),
        ];
        let rule = gauss_legendre::<8>();
        for (k, (node, weight)) in table.into_iter().enumerate() {
            assert!(
                (rule[k].0 - node).abs() < 1e-16 && (rule[k].1 - weight).abs() < 1e-15,
                "{k}"
            );
            assert!(
                (rule[7 - k].0 - (1.0 - node)).abs() < 1.2e-16 && rule[7 - k].1 == rule[k].1,
                "{k}"
            );
        }
        is_exact::<1>();
        is_exact::<2>();
        is_exact::<3>();
        is_exact::<4>();
        is_exact::<5>();
        is_exact::<16>();
        is_exact::<33>();
    }

    #[test]
    fn splines_pass_through_values_of_any_shape() {
        for (ny, nx) in [(1, 1), (1, 4), (2, 3), (9, 6), (3, 400)] {
            let values = Array2::from_shape_fn((ny, nx), |(y, x)| ((5 * y + 3 * x) % 7) as f64 - 2.0);
            let c = spline_coefficients(values.view());
            let near = |i: usize, n: usize| {
                let taps = spline_weights(0.0).into_iter().enumerate();
                taps.map(move |(tap, w)| (mirrored_index(i as i64 - 1 + tap as i64, n), w))
            };
            for ((y, x), value) in values.indexed_iter() {
                let sum: f64 = near(y, ny)
                    .flat_map(|(j, wy)| near(x, nx).map(move |(i, wx)| (j, i, wy * wx)))
                    .map(|(j, i, w)| w * c[[j, i]])
                    .sum();
                assert!((sum - value).abs() < 1e-13, "{ny} x {nx}: {sum} {value}");
            }
        }
    }

    #[test]
    fn spline_weights_add_up_and_slopes_are_their_derivatives() {
        for u in [0.0, 0.3, 0.5, 0.99] {
            let (here, next, slopes) = (spline_weights(u), spline_weights(u + 1e-6), spline_slopes(u));
            assert!((here.iter().sum::<f64>() - 1.0).abs() < 1e-15);
            for k in 0..4 {
                assert!(((next[k] - here[k]) / 1e-6 - slopes[k]).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn legendre_values() {
        let expected = [1.0, 0.5, -0.125, -0.4375, -0.289_062_5];
        for degree in 0..5 {
            let values = legendre(degree, 0.5);
            assert_eq!(values.len(), degree + 1);
            for (got, value) in values.iter().zip(expected) {
                assert!((got - value).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn hulls_without_area_have_one_or_two_corners() {
        let line = ConvexHull::new(&[[1.0, 1.0], [0.0, 0.0], [4.0, 4.0], [0.0, 0.0]]);
        assert_eq!(line.indices(), [1, 2]);
        assert!(line.area() == 0.0 && line.contains([4.0, 4.0]) && !line.contains([1.0, 1.0]));
        let one = ConvexHull::new(&[[3.0, 4.0]; 5]);
        assert_eq!((one.corners(), one.area()), (&[[3.0, 4.0]][..], 0.0));
        let none = ConvexHull::new(&[]);
        assert!(none.area() == 0.0 && none.corners().is_empty() && !none.contains([0.0, 0.0]));
    }
}
