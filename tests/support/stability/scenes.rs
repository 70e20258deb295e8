//! Extreme scenes.

use ndarray::Array2;
use psfield::fit::fit;
use psfield::psf_types::{Interpolation, PointSource, Position};
use psfield::{Method, PsfieldError};

use super::faint::{texture_and_disc, texture_and_stars};
use super::images::{Light, PRECISIONS, Precision, error};
use super::models::{FRAME, PATCH, SIDE, as_they_are, gaussian, jumping, lattice, random, samples, smooth};
use super::{Case, Cell, Section};

/// The methods, in the order of the columns.
pub(super) const METHODS: [Method; 5] = [
    Method::Direct,
    Method::Basis,
    Method::Patch(PATCH),
    Method::LowRank,
    Method::Auto,
];
/// The names of the columns.
pub(crate) const COLUMNS: &[&str] = &["direct", "basis", "patch", "lowrank", "auto"];

/// Each addition to a pixel rounds a subnormal result to whole quanta. This is the most additions
/// allowed.
const QUANTA: f64 = 64.0;
/// The light of a checkerboard exceeds the rest after cancellation by this factor.
const CANCELLED: f64 = 5.0;
/// Uneven light on every pixel: noise, a blob, and points.
fn uneven() -> Array2<f64> {
    uneven_of(FRAME)
}

/// Uneven light on a frame of so many columns and rows.
pub(crate) fn uneven_of((columns, rows): (usize, usize)) -> Array2<f64> {
    let mut noise = random(1);
    Array2::from_shape_fn((rows, columns), |(y, x)| {
        let r2 = (x as f64 - 40.0).powi(2) + (y as f64 - 30.0).powi(2);
        let point = if (x * 31 + y * 17) % 211 == 0 { 5.0 } else { 0.0 };
        0.1 + noise() + 3.0 * (-r2 / 200.0).exp() + point
    })
}

fn of(f: impl Fn(usize, usize) -> f64) -> Array2<f64> {
    Array2::from_shape_fn((FRAME.1, FRAME.0), |(y, x)| f(x, y))
}

/// Stars between pixels, on the frame and at its edges.
fn stars() -> Result<Light, PsfieldError> {
    let mut at = random(2);
    let star = |_| PointSource::new(Position::new(97.0 * at() - 1.0, 81.0 * at() - 1.0)?, 1.0 + at());
    Ok(Light {
        pixels: Array2::zeros((FRAME.1, FRAME.0)),
        stars: (0..40).map(star).collect::<Result<_, _>>()?,
    })
}

/// The error of a method with a model whose image it makes exactly. Patches get a PSF that is
/// constant in each.
fn measured(light: &Light, method: (Method, Precision)) -> Result<f64, PsfieldError> {
    let model = if matches!(method.0, Method::Patch(_)) {
        jumping()?
    } else {
        smooth()?
    };
    error(&model, light, method)
}

/// One row per precision, one cell per method.
fn cases(
    name: &str,
    light: impl Fn(Precision) -> Result<Light, PsfieldError> + Clone + Send + Sync + 'static,
    limit: impl Fn(Precision) -> f64 + Clone + Send + Sync + 'static,
) -> Vec<Case> {
    PRECISIONS
        .map(|precision| {
            let (light, limit) = (light.clone(), limit.clone());
            Case::new(format!("{name}, {}", precision.name()), move || {
                METHODS
                    .map(|method| {
                        let got = light(precision).and_then(|light| measured(&light, (method, precision)));
                        Cell::error(got, limit(precision))
                    })
                    .to_vec()
            })
        })
        .into()
}

/// Light near 1, multiplied by a factor.
fn scaled(name: &str, light: Array2<f64>, factor: fn(Precision) -> f64) -> Vec<Case> {
    let light = move |precision| Ok(Light::of(light.clone()).scaled(factor(precision), precision));
    cases(name, light, move |precision| {
        precision.rounding() + QUANTA * precision.quantum() / factor(precision)
    })
}

fn plain(name: &str, light: Array2<f64>) -> Vec<Case> {
    scaled(name, light, |_| 1.0)
}

