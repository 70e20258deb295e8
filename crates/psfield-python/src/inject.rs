//! Injection of sources into real frames.

use std::path::PathBuf;

use psfield::inject::{InjectOptions, RealFrame as Frame};
use psfield::psf_io::HduChoice;
use psfield::{PsfieldError, SimulateOptions};
use pyo3::prelude::*;

use crate::catalog::Sources;
use crate::error::{Failure, invalid};
use crate::psf_model::PsfModel;
use crate::settings::parsed;
use crate::threads::{self, pool};

/// A real frame.
#[pyclass(frozen, module = "psfield._native")]
pub(crate) struct RealFrame(Frame);

/// The arguments of `psfield.inject`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct InjectSettings {
    gain: Option<f64>,
    saturation: Option<f64>,
    seed: u64,
    tolerance: f64,
    truth_table: Option<PathBuf>,
    overwrite: bool,
}

#[pymethods]
impl RealFrame {
    #[new]
    fn new(path: PathBuf, extension: Option<&str>) -> PyResult<Self> {
        let extension = extension.map(parsed::<HduChoice>).transpose()?;
        Ok(Self(Frame::open(path, extension).map_err(Failure::from)?))
    }

    /// The unit of the frame, if it is known.
    fn unit(&self) -> Option<String> {
        self.0.header().pixel_unit()
    }

    /// The cards of the header, 80 characters each.
    fn cards(&self) -> String {
        self.0.header().to_text()
    }

    /// Writes the frame with sources in it. Without a model, the PSF is that of the frame's stars. Returns the
    /// report as JSON, and warnings.
    fn inject(
        &self,
        py: Python<'_>,
        model: Option<PyRef<'_, PsfModel>>,
        sources: PyRef<'_, Sources>,
        output: PathBuf,
        settings: InjectSettings,
    ) -> PyResult<(String, Vec<String>)> {
        let frame = &self.0;
        let options = InjectOptions {
            gain: settings.gain,
            saturation: settings.saturation,
            seed: settings.seed,
            truth_table: settings.truth_table,
            overwrite: settings.overwrite,
        };
        frame.gain(options.gain).map_err(Failure::from)?;
        let psf = model.map(|model| model.0.clone());
        let catalog = &sources.catalog;
        let report = threads::run_beside(py, None, &*pool()?, |watch, pool| {
            pool.install(|| -> Result<_, PsfieldError> {
                let psf = match psf {
                    Some(psf) => psf,
                    None => frame.psf_of_stars(&options)?,
                };
                let simulation = SimulateOptions {
                    tolerance: settings.tolerance,
                    ..SimulateOptions::default()
                };
                let light = frame.light_of(&psf, catalog, simulation, watch)?;
                let texts: Vec<String> = light.warnings().iter().map(ToString::to_string).collect();
                Ok((frame.inject(&light, &output, &options)?, texts))
            })
        })?;
        let (report, warnings) = report.map_err(Failure::from)?;
        let report = serde_json::to_string(&report).map_err(|e| invalid(e.to_string()))?;
        Ok((report, warnings))
    }
}
