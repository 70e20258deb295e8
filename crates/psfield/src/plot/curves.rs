//! Lines over one pair of axes.

use std::ops::Range;

use super::axes::{decades, extent};
use super::curve::Curve;
use super::figure::{Figure, PlotError};

/// How an axis counts, and its name with the unit.
#[derive(Debug, Clone)]
pub struct Axis {
    pub(super) name: String,
    pub(super) logarithmic: bool,
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

    pub(super) fn range(&self, values: impl Iterator<Item = f64>) -> Range<f64> {
        if self.logarithmic {
            decades(values)
        } else {
            extent(values)
        }
    }

    /// How far along the axis a value lies, from 0 to 1.
    pub(super) fn part(&self, value: f64, range: &Range<f64>) -> f64 {
        let scale = |v: f64| if self.logarithmic { v.log10() } else { v };
        (scale(value) - scale(range.start)) / (scale(range.end) - scale(range.start))
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

impl Curves {
    /// Draws them, with a key where there are several.
    ///
    /// # Errors
    /// [`PlotError`] when the drawing fails.
    pub fn figure(&self) -> Result<Figure, PlotError> {
        Figure::draw(SIZE, |root| {
            self.draw_in(root, self.curves.len() > 1)?;
            Ok(Vec::new())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
