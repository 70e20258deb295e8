//! Choices as Python writes them: the words of the command line.

use std::str::FromStr;

use psfield::psf_basis::PixelNoise;
use psfield::psf_types::{FrameShape, PixelRegion, Position, StampGrid};
use psfield::{FitChoices, PsfieldError};
use pyo3::prelude::*;

use crate::error::{Failure, invalid};

/// A choice by its name.
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

/// How samples become a model, as far as it is chosen.
#[derive(Debug, Default, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct FitWords {
    rank: Option<String>,
    centring: Option<String>,
    noise: Option<f64>,
    interpolation: Option<String>,
    outside: Option<String>,
    normalise: Option<String>,
}

impl FitWords {
    pub(crate) fn choices(&self) -> PyResult<FitChoices> {
        if self
            .noise
            .is_some_and(|sigma| !(sigma >= 0.0 && sigma.is_finite()))
        {
            return Err(invalid("noise must be a standard deviation, 0 or more"));
        }
        Ok(FitChoices {
            rank: chosen(self.rank.as_deref())?,
            centring: chosen(self.centring.as_deref())?,
            noise: self.noise.map(PixelNoise::Known),
            interpolation: chosen(self.interpolation.as_deref())?,
            outside: chosen(self.outside.as_deref())?,
            normalisation: chosen(self.normalise.as_deref())?,
        })
    }
}

/// What stamps are, beside their values.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct GridWords {
    oversampling: f64,
    /// (x, y).
    centre: Option<(f64, f64)>,
    pixel_response_included: bool,
    stamp_interpolation: String,
}

impl GridWords {
    /// The grid of stamps of `(ny, nx)` pixels.
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

/// A shape `(ny, nx)`, as NumPy has it.
pub(crate) fn frame_shape((ny, nx): (usize, usize)) -> PyResult<FrameShape> {
    Ok(FrameShape::new(nx, ny).map_err(Failure::from)?)
}

/// A region from `(x0, y0, nx, ny)`.
pub(crate) fn region((x0, y0, nx, ny): (i64, i64, usize, usize)) -> PyResult<PixelRegion> {
    Ok(PixelRegion::new(x0, y0, frame_shape((ny, nx))?))
}

/// Positions from their coordinates, of which there must be as many.
pub(crate) fn positions(x: &[f64], y: &[f64]) -> PyResult<Vec<Position>> {
    if x.len() != y.len() {
        return Err(invalid(format!("there are {} x and {} y", x.len(), y.len())));
    }
    let made: Result<_, _> = x.iter().zip(y).map(|(&x, &y)| Position::new(x, y)).collect();
    Ok(made.map_err(Failure::from)?)
}
