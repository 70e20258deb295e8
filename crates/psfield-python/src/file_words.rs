//! What a PSF file does not say of itself, from Python.

use psfield::PsfFileOptions;
use psfield::psf_io::{HduChoice, PlaneOrder};
use psfield::psf_types::Position;
use pyo3::prelude::*;

use crate::choices::{parsed, positions};
use crate::error::Failure;

/// The options of [`PsfFileOptions`] by name.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct FileWords {
    extension: Option<String>,
    detector: Option<usize>,
    plane_order: Option<String>,
    wavelength_um: Option<f64>,
    pixel_scale_arcsec: Option<f64>,
    field_centre: Option<(f64, f64)>,
    positions: Option<(Vec<f64>, Vec<f64>)>,
    oversampling: Option<f64>,
    centre: Option<(f64, f64)>,
    pixel_response_included: Option<bool>,
}

impl FileWords {
    pub(crate) fn options(self) -> PyResult<PsfFileOptions> {
        let position = |at: Option<(f64, f64)>| at.map(|(x, y)| Position::new(x, y)).transpose();
        Ok(PsfFileOptions {
            extension: self.extension.as_deref().map(parsed::<HduChoice>).transpose()?,
            detector: self.detector,
            plane_order: self
                .plane_order
                .as_deref()
                .map(parsed::<PlaneOrder>)
                .transpose()?,
            wavelength_um: self.wavelength_um,
            pixel_scale_arcsec: self.pixel_scale_arcsec,
            field_centre: position(self.field_centre).map_err(Failure::from)?,
            positions: self.positions.map(|(x, y)| positions(&x, &y)).transpose()?,
            oversampling: self.oversampling,
            centre: position(self.centre).map_err(Failure::from)?,
            pixel_response_included: self.pixel_response_included,
        })
    }
}
