//! Cumulative distributions, as SVG.

use plotters::prelude::*;

type Failure = DrawingAreaErrorKind<std::io::Error>;

/// Width and height of a panel.
const PANEL: (u32, u32) = (560, 420);
const TITLE: i32 = 17;
const TEXT: i32 = 15;
/// Colours that most eyes can tell apart (Okabe and Ito 2008).
const FRAME: RGBColor = RGBColor(0, 0, 0);
const SIMULATED: RGBColor = RGBColor(213, 94, 0);
/// Part of the range left free at both ends.
const MARGIN: f64 = 0.05;

/// A quantity of the stars of the frame and of the simulated ones.
pub(super) struct Panel<'a> {
    pub(super) quantity: &'static str,
    pub(super) frame: &'a [f64],
    pub(super) simulated: &'a [f64],
}

/// The cumulative distributions side by side.
pub(super) fn distributions<const N: usize>(panels: [Panel<'_>; N]) -> Result<String, Failure> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (N as u32 * PANEL.0, PANEL.1)).into_drawing_area();
        root.fill(&WHITE)?;
        for (panel, area) in panels.iter().zip(root.split_evenly((1, N))) {
            let all = || panel.frame.iter().chain(panel.simulated).copied();
            let (low, high) = (
                all().fold(f64::INFINITY, f64::min),
                all().fold(f64::NEG_INFINITY, f64::max),
            );
            let room = MARGIN * (high - low).max(1e-6);
            let (low, high) = (low - room, high + room);
            let mut chart = ChartBuilder::on(&area)
                .margin(12)
                .x_label_area_size(48)
                .y_label_area_size(64)
                .build_cartesian_2d(low..high, 0.0..1.0)?;
            chart
                .configure_mesh()
                .max_light_lines(1)
                .bold_line_style(RGBColor(225, 225, 225))
                .label_style(("sans-serif", TEXT))
                .axis_desc_style(("sans-serif", TITLE))
                .x_desc(panel.quantity)
                .y_desc("part of the stars below")
                .draw()?;
            for (values, colour, name) in [
                (panel.frame, FRAME, "frame"),
                (panel.simulated, SIMULATED, "simulated"),
            ] {
                chart
                    .draw_series(LineSeries::new(steps(values, low, high), colour.stroke_width(2)))?
                    .label(name)
                    .legend(move |(x, y)| {
                        PathElement::new(vec![(x, y), (x + 20, y)], colour.stroke_width(2))
                    });
            }
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::LowerRight)
                .label_font(("sans-serif", TEXT))
                .background_style(WHITE.filled())
                .draw()?;
        }
        root.present()?;
    }
    Ok(svg)
}

/// The corners of a cumulative distribution.
fn steps(values: &[f64], low: f64, high: f64) -> Vec<(f64, f64)> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let n = sorted.len() as f64;
    let mut corners = vec![(low, 0.0)];
    for (k, v) in sorted.into_iter().enumerate() {
        corners.extend([(v, k as f64 / n), (v, (k + 1) as f64 / n)]);
    }
    corners.push((high, 1.0));
    corners
}
