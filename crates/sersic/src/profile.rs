//! The surface brightness of one galaxy, and its rate of change.

use std::sync::OnceLock;

use psf_types::SersicSource;
use statrs::function::gamma::{gamma_ur, ln_gamma};

/// Fraction of a galaxy's flux that lies outside the radius at which drawing stops.
pub const FLUX_LEFT_OUT: f64 = 1e-9;

/// A half-light radius below this value is replaced by this value. Even for `n = 8`, almost all
/// light then falls in one pixel.
const SMALLEST_RADIUS_PX: f64 = 1e-9;
/// Along any line, the m-th derivative of the brightness `I` is at most about
/// `I ((k + DERIVATIVE_OFFSET) / r)^m` for the orders used here (up to 8), with
/// `k = -d ln I / d ln r`. The reason is that the derivatives of a power `r^-k` have the factors
/// `k, k + 1 ... k + 7`, whose geometric mean is about `k + 3`.
const DERIVATIVE_OFFSET: f64 = 3.0;

/// Smallest and largest radius in the table of brightness, in units of [`Profile::longest_step`].
/// The table ends at [`Profile::last_radius`] if that is smaller. At other radii the brightness is
/// computed from the formula.
const TABLE_RADII: [f64; 2] = [0.1, 2000.0];

/// `I(r) = central * exp(-b (r / re)^(1/n))` with `r = |(u, v)|`. Here `u` is the pixel offset
/// along the major axis, and `v` is the offset across the major axis divided by the axis ratio.
#[derive(Debug)]
pub(crate) struct Profile {
    /// The galaxy's centre, in pixels of the scene.
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// Central brightness, per pixel, of the profile with flux 1.
    central: f64,
    pub(crate) flux: f64,
    b: f64,
    /// `1 / (2n)`, the exponent of `r^2`.
    half_exponent: f64,
    inverse_index: f64,
    inverse_radius_squared: f64,
    inverse_axis_ratio_squared: f64,
    /// (u, v) of a step of one pixel in x.
    step_x: [f64; 2],
    /// (u, v) of a step of one pixel in y.
    step_y: [f64; 2],
    /// Length in (u, v) of a step of one pixel in x or y, whichever is longer.
    longest_step: f64,
    /// Largest distance in (u, v) from a pixel's centre to its corners.
    pixel_reach: f64,
    /// Radius in (u, v) outside which the fraction [`FLUX_LEFT_OUT`] of the light lies.
    pub(crate) last_radius: f64,
    /// The table is made when it is first needed. A galaxy that does not reach the image never
    /// needs it.
    table: OnceLock<RadialTable>,
}

/// The size of a square compared with the profile around it.
pub(crate) struct Nearness {
    /// The square's size divided by the length over which the profile changes. This length differs
    /// from point to point. The value is an upper limit of the ratio at all points.
    pub(crate) relative_size: f64,
    /// Lower limit of the radii in (u, v) of the square's points.
    pub(crate) radius: f64,
}

impl Profile {
    pub(crate) fn new(galaxy: &SersicSource) -> Self {
        let shape = galaxy.profile();
        let (n, q) = (shape.index(), shape.axis_ratio());
        let re = shape.half_light_radius_px().max(SMALLEST_RADIUS_PX);
        let b = half_light_constant(n);
        let (sin, cos) = shape.angle_deg().to_radians().sin_cos();
        let step_x = [cos, -sin / q];
        let step_y = [sin, cos / q];
        let length = |[u, v]: [f64; 2]| u.hypot(v);
        let diagonal = |sign: f64| length([step_x[0] + sign * step_y[0], step_x[1] + sign * step_y[1]]);
        let total =
            (std::f64::consts::TAU * n * q).ln() + 2.0 * re.ln() - 2.0 * n * b.ln() + ln_gamma(2.0 * n);
        Self {
            x: galaxy.position().x(),
            y: galaxy.position().y(),
            central: (-total).exp(),
            flux: galaxy.flux(),
            b,
            half_exponent: 0.5 / n,
            inverse_index: 1.0 / n,
            inverse_radius_squared: re.recip().powi(2),
            inverse_axis_ratio_squared: q.recip().powi(2),
            step_x,
            step_y,
            longest_step: length(step_x).max(length(step_y)),
            pixel_reach: 0.5 * diagonal(1.0).max(diagonal(-1.0)),
            last_radius: re * (argument_with_outside(n, FLUX_LEFT_OUT) / b).powf(n),
            table: OnceLock::new(),
        }
    }

