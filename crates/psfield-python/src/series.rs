//! Series of exposures.

use std::sync::Mutex;

use numpy::{Element, IntoPyArray, PyArray1};
use psfield::conv_core::ConvReal;
use psfield::series::{Exposures, LightCurves, Pointing, PointingPath, SeriesFrames, SourceInExposure};
use psfield::{Psf, SimulateOptions, SimulationWarning};
use pyo3::prelude::*;
use pyo3::types::PyMapping;

use crate::arrays::Borrowed;
use crate::catalog::Sources;
use crate::colour::{Colour, ColourArguments, light_of_scene};
use crate::error::{Failure, with_argument};
use crate::plan::options;
use crate::psf_model::PsfModel;
use crate::threads::{self, pool};

/// The times of the exposures, the motion of the pointing, and the changes of the fluxes.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Changes {
    starts_s: Vec<f64>,
    exposure_s: f64,
    drift_px_per_s: [f64; 2],
    jitter_px: f64,
    /// Times, and shifts along x and along y.
    path: Option<Rows>,
    /// Rows of the catalogue, times and factors.
    light_curves: Option<Rows>,
}

/// Three columns.
type Rows = (Vec<f64>, Vec<f64>, Vec<f64>);

impl Changes {
    fn series(self) -> Result<psfield::series::Series, Failure> {
        let path = self
            .path
            .map(|(times, dx, dy)| PointingPath::new(times, &dx, &dy));
        let (rows, times, factors) = self.light_curves.unwrap_or_default();
        Ok(psfield::series::Series {
            exposures: Exposures::new(self.starts_s, self.exposure_s)?,
            pointing: Pointing {
                drift_px_per_s: self.drift_px_per_s,
                jitter_px: self.jitter_px,
                path: path.transpose().map_err(Failure::of("path"))?,
            },
            light_curves: LightCurves::new(&rows, &times, &factors).map_err(Failure::of("light_curves"))?,
        })
    }
}

/// A series of exposures.
#[pyclass(frozen, module = "psfield._native")]
pub(crate) struct Series(AnyFrames);

/// The thread that makes an exposure holds the lock.
enum AnyFrames {
    Single(Mutex<SeriesFrames<f32>>),
    Double(Mutex<SeriesFrames<f64>>),
}

/// An exposure: its image, the mean shift along x and y, the columns row, x, y and flux of the sources as they
/// are in it, and warnings.
type Exposure<'py> = (
    Bound<'py, PyAny>,
    [f64; 2],
    [Bound<'py, PyArray1<f64>>; 4],
    Vec<String>,
);

#[pymethods]
impl Series {
    #[new]
    fn new(
        py: Python<'_>,
        model: &PsfModel,
        shape: (usize, usize),
        precision: &str,
        settings: &Bound<'_, PyMapping>,
        colour: Option<ColourArguments>,
        images: Vec<(Option<String>, Bound<'_, PyAny>)>,
        sources: Option<PyRef<'_, Sources>>,
        changes: Changes,
    ) -> PyResult<Self> {
        let colour = colour.map(Colour::new).transpose()?;
        let none = Sources::default();
        let sources = sources.as_deref().unwrap_or(&none);
        let of = (model.0.clone(), shape, options(settings)?, changes.series()?);
        Ok(Self(if precision == "f64" {
            AnyFrames::Double(frames(py, of, colour, &images, sources)?)
        } else {
            AnyFrames::Single(frames(py, of, colour, &images, sources)?)
        }))
    }

    /// Simulates an exposure.
    fn exposure<'py>(
        &self,
        py: Python<'py>,
        number: usize,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Exposure<'py>> {
        match &self.0 {
            AnyFrames::Single(frames) => exposed(py, frames, number, progress.as_ref()),
            AnyFrames::Double(frames) => exposed(py, frames, number, progress.as_ref()),
        }
    }
}

fn exposed<'py, T: ConvReal + Element>(
    py: Python<'py>,
    frames: &Mutex<SeriesFrames<T>>,
    number: usize,
    progress: Option<&Py<PyAny>>,
) -> PyResult<Exposure<'py>> {
    let made = threads::run_beside(py, progress, &*pool()?, |watch, pool| -> Result<_, Failure> {
        let mut locked = threads::turn(frames, watch)?;
        let frames = &mut *locked;
        pool.install(|| {
            let exposure = frames.exposure(number, watch)?;
            let (simulator, scene) = (&exposure.simulator, &exposure.scene);
            let mut image = simulator.zeros();
            simulator.simulate_into(scene, image.view_mut(), watch)?;
            Ok((
                image,
                exposure.shift_px,
                exposure.sources,
                simulator.warnings(scene, None),
            ))
        })
    })?;
    let (image, shift_px, sources, warnings) = made?;
    let column =
        |value: fn(&SourceInExposure) -> f64| sources.iter().map(value).collect::<Vec<_>>().into_pyarray(py);
    let columns = [
        column(|source| source.row as f64),
        column(|source| source.x),
        column(|source| source.y),
        column(|source| source.flux),
    ];
    let text = |warning: &SimulationWarning| with_argument(warning.to_string(), warning.setting());
    let warnings = warnings.iter().map(text).collect();
    Ok((image.into_pyarray(py).into_any(), shift_px, columns, warnings))
}

/// The settings of a simulation of exposures: the PSF, the shape of scenes, options, and what changes.
type Of = (Psf, (usize, usize), SimulateOptions, psfield::series::Series);

fn frames<T: ConvReal + Element>(
    py: Python<'_>,
    (psf, shape, options, series): Of,
    colour: Option<Colour>,
    images: &[(Option<String>, Bound<'_, PyAny>)],
    sources: &Sources,
) -> PyResult<Mutex<SeriesFrames<T>>> {
    let light = light_of_scene(colour.as_ref(), Borrowed::new(images)?.views(), sources)?;
    let made = threads::run_apart(py, move |_| {
        let psf = match colour {
            Some(colour) => colour.psf_of(&psf, &light)?,
            None => psf,
        };
        SeriesFrames::new(&psf, shape, options, series, light)
    });
    made.map(Mutex::new)
}
