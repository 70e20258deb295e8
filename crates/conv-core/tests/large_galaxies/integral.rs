//! The image of a Sersic profile by integrals in real space, in f64. Nothing here uses a Fourier
//! transform, or the code of `conv-core` and `sersic` that draws galaxies. Only the interpolated stamp
//! comes from [`StampInterpolator`].

use std::f64::consts::{PI, TAU};

use conv_core::StampInterpolator;
use ndarray::{Array2, ArrayView2};
use psf_types::StampGrid;
use psf_types::maths::gauss_legendre;

/// A profile of unit flux: half-light radius along the major axis, index, axis ratio, angle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    pub(crate) re: f64,
    pub(crate) n: f64,
    pub(crate) q: f64,
    pub(crate) angle_deg: f64,
}

/// The brightness of a [`Shape`], and its flux within curves.
pub(crate) struct Truth {
    shape: Shape,
    b: f64,
    central: f64,
    cos: f64,
    sin: f64,
}

impl Truth {
    pub(crate) fn new(shape: Shape) -> Self {
        let Shape { re, n, q, angle_deg } = shape;
        // Bisection: half of the light lies within `re`.
        let (mut low, mut high) = (1e-3, 2.0 * n + 1.0);
        for _ in 0..100 {
            let b = 0.5 * (low + high);
            if gamma_p(2.0 * n, b) < 0.5 {
                low = b;
            } else {
                high = b;
            }
        }
        let b = 0.5 * (low + high);
        let total = (TAU * n * q).ln() + 2.0 * re.ln() - 2.0 * n * b.ln() + ln_gamma(2.0 * n);
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        Self {
            shape,
            b,
            central: (-total).exp(),
            cos,
            sin,
        }
    }

    /// The radius of the isophote through an offset, along the major axis.
    fn radius(&self, dx: f64, dy: f64) -> f64 {
        let u = dx * self.cos + dy * self.sin;
        let v = (dy * self.cos - dx * self.sin) / self.shape.q;
        (u * u + v * v).sqrt()
    }

    pub(crate) fn brightness(&self, dx: f64, dy: f64) -> f64 {
        let ratio = self.radius(dx, dy) / self.shape.re;
        self.central * (-self.b * ratio.powf(1.0 / self.shape.n)).exp()
    }

    /// The flux within the rectangle from `low` to `high`, which holds the centre.
    pub(crate) fn flux_within(&self, low: [f64; 2], high: [f64; 2]) -> f64 {
        /// Parts between the angles of two corners, each with the nodes of [`GAUSS`].
        const PARTS: usize = 40;
        let q = self.shape.q;
        // The angles of the corners, as seen in the plane where the isophotes are circles.
        let mut ends: Vec<f64> = [
            (low[0], low[1]),
            (high[0], low[1]),
            (high[0], high[1]),
            (low[0], high[1]),
        ]
        .iter()
        .map(|&(x, y)| {
            let (u, v) = (x * self.cos + y * self.sin, y * self.cos - x * self.sin);
            (v / q).atan2(u)
        })
        .collect();
        ends.sort_by(f64::total_cmp);
        ends.push(ends[0] + TAU);
        let within = |angle: f64| {
            let (u, v) = (angle.cos(), q * angle.sin());
            let (x, y) = (u * self.cos - v * self.sin, u * self.sin + v * self.cos);
            let to_edge = |step: f64, low: f64, high: f64| {
                let edge = if step > 0.0 { high } else { low };
                if step == 0.0 { f64::INFINITY } else { edge / step }
            };
            let radius = to_edge(x, low[0], high[0]).min(to_edge(y, low[1], high[1]));
            let exponent = self.b * (radius / self.shape.re).powf(1.0 / self.shape.n);
            gamma_p(2.0 * self.shape.n, exponent)
        };
        let mut sum = 0.0;
        for ends in ends.windows(2) {
            let width = (ends[1] - ends[0]) / PARTS as f64;
            for part in 0..PARTS {
                let first = ends[0] + part as f64 * width;
                for (node, weight) in GAUSS {
                    sum += width * weight * within(first + node * width);
                }
            }
        }
        sum / TAU
    }

