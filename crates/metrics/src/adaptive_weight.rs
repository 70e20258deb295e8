//! The weight of adaptive moments, the moments under it, and the steps that improve it.

use nalgebra::{SMatrix, SVector};

use crate::gaussian_rows::{GaussianRow, MONOMIALS, MonomialSums, UnitGaussian, reach};
use crate::window::Cutout;
use crate::{Covariance, MetricsError};

/// A narrower weight covers only one pixel.
const SMALLEST_SIGMA_PX: f64 = 0.2;
/// Largest change of `M` in one step relative to its smaller eigenvalue, and of the centroid
/// relative to sigma.
const LARGEST_STEP: f64 = 0.25;
/// Derivatives of the mismatch of a Gaussian by the steps of its weight, with the opposite sign: the
/// diagonal of a matrix.
const GAUSSIAN: [f64; 5] = [0.5, 0.5, 0.125, 0.25, 0.125];

/// Checks the sigmas of a weight. The larger sigma may be at most `slack * largest_px`, where
/// `largest_px` is the limit for a result.
pub(crate) fn check_width(m: Covariance, slack: f64, largest_px: f64) -> Result<(), MetricsError> {
    if m.sigma_minor_px() < SMALLEST_SIGMA_PX {
        return Err(MetricsError::WeightCollapsed {
            sigma_px: m.sigma_minor_px(),
        });
    }
    if m.sigma_major_px() > slack * largest_px {
        return Err(MetricsError::WidthOutOfRange {
            major_px: m.sigma_major_px(),
            minor_px: m.sigma_minor_px(),
            smallest_px: SMALLEST_SIGMA_PX,
            largest_px,
        });
    }
    Ok(())
}

/// The centre and the covariance of a weight, in pixels of the cutout.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Weight {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) m: Covariance,
}

/// A step of a weight: of `x` and `y` in units of its smaller sigma, then of `Mxx`, `Mxy` and `Myy`
/// in units of the square of that sigma.
type Step = [f64; 5];

impl Weight {
    fn gaussian(&self) -> UnitGaussian {
        let height = self.m.yy().sqrt();
        let root = self.m.determinant().sqrt();
        UnitGaussian {
            x: self.x,
            y: self.y,
            lxx: height / root,
            lyx: -self.m.xy() / (height * root),
            lyy: 1.0 / height,
        }
    }

    /// Converts a step from the coordinates `(u, v)` of the weight, in which its covariance is the
    /// unit matrix: a shift of the centre, and changes of the covariance.
    fn step(&self, step: SVector<f64, 5>) -> Step {
        let UnitGaussian { lxx, lyx, lyy, .. } = self.gaussian();
        let [u, v, uu, uv, vv]: [f64; 5] = step.into();
        let sigma = self.m.sigma_minor_px();
        // dx = (u - tilt v) / lxx, dy = v / lyy
        let tilt = lyx / lyy;
        let (to_x, to_y) = (1.0 / (lxx * sigma), 1.0 / (lyy * sigma));
        [
            (u - tilt * v) * to_x,
            v * to_y,
            (uu - 2.0 * tilt * uv + tilt * tilt * vv) * to_x * to_x,
            (uv - tilt * vv) * to_x * to_y,
            vv * to_y * to_y,
        ]
    }

    /// Moves the weight by a step. Steps within [`LARGEST_STEP`] keep the smaller eigenvalue at half
    /// of its old value or more.
    pub(crate) fn moved(&self, [dx, dy, dxx, dxy, dyy]: Step) -> Result<Self, MetricsError> {
        let sigma = self.m.sigma_minor_px();
        let variance = sigma * sigma;
        Ok(Self {
            x: self.x + dx * sigma,
            y: self.y + dy * sigma,
            m: Covariance::new(
                self.m.xx() + dxx * variance,
                self.m.xy() + dxy * variance,
                self.m.yy() + dyy * variance,
            )?,
        })
    }
}

/// The flux under a weight, and the steps that improve the weight.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WeightedMoments {
    pub(crate) weight: Weight,
    pub(crate) flux: f64,
    pub(crate) plain_step: Step,
    /// The largest component of the plain step.
    pub(crate) change: f64,
    /// None far from a solution, and where plain steps do not converge.
    newton_step: Option<Step>,
}

