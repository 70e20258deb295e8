//! Figures of objects, simulated and true.

use psf_types::{FrameShape, Position};

use super::document::{NamedFigure, Table};
use super::{ErrorSummary, Evaluation, ObjectRow, Spread, Target};
use crate::plot::{Axis, Curve, Curves, FieldMap, HistogramPanel, Mark, PlotError, Scale, histograms};
use crate::report::document::short;

/// Part of the values that the colours of a map tell apart; the rest has the colour of the nearer end.
const SHOWN_PART: f64 = 0.99;

/// Differences of ellipticity and FWHM as histograms.
pub(super) fn shape_histograms(of: &Evaluation) -> Result<Vec<NamedFigure>, PlotError> {
    let [rows, columns] = [
        ("FWHM along rows, pixels", &of.fwhm_rows_px),
        ("FWHM along columns, pixels", &of.fwhm_columns_px),
    ]
    .map(|(quantity, [truth, simulated])| HistogramPanel {
        quantity,
        histograms: vec![("true", truth), ("simulated", simulated)],
    });
    Ok(vec![
        NamedFigure {
            name: "fwhm",
            caption: format!(
                "FWHM of {} objects along rows and along columns, true (filled) and simulated (line). Where the line follows the edge of the \
                 filled area the two agree.",
                of.summary.objects
            ),
            figure: histograms(&[rows, columns])?,
        },
        NamedFigure {
            name: "ellipticity-differences",
            caption: "Absolute differences of the ellipticity e = sqrt(1 - b^2/a^2), and MAE over the mean."
                .to_owned(),
            figure: histograms(&[
                HistogramPanel {
                    quantity: "|e simulated - e true|",
                    histograms: vec![("objects", &of.ellipticity_differences)],
                },
                HistogramPanel {
                    quantity: "MAE / mean",
                    histograms: vec![("objects", &of.mae_over_mean)],
                },
            ])?,
        },
    ])
}

/// Cumulative distributions, each kind of object a line.
pub(super) fn distributions(
    kinds: &[(&str, &Evaluation)],
    paper_q90: Option<f64>,
) -> Result<Vec<NamedFigure>, PlotError> {
    let curves = |of: fn(&ObjectRow) -> Option<f64>| -> Vec<Curve> {
        kinds
            .iter()
            .map(|(name, evaluation)| {
                Curve::distribution(name, evaluation.rows.iter().filter_map(of).map(f64::abs))
            })
            .collect()
    };
    let q90 = |of: fn(&ErrorSummary) -> Option<Spread>| -> Vec<Mark> {
        let mut marks = vec![Mark::Horizontal(0.9, "90 %".to_owned())];
        if let Some((_, first)) = kinds.first()
            && let Some(spread) = of(&first.summary)
            && spread.q90 > 0.0
        {
            marks.push(Mark::Vertical(spread.q90, short(Some(spread.q90))));
        }
        marks
    };
    let mut of_ellipticity = q90(|s| s.ellipticity);
    if let Some(paper) = paper_q90 {
        of_ellipticity.push(Mark::Vertical(paper, format!("paper: {paper}")));
    }
    let drawn = |x: &str, curves, marks| {
        Curves {
            x: Axis::logarithmic(x),
            y: Axis::linear("part of the objects below"),
            curves,
            marks,
        }
        .figure()
    };
    Ok(vec![
        NamedFigure {
            name: "ellipticity-distribution",
            caption: "Distribution of the absolute differences of ellipticity; the lines mark 90 % of the objects (first kind)."
                .to_owned(),
            figure: drawn(
                "|e simulated - e true|",
                curves(ObjectRow::ellipticity_difference),
                of_ellipticity,
            )?,
        },
        NamedFigure {
            name: "mae-distribution",
            caption: "Distribution of the mean absolute error of each object's window over the window's mean.".to_owned(),
            figure: drawn("MAE / mean", curves(|r| r.mae_over_mean), q90(|s| s.mae_over_mean))?,
        },
    ])
}

