//! Targets and errors.

use crate::report::document::Section;
use crate::report::object_figures::{error_cells, error_table, target_table};
use crate::report::{ModelRow, ObjectKind, Reproduction};

impl Reproduction {
    pub(super) fn accuracy_section(&self) -> Section {
        let targets = target_table(
            "Targets, at the default tolerance. The paper reports 0.0901 for 90 % of its differences of ellipticity.",
            &self.targets,
        );
        let mut tolerances = error_table(
            "Objects drawn by transforms alone at several tolerances, against the optics' own images. Absolute differences.",
            &["objects", "tolerance", "seconds a frame"],
        );
        for row in &self.tolerances {
            let kind = match row.kind {
                ObjectKind::Point => "stars",
                ObjectKind::Extended => "galaxies",
            };
            let mut cells = vec![
                kind.to_owned(),
                format!("{:e}", row.tolerance),
                format!("{:.1}", row.seconds),
            ];
            cells.extend(error_cells(&row.summary));
            tolerances.rows.push(cells);
        }
        let mut interpolations = error_table(
            "The model's PSFs by the exact sum, without the engine, with other interpolators of the same coefficients.",
            &["interpolation"],
        );
        for row in &self.interpolations {
            let name = if row.in_use {
                format!("{} (in use)", row.interpolation)
            } else {
                row.interpolation.to_string()
            };
            let mut cells = vec![name];
            cells.extend(error_cells(&row.summary));
            interpolations.rows.push(cells);
        }
        let mut tables = vec![targets, tolerances, interpolations];
        // Of few samples there are no fewer.
        if !self.fewer_samples.is_empty() {
            tables.push(ModelRow::table(
                "Models of fewer samples on regular grids, default settings, by the exact sum.",
                &self.fewer_samples,
            ));
        }
        tables.push(ModelRow::table(
            "The model with fewer components, by the exact sum.",
            &self.fewer_components,
        ));
        Section {
            title: "Accuracy".to_owned(),
            paragraphs: vec![
                "Each object is measured twice in the same window by a Gaussian fit: in the image that the fast engine made, and in the true \
                 image, for which the optics were evaluated at the object's own position. The error has three parts: the samples and the \
                 interpolation between them, the components left out (at most 1e-4, relative L2, at a sample), and the engine's tolerance. \
                 Where a row of the first table hardly differs from the next, the engine is no longer the largest of them; the second table \
                 shows what remains without it: bilinear and natural neighbour interpolation leave the curvature of the PSF between samples, which \
                 cubics follow, and a polynomial over the whole field (--interpolation polynomial=D) where optics are as smooth as these."
                    .to_owned(),
            ],
            tables,
            figures: Vec::new(),
        }
    }
}
