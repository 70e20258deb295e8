//! How stars become stamps on one grid.

use ndarray::{Array2, ArrayView2, s};
use psf_types::named;
use serde::Serialize;

use crate::StarError;
use crate::background::{Spline, median};
use crate::error::check;

/// How stars become stamps that share a centre and a grid.
///
/// Where stars are well sampled, a star's own pixels say what its PSF is between them. Where they are not (FWHM below 2 pixels), a single
/// star does not hold that information: interpolating it smears it. Many stars at different pixel phases do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum RegistrationMethod {
    /// [`Epsf`](Self::Epsf) for FWHM below 2 pixels and enough stars, else [`Stamps`](Self::Stamps).
    #[default]
    Auto,
    /// One oversampled PSF that varies over the field as a polynomial, fitted to the pixels of all stars together; a sample is its value
    /// at a star. The approach of the effective PSF (Anderson and King 2000, PASP 112, 1360) with the polynomial variation and the
    /// regularised pixel basis of PSFEx (Bertin 2011, ASPC 442, 435). Samples are nearly free of noise, and there are no more different
    /// shapes among them than the polynomial has terms; with [`Registration::with_own_shapes`] each star's pixels, and their noise, bend it.
    Epsf,
    /// Each star's own pixels, shifted to the common centre by cubic spline. Samples keep the star's noise. At one stamp pixel a
    /// pixel of the frame it stays nearly white, so that a fit can tell it from the PSF; on a finer grid neighbouring values share the noise of
    /// few pixels, a fit finds no white noise, and keeps it all.
    Stamps,
}

named!(
    RegistrationMethod,
    String,
    |text| format!("auto, epsf or stamps is needed, got {text}"),
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
    /// The smallest number of stars for an oversampled PSF, at any oversampling.
    pub const LEAST_FOR_EPSF: usize = 12;
    const LARGEST_STAMP: usize = 512;
    const LARGEST_OVERSAMPLING: usize = 8;
    /// Below this FWHM in pixels, stars are undersampled.
    const UNDERSAMPLED_PX: f64 = 2.0;
    /// Stamp pixels that a FWHM should have, so that a cubic spline represents it to some 1e-3 of the peak.
    const PIXELS_PER_FWHM: f64 = 3.0;
    /// By default a stamp reaches so many FWHM from the centre.
    const REACH_FWHM: f64 = 3.0;
    const LEAST_REACH: usize = 5;
    /// With fewer stars their noise and their own shapes cannot be told apart, and a finer grid loses less of either.
    const ENOUGH_FOR_FRAME_PIXELS: usize = 64;

    /// By this method.
    #[must_use]
    pub fn with_method(self, method: RegistrationMethod) -> Self {
        Self { method, ..self }
    }

    /// Stamps of about this many pixels of the frame along each side (the next odd number); by default 3 FWHM each way, at least 11.
    ///
    /// # Errors
    /// [`StarError::Setting`] unless it is from 5 to 512.
    pub fn with_stamp_size(self, stamp_size: usize) -> Result<Self, StarError> {
        check(
            (5..=Self::LARGEST_STAMP).contains(&stamp_size),
            "the stamp size",
            "from 5 to 512 pixels",
            stamp_size as f64,
        )?;
        Ok(Self {
            stamp_size: Some(stamp_size),
            ..self
        })
    }

    /// Stamp pixels for each pixel of the frame; by default one for [`Stamps`](RegistrationMethod::Stamps) of 64 stars or more with a FWHM of 2
    /// pixels or more, else as many as give a FWHM three of them.
    ///
    /// # Errors
    /// [`StarError::Setting`] unless it is from 1 to 8.
    pub fn with_oversampling(self, oversampling: usize) -> Result<Self, StarError> {
        check(
            (1..=Self::LARGEST_OVERSAMPLING).contains(&oversampling),
            "the oversampling",
            "a whole number from 1 to 8",
            oversampling as f64,
        )?;
        Ok(Self {
            oversampling: Some(oversampling),
            ..self
        })
    }

    /// Whether each star's own pixels bend the oversampled PSF (colour, local distortion); by default not, as they bring their noise.
    #[must_use]
    pub fn with_own_shapes(self, own_shapes: bool) -> Self {
        Self { own_shapes, ..self }
    }

    /// Pixels of the frame from a stamp's centre to its edge, for stars of this FWHM.
    pub(crate) fn reach(&self, fwhm_px: f64) -> usize {
        self.stamp_size.map_or_else(
            || {
                ((Self::REACH_FWHM * fwhm_px).ceil() as usize)
                    .clamp(Self::LEAST_REACH, Self::LARGEST_STAMP / 2)
            },
            |size| size / 2,
        )
    }

    /// The grid, for so many stars of this FWHM.
    pub(crate) fn grid(&self, fwhm_px: f64, stars: usize) -> FineGrid {
        let frame_pixels = self.method != RegistrationMethod::Epsf
            && !Self::is_undersampled(fwhm_px)
            && stars >= Self::ENOUGH_FOR_FRAME_PIXELS;
        let scale = self.oversampling.unwrap_or_else(|| {
            if frame_pixels {
                1
            } else {
                ((Self::PIXELS_PER_FWHM / fwhm_px).ceil() as usize).clamp(1, Self::LARGEST_OVERSAMPLING)
            }
        });
        FineGrid {
            reach: self.reach(fwhm_px),
            scale,
        }
    }

    /// Stars needed for an oversampled PSF: several for each phase of the fine grid.
    pub(crate) fn needed_for_epsf(scale: usize) -> usize {
        Self::LEAST_FOR_EPSF.max(3 * scale * scale)
    }

    /// The method in force.
    pub(crate) fn resolve(
        &self,
        fwhm_px: f64,
        stars: usize,
        scale: usize,
    ) -> Result<RegistrationMethod, StarError> {
        let need = Self::needed_for_epsf(scale);
        match self.method {
            RegistrationMethod::Epsf if stars < need => Err(StarError::NoSamples(format!(
                "an oversampled PSF (epsf) at {scale} x needs at least {need} stars, {stars} were accepted: use the stars' own stamps, or loosen the cuts"
            ))),
            RegistrationMethod::Auto if fwhm_px < Self::UNDERSAMPLED_PX && stars >= need => {
                Ok(RegistrationMethod::Epsf)
            }
            RegistrationMethod::Auto => Ok(RegistrationMethod::Stamps),
            method => Ok(method),
        }
    }

    /// Whether stars of this FWHM are undersampled.
    pub(crate) fn is_undersampled(fwhm_px: f64) -> bool {
        fwhm_px < Self::UNDERSAMPLED_PX
    }
}

