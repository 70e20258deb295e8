//! The floor allows to leave out parts of a galaxy's image: it has a smaller window and fewer wavenumbers.

use ndarray::{Array2, ArrayView1, ArrayView2};
use psf_types::{LightProfile, StampGrid};

use super::extent::SIDES;
use super::far_field::{farthest_edge, nearest_edge};
use crate::dropped_light::{DroppedLight, SQUARE};
use crate::view::region;

/// Upper limits of the light of a block's PSFs far from their centre, for a flux of 1.
#[derive(Debug)]
pub(super) struct PsfOutskirts {
    /// The largest value per frame pixel at a distance of at least `i` pixels along x or y.
    brightest: Vec<f64>,
    /// The flux of a typical PSF at such distances.
    beyond: Vec<f64>,
    /// The L2 norm on the frame's pixels.
    norm: f64,
}

/// The window and the wavenumbers of a galaxy that is drawn within the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WithinFloor {
    /// The side of the window.
    pub(super) side: usize,
    /// Up to this distance, light outside the window is drawn.
    pub(super) reach: Option<f64>,
    /// Light at wavenumbers that are left out is at most this part of the image, in the L2 norm.
    pub(super) accuracy: f64,
}

/// A galaxy has errors of at most this part of the floor from its window.
const OF_WINDOW: f64 = 0.9;
/// And of at most this part from wavenumbers that are left out.
const OF_WAVENUMBERS: f64 = 0.1;
/// The period of a window brings in the light of its neighbours. Together they are at most so many times as
/// bright as the image at the window's edge.
const NEIGHBOURS: f64 = 4.0;
/// The least part of the light that is drawn.
const LEAST_LIGHT: f64 = 0.9;
/// The largest error by wavenumbers that are left out, relative to the image in the L2 norm.
const LARGEST_ERROR: f64 = 1e-2;
/// Interpolated values exceed the values of a stamp by at most about this factor.
const OVERSHOOT: f64 = 1.5;
/// The limits of dropped light are computed at the edge of the window and at so many distances, each twice the
/// one before.
const DISTANCES: usize = 3;
/// Light far out comes from the PSF, or from the galaxy at these parts of the distance.
const PARTS: [f64; 4] = [0.5, 0.3, 0.75, 0.15];

impl PsfOutskirts {
    /// `stamps` are `[stamp, pixel]`, `directions` `[PSF, stamp]`. Each PSF counts with its largest
    /// coefficient, for a flux of 1. `typical` is one of the combinations.
    pub(super) fn new(
        (stamps, grid): (ArrayView2<'_, f64>, StampGrid),
        directions: &Array2<f64>,
        largest: &[f64],
        typical: ArrayView1<'_, f64>,
    ) -> Self {
        let s = grid.oversampling();
        let mut limits = vec![0.0_f64; grid.pixel_count()];
        for (psf, largest) in directions.dot(&stamps).outer_iter().zip(largest) {
            for (limit, v) in limits.iter_mut().zip(psf) {
                *limit += (v * largest).abs();
            }
        }
        let typical = typical.dot(&stamps);
        let flux = typical.sum();
        let side = |centre: f64, count: usize| centre.max((count - 1) as f64 - centre) / s;
        let half = side(grid.centre_x(), grid.nx()).max(side(grid.centre_y(), grid.ny()));
        let mut brightest = vec![0.0_f64; half.ceil() as usize + 2];
        let mut beyond = vec![0.0; brightest.len()];
        let mut squares = 0.0;
        for (index, (value, limit)) in typical.iter().zip(limits).enumerate() {
            let (j, i) = (index / grid.nx(), index % grid.nx());
            let (x, y) = ((i as f64 - grid.centre_x()) / s, (j as f64 - grid.centre_y()) / s);
            // Interpolation spreads a value over the pixels of the stamp next to it.
            let distance = (x.abs().max(y.abs()) + 2.0 / s).floor() as usize;
            let at = distance.min(brightest.len() - 1);
            brightest[at] = brightest[at].max(OVERSHOOT * limit);
            beyond[at] += value / flux;
            squares += (value / flux * s * s).powi(2) / (s * s);
        }
        for i in (1..brightest.len()).rev() {
            brightest[i - 1] = brightest[i - 1].max(brightest[i]);
            beyond[i - 1] += beyond[i];
        }
        Self {
            brightest,
            beyond,
            norm: squares.sqrt(),
        }
    }

    fn brightest_at(&self, distance: f64) -> f64 {
        self.brightest
            .get(distance.max(0.0) as usize)
            .copied()
            .unwrap_or(0.0)
    }

    /// Upper limits of the image of a galaxy of flux 1 at a distance from its centre along x or y, one for each
    /// part of the distance. Each of them holds.
    fn limits_at<'a>(&'a self, light: &'a dyn LightProfile, distance: f64) -> impl Iterator<Item = f64> + 'a {
        PARTS.into_iter().map(move |part| {
            let of_psf = self.brightest_at((1.0 - part) * distance);
            let of_light = light.flux_beyond(part * distance) * self.brightest[0];
            of_psf + of_light.min(light.outskirts(part * distance).brightness)
        })
    }

    /// The lowest of these limits.
    fn image_at(&self, light: &dyn LightProfile, distance: f64) -> f64 {
        self.limits_at(light, distance).fold(self.brightest[0], f64::min)
    }

    /// Upper limits of the part of a galaxy's light farther than this along x or y. Each of them holds.
    fn limits_beyond<'a>(
        &'a self,
        light: &'a dyn LightProfile,
        distance: f64,
    ) -> impl Iterator<Item = f64> + 'a {
        PARTS.into_iter().map(move |part| {
            let of_psf = self.beyond.get(((1.0 - part) * distance) as usize);
            of_psf.copied().unwrap_or(0.0).abs() + light.flux_beyond(part * distance)
        })
    }

    /// An upper limit of the L2 norm of a galaxy's image, for a flux of 1.
    fn norm_with(&self, light: &dyn LightProfile) -> f64 {
        self.norm.min(light.squared_norm().sqrt())
    }
}

