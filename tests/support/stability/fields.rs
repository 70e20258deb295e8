//! Interpolators over extreme positions: the fields themselves, and images through them.

use ndarray::Array2;
use psfield::coeff_field::interpolation;
use psfield::fit::fit;
use psfield::psf_types::{Interpolation, OutsidePolicy, Position, SampleCoefficients, SamplePositions};
use psfield::{Method, PsfieldError};

use super::images::{Light, PRECISIONS, error};
use super::models::{full, gaussians, random, unit_coordinates};
use super::positions::{Positions, positions};
use super::scenes::uneven_of;
use super::{Case, Cell, Section};

/// Every interpolator with few weights at each position. The polynomial appears with the lowest and with
/// a high degree.
const INTERPOLATIONS: [Interpolation; 8] = [
    Interpolation::Bilinear,
    Interpolation::Bicubic,
    Interpolation::Delaunay,
    Interpolation::NaturalNeighbour,
    Interpolation::InverseDistance { power: 2.0 },
    Interpolation::Nearest,
    Interpolation::Polynomial { degree: 1 },
    Interpolation::Polynomial { degree: 8 },
];

/// Weights add up to 1 except for their own rounding.
const CONSTANT: f64 = 1e-12;
/// Limit for a linear function, in addition to the rounding of coordinates. Triangles of 1e-9
/// pixels amplify the rounding of weights.
const LINEAR: f64 = 1e-10;
/// Natural neighbours are bilinear in the cells of a tree. In a cell that crosses the hull of
/// the samples, outside of which values are constant, they do not follow slopes quite.
const ACROSS_THE_HULL: f64 = 0.3;
/// Rounding of the largest coordinate, in multiples of the precision, relative to the samples'
/// extent.
const COORDINATES: f64 = 8.0 * f64::EPSILON;
/// Away from the samples' centre, the terms of a polynomial of degree 8 are about ten times the
/// values.
const POLYNOMIAL: f64 = 1e-10;
/// On uniform grids, the magnitudes of cubic weights add up to at most 13/8 per coordinate, reached
/// next to an edge.
const CUBIC_BEYOND: f64 = 13.0 / 8.0 * 13.0 / 8.0 - 1.0;
/// Natural neighbours have negative weights, and so has a tree of cells that is exact at the samples.
const TREE_BEYOND: f64 = 0.5;
/// Number of tested positions, in addition to the samples.
const QUERIES: usize = 600;
/// The most samples that are tested.
const AT_MOST_SAMPLES: usize = 500;

/// The error message of an interpolator that must refuse these positions.
fn refusal(choice: Interpolation, of: &Positions) -> Option<&'static str> {
    match choice {
        Interpolation::Bilinear | Interpolation::Bicubic => of.irregular,
        Interpolation::Polynomial { degree } => {
            let terms = (degree + 1) * (degree + 2) / 2;
            if (of.at)().len() < terms {
                Some("one per term")
            } else {
                let undetermined = of.undetermined_from.is_some_and(|from| degree >= from);
                undetermined.then_some("determine only")
            }
        }
        _ => None,
    }
}

struct Figures {
    constant: f64,
    linear: f64,
    at_samples: f64,
    beyond: f64,
    /// The limit of `beyond`.
    most_beyond: f64,
}

/// The larger of two values, or NaN if any is NaN.
fn worse(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}

