//! Comparison of a given model with given PSFs, and its report.

use conv_core::StampInterpolator;
use ndarray::{Array2, s};
use psf_stars::StarSampling;
use psf_types::{Image, Normalisation, Position, PsfModel, PsfSamples};
use psfield::{check_frame_on_field, check_on_field};
use rayon::prelude::*;
use serde::Serialize;

use crate::LabError;
use crate::plot::PlotError;
use crate::report::document::{Document, Section};
use crate::report::object_figures::{distributions, error_table, maps, shape_histograms, target_table};
use crate::report::{Evaluation, Software, Target};
use crate::round_trip::{drawn, drawn_sources, measuring_window};

/// The errors of a model against known PSFs.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Validation {
    /// The kind of truth.
    pub truth: ValidationTruth,
    /// Pixels along each side of the window that is compared.
    pub window: [usize; 2],
    /// Pixels of the window per pixel of the frame. Lengths are in pixels of the window.
    pub oversampling: f64,
    /// Components of the model, the mean not counted.
    pub rank: usize,
    /// The targets for PSFs without noise. Empty for a frame.
    pub targets: Vec<Target>,
    /// The PSFs.
    pub objects: Evaluation,
}

/// The truth with which a model is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ValidationTruth {
    /// PSFs.
    Samples,
    /// Stars of a frame, with its noise.
    Frame,
}

impl Validation {
    /// Compares the model's PSFs, by the exact sum over its components, with the samples at their
    /// positions and on their pixels. Both are scaled to unit flux if the PSFs of the model are.
    ///
    /// # Errors
    /// [`ErrorKind::Field`](psfield::ErrorKind::Field) for a sample outside the model's field or if
    /// the model has no value there, [`LabError::TruthWithoutPixels`].
    pub fn of_samples(model: &PsfModel, truth: &PsfSamples) -> Result<Self, LabError> {
        let grid = truth.grid();
        if model.grid().pixel_response_included() && !grid.pixel_response_included() {
            return Err(LabError::TruthWithoutPixels);
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
                // Both hold the same part of the light, even if one grid reaches further than the
                // other.
                let flux = if unit { grid.flux_of_sum(stamp.sum()) } else { 1.0 };
                Ok(stamp / flux)
            })
            .collect::<Result<_, LabError>>()?;
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

    /// Compares a frame minus its background with stars drawn by the model: all sources found, at
    /// their measured positions and fluxes, without noise. The windows measured are those around
    /// the stars that are good enough to be samples. The differences include the noise of the frame
    /// and the errors of the measured positions.
    ///
    /// # Errors
    /// [`ErrorKind::Stars`](psfield::ErrorKind::Stars) if the frame has no such stars,
    /// [`LabError::NothingMeasured`] if none can be measured in both, and the errors of drawing.
    pub fn of_frame(
        model: &PsfModel,
        frame: &Image<f64>,
        sampling: &StarSampling,
        window: Option<usize>,
    ) -> Result<Self, LabError> {
        let shape = frame.shape();
        check_frame_on_field(shape, model.field_shape())?;
        let stars = sampling.run(frame)?;
        let window = window
            .unwrap_or_else(|| measuring_window(stars.fwhm_px))
            .min(shape.nx())
            .min(shape.ny());
        let simulated = drawn(model, &drawn_sources(&stars)?, shape)?;
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
            return Err(LabError::NothingMeasured {
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

impl Validation {
    /// Makes the report, with all figures. `inputs` are names and values of the compared files.
    ///
    /// # Errors
    /// [`PlotError`] when a figure cannot be drawn.
    pub fn document(
        &self,
        mut inputs: Vec<(&'static str, String)>,
        software: Software,
    ) -> Result<Document, PlotError> {
        let (name, text) = match self.truth {
            ValidationTruth::Samples => (
                "PSFs",
                "Each PSF is measured twice in the same way, by a Gaussian fit: as given by the model at that position, and as given in the \
                 truth. No image is simulated: the error of the engine is bounded by its tolerance.",
            ),
            ValidationTruth::Frame => (
                "stars",
                "Each star is measured twice in the same window, by a Gaussian fit: in the frame minus its background, and as drawn by the \
                 model at the measured position with the measured flux, without noise. The differences include the noise of the frame.",
            ),
        };
        inputs.push(("objects", format!("{} {name}", self.objects.summary.objects)));
        let ([nx, ny], finer) = (self.window, self.oversampling);
        let window = format!("{nx} x {ny} pixels, {finer} per pixel of the frame");
        inputs.push(("window", window));
        inputs.push(("model", format!("{} components", self.rank)));
        let errors = error_table(
            "Absolute differences between the model and the truth.",
            &["objects"],
            [(vec![name.to_owned()], &self.objects.summary)],
        );
        let mut tables = vec![errors];
        if !self.targets.is_empty() {
            tables.push(target_table("Targets for PSFs without noise", &self.targets));
        }
        let mut figures = shape_histograms(&self.objects)?;
        figures.extend(distributions(&[(name, &self.objects)], None)?);
        Ok(Document {
            title: "psfield: a PSF model against the truth".to_owned(),
            software,
            inputs,
            sections: vec![
                Section {
                    tables,
                    ..Section::new("Accuracy", Some(text.to_owned()), Vec::new())
                },
                Section::new("FWHM, ellipticity, MAE", None, figures),
                Section::new("Over the field", None, maps(&self.objects)?),
            ],
        })
    }
}
