//! Registration: from stars to stamps on one grid.

use ndarray::{Array2, ArrayView2};
use psf_types::named;
use serde::Serialize;

use crate::StarError;
use crate::background::Spline;
use crate::error::checked_setters;

/// The method that makes stamps with a common centre and grid from stars.
///
/// Many stars together give a PSF with little noise, as far as it varies smoothly over the field. If
/// stars are well sampled, the pixels of a single star also determine its PSF between the pixels, with
/// the star's noise. If stars are undersampled (FWHM below 2 pixels), a single star does not contain
/// this information, and interpolation blurs the PSF.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum RegistrationMethod {
    /// [`Epsf`](Self::Epsf) if there are enough stars, else [`Stamps`](Self::Stamps). If the FWHM is
    /// at least 2 pixels, enough stars are 64, and stars that are left out decide: where the nearest
    /// stars' own pixels predict them better than the oversampled PSF, the PSF varies too fast for a
    /// polynomial, and the method is [`Stamps`](Self::Stamps).
    #[default]
    Auto,
    /// One oversampled PSF that varies over the field as a polynomial, fitted to the pixels of all
    /// stars together. A sample is this PSF at a star's position. The approach is that of the
    /// effective PSF (Anderson and King 2000, PASP 112, 1360), with the polynomial variation and
    /// the regularised pixel basis of PSFEx (Bertin 2011, ASPC 442, 435).
    ///
    /// Samples are nearly free of noise. They have at most as many independent shapes as the
    /// polynomial has terms. With [`Registration::with_own_shapes`] each sample is adapted to its
    /// star's own pixels, and contains some of their noise.
    Epsf,
    /// Each star's own pixels, shifted to the common centre by cubic spline and divided by the
    /// star's flux. This flux comes from a fit of an oversampled PSF, and for bright stars also from
    /// the sum of the pixels. Stars that do not agree with the oversampled PSF are rejected. Samples
    /// keep the star's noise. With one stamp pixel per pixel of the frame the noise stays nearly white, so
    /// that a fit can separate it from the PSF. On a finer grid, neighbouring stamp pixels have
    /// correlated noise, because they come from the same few pixels of the frame. A fit then cannot
    /// recognise the noise and keeps all of it.
    Stamps,
}

named!(
    RegistrationMethod,
    String,
    |text| format!("the registration method must be auto, epsf or stamps, got {text}"),
    "auto" => Auto,
    "epsf" => Epsf,
    "stamps" => Stamps
);

/// Method, stamp size and oversampling. Sizes that are not given follow from the stars' FWHM.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Registration {
    method: RegistrationMethod,
    stamp_size: Option<usize>,
    oversampling: Option<usize>,
    pub(crate) own_shapes: bool,
}

impl Registration {
    /// The smallest number of stars for an oversampled PSF. An oversampling of `s` needs at least
    /// `3 s^2` stars, if that is more.
    pub const LEAST_FOR_EPSF: usize = 12;
    const LARGEST_STAMP: usize = 512;
    const LARGEST_OVERSAMPLING: usize = 8;
    /// Below this FWHM in pixels, stars are undersampled.
    const UNDERSAMPLED_PX: f64 = 2.0;
    /// With this number of stamp pixels per FWHM, the error of a cubic spline is about 1e-3 of the
    /// peak for a Gaussian, and 1e-2 for a PSF with as sharp a core as diffraction gives.
    const PIXELS_PER_FWHM: f64 = 3.0;
    /// The number of stamp pixels per FWHM for an oversampled PSF of many stars.
    const PIXELS_PER_FWHM_OF_MANY: f64 = 4.0;
    /// The default distance from a stamp's centre to its edge, in FWHM.
    const REACH_FWHM: f64 = 3.0;
    const LEAST_REACH: usize = 5;
    /// With at least this number of well-sampled stars, the method `auto` may choose an oversampled PSF,
    /// and stamps have one pixel per pixel of the frame. With fewer stars, a few that differ from
    /// the others would rule the PSF, a fit of stamps cannot separate the stars' noise from their
    /// shapes, and a finer grid preserves the shapes better.
    const MIN_WELL_SAMPLED_STARS: usize = 64;

    /// Sets the method.
    #[must_use]
    pub fn with_method(self, method: RegistrationMethod) -> Self {
        Self { method, ..self }
    }

    checked_setters! {
        /// Sets the stamp size in pixels of the frame along each side. An even number is raised to the
        /// next odd one. By default, a stamp reaches 3 FWHM from its centre in each direction, and has at
        /// least 11 pixels along each side.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is from 5 to 512.
        with_stamp_size(size: usize) => stamp_size: Some, if (5..=Self::LARGEST_STAMP).contains(&size),
            else "the stamp size", "from 5 to 512 pixels";

        /// Sets the number of stamp pixels per pixel of the frame. The default is 1 for
        /// [`Stamps`](RegistrationMethod::Stamps) of at least 64 stars with a FWHM of at least 2
        /// pixels. Otherwise it is the smallest number that gives 3 stamp pixels per FWHM, or 4 for
        /// [`Epsf`](RegistrationMethod::Epsf) of enough stars, at most 8.
        ///
        /// # Errors
        /// [`StarError::Setting`] unless it is from 1 to 8.
        with_oversampling(scale: usize) => oversampling: Some,
            if (1..=Self::LARGEST_OVERSAMPLING).contains(&scale),
            else "the oversampling", "a whole number from 1 to 8";
    }

