//! The tolerance of the fast engine, pixel by pixel. With light everywhere, the PSF of each pixel
//! must be within the tolerance.

use integration_tests::circles::circle_errors;
use libtest_mimic::{Failed, Trial};
use ndarray::Array2;
use psfield::conv_core::{ConvReal, Engine, Paths, Plan, PlanOptions};
use psfield::psf_types::{Anchor, FrameShape, PsfModel, ToleranceOn};

use crate::data::{Field, ROMAN, STRONG, ensure, trial};
use crate::responses::{Probes, ResponseErrors, lit_everywhere};
use crate::simulation::{ANCHORS, FULL};

const TOLERANCES: [f64; 6] = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 0.0];
const PIXELS: usize = 1000;
/// Rounding of a response in double precision. The response is a difference of two images of light
/// around 1, divided by the norm of a PSF, around 0.1. Each of the thousands of pixels of a stamp
/// rounds by 1e-15.
const ROUNDING_F64: f64 = 1e-12;
/// Rounding in single precision. A tile with thousands of pixels of 1 and one of [`MORE`] is
/// transformed with an error of a few 1e-7 of its norm. Most of this norm comes from the added
/// light.
pub(crate) const ROUNDING_F32: f64 = 2e-6;
/// Light added in single precision. A response to 1 would be lost in the rounding of the light
/// around it.
pub(crate) const MORE: f64 = 1e4;

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = Vec::new();
    for field in [STRONG, ROMAN] {
        for (anchor, name) in ANCHORS {
            for paths in [Paths::Transforms, Paths::Cheapest] {
                let label = |precision: &str| {
                    format!(
                        "{}, {name}-anchored, {paths:?}: every pixel's PSF in {precision}",
                        field.name
                    )
                };
                trials.push(trial(label("f64"), move || of_field::<f64>(field, anchor, paths)));
                trials.push(trial(label("f32"), move || of_field::<f32>(field, anchor, paths)));
            }
        }
    }
    for field in [STRONG, ROMAN] {
        trials.push(trial(
            format!("{}: the flux in circles about every pixel and star", field.name),
            move || in_circles(field),
        ));
    }
    trials.push(trial(
        "strong: every pixel's PSF where nothing else is lit".to_owned(),
        in_the_dark,
    ));
    trials
}

/// The light added to a pixel, 1 in f64 and [`MORE`] in f32, and its rounding.
fn precision<T: ConvReal>() -> (f64, f64) {
    if T::NAME == "f64" {
        (1.0, ROUNDING_F64)
    } else {
        (MORE, ROUNDING_F32)
    }
}

/// Errors of some pixels' responses by a plan, with light around 1 on all pixels.
pub(crate) fn measured<T: ConvReal>(
    model: &PsfModel,
    probes: &Probes,
    frame: FrameShape,
    options: PlanOptions,
    limit: f64,
) -> Result<ResponseErrors, Failed> {
    let engine = Engine::<T>::new(Plan::new(model, frame, frame.region(), options)?);
    let light = lit_everywhere::<T>(frame.nx(), frame.ny(), 3);
    probes.measure(&engine, &light, precision::<T>().0, limit)
}

/// Checks [`PIXELS`] pixels at each of the [`TOLERANCES`], with light around 1 on all pixels.
pub(crate) fn within<T: ConvReal>(
    name: &str,
    model: &PsfModel,
    frame: FrameShape,
    anchor: Anchor,
    paths: Paths,
) -> Result<(), Failed> {
    let probes = Probes::random(model, (frame.nx(), frame.ny()), PIXELS, anchor)?;
    let mut failed = String::new();
    for tolerance in TOLERANCES {
        let options = PlanOptions::new(tolerance)?.with_anchor(anchor).with_paths(paths);
        let limit = tolerance + precision::<T>().1;
        let found = measured::<T>(model, &probes, frame, options, limit)?;
        let line = format!(
            "{name} {anchor} {paths:?} {} at {tolerance:.0e}: largest {:.2e} ({:.4} of the limit), mean {:.2e}, beyond the \
             stamps {:.1e}, {} violations",
            T::NAME,
            found.largest,
            found.largest / limit,
            found.mean,
            found.stray,
            found.violations
        );
        println!("{line}");
        if found.violations > 0 || found.stray > precision::<T>().1 {
            failed += &line;
        }
    }
    ensure(failed.is_empty(), || failed)
}

fn of_field<T: ConvReal>(field: Field, anchor: Anchor, paths: Paths) -> Result<(), Failed> {
    let model = field.model(FULL)?;
    within::<T>(field.name, &model, field.frame()?, anchor, paths)
}

/// The tolerance on apertures, for lit pixels and stars.
fn in_circles(field: Field) -> Result<(), Failed> {
    let (model, frame) = (field.model(FULL)?, field.frame()?);
    for tolerance in TOLERANCES {
        let options = PlanOptions::new(tolerance)?.with_tolerance_on(ToleranceOn::Aperture);
        let found = circle_errors(&model, frame, options, PIXELS)?;
        println!("{} at {tolerance:.0e}: {found:?}", field.name);
        let limit = tolerance + ROUNDING_F64;
        ensure(found.circle <= limit && found.l2 <= limit, || {
            format!("{} at {tolerance:.0e}: {found:?}", field.name)
        })?;
    }
    Ok(())
}

/// Single lit pixels: their stamps are also made from the modes of a tile.
fn in_the_dark() -> Result<(), Failed> {
    let model = STRONG.model(FULL)?;
    let frame = STRONG.frame()?;
    for (anchor, name) in ANCHORS {
        let probes = Probes::random(&model, (frame.nx(), frame.ny()), PIXELS, anchor)?;
        for tolerance in TOLERANCES {
            let options = PlanOptions::new(tolerance)?.with_anchor(anchor);
            let engine = Engine::<f64>::new(Plan::new(&model, frame, frame.region(), options)?);
            let dark = Array2::zeros((frame.ny(), frame.nx()));
            let found = probes.measure(&engine, &dark, 1.0, tolerance + ROUNDING_F64)?;
            println!("{name}-anchored, in the dark, at {tolerance:.0e}: {found:?}");
            ensure(found.violations == 0 && found.stray == 0.0, || {
                format!("{found:?}")
            })?;
        }
    }
    Ok(())
}
