//! Colours that most eyes can tell apart.

use plotters::style::RGBColor;

/// Colours of lines, in this order (Okabe and Ito 2008).
pub const SERIES: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(0, 0, 0),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
];

/// Colours of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourMap {
    /// Dark blue to yellow, even steps of lightness: for values.
    Viridis,
    /// Blue below, white in the middle, red above: for differences.
    BlueWhiteRed,
    /// Black to white: for images of the sky.
    Grey,
}

/// `RdBu` with 9 classes (C. Brewer, colorbrewer2.org), from blue, its middle pure white, so that no difference looks like none.
const BLUE_WHITE_RED: [[u8; 3]; 9] = [
    [33, 102, 172],
    [67, 147, 195],
    [146, 197, 222],
    [209, 229, 240],
    [255, 255, 255],
    [253, 219, 199],
    [244, 165, 130],
    [214, 96, 77],
    [178, 24, 43],
];

impl ColourMap {
    /// The colour of a value from 0 to 1; beyond, that of the nearer end.
    pub fn at(self, value: f64) -> [u8; 3] {
        let value = value.clamp(0.0, 1.0);
        match self {
            Self::Grey => [(value * 255.0).round() as u8; 3],
            Self::Viridis => colorous::VIRIDIS.eval_continuous(value).into_array(),
            Self::BlueWhiteRed => between(&BLUE_WHITE_RED, value),
        }
    }
}

fn between(stops: &[[u8; 3]], value: f64) -> [u8; 3] {
    let along = value * (stops.len() - 1) as f64;
    let first = (along as usize).min(stops.len() - 2);
    let part = along - first as f64;
    std::array::from_fn(|c| {
        let (a, b) = (f64::from(stops[first][c]), f64::from(stops[first + 1][c]));
        (a + part * (b - a)).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lightness([r, g, b]: [u8; 3]) -> f64 {
        0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
    }

    #[test]
    fn values_get_lighter_and_differences_darken_both_ways() {
        let steps: Vec<f64> = (0..=100).map(|k| f64::from(k) / 100.0).collect();
        let viridis: Vec<f64> = steps
            .iter()
            .map(|&v| lightness(ColourMap::Viridis.at(v)))
            .collect();
        assert!(viridis.windows(2).all(|w| w[1] >= w[0]), "{viridis:?}");
        let map = ColourMap::BlueWhiteRed;
        assert_eq!(map.at(0.5), [255, 255, 255]);
        for &v in &steps[..50] {
            assert!(lightness(map.at(v)) < lightness(map.at(v + 0.01)) + 1.0);
            assert!(map.at(v)[2] > map.at(v)[0] && map.at(1.0 - v)[0] > map.at(1.0 - v)[2]);
        }
        assert_eq!(map.at(-3.0), map.at(0.0));
    }
}
