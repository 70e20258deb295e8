//! Samples and models with a known PSF.

use ndarray::{Array2, Array3};
use psfield::fit::fit;
use psfield::psf_basis::{Centring, RankSelection};
use psfield::psf_types::{
    Interpolation, Normalisation, Position, PsfModel, PsfSamples, SamplePositions, StampGrid,
};
use psfield::{FitOptions, PsfieldError};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Columns and rows of the frame that most cases share.
pub(crate) const FRAME: (usize, usize) = (96, 80);
/// The side of the patches in which the PSF of [`jumping`] is constant.
pub(crate) const PATCH: usize = 16;
/// The side of most stamps.
pub(crate) const SIDE: usize = 15;

/// Options with all modes and an interpolator. The other options keep their defaults.
pub(crate) fn full(interpolation: Interpolation) -> FitOptions {
    FitOptions {
        rank: RankSelection::Full,
        interpolation,
        ..FitOptions::default()
    }
}

/// Like [`full`], but without a mean stamp and without scaling: the stamps stay unchanged.
pub(crate) fn as_they_are(interpolation: Interpolation) -> FitOptions {
    FitOptions {
        centring: Centring::None,
        normalisation: Normalisation::Keep,
        ..full(interpolation)
    }
}

/// An elliptical Gaussian of unit sum. Its width depends on `u` and its shape on `v`, both 0 to 1
/// over the field.
pub(crate) fn gaussian((ny, nx): (usize, usize), u: f64, v: f64) -> Array2<f64> {
    let sigma = 1.1 + 0.9 * u;
    let (a, b) = (sigma * (1.0 + 0.3 * v), sigma);
    let stamp = Array2::from_shape_fn((ny, nx), |(y, x)| {
        let (dx, dy) = (x as f64 - (nx / 2) as f64, y as f64 - (ny / 2) as f64);
        let (along, across) = (0.8 * dx + 0.6 * dy, 0.8 * dy - 0.6 * dx);
        (-0.5 * ((along / a).powi(2) + (across / b).powi(2))).exp()
    });
    let sum = stamp.sum();
    stamp / sum
}

/// Samples at positions. The stamp is a function of the sample's number.
pub(crate) fn samples(
    at: &[(f64, f64)],
    (ny, nx): (usize, usize),
    stamp: impl Fn(usize) -> Array2<f64>,
) -> Result<PsfSamples, PsfieldError> {
    let positions: Result<Vec<Position>, _> = at.iter().map(|&(x, y)| Position::new(x, y)).collect();
    let mut stamps = Array3::zeros((at.len(), ny, nx));
    for (j, mut into) in stamps.outer_iter_mut().enumerate() {
        into.assign(&stamp(j));
    }
    let positions = SamplePositions::new(positions?, None)?;
    Ok(PsfSamples::new(stamps, positions, StampGrid::new(nx, ny)?)?)
}

/// Gaussians at positions. Their shape depends on the place in the samples' bounding box.
pub(crate) fn gaussians(at: &[(f64, f64)], side: usize) -> Result<PsfSamples, PsfieldError> {
    let unit = unit_coordinates(at);
    samples(at, (side, side), |j| gaussian((side, side), unit[j].0, unit[j].1))
}

/// Positions scaled to 0 to 1 over their bounding box.
pub(crate) fn unit_coordinates(at: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let range = |values: &dyn Fn(&(f64, f64)) -> f64| {
        let all = at.iter().map(values);
        all.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
            (a.min(v), b.max(v))
        })
    };
    let (x, y) = (range(&|p| p.0), range(&|p| p.1));
    let scaled = |v: f64, (a, b): (f64, f64)| if b > a { (v - a) / (b - a) } else { 0.5 };
    at.iter().map(|p| (scaled(p.0, x), scaled(p.1, y))).collect()
}

/// A lattice over a rectangle that starts at the origin, row by row.
pub(crate) fn lattice((columns, rows): (usize, usize), (width, height): (f64, f64)) -> Vec<(f64, f64)> {
    let at = |k: usize, n: usize, length: f64| {
        if n == 1 {
            0.0
        } else {
            length * k as f64 / (n - 1) as f64
        }
    };
    (0..columns * rows)
        .map(|k| (at(k % columns, columns, width), at(k / columns, rows, height)))
        .collect()
}

/// A PSF that changes smoothly over [`FRAME`].
pub(crate) fn smooth() -> Result<PsfModel, PsfieldError> {
    let at = lattice((5, 5), ((FRAME.0 - 1) as f64, (FRAME.1 - 1) as f64));
    fit(gaussians(&at, SIDE)?, &full(Interpolation::Bilinear))?.into_model()
}

/// A PSF that is constant in squares of [`PATCH`] pixels and jumps between them. Patches of that
/// size make its image exactly.
pub(crate) fn jumping() -> Result<PsfModel, PsfieldError> {
    let (columns, rows) = (FRAME.0 / PATCH, FRAME.1 / PATCH);
    let middle = |k: usize| (k * PATCH) as f64 + (PATCH as f64 - 1.0) / 2.0;
    let at: Vec<(f64, f64)> = (0..columns * rows)
        .map(|k| (middle(k % columns), middle(k / columns)))
        .collect();
    let jumps = |j: usize| {
        gaussian(
            (SIDE, SIDE),
            (j * 7 % 11) as f64 / 10.0,
            (j * 5 % 13) as f64 / 12.0,
        )
    };
    let options = full(Interpolation::Nearest);
    fit(samples(&at, (SIDE, SIDE), jumps)?, &options)?.into_model()
}

/// Random numbers from 0 to 1, from a seed.
pub(crate) fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    move || rng.random_range(0.0..1.0)
}