    /// Sets whether the oversampled PSF is adapted to each star's own pixels (colour, local
    /// distortion). The default is `false`, because the pixels also add their noise.
    #[must_use]
    pub fn with_own_shapes(self, own_shapes: bool) -> Self {
        Self { own_shapes, ..self }
    }

    /// Pixels of the frame from a stamp's centre to its edge, for stars of the given FWHM.
    pub(crate) fn reach(&self, fwhm_px: f64) -> usize {
        self.stamp_size.map_or_else(
            || {
                ((Self::REACH_FWHM * fwhm_px).ceil() as usize)
                    .clamp(Self::LEAST_REACH, Self::LARGEST_STAMP / 2)
            },
            |size| size / 2,
        )
    }

    /// The grid of a method for a number of stars of the given FWHM.
    pub(crate) fn grid(&self, method: RegistrationMethod, fwhm_px: f64, stars: usize) -> FineGrid {
        let of = |per_fwhm: f64| ((per_fwhm / fwhm_px).ceil() as usize).clamp(1, Self::LARGEST_OVERSAMPLING);
        let scale = self.oversampling.unwrap_or_else(|| {
            let (least, fine) = (of(Self::PIXELS_PER_FWHM), of(Self::PIXELS_PER_FWHM_OF_MANY));
            let well_sampled = !Self::is_undersampled(fwhm_px);
            match method {
                RegistrationMethod::Stamps if well_sampled && stars >= Self::MIN_WELL_SAMPLED_STARS => 1,
                RegistrationMethod::Epsf if stars >= Self::needed_for_epsf(fine) => fine,
                _ => least,
            }
        });
        FineGrid {
            reach: self.reach(fwhm_px),
            scale,
        }
    }

    /// The number of stars needed for an oversampled PSF: several for each phase of the fine grid.
    pub(crate) fn needed_for_epsf(scale: usize) -> usize {
        Self::LEAST_FOR_EPSF.max(3 * scale * scale)
    }

    /// Returns whether an oversampled PSF may serve as samples, for a number of stars of the given FWHM
    /// and the grid's number of stamp pixels per pixel of the frame.
    ///
    /// # Errors
    /// [`StarError::NoSamples`] when the method was requested and there are too few stars.
    pub(crate) fn may_be_epsf(&self, fwhm_px: f64, stars: usize, scale: usize) -> Result<bool, StarError> {
        let need = Self::needed_for_epsf(scale);
        match self.method {
            RegistrationMethod::Epsf if stars < need => Err(StarError::NoSamples(format!(
                "an oversampled PSF (method epsf) with an oversampling of {scale} needs at least {need} stars, but the cuts accepted only {stars}: use the method stamps, reduce the oversampling, or relax the cuts"
            ))),
            RegistrationMethod::Stamps => Ok(false),
            RegistrationMethod::Epsf => Ok(true),
            RegistrationMethod::Auto if Self::is_undersampled(fwhm_px) => Ok(stars >= need),
            RegistrationMethod::Auto => Ok(stars >= need.max(Self::MIN_WELL_SAMPLED_STARS)),
        }
    }

    /// Returns whether the data choose the method, if both are possible. The pixels of an
    /// undersampled star do not give its PSF.
    pub(crate) fn is_open(&self, fwhm_px: f64) -> bool {
        self.method == RegistrationMethod::Auto && !Self::is_undersampled(fwhm_px)
    }

    /// Returns whether stars of the given FWHM are undersampled.
    pub(crate) fn is_undersampled(fwhm_px: f64) -> bool {
        fwhm_px < Self::UNDERSAMPLED_PX
    }
}

/// The nodes of a stamp: `2 reach scale + 1` along each side, with the middle one at the star.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct FineGrid {
    /// Pixels of the frame from the centre to the edge.
    pub(crate) reach: usize,
    /// Nodes per pixel of the frame.
    pub(crate) scale: usize,
}

impl FineGrid {
    pub(crate) fn middle(self) -> usize {
        self.reach * self.scale
    }

    pub(crate) fn side(self) -> usize {
        2 * self.middle() + 1
    }
}

