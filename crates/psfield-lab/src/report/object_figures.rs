//! Figures and tables of the differences between simulated and true objects.

use psf_types::{FrameShape, Position};

use super::document::{NamedFigure, Table};
use super::{ErrorSummary, Evaluation, ObjectRow, Spread, Target};
use crate::plot::{Axis, Curve, Curves, FieldMap, HistogramPanel, Mark, PlotError, Scale, histograms};
use crate::report::document::short;

/// The colours of a map end at this quantile of the values (for e1 and e2: of the absolute values).
/// The colours of the MSE map begin at the quantile `1 - SHOWN_PART`. Values outside get the colour
/// of the nearer end.
const SHOWN_PART: f64 = 0.99;

/// Draws FWHM, eccentricity and MAE. Histograms show the first kind of object. Cumulative
/// distributions have a line for each kind, and mark the 90th percentile of the first kind. If
/// `paper_q90` is given, the distribution of eccentricity also marks the paper's percentile. `image`
/// names the image that is compared with the truth.
pub(super) fn shape_figures(
    kinds: &[(&str, &Evaluation)],
    image: &str,
    paper_q90: Option<f64>,
) -> Result<Vec<NamedFigure>, PlotError> {
    let (name, first) = kinds[0];
    let quantities = ["x", "y"].map(|axis| format!("FWHM along {axis} (pixels of the frame)"));
    let fwhm = [&first.fwhm_rows_px, &first.fwhm_columns_px];
    let fwhm_panels = [0, 1].map(|k| HistogramPanel {
        quantity: &quantities[k],
        histograms: vec![("true", &fwhm[k][0]), (image, &fwhm[k][1])],
    });
    let (e_difference, mae) = (
        format!("|eccentricity {image} - true|"),
        "mean absolute error / mean of the window",
    );
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
        if let Some(q90) = of(&first.summary).map(|s| s.q90).filter(|&q| q > 0.0) {
            let text = format!("90 % of {name}: {}", short(Some(q90)));
            marks.push(Mark::Vertical(q90, text));
        }
        marks
    };
    let mut of_eccentricity = q90(|s| s.eccentricity);
    if let Some(paper) = paper_q90 {
        of_eccentricity.push(Mark::Vertical(paper, format!("paper: {paper}")));
    }
    let drawn = |x: &str, curves, marks| {
        Curves {
            x: Axis::logarithmic(x),
            y: Axis::linear("cumulative fraction of objects"),
            curves,
            marks,
        }
        .figure()
    };
    let line = format!("The vertical line is the value that 90 % of the {name} do not exceed.");
    let measured = |of: fn(&ObjectRow) -> Option<f64>| first.rows.iter().filter_map(of).count();
    let of_paper = paper_q90.map_or("", |_| " Another line marks this value in the paper.");
    Ok(vec![
        NamedFigure {
            name: "fwhm",
            caption: format!(
                "FWHM along x and along y: true (filled, {} objects) and {image} (line, {} objects). Objects that could not be \
                 measured are left out. Where both agree, the line follows the edge of the filled area.",
                measured(|r| r.fwhm_px_true),
                measured(|r| r.fwhm_px)
            ),
            figure: histograms(&fwhm_panels)?,
        },
        NamedFigure {
            name: "eccentricity-differences",
            caption: "Absolute differences of the eccentricity sqrt(1 - b^2/a^2) (called ellipticity in the paper by Bai, Jia et al. 2025), and of the mean absolute error (MAE) divided by the mean \
                      of the window."
                .to_owned(),
            figure: histograms(&[
                HistogramPanel {
                    quantity: &e_difference,
                    histograms: vec![("objects", &first.eccentricity_differences)],
                },
                HistogramPanel {
                    quantity: mae,
                    histograms: vec![("objects", &first.mae_over_mean)],
                },
            ])?,
        },
        NamedFigure {
            name: "eccentricity-distribution",
            caption: format!(
                "Cumulative distribution of the absolute differences of the eccentricity sqrt(1 - b^2/a^2) (called ellipticity in the paper by Bai, Jia et al. 2025). {line}{of_paper}"
            ),
            figure: drawn(
                &e_difference,
                curves(ObjectRow::eccentricity_difference),
                of_eccentricity,
            )?,
        },
        NamedFigure {
            name: "mae-distribution",
            caption: format!(
                "Cumulative distribution of the mean absolute error in the window of each object, divided by the mean of the window. {line}"
            ),
            figure: drawn(mae, curves(|r| r.mae_over_mean), q90(|s| s.mae_over_mean))?,
        },
    ])
}

