//! Plots of curves side by side.

use plotters::prelude::{PathElement, Text};
use plotters::style::Color;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::axes::{MARGIN, TEXT, text_style, under_title};
use super::curve::Curve;
use super::curve_chart::{KEY_LINE, draw_marker};
use super::curves::Curves;
use super::figure::{Area, Figure, PlotError};

/// Width and height of a panel: two side by side stay readable at a page's width.
const PANEL: (u32, u32) = (560, 440);
/// Height of the strip with the key.
const KEY: u32 = 44;
/// Pixels between two names of the key.
const NAME_WIDTH: i32 = 118;

/// Plots with headings, two in a row, with one key above for all: curves of one name should have one colour and one marker.
///
/// # Errors
/// [`PlotError`] when the drawing fails.
pub fn curve_panels(panels: &[(String, Curves)]) -> Result<Figure, PlotError> {
    let across = panels.len().clamp(1, 2);
    let down = panels.len().div_ceil(across).max(1);
    let names = names(panels);
    let width = (across as u32 * PANEL.0).max(NAME_WIDTH as u32 * names.len() as u32 + 2 * MARGIN);
    Figure::draw((width, KEY + down as u32 * PANEL.1), |root| {
        let (top, rest) = root.split_vertically(KEY);
        draw_names(&top, &names)?;
        for ((title, curves), area) in panels.iter().zip(rest.split_evenly((down, across))) {
            curves.draw_in(&under_title(&area, title)?, false)?;
        }
        Ok(Vec::new())
    })
}

/// The first curve of each name, with its place in its panel.
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
            2 * MARGIN as i32 + KEY_LINE + k as i32 * NAME_WIDTH,
            KEY as i32 / 2,
        );
        area.draw(&PathElement::new(
            vec![(x - KEY_LINE, y), (x + KEY_LINE, y)],
            colour.stroke_width(2),
        ))?;
        if let Some(marker) = curve.marker {
            draw_marker(area, marker, (x, y), colour)?;
        }
        area.draw(&Text::new(
            curve.name.clone(),
            (x + KEY_LINE + 6, y),
            style.clone(),
        ))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::{Axis, Marker};

    #[test]
    fn panels_share_a_key_that_names_each_curve_once() {
        let curves = |names: &[&str]| Curves {
            x: Axis::logarithmic("error"),
            y: Axis::logarithmic("time, seconds"),
            curves: names
                .iter()
                .map(|name| {
                    Curve::new(name, vec![(1e-3, 1.0), (1e-2, 0.1)])
                        .with_marker(Marker::Square)
                        .with_colour(name.len())
                        .with_labels(vec![((1e-3, 1.0), format!("{name} beside"))])
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
