//! Measurements of the off-grid stamps, compared with the measurements by other software.

use libtest_mimic::{Failed, Trial};
use psfield::metrics::{AdaptiveMomentFinder, GaussianFitter, Window};

use crate::data::{ROMAN, STRONG, ensure, trial};

/// Largest relative error of the size, and largest error of the shear.
const MOMENTS: f64 = 1e-4;
/// Largest error of the centroids of adaptive moments, in pixels.
const CENTROID_PX: f64 = 1e-3;
/// Largest error of the widths and centres of Gaussian fits, in pixels.
const FIT_PX: f64 = 1e-4;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial(
            "strong: adaptive moments against HSM".to_owned(),
            adaptive_moments,
        ),
        trial("roman: Gaussian fits".to_owned(), gaussian_fits),
    ]
}

fn largest(differences: impl Iterator<Item = f64>) -> f64 {
    differences.fold(0.0, |m, d| m.max(d.abs()))
}

fn adaptive_moments() -> Result<(), Failed> {
    let stamps = STRONG.off_grid()?;
    let moments: Result<Vec<_>, _> = stamps
        .stamps()
        .outer_iter()
        .map(|stamp| AdaptiveMomentFinder::new().measure(stamp))
        .collect();
    let moments = moments?;
    ensure(moments.len() == 100, || format!("{} stamps", moments.len()))?;
    let sigma = STRONG.measured("hsm_sigma_pix")?;
    let sigma = largest(moments.iter().zip(sigma).map(|(m, t)| m.sigma_px() / t - 1.0));
    let g1 = largest(
        moments
            .iter()
            .zip(STRONG.measured("hsm_g1")?)
            .map(|(m, t)| m.g1() - t),
    );
    let g2 = largest(
        moments
            .iter()
            .zip(STRONG.measured("hsm_g2")?)
            .map(|(m, t)| m.g2() - t),
    );
    let x = largest(
        moments
            .iter()
            .zip(STRONG.measured("hsm_xc")?)
            .map(|(m, t)| m.x_centroid() - t),
    );
    let y = largest(
        moments
            .iter()
            .zip(STRONG.measured("hsm_yc")?)
            .map(|(m, t)| m.y_centroid() - t),
    );
    println!("strong: sigma {sigma:.1e}, g1 {g1:.1e}, g2 {g2:.1e}, x {x:.1e}, y {y:.1e}");
    ensure(
        sigma <= MOMENTS && g1 <= MOMENTS && g2 <= MOMENTS && x <= CENTROID_PX && y <= CENTROID_PX,
        || format!("sigma {sigma:.3e}, g1 {g1:.3e}, g2 {g2:.3e}, x {x:.3e}, y {y:.3e}"),
    )
}

fn gaussian_fits() -> Result<(), Failed> {
    let stamps = ROMAN.off_grid()?;
    let fitter = GaussianFitter::elliptical().with_window(Window::central(15));
    let fits: Result<Vec<_>, _> = stamps
        .stamps()
        .outer_iter()
        .map(|stamp| fitter.fit(stamp))
        .collect();
    let fits = fits?;
    ensure(fits.len() == 100, || format!("{} stamps", fits.len()))?;
    let off = |column: &str, of: fn(&psfield::metrics::GaussianFit) -> f64| -> Result<f64, Failed> {
        Ok(largest(
            fits.iter()
                .zip(ROMAN.measured(column)?)
                .map(|(fit, truth)| of(fit) - truth),
        ))
    };
    for (column, of) in [
        (
            "gfit_fwhm_pix",
            (|fit| fit.fwhm_px()) as fn(&psfield::metrics::GaussianFit) -> f64,
        ),
        ("gfit_fwhm_maj", |fit| fit.fwhm_major_px()),
        ("gfit_fwhm_min", |fit| fit.fwhm_minor_px()),
        ("gfit_xc", |fit| fit.x_centroid()),
        ("gfit_yc", |fit| fit.y_centroid()),
    ] {
        let off = off(column, of)?;
        println!("roman {column}: off by {off:.1e} pixels");
        ensure(off <= FIT_PX, || format!("{column} is off by {off:.3e} pixels"))?;
    }
    Ok(())
}
