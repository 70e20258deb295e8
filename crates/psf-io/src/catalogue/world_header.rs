//! Reads the keywords of world coordinates from a header, with two kinds of distortion. SIP acts on
//! pixel coordinates, and TPV acts on coordinates in the plane of the projection.

use thiserror::Error;

use crate::fits::card::{Card, FromValue};
use crate::fits::header_cards::{HeaderCards, matrix_keywords, sip_degree};

/// The highest supported order of SIP, which is the highest that the convention allows.
const LARGEST_SIP_ORDER: usize = 9;
/// Number of terms of TPV: orders 0 to 7, where each odd order has a further term in the radius.
const TPV_TERMS: usize = 40;
/// The search for the point that a distortion maps to a wanted point ends when a step is at most
/// this fraction of the wanted point's size. That size is 1e-6 plus the larger magnitude of the two
/// wanted coordinates. The search also ends after [`INVERSE_STEPS`] steps.
const INVERSE_ACCURACY: f64 = 1e-13;
const INVERSE_STEPS: usize = 50;
/// A found point is rejected if the distortion maps it to a point that differs from the wanted one
/// by more than this fraction of the wanted point's size. The search has then failed, for example
/// because the distortion folds the plane there.
const INVERSE_TOLERANCE: f64 = 1e-9;

/// The reason why a header does not give world coordinates.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum WorldCoordinatesError {
    /// A required keyword is missing.
    #[error("the header has no keyword {keyword} ({expected})")]
    Missing {
        /// The keyword.
        keyword: String,
        /// The value that the keyword should hold.
        expected: &'static str,
    },
    /// The value of a keyword is not supported.
    #[error("the keyword {keyword} must be {expected}, got {got}")]
    Unsupported {
        /// The keyword.
        keyword: String,
        /// The supported values.
        expected: &'static str,
        /// The value in the header.
        got: String,
    },
    /// The matrix maps the frame to a line or a point.
    #[error("the matrix of CDi_j, or of PCi_j and CDELTi, has no inverse")]
    Singular,
}

pub(crate) fn product(matrix: &[[f64; 2]; 2], [x, y]: [f64; 2]) -> [f64; 2] {
    [
        matrix[0][0] * x + matrix[0][1] * y,
        matrix[1][0] * x + matrix[1][1] * y,
    ]
}

/// The determinant and the inverse of a matrix.
pub(crate) fn inverted(matrix: &[[f64; 2]; 2]) -> (f64, [[f64; 2]; 2]) {
    let [[a, b], [c, d]] = *matrix;
    let determinant = a * d - b * c;
    let inverse = [
        [d / determinant, -b / determinant],
        [-c / determinant, a / determinant],
    ];
    (determinant, inverse)
}

pub(crate) fn unsupported(keyword: &str, expected: &'static str, got: &str) -> WorldCoordinatesError {
    WorldCoordinatesError::Unsupported {
        keyword: keyword.to_owned(),
        expected,
        got: got.to_owned(),
    }
}

/// The keywords of world coordinates in a header.
pub(crate) struct World<'a> {
    pub(crate) header: &'a HeaderCards,
}