impl WithinFloor {
    /// The image of a galaxy whose light per pixel, for a flux of 1, may be `floor` lower. `whole` is how the
    /// galaxy is drawn without a floor.
    pub(super) fn new(whole: Self, light: &dyn LightProfile, psf: &PsfOutskirts, floor: f64) -> Self {
        let fits = |&side: &usize| {
            let edge = nearest_edge(side);
            let mut images = psf.limits_at(light, edge);
            images.any(|image| NEIGHBOURS * image <= OF_WINDOW * floor)
                && psf
                    .limits_beyond(light, edge)
                    .any(|beyond| beyond <= 1.0 - LEAST_LIGHT)
        };
        let of_norm = OF_WAVENUMBERS * floor / psf.norm_with(light);
        let accuracy = of_norm.min(LARGEST_ERROR).max(whole.accuracy);
        let largest = if whole.reach.is_some() {
            whole.side
        } else {
            whole.side - 1
        };
        let side = SIDES.into_iter().take_while(|&side| side <= largest).find(fits);
        if let Some(side) = side {
            return Self {
                side,
                reach: None,
                accuracy,
            };
        }
        let reach = whole.reach.map(|most| {
            let mut reach = whole.side as f64;
            while reach < most && psf.image_at(light, reach) > OF_WINDOW * floor {
                reach *= 1.25;
            }
            reach.min(most)
        });
        Self {
            reach,
            accuracy,
            ..whole
        }
    }

    /// Adds the light that a galaxy of a flux drops at most, within `floor`.
    pub(super) fn add_dropped(
        &self,
        whole: &Self,
        ((x, y), flux, light): ((f64, f64), f64, &dyn LightProfile),
        (psf, floor, farthest): (&PsfOutskirts, f64, f64),
        dropped: &mut DroppedLight,
    ) {
        if self == whole {
            return dropped.count(flux, 0.0);
        }
        let is_smaller = (self.side, self.reach) != (whole.side, whole.reach);
        let mut of_wavenumbers = 0.0;
        if self.accuracy > whole.accuracy {
            of_wavenumbers = self.accuracy * psf.norm_with(light);
        }
        // Up to these distances, no more than these limits are dropped.
        let mut limits = [(f64::INFINITY, 0.0); DISTANCES];
        if is_smaller {
            let drawn = self.reach.unwrap_or_else(|| nearest_edge(self.side));
            let beyond = psf.limits_beyond(light, drawn).fold(1.0, f64::min);
            dropped.count(flux, beyond);
            let mut from = drawn;
            for (to, limit) in &mut limits {
                *limit = psf.image_at(light, from);
                from *= 2.0;
                *to = from;
            }
            if self.reach.is_none() {
                limits[0].1 *= NEIGHBOURS;
            }
        } else {
            dropped.count(flux, 0.0);
        }
        let half = if is_smaller {
            farthest
        } else {
            farthest_edge(self.side)
        };
        let first = |at: f64| (at - half).floor() as i64;
        let side = (2.0 * half).ceil() as usize + 1;
        dropped.add(region(first(x), first(y), (side, side)), |column, row| {
            let away = |at: f64, first: i64| {
                let (first, last) = (first as f64 - at, (first + SQUARE - 1) as f64 - at);
                first.max(-last)
            };
            let distance = away(x, column).max(away(y, row));
            let outside = limits
                .iter()
                .find(|(to, _)| distance < *to)
                .unwrap_or(&limits[DISTANCES - 1]);
            (flux.abs() * (outside.1 + of_wavenumbers)).min(floor)
        });
    }
}
