//! Wings of a power law with spikes, which vary over the field.

use std::f64::consts::{FRAC_PI_2, TAU};

use ndarray::{Array2, Array3, Axis};
use psf_types::{FrameShape, PsfModelRecord, SampleCoefficients, WingsRecord};
use psfield::PsfieldError;

/// The side of the wings' stamps, in pixels.
const STAMP: usize = 1023;
/// The part of the flux that the first stamp holds.
const FLUX: f64 = 0.05;
/// The light falls with this power of the distance, beyond some pixels.
const SLOPE: f64 = 2.5;
const FLAT_PX: f64 = 16.0;
/// The brightness of the spikes relative to the light between them, and their width in pixels.
const SPIKE: (f64, f64) = (4.0, 2.0);

/// Adds wings of this number of stamps to a model. The first stamp is the mean over the field. The others, which are
/// fainter, turn the spikes and shift the light, each with a coefficient of its own over the field.
pub(super) fn with_wings(
    record: PsfModelRecord,
    frame: FrameShape,
    count: usize,
) -> Result<PsfModelRecord, PsfieldError> {
    if count == 0 {
        return Ok(record);
    }
    let centre = (STAMP / 2) as f64;
    let mut stamps = Array3::from_shape_fn((count, STAMP, STAMP), |(k, y, x)| {
        let (u, v) = (x as f64 - centre, y as f64 - centre);
        let (radius, angle) = (u.hypot(v), v.atan2(u));
        let smooth = (1.0 + (radius / FLAT_PX).powi(2)).powf(-SLOPE / 2.0);
        // The distance from the nearest of four spikes.
        let turned = (angle + TAU / 8.0).rem_euclid(FRAC_PI_2) - TAU / 8.0;
        let spike = SPIKE.0 * (-(radius * turned.sin() / SPIKE.1).powi(2) / 2.0).exp();
        match k {
            0 => smooth * (1.0 + spike),
            1 => smooth * spike * (radius * turned.sin() / SPIKE.1).tanh(),
            k => 0.3 * smooth * (angle * (k - 1) as f64).cos(),
        }
    });
    let sum: f64 = stamps.index_axis(Axis(0), 0).sum();
    stamps.mapv_inplace(|v| v * FLUX / sum);
    let positions = record.coefficients().positions().clone();
    let along = |at: f64, pixels: usize| at / pixels as f64 - 0.5;
    let values = Array2::from_shape_fn((positions.len(), count), |(sample, k)| {
        let at = positions.as_slice()[sample];
        let (x, y) = (along(at.x(), frame.nx()), along(at.y(), frame.ny()));
        [1.0, x, y, x * y][k]
    });
    let wings = WingsRecord::new(
        stamps.mapv(|v| v as f32),
        SampleCoefficients::new(values, positions)?,
        record.basis().grid().about_centre(STAMP / 2)?,
    )?;
    Ok(record.with_wings(Some(wings))?)
}
