//! The samples and what they are made of.

use crate::plot::{Axis, Curve, Curves, Mark, PlotError, positions_figure};
use crate::readable::short;
use crate::report::Reproduction;
use crate::report::document::{NamedFigure, Section};

impl Reproduction {
    pub(super) fn basis_section(&self) -> Result<Section, PlotError> {
        let weights = &self.basis.cumulative_weights;
        let points = weights
            .iter()
            .enumerate()
            .map(|(k, &w)| ((k + 1) as f64, w))
            .collect();
        let at = |k: usize| k.checked_sub(1).and_then(|i| weights.get(i)).copied();
        let mark =
            |k: usize, name: &str| at(k).map(|w| Mark::Point(k as f64, w, format!("{name}: {k} components")));
        let marks = match self.basis.elbow {
            Some(elbow) if elbow == self.basis.rank => mark(elbow, "elbow, and kept").into_iter().collect(),
            elbow => elbow
                .and_then(|k| mark(k, "elbow"))
                .into_iter()
                .chain(mark(self.basis.rank, "kept"))
                .collect(),
        };
        let figure = Curves {
            x: Axis::logarithmic("components"),
            y: Axis::linear("cumulative weight of the singular values"),
            curves: vec![Curve::new("cumulative weight", points)],
            marks,
        }
        .figure()?;
        Ok(Section {
            title: "Singular values".to_owned(),
            paragraphs: vec![format!(
                "{} components are kept; no sample is off by more than {} (relative L2) for the others. Samples predicted from their \
                 neighbours alone, at twice the distance between samples, are off by {} in the median.",
                self.basis.rank,
                short(Some(self.basis.max_error)),
                short(self.basis.leave_one_out_median),
            )],
            figures: vec![NamedFigure {
                name: "singular-values",
                caption: "Cumulative weight of the singular values, sum of the first k over the sum of all, with the elbow.".to_owned(),
                figure,
            }],
            ..Section::default()
        })
    }

    pub(super) fn sampling_section(&self) -> Result<Section, PlotError> {
        let panels = [
            (
                format!("regular: {} samples", self.samples),
                self.sample_positions.as_slice(),
            ),
            (
                format!("non-uniform: {} samples", self.adaptive_samples),
                self.adaptive_positions.as_slice(),
            ),
        ];
        Ok(Section {
            title: "Sampling".to_owned(),
            figures: vec![NamedFigure {
                name: "sampling",
                caption: format!(
                    "Where the PSF is sampled: the regular grid of this report, and psfield's non-uniform sampling, refined until interpolation \
                     between samples is within {} (relative L2).",
                    short(Some(self.adaptive_threshold))
                ),
                figure: positions_figure(&panels, self.frame)?,
            }],
            ..Section::default()
        })
    }
}
