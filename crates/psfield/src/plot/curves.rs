//! Lines over one pair of axes.

use std::ops::Range;

use plotters::chart::{ChartBuilder, ChartContext, SeriesLabelPosition};
use plotters::coord::ranged1d::{Ranged, ValueFormatter};
use plotters::prelude::{
    Cartesian2d, Circle, IntoLogRange, LineSeries, PathElement, RGBColor, SVGBackend, Text,
};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{BLACK, Color};

use super::axes::{
    LABEL_ROOM_X, LABEL_ROOM_Y, MARGIN, TEXT, decades, draw_axes, draw_key, extent, text_style,
};
use super::colours::SERIES;
use super::figure::{Figure, PlotError};

/// How an axis counts, and its name with the unit.
#[derive(Debug, Clone)]
pub struct Axis {
    name: String,
    logarithmic: bool,
}

impl Axis {
    /// Even steps.
    pub fn linear(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            logarithmic: false,
        }
    }

    /// Powers of ten; values that are not above 0 are left out.
    pub fn logarithmic(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            logarithmic: true,
        }
    }

    fn range(&self, values: impl Iterator<Item = f64>) -> Range<f64> {
        if self.logarithmic {
            decades(values)
        } else {
            extent(values)
        }
    }
}

/// A line through points.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Its name in the key.
    pub name: String,
    /// Its points.
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    /// The part of the values that is below a value, as steps.
    pub fn distribution(name: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let n = sorted.len() as f64;
        let steps = sorted.iter().enumerate();
        Self {
            name: name.to_owned(),
            points: steps
                .flat_map(|(k, &v)| [(v, k as f64 / n), (v, (k + 1) as f64 / n)])
                .collect(),
        }
    }
}

/// A value that the reader should see.
#[derive(Debug, Clone)]
pub enum Mark {
    /// A line up the plot at x, with a text at its upper end.
    Vertical(f64, String),
    /// A line across the plot at y, with a text at its left end.
    Horizontal(f64, String),
    /// A dot.
    Point(f64, f64, String),
}

/// Lines over one pair of axes, with marks and a key.
#[derive(Debug, Clone)]
pub struct Curves {
    /// The axis across.
    pub x: Axis,
    /// The axis up.
    pub y: Axis,
    /// The lines.
    pub curves: Vec<Curve>,
    /// What is marked.
    pub marks: Vec<Mark>,
}

const SIZE: (u32, u32) = (760, 460);
const MARK: RGBColor = RGBColor(90, 90, 90);

impl Curves {
    /// Draws them.
    ///
    /// # Errors
    /// [`PlotError`] when the drawing fails.
    pub fn figure(&self) -> Result<Figure, PlotError> {
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
        Figure::draw(SIZE, |root| {
            let mut chart = ChartBuilder::on(root);
            chart
                .margin(MARGIN)
                .margin_right(2 * MARGIN)
                .x_label_area_size(LABEL_ROOM_X)
                .y_label_area_size(LABEL_ROOM_Y);
            let (xs, ys) = (x.clone(), y.clone());
            match (self.x.logarithmic, self.y.logarithmic) {
                (false, false) => self.fill(chart.build_cartesian_2d(xs, ys)?, &x, &y)?,
                (true, false) => self.fill(chart.build_cartesian_2d(xs.log_scale(), ys)?, &x, &y)?,
                (false, true) => self.fill(chart.build_cartesian_2d(xs, ys.log_scale())?, &x, &y)?,
                (true, true) => {
                    self.fill(chart.build_cartesian_2d(xs.log_scale(), ys.log_scale())?, &x, &y)?;
                }
            }
            Ok(Vec::new())
        })
    }

    fn fill<'a, 'b: 'a, X, Y>(
        &self,
        mut chart: ChartContext<'a, SVGBackend<'b>, Cartesian2d<X, Y>>,
        x: &Range<f64>,
        y: &Range<f64>,
    ) -> Result<(), PlotError>
    where
        X: Ranged<ValueType = f64> + ValueFormatter<f64> + 'a,
        Y: Ranged<ValueType = f64> + ValueFormatter<f64> + 'a,
    {
        draw_axes(&mut chart, &self.x.name, &self.y.name)?;
        for (curve, colour) in self.curves.iter().zip(SERIES.iter().cycle()) {
            let shown = curve
                .points
                .iter()
                .copied()
                .filter(|p| (!self.x.logarithmic || p.0 > 0.0) && (!self.y.logarithmic || p.1 > 0.0));
            let line = chart.draw_series(LineSeries::new(shown, colour.stroke_width(2)))?;
            if self.curves.len() > 1 {
                line.label(curve.name.clone()).legend(move |(x, y)| {
                    PathElement::new(vec![(x, y), (x + 22, y)], colour.stroke_width(3))
                });
            }
        }
        let style = |h, v| text_style(TEXT).pos(Pos::new(h, v));
        let mut points_so_far = 0;
        for mark in &self.marks {
            let mut lower = 0;
            let (line, at, text, style) = match mark {
                Mark::Vertical(v, text) => (
                    [(*v, y.start), (*v, y.end)],
                    (*v, y.end),
                    text,
                    // On the side with more room.
                    if self.part(*v, x) > 0.6 {
                        style(HPos::Right, VPos::Top)
                    } else {
                        style(HPos::Left, VPos::Top)
                    },
                ),
                Mark::Horizontal(v, text) => (
                    [(x.start, *v), (x.end, *v)],
                    (x.start, *v),
                    text,
                    style(HPos::Left, VPos::Bottom),
                ),
                Mark::Point(px, py, text) => {
                    // Points near each other would write over each other's names.
                    lower = points_so_far * 2 * (TEXT + 5);
                    points_so_far += 1;
                    chart.draw_series([Circle::new((*px, *py), 5, BLACK.filled())])?;
                    (
                        [(*px, *py), (*px, *py)],
                        (*px, *py),
                        text,
                        style(HPos::Left, VPos::Top),
                    )
                }
            };
            chart.draw_series([PathElement::new(line.to_vec(), MARK.stroke_width(1))])?;
            let right = matches!(style.pos.h_pos, HPos::Right);
            let shift = if right { -6 } else { 6 };
            let down = if matches!(style.pos.v_pos, VPos::Top) {
                5
            } else {
                -4
            };
            chart.draw_series([plotters::element::EmptyElement::at(at)
                + Text::new(text.clone(), (shift, down + lower), style)])?;
        }
        if self.curves.len() > 1 {
            draw_key(&mut chart, SeriesLabelPosition::LowerRight)?;
        }
        Ok(())
    }

    /// How far along the x axis a value lies, from 0 to 1.
    fn part(&self, value: f64, range: &Range<f64>) -> f64 {
        let scale = |v: f64| if self.x.logarithmic { v.log10() } else { v };
        (scale(value) - scale(range.start)) / (scale(range.end) - scale(range.start))
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
            let curves = Curves {
                x,
                y,
                curves: vec![
                    Curve {
                        name: "first".to_owned(),
                        points: vec![(1.0, 2.0), (10.0, 30.0)],
                    },
                    Curve {
                        name: "second".to_owned(),
                        points: vec![(0.0, 0.0), (5.0, 3.0)],
                    },
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
}
