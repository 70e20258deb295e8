//! The fast engine keeps the flux at any tolerance.

use integration_tests::convolve;
use libtest_mimic::{Failed, Trial};
use ndarray::Array2;
use psfield::FitOptions;
use psfield::conv_core::{ConvReal, LowRank, Paths, PlanOptions};
use psfield::psf_types::{Anchor, Image, Normalisation, PsfModel, Real};

use crate::data::{STRONG, ensure, trial};
use crate::simulation::FULL;

const TOLERANCES: [f64; 7] = [0.5, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 0.0];
/// Rounding of sums of a few hundred thousand pixels in double precision.
const DOUBLE: f64 = 1e-13;
/// Rounding of every pixel in single precision. Most of it averages out.
const SINGLE: f64 = 1e-6;
/// Border without light, in pixels. It is wider than half a stamp, so no light leaves the frame.
const MARGIN: usize = 33;

pub(crate) fn trials() -> Vec<Trial> {
    vec![trial(
        "strong: total flux at every tolerance".to_owned(),
        total_flux,
    )]
}

/// The scene with a border without light.
fn light<T: Real>() -> Result<Array2<T>, Failed> {
    let mut light = STRONG.scene::<T>()?.into_pixels();
    let (ny, nx) = light.dim();
    for ((y, x), value) in light.indexed_iter_mut() {
        if y < MARGIN || x < MARGIN || y >= ny - MARGIN || x >= nx - MARGIN {
            *value = T::zero();
        }
    }
    Ok(light)
}

/// The exact total flux: the sum over the pixels of light times flux of the PSF.
fn exact(model: &PsfModel) -> Result<f64, Failed> {
    let light = light::<f64>()?;
    let mut fluxes = Array2::zeros(light.dim());
    let region = STRONG.frame()?.region();
    model.flux_region_into(region, fluxes.view_mut())?;
    Ok((light * fluxes).sum())
}

fn total_flux() -> Result<(), Failed> {
    for normalisation in [Normalisation::Unit, Normalisation::Keep] {
        let options = FitOptions {
            normalisation,
            ..FULL
        };
        let model = psfield::fit::fit(STRONG.samples()?, &options)?.into_model()?;
        let expected = match normalisation {
            Normalisation::Unit => light::<f64>()?.sum(),
            _ => exact(&model)?,
        };
        for tolerance in TOLERANCES {
            for paths in [Paths::Transforms, Paths::Cheapest] {
                let options = PlanOptions::new(tolerance)?.with_paths(paths);
                let double = off::<f64>(&model, options, expected)?;
                let single = off::<f32>(&model, options, expected)?;
                let line = format!(
                    "strong {normalisation} {paths:?} at {tolerance:.0e}: flux off by {double:.1e} in f64, {single:.1e} in f32"
                );
                println!("{line}");
                ensure(double <= DOUBLE && single <= SINGLE, || line)?;
            }
        }
    }
    Ok(())
}

fn off<T: ConvReal>(model: &PsfModel, options: PlanOptions, expected: f64) -> Result<f64, Failed> {
    let engine = LowRank::new(options.with_anchor(Anchor::Source));
    let image = convolve(&engine, model, &Image::new(light::<T>()?)?)?;
    let flux: f64 = image.pixels().iter().map(|v| v.as_f64()).sum();
    Ok((flux / expected - 1.0).abs())
}