/// The nodes of a stamp: `2 reach scale + 1` each way, the middle one at the star.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct FineGrid {
    /// Pixels of the frame from the centre to the edge.
    pub(crate) reach: usize,
    /// Nodes for each pixel of the frame.
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

/// How the samples were made.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RegistrationReport {
    /// The method in force.
    pub method: RegistrationMethod,
    /// Stamp pixels for each pixel of the frame.
    pub oversampling: usize,
    /// Stamp pixels along each side.
    pub stamp_pixels: usize,
    /// Whether the stars are undersampled (FWHM below 2 pixels).
    pub undersampled: bool,
    /// Degree of the polynomial over the field, for an oversampled PSF.
    pub field_degree: Option<usize>,
    /// Median over the stars of the root of the reduced chi squared, for an oversampled PSF; 1 where the noise explains all that is left.
    pub median_chi: Option<f64>,
}

/// Pixels beyond the stamp that the spline sees, so that its end does not matter.
const MARGIN: usize = 3;

/// The star's pixels at the nodes of the grid, of unit flux, and its flux; nothing for a star without light.
///
/// Pixels that belong to a neighbour are replaced by those opposite the star. What the background map is off by is the median
/// along the stamp's edge. The spline passes through the pixels, so at the star's own place an oversampled stamp gives them back.
pub(crate) fn own_stamp(
    excess: ArrayView2<'_, f64>,
    (star_x, star_y): (f64, f64),
    trusted: impl Fn(usize, usize) -> bool,
    grid: FineGrid,
) -> Option<(Array2<f64>, f64)> {
    let (ny, nx) = excess.dim();
    let reach = (grid.reach + MARGIN) as i64;
    let (column, row) = (star_x.round() as i64, star_y.round() as i64);
    let on = |v: i64, n: usize| (0..n as i64).contains(&v);
    let value = |x: i64, y: i64| {
        let good = |x: i64, y: i64| on(x, nx) && on(y, ny) && trusted(x as usize, y as usize);
        if good(x, y) {
            return excess[[y as usize, x as usize]];
        }
        let opposite = |v: i64, centre: f64| (2.0 * centre - v as f64).round() as i64;
        let (x, y) = (opposite(x, star_x), opposite(y, star_y));
        if good(x, y) {
            excess[[y as usize, x as usize]]
        } else {
            0.0
        }
    };
    let side = (2 * reach + 1) as usize;
    let mut window = Array2::from_shape_fn((side, side), |(j, i)| {
        value(column + i as i64 - reach, row + j as i64 - reach)
    });
    let offset = edge_level(window.slice(s![MARGIN..side - MARGIN, MARGIN..side - MARGIN]));
    window.mapv_inplace(|v| v - offset);
    let spline = Spline::through(window.view());
    let middle = grid.middle() as f64;
    let at =
        |k: usize, centre: f64, first: i64| centre + (k as f64 - middle) / grid.scale as f64 - first as f64;
    let stamp = Array2::from_shape_fn((grid.side(), grid.side()), |(j, i)| {
        spline.at(at(i, star_x, column - reach), at(j, star_y, row - reach))
    });
    let flux = stamp.sum() / (grid.scale * grid.scale) as f64;
    (flux > 0.0).then(|| (stamp / flux, flux))
}

