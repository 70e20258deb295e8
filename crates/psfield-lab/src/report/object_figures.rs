//! Figures and tables of the differences between simulated and true objects.

use metrics::Summary;
use psf_types::FrameShape;

use super::document::{Column, Section, Table, short};
use super::{ErrorSummary, Evaluation, ObjectRow, Spread, Target};
use crate::plot::{Axis, Chart, Curve, Mark, Scale};

/// The colour bar of the MSE map ends at this quantile of the values and begins at the quantile
/// `1 - SHOWN_PART`. The colour bar of the maps of e1 and e2 ends at this quantile of the absolute
/// values of both. Values outside the range of a bar get the colour of the nearer end.
const SHOWN_PART: f64 = 0.99;

const ECCENTRICITY: &str =
    "eccentricity sqrt(1 - b^2/a^2) (called ellipticity in the paper by Bai, Jia et al. 2025)";

/// A measurement of an object.
type Value = fn(&ObjectRow) -> Option<f64>;

/// Adds figures of the FWHM, and of the errors of eccentricity and of pixels (mean absolute error).
///
/// Histograms show the first kind of object. Cumulative distributions have a line for each kind, and
/// mark the 90th percentile of the first kind. `paper_q90` is the 90th percentile of the differences
/// of eccentricity in the paper, which is also marked if it is given. `image` names the image that is
/// compared with the truth.
pub(super) fn with_shapes(
    section: Section,
    kinds: &[(&str, &Evaluation)],
    image: &str,
    paper_q90: Option<f64>,
) -> Section {
    let (name, first) = kinds[0];
    let fwhm = [("x", &first.fwhm_rows_px), ("y", &first.fwhm_columns_px)].map(|(axis, [truth, ours])| {
        let quantity = format!("FWHM along {axis} (pixels of the frame)");
        Chart::histograms(&quantity, &[("true", truth), (image, ours)])
    });
    let difference = format!("absolute difference of eccentricity, {image} - true");
    let mae = "mean absolute error / mean of the window";
    let histograms = [
        (difference.as_str(), &first.eccentricity_differences),
        (mae, &first.mae_over_mean),
    ]
    .map(|(quantity, histogram)| Chart::histograms(quantity, &[("objects", histogram)]));
    let distribution = |quantity: &str, of: Value, spread: Option<Spread>, paper: Option<f64>| {
        let curves = kinds
            .iter()
            .map(|(name, kind)| Curve::distribution(name, kind.rows.iter().filter_map(of).map(f64::abs)));
        let q90 = spread.map(|s| s.q90).filter(|&q90| q90 > 0.0);
        let q90 = q90.map(|q90| Mark::Vertical(q90, format!("90 % of {name} below {}", short(Some(q90)))));
        let paper = paper.map(|paper| Mark::Vertical(paper, format!("paper: {paper}")));
        let marks = [Some(Mark::Horizontal(0.9, "90 %".to_owned())), q90, paper];
        let fraction = Axis::linear("cumulative fraction of objects");
        Chart::new("", Axis::logarithmic(quantity), fraction, curves.collect())
            .with_marks(marks.into_iter().flatten().collect())
    };
    let measured = |of: Value| first.rows.iter().filter_map(of).count();
    let line = format!("The vertical line is the value that 90 % of the {name} do not exceed.");
    let of_paper = paper_q90.map_or("", |_| " Another line marks this value in the paper.");
    let (eccentricity, mae_of_kind) = (first.summary.eccentricity, first.summary.mae_over_mean);
    section
        .with_figure(
            "fwhm",
            &format!(
                "FWHM of the {name} along x and along y: true (filled, {} {name}) and {image} (line, {} {name}). Objects that could not be \
                 measured are left out. Where both agree, the line follows the edge of the filled area.",
                measured(|r| r.fwhm_px_true),
                measured(|r| r.fwhm_px)
            ),
            &fwhm,
        )
        .with_figure(
            "eccentricity-differences",
            &format!(
                "Histograms of the {name}. Left: absolute differences of the {ECCENTRICITY}. Right: mean absolute error (MAE) in the window of each object, divided by the mean of the window."
            ),
            &histograms,
        )
        .with_figure(
            "eccentricity-distribution",
            &format!("Cumulative distribution of the absolute differences of the {ECCENTRICITY}. {line}{of_paper}"),
            &[distribution(&difference, ObjectRow::eccentricity_difference, eccentricity, paper_q90)],
        )
        .with_figure(
            "mae-distribution",
            &format!(
                "Cumulative distribution of the mean absolute error in the window of each object, divided by the mean of the window. {line}"
            ),
            &[distribution(mae, |r| r.mae_over_mean, mae_of_kind, None)],
        )
}

