//! Python arguments by name, and their defaults.

use std::str::FromStr;

use psfield::fit::OwnInterpolation;
use psfield::psf_basis::PixelNoise;
use psfield::psf_sample::SamplingOptions;
use psfield::psf_types::{FrameShape, PixelRegion, Position, Real, StampGrid};
use psfield::{FitChoices, FitOptions, PsfFileOptions, PsfieldError, SimulateOptions};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::{Failure, invalid};

/// Parses a choice from its name.
pub(crate) fn parsed<C>(text: &str) -> PyResult<C>
where
    C: FromStr,
    C::Err: Into<PsfieldError>,
{
    Ok(text.parse().map_err(Failure::from)?)
}

fn chosen<C>(text: Option<&str>) -> PyResult<Option<C>>
where
    C: FromStr,
    C::Err: Into<PsfieldError>,
{
    text.map(parsed).transpose()
}

/// The settings of the fit that the caller gave.
#[derive(Debug, Default, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct FitSettings {
    rank: Option<String>,
    centring: Option<String>,
    noise: Option<f64>,
    interpolation: Option<String>,
    outside: Option<String>,
    normalise: Option<String>,
    shift_copies: Option<usize>,
}

impl FitSettings {
    pub(crate) fn choices(&self) -> PyResult<FitChoices> {
        let bad = |sigma: f64| !(sigma >= 0.0 && sigma.is_finite());
        if self.noise.is_some_and(bad) {
            return Err(invalid("noise (sigma) must be finite and 0 or more"));
        }
        Ok(FitChoices {
            rank: chosen(self.rank.as_deref())?,
            centring: chosen(self.centring.as_deref())?,
            noise: self.noise.map(PixelNoise::Known),
            interpolation: chosen(self.interpolation.as_deref())?,
            outside: chosen(self.outside.as_deref())?,
            normalisation: chosen(self.normalise.as_deref())?,
            shift_copies: self.shift_copies,
        })
    }
}

/// The geometry of stamps: the relation between their pixels and the frame's pixels.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct GridSettings {
    oversampling: f64,
    /// (x, y).
    centre: Option<(f64, f64)>,
    pixel_response_included: bool,
    stamp_interpolation: String,
}

impl GridSettings {
    /// The grid for stamps of `(ny, nx)` pixels.
    pub(crate) fn grid(&self, (ny, nx): (usize, usize)) -> PyResult<StampGrid> {
        let made = || {
            let grid = StampGrid::new(nx, ny)?.with_oversampling(self.oversampling)?;
            match self.centre {
                Some((x, y)) => grid.with_centre(x, y),
                None => Ok(grid),
            }
        };
        Ok(made()
            .map_err(Failure::from)?
            .with_pixel_response_included(self.pixel_response_included)
            .with_interpolation(parsed(&self.stamp_interpolation)?))
    }
}

/// The fields of [`PsfFileOptions`] by name.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct FileSettings {
    extension: Option<String>,
    contexts: Vec<(String, f64)>,
    detector: Option<usize>,
    plane_order: Option<String>,
    skip_invalid: bool,
    wavelength_um: Option<f64>,
    time_s: Option<f64>,
    frame_number: Option<f64>,
    pixel_scale_arcsec: Option<f64>,
    field_centre: Option<(f64, f64)>,
    positions: Option<(Vec<f64>, Vec<f64>)>,
    oversampling: Option<f64>,
    centre: Option<(f64, f64)>,
    pixel_response_included: Option<bool>,
}

impl FileSettings {
    pub(crate) fn options(self) -> PyResult<PsfFileOptions> {
        let position = |at: Option<(f64, f64)>| at.map(|(x, y)| Position::new(x, y)).transpose();
        Ok(PsfFileOptions {
            extension: chosen(self.extension.as_deref())?,
            contexts: self.contexts,
            detector: self.detector,
            plane_order: chosen(self.plane_order.as_deref())?,
            skip_invalid: self.skip_invalid,
            wavelength_um: self.wavelength_um,
            time_s: self.time_s,
            frame_number: self.frame_number,
            pixel_scale_arcsec: self.pixel_scale_arcsec,
            field_centre: position(self.field_centre).map_err(Failure::from)?,
            positions: self.positions.map(|(x, y)| positions(&x, &y)).transpose()?,
            oversampling: self.oversampling,
            centre: position(self.centre).map_err(Failure::from)?,
            pixel_response_included: self.pixel_response_included,
        })
    }
}

/// Makes a shape from `(ny, nx)`, the order of NumPy.
pub(crate) fn frame_shape((ny, nx): (usize, usize)) -> PyResult<FrameShape> {
    Ok(FrameShape::new(nx, ny).map_err(Failure::from)?)
}

/// Makes a region from `(x0, y0, nx, ny)`.
pub(crate) fn region((x0, y0, nx, ny): (i64, i64, usize, usize)) -> PyResult<PixelRegion> {
    Ok(PixelRegion::new(x0, y0, frame_shape((ny, nx))?))
}

/// Makes positions from columns x and y of the same length.
pub(crate) fn positions(x: &[f64], y: &[f64]) -> PyResult<Vec<Position>> {
    if x.len() != y.len() {
        return Err(invalid(format!(
            "x and y must have the same length, got {} and {}",
            x.len(),
            y.len()
        )));
    }
    let made: Result<_, _> = x.iter().zip(y).map(|(&x, &y)| Position::new(x, y)).collect();
    Ok(made.map_err(Failure::from)?)
}

/// The defaults of the library, by the names of the Python arguments.
pub(crate) fn defaults(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    let (simulation, fit) = (SimulateOptions::default(), FitOptions::default());
    let sampling = SamplingOptions::default();
    let grid = StampGrid::new(1, 1).map_err(Failure::from)?;
    let values = PyDict::new(py);
    values.set_item("tolerance", simulation.tolerance)?;
    values.set_item("tolerance_on", simulation.tolerance_on.to_string())?;
    values.set_item("precision", f32::NAME)?;
    values.set_item("device", simulation.device.to_string())?;
    values.set_item("anchor", simulation.anchor.to_string())?;
    values.set_item("method", simulation.method.to_string())?;
    values.set_item("memory", simulation.memory)?;
    values.set_item("oversample", simulation.oversample)?;
    values.set_item("scene_pixels", simulation.scene_pixels.to_string())?;
    values.set_item("interpolation", fit.interpolation.to_string())?;
    values.set_item("table_error", OwnInterpolation::TABLE_ERROR)?;
    values.set_item("outside", fit.outside.to_string())?;
    values.set_item("normalise", fit.normalisation.to_string())?;
    values.set_item("oversampling", grid.oversampling())?;
    values.set_item("pixel_response_included", grid.pixel_response_included())?;
    values.set_item("stamp_interpolation", grid.interpolation().to_string())?;
    values.set_item("measure", sampling.measure.to_string())?;
    values.set_item("threshold", sampling.threshold)?;
    values.set_item("max_draws", sampling.max_draws)?;
    values.set_item("seed", sampling.seed)?;
    Ok(values)
}