    /// The sum of the image over all pixels from `first` to `last` (offsets from the centre), for a
    /// PSF of unit flux that is well sampled and has the covariance `[xx, yy]`: the flux in the square
    /// of these pixels, the light that the PSF moves through its edges, and the difference between the
    /// sum over pixels and the integral.
    pub(crate) fn sum_over(&self, first: [f64; 2], last: [f64; 2], [xx, yy]: [f64; 2]) -> f64 {
        let (low, high) = (first.map(|v| v - 0.5), last.map(|v| v + 0.5));
        let slope = |x: f64, y: f64, outwards: [f64; 2]| {
            const H: f64 = 0.05;
            let at = |t: f64| self.brightness(x + t * outwards[0], y + t * outwards[1]);
            (at(H) - at(-H)) / (2.0 * H)
        };
        let along = |low: f64, high: f64, value: &dyn Fn(f64) -> f64| {
            let parts = (high - low).round() as usize;
            (0..parts).map(|i| value(low + i as f64 + 0.5)).sum::<f64>()
        };
        let mut change = 0.0;
        for (x, out) in [(low[0], -1.0), (high[0], 1.0)] {
            let slopes = along(low[1], high[1], &|y| slope(x, y, [out, 0.0]));
            change += (0.5 * xx - 1.0 / 24.0) * slopes;
        }
        for (y, out) in [(low[1], -1.0), (high[1], 1.0)] {
            let slopes = along(low[0], high[0], &|x| slope(x, y, [0.0, out]));
            change += (0.5 * yy - 1.0 / 24.0) * slopes;
        }
        self.flux_within(low, high) + change
    }
}

/// An interpolated stamp as bicubic polynomials between its pixels.
pub(crate) struct Cells {
    /// The corner of the first cell, and the side of a cell, in frame pixels from the centre.
    first: (f64, f64),
    side: f64,
    /// The values of a cell at 0, 1/3, 2/3 and 1 of its side, rows first.
    values: Array2<[[f64; 4]; 4]>,
    /// The stamp as points `(x, y, weight)`, for light that is smooth.
    points: Array2<[[f64; 3]; 9]>,
}

/// The interpolated stamp is followed for this many stamp pixels beyond the outermost ones.
const BEYOND: usize = 12;
/// A cell is divided until its side is at most this part of its distance from the galaxy's centre,
/// both measured where the isophotes are circles.
const STEP: f64 = 0.4;
/// The light within this part of the half-light radius is left out: below 1e-12 of the flux, even
/// for an index of 8.
const LEFT_OUT: f64 = 1e-9;

impl Cells {
    pub(crate) fn new(stamp: ArrayView2<'_, f64>, grid: StampGrid) -> Self {
        let s = grid.oversampling();
        let (nx, ny) = (grid.nx() + 2 * BEYOND - 1, grid.ny() + 2 * BEYOND - 1);
        let fine = StampGrid::new(3 * nx + 1, 3 * ny + 1)
            .and_then(|fine| fine.with_oversampling(3.0 * s))
            .and_then(|fine| {
                fine.with_centre(
                    3.0 * (grid.centre_x() + BEYOND as f64),
                    3.0 * (grid.centre_y() + BEYOND as f64),
                )
            })
            .unwrap();
        let all = StampInterpolator::new(stamp, grid).resample((0.0, 0.0), fine);
        let values = Array2::from_shape_fn((ny, nx), |(j, i)| {
            std::array::from_fn(|y| std::array::from_fn(|x| all[[3 * j + y, 3 * i + x]]))
        });
        let first = (
            -(grid.centre_x() + BEYOND as f64) / s,
            -(grid.centre_y() + BEYOND as f64) / s,
        );
        let side = 1.0 / s;
        let points = Array2::from_shape_fn((ny, nx), |(j, i)| {
            let corner = (first.0 + i as f64 * side, first.1 + j as f64 * side);
            std::array::from_fn(|k| {
                let ((x, wx), (y, wy)) = (GAUSS_3[k % 3], GAUSS_3[k / 3]);
                let h = polynomial(&values[[j, i]], x, y);
                let weight = wx * wy * side * side * h;
                [corner.0 + x * side, corner.1 + y * side, weight]
            })
        });
        Self {
            first,
            side,
            values,
            points,
        }
    }