/// The pixels to measure, and the limits of their weight.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WeightedPixels<'a> {
    pub(crate) cutout: &'a Cutout,
    /// The largest magnitude of a pixel.
    pub(crate) brightest: f64,
    /// The largest sigma of a result.
    pub(crate) largest_px: f64,
    /// The largest sigma of a weight, in units of `largest_px`.
    pub(crate) slack: f64,
}

impl WeightedPixels<'_> {
    /// Measures under a weight. `flux` is the flux under the weight before the last step, or 0. Pixels
    /// whose weighted light is negligible next to it are left out.
    pub(crate) fn measure(&self, weight: Weight, flux: f64) -> Result<WeightedMoments, MetricsError> {
        self.cutout.check_centre(weight.x, weight.y)?;
        check_width(weight.m, self.slack, self.largest_px)?;
        let (rows, columns) = self.cutout.values.dim();
        let reach = reach(self.brightest, rows * columns, flux);
        let gaussian = weight.gaussian();
        let mut row = GaussianRow::new(columns);
        let mut sums = MonomialSums::default();
        for (i, values) in self.cutout.rows().enumerate() {
            row.evaluate(gaussian, i, reach);
            sums.add(&row, &values[row.columns()]);
        }
        let [flux, u, v, uu, uv, vv] = MONOMIALS.map(|monomial| sums.of(monomial));
        // The amplitude is twice the weighted flux.
        if [2.0 * flux, u, v, uu, uv, vv].iter().any(|sum| !sum.is_finite()) {
            return Err(MetricsError::Overflow {
                largest: self.cutout.extreme(),
            });
        }
        if flux <= 0.0 {
            return Err(MetricsError::NonPositiveFlux { flux });
        }
        // Means over the weighted light of u, v, u^2 / 2, uv and v^2 / 2, less those of a solution.
        let solved = SVector::from([0.0, 0.0, 0.25, 0.0, 0.25]);
        let mismatch = SVector::from([u, v, 0.5 * uu, uv, 0.5 * vv]) / flux - solved;
        // The plain step would be Newton's if the light were a Gaussian near the weight.
        let plain = mismatch.component_div(&SVector::from(GAUSSIAN));
        let plain_step = weight.step(plain).map(|d| d.clamp(-LARGEST_STEP, LARGEST_STEP));
        Ok(WeightedMoments {
            weight,
            flux,
            plain_step,
            change: plain_step.iter().fold(0.0, |most, d| most.max(d.abs())),
            newton_step: newton_step(mismatch, solved, &sums)
                .map(|step| weight.step(step))
                .filter(|step| step.iter().all(|d| d.abs() < LARGEST_STEP)),
        })
    }

    /// Measures after a step of Newton's method. None if there is no such step, or no result there.
    pub(crate) fn after_newton_step(&self, now: &WeightedMoments) -> Option<WeightedMoments> {
        let weight = now.weight.moved(now.newton_step?).ok()?;
        self.measure(weight, now.flux).ok()
    }
}

/// The step of Newton's method in the coordinates of the weight.
///
/// The matrix `H` holds the derivatives of the mismatch by the step, with the opposite sign. Terms of
/// the order of the mismatch are left out, which makes it symmetric. With `G` for a Gaussian, plain
/// steps multiply the mismatch by `1 - H / G`. They converge if and only if `0 < H < 2 G`. Elsewhere
/// there is no step, so that both methods find equal solutions.
fn newton_step(
    mismatch: SVector<f64, 5>,
    solved: SVector<f64, 5>,
    sums: &MonomialSums,
) -> Option<SVector<f64, 5>> {
    let halves = [1.0, 1.0, 0.5, 1.0, 0.5];
    let (products, flux) = (sums.products(), sums.of(MONOMIALS[0]));
    let products =
        SMatrix::<f64, 5, 5>::from_fn(|i, j| halves[i] * halves[j] * products[(i + 1, j + 1)] / flux);
    let twice_gaussian = SMatrix::from_diagonal(&(SVector::from(GAUSSIAN) * 2.0));
    let matrix = twice_gaussian + solved * solved.transpose() - products;
    (twice_gaussian - matrix).cholesky()?;
    Some(matrix.cholesky()?.solve(&mismatch))
}
