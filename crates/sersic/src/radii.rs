//! The radii on which the photons of Sersic profiles fall.

use std::cell::RefCell;
use std::sync::OnceLock;

use psf_types::{LightProfile, RadialLight};

use crate::profile::SersicLight;

/// The step in `ln n` between the tables that are computed by integration. The logarithms of other indices
/// are interpolated from the eight nearest of them.
const STEP: f64 = 0.1;
const HALF_SUPPORT: i32 = 4;
/// The first computed table is that of `exp(FIRST * STEP)`. The indices from 0.3 to 8 then have four computed
/// tables on either side.
const FIRST: i32 = -16;
const TABLES: usize = 42;

/// The radii of the profile of index `n` with a half-light radius of 1. The last table of a thread is kept,
/// because catalogues often hold many galaxies of one index.
pub(crate) fn of_index(n: f64) -> RadialLight {
    thread_local! {
        static LAST: RefCell<Option<(f64, RadialLight)>> = const { RefCell::new(None) };
    }
    LAST.with_borrow_mut(|last| match last {
        Some((index, radii)) if *index == n => radii.clone(),
        _ => {
            let radii = interpolated(n);
            *last = Some((n, radii.clone()));
            radii
        }
    })
}

fn interpolated(n: f64) -> RadialLight {
    let place = n.ln() / STEP;
    let below = place.floor() as i32;
    let nodes = below + 1 - HALF_SUPPORT..=below + HALF_SUPPORT;
    let mut sums = vec![[0.0; 2]; computed(below).len()];
    for node in nodes.clone() {
        let others = nodes.clone().filter(|&other| other != node);
        let weight: f64 = others
            .map(|other| (place - f64::from(other)) / f64::from(node - other))
            .product();
        for (sum, value) in sums.iter_mut().zip(computed(node)) {
            *sum = [sum[0] + weight * value[0], sum[1] + weight * value[1]];
        }
    }
    RadialLight::from_logarithms(&sums, 1.0)
}

/// The logarithms ([`RadialLight::logarithms`]) of the index `exp(node * STEP)`, computed when first needed.
fn computed(node: i32) -> &'static [[f64; 2]] {
    static COMPUTED: [OnceLock<Vec<[f64; 2]>>; TABLES] = [const { OnceLock::new() }; TABLES];
    COMPUTED[(node - FIRST) as usize].get_or_init(|| {
        let light = SersicLight::of_index((f64::from(node) * STEP).exp());
        RadialLight::logarithms(&|radius| light.brightness(radius), 1.0)
    })
}

#[cfg(test)]
mod tests {
    use psf_types::{Position, SersicProfile, SersicSource};

    use super::*;

    /// Documented error of the light within an interpolated radius.
    const ERROR: f64 = 1e-6;

    #[test]
    fn the_light_within_the_radii_is_that_of_the_profile() {
        for n in [0.3, 0.5, 0.77, 1.0, 1.93, 2.5, 4.0, 6.1, 8.0] {
            let profile = SersicProfile::new(2.5, n, 0.4, 20.0).unwrap();
            let light = SersicLight::new(&SersicSource::new(Position::of_pixel(0, 0), 1.0, profile).unwrap());
            let radii = light.radial_light();
            for i in 0..3000 {
                let s = f64::from(i).mul_add(0.006, -14.0).exp().min(31.9);
                let (x, y) = radii.offset(0.6 * s.sqrt(), 0.8 * s.sqrt());
                let error = light.flux_beyond(x.hypot(y)) - (-0.5 * s).exp();
                assert!(error.abs() < ERROR, "n = {n}, s = {s}: {error:e}");
            }
        }
    }
}
