//! Figures and tables of the differences between simulated and true objects.

use psf_types::{FrameShape, Position};

use super::document::{NamedFigure, Table};
use super::{ErrorSummary, Evaluation, ObjectRow, Spread, Target};
use crate::plot::{Axis, Curve, Curves, FieldMap, HistogramPanel, Mark, PlotError, Scale, histograms};
use crate::report::document::short;

/// The colour bar of the MSE map ends at this quantile of the values and begins at the quantile
/// `1 - SHOWN_PART`. The colour bar of the maps of e1 and e2 ends at this quantile of the absolute
/// values of both. Values outside the range of a bar get the colour of the nearer end.
const SHOWN_PART: f64 = 0.99;

/// Draws the FWHM, and the errors of eccentricity and of pixels (mean absolute error). Histograms
/// show the first kind of object. Cumulative distributions have a line for each kind, and mark the
/// 90th percentile of the first kind. `paper_q90` is the 90th percentile of the differences of
/// eccentricity in the paper, which is also marked if it is given. `image` names the image that is
/// compared with the truth.
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
        format!("absolute difference of eccentricity, {image} - true"),
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
            let text = format!("90 % of {name} below {}", short(Some(q90)));
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
                "FWHM of the {name} along x and along y: true (filled, {} {name}) and {image} (line, {} {name}). Objects that could not be \
                 measured are left out. Where both agree, the line follows the edge of the filled area.",
                measured(|r| r.fwhm_px_true),
                measured(|r| r.fwhm_px)
            ),
            figure: histograms(&fwhm_panels)?,
        },
        NamedFigure {
            name: "eccentricity-differences",
            caption: format!(
                "Histograms of the {name}. Left: absolute differences of the eccentricity sqrt(1 - b^2/a^2) (called ellipticity in the paper by Bai, Jia et al. 2025). Right: mean absolute error (MAE) in the window of each object, divided by the mean of the window."
            ),
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

/// Draws maps over the field: the mean squared error (MSE), and the differences of e1 and of e2 on
/// one colour scale. `image` names the image that is compared with the truth.
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
    let ends = "The maps of e1 and e2 have equal colour bars. Values outside the range of the bar (1 % of both maps together) have the colours of its ends. Objects that could not be measured are grey.";
    Ok(vec![
        NamedFigure {
            name: "mse-map",
            caption: "Mean squared error (MSE) in the window of each object, at the position of the object. Values outside the range of the bar \
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
            caption: format!("Distortion e1 = (a^2 - b^2)/(a^2 + b^2) cos(2 phi), {image} minus true. {ends}"),
            figure: map(&e1_name, &e1_name, &e1, differences)?,
        },
        NamedFigure {
            name: "e2-map",
            caption: format!("Distortion e2 = (a^2 - b^2)/(a^2 + b^2) sin(2 phi), {image} minus true. {ends}"),
            figure: map(&e2_name, &e2_name, &e2, differences)?,
        },
    ])
}

/// The columns of [`error_cells`].
const ERROR_COLUMNS: [&str; 10] = [
    "eccentricity: 90 %",
    "eccentricity: largest",
    "distortion e1: 90 %",
    "distortion e2: 90 %",
    "FWHM (px): 90 %",
    "FWHM (px): largest",
    "mean absolute error / window mean: median",
    "mean absolute error / window mean: 90 %",
    "mean absolute error / window mean: largest",
    "objects not measured",
];

/// Formats a summary as the cells below [`ERROR_COLUMNS`].
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

/// Makes a table of errors. Each row has the caller's first cells, then the cells of a summary.
/// `first` names the columns of the first cells. The table's caption is `caption` with the meaning
/// of "90 %".
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

/// Returns the smallest frame that holds all objects. It replaces a frame that is not known.
fn frame_about(rows: &[ObjectRow]) -> Option<FrameShape> {
    let side = |of: fn(&ObjectRow) -> f64| {
        let largest = rows.iter().map(of).fold(0.0, f64::max);
        largest.ceil() as usize + 1
    };
    FrameShape::new(side(|r| r.x), side(|r| r.y)).ok()
}
