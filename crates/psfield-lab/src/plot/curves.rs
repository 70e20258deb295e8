//! Lines over one pair of axes.

use std::ops::Range;

use plotters::chart::{ChartBuilder, SeriesLabelPosition};
use plotters::coord::CoordTranslate;
use plotters::coord::combinators::{BindKeyPoints, IntoLogRange};
use plotters::element::EmptyElement;
use plotters::prelude::{
    Circle, Cross, DrawingArea, LineSeries, PathElement, Polygon, RGBColor, Rectangle, Text, TriangleMarker,
};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{BLACK, Color};

use crate::plot::axes::{
    Chart, Counting, LABEL_ROOM_X, LABEL_ROOM_Y, MARGIN, SMALL, TEXT, decades, draw_axes, draw_legend,
    extent, logarithmic_ticks, text_style, under_title,
};
use crate::plot::canvas::Canvas;
use crate::plot::colours::SERIES;
use crate::plot::figure::{Area, Figure, PlotError};

/// A line through points, with a name in the legend.
#[derive(Debug, Clone)]
pub struct Curve {
    /// The name in the legend.
    pub name: String,
    /// The points, in this order.
    pub points: Vec<(f64, f64)>,
    /// The index of the line's colour in [`SERIES`](crate::plot::SERIES), modulo the number of
    /// colours.
    /// None: the index of the curve in its plot.
    pub colour: Option<usize>,
    /// The shape drawn at every point. None: only the line is drawn.
    pub marker: Option<Marker>,
    /// Positions and texts of labels, in the curve's colour.
    pub labels: Vec<((f64, f64), String)>,
}

/// The shape of a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Marker {
    /// A filled circle.
    Circle,
    /// A filled triangle.
    Triangle,
    /// A filled square.
    Square,
    /// A filled square that stands on its corner.
    Diamond,
    /// Two crossing strokes.
    Cross,
}

impl Curve {
    /// A line through these points, in this order.
    pub fn new(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.to_owned(),
            points,
            colour: None,
            marker: None,
            labels: Vec::new(),
        }
    }

    /// The cumulative distribution of values, as steps.
    pub fn distribution(name: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let n = sorted.len() as f64;
        let steps = sorted.iter().enumerate();
        let points = steps
            .flat_map(|(k, &v)| [(v, k as f64 / n), (v, (k + 1) as f64 / n)])
            .collect();
        Self::new(name, points)
    }

    /// The colour of this curve. `place` is the index of the curve in its plot.
    fn colour_at(&self, place: usize) -> RGBColor {
        SERIES[self.colour.unwrap_or(place) % SERIES.len()]
    }
}

/// An axis: its scale (linear or logarithmic), and its name with the unit.
#[derive(Debug, Clone)]
pub struct Axis {
    pub(super) name: String,
    pub(super) logarithmic: bool,
    /// The values at both ends. None: the range of the points.
    ends: Option<Range<f64>>,
}

impl Axis {
    /// A linear axis.
    pub fn linear(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            logarithmic: false,
            ends: None,
        }
    }

    /// A logarithmic axis. Points whose coordinate along the axis is not above 0 are left out.
    pub fn logarithmic(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            logarithmic: true,
            ends: None,
        }
    }

    /// Sets the values at both ends of the axis.
    #[must_use]
    pub fn within(self, ends: Range<f64>) -> Self {
        Self {
            ends: Some(ends),
            ..self
        }
    }

    pub(super) fn range(&self, values: impl Iterator<Item = f64>) -> Range<f64> {
        if let Some(ends) = &self.ends {
            ends.clone()
        } else if self.logarithmic {
            decades(values)
        } else {
            extent(values)
        }
    }

    /// Returns the position of a value along the axis, from 0 to 1.
    pub(super) fn part(&self, value: f64, range: &Range<f64>) -> f64 {
        let scale = |v: f64| if self.logarithmic { v.log10() } else { v };
        (scale(value) - scale(range.start)) / (scale(range.end) - scale(range.start))
    }
}

