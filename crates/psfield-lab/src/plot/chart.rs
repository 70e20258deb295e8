//! A chart: two axes, and what lies between them.

use super::axis::{Axis, Ruler};
use super::colours::{SERIES, Scale};
use super::figure::{Figure, LINE, TEXT, text_width};
use crate::preview::Picture;

/// A line through points, with a name in the legend.
#[derive(Debug, Clone, Default)]
pub struct Curve {
    /// The name in the legend. A curve without a name is not in the legend.
    pub name: String,
    /// The points, in this order.
    pub points: Vec<(f64, f64)>,
    /// The index of the line's colour in [`SERIES`], modulo the number of colours. None: the index of
    /// the curve in its chart.
    pub colour: Option<usize>,
    /// The shape drawn at every point. None: only the line is drawn.
    pub marker: Option<Marker>,
    /// Positions and texts of labels, in the curve's colour.
    pub labels: Vec<((f64, f64), String)>,
    /// True if the area below the line is filled.
    pub filled: bool,
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
    /// A small dot. No line joins dots.
    Dot,
}

impl Marker {
    /// The outline of the shape about (0, 0), as the data of an SVG path.
    fn path(self) -> &'static str {
        match self {
            Self::Circle => "M-5 0a5 5 0 1 0 10 0a5 5 0 1 0-10 0z",
            Self::Triangle => "M0-6L5.5 4H-5.5z",
            Self::Square => "M-4.5-4.5h9v9h-9z",
            Self::Diamond => "M0-6L6 0L0 6L-6 0z",
            Self::Cross => "M-5-5L5 5M-5 5L5-5",
            Self::Dot => "M-1.6 0a1.6 1.6 0 1 0 3.2 0a1.6 1.6 0 1 0-3.2 0z",
        }
    }
}

impl Curve {
    /// A line through these points, in this order.
    pub fn new(name: &str, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.to_owned(),
            points,
            ..Self::default()
        }
    }

    /// The cumulative distribution of values, as steps.
    pub fn distribution(name: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let n = sorted.len() as f64;
        let steps = sorted.iter().enumerate();
        let points = steps.flat_map(|(k, &v)| [(v, k as f64 / n), (v, (k + 1) as f64 / n)]);
        Self::new(name, points.collect())
    }

    /// The colour of this curve. `place` is the index of the curve in its chart.
    fn colour(&self, place: usize) -> &'static str {
        SERIES[self.colour.unwrap_or(place) % SERIES.len()]
    }

    /// Draws the line of the curve through positions in the figure. The filled area ends at `bottom`.
    fn draw_line(&self, figure: &mut Figure, points: &[(f64, f64)], bottom: f64, place: usize) {
        let (Some(first), Some(last)) = (points.first(), points.last()) else {
            return;
        };
        let colour = self.colour(place);
        let line: Vec<String> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        let line = line.join(" ");
        if self.filled {
            let (left, right) = (first.0, last.0);
            figure.shape(format_args!(
                "polygon points=\"{left:.1},{bottom:.1} {line} {right:.1},{bottom:.1}\" fill=\"{colour}\" fill-opacity=\"0.3\""
            ));
        }
        if self.marker != Some(Marker::Dot) {
            let width = if self.filled { 1 } else { 2 };
            figure.shape(format_args!(
                "polyline points=\"{line}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\""
            ));
        }
    }

    fn draw_marker(&self, figure: &mut Figure, (x, y): (f64, f64), place: usize) {
        if let Some(marker) = self.marker {
            let (path, colour) = (marker.path(), self.colour(place));
            let stroke = if marker == Marker::Cross { 2 } else { 0 };
            figure.shape(format_args!(
                "path transform=\"translate({x:.1} {y:.1})\" d=\"{path}\" fill=\"{colour}\" stroke=\"{colour}\" stroke-width=\"{stroke}\""
            ));
        }
    }

    /// Draws a short piece of the curve for the legend.
    pub(super) fn draw_sample(&self, figure: &mut Figure, (x, y): (f64, f64), length: f64, place: usize) {
        let high = if self.filled { 6.0 } else { 0.0 };
        self.draw_line(figure, &[(x, y - high), (x + length, y - high)], y + high, place);
        self.draw_marker(figure, (x + length / 2.0, y), place);
    }
}

