//! The sizes of windows, and the distance up to which a galaxy is drawn.

use ndarray::{Array1, ArrayViewMut1, Axis};
use psf_types::{LightProfile, PsfModel, StampGrid};

use super::far_field::{SMALLEST, TILE, error_of_polynomial, farthest_edge, nearest_edge};

/// Decides how far galaxies are drawn in each way, from the tolerance and the extent of a model's
/// PSFs.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extent {
    tolerance: f64,
    /// The largest distance of a stamp's edge from its centre, in frame pixels.
    half: f64,
    /// The largest value, per frame pixel, of the mean PSF.
    peak: f64,
    /// The largest value at the stamp's edge, as a fraction of the peak.
    edge: f64,
    /// The fourth root of the mean fourth power of the light's distance from the centre along a
    /// line: along x, y or a diagonal, whichever is largest.
    spread: f64,
}

/// The sides of windows in pixels, which have fast transforms.
pub(super) const SIDES: [usize; 19] = [
    32, 48, 64, 80, 96, 128, 160, 192, 240, 320, 384, 480, 640, 768, 960, 1280, 1536, 1920, 2560,
];
/// The errors of a galaxy beside that of its PSF are about this fraction of the tolerance times the
/// galaxy's peak.
pub(super) const FRACTION: f64 = 0.3;
/// Light is left out from the distance on beyond which less than this fraction of the tolerance
/// lies.
const LEFT_OUT: f64 = 0.1;
/// The least error of a galaxy relative to its peak for which a window is chosen.
const LEAST_ACCURACY: f64 = 1e-8;
/// The least fraction of the flux that may be left out.
const LEAST_LEFT_OUT: f64 = 1e-9;
/// A window smaller than [`LARGE_SIDE`] is enlarged if the light outside would need blocks smaller
/// than this, in pixels. Drawing such blocks takes longer than a larger window.
const USUAL_BLOCK: f64 = 16.0;
const LARGE_SIDE: usize = 128;
/// The least and the largest error of the light outside a window, relative to this light. The light
/// is computed in single precision.
pub(super) const RELATIVE_ERROR: [f64; 2] = [1e-6, 5e-2];
/// The relative rounding of the light that the periods of a window bring in from outside.
const ROUNDING: f64 = 3e-7;
/// The brightness of this light is at most so many times the galaxy's peak: fewer times if the
/// tolerance is tight. Then its rounding and the errors of its sum are small beside the peak.
const BRIGHTEST_REPEATED: [f64; 2] = [1.0, 30.0];
/// The flux of such an error is at most this part of what it would be without changes of sign.
const OSCILLATING: f64 = 10.0;
/// Light is drawn at most up to this distance, in pixels.
const FARTHEST: f64 = 1e6;
/// Interpolated stamps reach about this many frame pixels beyond their outermost pixels.
const BEYOND: f64 = 3.0;

impl Extent {
    /// For stamps that are truncated to `size` frame pixels along each side, if it is given.
    pub(super) fn new(model: &PsfModel, size: Option<usize>, tolerance: f64) -> Self {
        let grid = model.grid();
        let s = grid.oversampling();
        let mut first: Array1<f64> = model.stamps().index_axis(Axis(0), 0).iter().copied().collect();
        if let Some(size) = size {
            truncate(first.view_mut(), grid, size);
        }
        // Without a mean, the first component is nearly the mean PSF, times a factor.
        let flux = first.sum() / (s * s);
        let values = if flux == 0.0 { first } else { first / flux };
        let side = |centre: f64, count: usize| centre.max((count - 1) as f64 - centre) / s;
        let half = side(grid.centre_x(), grid.nx()).max(side(grid.centre_y(), grid.ny()));
        let half = size.map_or(half, |size| half.min(0.5 * size as f64));
        let (mut peak, mut edge, mut total) = (0.0_f64, 0.0_f64, 0.0);
        let mut fourth = [0.0; 4];
        for (index, v) in values.iter().enumerate() {
            let (j, i, v) = (index / grid.nx(), index % grid.nx(), v.abs());
            let (x, y) = ((i as f64 - grid.centre_x()) / s, (j as f64 - grid.centre_y()) / s);
            peak = peak.max(v);
            if x.abs().max(y.abs()) > half - 1.0 {
                edge = edge.max(v);
            }
            let diagonals = [x + y, x - y].map(|d| d * std::f64::consts::FRAC_1_SQRT_2);
            for (sum, d) in fourth.iter_mut().zip([x, y].into_iter().chain(diagonals)) {
                *sum += v * d.powi(4);
            }
            total += v;
        }
        Self {
            tolerance,
            half: half + BEYOND,
            peak: peak.max(f64::MIN_POSITIVE),
            edge: edge / peak.max(f64::MIN_POSITIVE),
            spread: (fourth.into_iter().fold(0.0, f64::max) / total.max(f64::MIN_POSITIVE))
                .sqrt()
                .sqrt(),
        }
    }

    /// The error of a galaxy's image beside that of its PSF, relative to its peak.
    pub(super) fn accuracy(&self) -> f64 {
        FRACTION * self.tolerance
    }

    /// The error of a galaxy's image, relative to its peak, for which windows are chosen.
    fn least_accuracy(&self) -> f64 {
        self.accuracy().max(LEAST_ACCURACY)
    }