/// The median along the outermost pixels.
fn edge_level(stamp: ArrayView2<'_, f64>) -> f64 {
    let (ny, nx) = stamp.dim();
    let mut edge: Vec<f64> = stamp
        .indexed_iter()
        .filter(|((y, x), _)| *y == 0 || *x == 0 || *y == ny - 1 || *x == nx - 1)
        .map(|(_, v)| *v)
        .collect();
    median(&mut edge)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(x: f64, y: f64, sigma: f64) -> Array2<f64> {
        Array2::from_shape_fn((41, 41), |(j, i)| {
            let r2 = (i as f64 - x).powi(2) + (j as f64 - y).powi(2);
            500.0 * (-0.5 * r2 / (sigma * sigma)).exp() + 3.0
        })
    }

    #[test]
    fn it_is_centred_of_unit_flux_and_holds_the_stars_pixels() {
        let (x, y, sigma) = (20.3, 19.6, 1.2);
        let grid = FineGrid { reach: 8, scale: 2 };
        let (stamp, flux) = own_stamp(frame(x, y, sigma).view(), (x, y), |_, _| true, grid).unwrap();
        assert!((stamp.sum() / 4.0 - 1.0).abs() < 1e-12);
        let truth = std::f64::consts::TAU * sigma * sigma * 500.0;
        // The pedestal of 3 is the level of the edge.
        assert!((flux / truth - 1.0).abs() < 1e-4, "{flux} against {truth}");
        let middle = grid.middle();
        let (mut mx, mut my) = (0.0, 0.0);
        for ((j, i), v) in stamp.indexed_iter() {
            mx += v / 4.0 * (i as f64 - middle as f64) / 2.0;
            my += v / 4.0 * (j as f64 - middle as f64) / 2.0;
        }
        // The spline's own error on a FWHM of 2.8 pixels.
        assert!(mx.abs() < 2e-3 && my.abs() < 2e-3, "{mx}, {my}");
    }

    #[test]
    fn a_neighbours_pixels_are_those_opposite() {
        let clean = frame(20.0, 20.0, 1.5);
        let mut with_neighbour = clean.clone();
        with_neighbour.slice_mut(s![24..27, 19..22]).fill(1e4);
        let grid = FineGrid { reach: 8, scale: 1 };
        let trusted = |x: usize, y: usize| !((19..22).contains(&x) && (24..27).contains(&y));
        let (a, _) = own_stamp(clean.view(), (20.0, 20.0), |_, _| true, grid).unwrap();
        let (b, _) = own_stamp(with_neighbour.view(), (20.0, 20.0), trusted, grid).unwrap();
        assert!((&a - &b).iter().all(|d| d.abs() < 1e-12));
    }
}