/// A value that is marked in a chart, with a text.
#[derive(Debug, Clone)]
pub enum Mark {
    /// A line at x from bottom to top, with a text at its upper end.
    Vertical(f64, String),
    /// A line at y from left to right, with a text at its left end.
    Horizontal(f64, String),
}

/// Two axes, and what lies between them.
#[derive(Debug, Clone)]
pub struct Chart {
    pub(super) title: String,
    pub(super) x: Axis,
    pub(super) y: Axis,
    pub(super) curves: Vec<Curve>,
    pub(super) marks: Vec<Mark>,
    /// An image that fills the area between the axes.
    pub(super) picture: Option<Picture>,
    /// Positions with the values that give their colours.
    pub(super) dots: Vec<((f64, f64), f64)>,
    /// The colours of the picture or the dots, explained by a bar.
    pub(super) scale: Option<Scale>,
    /// Height of the area between the axes, divided by its width.
    pub(super) aspect: f64,
}

/// Room beside the area between the axes, in pixels: for numbers and names, and for a colour bar.
const LEFT: f64 = 92.0;
const RIGHT: f64 = 28.0;
const BAR_RIGHT: f64 = 128.0;
const ABOVE: f64 = 26.0;
const BELOW: f64 = 58.0;
/// Distance and width of a colour bar.
const BAR: (f64, f64) = (24.0, 16.0);
const GRID: &str = "#dedede";
const LINES: &str = "#5a5a5a";
/// Two dots of a field map overlap little if each has this radius, in units of their mean distance.
const DOT: f64 = 0.35;

impl Chart {
    /// A chart of curves. The lines of the title are its heading.
    pub fn new(title: &str, x: Axis, y: Axis, curves: Vec<Curve>) -> Self {
        Self {
            title: title.to_owned(),
            x,
            y,
            curves,
            marks: Vec::new(),
            picture: None,
            dots: Vec::new(),
            scale: None,
            aspect: 0.72,
        }
    }

    /// Adds marks.
    #[must_use]
    pub fn with_marks(self, marks: Vec<Mark>) -> Self {
        Self { marks, ..self }
    }

    /// Replaces the axes.
    #[must_use]
    pub fn with_axes(self, x: Axis, y: Axis) -> Self {
        Self { x, y, ..self }
    }

    /// Width and height of the area between the axes, in a cell of this width.
    fn plot_size(&self, cell: f64) -> (f64, f64) {
        let right = if self.scale.is_some() { BAR_RIGHT } else { RIGHT };
        let width = cell - LEFT - right;
        (width, width * self.aspect)
    }

    /// The height with axes and heading, in a cell of this width.
    pub(super) fn height(&self, cell: f64) -> f64 {
        let heading = self.title.lines().count() as f64 * LINE;
        heading + ABOVE + self.plot_size(cell).1 + BELOW
    }

    /// Draws the chart at the bottom of a cell of the figure, which begins at a corner and has this
    /// width and height.
    pub(super) fn draw(&self, figure: &mut Figure, corner: (f64, f64), cell: (f64, f64)) {
        let (width, height) = self.plot_size(cell.0);
        let (left, bottom) = (corner.0 + LEFT, corner.1 + cell.1 - BELOW);
        let (right, top) = (left + width, bottom - height);
        for (row, line) in self.title.lines().rev().enumerate() {
            let at = (left + width / 2.0, top - ABOVE - row as f64 * LINE + 6.0);
            figure.text(at, MIDDLE, line);
        }
        let points = || self.curves.iter().flat_map(|curve| &curve.points);
        let (mut of_x, mut of_y) = (Vec::new(), Vec::new());
        for mark in &self.marks {
            match mark {
                Mark::Vertical(x, _) => of_x.push(*x),
                Mark::Horizontal(y, _) => of_y.push(*y),
            }
        }
        let x = self.x.ruler(points().map(|p| p.0).chain(of_x));
        let y = self.y.ruler(points().map(|p| p.1).chain(of_y));
        let place = |(px, py): (f64, f64)| (left + width * x.at(px), bottom - height * y.at(py));

        for (at, text) in x.numbers() {
            let at = left + width * at;
            line(figure, (at, top), (at, bottom + 5.0), GRID);
            figure.text((at, bottom + 20.0), MIDDLE, &text);
        }
        for (at, _) in y.numbers() {
            let at = bottom - height * at;
            line(figure, (left - 5.0, at), (right, at), GRID);
        }
        figure.text((left + width / 2.0, bottom + 44.0), MIDDLE, &self.x.name);
        upright(figure, y, &self.y.name, (left - 9.0, -65.0), (bottom, height));
        if let Some(picture) = &self.picture {
            figure.picture((left, top), (width, height), picture);
        }
        self.draw_curves(figure, place, ([left, right], [top, bottom]));
        if let Some(scale) = &self.scale {
            let radius = DOT * (width * height / self.dots.len().max(1) as f64).sqrt();
            for &(at, value) in &self.dots {
                let ((x, y), [r, g, b]) = (place(at), scale.colour(value));
                let radius = radius.clamp(2.0, 9.0);
                // White dots would be invisible without an edge.
                figure.shape(format_args!(
                    "circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" fill=\"rgb({r},{g},{b})\" stroke=\"#808080\""
                ));
            }
            figure.picture((right + BAR.0, top), (BAR.1, height), &scale.bar());
            let beside = right + BAR.0 + BAR.1 + 6.0;
            upright(figure, scale.ruler, &scale.name, (beside, 62.0), (bottom, height));
        }
        line(figure, (left, top), (left, bottom), LINES);
        line(figure, (left, bottom), (right, bottom), LINES);
    }