    /// The least peak of a galaxy's image, for a flux of 1.
    fn peak_of(&self, light: &dyn LightProfile) -> f64 {
        // The peak of the galaxy's image is at least about the light within the PSF's core times
        // the PSF's peak.
        let peak = self.peak;
        let core = (std::f64::consts::TAU * peak).sqrt().recip();
        peak * (0.5 * (1.0 - light.flux_beyond(core))).max(f64::MIN_POSITIVE)
    }

    /// The side of a galaxy's window, and the distance up to which light outside the window is drawn.
    /// `None` if there is too little of it.
    pub(super) fn side_and_reach(&self, light: &dyn LightProfile) -> (usize, Option<f64>) {
        let side = self.side(light);
        (side, self.reach(light, side))
    }

    /// The smallest side of a window outside which the image of a galaxy is its light.
    fn side(&self, light: &dyn LightProfile) -> usize {
        let Self {
            half,
            peak,
            edge,
            spread,
            ..
        } = *self;
        let at_peak = self.peak_of(light);
        let allowed = self.least_accuracy() * at_peak;
        let [least, most] = BRIGHTEST_REPEATED;
        let brightest_repeated = (self.accuracy() / ROUNDING).clamp(least, most) * at_peak;
        let fits = |side: usize| {
            let distance = nearest_edge(side);
            let room = distance - half;
            if room < 2.0 || peak * edge * light.flux_beyond(room) > allowed {
                return false;
            }
            let beyond = light.flux_beyond(distance);
            if beyond > brightest_repeated * (side * side) as f64 {
                return false;
            }
            let outskirts = light.outskirts(distance);
            if side < LARGE_SIDE
                && beyond > self.left_out()
                && error_of_polynomial(USUAL_BLOCK / outskirts.scale_px) > RELATIVE_ERROR[1]
            {
                return false;
            }
            let t = spread / outskirts.scale_px;
            outskirts.brightness * (t.powi(4) / 24.0).min(1.0) <= allowed
        };
        SIDES
            .into_iter()
            .find(|&side| fits(side))
            .unwrap_or(SIDES[SIDES.len() - 1].max((2.0 * half) as usize / SMALLEST * SMALLEST + 4 * SMALLEST))
    }

    /// The fraction of a galaxy's flux that may be left out.
    pub(super) fn left_out(&self) -> f64 {
        (LEFT_OUT * self.tolerance).max(LEAST_LEFT_OUT)
    }

    /// The distance up to which light outside a window of a side is drawn, at least this side.
    fn reach(&self, light: &dyn LightProfile, side: usize) -> Option<f64> {
        let left_out = self.left_out();
        let mut reach = nearest_edge(side);
        if light.flux_beyond(reach) <= left_out {
            return None;
        }
        while reach < FARTHEST && light.flux_beyond(reach) > left_out {
            reach *= 1.25;
        }
        Some(reach.max(side as f64))
    }

    /// The distance up to which pixels may be drawn. Light outside the window is drawn on whole
    /// blocks, around the centroid of the PSF.
    pub(super) fn farthest(&self, side: usize, reach: Option<f64>) -> f64 {
        reach.map_or(farthest_edge(side), |reach| reach + TILE as f64 + self.half)
    }

    /// Whether a PSF's centroid and its covariance (xx, xy, yy) lie within the stamp.
    pub(super) fn holds(&self, (x, y): (f64, f64), covariance: [f64; 3]) -> bool {
        x.abs().max(y.abs()) <= self.half && covariance.iter().all(|v| v.abs() <= self.half * self.half)
    }

    /// The light of a galaxy outside a window of a side, and the errors that are allowed there.
    pub(super) fn outside(&self, light: &dyn LightProfile, side: usize) -> Outside {
        let edge = nearest_edge(side);
        let (flux, brightness) = (light.flux_beyond(edge), light.outskirts(edge).brightness);
        let allowed = self.least_accuracy() * self.peak_of(light);
        // The error of a polynomial changes its sign several times on a block.
        let of_flux = OSCILLATING * self.left_out() / flux;
        let [least, most] = RELATIVE_ERROR;
        Outside {
            flux,
            brightness,
            relative_error: (allowed / brightness).min(of_flux).clamp(least, most),
            repeated_error: (allowed * (side * side) as f64).min(self.left_out()),
        }
    }
}

/// The light of a galaxy of unit flux outside its window, and its errors.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outside {
    /// An upper limit of the flux outside the window.
    pub(super) flux: f64,
    /// The largest brightness at the window's edge.
    pub(super) brightness: f64,
    /// Largest error of the polynomial of a block relative to the brightest light in it.
    pub(super) relative_error: f64,
    /// Largest error of the flux that the period of the window brings in from outside.
    pub(super) repeated_error: f64,
}

/// Sets the values of a stamp to 0 that lie outside a square of `size` frame pixels.
pub(crate) fn truncate(mut stamp: ArrayViewMut1<'_, f64>, grid: StampGrid, size: usize) {
    let (s, from, to) = (
        grid.oversampling(),
        (size / 2) as f64,
        (size - 1 - size / 2) as f64,
    );
    for (index, v) in stamp.iter_mut().enumerate() {
        let (j, i) = (index / grid.nx(), index % grid.nx());
        let (x, y) = ((i as f64 - grid.centre_x()) / s, (j as f64 - grid.centre_y()) / s);
        if x < -from - 0.5 || y < -from - 0.5 || x > to + 0.5 || y > to + 0.5 {
            *v = 0.0;
        }
    }
}