/// Maps over the field: MSE, differences of e1 and of e2 (with one scale).
pub(super) fn maps(of: &Evaluation) -> Result<Vec<NamedFigure>, PlotError> {
    let Some(frame) = of.frame.or_else(|| frame_about(&of.rows)) else {
        return Ok(Vec::new());
    };
    let values = |value: fn(&ObjectRow) -> Option<f64>| -> Vec<(Position, Option<f64>)> {
        of.rows
            .iter()
            .filter_map(|r| Some((r.position()?, value(r))))
            .collect()
    };
    let (mse, e1, e2) = (
        values(|r| r.mse),
        values(ObjectRow::e1_difference),
        values(ObjectRow::e2_difference),
    );
    let both = e1.iter().chain(&e2).filter_map(|v| v.1.map(f64::abs));
    let most = quantile(both, SHOWN_PART).filter(|&m| m > 0.0).unwrap_or(1e-12);
    let positive = || mse.iter().filter_map(|v| v.1).filter(|&v| v > 0.0);
    let low = quantile(positive(), 1.0 - SHOWN_PART).unwrap_or(0.1);
    let high = quantile(positive(), SHOWN_PART).unwrap_or(1.0).max(1.25 * low);
    let map = |title, quantity, values: &[(Position, Option<f64>)], scale| {
        FieldMap {
            title,
            quantity,
            frame,
            values,
            grid_columns: of.grid_columns,
            scale,
        }
        .figure()
    };
    let differences = Scale::Difference { most };
    let saturated = "the 1 % of the values of both maps that are beyond the bar have the colours of its ends";
    Ok(vec![
        NamedFigure {
            name: "mse-map",
            caption: "Mean squared error of each object's window over the field; the 1 % of the values below the bar and the 1 % above it have \
                      the colours of its ends."
                .to_owned(),
            figure: map(
                "mean squared error",
                "MSE, squared flux a pixel",
                &mse,
                Scale::Logarithmic { low, high },
            )?,
        },
        NamedFigure {
            name: "e1-map",
            caption: format!("Differences of e1 (distortion), simulated less true, on the scale of e2; {saturated}."),
            figure: map("difference of e1", "e1 difference", &e1, differences)?,
        },
        NamedFigure {
            name: "e2-map",
            caption: format!("Differences of e2, on the scale of e1; {saturated}."),
            figure: map("difference of e2", "e2 difference", &e2, differences)?,
        },
    ])
}

/// The columns of [`error_cells`].
const ERROR_COLUMNS: [&str; 10] = [
    "e: 90 %",
    "e: largest",
    "e1: 90 %",
    "e2: 90 %",
    "FWHM: 90 %, px",
    "FWHM: largest, px",
    "MAE/mean: median",
    "MAE/mean: 90 %",
    "MAE/mean: largest",
    "failed",
];

/// The figures of a summary for a table.
fn error_cells(summary: &ErrorSummary) -> [String; 10] {
    let cell = |spread: Option<Spread>, of: fn(Spread) -> f64| short(spread.map(of));
    [
        cell(summary.ellipticity, |s| s.q90),
        cell(summary.ellipticity, |s| s.largest),
        cell(summary.e1, |s| s.q90),
        cell(summary.e2, |s| s.q90),
        cell(summary.fwhm_px, |s| s.q90),
        cell(summary.fwhm_px, |s| s.largest),
        cell(summary.mae_over_mean, |s| s.median),
        cell(summary.mae_over_mean, |s| s.q90),
        cell(summary.mae_over_mean, |s| s.largest),
        summary.failed.to_string(),
    ]
}

/// A table of errors: the caller's first columns and cells, then those of a summary.
pub(super) fn error_table<'a>(
    caption: &str,
    first: &[&str],
    rows: impl IntoIterator<Item = (Vec<String>, &'a ErrorSummary)>,
) -> Table {
    let columns: Vec<&str> = first.iter().copied().chain(ERROR_COLUMNS).collect();
    let rows = rows.into_iter();
    Table {
        rows: rows
            .map(|(first, summary)| first.into_iter().chain(error_cells(summary)).collect())
            .collect(),
        ..Table::new(caption, &columns)
    }
}

/// What should hold, and whether it does.
pub(super) fn target_table(caption: &str, targets: &[Target]) -> Table {
    let mut table = Table::new(caption, &["quantity", "should be below", "measured", "met"]);
    for target in targets {
        table.rows.push(vec![
            target.what.clone(),
            short(Some(target.limit)),
            short(target.measured),
            if target.met { "yes" } else { "no" }.to_owned(),
        ]);
    }
    table
}

fn quantile(values: impl Iterator<Item = f64>, q: f64) -> Option<f64> {
    metrics::Summary::of(values).ok()?.quantile(q).ok()
}

/// A frame that holds all objects, where none is known.
fn frame_about(rows: &[ObjectRow]) -> Option<FrameShape> {
    let side = |of: fn(&ObjectRow) -> f64| {
        let largest = rows.iter().map(of).fold(0.0, f64::max);
        largest.ceil() as usize + 1
    };
    FrameShape::new(side(|r| r.x), side(|r| r.y)).ok()
}
