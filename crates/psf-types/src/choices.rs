//! Settings that the stages apply. Models store all of them except [`Anchor`] and
//! [`ToleranceOn`].

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::frame::DataError;
use crate::kriging::{KrigingKernel, KrigingParameters};

/// The interpolator that computes coefficients between the samples.
///
/// Text forms: `auto`, `kriging`, `kriging=PARAMETERS` ([`KrigingParameters`]), `delaunay`,
/// `natural-neighbour`, `idw`, `idw=POWER`, `bilinear`, `bicubic`, `polynomial=DEGREE`, `nearest` or
/// `table=COLUMNS,ROWS`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum Interpolation {
    /// Chosen by cross-validation on the samples: kriging, or the method that suits the samples'
    /// positions. This is bicubic for samples on a regular grid with more than one row and more than one
    /// column (bilinear if it is 2 x 2), nearest for a single sample, else natural neighbour.
    #[default]
    Auto,
    /// Kriging, also called Gaussian process regression. Without parameters, they are chosen by
    /// cross-validation on the samples.
    Kriging(Option<KrigingParameters>),
    /// Linear inside the triangles of the Delaunay triangulation.
    Delaunay,
    /// Sibson's natural neighbours with gradients at the corners of a tree of cells, bilinear between
    /// them. Exact at the samples.
    NaturalNeighbour,
    /// Inverse distance weights `d^-power` at the corners of a tree of cells, bilinear between them.
    /// Exact at the samples.
    InverseDistance {
        /// The exponent, above 0.
        power: f64,
    },
    /// Bilinear inside the cells of a regular (rectilinear) grid.
    Bilinear,
    /// Products of cubics through four columns and four rows of a regular (rectilinear) grid. Each
    /// cell is divided into 5 x 5 parts, and the values are bilinear in each part.
    Bicubic,
    /// One polynomial in x and y over the whole field, by least squares.
    Polynomial {
        /// The total degree.
        degree: usize,
    },
    /// The value of the nearest sample.
    Nearest,
    /// Polynomials on the patches of a table ([`FieldTable`](crate::FieldTable)). Coefficients are those of
    /// the table's nodes, in place of samples. So a file can hold any smooth field.
    Table {
        /// The number of undivided patches in a row.
        columns: usize,
        /// The number of undivided patches in a column.
        rows: usize,
    },
}

impl Interpolation {
    /// The exponent of inverse distance weighting if the caller gives none.
    pub const DEFAULT_POWER: f64 = 2.0;
    /// The highest polynomial degree accepted. Real sets of samples are too small for a higher
    /// degree.
    pub const MAX_DEGREE: usize = 20;
}

impl std::fmt::Display for Interpolation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Kriging(None) => f.write_str("kriging"),
            Self::Kriging(Some(parameters)) => write!(f, "kriging={parameters}"),
            Self::Delaunay => f.write_str("delaunay"),
            Self::NaturalNeighbour => f.write_str("natural-neighbour"),
            Self::InverseDistance { power } if *power == Self::DEFAULT_POWER => f.write_str("idw"),
            Self::InverseDistance { power } => write!(f, "idw={power}"),
            Self::Bilinear => f.write_str("bilinear"),
            Self::Bicubic => f.write_str("bicubic"),
            Self::Polynomial { degree } => write!(f, "polynomial={degree}"),
            Self::Nearest => f.write_str("nearest"),
            Self::Table { columns, rows } => write!(f, "table={columns},{rows}"),
        }
    }
}

impl FromStr for Interpolation {
    type Err = DataError;
    fn from_str(text: &str) -> Result<Self, DataError> {
        const ALLOWED: &str = "auto, kriging, kriging=KERNEL,LENGTH_X,LENGTH_Y,TREND,NUGGET, delaunay, natural-neighbour, idw, \
                               idw=POWER (above 0), bilinear, bicubic, polynomial=DEGREE (0 to 20) or nearest";
        let refused = || DataError::setting("interpolation", ALLOWED, text);
        match text.split_once('=') {
            None => match text {
                "auto" => Ok(Self::Auto),
                "kriging" => Ok(Self::Kriging(None)),
                "delaunay" => Ok(Self::Delaunay),
                "natural-neighbour" => Ok(Self::NaturalNeighbour),
                "idw" => Ok(Self::InverseDistance {
                    power: Self::DEFAULT_POWER,
                }),
                "bilinear" => Ok(Self::Bilinear),
                "bicubic" => Ok(Self::Bicubic),
                "nearest" => Ok(Self::Nearest),
                _ => Err(refused()),
            },
            Some(("kriging", parameters)) => Ok(Self::Kriging(Some(parameters.parse()?))),
            Some(("table", counts)) => {
                let counts = counts.split_once(',').ok_or_else(refused)?;
                match (counts.0.parse(), counts.1.parse()) {
                    (Ok(columns), Ok(rows)) => Ok(Self::Table { columns, rows }),
                    _ => Err(refused()),
                }
            }
            Some(("idw", power)) => match power.parse::<f64>() {
                Ok(power) if power.is_finite() && power > 0.0 => Ok(Self::InverseDistance { power }),
                _ => Err(refused()),
            },
            Some(("polynomial", degree)) => match degree.parse::<usize>() {
                Ok(degree) if degree <= Self::MAX_DEGREE => Ok(Self::Polynomial { degree }),
                _ => Err(refused()),
            },
            Some(_) => Err(refused()),
        }
    }
}