/// Draws maps over the field: MSE, and the differences of e1 and e2 on one scale. `image` names the
/// image that is compared with the truth.
pub(super) fn maps(of: &Evaluation, image: &str) -> Result<Vec<NamedFigure>, PlotError> {
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
    let map = |title: &str, quantity: &str, values: &[(Position, Option<f64>)], scale| {
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
    let [e1_name, e2_name] = ["e1", "e2"].map(|e| format!("{e}: {image} - true"));
    let ends = "Values outside the bar's range (1 % of both maps together) have the colours of its ends.";
    Ok(vec![
        NamedFigure {
            name: "mse-map",
            caption: "Mean squared error (MSE) in the window of each object, over the field. Values outside the range of the bar \
                      (1 % below it, 1 % above it) have the colours of its ends."
                .to_owned(),
            figure: map(
                "mean squared error",
                "MSE ((flux per pixel)^2)",
                &mse,
                Scale::Logarithmic { low, high },
            )?,
        },
        NamedFigure {
            name: "e1-map",
            caption: format!("e1 (distortion), {image} minus true, on the colour scale of e2. {ends}"),
            figure: map(&e1_name, &e1_name, &e1, differences)?,
        },
        NamedFigure {
            name: "e2-map",
            caption: format!("e2 (distortion), {image} minus true, on the colour scale of e1. {ends}"),
            figure: map(&e2_name, &e2_name, &e2, differences)?,
        },
    ])
}

/// The columns of [`error_cells`].
const ERROR_COLUMNS: [&str; 10] = [
    "eccentricity: 90 %",
    "eccentricity: largest",
    "e1: 90 %",
    "e2: 90 %",
    "FWHM (px): 90 %",
    "FWHM (px): largest",
    "MAE/mean: median",
    "MAE/mean: 90 %",
    "MAE/mean: largest",
    "failed",
];

/// Formats a summary as cells of a table.
fn error_cells(summary: &ErrorSummary) -> [String; 10] {
    let cell = |spread: Option<Spread>, of: fn(Spread) -> f64| short(spread.map(of));
    [
        cell(summary.eccentricity, |s| s.q90),
        cell(summary.eccentricity, |s| s.largest),
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

/// Makes a table of errors: the caller's first columns and cells, then the cells of a summary. Adds
/// the meaning of "90 %" to the caption.
pub(super) fn error_table<'a>(
    caption: &str,
    first: &[&str],
    rows: impl IntoIterator<Item = (Vec<String>, &'a ErrorSummary)>,
) -> Table {
    let columns: Vec<&str> = first.iter().copied().chain(ERROR_COLUMNS).collect();
    let caption = format!("{caption} 90 %: the value that 90 % of the objects do not exceed.");
    let rows = rows.into_iter();
    Table {
        rows: rows
            .map(|(first, summary)| first.into_iter().chain(error_cells(summary)).collect())
            .collect(),
        ..Table::new(&caption, &columns)
    }
}

/// Makes a table of targets, with the measured values.
pub(super) fn target_table(caption: &str, targets: &[Target]) -> Table {
    let mut table = Table::new(caption, &["quantity", "target: below", "measured", "met"]);
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

/// Returns a frame that holds all objects, for use where the frame is not known.
fn frame_about(rows: &[ObjectRow]) -> Option<FrameShape> {
    let side = |of: fn(&ObjectRow) -> f64| {
        let largest = rows.iter().map(of).fold(0.0, f64::max);
        largest.ceil() as usize + 1
    };
    FrameShape::new(side(|r| r.x), side(|r| r.y)).ok()
}
