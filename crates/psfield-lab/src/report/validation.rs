//! Compares a model with known PSFs or with the stars of a frame, and reports the errors.

use conv_core::StampInterpolator;
use ndarray::{Array2, Zip, s};
use psf_stars::StarSampling;
use psf_types::{FrameShape, Normalisation, Position, PsfModel, PsfSamples};
use psfield::evaluate::{check_frame_on_field, check_on_field};
use rayon::prelude::*;
use serde::Serialize;

use crate::LabError;
use crate::report::document::{Document, Section};
use crate::report::object_figures::{error_table, target_table, with_maps, with_shapes};
use crate::report::{Evaluation, ObjectRow, Software, Target};
use crate::round_trip::{drawn, drawn_sources, measuring_window};

/// The errors of a model against known PSFs or against the stars of a frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Validation {
    /// The kind of truth.
    pub truth: ValidationTruth,
    /// Columns and rows of the compared windows.
    pub window: [usize; 2],
    /// Window pixels per frame pixel along each axis. Each FWHM in `objects` is in pixels of the
    /// frame.
    pub oversampling: f64,
    /// Components of the model, the mean not counted.
    pub rank: usize,
    /// Number of objects that lie on samples of the model, counted by
    /// [`with_training`](Self::with_training). None if they were not counted.
    pub at_samples: Option<usize>,
    /// The accuracy targets for PSFs without noise. Empty for a frame.
    pub targets: Vec<Target>,
    /// The errors of the PSFs or stars.
    pub objects: Evaluation,
}

/// The truth with which a model is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ValidationTruth {
    /// Samples of known PSFs.
    Samples,
    /// Stars of a frame that has noise.
    Frame,
}

impl Validation {
    /// Compares the model's PSFs with samples, at the positions and on the pixels of the samples.
    /// The model's PSFs are exact sums over its components. If they are scaled to unit flux, the
    /// samples are, too.
    ///
    /// # Errors
    /// [`ErrorKind::Field`](psfield::ErrorKind::Field) for a sample outside the model's field or if
    /// the model has no value there. [`LabError::TruthWithoutPixels`] if the PSFs of the model
    /// include the pixel response and the samples lack it.
    pub fn of_samples(model: &PsfModel, truth: &PsfSamples) -> Result<Self, LabError> {
        let grid = truth.grid();
        let own = model.whole_grid();
        if own.pixel_response_included() && !grid.pixel_response_included() {
            return Err(LabError::TruthWithoutPixels);
        }
        let unit = model.normalisation() == Normalisation::Unit;
        let positions = truth.positions().as_slice();
        check_on_field(model, positions)?;
        let ours: Vec<Array2<f64>> = positions
            .par_iter()
            .map(|&at| {
                let psf = model.psf_at(at)?;
                let stamp = if grid == own {
                    psf.into_values()
                } else {
                    StampInterpolator::new(psf.values(), own).resample((0.0, 0.0), grid)
                };
                // The grid of the model may reach further than the grid of the truth. Both PSFs
                // therefore get unit flux on the grid of the truth.
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
        let objects = Evaluation::measure(positions, &ours, &theirs, grid.oversampling(), frame, None);
        Ok(Self {
            truth: ValidationTruth::Samples,
            window: [grid.nx(), grid.ny()],
            oversampling: grid.oversampling(),
            rank: model.rank(),
            at_samples: None,
            targets: Target::of("PSFs", &objects.summary),
            objects,
        })
    }

    /// Compares a frame minus its background with stars drawn by the model. The model draws all
    /// sources found, at their measured positions and with their measured fluxes, without noise.
    /// The measured windows lie around the stars that are good enough to be samples. `window` is
    /// their side in pixels (None: four FWHM, at least 7). The differences include the noise of the
    /// frame and the errors of the measured positions. `frame` is `[y, x]`. NaN stands for a masked
    /// pixel ([`StarSampling::run_masked`]). The comparison replaces it by the drawn value.
    ///
    /// # Errors
    /// [`ErrorKind::Data`](psfield::ErrorKind::Data) for a frame without pixels,
    /// [`ErrorKind::Field`](psfield::ErrorKind::Field) if the frame is larger than the model's
    /// field, [`ErrorKind::Stars`](psfield::ErrorKind::Stars) if no star is good enough to be a
    /// sample, [`LabError::NothingMeasured`] if no such star can be measured both in the frame and
    /// as drawn, and the errors of drawing.
    pub fn of_frame(
        model: &PsfModel,
        frame: Array2<f64>,
        sampling: &StarSampling,
        window: Option<usize>,
    ) -> Result<Self, LabError> {
        let shape = FrameShape::new(frame.ncols(), frame.nrows())?;
        check_frame_on_field(shape, model.field_shape())?;
        let stars = sampling.run_masked(frame.clone())?;
        let window = window
            .unwrap_or_else(|| measuring_window(stars.fwhm_px))
            .min(shape.nx())
            .min(shape.ny());
        let simulated = drawn(model, &drawn_sources(&stars)?, shape)?;
        let mut light = frame - stars.background.level();
        // Masked pixels get the drawn values, so that they add no difference.
        Zip::from(&mut light).and(&simulated).for_each(|light, &drawn| {
            if light.is_nan() {
                *light = drawn;
            }
        });

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
        let objects = Evaluation::measure(&positions, &ours, &theirs, 1.0, Some(shape), None);
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
            at_samples: None,
            targets: Vec::new(),
            objects,
        })
    }
}

