//! Colours that colour-blind readers can tell apart.

use ndarray::Array2;

use super::axis::{Ruler, Spacing};
use crate::preview::{Colormap, Picture};

/// Colours of lines, in the order of use (Okabe and Ito 2008).
pub const SERIES: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#000000", "#cc79a7", "#e69f00"];

/// The colour of values that are NaN.
const UNDEFINED: [u8; 3] = [128; 3];

/// Every second colour of `RdBu` with 9 classes (C. Brewer, colorbrewer2.org), from blue to red. The
/// middle is changed to pure white, so that a difference of 0 is invisible.
const BLUE_WHITE_RED: [[u8; 3]; 5] = [
    [33, 102, 172],
    [146, 197, 222],
    [255; 3],
    [244, 165, 130],
    [178, 24, 43],
];

/// The colour of a difference at a place from 0 (blue) to 1 (red).
fn blue_white_red(place: f64) -> [u8; 3] {
    let along = place * (BLUE_WHITE_RED.len() - 1) as f64;
    let first = (along as usize).min(BLUE_WHITE_RED.len() - 2);
    let [from, to] = [BLUE_WHITE_RED[first], BLUE_WHITE_RED[first + 1]];
    std::array::from_fn(|c| {
        let (from, to) = (f64::from(from[c]), f64::from(to[c]));
        (from + (along - first as f64) * (to - from)).round() as u8
    })
}

/// Assigns colours to values, with a name for its colour bar: the quantity with its unit. Values
/// outside the bar get the colour of its nearer end, and NaN is grey. Charts that are compared should
/// have equal scales.
#[derive(Debug, Clone)]
pub struct Scale {
    pub(super) name: String,
    pub(super) ruler: Ruler,
    /// The colour at a place from 0 to 1.
    colours: fn(f64) -> [u8; 3],
}

impl Scale {
    /// Black at 0 to white at `high`, by `asinh(v / soft)`: linear below about `soft`, logarithmic
    /// above.
    pub fn sky(name: &str, soft: f64, high: f64) -> Self {
        Self::new(name, Spacing::Asinh(soft), (0.0, high), |place| {
            Colormap::Grey.colour(place)
        })
    }

    /// Blue at `-most`, white at 0, red at `most`, with linear steps between them.
    pub fn difference(name: &str, most: f64) -> Self {
        Self::new(name, Spacing::Linear, (-most, most), blue_white_red)
    }

    /// Viridis from `low` to `high`, both above 0, logarithmic.
    pub fn logarithmic(name: &str, low: f64, high: f64) -> Self {
        Self::new(name, Spacing::Logarithmic, (low, high), |place| {
            Colormap::Viridis.colour(place)
        })
    }

    fn new(name: &str, spacing: Spacing, (low, high): (f64, f64), colours: fn(f64) -> [u8; 3]) -> Self {
        let ruler = Ruler { spacing, low, high };
        Self {
            name: name.to_owned(),
            ruler,
            colours,
        }
    }

    /// The colour of a value.
    pub(super) fn colour(&self, value: f64) -> [u8; 3] {
        if value.is_nan() {
            return UNDEFINED;
        }
        (self.colours)(self.ruler.at(value).clamp(0.0, 1.0))
    }

    /// The colours from the lower end to the upper end, as a picture of one column.
    pub(super) fn bar(&self) -> Picture {
        const STEPS: usize = 256;
        let places = Array2::from_shape_fn((STEPS, 1), |(step, _)| step as f64 / (STEPS - 1) as f64);
        Picture::coloured(places.view(), self.colours)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lightness([r, g, b]: [u8; 3]) -> f64 {
        0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
    }

    #[test]
    fn scales_end_in_their_end_colours() {
        let sky = Scale::sky("flux", 0.1, 50.0);
        assert_eq!(
            [0.0, 50.0, 90.0].map(|v| sky.colour(v)),
            [[0; 3], [255; 3], [255; 3]]
        );
        let difference = Scale::difference("flux", 2.0);
        assert_eq!(difference.colour(0.0), [255; 3]);
        assert_eq!([-2.0, -9.0].map(|v| difference.colour(v)), [BLUE_WHITE_RED[0]; 2]);
        assert_eq!(difference.colour(f64::NAN), UNDEFINED);
        let map = Scale::logarithmic("flux", 1e-3, 1.0);
        assert_eq!(map.colour(1e-3), Colormap::Viridis.colour(0.0));
    }

    #[test]
    fn differences_darken_both_ways() {
        for step in 0..50 {
            let v = f64::from(step) / 100.0;
            let (blue, red) = (blue_white_red(v), blue_white_red(1.0 - v));
            assert!(lightness(blue) < lightness(blue_white_red(v + 0.01)) + 1.0);
            assert!(blue[2] > blue[0] && red[0] > red[2]);
        }
    }
}