impl World<'_> {
    /// The value of a keyword, or `None` if the header lacks the keyword. A value that is not a
    /// number is an error.
    pub(crate) fn number(&self, keyword: &str) -> Result<Option<f64>, WorldCoordinatesError> {
        let Some(card) = self.header.get(keyword) else {
            return Ok(None);
        };
        let value = card.value();
        if let Some(number) = value.clone().and_then(f64::from_value) {
            return Ok(Some(number));
        }
        let got = value.map_or_else(|| "no value".to_owned(), |value| value.to_string());
        Err(unsupported(keyword, "a number", &got))
    }

    pub(crate) fn needed(&self, keyword: &str, expected: &'static str) -> Result<f64, WorldCoordinatesError> {
        self.number(keyword)?
            .ok_or_else(|| WorldCoordinatesError::Missing {
                keyword: keyword.to_owned(),
                expected,
            })
    }

    pub(crate) fn text(&self, keyword: &str) -> Result<String, WorldCoordinatesError> {
        self.header
            .value(keyword)
            .ok_or_else(|| WorldCoordinatesError::Missing {
                keyword: keyword.to_owned(),
                expected: "the kind of world coordinate, such as RA---TAN",
            })
    }

    /// Reads the matrix from pixels to the units of the axes: `CDi_j`, or `CDELTi` with `PCi_j` or
    /// `CROTA2`. Old headers spell the keywords `PC001002`.
    pub(crate) fn matrix(&self) -> Result<[[f64; 2]; 2], WorldCoordinatesError> {
        let named = |stem: &str| -> Result<[[Option<f64>; 2]; 2], WorldCoordinatesError> {
            let of = |i, j| {
                let spelt = matrix_keywords(stem, i, j);
                let here = spelt.iter().find(|keyword| self.header.get(keyword).is_some());
                here.map_or(Ok(None), |keyword| self.number(keyword))
            };
            Ok([[of(1, 1)?, of(1, 2)?], [of(2, 1)?, of(2, 2)?]])
        };
        let cd = named("CD")?;
        if cd.iter().flatten().any(Option::is_some) {
            return Ok(cd.map(|row| row.map(|value| value.unwrap_or(0.0))));
        }
        let scale = "degrees per pixel, or use CDi_j";
        let scales = [self.needed("CDELT1", scale)?, self.needed("CDELT2", scale)?];
        let pc = named("PC")?;
        if pc.iter().flatten().any(Option::is_some) {
            let of = |i: usize, j: usize| scales[i] * pc[i][j].unwrap_or(f64::from(u8::from(i == j)));
            return Ok([[of(0, 0), of(0, 1)], [of(1, 0), of(1, 1)]]);
        }
        let (sin, cos) = self.number("CROTA2")?.unwrap_or(0.0).to_radians().sin_cos();
        Ok([
            [scales[0] * cos, -scales[1] * sin],
            [scales[0] * sin, scales[1] * cos],
        ])
    }
}

/// The distortion that is applied in addition to the projection.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Distortion {
    None,
    /// Adds `A(u, v)` and `B(u, v)` to offsets `(u, v)` in pixels (Shupe et al. 2005). Each term is
    /// a coefficient, a power of u and a power of v.
    Sip([Vec<(f64, i32, i32)>; 2]),
    /// Replaces the coordinates on the projection, in degrees, by polynomials of both coordinates.
    /// `PV1_m` and `PV2_m` are the coefficients.
    Tpv(Box<[[f64; TPV_TERMS]; 2]>),
}

impl Distortion {
    /// Reads the distortion. `axes` are the axis numbers of longitude and latitude. `reference` is the
    /// usual native latitude of the reference point.
    pub(crate) fn from_header(
        header: &HeaderCards,
        types: &[String; 2],
        axes: [&str; 2],
        reference: f64,
    ) -> Result<Self, WorldCoordinatesError> {
        let world = World { header };
        refuse_tables(header)?;
        let is = |name| types[0].get(5..8) == Some(name);
        let suffix_of = |ctype: &str| ctype.get(8..).unwrap_or_default().trim_end().to_owned();
        for (keyword, ctype) in ["CTYPE1", "CTYPE2"].iter().zip(types) {
            if !["", "-SIP"].contains(&suffix_of(ctype).as_str()) {
                const SIP: &str = "without a distortion after the projection, or with -SIP";
                return Err(unsupported(keyword, SIP, ctype));
            }
        }
        let announced = types.iter().any(|ctype| suffix_of(ctype) == "-SIP");
        // Headers processed by several programs may hold SIP although CTYPEi does not end in -SIP.
        // astropy then applies SIP and ignores the `PVi_m` of SCAMP, and so does this code.
        let order = ["A_ORDER", "B_ORDER"]
            .into_iter()
            .find(|keyword| header.get(keyword).is_some());
        if let Some(keyword) = order.filter(|_| is("TPV")) {
            return Err(unsupported(
                keyword,
                "absent if CTYPE1 asks for the distortion TPV (this keyword belongs to SIP)",
                "both distortions",
            ));
        }
        // A type that ends in -SIP without any coefficient has no distortion.
        let is_term = |card: &Card| {
            let keyword = card.keyword();
            (keyword.starts_with("A_") || keyword.starts_with("B_")) && sip_degree(&keyword).is_some()
        };
        if order.is_some() || (announced && header.iter().any(is_term)) {
            if !is("TAN") {
                refuse_moved_reference(&world, axes[0], reference)?;
            }
            return Ok(Self::Sip([sip(&world, "A")?, sip(&world, "B")?]));
        }
        // SCAMP's headers say TAN. With TAN, terms `PVi_m` of the latitude, and terms of the
        // longitude from m = 5 on, have no other meaning than TPV.
        let has = |axis: &str, from: usize| {
            (from..TPV_TERMS).any(|m| header.get(&format!("PV{axis}_{m}")).is_some())
        };
        if !is("TPV") && !(is("TAN") && (has(axes[1], 0) || has(axes[0], 5))) {
            refuse_moved_reference(&world, axes[0], reference)?;
            return Ok(Self::None);
        }
        let mut terms = Box::new([[0.0; TPV_TERMS]; 2]);
        for (axis, terms) in axes.iter().zip(terms.iter_mut()) {
            terms[1] = 1.0;
            for (m, term) in terms.iter_mut().enumerate() {
                if let Some(value) = world.number(&format!("PV{axis}_{m}"))? {
                    *term = value;
                }
            }
        }
        Ok(Self::Tpv(terms))
    }

