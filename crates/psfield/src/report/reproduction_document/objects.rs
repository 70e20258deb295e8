//! Stars and galaxies over the field.

use crate::plot::PlotError;
use crate::report::Reproduction;
use crate::report::document::Section;
use crate::report::object_figures::{distributions, maps, shape_histograms};
use crate::report::targets::PAPER_ELLIPTICITY_Q90;

impl Reproduction {
    pub(super) fn shape_section(&self) -> Result<Section, PlotError> {
        let mut figures = shape_histograms(&self.stars)?;
        figures.extend(distributions(
            &[("stars", &self.stars), ("galaxies", &self.galaxies)],
            Some(PAPER_ELLIPTICITY_Q90),
        )?);
        Ok(Section {
            title: "FWHM, ellipticity, MAE".to_owned(),
            paragraphs: vec![format!(
                "The histograms are of the {} stars, at the default tolerance.",
                self.objects
            )],
            figures,
            ..Section::default()
        })
    }

    pub(super) fn map_section(&self) -> Result<Section, PlotError> {
        Ok(Section {
            title: "Over the field".to_owned(),
            paragraphs: vec!["Stars of unit flux, at the default tolerance.".to_owned()],
            figures: maps(&self.stars)?,
            ..Section::default()
        })
    }
}