/// A value that is marked in a plot, with a text.
#[derive(Debug, Clone)]
pub enum Mark {
    /// A line at x from bottom to top, with a text above the plot.
    Vertical(f64, String),
    /// A line at y from left to right, with a text at its left end.
    Horizontal(f64, String),
    /// A dot at (x, y), with a text to its lower right.
    Point(f64, f64, String),
}

/// Lines over one pair of axes, with marks and a legend.
#[derive(Debug, Clone)]
pub struct Curves {
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// The lines.
    pub curves: Vec<Curve>,
    /// The marks.
    pub marks: Vec<Mark>,
}

const SIZE: (u32, u32) = (760, 460);
const MARK: RGBColor = RGBColor(90, 90, 90);
/// Half the length of a line in the legend of [`curve_panels`].
const LEGEND_LINE: i32 = 14;
/// If two marked points are closer to each other than these fractions of the axes, their texts
/// would overlap. The second text is then drawn one line lower.
const NEAR: (f64, f64) = (0.3, 0.06);

impl Curves {
    /// Draws the curves, with a legend if there are several.
    ///
    /// # Errors
    /// [`PlotError`] when the drawing fails.
    pub fn figure(&self) -> Result<Figure, PlotError> {
        Figure::draw(SIZE, |root| {
            self.draw_in(root, self.curves.len() > 1)?;
            Ok(Vec::new())
        })
    }

    /// Draws axes, curves and marks, and a legend if one is requested.
    fn draw_in(&self, area: &Area<'_>, legend: bool) -> Result<(), PlotError> {
        let points = || self.curves.iter().flat_map(|c| c.points.iter());
        let marked_x = self.marks.iter().filter_map(|mark| match mark {
            Mark::Vertical(x, _) | Mark::Point(x, ..) => Some(*x),
            Mark::Horizontal(..) => None,
        });
        let marked_y = self.marks.iter().filter_map(|mark| match mark {
            Mark::Horizontal(y, _) | Mark::Point(_, y, _) => Some(*y),
            Mark::Vertical(..) => None,
        });
        let x = self.x.range(points().map(|p| p.0).chain(marked_x));
        let y = self.y.range(points().map(|p| p.1).chain(marked_y));
        let mut chart = ChartBuilder::on(area);
        chart
            .margin(MARGIN)
            .margin_right(2 * MARGIN)
            .x_label_area_size(LABEL_ROOM_X)
            .y_label_area_size(LABEL_ROOM_Y);
        let (xs, ys) = (x.clone(), y.clone());
        let log = |range: &Range<f64>| {
            range
                .clone()
                .log_scale()
                .with_key_points(logarithmic_ticks(range.start, range.end))
        };
        match (self.x.logarithmic, self.y.logarithmic) {
            (false, false) => self.fill(chart.build_cartesian_2d(xs, ys)?, &x, &y, legend),
            (true, false) => self.fill(chart.build_cartesian_2d(log(&x), ys)?, &x, &y, legend),
            (false, true) => self.fill(chart.build_cartesian_2d(xs, log(&y))?, &x, &y, legend),
            (true, true) => self.fill(chart.build_cartesian_2d(log(&x), log(&y))?, &x, &y, legend),
        }
    }