    /// Applies the distortion to offsets in pixels.
    pub(crate) fn in_pixels(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        match self {
            Self::Sip([a, b]) => {
                let sum = |terms: &[(f64, i32, i32)]| {
                    terms
                        .iter()
                        .map(|&(c, p, q)| c * u.powi(p) * v.powi(q))
                        .sum::<f64>()
                };
                [u + sum(a), v + sum(b)]
            }
            _ => [u, v],
        }
    }

    /// Applies the distortion to coordinates on the projection.
    pub(crate) fn in_plane(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        match self {
            Self::Tpv(terms) => [tpv(&terms[0], x, y), tpv(&terms[1], y, x)],
            _ => [x, y],
        }
    }

    /// The offset in pixels whose distorted value is `to`.
    pub(crate) fn undo_in_pixels(&self, to: [f64; 2]) -> Option<[f64; 2]> {
        match self {
            Self::Sip(_) => inverse(|from| self.in_pixels(from), to),
            _ => Some(to),
        }
    }

    /// The coordinates on the projection plane whose distorted value is `to`.
    pub(crate) fn undo_in_plane(&self, to: [f64; 2]) -> Option<[f64; 2]> {
        match self {
            Self::Tpv(_) => inverse(|from| self.in_plane(from), to),
            _ => Some(to),
        }
    }
}

/// Returns an error for distortions by tables of pixels (Calabretta et al. 2004), since the tables
/// are not part of the image's header.
fn refuse_tables(header: &HeaderCards) -> Result<(), WorldCoordinatesError> {
    const STEMS: [&str; 4] = ["CPDIS", "CQDIS", "D2IMDIS", "D2IMARR"];
    let of_table = |card: &&Card| {
        let keyword = card.keyword();
        let rest = STEMS.iter().find_map(|stem| keyword.strip_prefix(stem));
        rest.is_some_and(|rest| rest.bytes().all(|byte| byte.is_ascii_digit()))
    };
    match header.iter().find(of_table) {
        None => Ok(()),
        Some(card) => Err(unsupported(
            &card.keyword(),
            "absent (distortions by tables are not supported: give a header with SIP or TPV, or positions in pixels)",
            &card.value().map_or_else(String::new, |value| value.to_string()),
        )),
    }
}