    /// Returns (u, v) of an offset from the centre in pixels.
    fn turned(&self, dx: f64, dy: f64) -> (f64, f64) {
        (
            dx * self.step_x[0] + dy * self.step_y[0],
            dx * self.step_x[1] + dy * self.step_y[1],
        )
    }

    /// Returns `b (r / re)^(1/n)`.
    fn exponent(&self, r_squared: f64) -> f64 {
        self.b * ((r_squared * self.inverse_radius_squared).ln() * self.half_exponent).exp()
    }

    /// Brightness per pixel at an offset from the centre, for a flux of 1.
    pub(crate) fn brightness(&self, dx: f64, dy: f64) -> f64 {
        let (u, v) = self.turned(dx, dy);
        let r_squared = u * u + v * v;
        match self.table().value(r_squared) {
            Some(brightness) => brightness,
            None => self.computed(r_squared),
        }
    }

    /// Brightness per pixel at a radius in (u, v), for a flux of 1.
    pub(crate) fn brightness_at(&self, radius: f64) -> f64 {
        self.computed(radius * radius)
    }

    fn computed(&self, r_squared: f64) -> f64 {
        self.central * (-self.exponent(r_squared)).exp()
    }

    fn table(&self) -> &RadialTable {
        self.table.get_or_init(|| {
            let [low, high] = TABLE_RADII.map(|radius| radius * self.longest_step);
            RadialTable::new(low * low, high.min(self.last_radius).powi(2), |r_squared| {
                let [brightness, slope, _] = self.derivatives(r_squared);
                (brightness, slope)
            })
        })
    }

    /// Flux in a pixel far from the centre, to second order: `I + (I_xx + I_yy) / 24`, for a flux
    /// of 1.
    pub(crate) fn pixel_flux(&self, dx: f64, dy: f64) -> f64 {
        let (u, v) = self.turned(dx, dy);
        let (u2, v2) = (u * u, v * v);
        let r_squared = u2 + v2;
        let [brightness, first, second] = match self.table().derivatives(r_squared) {
            Some(derivatives) => derivatives,
            None => self.derivatives(r_squared),
        };
        // I_w and I_ww are derivatives with respect to the squared radius w = u^2 + v^2. Then
        // I_uu = 2 I_w + 4 u^2 I_ww, and likewise for v.
        let across = self.inverse_axis_ratio_squared;
        brightness + (2.0 * (1.0 + across) * first + 4.0 * (u2 + across * v2) * second) / 24.0
    }

    /// The brightness and its first two derivatives with respect to the squared radius.
    fn derivatives(&self, r_squared: f64) -> [f64; 3] {
        let exponent = self.exponent(r_squared);
        let brightness = self.central * (-exponent).exp();
        let slope = self.half_exponent * exponent;
        [
            brightness,
            -slope * brightness / r_squared,
            slope * (slope + 1.0 - self.half_exponent) * brightness / (r_squared * r_squared),
        ]
    }

    /// Compares the size of a square with the length over which the profile changes in it. The
    /// square has sides of `size` pixels. Its centre is at (`dx`, `dy`) from the galaxy's centre.
    pub(crate) fn nearness(&self, dx: f64, dy: f64, size: f64) -> Nearness {
        let (u, v) = self.turned(dx, dy);
        let (middle, reach) = (u.hypot(v), self.pixel_reach * size);
        let radius = (middle - reach).max(0.0);
        let slope = self.exponent((middle + reach).powi(2)) * self.inverse_index;
        Nearness {
            relative_size: size * self.longest_step * (slope + DERIVATIVE_OFFSET) / radius,
            radius,
        }
    }
}