    fn fill<'a, 'b: 'a, X: Counting + 'a, Y: Counting + 'a>(
        &self,
        mut chart: Chart<'a, 'b, X, Y>,
        x: &Range<f64>,
        y: &Range<f64>,
        legend: bool,
    ) -> Result<(), PlotError> {
        draw_axes(&mut chart, &self.x.name, &self.y.name)?;
        let shown = |p: &(f64, f64)| (!self.x.logarithmic || p.0 > 0.0) && (!self.y.logarithmic || p.1 > 0.0);
        for (place, curve) in self.curves.iter().enumerate() {
            let colour = curve.colour_at(place);
            let points: Vec<(f64, f64)> = curve.points.iter().copied().filter(shown).collect();
            let line = chart.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?;
            if legend {
                line.label(curve.name.clone()).legend(move |(x, y)| {
                    PathElement::new(vec![(x, y), (x + 22, y)], colour.stroke_width(3))
                });
            }
            if let Some(marker) = curve.marker {
                for &point in &points {
                    draw_marker(chart.plotting_area(), marker, point, colour)?;
                }
            }
            let style = text_style(SMALL)
                .color(&colour)
                .pos(Pos::new(HPos::Left, VPos::Bottom));
            let labels = curve.labels.iter().filter(|(at, _)| shown(at));
            chart.draw_series(
                labels.map(|(at, text)| {
                    EmptyElement::at(*at) + Text::new(text.clone(), (6, -5), style.clone())
                }),
            )?;
        }
        let mut last_point = None;
        for mark in &self.marks {
            let mut lower = 0;
            let (line, at, text, h, v) = match mark {
                Mark::Vertical(at, text) => {
                    // The text stands above the plot, on the side of the line with more room.
                    let right = self.x.part(*at, x) > 0.6;
                    let h = if right { HPos::Right } else { HPos::Left };
                    let line = [(*at, y.start), (*at, y.end)];
                    (line, line[1], text, h, VPos::Bottom)
                }
                Mark::Horizontal(at, text) => {
                    let line = [(x.start, *at), (x.end, *at)];
                    (line, line[0], text, HPos::Left, VPos::Bottom)
                }
                Mark::Point(px, py, text) => {
                    let p = (self.x.part(*px, x), self.y.part(*py, y));
                    let near = |(u, v): (f64, f64)| (p.0 - u).abs() < NEAR.0 && (p.1 - v).abs() < NEAR.1;
                    lower = i32::from(last_point.is_some_and(near)) * (TEXT + 5);
                    last_point = Some(p);
                    let at = (*px, *py);
                    chart.draw_series([Circle::new(at, 5, BLACK.filled())])?;
                    ([at, at], at, text, HPos::Left, VPos::Top)
                }
            };
            chart.draw_series([PathElement::new(line.to_vec(), MARK.stroke_width(1))])?;
            let shift = if matches!(h, HPos::Right) { -6 } else { 6 };
            let down = if matches!(v, VPos::Top) { 5 } else { -1 };
            let style = text_style(TEXT).pos(Pos::new(h, v));
            let text = Text::new(text.clone(), (shift, down + lower), style);
            chart.draw_series([EmptyElement::at(at) + text])?;
        }
        if legend {
            draw_legend(&mut chart, SeriesLabelPosition::LowerRight)?;
        }
        Ok(())
    }
}

/// Draws a marker at a point. The size of the marker is in pixels.
fn draw_marker<C: CoordTranslate>(
    area: &DrawingArea<Canvas<'_>, C>,
    marker: Marker,
    at: C::From,
    colour: RGBColor,
) -> Result<(), PlotError> {
    let (at, filled) = (EmptyElement::at(at), colour.filled());
    match marker {
        Marker::Circle => area.draw(&(at + Circle::new((0, 0), 5, filled))),
        Marker::Triangle => area.draw(&(at + TriangleMarker::new((0, 0), 6, filled))),
        Marker::Square => area.draw(&(at + Rectangle::new([(-5, -5), (5, 5)], filled))),
        Marker::Diamond => area.draw(&(at + Polygon::new(vec![(0, -6), (6, 0), (0, 6), (-6, 0)], filled))),
        Marker::Cross => area.draw(&(at + Cross::new((0, 0), 5, colour.stroke_width(2)))),
    }?;
    Ok(())
}

/// Width and height of a panel. Two panels next to each other stay readable on a page.
const PANEL: (u32, u32) = (560, 440);
/// Height of the strip that holds the legend.
const LEGEND: u32 = 44;
/// Width of a name in the legend, in pixels.
const NAME_WIDTH: i32 = 118;

/// Draws plots with headings, two per row, below one legend for all of them. The legend shows each
/// name once, so curves with equal names should have equal colours and markers.
///
/// # Errors
/// [`PlotError`] when the drawing fails.
pub fn curve_panels(panels: &[(String, Curves)]) -> Result<Figure, PlotError> {
    let across = panels.len().clamp(1, 2);
    let down = panels.len().div_ceil(across).max(1);
    let names = names(panels);
    let width = (across as u32 * PANEL.0).max(NAME_WIDTH as u32 * names.len() as u32 + 2 * MARGIN);
    Figure::draw((width, LEGEND + down as u32 * PANEL.1), |root| {
        let (top, rest) = root.split_vertically(LEGEND);
        draw_names(&top, &names)?;
        for ((title, curves), area) in panels.iter().zip(rest.split_evenly((down, across))) {
            curves.draw_in(&under_title(&area, title)?, false)?;
        }
        Ok(Vec::new())
    })
}

