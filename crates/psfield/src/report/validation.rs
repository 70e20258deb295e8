//! A given model against given PSFs.

use conv_core::{StampInterpolator, add_point_sources};
use ndarray::{Array2, s};
use psf_stars::StarSampling;
use psf_types::{Anchor, Image, Normalisation, Position, PsfModel, PsfSamples, Scene};
use rayon::prelude::*;
use serde::Serialize;

use super::{Evaluation, Target};
use crate::PsfieldError;
use crate::evaluate::check_on_field;
use crate::star_frame::{drawn_sources, measuring_window};

/// How far a model is from PSFs that are known.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Validation {
    /// What the model is compared with.
    pub truth: ValidationTruth,
    /// Pixels along each side of the window that is compared.
    pub window: [usize; 2],
    /// Pixels of the window for each pixel of the frame; lengths are in pixels of the window.
    pub oversampling: f64,
    /// Components of the model, the mean not counted.
    pub rank: usize,
    /// The targets for PSFs without noise, and whether they are met; none for a frame.
    pub targets: Vec<Target>,
    /// The PSFs.
    pub objects: Evaluation,
}

/// What a model is compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ValidationTruth {
    /// PSFs.
    Samples,
    /// Stars of a frame, with its noise.
    Frame,
}

impl Validation {
    /// Compares the model's PSFs, by the exact sum over its components, with the samples at their positions and on their pixels. Both hold
    /// unit flux where the model's do.
    ///
    /// # Errors
    /// [`PsfieldError::OutsideField`] for a sample off the model's field, [`PsfieldError::Field`] where the model has no value,
    /// [`PsfieldError::TruthWithoutPixels`].
    pub fn of_samples(model: &PsfModel, truth: &PsfSamples) -> Result<Self, PsfieldError> {
        let grid = truth.grid();
        if model.grid().pixel_response_included() && !grid.pixel_response_included() {
            return Err(PsfieldError::TruthWithoutPixels);
        }
        let unit = model.normalisation() == Normalisation::Unit;
        let positions = truth.positions().as_slice();
        check_on_field(model, positions)?;
        let ours: Vec<Array2<f64>> = positions
            .par_iter()
            .map(|&at| {
                let psf = model.psf_at(at)?;
                let stamp = if grid == model.grid() {
                    psf.into_values()
                } else {
                    StampInterpolator::new(psf.values(), model.grid()).resample((0.0, 0.0), grid)
                };
                // The same part of the light in both, where one grid reaches further than the other.
                let flux = if unit { grid.flux_of_sum(stamp.sum()) } else { 1.0 };
                Ok(stamp / flux)
            })
            .collect::<Result<_, PsfieldError>>()?;
        let theirs: Vec<Array2<f64>> = (0..truth.len())
            .map(|k| {
                let flux = if unit { truth.flux(k) } else { 1.0 };
                &truth.stamp(k) / flux
            })
            .collect();
        let frame = truth.positions().field().or(model.field_shape());
        let objects = Evaluation::measure(positions, &ours, &theirs, frame, None);
        Ok(Self {
            truth: ValidationTruth::Samples,
            window: [grid.nx(), grid.ny()],
            oversampling: grid.oversampling(),
            rank: model.rank(),
            targets: Target::of("PSFs", &objects.summary),
            objects,
        })
    }

    /// Compares a frame with the stars that the model draws: all sources found, at their measured positions and fluxes, without noise; the
    /// frame less its background. Measured in windows about the stars that are good enough to be samples. The differences hold the frame's
    /// noise and the errors of the measured positions.
    ///
    /// # Errors
    /// [`PsfieldError::Stars`] when the frame has no such stars, [`PsfieldError::NothingMeasured`] when none can be measured in both,
    /// and the errors of drawing.
    pub fn of_frame(
        model: &PsfModel,
        frame: &Image<f64>,
        sampling: &StarSampling,
        window: Option<usize>,
    ) -> Result<Self, PsfieldError> {
        let shape = frame.shape();
        if let Some(field) = model.field_shape()
            && (shape.nx() > field.nx() || shape.ny() > field.ny())
        {
            return Err(PsfieldError::FrameBeyondField { frame: shape, field });
        }
        let stars = sampling.run(frame)?;
        let window = window
            .unwrap_or_else(|| measuring_window(stars.fwhm_px))
            .min(shape.nx())
            .min(shape.ny());
        let scene = Scene::<f64>::dark(shape).with_sources(drawn_sources(&stars)?);
        let mut simulated = Array2::zeros(frame.pixels().dim());
        add_point_sources(model, &scene, Anchor::Source, &mut simulated)?;
        let light = &frame.pixels() - &stars.background.level();

        let corner = |v: f64, n: usize| {
            let first = (v + 0.5).floor() as i64 - (window / 2) as i64;
            first.clamp(0, (n - window) as i64) as usize
        };
        let mut positions = Vec::new();
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        for star in stars.sources.iter().filter(|s| s.sample.is_some()) {
            let (x0, y0) = (corner(star.x, shape.nx()), corner(star.y, shape.ny()));
            let part = s![y0..y0 + window, x0..x0 + window];
            ours.push(simulated.slice(part).to_owned());
            theirs.push(light.slice(part).to_owned());
            positions.push(Position::new(star.x, star.y)?);
        }
        let objects = Evaluation::measure(&positions, &ours, &theirs, Some(shape), None);
        if objects.summary.failed == objects.summary.objects {
            return Err(PsfieldError::NothingMeasured {
                stars: positions.len(),
                window,
            });
        }
        Ok(Self {
            truth: ValidationTruth::Frame,
            window: [window; 2],
            oversampling: 1.0,
            rank: model.rank(),
            targets: Vec::new(),
            objects,
        })
    }
}