    /// Draws curves and marks. `place` gives the place of a point in the figure.
    fn draw_curves(
        &self,
        figure: &mut Figure,
        place: impl Fn((f64, f64)) -> (f64, f64),
        ([left, right], [top, bottom]): ([f64; 2], [f64; 2]),
    ) {
        let shown = |p: &&(f64, f64)| self.x.shows(p.0) && self.y.shows(p.1);
        let mut labels = Labels {
            taken: Vec::new(),
            within: [left, top - ABOVE, right + RIGHT, bottom],
        };
        for (k, curve) in self.curves.iter().enumerate() {
            let points: Vec<(f64, f64)> = curve.points.iter().filter(shown).map(|&p| place(p)).collect();
            curve.draw_line(figure, &points, bottom, k);
            for &at in &points {
                curve.draw_marker(figure, at, k);
                labels.keep_free(at, if curve.marker.is_some() { 5.0 } else { 1.0 });
            }
            for pair in points.windows(2) {
                let part = |part: f64, from: f64, to: f64| from + part * (to - from);
                for t in (1..8).map(|step| f64::from(step) / 8.0) {
                    labels.keep_free(
                        (part(t, pair[0].0, pair[1].0), part(t, pair[0].1, pair[1].1)),
                        1.0,
                    );
                }
            }
        }
        for mark in &self.marks {
            let (at, to, text) = match mark {
                Mark::Vertical(x, text) => {
                    let x = place((*x, 1.0)).0;
                    ((x, top), (x, bottom), text)
                }
                Mark::Horizontal(y, text) => {
                    let y = place((1.0, *y)).1;
                    ((left, y), (right, y), text)
                }
            };
            line(figure, at, to, LINES);
            labels.write(figure, at, "#000000", text);
        }
        for (k, curve) in self.curves.iter().enumerate() {
            for (at, text) in curve.labels.iter().filter(|(at, _)| shown(&at)) {
                labels.write(figure, place(*at), curve.colour(k), text);
            }
        }
    }
}

const MIDDLE: &str = "text-anchor=\"middle\"";

fn line(figure: &mut Figure, (x1, y1): (f64, f64), (x2, y2): (f64, f64), colour: &str) {
    figure.shape(format_args!(
        "line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"{colour}\""
    ));
}

/// Writes the numbers and the name of an upright axis, whose lower end is at `bottom`. The numbers
/// end or begin at `x`, and the name is at the distance `away` from there: to the left if it is negative.
fn upright(figure: &mut Figure, of: Ruler, name: &str, (x, away): (f64, f64), (bottom, height): (f64, f64)) {
    let style = if away < 0.0 { "text-anchor=\"end\"" } else { "" };
    for (at, text) in of.numbers() {
        figure.text((x, bottom - height * at + 5.0), style, &text);
    }
    let (x, y) = (x + away, bottom - height / 2.0);
    let turned = format!("{MIDDLE} transform=\"rotate(-90 {x:.1} {y:.1})\"");
    figure.text((x, y), &turned, name);
}