/// The registration that was used.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RegistrationReport {
    /// The method that was used.
    pub method: RegistrationMethod,
    /// Stamp pixels per pixel of the frame.
    pub oversampling: usize,
    /// Stamp pixels along each side.
    pub stamp_pixels: usize,
    /// True if the stars are undersampled (FWHM below 2 pixels).
    pub undersampled: bool,
    /// Degree of the polynomial over the field, for an oversampled PSF.
    pub field_degree: Option<usize>,
    /// Median over the stars of the root of the reduced chi squared, for an oversampled PSF. It is
    /// 1 if noise explains all residuals.
    pub median_chi: Option<f64>,
    /// Median over the samples of the noise of their pixels, as a fraction of the sample's norm, for
    /// stamps of single stars.
    pub stamp_noise: Option<f64>,
}

/// Pixels beyond the stamp that enter the spline, so that the spline's boundary hardly affects the
/// stamp.
const MARGIN: usize = 3;

/// Returns the light of a star at position `(x, y)` of the frame, interpolated at the nodes of the
/// grid. `level` is the background minus the background map.
///
/// A pixel that is masked, belongs to a neighbour or lies off the frame is replaced by the pixel on
/// the opposite side of the star, or by 0 if that cannot be used either. The spline passes exactly
/// through the pixels' values.
pub(crate) fn own_stamp(
    excess: ArrayView2<'_, f64>,
    (star_x, star_y): (f64, f64),
    level: f64,
    trusted: impl Fn(usize, usize) -> bool,
    grid: FineGrid,
) -> Array2<f64> {
    let (ny, nx) = excess.dim();
    let reach = (grid.reach + MARGIN) as i64;
    let (column, row) = (star_x.round() as i64, star_y.round() as i64);
    let on = |v: i64, n: usize| (0..n as i64).contains(&v);
    let value = |x: i64, y: i64| {
        let good = |x: i64, y: i64| on(x, nx) && on(y, ny) && trusted(x as usize, y as usize);
        let at = |x: i64, y: i64| excess[[y as usize, x as usize]] - level;
        if good(x, y) {
            return at(x, y);
        }
        let opposite = |v: i64, centre: f64| (2.0 * centre - v as f64).round() as i64;
        let (x, y) = (opposite(x, star_x), opposite(y, star_y));
        if good(x, y) { at(x, y) } else { 0.0 }
    };
    let side = (2 * reach + 1) as usize;
    let window = Array2::from_shape_fn((side, side), |(j, i)| {
        value(column + i as i64 - reach, row + j as i64 - reach)
    });
    let spline = Spline::through(window.view());
    let middle = grid.middle() as f64;
    let at =
        |k: usize, centre: f64, first: i64| centre + (k as f64 - middle) / grid.scale as f64 - first as f64;
    Array2::from_shape_fn((grid.side(), grid.side()), |(j, i)| {
        spline.at(at(i, star_x, column - reach), at(j, star_y, row - reach))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::s;

    fn frame(x: f64, y: f64, sigma: f64) -> Array2<f64> {
        Array2::from_shape_fn((41, 41), |(j, i)| {
            let r2 = (i as f64 - x).powi(2) + (j as f64 - y).powi(2);
            500.0 * (-0.5 * r2 / (sigma * sigma)).exp() + 3.0
        })
    }

    #[test]
    fn a_stamp_is_centred_and_holds_the_flux() {
        let (x, y, sigma) = (20.3, 19.6, 1.2);
        let grid = FineGrid { reach: 8, scale: 2 };
        // The pedestal of 3 is the level around the star.
        let mut stamp = own_stamp(frame(x, y, sigma).view(), (x, y), 3.0, |_, _| true, grid);
        let (flux, truth) = (stamp.sum() / 4.0, std::f64::consts::TAU * sigma * sigma * 500.0);
        assert!((flux / truth - 1.0).abs() < 1e-4, "{flux} against {truth}");
        stamp /= flux;
        let middle = grid.middle();
        let (mut mx, mut my) = (0.0, 0.0);
        for ((j, i), v) in stamp.indexed_iter() {
            mx += v / 4.0 * (i as f64 - middle as f64) / 2.0;
            my += v / 4.0 * (j as f64 - middle as f64) / 2.0;
        }
        // The error of the spline at a FWHM of 2.8 pixels.
        assert!(mx.abs() < 2e-3 && my.abs() < 2e-3, "{mx}, {my}");
    }

    #[test]
    fn a_neighbours_pixels_are_replaced_by_the_opposite_ones() {
        let clean = frame(20.0, 20.0, 1.5);
        let mut with_neighbour = clean.clone();
        with_neighbour.slice_mut(s![24..27, 19..22]).fill(1e4);
        let grid = FineGrid { reach: 8, scale: 1 };
        let trusted = |x: usize, y: usize| !((19..22).contains(&x) && (24..27).contains(&y));
        let a = own_stamp(clean.view(), (20.0, 20.0), 3.0, |_, _| true, grid);
        let b = own_stamp(with_neighbour.view(), (20.0, 20.0), 3.0, trusted, grid);
        assert!((&a - &b).iter().all(|d| d.abs() < 1e-12));
    }
}