/// The policy for positions outside the area that the samples cover. This area is the convex hull
/// of the samples. For the methods bilinear and bicubic, it is the samples' grid, and for a table the
/// rectangle that the table covers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum OutsidePolicy {
    /// Use the value at the nearest point of the covered area.
    #[default]
    Nearest,
    /// Continue the interpolation outside. The methods delaunay, natural-neighbour, bilinear,
    /// bicubic and table continue linearly. The methods kriging, idw, polynomial and nearest apply their own
    /// formula (idw up to half the width of the samples beyond them, then linear).
    Extend,
    /// Return an error.
    Error,
}

/// The choice between PSFs scaled to unit flux and PSFs as stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum Normalisation {
    /// Every PSF holds unit flux at every position.
    #[default]
    Unit,
    /// The values are used as they are.
    Keep,
}

/// The position at which the PSF is evaluated: the source's own position, or the position of the
/// output pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum Anchor {
    /// Each source spreads with the PSF of its own position ("scattering"), as light does.
    #[default]
    Source,
    /// Each output pixel gathers light with the PSF of its own position, as in the paper from which
    /// psfield's method comes (Bai, Jia et al.).
    Output,
}

/// The errors of a PSF that the tolerance of a convolution bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum ToleranceOn {
    /// The L2 error of the PSF, relative to the L2 norm of the PSF.
    L2,
    /// The L2 error, and the error of the flux in every circle about the source, relative to the
    /// total flux of the PSF: `|sum_{|u| <= R} dh(u)| <= tolerance |sum_u h(u)|` for every radius
    /// `R`. This bounds the error of aperture photometry.
    #[default]
    Aperture,
}

/// The interpolation between the pixels of a stamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum StampInterpolation {
    /// The interpolating cubic spline, as in photutils and in the software that makes gridded
    /// ePSFs.
    #[default]
    CubicSpline,
    /// The Lanczos kernel of three lobes, corrected to preserve constants. GalSim draws PSFEx
    /// models in this way.
    Lanczos3,
}

/// Implements `Display` and `FromStr` of an enum without fields, from one table of names. For any
/// other text, `FromStr` returns [`DataError::Setting`], or the given error.
#[doc(hidden)]
#[macro_export]
macro_rules! named {
    ($type:ident, $what:literal, $allowed:literal, $($name:literal => $variant:ident),+) => {
        $crate::named!(
            $type,
            $crate::DataError,
            |text| $crate::DataError::setting($what, $allowed, text),
            $($name => $variant),+
        );
    };
    ($type:ident, $error:ty, |$text:ident| $refused:expr, $($name:literal => $variant:ident),+) => {
        impl std::fmt::Display for $type {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(match self { $(Self::$variant => $name),+ })
            }
        }
        impl std::str::FromStr for $type {
            type Err = $error;
            fn from_str($text: &str) -> Result<Self, $error> {
                match $text {
                    $($name => Ok(Self::$variant),)+
                    _ => Err($refused),
                }
            }
        }
    };
}

named!(OutsidePolicy, "outside", "nearest, extend or error", "nearest" => Nearest, "extend" => Extend, "error" => Error);
named!(Normalisation, "normalise", "unit or keep", "unit" => Unit, "keep" => Keep);
named!(StampInterpolation, "stamp interpolation", "cubic-spline or lanczos3", "cubic-spline" => CubicSpline, "lanczos3" => Lanczos3);
named!(Anchor, "anchor", "source or output", "source" => Source, "output" => Output);
named!(ToleranceOn, "tolerance on", "l2 or aperture", "l2" => L2, "aperture" => Aperture);

/// Makes serde read and write the text form of a type, so that files and Python accept the same
/// values as the command line. The error of the text form is [`DataError`] if none is given.
#[doc(hidden)]
#[macro_export]
macro_rules! through_text {
    ($($type:ident),+) => {$(
        $crate::through_text!($type => $crate::DataError);
    )+};
    ($type:ident => $error:ty) => {
        impl TryFrom<String> for $type {
            type Error = $error;
            fn try_from(text: String) -> Result<Self, $error> {
                text.parse()
            }
        }
        impl From<$type> for String {
            fn from(value: $type) -> Self {
                value.to_string()
            }
        }
    };
}

through_text!(
    Interpolation,
    OutsidePolicy,
    Normalisation,
    Anchor,
    ToleranceOn,
    StampInterpolation,
    KrigingKernel
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_forms_round_trip() {
        for text in [
            "auto",
            "kriging",
            "kriging=gaussian,0.61,0.5,2,1e-12",
            "kriging=cubic,1,1,1,0e0",
            "delaunay",
            "natural-neighbour",
            "idw",
            "idw=3.5",
            "bilinear",
            "bicubic",
            "polynomial=3",
            "nearest",
        ] {
            assert_eq!(text.parse::<Interpolation>().unwrap().to_string(), text);
        }
        for text in [
            "",
            "Bilinear",
            "idw=0",
            "idw=-1",
            "idw=NaN",
            "polynomial",
            "polynomial=21",
            "nearest=1",
            "kriging=",
            "kriging=gaussian,1,1,1",
            "kriging=cubic,1,1,0,0",
            "kriging=gaussian,0,1,1,0",
            "kriging=gaussian,1,1,1,-1",
            "kriging=gaussian,1,1,1,nan",
        ] {
            assert!(text.parse::<Interpolation>().is_err(), "{text}");
        }
        assert_eq!(
            serde_json::to_string(&OutsidePolicy::Extend).unwrap(),
            "\"extend\""
        );
        assert!(serde_json::from_str::<Anchor>("\"both\"").is_err());
    }
}
