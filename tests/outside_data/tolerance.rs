//! The tolerance of the fast engine, pixel by pixel: with light everywhere, each pixel must see a PSF within it.

use std::sync::Arc;

use libtest_mimic::{Failed, Trial};
use psfield::FitOptions;
use psfield::conv_core::{ConvReal, Paths, Plan, PlanOptions};
use psfield::psf_basis::{Centring, RankSelection};
use psfield::psf_types::{
    Anchor, CoefficientField, FieldError, FrameShape, Interpolation, Normalisation, Position, PsfModel,
};

use crate::data::{Field, ROMAN, STRONG, ensure, trial};
use crate::responses::{Probes, ResponseErrors, lit_everywhere};
use crate::simulation::{ANCHORS, FULL};

const TOLERANCES: [f64; 6] = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 0.0];
const PIXELS: usize = 1000;
/// Rounding of a response that is a difference of two images of light around 1, over the norm of a PSF, around 0.1: 1e-15 a
/// pixel over the thousands of pixels of a stamp.
const ROUNDING_F64: f64 = 1e-11;
/// Single precision: light of [`MORE`] beside thousands of pixels of 1 is transformed with an error of a few 1e-7 of the norm of
/// all that is in a tile, most of which is that light's.
const ROUNDING_F32: f64 = 2e-6;
/// Light added in single precision, where a response to 1 would be lost in the rounding of the light around it.
const MORE: f64 = 1e4;
/// One response from an execution of its own against the same from a batch.
const BATCHES: f64 = 1e-11;

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
    for (anchor, name) in ANCHORS {
        trials.push(trial(
            format!("strong with a step, {name}-anchored: every pixel's PSF"),
            move || of_step(anchor),
        ));
    }
    for interpolation in INTERPOLATIONS {
        trials.push(trial(
            format!("strong, {interpolation}: every pixel's PSF"),
            move || of_interpolation(interpolation),
        ));
    }
    trials.push(trial(
        "strong: responses of a batch are those of single pixels".to_owned(),
        batches,
    ));
    trials.push(trial(
        "strong: a PSF beyond the tolerance is seen".to_owned(),
        seen,
    ));
    trials
}

/// One response to 1 in f64, to [`MORE`] in f32; and the rounding of either.
fn precision<T: ConvReal>() -> (f64, f64) {
    if T::NAME == "f64" {
        (1.0, ROUNDING_F64)
    } else {
        (MORE, ROUNDING_F32)
    }
}

fn measured<T: ConvReal>(
    model: &PsfModel,
    probes: &Probes,
    frame: FrameShape,
    options: PlanOptions,
    limit: f64,
) -> Result<ResponseErrors, Failed> {
    let plan = Plan::<T>::new(model, frame, frame.region(), options)?;
    let light = lit_everywhere::<T>(frame.nx(), frame.ny(), 3);
    probes.measure(&plan, &light, precision::<T>().0, limit)
}

fn within<T: ConvReal>(
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
            "{name} {anchor} {paths:?} {} at {tolerance:.0e}: largest {:.2e} ({:.4} of the tolerance), mean {:.2e}, beyond the \
             stamps {:.1e}, {} violations",
            T::NAME,
            found.largest,
            found.largest / tolerance,
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
    let model = field.psf(FULL)?.into_model()?;
    within::<T>(field.name, &model, field.frame()?, anchor, paths)
}

/// A field that jumps along a slanted line: beyond it, the PSF is that of the position mirrored at the frame's centre.
#[derive(Debug)]
struct Step(PsfModel);

impl CoefficientField for Step {
    fn component_count(&self) -> usize {
        self.0.field().component_count()
    }
    fn evaluate_into(&self, p: Position, coefficients: &mut [f64]) -> Result<(), FieldError> {
        let jumps = p.x() + 0.3 * p.y() > 170.0;
        let mirrored = Position::new(511.0 - p.x(), 511.0 - p.y()).unwrap_or(p);
        self.0
            .field()
            .evaluate_into(if jumps { mirrored } else { p }, coefficients)
    }
}

/// Enough components that the step is one of real PSFs, few enough that they can be weighed pixel by pixel.
const STEP_RANK: usize = 12;

fn step() -> Result<(PsfModel, FrameShape), Failed> {
    let options = FitOptions {
        rank: RankSelection::Fixed(STEP_RANK),
        ..FULL
    };
    let fitted = psfield::fit(STRONG.samples()?, &options)?;
    let record = fitted.record().clone();
    let field = Arc::new(Step(fitted.into_model()?));
    let model = PsfModel::new(record.basis(), field, Normalisation::Keep, None)?;
    Ok((model, FrameShape::new(256, 240)?))
}

fn of_step(anchor: Anchor) -> Result<(), Failed> {
    let (model, frame) = step()?;
    for paths in [Paths::Transforms, Paths::Cheapest] {
        within::<f64>("step", &model, frame, anchor, paths)?;
    }
    Ok(())
}

/// All but the bilinear one, with PSFs scaled to unit flux.
const INTERPOLATIONS: [Interpolation; 5] = [
    Interpolation::Delaunay,
    Interpolation::NaturalNeighbour,
    Interpolation::InverseDistance { power: 2.0 },
    Interpolation::Polynomial { degree: 3 },
    Interpolation::Nearest,
];

fn of_interpolation(interpolation: Interpolation) -> Result<(), Failed> {
    let options = FitOptions {
        interpolation,
        normalisation: Normalisation::Unit,
        rank: RankSelection::Fixed(40),
        centring: Centring::None,
        ..FULL
    };
    let model = psfield::fit(STRONG.samples()?, &options)?.into_model()?;
    let frame = FrameShape::new(251, 199)?;
    for (anchor, _) in ANCHORS {
        within::<f64>(&interpolation.to_string(), &model, frame, anchor, Paths::Cheapest)?;
    }
    Ok(())
}

fn batches() -> Result<(), Failed> {
    let model = STRONG.psf(FULL)?.into_model()?;
    let frame = STRONG.frame()?;
    for (anchor, name) in ANCHORS {
        let options = PlanOptions::new(1e-2)?
            .with_anchor(anchor)
            .with_paths(Paths::Transforms);
        let probes = |count| Probes::random(&model, (frame.nx(), frame.ny()), count, anchor);
        let together = measured::<f64>(&model, &probes(12)?, frame, options, 1.0)?;
        let alone = measured::<f64>(&model, &probes(12)?.one_by_one(12), frame, options, 1.0)?;
        println!("{name}: together {together:?}, alone {alone:?}");
        ensure(
            (together.largest - alone.largest).abs() <= BATCHES
                && (together.mean - alone.mean).abs() <= BATCHES
                && alone.largest > 1e-4,
            || format!("together {together:?}, alone {alone:?}"),
        )?;
    }
    Ok(())
}

/// The PSFs of a coarse tolerance violate a fine one, and the step is no small one.
fn seen() -> Result<(), Failed> {
    let model = STRONG.psf(FULL)?.into_model()?;
    let (stepped, cut) = step()?;
    for (anchor, _) in ANCHORS {
        for (model, frame) in [(&model, STRONG.frame()?), (&stepped, cut)] {
            let probes = Probes::random(model, (frame.nx(), frame.ny()), 60, anchor)?;
            let options = PlanOptions::new(1e-1)?.with_anchor(anchor);
            let found = measured::<f64>(model, &probes, frame, options, 1e-3)?;
            println!(
                "{anchor}: of 60 PSFs made to 1e-1, {} miss 1e-3",
                found.violations
            );
            ensure(found.violations > 50, || format!("{found:?}"))?;
        }
    }
    Ok(())
}
