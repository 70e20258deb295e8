//! The report of a reproduction.

mod accuracy;
mod objects;
mod patches;
mod samples;

use super::document::Document;
use super::{Reproduction, Software};
use crate::plot::PlotError;

impl Reproduction {
    /// The report, with all figures drawn.
    ///
    /// # Errors
    /// [`PlotError`] when a figure cannot be drawn.
    pub fn document(&self, software: Software) -> Result<Document, PlotError> {
        let [radius, index, ratio, angle] = self.galaxy;
        let inputs = [
            ("telescope", format!("{} (preset survey-2m)", self.telescope)),
            ("frame", format!("{} pixels", self.frame)),
            ("stamps", format!("{} x {} pixels", self.stamp[0], self.stamp[1])),
            ("PSF samples", format!("{}, on a regular grid", self.samples)),
            (
                "objects",
                format!("{} stars and {} galaxies", self.objects, self.objects),
            ),
            (
                "galaxies",
                format!(
                    "half-light radius {radius} pixels, Sersic index {index}, axis ratio {ratio}, angle {angle} degrees"
                ),
            ),
            (
                "model",
                format!(
                    "{} components, interpolation {}, default settings",
                    self.basis.rank, self.basis.interpolation
                ),
            ),
            (
                "tolerance of the figures",
                format!("{:e} (default)", self.tolerance),
            ),
            ("seconds", format!("{:.0}", self.seconds)),
        ];
        Ok(Document {
            title: "psfield: a spatially varying PSF against the truth".to_owned(),
            software,
            inputs: inputs
                .into_iter()
                .map(|(name, value)| (name.to_owned(), value))
                .collect(),
            sections: vec![
                self.accuracy_section(),
                self.basis_section()?,
                self.sampling_section()?,
                self.shape_section()?,
                self.map_section()?,
                self.galaxy_section()?,
                self.table_1_section(),
            ],
        })
    }
}
