//! A model and the scene that a benchmark convolves with it, and functions that make both.

use coeff_field::{FieldInterpolation, Nearest};
use ndarray::{Array2, Axis};
use psf_types::{
    DataError, FrameShape, Image, Interpolation, Normalisation, OutsidePolicy, Position, PsfBasis, PsfModel,
    PsfModelRecord, Real, SampleCoefficients, SamplePositions,
};
use psfield::PsfieldError;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A model and the scene that every contender convolves with it.
#[derive(Debug, Clone)]
pub struct BenchCase<T> {
    /// The model.
    pub record: PsfModelRecord,
    /// The scene.
    pub scene: Image<T>,
}

impl<T> BenchCase<T> {
    /// Combines a model and a scene. [`run`](crate::bench::run()) needs stamps that are sampled at
    /// the centres of the scene's pixels and include the pixel response.
    pub fn new(record: PsfModelRecord, scene: Image<T>) -> Self {
        Self { record, scene }
    }
}

/// A scene in which every pixel has light: exponential noise of mean 1 on a smooth background
/// between 1 and 3.
///
/// No part of the scene is empty or sparse, so that no method gains by skipping pixels. Equal seeds
/// give equal scenes.
///
/// # Errors
/// No error occurs. [`Image::new`] returns a [`DataError`] for an image that is empty or too large,
/// and for values that are not finite. A [`FrameShape`] excludes both, and all values are finite.
pub fn lit_scene<T: Real>(shape: FrameShape, seed: u64) -> Result<Image<T>, DataError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let wave = |i: usize, n: usize| (WAVE * i as f64 / n as f64).sin();
    let across: Vec<f64> = (0..shape.nx()).map(|x| wave(x, shape.nx())).collect();
    let mut pixels = Array2::zeros((shape.ny(), shape.nx()));
    for (y, mut row) in pixels.outer_iter_mut().enumerate() {
        let up = wave(y, shape.ny());
        for (pixel, across) in row.iter_mut().zip(&across) {
            let noise = -(1.0 - rng.random_range(0.0..1.0f64)).ln();
            *pixel = T::nearest(2.0 + across * up + noise);
        }
    }
    Image::new(pixels)
}

/// Range of the phase of the background's wave over the frame, in radians.
const WAVE: f64 = 7.0;

/// Stretches the positions of a model's samples to a frame. Along each axis, the outermost
/// positions become pixel 0 and the last pixel. If all samples have equal coordinates along an
/// axis, they move to the middle of this axis. The PSF of the stretched model varies over a frame
/// of any size as over the whole field.
///
/// # Errors
/// [`DataError`] if two samples at different positions move to one position.
pub fn stretched(record: &PsfModelRecord, frame: FrameShape) -> Result<PsfModelRecord, DataError> {
    let [x, y] = Position::bounds(record.coefficients().positions().as_slice());
    let (x, y) = (stretch(x, frame.nx()), stretch(y, frame.ny()));
    placed(record, frame, |p| [x(p.x()), y(p.y())])
}

/// Moves the samples of a model to other positions on a frame.
pub(super) fn placed(
    record: &PsfModelRecord,
    frame: FrameShape,
    place: impl Fn(Position) -> [f64; 2],
) -> Result<PsfModelRecord, DataError> {
    let positions = record.coefficients().positions().as_slice().iter();
    let positions = positions.map(|&p| {
        let [x, y] = place(p);
        Position::new(x, y)
    });
    let states = record.coefficients().positions().states().cloned();
    let positions = positions.collect::<Result<_, _>>()?;
    let positions = SamplePositions::with_states(positions, Some(frame), states)?;
    let values = record.coefficients().values().to_owned();
    record.with_parts(
        record.basis().clone(),
        SampleCoefficients::new(values, positions)?,
    )
}

/// Returns a model with another interpolator of the coefficients.
pub(crate) fn interpolated_by(
    record: &PsfModelRecord,
    interpolation: Interpolation,
) -> Result<PsfModelRecord, DataError> {
    let (basis, coefficients) = (record.basis().clone(), record.coefficients().clone());
    let (outside, normalisation) = (record.outside(), record.normalisation());
    PsfModelRecord::new(basis, coefficients, interpolation, outside, normalisation)
}

/// Returns a random position on the frame.
pub(crate) fn random_position(frame: FrameShape, rng: &mut ChaCha8Rng) -> Result<Position, PsfieldError> {
    let mut along = |pixels: usize| rng.random::<f64>() * (pixels - 1) as f64;
    Ok(Position::new(along(frame.nx()), along(frame.ny()))?)
}