/// Interpolates a constant, two linear functions and random values of -1 to 1.
fn figures(choice: Interpolation, at: &[(f64, f64)]) -> Result<Figures, PsfieldError> {
    let unit = unit_coordinates(at);
    let mut random_value = random(21);
    let values = Array2::from_shape_fn((at.len(), 4), |(j, k)| match k {
        0 => 1.0,
        1 => unit[j].0,
        2 => unit[j].1,
        _ => 2.0 * random_value() - 1.0,
    });
    let all: Result<Vec<Position>, _> = at.iter().map(|&(x, y)| Position::new(x, y)).collect();
    let positions = SamplePositions::new(all?, None)?;
    let most_beyond = match choice {
        Interpolation::Bicubic => CONSTANT + CUBIC_BEYOND,
        Interpolation::NaturalNeighbour | Interpolation::InverseDistance { .. } => CONSTANT + TREE_BEYOND,
        _ => CONSTANT,
    };
    let samples = SampleCoefficients::new(values.clone(), positions)?;
    let field = interpolation(choice)?.interpolate(&samples, OutsidePolicy::Nearest)?;
    let (mut found, mut wanted) = ([0.0; 4], [0.0; 3]);
    let mut figures = Figures {
        constant: 0.0,
        linear: 0.0,
        at_samples: 0.0,
        beyond: 0.0,
        most_beyond,
    };
    let mut evaluate = |x: f64, y: f64, figures: &mut Figures| -> Result<[f64; 4], PsfieldError> {
        field.evaluate_into(Position::new(x, y)?, &mut found)?;
        figures.constant = worse(figures.constant, (found[0] - 1.0).abs());
        figures.beyond = worse(figures.beyond, (found[3].abs() - 1.0).max(0.0) + 0.0 * found[3]);
        Ok(found)
    };
    let mut share = random(22);
    let mut any = |count: usize| ((share() * count as f64) as usize).min(count - 1);
    for _ in 0..QUERIES {
        // A position between three samples is inside their hull, where linear functions are known.
        let corners = [any(at.len()), any(at.len()), any(at.len())];
        let (a, b) = (any(1000) as f64 / 1000.0, any(1000) as f64 / 1000.0);
        let weights = [a * (1.0 - b), a * b, 1.0 - a];
        let mean =
            |of: &dyn Fn(usize) -> f64| corners.iter().zip(weights).map(|(&j, w)| w * of(j)).sum::<f64>();
        let (x, y) = (mean(&|j| at[j].0), mean(&|j| at[j].1));
        wanted[1] = mean(&|j| unit[j].0);
        wanted[2] = mean(&|j| unit[j].1);
        let inside = evaluate(x, y, &mut figures)?;
        for k in [1, 2] {
            figures.linear = worse(figures.linear, (inside[k] - wanted[k]).abs());
        }
        // Close to a sample, and far outside.
        let (x, y) = at[corners[0]];
        let step = 10_f64.powi(-(any(12) as i32));
        evaluate(x + step * (a - 0.5), y + step * (b - 0.5), &mut figures)?;
        evaluate(x + 1e3 * (a - 0.5), y + 1e3 * (b - 0.5), &mut figures)?;
    }
    let some = at.len().div_ceil(AT_MOST_SAMPLES);
    for j in (0..at.len()).step_by(some) {
        let found = evaluate(at[j].0, at[j].1, &mut figures)?;
        for (k, value) in found.iter().enumerate() {
            figures.at_samples = worse(figures.at_samples, (value - values[[j, k]]).abs());
        }
    }
    Ok(figures)
}

const NOT_LINEAR: &str = "inverse distances and the nearest sample do not follow slopes, by definition";
const SMOOTHS: &str = "a least squares polynomial does not meet its samples, by definition";
const REFUSED: &str = "there is no field";

/// The rounding of coordinates relative to the samples' extent, for the worse axis.
fn coordinate_rounding(at: &[(f64, f64)]) -> f64 {
    let of_axis = |axis: fn(&(f64, f64)) -> f64| {
        let (low, high) = at
            .iter()
            .map(axis)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
                (a.min(v), b.max(v))
            });
        // Without an extent the function is constant.
        if high > low {
            COORDINATES * low.abs().max(high.abs()) / (high - low)
        } else {
            0.0
        }
    };
    of_axis(|p| p.0).max(of_axis(|p| p.1))
}

