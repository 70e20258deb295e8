//! From a fraction of the range to a brightness.

use std::str::FromStr;

use super::PreviewError;

/// How bright a value is between the limits. All are those of `astropy.visualization`, with its parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stretch {
    /// `x`.
    Linear,
    /// `sqrt(x)`.
    Sqrt,
    /// `ln(1000 x + 1) / ln(1001)`.
    Log,
    /// `asinh(10 x) / asinh(10)`: linear below a tenth of the range, logarithmic above.
    Asinh,
}

impl Stretch {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Linear, Self::Sqrt, Self::Log, Self::Asinh];

    /// Its name, which it is parsed from.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Sqrt => "sqrt",
            Self::Log => "log",
            Self::Asinh => "asinh",
        }
    }

    /// The brightness, 0 to 1, at a fraction of the range, 0 to 1. NaN stays NaN.
    pub fn brightness(self, fraction: f64) -> f64 {
        const LOG: f64 = 1000.0;
        const ASINH: f64 = 0.1;
        match self {
            Self::Linear => fraction,
            Self::Sqrt => fraction.sqrt(),
            Self::Log => (LOG * fraction).ln_1p() / LOG.ln_1p(),
            Self::Asinh => (fraction / ASINH).asinh() / ASINH.recip().asinh(),
        }
    }
}

impl FromStr for Stretch {
    type Err = PreviewError;
    fn from_str(text: &str) -> Result<Self, PreviewError> {
        Self::ALL
            .into_iter()
            .find(|stretch| stretch.name() == text)
            .ok_or_else(|| PreviewError::Name {
                known: "linear, sqrt, log, asinh",
                got: text.to_owned(),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Brightnesses are compared with figures of 12 digits.
    const DIGITS: f64 = 1e-11;

    // from astropy.visualization import *; x = np.array([0.0, 0.01, 0.3, 1.0])    (astropy 8.0.2)
    // for s in LinearStretch(), SqrtStretch(), LogStretch(), AsinhStretch(): print(s(x))
    #[test]
    fn stretches_are_those_of_astropy() {
        for (stretch, expected) in [
            (Stretch::Linear, [0.0, 0.01, 0.3, 1.0]),
            (Stretch::Sqrt, [0.0, 0.1, 0.547_722_557_505, 1.0]),
            (Stretch::Log, [0.0, 0.347_080_675_085, 0.826_069_305_837, 1.0]),
            (Stretch::Asinh, [0.0, 0.033_297_750_218_8, 0.606_508_084_748, 1.0]),
        ] {
            let got = [0.0, 0.01, 0.3, 1.0].map(|x| stretch.brightness(x));
            let near = got
                .iter()
                .zip(&expected)
                .all(|(a, b): (&f64, &f64)| (a - b).abs() <= DIGITS);
            assert!(near, "{stretch:?}: {got:?}");
            assert_eq!(stretch.name().parse(), Ok(stretch));
        }
        assert!(Stretch::Log.brightness(f64::NAN).is_nan());
        assert!("power".parse::<Stretch>().is_err());
    }
}
