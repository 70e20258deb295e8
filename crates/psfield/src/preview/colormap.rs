//! From a brightness to a colour.

use std::str::FromStr;

use super::PreviewError;

/// Colours from dark to bright that also colour-blind people can tell apart: lightness grows all along. matplotlib's, beside grey.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Colormap {
    /// Black to white.
    Grey,
    /// Violet, green, yellow.
    Viridis,
    /// Blue, grey, yellow: the same for most colour-blind people as for others.
    Cividis,
    /// Black, red, pale yellow.
    Inferno,
    /// Black, pink, white.
    Magma,
    /// Blue, pink, yellow.
    Plasma,
}

impl Colormap {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Grey,
        Self::Viridis,
        Self::Cividis,
        Self::Inferno,
        Self::Magma,
        Self::Plasma,
    ];

    /// Its name, which it is parsed from.
    pub fn name(self) -> &'static str {
        match self {
            Self::Grey => "grey",
            Self::Viridis => "viridis",
            Self::Cividis => "cividis",
            Self::Inferno => "inferno",
            Self::Magma => "magma",
            Self::Plasma => "plasma",
        }
    }

    /// Red, green and blue of a brightness from 0 to 1; what is not a number has the [`undefined_colour`](Self::undefined_colour).
    pub fn colour(self, brightness: f64) -> [u8; 3] {
        let gradient = match self {
            _ if brightness.is_nan() => return self.undefined_colour(),
            Self::Grey => return [(255.0 * brightness).round() as u8; 3],
            Self::Viridis => colorous::VIRIDIS,
            Self::Cividis => colorous::CIVIDIS,
            Self::Inferno => colorous::INFERNO,
            Self::Magma => colorous::MAGMA,
            Self::Plasma => colorous::PLASMA,
        };
        gradient.eval_continuous(brightness.clamp(0.0, 1.0)).into_array()
    }

    /// The colour of pixels without a value, which is none of the map's: magenta where the map has no pink, else cyan.
    pub fn undefined_colour(self) -> [u8; 3] {
        match self {
            Self::Grey | Self::Viridis | Self::Cividis => [255, 0, 255],
            Self::Inferno | Self::Magma | Self::Plasma => [0, 255, 255],
        }
    }
}

impl FromStr for Colormap {
    type Err = PreviewError;
    fn from_str(text: &str) -> Result<Self, PreviewError> {
        Self::ALL
            .into_iter()
            .find(|map| map.name() == text)
            .ok_or_else(|| PreviewError::Name {
                known: "grey, viridis, cividis, inferno, magma, plasma",
                got: text.to_owned(),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Colours nearer than this in red, green and blue together could be taken for one another; two greys of a step of 28 % are as far.
    const APART: f64 = 120.0;

    fn distance(a: [u8; 3], b: [u8; 3]) -> f64 {
        let squares = a
            .iter()
            .zip(b)
            .map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2));
        squares.sum::<f64>().sqrt()
    }

    #[test]
    fn pixels_without_a_value_stand_out() {
        for map in Colormap::ALL {
            let nearest = (0..=255)
                .map(|level| distance(map.colour(f64::from(level) / 255.0), map.undefined_colour()))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest > APART, "{map:?}: {nearest}");
            assert_eq!(map.colour(f64::NAN), map.undefined_colour());
            assert_eq!(map.name().parse(), Ok(map));
        }
        assert!("jet".parse::<Colormap>().is_err());
    }

    #[test]
    fn lightness_grows_all_along() {
        // Luma of Rec. 709 on linear light.
        let lightness = |[r, g, b]: [u8; 3]| {
            let linear = |c: u8| (f64::from(c) / 255.0).powf(2.2);
            0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b)
        };
        for map in Colormap::ALL {
            let steps: Vec<f64> = (0..=16)
                .map(|n| lightness(map.colour(f64::from(n) / 16.0)))
                .collect();
            assert!(steps.is_sorted_by(|a, b| a < b), "{map:?}: {steps:?}");
        }
    }

    // matplotlib.colormaps["viridis"](x, bytes=True) at x = 0 and 1.
    #[test]
    fn viridis_is_matplotlibs() {
        assert_eq!(Colormap::Viridis.colour(0.0), [68, 1, 84]);
        assert_eq!(Colormap::Viridis.colour(1.0), [253, 231, 37]);
    }
}