/// Returns the `b` for which half of the light lies within `re`: `P(2n, b) = 1/2`, with the
/// regularised lower incomplete gamma function `P`.
fn half_light_constant(n: f64) -> f64 {
    solve_decreasing(|b| gamma_ur(2.0 * n, b) - 0.5, 40.0)
}

/// Returns the exponent `x` at the radius outside which the fraction `outside` of the light lies:
/// `Q(2n, x) = outside`, with `Q = 1 - P`.
fn argument_with_outside(n: f64, outside: f64) -> f64 {
    solve_decreasing(|x| gamma_ur(2.0 * n, x).ln() - outside.ln(), 200.0)
}

/// The zero of a decreasing function between 0 and `limit`, by bisection down to the last bit.
fn solve_decreasing(function: impl Fn(f64) -> f64, limit: f64) -> f64 {
    let (mut low, mut high) = (0.0, limit);
    loop {
        let middle = f64::midpoint(low, high);
        if middle <= low || middle >= high {
            return middle;
        }
        if function(middle) > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
}

/// A [`RadialTable`] has `2^PIECES_LOG2` cubic pieces for each factor of two in the squared radius.
/// A piece's error relative to the brightness is about `(k / 2 / 32)^4 / 384` with
/// `k = -d ln I / d ln r`, which is 6e-7 at `k = 8`.
const PIECES_LOG2: u32 = 5;
/// Number of mantissa bits of a double that give the position within a piece.
const BITS_WITHIN: u32 = 52 - PIECES_LOG2;

/// A function of the squared radius, as a table of cubic pieces. The leading bits of a squared
/// radius (a double) are the number of the piece that contains it.
#[derive(Debug)]
pub(crate) struct RadialTable {
    /// The number of the first piece.
    first: u64,
    /// Coefficients of the powers 0 to 3 of the position within the piece. The position is from 0
    /// to 1.
    pieces: Vec<[f64; 4]>,
}

impl RadialTable {
    /// Makes a table between two squared radii, which must be positive and finite. `function`
    /// returns the value and its derivative with respect to the squared radius.
    pub(crate) fn new(
        lowest_squared: f64,
        highest_squared: f64,
        function: impl Fn(f64) -> (f64, f64),
    ) -> Self {
        let first = lowest_squared.to_bits() >> BITS_WITHIN;
        let last = (highest_squared.to_bits() >> BITS_WITHIN).max(first);
        let start_of = |piece: u64| f64::from_bits(piece << BITS_WITHIN);
        let (mut start, mut at_start) = (start_of(first), function(start_of(first)));
        let pieces = (first..=last).map(|piece| {
            let end = start_of(piece + 1);
            let at_end = function(end);
            let width = end - start;
            let (rise, slope, end_slope) = (at_end.0 - at_start.0, at_start.1 * width, at_end.1 * width);
            let coefficients = [
                at_start.0,
                slope,
                3.0 * rise - 2.0 * slope - end_slope,
                slope + end_slope - 2.0 * rise,
            ];
            (start, at_start) = (end, at_end);
            coefficients
        });
        Self {
            first,
            pieces: pieces.collect(),
        }
    }

    /// Returns the value at a squared radius, or `None` outside the table.
    #[inline]
    pub(crate) fn value(&self, squared: f64) -> Option<f64> {
        let (_, [c0, c1, c2, c3], place) = self.piece(squared)?;
        Some(c0 + place * (c1 + place * (c2 + place * c3)))
    }

    /// Returns the value and its first two derivatives with respect to the squared radius. The
    /// second derivative has a relative error of `(k / 2 / 32)^2 / 12`, which is 1e-3 at
    /// `k = 8`.
    #[inline]
    pub(crate) fn derivatives(&self, squared: f64) -> Option<[f64; 3]> {
        let (piece, [c0, c1, c2, c3], place) = self.piece(squared)?;
        // The width of a piece is a power of two, so its inverse is exact.
        let per_width =
            (f64::from_bits((piece + 1) << BITS_WITHIN) - f64::from_bits(piece << BITS_WITHIN)).recip();
        Some([
            c0 + place * (c1 + place * (c2 + place * c3)),
            (c1 + place * (2.0 * c2 + place * 3.0 * c3)) * per_width,
            (2.0 * c2 + 6.0 * place * c3) * per_width * per_width,
        ])
    }

    /// Returns the piece that contains a squared radius: its number, its coefficients, and the
    /// position within it. Returns `None` outside the table.
    #[inline]
    fn piece(&self, squared: f64) -> Option<(u64, [f64; 4], f64)> {
        const WITHIN: u64 = (1 << BITS_WITHIN) - 1;
        let bits = squared.to_bits();
        let piece = bits >> BITS_WITHIN;
        let index = usize::try_from(piece.wrapping_sub(self.first)).ok()?;
        let place = (bits & WITHIN) as f64 * const { 1.0 / (1_u64 << BITS_WITHIN) as f64 };
        Some((piece, *self.pieces.get(index)?, place))
    }
}

#[cfg(test)]
mod tests {
    use psf_types::{Position, SersicProfile};
    use statrs::function::gamma::gamma_lr;

    use super::*;

    #[test]
    fn half_of_the_light_lies_within_the_half_light_radius() {
        // Known values: n = 0.5 is a Gaussian with b = ln 2. Values for n = 1 and 4 are from Graham
        // and Driver (2005).
        for (n, b, within) in [
            (0.5, std::f64::consts::LN_2, 1e-14),
            (1.0, 1.678_346_990_016_66, 1e-13),
            (4.0, 7.669_249_442_500_8, 1e-12),
        ] {
            assert!(
                (half_light_constant(n) - b).abs() < within,
                "n = {n}: {}",
                half_light_constant(n)
            );
        }
        for n in [0.3, 0.7, 2.5, 8.0] {
            assert!((gamma_lr(2.0 * n, half_light_constant(n)) - 0.5).abs() < 1e-13);
        }
    }

    #[test]
    fn pixel_flux_contains_the_curvature_of_the_brightness() {
        let profile = SersicProfile::new(5.0, 2.3, 0.4, 25.0).unwrap();
        let galaxy = SersicSource::new(Position::of_pixel(0, 0), 1.0, profile).unwrap();
        let profile = Profile::new(&galaxy);
        let (x, y, h) = (17.0, -9.0, 1e-2);
        let at = |dx: f64, dy: f64| profile.brightness(x + dx, y + dy);
        let laplacian = (at(h, 0.0) + at(-h, 0.0) + at(0.0, h) + at(0.0, -h) - 4.0 * at(0.0, 0.0)) / (h * h);
        let curvature = (profile.pixel_flux(x, y) - at(0.0, 0.0)) * 24.0;
        assert!(
            (curvature / laplacian - 1.0).abs() < 1e-4,
            "{curvature} {laplacian}"
        );
    }

    #[test]
    fn the_table_matches_a_power_law_and_returns_none_outside() {
        let table = RadialTable::new(0.3, 1e5, |w| (w.powi(-4), -4.0 * w.powi(-5)));
        for i in 0..1000 {
            let w = 0.3 * (3e5_f64).powf(f64::from(i) / 1000.0);
            let error = table.value(w).unwrap() * w.powi(4) - 1.0;
            assert!(error.abs() < 4e-6, "{w}: {error}");
            let [value, first, second] = table.derivatives(w).unwrap();
            assert_eq!(value, table.value(w).unwrap());
            assert!((first / (-4.0 * w.powi(-5)) - 1.0).abs() < 1e-3);
            assert!((second / (20.0 * w.powi(-6)) - 1.0).abs() < 1e-2);
        }
        for outside in [0.0, 0.2, 1.1e5, f64::INFINITY, f64::NAN, -1.0] {
            assert_eq!(table.value(outside), None);
        }
    }
}