/// Writes texts next to points, each where it covers no earlier text and no curve.
struct Labels {
    /// Left, top, right and bottom of what a text must not cover.
    taken: Vec<[f64; 4]>,
    /// Left, top, right and bottom of the area for texts.
    within: [f64; 4],
}

impl Labels {
    /// Keeps texts away from a square about a point, with this half side.
    fn keep_free(&mut self, (x, y): (f64, f64), half: f64) {
        self.taken.push([x - half, y - half, x + half, y + half]);
    }

    fn write(&mut self, figure: &mut Figure, (x, y): (f64, f64), colour: &str, text: &str) {
        let (width, height) = (text_width(text), TEXT + 1.0);
        let area = |left: f64, top: f64| [left, top, left + width, top + height];
        // Above and below the point on its right, then on its left, then farther and farther away.
        let places = (0..6).flat_map(|step| {
            let away = 4.0 + 0.7 * height * f64::from(step);
            let (right, left) = (x + 6.0, x - 6.0 - width);
            let (above, below) = (y - away - height, y + away);
            [
                area(right, above),
                area(right, below),
                area(left, above),
                area(left, below),
            ]
        });
        let [left, top, right, bottom] = self.within;
        let is_free = |[l, t, r, b]: &[f64; 4]| {
            let covers = |other: &[f64; 4]| *l < other[2] && other[0] < *r && *t < other[3] && other[1] < *b;
            *l >= left && *t >= top && *r <= right && *b <= bottom && !self.taken.iter().any(covers)
        };
        let first = area(x + 6.0, y - 4.0 - height);
        let place = places.into_iter().find(is_free).unwrap_or(first);
        self.taken.push(place);
        let style = format!("fill=\"{colour}\"");
        figure.text((place[0], place[1] + TEXT - 2.0), &style, text);
    }
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
            let curves = vec![
                Curve::new("first", vec![(1.0, 2.0), (10.0, 30.0)]),
                Curve::new("second", vec![(0.0, 0.0), (5.0, 3.0)]),
            ];
            let chart = Chart::new("heading", x, y, curves).with_marks(vec![
                Mark::Vertical(4.0, "four".to_owned()),
                Mark::Horizontal(3.0, "three".to_owned()),
            ]);
            let svg = Figure::new(&[chart], 300.0).svg();
            for text in ["heading", "first", "second", "four", "three"] {
                assert!(svg.contains(&format!(">{text}</text>")), "{text}");
            }
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }

    #[test]
    fn charts_share_a_legend_that_names_each_curve_once() {
        let chart = |title: &str, names: &[&str]| {
            let curve = |name: &&str| Curve {
                labels: vec![((1e-3, 2.0), format!("{name} beside"))],
                marker: Some(Marker::Square),
                ..Curve::new(name, vec![(1e-3, 2.0), (1e-2, 3.0)])
            };
            let curves = names.iter().map(curve).collect();
            Chart::new(
                title,
                Axis::logarithmic("error"),
                Axis::logarithmic("time"),
                curves,
            )
        };
        let charts = [
            chart("left", &["alpha", "beta"]),
            chart("right", &["beta", "gamma"]),
        ];
        let svg = Figure::new(&charts, 300.0).svg();
        for (text, count) in [
            ("left", 1),
            ("right", 1),
            ("alpha", 1),
            ("beta", 1),
            ("gamma", 1),
            ("beta beside", 2),
        ] {
            assert_eq!(svg.matches(&format!(">{text}</text>")).count(), count, "{text}");
        }
    }

    #[test]
    fn texts_do_not_cover_each_other() {
        let mut figure = Figure::new(&[], 100.0);
        let mut labels = Labels {
            taken: vec![[48.0, 48.0, 52.0, 52.0]],
            within: [0.0, 0.0, 300.0, 300.0],
        };
        for _ in 0..6 {
            labels.write(&mut figure, (50.0, 50.0), "#000000", "text");
        }
        let taken = &labels.taken;
        for (k, [left, top, right, bottom]) in taken.iter().enumerate() {
            let apart = |b: &[f64; 4]| *right <= b[0] || b[2] <= *left || *bottom <= b[1] || b[3] <= *top;
            assert!(taken[..k].iter().all(apart), "{taken:?}");
            assert!(*left >= 0.0 && *top >= 0.0 && *right <= 300.0 && *bottom <= 300.0);
        }
    }
}
