//! The report of a validation.

use super::document::{Document, Section};
use super::object_figures::{distributions, error_cells, error_table, maps, shape_histograms, target_table};
use super::{Software, Validation, ValidationTruth};
use crate::plot::PlotError;

impl Validation {
    /// The report, with all figures drawn. `inputs` are names and values of what was compared.
    ///
    /// # Errors
    /// [`PlotError`] when a figure cannot be drawn.
    pub fn document(
        &self,
        mut inputs: Vec<(String, String)>,
        software: Software,
    ) -> Result<Document, PlotError> {
        let (name, text) = match self.truth {
            ValidationTruth::Samples => (
                "PSFs",
                "Each PSF is measured twice in the same way, by a Gaussian fit: as the model gives it at that position, and as it was given. \
                 No image is made: what the engine adds is bounded by its tolerance.",
            ),
            ValidationTruth::Frame => (
                "stars",
                "Each star is measured twice in the same window, by a Gaussian fit: in the frame less its background, and as the model draws it \
                 at the measured position with the measured flux, without noise. The differences hold the noise of the frame.",
            ),
        };
        inputs.push((
            "objects".to_owned(),
            format!("{} {name}", self.objects.summary.objects),
        ));
        inputs.push((
            "window".to_owned(),
            format!(
                "{} x {} pixels, {} for each pixel of the frame",
                self.window[0], self.window[1], self.oversampling
            ),
        ));
        inputs.push(("model".to_owned(), format!("{} components", self.rank)));
        let mut errors = error_table("Absolute differences of the model from the truth.", &["objects"]);
        let mut cells = vec![name.to_owned()];
        cells.extend(error_cells(&self.objects.summary));
        errors.rows.push(cells);
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
                    title: "Accuracy".to_owned(),
                    paragraphs: vec![text.to_owned()],
                    tables,
                    figures: Vec::new(),
                },
                Section {
                    title: "FWHM, ellipticity, MAE".to_owned(),
                    figures,
                    ..Section::default()
                },
                Section {
                    title: "Over the field".to_owned(),
                    figures: maps(&self.objects)?,
                    ..Section::default()
                },
            ],
        })
    }
}