/// An object lies on a sample of the model if the distance between them is smaller than this, in
/// pixels of the frame.
const ON_SAMPLE_PX: f64 = 0.5;

impl Validation {
    /// Sets [`at_samples`](Self::at_samples) to the number of objects that are closer than half a
    /// pixel of the frame to one of the `samples` from which the model was made. The errors of
    /// these objects do not show the error of the model between its samples.
    #[must_use]
    pub fn with_training(mut self, samples: &[Position]) -> Self {
        let near = |row: &&ObjectRow| {
            let mut distances = samples.iter().map(|s| (s.x() - row.x).hypot(s.y() - row.y));
            distances.any(|distance| distance < ON_SAMPLE_PX)
        };
        self.at_samples = Some(self.objects.rows.iter().filter(near).count());
        self
    }

    /// Makes the report without its [`sections`](Self::sections). `inputs` lists the compared files,
    /// each with its role (such as `PSF model`) and its path.
    pub fn document(&self, mut inputs: Vec<(&'static str, String)>, software: Software) -> Document {
        let at_samples = match self.at_samples {
            Some(count) => format!("{count} of them at positions of the model's own samples"),
            None => "the positions of the model's own samples are not known".to_owned(),
        };
        let ([nx, ny], finer, count) = (self.window, self.oversampling, self.objects.summary.objects);
        let window = format!("{nx} x {ny} pixels, {finer} per frame pixel along each axis");
        inputs.extend([
            (
                "objects",
                format!("{count} {}, {at_samples}", self.truth.objects()),
            ),
            ("window", window),
            ("model", format!("{} components", self.rank)),
        ]);
        Document {
            title: "psfield: a PSF model against the truth",
            software,
            inputs,
            sections: Vec::new(),
        }
    }

    /// Makes the sections of the report, with all figures.
    pub fn sections(&self) -> Vec<Section> {
        let name = self.truth.objects();
        let (image, text) = match self.truth {
            ValidationTruth::Samples => (
                "model",
                "Each PSF of the truth is compared with the PSF of the model at its position. Both are measured by a Gaussian fit. If \
                 the PSFs of the model have unit flux, both PSFs are scaled to unit flux. No image is simulated, so the differences do not \
                 include the error of the convolution, which the tolerance of a simulation limits.",
            ),
            ValidationTruth::Frame => (
                "simulated",
                "Each star is measured twice in the same window, by a Gaussian fit: in the frame minus its background, and as drawn by the \
                 model at the measured position with the measured flux, without noise. The differences include the noise of the frame.",
            ),
        };
        let accuracy = Section::new("Accuracy", [text]).with_table(error_table(
            "Absolute differences between the model and the truth. Lengths are in pixels of the frame.",
            &[("objects", &|_| name.to_owned())],
            [&self.objects.summary],
            |summary| summary,
        ));
        let accuracy = match self.targets.as_slice() {
            [] => accuracy,
            targets => accuracy.with_table(target_table("psfield's targets for PSFs without noise", targets)),
        };
        let shapes = Section::new("FWHM, eccentricity, MAE", []);
        vec![
            accuracy,
            with_shapes(shapes, &[(name, &self.objects)], image, None),
            with_maps(Section::new("Over the field", []), &self.objects, image),
        ]
    }
}

impl ValidationTruth {
    /// The name of the compared objects.
    fn objects(self) -> &'static str {
        match self {
            Self::Samples => "PSFs",
            Self::Frame => "stars",
        }
    }
}
