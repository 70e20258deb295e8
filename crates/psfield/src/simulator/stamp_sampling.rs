//! Measures how well the stamps of a model can be interpolated between their pixels.

use conv_core::StampInterpolator;
use ndarray::{Array1, Array2, Zip, s};
use psf_types::maths::sinc;
use psf_types::{DataError, Position, PsfModel, StampGrid};

/// The largest distance from the source, in stamp pixels, of the part of a stamp that is judged. The
/// finest structure of a PSF is in its core, and the work must not grow with the stamp.
const MOST_PIXELS: usize = 48;

/// The part of a stamp that fades to 0 at each edge. A sharp edge would have power at all frequencies.
const FADING: usize = 8;

/// The numbers of sub-pixel phases, a quarter of a stamp pixel apart: over one stamp pixel, and over
/// several if frame pixels have a broken number of stamp pixels. Errors then also depend on the phase
/// of the frame's pixels.
const PHASES: [usize; 2] = [4, 16];

/// The errors that the interpolation of stamps between their pixels adds to stars, at the worst of many
/// positions within a pixel.
///
/// The interpolated stamp is compared with the sum of sinc functions through the pixels of the stamp.
/// This sum is exact for a PSF without power above the stamps' Nyquist frequency. The errors come from
/// the power below that frequency, where the kernel is not 1, and from its images above it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SamplingErrors {
    /// Error of a star's total flux, relative.
    pub flux: f64,
    /// Error of the flux that a fit of the exact PSF finds: `sum e h / sum h^2` for the PSF `h` and its
    /// error `e`, over frame pixels.
    pub fitted_flux: f64,
    /// Error of the position that such a fit finds, in frame pixels: `-sum e h' / sum h'^2` along x and
    /// y, with the derivative `h'`.
    pub position_px: f64,
}

impl SamplingErrors {
    /// The largest errors of a model's PSFs at some positions. Positions where the PSF is not known do
    /// not count. The work does not depend on the size of the stamps.
    pub(super) fn of_model(model: &PsfModel, positions: &[Position]) -> Result<Self, DataError> {
        let axes = Axes::new(model.grid())?;
        let [x, y] = axes.pixels.clone();
        let mut coefficients = vec![0.0; model.stamp_count()];
        let mut largest = Self::default();
        for &position in positions {
            if model
                .scaled_coefficients_into(position, &mut coefficients)
                .is_err()
            {
                continue;
            }
            let mut psf = Array2::zeros((y.len(), x.len()));
            for (&a, stamp) in coefficients.iter().zip(model.stamps().outer_iter()) {
                psf.scaled_add(a, &stamp.slice(s![y.clone(), x.clone()]));
            }
            largest = largest.max(axes.errors(&psf));
        }
        Ok(largest)
    }

    /// The larger of each error.
    pub(super) fn max(self, other: Self) -> Self {
        Self {
            flux: self.flux.max(other.flux),
            fitted_flux: self.fitted_flux.max(other.fitted_flux),
            position_px: self.position_px.max(other.position_px),
        }
    }
}

/// The part of stamps that is judged, and the frame pixels at which they are interpolated.
struct Axes {
    /// Pixels of the stamps along x and y.
    pixels: [std::ops::Range<usize>; 2],
    /// Their grid.
    grid: StampGrid,
    /// Frame pixels around the source.
    frame: StampGrid,
    /// The factors along x and y that fade at the edges.
    fading: [Array1<f64>; 2],
}

/// The sinc functions of stamp pixels and their derivatives at frame pixels, `[frame pixel, stamp pixel]`.
struct Sincs {
    values: Array2<f64>,
    slopes: Array2<f64>,
}

impl Axes {
    fn new(stamps: StampGrid) -> Result<Self, DataError> {
        let around = |centre: f64, count: usize| {
            let middle = (centre.round().max(0.0) as usize).min(count - 1);
            middle.saturating_sub(MOST_PIXELS)..(middle + MOST_PIXELS + 1).min(count)
        };
        let pixels = [
            around(stamps.centre_x(), stamps.nx()),
            around(stamps.centre_y(), stamps.ny()),
        ];
        let [x, y] = [&pixels[0], &pixels[1]];
        let centre = (
            stamps.centre_x() - x.start as f64,
            stamps.centre_y() - y.start as f64,
        );
        let s = stamps.oversampling();
        let grid = stamps
            .with_size(x.len(), y.len())?
            .with_centre(centre.0, centre.1)?;
        // One more frame pixel on each side, for the shift within a pixel and the edges of the kernel.
        let side = |count: usize| 2 * ((count as f64 / s).ceil() as usize + 1) + 1;
        let frame = StampGrid::new(side(x.len()), side(y.len()))?
            .with_pixel_response_included(stamps.pixel_response_included());
        let fading = [x.len(), y.len()].map(|count| {
            let edge = count / FADING;
            Array1::from_shape_fn(count, |i| match i.min(count - 1 - i) {
                inner if inner >= edge => 1.0,
                outer => {
                    let part = (outer + 1) as f64 / (edge + 1) as f64;
                    (std::f64::consts::FRAC_PI_2 * part).sin().powi(2)
                }
            })
        });
        Ok(Self {
            pixels,
            grid,
            frame,
            fading,
        })
    }