fn field_cells(choice: Interpolation, of: &Positions) -> Vec<Cell> {
    let figures = figures(choice, &(of.at)());
    if let Some(words) = refusal(choice, of) {
        let mut cells = vec![Cell::refusal(figures.map(|_| 0.0), words)];
        cells.extend((0..3).map(|_| Cell::not_applicable(REFUSED)));
        return cells;
    }
    let figures = match figures {
        Ok(figures) => figures,
        Err(error) => {
            let mut cells = vec![Cell::error(Err(error), CONSTANT)];
            cells.extend((0..3).map(|_| Cell::not_applicable(REFUSED)));
            return cells;
        }
    };
    let polynomial = matches!(choice, Interpolation::Polynomial { .. });
    let constant = if polynomial { POLYNOMIAL } else { CONSTANT };
    let linear = match choice {
        Interpolation::InverseDistance { .. } | Interpolation::Nearest => Cell::not_applicable(NOT_LINEAR),
        _ => {
            let across = match choice {
                Interpolation::NaturalNeighbour => ACROSS_THE_HULL,
                _ => 0.0,
            };
            let limit = LINEAR + coordinate_rounding(&(of.at)()) + across;
            Cell::error(Ok(figures.linear), limit)
        }
    };
    let smooths = |figure: f64, limit: f64| {
        if polynomial {
            Cell::not_applicable(SMOOTHS)
        } else {
            Cell::error(Ok(figure), limit)
        }
    };
    vec![
        Cell::error(Ok(figures.constant), constant),
        linear,
        smooths(figures.at_samples, CONSTANT),
        smooths(figures.beyond, figures.most_beyond),
    ]
}

/// One row for each interpolator at each set of positions.
fn rows(cells: fn(Interpolation, &Positions) -> Vec<Cell>) -> Vec<Case> {
    let count = positions().len();
    INTERPOLATIONS
        .into_iter()
        .flat_map(|choice| {
            (0..count).map(move |number| {
                let name = format!("{choice}: {}", positions()[number].name);
                Case::new(name, move || cells(choice, &positions()[number]))
            })
        })
        .collect()
}

pub(super) fn section() -> Section {
    Section {
        title: "Interpolators",
        story: "Fields are always in f64. *Constant*: the error for a constant anywhere, also 1e3 pixels outside\n\
            the samples. *Linear*: the error for a linear function of 0 to 1 over the samples, within their\n\
            convex hull. Its limit includes the rounding of coordinates over the samples' extent. For natural\n\
            neighbours it includes the cells that cross the hull. *At samples*: the error for\n\
            random values of -1 to 1 at the samples. *Beyond*: the distance by which the field\n\
            leaves -1 to 1. Cubics (`bicubic`) have negative weights, whose bound is 13/8\n\
            in each coordinate, so 1.64 here. Natural neighbours have negative weights, too, and so have inverse\n\
            distances on a tree of cells that is exact at the samples.",
        columns: &["constant", "linear", "at samples", "beyond"],
        cases: rows(field_cells),
    }
}

/// Columns and rows of the frame.
const FRAME: (usize, usize) = (48, 40);
const METHODS: [Method; 4] = [Method::Basis, Method::Patch(1), Method::LowRank, Method::Auto];

fn image_cells(choice: Interpolation, of: &Positions) -> Vec<Cell> {
    PRECISIONS
        .map(|precision| {
            let light = Light::of(uneven_of(FRAME)).scaled(1.0, precision);
            let got = gaussians(&(of.at)(), 9)
                .and_then(|samples| fit(samples, &full(choice))?.into_model())
                .and_then(|model| {
                    METHODS.into_iter().try_fold(0.0, |worst, method| {
                        Ok(worse(worst, error(&model, &light, (method, precision))?))
                    })
                });
            match refusal(choice, of) {
                Some(words) => Cell::refusal(got, words),
                None => Cell::error(got, 10.0 * precision.rounding()),
            }
        })
        .to_vec()
}

pub(super) fn image_section() -> Section {
    Section {
        title: "Images through every interpolator",
        story: "The largest difference from the direct sum in f64, divided by its peak: the largest of `basis`,\n\
            `patch` with patches of one pixel, `lowrank` and `auto`, in both anchorings. The frame has 48 x 40\n\
            pixels and begins at the origin, the stamps have 9 x 9 pixels, and all K are used. The limit is ten\n\
            times that of scenes: the weights of an interpolator, which may be terms of a polynomial, add their\n\
            rounding.",
        columns: &["f64", "f32"],
        cases: rows(image_cells),
    }
}
