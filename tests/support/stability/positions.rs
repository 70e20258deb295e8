//! Extreme positions of samples.

use super::models::{lattice, random};

/// Samples at positions that are difficult in one respect.
pub(crate) struct Positions {
    pub(crate) name: &'static str,
    pub(crate) at: fn() -> Vec<(f64, f64)>,
    /// The bilinear interpolator's error message if the samples do not fill a regular grid.
    pub(crate) irregular: Option<&'static str>,
    /// The lowest polynomial degree that these positions cannot determine, however many they are.
    pub(crate) undetermined_from: Option<usize>,
}

/// The extent of most sets of positions, equal to that of the frame.
const EXTENT: (f64, f64) = (47.0, 39.0);
/// The distance of samples in a cluster.
const CLOSE: f64 = 1e-9;
/// A large distance, from the origin or between samples.
const FAR: f64 = 1e7;

fn scattered(count: usize, (x, y): (f64, f64), (width, height): (f64, f64), seed: u64) -> Vec<(f64, f64)> {
    let mut at = random(seed);
    (0..count)
        .map(|_| (x + width * at(), y + height * at()))
        .collect()
}

/// The corners, and four clusters of four samples.
fn clusters() -> Vec<(f64, f64)> {
    let mut all = lattice((2, 2), EXTENT);
    for (x, y) in [(10.0, 11.0), (30.0, 9.5), (13.3, 28.0), (36.0, 31.7)] {
        all.extend(
            [(0.0, 0.0), (CLOSE, 0.0), (0.0, CLOSE), (1.3 * CLOSE, 0.9 * CLOSE)].map(|(a, b)| (x + a, y + b)),
        );
    }
    all
}

/// Two rows of samples, 1e-6 apart.
fn slivers() -> Vec<(f64, f64)> {
    let mut all: Vec<(f64, f64)> = (0..12).map(|k| (f64::from(k) * 4.2, 20.0)).collect();
    all.extend((0..11).map(|k| (2.1 + f64::from(k) * 4.2, 20.0 + 1e-6)));
    all
}

/// Scattered samples, and some that lie 1e-7 inside the edges of their hull. The triangles between
/// them are almost flat.
fn slivers_at_edges() -> Vec<(f64, f64)> {
    let mut all = scattered(60, (1.0, 1.0), (45.0, 37.0), 15);
    all.extend(lattice((2, 2), EXTENT));
    all.extend((1..6).flat_map(|k| {
        let along = f64::from(k) / 6.0;
        [(EXTENT.0 * along, 1e-7), (EXTENT.0 - 1e-7, EXTENT.1 * along)]
    }));
    all
}

/// Samples on an ellipse. Scaled to the bounding box they form a circle, for which every
/// triangulation is equally good.
fn circle() -> Vec<(f64, f64)> {
    let turn = std::f64::consts::TAU / 24.0;
    (0..24)
        .map(|k| (f64::from(k) * turn).sin_cos())
        .map(|(s, c)| (23.0 + 20.0 * c, 19.0 + 18.0 * s))
        .collect()
}

pub(crate) fn positions() -> Vec<Positions> {
    let positions = |name, at| Positions {
        name,
        at,
        irregular: Some("do not form a regular grid"),
        undetermined_from: None,
    };
    let regular = |of: Positions| Positions {
        irregular: None,
        ..of
    };
    let undetermined = |degree, of: Positions| Positions {
        undetermined_from: Some(degree),
        ..of
    };
    vec![
        undetermined(1, regular(positions("one sample", || vec![(20.0, 17.0)]))),
        positions("3 samples", || vec![(2.0, 3.0), (45.0, 8.0), (20.0, 36.0)]),
        undetermined(
            1,
            regular(positions("9 samples in a row", || lattice((9, 1), EXTENT))),
        ),
        undetermined(
            1,
            positions("9 samples on a slanted line", || {
                (0..9)
                    .map(|k| (f64::from(k) * 5.1, 3.0 + f64::from(k) * 3.7))
                    .collect()
            }),
        ),
        Positions {
            irregular: Some("too close to each other"),
            ..positions("four clusters of samples 1e-9 apart", clusters)
        },
        undetermined(2, positions("slivers: two rows 1e-6 apart", slivers)),
        positions("slivers: a corner's angle of 1e-8", slivers_at_edges),
        positions("24 samples on an ellipse", circle),
        undetermined(
            8,
            regular(positions("8 x 8 samples on a grid", || lattice((8, 8), EXTENT))),
        ),
        regular(positions("9 x 9 samples on a grid", || lattice((9, 9), EXTENT))),
        positions("60 scattered samples", || scattered(60, (0.0, 0.0), EXTENT, 11)),
        positions("20 000 scattered samples", || {
            scattered(20_000, (-100.0, -100.0), (300.0, 300.0), 12)
        }),
        regular(positions("9 x 9 samples over 1e7 pixels", || {
            lattice((9, 9), (FAR, FAR))
        })),
        positions("60 scattered samples over 1e7 pixels", || {
            scattered(60, (0.0, 0.0), (FAR, FAR), 13)
        }),
        regular(positions("9 x 9 samples 1e7 pixels away", || {
            lattice((9, 9), EXTENT)
                .into_iter()
                .map(|(x, y)| (x + FAR, y + FAR))
                .collect()
        })),
        positions("60 scattered samples 1e7 pixels away", || {
            scattered(60, (FAR, FAR), EXTENT, 14)
        }),
    ]
}