    /// The stamp's covariance `[xx, yy]` about its centre, for a flux of 1.
    pub(crate) fn covariance(&self) -> [f64; 2] {
        let mut sums = [0.0; 2];
        for [x, y, weight] in self.points.iter().flatten() {
            sums[0] += weight * x * x;
            sums[1] += weight * y * y;
        }
        sums
    }

    /// The image of a galaxy at an offset from its centre.
    pub(crate) fn image(&self, light: &Truth, (dx, dy): (f64, f64)) -> f64 {
        let mut sum = 0.0;
        for ((j, i), points) in self.points.indexed_iter() {
            // The centre of this cell's light.
            let x = dx - self.first.0 - (i as f64 + 0.5) * self.side;
            let y = dy - self.first.1 - (j as f64 + 0.5) * self.side;
            if self.side <= STEP * light.shape.q * light.radius(x, y) {
                for [u, v, weight] in points {
                    sum += weight * light.brightness(dx - u, dy - v);
                }
            } else {
                sum += divided(light, &self.values[[j, i]], (x, y), self.side, (0.0, 0.0), 1.0);
            }
        }
        sum
    }
}

/// The integral over a part of a cell: the square of side `size` (in sides of the cell) at `corner`.
/// `(x, y)` is the offset of the light at the cell's middle.
fn divided(
    light: &Truth,
    values: &[[f64; 4]; 4],
    (x, y): (f64, f64),
    side: f64,
    corner: (f64, f64),
    size: f64,
) -> f64 {
    let at = |u: f64, v: f64| (x - (u - 0.5) * side, y - (v - 0.5) * side);
    let middle = at(corner.0 + 0.5 * size, corner.1 + 0.5 * size);
    let radius = light.radius(middle.0, middle.1);
    let width = side * size / light.shape.q;
    if width > STEP * radius {
        if radius + width < LEFT_OUT * light.shape.re {
            return 0.0;
        }
        let half = 0.5 * size;
        return [(0.0, 0.0), (half, 0.0), (0.0, half), (half, half)]
            .iter()
            .map(|(u, v)| divided(light, values, (x, y), side, (corner.0 + u, corner.1 + v), half))
            .sum();
    }
    let mut sum = 0.0;
    for (node_y, weight_y) in GAUSS {
        for (node_x, weight_x) in GAUSS {
            let (u, v) = (corner.0 + node_x * size, corner.1 + node_y * size);
            let (dx, dy) = at(u, v);
            sum += weight_x * weight_y * polynomial(values, u, v) * light.brightness(dx, dy);
        }
    }
    sum * (side * size).powi(2)
}

/// The bicubic polynomial of values at 0, 1/3, 2/3 and 1.
fn polynomial(values: &[[f64; 4]; 4], x: f64, y: f64) -> f64 {
    let weights = |t: f64| {
        let t = 3.0 * t;
        [
            (1.0 - t) * (2.0 - t) * (3.0 - t) / 6.0,
            t * (2.0 - t) * (3.0 - t) / 2.0,
            t * (t - 1.0) * (3.0 - t) / 2.0,
            t * (t - 1.0) * (t - 2.0) / 6.0,
        ]
    };
    let (wx, wy) = (weights(x), weights(y));
    let lines = values.iter().zip(wy);
    lines
        .map(|(line, w)| w * line.iter().zip(wx).map(|(v, w)| v * w).sum::<f64>())
        .sum()
}

/// Nodes and weights on an interval of length 1.
const GAUSS: [(f64, f64); 5] = gauss_legendre();
const GAUSS_3: [(f64, f64); 3] = gauss_legendre();

