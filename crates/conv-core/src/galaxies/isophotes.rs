//! The shape of the isophotes of extended sources.

use psf_types::{LightProfile, RadialLight};

/// The linear map from the offsets of a round profile to those of a profile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Isophotes {
    pub(crate) xx: f64,
    pub(crate) xy: f64,
    pub(crate) yy: f64,
}

impl Isophotes {
    pub(crate) fn of(light: &dyn LightProfile) -> Self {
        // The squared radius of an isophote is a quadratic form. Its Cholesky factor maps the isophote to a
        // circle, and the inverse of its transpose maps back.
        let square = |dx: f64, dy: f64| light.radius(dx, dy).powi(2);
        let (xx, yy) = (square(1.0, 0.0), square(0.0, 1.0));
        let xy = 0.5 * (square(1.0, 1.0) - xx - yy);
        let first = xx.sqrt();
        let along = xy / first;
        let second = (yy - along * along).sqrt();
        Self {
            xx: 1.0 / first,
            xy: -along / (first * second),
            yy: 1.0 / second,
        }
    }

    #[inline(always)]
    pub(crate) fn offset(&self, (a, b): (f64, f64)) -> (f64, f64) {
        (self.xx * a + self.xy * b, self.yy * b)
    }
}

/// Rings of points, and points of a ring, that represent a profile.
const RINGS: usize = 4;
const ON_RING: usize = 8;

/// Offsets of points that represent a profile, each with an equal part of its light. The rings of points divide
/// the light into parts, and each ring lies on the isophote that halves its part.
pub(crate) fn representative_points(light: &dyn LightProfile) -> Vec<(f64, f64)> {
    let (shape, radii): (Isophotes, RadialLight) = (Isophotes::of(light), light.radial_light());
    let ring = |ring: usize| {
        let within = (ring as f64 + 0.5) / RINGS as f64;
        let radius = (-2.0 * (1.0 - within).ln()).sqrt();
        (0..ON_RING).map(move |i| {
            // Points of a ring lie between those of its neighbours.
            let turn = (i as f64 + 0.5 * (ring % 2) as f64) / ON_RING as f64;
            let (b, a) = (std::f64::consts::TAU * turn).sin_cos();
            (radius * a, radius * b)
        })
    };
    (0..RINGS)
        .flat_map(ring)
        .map(|(a, b)| shape.offset(radii.offset(a, b)))
        .collect()
}
