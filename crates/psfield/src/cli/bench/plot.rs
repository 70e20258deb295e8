//! Run time against error, as SVG.

use std::ops::Range;

use plotters::coord::{CoordTranslate, Shift};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use psfield::bench::BenchRow;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Failure = DrawingAreaErrorKind<std::io::Error>;

/// Width and height of a panel, chosen so that two side by side stay readable at a page's width.
const PANEL: (u32, u32) = (560, 440);
/// Height of the strip with the legend.
const LEGEND: u32 = 44;
/// Pixels between two names of the legend.
const NAME_WIDTH: i32 = 118;
/// An error below this, or none at all, is drawn here.
const LEAST_ERROR: f64 = 1e-17;

const TITLE: i32 = 17;
const TEXT: i32 = 15;
const SMALL: i32 = 12;

/// The methods in the order of the legend, with colours that most eyes can tell apart (Okabe and Ito 2008).
const METHODS: [(&str, RGBColor); 6] = [
    ("single", RGBColor(0, 0, 0)),
    ("lowrank", RGBColor(0, 114, 178)),
    ("auto", RGBColor(230, 159, 0)),
    ("patch", RGBColor(0, 158, 115)),
    ("basis", RGBColor(213, 94, 0)),
    ("direct", RGBColor(128, 128, 128)),
];

/// A panel for each case: its title and its rows, the single PSF first.
pub(super) fn plot(cases: &[(String, &[BenchRow])]) -> Result<String, Failure> {
    let across = cases.len().clamp(1, 2);
    let down = cases.len().div_ceil(across).max(1);
    let size = (
        (across as u32 * PANEL.0).max(NAME_WIDTH as u32 * METHODS.len() as u32),
        LEGEND + down as u32 * PANEL.1,
    );
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        let (top, rest) = root.split_vertically(LEGEND);
        let there = |name: &str| {
            cases
                .iter()
                .any(|(_, rows)| rows.iter().any(|r| r.method == name))
        };
        legend(&top, METHODS.iter().filter(|(name, _)| there(name)))?;
        for ((title, rows), panel) in cases.iter().zip(rest.split_evenly((down, across))) {
            draw(&panel, title, rows)?;
        }
        root.present()?;
    }
    Ok(svg)
}

fn legend<'a>(area: &Area<'_>, names: impl Iterator<Item = &'a (&'a str, RGBColor)>) -> Result<(), Failure> {
    let style = ("sans-serif", TEXT)
        .into_font()
        .color(&BLACK)
        .pos(Pos::new(HPos::Left, VPos::Center));
    for (i, (name, colour)) in names.enumerate() {
        let (x, y) = (28 + i as i32 * NAME_WIDTH, LEGEND as i32 / 2);
        area.draw(&PathElement::new(
            vec![(x - 14, y), (x + 14, y)],
            colour.stroke_width(2),
        ))?;
        mark(area, name, (x, y), *colour)?;
        area.draw(&Text::new((*name).to_owned(), (x + 20, y), style.clone()))?;
    }
    Ok(())
}

fn draw(area: &Area<'_>, title: &str, rows: &[BenchRow]) -> Result<(), Failure> {
    let errors = extent(rows.iter().filter_map(error), 3.0);
    let times = decades(&extent(rows.iter().map(|row| row.seconds), 1.2));
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", TITLE))
        .margin(10)
        .margin_right(24)
        .x_label_area_size(48)
        .y_label_area_size(74)
        .build_cartesian_2d(errors.clone().log_scale(), times.log_scale())?;
    chart
        .configure_mesh()
        .max_light_lines(1)
        .light_line_style(RGBColor(240, 240, 240))
        .bold_line_style(RGBColor(215, 215, 215))
        .label_style(("sans-serif", TEXT))
        .axis_desc_style(("sans-serif", TITLE))
        .x_desc("measured relative L2 error")
        .y_desc("run time, seconds (fastest run)")
        .x_label_formatter(&|v| format!("{v:.0e}"))
        .y_label_formatter(&|v| seconds(*v))
        .draw()?;
    for (name, colour) in &METHODS {
        let points: Vec<(f64, f64, Option<&str>)> = rows
            .iter()
            .filter(|row| row.method == *name)
            .filter_map(|row| Some((error(row)?, row.seconds, row.setting.as_deref())))
            .collect();
        if *name == "single" {
            // One convolution costs this, whatever the error.
            let at = rows
                .iter()
                .filter(|row| row.method == *name)
                .map(|row| row.seconds);
            for level in at {
                chart.draw_series(LineSeries::new(
                    [(errors.start, level), (errors.end, level)],
                    colour.stroke_width(2),
                ))?;
            }
        } else {
            chart.draw_series(LineSeries::new(
                points.iter().map(|p| (p.0, p.1)),
                colour.stroke_width(2),
            ))?;
        }
        for p in &points {
            mark(chart.plotting_area(), name, (p.0, p.1), *colour)?;
        }
        // `auto` has the settings of `lowrank`, close by.
        if *name != "auto" || !rows.iter().any(|row| row.method == "lowrank") {
            let style = ("sans-serif", SMALL)
                .into_font()
                .color(colour)
                .pos(Pos::new(HPos::Left, VPos::Bottom));
            let labels = points
                .chunk_by(|a, b| close(a.0, b.0) && close(a.1, b.1))
                .map(|same| {
                    let values = same.iter().filter_map(|p| p.2?.rsplit('=').next());
                    let text = values.collect::<Vec<_>>().join(", ");
                    EmptyElement::at((same[0].0, same[0].1)) + Text::new(text, (6, -5), style.clone())
                });
            chart.draw_series(labels)?;
        }
    }
    Ok(())
}

/// A method's marker, in pixels about a point.
fn mark<C: CoordTranslate>(
    area: &DrawingArea<SVGBackend<'_>, C>,
    method: &str,
    at: C::From,
    colour: RGBColor,
) -> Result<(), Failure> {
    let (at, filled) = (EmptyElement::at(at), colour.filled());
    match method {
        "lowrank" => area.draw(&(at + Circle::new((0, 0), 5, filled))),
        "auto" => area.draw(&(at + TriangleMarker::new((0, 0), 6, filled))),
        "patch" => area.draw(&(at + Rectangle::new([(-5, -5), (5, 5)], filled))),
        "basis" => area.draw(&(at + Polygon::new(vec![(0, -6), (6, 0), (0, 6), (-6, 0)], filled))),
        _ => area.draw(&(at + Cross::new((0, 0), 5, colour.stroke_width(2)))),
    }
}

/// Whether two values lie so close on a logarithmic axis that their labels would overlap.
fn close(a: f64, b: f64) -> bool {
    (a / b).ln().abs() < 0.3
}

/// The error as it is drawn, where there is one.
fn error(row: &BenchRow) -> Option<f64> {
    row.relative_l2.map(|e| e.max(LEAST_ERROR))
}

/// The range of some values, widened by a factor at both ends.
fn extent(values: impl Iterator<Item = f64>, factor: f64) -> Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, 0.0f64), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    if low <= high {
        low / factor..high * factor
    } else {
        LEAST_ERROR..1.0
    }
}

/// The whole powers of ten about a range.
fn decades(range: &Range<f64>) -> Range<f64> {
    10f64.powf(range.start.log10().floor())..10f64.powf(range.end.log10().ceil())
}

/// Seconds without needless digits.
fn seconds(value: f64) -> String {
    if (1e-3..1e4).contains(&value) {
        format!("{}", (value * 1e6).round() / 1e6)
    } else {
        format!("{value:.0e}")
    }
}