pub(super) fn section() -> Section {
    let mut noise = random(3);
    let mut cases: Vec<Case> = [
        plain("uneven light near 1", uneven()),
        scaled("uneven light times 1e-30", uneven(), |_| 1e-30),
        scaled("uneven light times 1e-15", uneven(), |_| 1e-15),
        scaled("uneven light times 1e15", uneven(), |_| 1e15),
        scaled("uneven light times 1e30", uneven(), |_| 1e30),
        scaled("uneven light times 1e-300 (f32: 1e-37)", uneven(), |p| match p {
            Precision::F64 => 1e-300,
            Precision::F32 => 1e-37,
        }),
        scaled("uneven light times 1e306 (f32: 1e36)", uneven(), |p| match p {
            Precision::F64 => 1e306,
            Precision::F32 => 1e36,
        }),
        scaled(
            "uneven light among the subnormal numbers: times 1e-312 (f32: 1e-40)",
            uneven(),
            |p| match p {
                Precision::F64 => 1e-312,
                Precision::F32 => 1e-40,
            },
        ),
        scaled("all equal, 1e30", of(|_, _| 1.0), |_| 1e30),
        plain("all equal, 1", of(|_, _| 1.0)),
        plain("no light", of(|_, _| 0.0)),
        plain(
            "one lit pixel",
            of(|x, y| f64::from(u8::from((x, y) == (50, 41)))),
        ),
        plain(
            "only the corners lit",
            of(|x, y| f64::from(u8::from(x % 95 == 0 && y % 79 == 0))),
        ),
        plain("checkerboard of 0 and 1", of(|x, y| ((x + y) % 2) as f64)),
        cancelling(),
        plain("fluxes all negative", -uneven()),
        plain(
            "fluxes of random sign",
            uneven().mapv(|v| if noise() < 0.5 { -v } else { v }),
        ),
        plain(
            "every 7th row and every 5th column lit",
            of(|x, y| {
                if y % 7 == 0 && x % 5 == 0 {
                    1.0 + (x % 3) as f64
                } else {
                    0.0
                }
            }),
        ),
    ]
    .into_iter()
    .flatten()
    .collect();
    for (name, factor) in [("1e-30", 1e-30), ("1", 1.0), ("1e30", 1e30)] {
        cases.extend(self::cases(
            &format!("40 stars between pixels, flux {name}"),
            move |precision| Ok(stars()?.scaled(factor, precision)),
            Precision::rounding,
        ));
    }
    cases.extend(dynamic_range_over_peak());
    cases.extend(overflow());
    Section {
        title: "Scenes",
        story: "The largest difference from the direct sum in f64, divided by its peak, for the worse of the two\n\
            anchorings. The frame has 96 x 80 pixels. The stamps have 15 x 15 pixels, K = 24 of 25 samples,\n\
            bilinear. For patches the PSF is constant in each patch and jumps between them (30 samples,\n\
            nearest), so that patches of 16 pixels are exact.\n\n\
            f64 must keep 1e-12, f32 2e-6. This is the rounding of some hundred transforms, products and\n\
            additions per pixel. The limit is five times larger for the checkerboard of -1 and 1, which cancels\n\
            except at its edge. Among subnormal numbers a result is an integer number of quanta (1.4e-45,\n\
            4.9e-324), and every addition to a pixel rounds to one: 64 of them are allowed on top. Light beyond\n\
            2^80 or below 2^-80 (f64: 2^900) is multiplied by a power of two before transforms and divided by\n\
            it after them.",
        columns: COLUMNS,
        cases,
    }
}

/// Neighbours cancel, so the peak is at the edge. Rounding follows the light, which is a few times
/// larger.
fn cancelling() -> Vec<Case> {
    let board = of(|x, y| if (x + y) % 2 == 0 { 1.0 } else { -1.0 });
    cases(
        "checkerboard of -1 and 1",
        move |precision| Ok(Light::of(board.clone()).scaled(1.0, precision)),
        |precision| CANCELLED * precision.rounding(),
    )
}

fn dynamic_range_over_peak() -> Vec<Case> {
    let mut exponent = random(4);
    let wide = uneven().mapv(|v| v * 10_f64.powf(12.0 * exponent()));
    [
        plain("range of 1e12, five bright stars", texture_and_stars()),
        plain("range of 1e12, a bright disc of 200 pixels", texture_and_disc()),
        plain("range of 1e12, every pixel at random", wide),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Results beyond the range of the precision.
fn overflow() -> Vec<Case> {
    PRECISIONS
        .map(|precision| {
            let name = format!(
                "PSFs of flux 10 and light at the end of the range, {}",
                precision.name()
            );
            Case::new(name, move || {
                METHODS
                    .map(|method| {
                        let got = (|| {
                            let at = lattice((2, 2), (95.0, 79.0));
                            let stamps = samples(&at, (SIDE, SIDE), |j| {
                                10.0 * gaussian((SIDE, SIDE), 0.3 * j as f64, 0.5)
                            })?;
                            let model = fit(stamps, &as_they_are(Interpolation::Bilinear))?.into_model()?;
                            let largest = match precision {
                                Precision::F32 => f64::from(f32::MAX),
                                Precision::F64 => f64::MAX,
                            };
                            error(&model, &Light::of(of(|_, _| largest)), (method, precision))
                        })();
                        Cell::refusal(got, "beyond the range of f32 or f64")
                    })
                    .to_vec()
            })
        })
        .into()
}