/// Adds maps over the field: the mean squared error (MSE), and the differences of e1 and of e2 on
/// one colour scale. `image` names the image that is compared with the truth.
pub(super) fn with_maps(section: Section, of: &Evaluation, image: &str) -> Section {
    let Some(frame) = of.frame.or_else(|| frame_about(&of.rows)) else {
        return section;
    };
    let map = |title: &str, value: Value, scale: &Scale| {
        let values = of
            .rows
            .iter()
            .filter_map(|row| Some((row.position()?, value(row))));
        [Chart::map(
            title,
            frame,
            &values.collect::<Vec<_>>(),
            of.grid_columns,
            scale,
        )]
    };
    let mse = |q| quantile(of.rows.iter().filter_map(|r| r.mse).filter(|&v| v > 0.0), q);
    let low = mse(1.0 - SHOWN_PART).unwrap_or(0.1);
    let high = mse(SHOWN_PART).unwrap_or(1.0).max(1.25 * low);
    let differences = |r: &ObjectRow| [r.e1_difference(), r.e2_difference()];
    let both = of.rows.iter().flat_map(differences).flatten().map(f64::abs);
    let most = quantile(both, SHOWN_PART).filter(|&m| m > 0.0).unwrap_or(1e-12);
    let mse_scale = Scale::logarithmic("MSE ((flux per pixel)^2)", low, high);
    let section = section.with_figure(
        "mse-map",
        "Mean squared error (MSE) in the window of each object, at the position of the object. Values outside the range of the bar \
         (1 % below it, 1 % above it) have the colours of its ends.",
        &map("mean squared error", |r| r.mse, &mse_scale),
    );
    let maps: [(_, _, _, Value); 2] = [
        ("e1-map", "e1", "cos", ObjectRow::e1_difference),
        ("e2-map", "e2", "sin", ObjectRow::e2_difference),
    ];
    maps.into_iter().fold(section, |section, (file, e, part, value)| {
        let title = format!("{e}: {image} - true");
        let caption = format!(
            "Distortion {e} = (a^2 - b^2)/(a^2 + b^2) {part}(2 phi), {image} minus true. The maps of e1 and e2 have equal colour bars. \
             Values outside the range of the bar (1 % of both maps together) have the colours of its ends. Objects that could not be \
             measured are grey."
        );
        section.with_figure(file, &caption, &map(&title, value, &Scale::difference(&title, most)))
    })
}

/// Makes a table of errors. Each row has the caller's first cells, then the cells of a summary. The
/// table's caption is `caption` with the meaning of "90 %".
pub(super) fn error_table<'a, R: 'a>(
    caption: &str,
    first: &[Column<'_, R>],
    rows: impl IntoIterator<Item = &'a R>,
    summary: fn(&R) -> &ErrorSummary,
) -> Table {
    let q90 = |spread: Option<Spread>| short(spread.map(|s| s.q90));
    let largest = |spread: Option<Spread>| short(spread.map(|s| s.largest));
    let errors: [Column<'_, R>; 10] = [
        ("eccentricity: 90 %", &|row| q90(summary(row).eccentricity)),
        ("eccentricity: largest", &|row| largest(summary(row).eccentricity)),
        ("distortion e1: 90 %", &|row| q90(summary(row).e1)),
        ("distortion e2: 90 %", &|row| q90(summary(row).e2)),
        ("FWHM (px): 90 %", &|row| q90(summary(row).fwhm_px)),
        ("FWHM (px): largest", &|row| largest(summary(row).fwhm_px)),
        ("mean absolute error / window mean: median", &|row| {
            short(summary(row).mae_over_mean.map(|s| s.median))
        }),
        ("mean absolute error / window mean: 90 %", &|row| {
            q90(summary(row).mae_over_mean)
        }),
        ("mean absolute error / window mean: largest", &|row| {
            largest(summary(row).mae_over_mean)
        }),
        ("objects not measured", &|row| summary(row).failed.to_string()),
    ];
    let caption = format!("{caption} 90 %: the value that 90 % of the objects do not exceed.");
    Table::new(&caption, &[first, &errors].concat(), rows)
}

/// Makes a table of targets, with the measured values.
pub(super) fn target_table(caption: &str, targets: &[Target]) -> Table {
    let columns: [Column<'_, Target>; 4] = [
        ("quantity", &|target| target.what.clone()),
        ("target: below", &|target| short(Some(target.limit))),
        ("measured", &|target| short(target.measured)),
        ("met", &|target| if target.met { "yes" } else { "no" }.to_owned()),
    ];
    Table::new(caption, &columns, targets)
}

fn quantile(values: impl Iterator<Item = f64>, q: f64) -> Option<f64> {
    Summary::of(values).ok()?.quantile(q).ok()
}

/// Returns the smallest frame that holds all objects. It replaces a frame that is not known.
fn frame_about(rows: &[ObjectRow]) -> Option<FrameShape> {
    let side = |of: fn(&ObjectRow) -> f64| rows.iter().map(of).fold(0.0, f64::max).ceil() as usize + 1;
    FrameShape::new(side(|r| r.x), side(|r| r.y)).ok()
}