/// The regularised lower incomplete gamma function: its series, or Lentz's continued fraction of the
/// upper one (Abramowitz and Stegun 6.5.29 and 6.5.31).
fn gamma_p(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    let factor = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum) = (1.0 / a, 1.0 / a);
        for k in 1..1000 {
            term *= x / (a + f64::from(k));
            sum += term;
            if term < 1e-17 * sum {
                break;
            }
        }
        return factor * sum;
    }
    let (mut f, mut c, mut d) = (1e-300, 1e-300, 0.0);
    for k in 0..1000 {
        let k = f64::from(k);
        let (numerator, denominator) = if k == 0.0 {
            (1.0, x + 1.0 - a)
        } else {
            (k * (a - k), x + 2.0 * k + 1.0 - a)
        };
        d = 1.0 / (denominator + numerator * d);
        c = denominator + numerator / c;
        f *= c * d;
        if (c * d - 1.0).abs() < 1e-16 {
            break;
        }
    }
    1.0 - factor * f
}

/// The logarithm of the gamma function: Stirling's series, after a shift to a large argument.
fn ln_gamma(mut a: f64) -> f64 {
    let mut shift = 0.0;
    while a < 15.0 {
        shift += a.ln();
        a += 1.0;
    }
    let square = 1.0 / (a * a);
    let series = (1.0 / 12.0 - square * (1.0 / 360.0 - square * (1.0 / 1260.0 - square / 1680.0))) / a;
    (a - 0.5) * a.ln() - a + 0.5 * (2.0 * PI).ln() + series - shift
}

/// A Gaussian galaxy through a Gaussian stamp, for which all is known.
#[test]
fn integrals_match_closed_forms() {
    const SIGMA: f64 = 1.6;
    let gauss = |d: f64, s: f64| (-0.5 * (d / s).powi(2)).exp() / (s * TAU.sqrt());
    let grid = StampGrid::new(81, 81).and_then(|grid| grid.with_oversampling(4.0));
    let grid = grid.unwrap();
    let stamp = Array2::from_shape_fn(grid.dim(), |(y, x)| {
        gauss((x as f64 - 40.0) / 4.0, SIGMA) * gauss((y as f64 - 40.0) / 4.0, SIGMA)
    });
    let cells = Cells::new(stamp.view(), grid);
    let covariance = cells.covariance();
    assert!(
        covariance
            .iter()
            .all(|v| (v / (SIGMA * SIGMA) - 1.0).abs() < 1e-6),
        "{covariance:?}"
    );
    for (re, q) in [(3.0, 0.3), (60.0, 0.8)] {
        let light = Truth::new(Shape {
            re,
            n: 0.5,
            q,
            angle_deg: 0.0,
        });
        let own = re / (2.0 * std::f64::consts::LN_2).sqrt();
        let (sx, sy) = (own.hypot(SIGMA), (q * own).hypot(SIGMA));
        let peak = gauss(0.0, sx) * gauss(0.0, sy);
        for (x, y) in [(0.0, 0.0), (0.7, -1.2), (4.0, 2.0), (30.0, -9.0)] {
            let error = cells.image(&light, (x, y)) - gauss(x, sx) * gauss(y, sy);
            // The interpolation of these stamps.
            assert!(
                error.abs() < 2e-6 * peak,
                "re = {re} at {x}, {y}: {:e}",
                error / peak
            );
        }
    }
    // P(1, x) and P(2, x).
    for x in [0.01, 0.5, 1.9, 3.1, 20.0] {
        let e = f64::exp(-x);
        assert!((gamma_p(1.0, x) - (1.0 - e)).abs() < 1e-13, "{x}");
        assert!((gamma_p(2.0, x) - (1.0 - e * (1.0 + x))).abs() < 1e-13, "{x}");
    }
    // A circle that touches all sides of a square, and one around it.
    let light = Truth::new(Shape {
        re: 50.0,
        n: 4.0,
        q: 1.0,
        angle_deg: 30.0,
    });
    let within = light.flux_within([-50.0, -50.0], [50.0, 50.0]);
    assert!(
        within > 0.5 && within < gamma_p(8.0, light.b * f64::sqrt(2.0).powf(0.25)),
        "{within}"
    );
}
