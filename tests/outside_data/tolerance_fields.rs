//! The tolerance of the fast engine for fields that are not bilinear, and for a field with a jump.

use std::sync::Arc;

use libtest_mimic::{Failed, Trial};
use psfield::FitOptions;
use psfield::conv_core::Paths;
use psfield::psf_basis::{Centring, RankSelection};
use psfield::psf_types::{
    Anchor, CoefficientField, FieldError, FrameShape, Interpolation, Normalisation, Position, PsfModel,
};

use crate::data::{STRONG, trial};
use crate::simulation::{ANCHORS, FULL};
use crate::tolerance::within;

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = Vec::new();
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
    trials
}

/// A field that jumps along a slanted line. Beyond the line, it returns the coefficients of the
/// position mirrored at the frame's centre.
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

/// Enough components for real PSFs on both sides of the step, and few enough to test pixel by
/// pixel.
const STEP_RANK: usize = 12;

/// The model with the step, and a frame that the step crosses.
pub(crate) fn step() -> Result<(PsfModel, FrameShape), Failed> {
    let options = FitOptions {
        rank: RankSelection::Fixed(STEP_RANK),
        ..FULL
    };
    let fitted = psfield::fit::fit(STRONG.samples()?, &options)?;
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

/// All interpolators except the bilinear one, with PSFs scaled to unit flux.
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
    let model = psfield::fit::fit(STRONG.samples()?, &options)?.into_model()?;
    let frame = FrameShape::new(251, 199)?;
    for (anchor, _) in ANCHORS {
        within::<f64>(&interpolation.to_string(), &model, frame, anchor, Paths::Cheapest)?;
    }
    Ok(())
}