/// Returns an error if `PVi_0` to `PVi_3` of the longitude move the reference point or the pole
/// (Calabretta and Greisen 2002, section 2.5).
fn refuse_moved_reference(
    world: &World<'_>,
    axis: &str,
    reference: f64,
) -> Result<(), WorldCoordinatesError> {
    let pole = world.number("LONPOLE")?;
    // `PVi_2` is the native latitude of the reference point: 90 in a zenithal projection, 0 in CAR.
    // `PVi_4` (LATPOLE, the native latitude of the celestial pole) has no effect in a zenithal
    // projection. In CAR, it is 90 or the declination of the reference point, unless the map is
    // upside down.
    let latitude = world.number("LATPOLE")?;
    if let Some(value) = latitude.filter(|&value| reference == 0.0 && value <= 0.0) {
        return Err(unsupported(
            "LATPOLE",
            "above 0 in the projection CAR",
            &value.to_string(),
        ));
    }
    for (m, usual) in [(0, 0.0), (1, 0.0), (2, reference), (3, pole.unwrap_or(0.0))] {
        let keyword = format!("PV{axis}_{m}");
        if let Some(value) = world
            .number(&keyword)?
            .filter(|&value| value != 0.0 && value != usual)
        {
            return Err(unsupported(
                &keyword,
                "0 or absent (moved reference points are not supported, and the pole is read from LONPOLE)",
                &value.to_string(),
            ));
        }
    }
    Ok(())
}

/// Reads the terms `A_p_q` up to `A_ORDER`, or the terms of B.
fn sip(world: &World<'_>, name: &str) -> Result<Vec<(f64, i32, i32)>, WorldCoordinatesError> {
    let keyword = format!("{name}_ORDER");
    let order = world.needed(
        &keyword,
        "the order of the SIP distortion: A_ORDER and B_ORDER are both needed",
    )?;
    if order.fract() != 0.0 || !(0.0..=LARGEST_SIP_ORDER as f64).contains(&order) {
        return Err(unsupported(
            &keyword,
            "a whole number from 0 to 9",
            &order.to_string(),
        ));
    }
    let order = order as usize;
    let mut terms = Vec::new();
    for p in 0..=order {
        for q in 0..=order - p {
            if let Some(value) = world.number(&format!("{name}_{p}_{q}"))? {
                terms.push((value, p as i32, q as i32));
            }
        }
    }
    Ok(terms)
}

/// `PV_0 + PV_1 x + PV_2 y + PV_3 r + PV_4 x^2 + PV_5 xy + PV_6 y^2 + PV_7 x^3 ...`: orders up to
/// 7. The last term of each odd order is a power of r.
fn tpv(terms: &[f64; TPV_TERMS], x: f64, y: f64) -> f64 {
    let r = x.hypot(y);
    let mut terms = terms.iter();
    let mut sum = *terms.next().expect("40 terms");
    for order in 1..=7 {
        for q in 0..=order {
            sum += terms.next().expect("40 terms") * x.powi(order - q) * y.powi(q);
        }
        if order % 2 == 1 {
            sum += terms.next().expect("40 terms") * r.powi(order);
        }
    }
    sum
}

/// The point that a mapping close to the identity maps to `to`, or `None` if no such point is
/// found. The search is Newton's method with finite differences as derivatives.
fn inverse(mapping: impl Fn([f64; 2]) -> [f64; 2], to: [f64; 2]) -> Option<[f64; 2]> {
    let mut at = to;
    let size = 1e-6 + to[0].abs().max(to[1].abs());
    let step = 1e-6 * size;
    let error_at = |at| {
        let value = mapping(at);
        [to[0] - value[0], to[1] - value[1]]
    };
    for _ in 0..INVERSE_STEPS {
        let error = error_at(at);
        let along_x = error_at([at[0] + step, at[1]]);
        let along_y = error_at([at[0], at[1] + step]);
        // The slope of the mapping has the opposite sign of the slope of the error.
        let slope = |moved: [f64; 2], i: usize| (error[i] - moved[i]) / step;
        let matrix = [
            [slope(along_x, 0), slope(along_y, 0)],
            [slope(along_x, 1), slope(along_y, 1)],
        ];
        let (_, inverse) = inverted(&matrix);
        let move_by = product(&inverse, error);
        at = [at[0] + move_by[0], at[1] + move_by[1]];
        if !at[0].is_finite() || !at[1].is_finite() {
            return None;
        }
        if move_by[0].abs().max(move_by[1].abs()) <= INVERSE_ACCURACY * size {
            break;
        }
    }
    let left = error_at(at);
    (left[0].abs().max(left[1].abs()) <= INVERSE_TOLERANCE * size).then_some(at)
}