/// Returns the first curve of each name, with the index of the curve in its panel.
fn names(panels: &[(String, Curves)]) -> Vec<(usize, &Curve)> {
    let mut found: Vec<(usize, &Curve)> = Vec::new();
    for (place, curve) in panels.iter().flat_map(|(_, c)| c.curves.iter().enumerate()) {
        if found.iter().all(|(_, known)| known.name != curve.name) {
            found.push((place, curve));
        }
    }
    found
}

fn draw_names(area: &Area<'_>, names: &[(usize, &Curve)]) -> Result<(), PlotError> {
    let style = text_style(TEXT).pos(Pos::new(HPos::Left, VPos::Center));
    for (k, (place, curve)) in names.iter().enumerate() {
        let colour = curve.colour_at(*place);
        let (x, y) = (
            2 * MARGIN as i32 + LEGEND_LINE + k as i32 * NAME_WIDTH,
            LEGEND as i32 / 2,
        );
        let line = vec![(x - LEGEND_LINE, y), (x + LEGEND_LINE, y)];
        area.draw(&PathElement::new(line, colour.stroke_width(2)))?;
        if let Some(marker) = curve.marker {
            draw_marker(area, marker, (x, y), colour)?;
        }
        let right_of_line = (x + LEGEND_LINE + 6, y);
        area.draw(&Text::new(curve.name.clone(), right_of_line, style.clone()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_distribution_steps_from_none_to_all() {
        let curve = Curve::distribution("d", [3.0, 1.0]);
        assert_eq!(curve.points, [(1.0, 0.0), (1.0, 0.5), (3.0, 0.5), (3.0, 1.0)]);
    }

    #[test]
    fn curves_on_every_kind_of_axes_are_drawn() {
        for (x, y) in [
            (Axis::linear("x"), Axis::linear("y")),
            (Axis::logarithmic("x"), Axis::linear("y")),
            (Axis::linear("x"), Axis::logarithmic("y")),
            (Axis::logarithmic("x"), Axis::logarithmic("y")),
        ] {
            let curves = Curves {
                x,
                y,
                curves: vec![
                    Curve::new("first", vec![(1.0, 2.0), (10.0, 30.0)]),
                    Curve::new("second", vec![(0.0, 0.0), (5.0, 3.0)]),
                ],
                marks: vec![
                    Mark::Vertical(4.0, "four".to_owned()),
                    Mark::Horizontal(3.0, "three".to_owned()),
                ],
            };
            let figure = curves.figure().unwrap();
            for text in ["first", "second", "four", "three"] {
                assert!(figure.svg().contains(text), "{text}");
            }
        }
    }

    #[test]
    fn panels_share_a_legend_that_names_each_curve_once() {
        let curves = |names: &[&str]| Curves {
            x: Axis::logarithmic("error"),
            y: Axis::logarithmic("time, seconds"),
            curves: names
                .iter()
                .map(|name| Curve {
                    marker: Some(Marker::Square),
                    colour: Some(name.len()),
                    labels: vec![((1e-3, 1.0), format!("{name} beside"))],
                    ..Curve::new(name, vec![(1e-3, 1.0), (1e-2, 0.1)])
                })
                .collect(),
            marks: Vec::new(),
        };
        let figure = curve_panels(&[
            ("left panel".to_owned(), curves(&["alpha", "beta"])),
            ("right panel".to_owned(), curves(&["beta", "gamma"])),
        ])
        .unwrap();
        for (text, count) in [
            ("left panel", 1),
            ("right panel", 1),
            ("alpha\n", 1),
            ("beta\n", 1),
            ("gamma\n", 1),
            ("beta beside", 2),
        ] {
            assert_eq!(figure.svg().matches(text).count(), count, "{text}");
        }
    }
}