    /// The sinc functions along x (0) or y (1) for a source shifted by a part of a frame pixel.
    fn sincs(&self, axis: usize, shift: f64) -> Sincs {
        let (grid, frame, s) = (self.grid, self.frame, self.grid.oversampling());
        let (count, centre, from) = match axis {
            0 => (grid.nx(), grid.centre_x(), (frame.nx(), frame.centre_x())),
            _ => (grid.ny(), grid.centre_y(), (frame.ny(), frame.centre_y())),
        };
        let distance = |i: usize, n: usize| centre + s * (i as f64 - from.1 - shift) - n as f64;
        Sincs {
            values: Array2::from_shape_fn((from.0, count), |(i, n)| sinc(distance(i, n))),
            slopes: Array2::from_shape_fn((from.0, count), |(i, n)| s * slope(distance(i, n))),
        }
    }

    /// The largest errors of a stamp over the phases.
    fn errors(&self, psf: &Array2<f64>) -> SamplingErrors {
        let [along_x, along_y] = &self.fading;
        let psf = psf * &along_y.view().insert_axis(ndarray::Axis(1)) * along_x;
        let kernel = StampInterpolator::new(psf.view(), self.grid);
        let flux = self.grid.flux_of_sum(psf.sum());
        let s = self.grid.oversampling();
        let phases = PHASES[usize::from(s.fract() != 0.0)];
        let mut largest = SamplingErrors::default();
        for phase in 0..phases {
            // Equal shifts along x and y, because the errors of both axes add up.
            let shift = (phase as f64 / (4.0 * s)).fract();
            let (x, y) = (self.sincs(0, shift), self.sincs(1, shift));
            let rows = y.values.dot(&psf);
            let exact = rows.dot(&x.values.t());
            let slopes = [rows.dot(&x.slopes.t()), y.slopes.dot(&psf).dot(&x.values.t())];
            let interpolated = kernel.resample((shift, shift), self.frame);
            let error = &interpolated - &exact;
            let part_of = |shape: &Array2<f64>| {
                let (mut product, mut square) = (0.0, 0.0);
                Zip::from(&error).and(shape).for_each(|e, h| {
                    product += e * h;
                    square += h * h;
                });
                product / square
            };
            let [dx, dy] = [part_of(&slopes[0]), part_of(&slopes[1])];
            // Of stamps that hold power above their Nyquist frequency, the sinc functions have an error of
            // their own, while the kernel may keep the flux.
            let of_flux = error.sum().abs().min((interpolated.sum() - flux).abs());
            let found = SamplingErrors {
                flux: of_flux / flux.abs(),
                fitted_flux: part_of(&exact).abs(),
                position_px: dx.hypot(dy),
            };
            // `max` ignores NaN, which a PSF without flux has.
            largest = largest.max(found);
        }
        largest
    }
}

/// The derivative of [`sinc`].
fn slope(t: f64) -> f64 {
    /// Below this distance, the first term of the series is exact to rounding.
    const SMALL: f64 = 1e-5;
    if t.abs() < SMALL {
        return -std::f64::consts::PI.powi(2) * t / 3.0;
    }
    ((std::f64::consts::PI * t).cos() - sinc(t)) / t
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaussian(oversampling: f64, fwhm_px: f64) -> (Array2<f64>, StampGrid) {
        /// An average over a frame pixel is a sum of so many points.
        const POINTS: usize = 40;
        let side = (16.0 * oversampling) as usize / 2 * 2 + 1;
        let grid = StampGrid::new(side, side)
            .unwrap()
            .with_oversampling(oversampling)
            .unwrap();
        // The width of the Gaussian that is convolved with a pixel, in quadrature.
        let sigma = (fwhm_px / 2.354_82) * oversampling;
        let middle = (side / 2) as f64;
        let along = |i: usize| -> f64 {
            (0..POINTS)
                .map(|p| {
                    let within = ((p as f64 + 0.5) / POINTS as f64 - 0.5) * oversampling;
                    (-0.5 * ((i as f64 - middle + within) / sigma).powi(2)).exp()
                })
                .sum()
        };
        (
            Array2::from_shape_fn((side, side), |(y, x)| along(y) * along(x)),
            grid,
        )
    }

    /// The figures of a computation in Python with dense matrices of the spline (SciPy).
    #[test]
    fn the_errors_are_those_of_an_independent_computation() {
        /// Its crop fades over other pixels.
        const ROOM: f64 = 0.2;
        for (oversampling, fwhm_px, flux, fitted_flux, along_x) in [
            (1.0, 2.0, 0.0, 1.2e-2, 7.7e-3),
            (1.5, 2.0, 4.5e-3, 4.5e-3, 1.4e-3),
            (2.0, 2.0, 0.0, 4.5e-4, 2.4e-4),
            (2.5, 2.0, 3.4e-4, 4.0e-4, 1.3e-4),
            (3.0, 2.0, 0.0, 8.4e-5, 2.9e-5),
            (2.0, 1.5, 0.0, 1.3e-3, 1.7e-3),
        ] {
            let (psf, grid) = gaussian(oversampling, fwhm_px);
            let found = Axes::new(grid).unwrap().errors(&psf);
            for (found, expected) in [
                (found.flux, flux),
                (found.fitted_flux, fitted_flux),
                (found.position_px, along_x * std::f64::consts::SQRT_2),
            ] {
                let near = (found - expected).abs() <= ROOM * expected + 1e-5;
                assert!(near, "{oversampling} {fwhm_px}: {found:e}, not {expected:e}");
            }
        }
    }

    #[test]
    fn a_psf_without_flux_has_no_errors_that_are_not_finite() {
        let grid = StampGrid::new(9, 9).unwrap();
        let none = Axes::new(grid).unwrap().errors(&Array2::zeros((9, 9)));
        assert_eq!(none, SamplingErrors::default());
    }
}