/// Maps the extent of the samples along an axis to the extent of the frame.
fn stretch((low, high): (f64, f64), pixels: usize) -> impl Fn(f64) -> f64 {
    let last = (pixels - 1) as f64;
    move |coordinate| {
        if high > low {
            // Rounding must not move the last sample off the frame.
            ((coordinate - low) / (high - low) * last).min(last)
        } else {
            last / 2.0
        }
    }
}

/// A model that has the PSF of one position everywhere.
///
/// # Errors
/// [`ErrorKind::Field`](psfield::ErrorKind::Field) if the model has no PSF at the position,
/// [`ErrorKind::Data`](psfield::ErrorKind::Data) if this PSF is zero at all pixels.
pub(super) fn constant(model: &PsfModel, position: Position) -> Result<PsfModel, PsfieldError> {
    let psf = model.psf_at(position)?;
    let norm = psf.values().iter().map(|v| v * v).sum::<f64>().sqrt();
    let stamp = psf.values().mapv(|v| v / norm).insert_axis(Axis(0));
    let basis = PsfBasis::new(None, stamp, model.whole_grid())?;
    let at = SamplePositions::new(vec![position], model.field_shape())?;
    let coefficient = SampleCoefficients::new(Array2::from_elem((1, 1), norm), at)?;
    let field = Nearest.interpolate(&coefficient, OutsidePolicy::Nearest)?;
    let shape = model.field_shape();
    // `Keep`, because `psf_at` has already scaled the stamp if the model's PSFs have unit flux.
    Ok(PsfModel::new(&basis, field, Normalisation::Keep, shape)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;
    use psf_types::{PsfSamples, StampGrid};
    use psfield::FitOptions;
    use psfield::fit::{fit, model_of};

    #[test]
    fn every_pixel_is_lit_and_the_seed_decides() {
        let shape = FrameShape::new(40, 30).unwrap();
        let pixels = |seed| lit_scene::<f32>(shape, seed).unwrap().into_pixels();
        assert!(pixels(1).iter().all(|&v| v >= 1.0));
        assert_eq!(pixels(1), pixels(1));
        assert_ne!(pixels(1), pixels(2));
        // The mean is 1 for the noise and about 2 for the background. 1200 pixels measure it to a
        // few percent.
        assert!((pixels(3).mean().unwrap() - 3.0).abs() < 0.3);
    }

    /// Four Gaussians that widen with x and with y, on a field of 21 x 11 pixels.
    fn record() -> PsfModelRecord {
        let corners = [(2, 1), (18, 1), (2, 9), (18, 9)].map(|(x, y)| Position::of_pixel(x, y));
        let stamps = Array3::from_shape_fn((4, 9, 9), |(j, y, x)| {
            (-((y as f64 - 4.0).powi(2) + (x as f64 - 4.0).powi(2)) / (2.0 + j as f64)).exp()
        });
        let positions = SamplePositions::new(corners.to_vec(), FrameShape::new(21, 11).ok()).unwrap();
        let samples = PsfSamples::new(stamps, positions, StampGrid::new(9, 9).unwrap()).unwrap();
        fit(samples, &FitOptions::default()).unwrap().record().clone()
    }

    #[test]
    fn stretching_moves_positions_and_nothing_else() {
        let record = record();
        let frame = FrameShape::new(101, 51).unwrap();
        let wide = stretched(&record, frame).unwrap();
        let corners: Vec<(f64, f64)> = wide
            .coefficients()
            .positions()
            .as_slice()
            .iter()
            .map(|p| (p.x(), p.y()))
            .collect();
        assert_eq!(corners, [(0.0, 0.0), (100.0, 0.0), (0.0, 50.0), (100.0, 50.0)]);
        assert_eq!(wide.coefficients().positions().field(), Some(frame));
        let psf = |record: PsfModelRecord, x: f64, y: f64| {
            let model = model_of(record).unwrap();
            model.psf_at(Position::new(x, y).unwrap()).unwrap().into_values()
        };
        let difference = psf(record, 6.0, 3.0) - psf(wide, 25.0, 12.5);
        assert!(difference.iter().all(|d| d.abs() < 1e-15));
    }

    #[test]
    fn the_constant_model_has_the_psf_of_its_position() {
        let model = model_of(record()).unwrap();
        let position = Position::new(10.0, 5.0).unwrap();
        let constant = constant(&model, position).unwrap();
        let psf = model.psf_at(position).unwrap();
        for (x, y) in [(0, 0), (20, 10), (10, 5)] {
            let there = constant.psf_at(Position::of_pixel(x, y)).unwrap();
            let difference = &there.values() - &psf.values();
            assert!(difference.iter().all(|d| d.abs() < 1e-15));
        }
    }
}
