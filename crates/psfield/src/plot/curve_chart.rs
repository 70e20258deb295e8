//! Curves drawn in their area.

use std::ops::Range;

use plotters::chart::{ChartBuilder, ChartContext, SeriesLabelPosition};
use plotters::coord::CoordTranslate;
use plotters::coord::combinators::{BindKeyPoints, IntoLogRange};
use plotters::coord::ranged1d::{Ranged, ValueFormatter};
use plotters::element::EmptyElement;
use plotters::prelude::{
    Cartesian2d, Circle, Cross, DrawingArea, LineSeries, PathElement, Polygon, RGBColor, Rectangle,
    SVGBackend, Text, TriangleMarker,
};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{BLACK, Color};

use super::axes::{LABEL_ROOM_X, LABEL_ROOM_Y, MARGIN, SMALL, TEXT, draw_axes, draw_key, text_style};
use super::colours::SERIES;
use super::curve::{Curve, Marker};
use super::curves::{Curves, Mark};
use super::figure::{Area, PlotError};
use super::ticks;

const MARK: RGBColor = RGBColor(90, 90, 90);
/// Half the length of a line in a key.
pub(super) const KEY_LINE: i32 = 14;

type Chart<'a, 'b, X, Y> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<X, Y>>;

impl Curve {
    /// Its colour, where it is the `place`-th curve of its plot.
    pub(super) fn colour_at(&self, place: usize) -> RGBColor {
        SERIES[self.colour.unwrap_or(place) % SERIES.len()]
    }
}

impl Curves {
    /// Draws axes, curves and marks, and the key where one is asked for.
    pub(super) fn draw_in(&self, area: &Area<'_>, key: bool) -> Result<(), PlotError> {
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
        let decades = |range: &Range<f64>| {
            range
                .clone()
                .log_scale()
                .with_key_points(ticks::logarithmic(range.start, range.end))
        };
        match (self.x.logarithmic, self.y.logarithmic) {
            (false, false) => self.fill(chart.build_cartesian_2d(xs, ys)?, &x, &y, key),
            (true, false) => self.fill(chart.build_cartesian_2d(decades(&x), ys)?, &x, &y, key),
            (false, true) => self.fill(chart.build_cartesian_2d(xs, decades(&y))?, &x, &y, key),
            (true, true) => self.fill(chart.build_cartesian_2d(decades(&x), decades(&y))?, &x, &y, key),
        }
    }

    fn fill<'a, 'b: 'a, X, Y>(
        &self,
        mut chart: Chart<'a, 'b, X, Y>,
        x: &Range<f64>,
        y: &Range<f64>,
        key: bool,
    ) -> Result<(), PlotError>
    where
        X: Ranged<ValueType = f64> + ValueFormatter<f64> + 'a,
        Y: Ranged<ValueType = f64> + ValueFormatter<f64> + 'a,
    {
        draw_axes(&mut chart, &self.x.name, &self.y.name)?;
        for (place, curve) in self.curves.iter().enumerate() {
            self.draw_curve(&mut chart, curve, curve.colour_at(place), key)?;
        }
        self.draw_marks(&mut chart, x, y)?;
        if key {
            draw_key(&mut chart, SeriesLabelPosition::LowerRight)?;
        }
        Ok(())
    }

    fn draw_curve<'a, 'b: 'a, X, Y>(
        &self,
        chart: &mut Chart<'a, 'b, X, Y>,
        curve: &Curve,
        colour: RGBColor,
        key: bool,
    ) -> Result<(), PlotError>
    where
        X: Ranged<ValueType = f64> + 'a,
        Y: Ranged<ValueType = f64> + 'a,
    {
        let shown = |p: &(f64, f64)| (!self.x.logarithmic || p.0 > 0.0) && (!self.y.logarithmic || p.1 > 0.0);
        let points: Vec<(f64, f64)> = curve.points.iter().copied().filter(shown).collect();
        let line = chart.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?;
        if key {
            line.label(curve.name.clone())
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 22, y)], colour.stroke_width(3)));
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
            labels.map(|(at, text)| EmptyElement::at(*at) + Text::new(text.clone(), (6, -5), style.clone())),
        )?;
        Ok(())
    }

    fn draw_marks<'a, 'b: 'a, X, Y>(
        &self,
        chart: &mut Chart<'a, 'b, X, Y>,
        x: &Range<f64>,
        y: &Range<f64>,
    ) -> Result<(), PlotError>
    where
        X: Ranged<ValueType = f64> + 'a,
        Y: Ranged<ValueType = f64> + 'a,
    {
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
                    if self.x.part(*v, x) > 0.6 {
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
            chart.draw_series([
                EmptyElement::at(at) + Text::new(text.clone(), (shift, down + lower), style)
            ])?;
        }
        Ok(())
    }
}

/// A marker in pixels about a point.
pub(super) fn draw_marker<C: CoordTranslate>(
    area: &DrawingArea<SVGBackend<'_>, C>,
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
