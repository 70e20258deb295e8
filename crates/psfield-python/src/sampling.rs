//! Samples a PSF that a Python function draws, or that of a telescope.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use ndarray::ArrayViewMut2;
use numpy::PyReadonlyArray2;
use psfield::psf_optics::Telescope;
use psfield::psf_sample::{
    SampleError, Sampling, SamplingMethod, SamplingOptions, SamplingOutcome, SamplingReport, UniformSampling,
    draw_states,
};
use psfield::psf_types::{
    FrameShape, Position, Progress, PsfSamples, PsfSource, SourceError, StampGrid, StateKind,
};
use psfield::{FitChoices, FitOptions, Psf, PsfieldError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};
use serde::Deserialize;

use crate::error::{Failure, invalid};
use crate::psf_model::PsfModel;
use crate::settings::{GridSettings, frame_shape, from_python};
use crate::threads::{self, Watch};

/// The settings of the sampling by name.
#[derive(Debug, Deserialize)]
struct SamplingSettings {
    method: Option<String>,
    criterion: Option<String>,
    measure: String,
    threshold: f64,
    /// (ny, nx) of the starting grid.
    start: Option<(usize, usize)>,
    max_draws: NonZeroUsize,
    accept_cap: bool,
    verify: Option<usize>,
    seed: u64,
    /// (ny, nx) of a regular grid that replaces refinement.
    uniform: Option<(usize, usize)>,
}

impl SamplingSettings {
    fn options(&self) -> PyResult<SamplingOptions> {
        let refinement = self.method.as_deref().map(str::parse).transpose();
        let criterion = self.criterion.as_deref().map(str::parse).transpose();
        Ok(SamplingOptions {
            refinement: refinement.map_err(Failure::from)?,
            criterion: criterion.map_err(Failure::from)?,
            measure: self.measure.parse().map_err(Failure::from)?,
            threshold: self.threshold,
            start: self.start.map(|(ny, nx)| (nx, ny)),
            max_draws: self.max_draws.get(),
            verify: self.verify,
            seed: self.seed,
            uniform: self.uniform.map(|(ny, nx)| (nx, ny)),
        })
    }
}

/// Samples the function `f(x, y)` over a field. Returns the model and a report of the sampling.
#[pyfunction]
pub(crate) fn sample_function<'py>(
    py: Python<'py>,
    function: Py<PyAny>,
    stamp_shape: (usize, usize),
    field: (usize, usize),
    grid: &Bound<'_, PyMapping>,
    sampling: &Bound<'_, PyMapping>,
    fit: &Bound<'_, PyMapping>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(PsfModel, Bound<'py, PyDict>)> {
    let grid = from_python::<GridSettings>(grid)?.grid(stamp_shape)?;
    let field = frame_shape(field)?;
    let sampling: SamplingSettings = from_python(sampling)?;
    let method = sampling.options()?.method().map_err(Failure::from)?;
    let options = from_python::<FitChoices>(fit)?.or(FitOptions::default());
    if let Some((ny, nx)) = sampling.uniform {
        psfield::stack_size::check_stack(nx.saturating_mul(ny), grid).map_err(Failure::from)?;
    }
    // The sampling has a pool of its own. The caller's function may itself call psfield, which then
    // uses the common pool. Threads that wait for the function must not occupy that pool.
    let pool = threads::made(threads::threads()?)?;
    let sampled = threads::run_beside(py, progress.as_ref(), &pool, |watch, pool| {
        let source = FunctionSource {
            function: &function,
            grid,
            field,
            watch,
            turn: Mutex::new(()),
        };
        pool.install(|| method.sample(&source, watch))
    })?;
    let Sampling { samples, report } = match sampled {
        Ok(sampling) => sampling,
        Err(SampleError::NotMet(found)) if sampling.accept_cap => found.into_sampling(),
        Err(SampleError::NotMet(found)) => {
            return Err(invalid(format!(
                "{found} (arguments max_draws, threshold and accept_cap)"
            )));
        }
        Err(error) => return Err(Failure::from(PsfieldError::from(error)).into()),
    };
    let found = report_of(py, &report, samples.len())?;
    Ok((PsfModel(Psf::new(samples, options)), found))
}

/// The values of a report, by their names in Python.
fn report_of<'py>(py: Python<'py>, report: &SamplingReport, samples: usize) -> PyResult<Bound<'py, PyDict>> {
    let place = |at: Position| (at.x(), at.y());
    let found = PyDict::new(py);
    found.set_item("method", report.refinement.map(|method| method.to_string()))?;
    found.set_item("samples", samples)?;
    found.set_item("draws", report.draws)?;
    found.set_item("cells", report.cells)?;
    found.set_item("unmet_cells", report.unmet_cells)?;
    found.set_item("worst", report.worst)?;
    found.set_item("worst_at", report.worst_at.map(place))?;
    found.set_item("expected", report.expected)?;
    found.set_item("threshold", report.threshold)?;
    let verification = match &report.verification {
        None => None,
        Some(random) => {
            let values = PyDict::new(py);
            values.set_item("tests", random.tests)?;
            values.set_item("above", random.above)?;
            values.set_item("fraction_limit", random.fraction_limit())?;
            values.set_item("worst", random.worst)?;
            values.set_item("worst_at", place(random.worst_at))?;
            values.set_item("draws", random.draws)?;
            Some(values)
        }
    };
    found.set_item("verification", verification)?;
    let outcome = match report.outcome {
        SamplingOutcome::Met => "met",
        SamplingOutcome::CellSizeReached => "cell-size-reached",
        _ => "cap-reached",
    };
    found.set_item("outcome", outcome)?;
    Ok(found)
}

/// The PSF of a telescope, by the names of the arguments.
#[derive(Debug, Deserialize)]
struct TelescopeSettings {
    /// The name of a built-in telescope, or the path of a TOML file.
    telescope: String,
    /// (ny, nx) of the frame.
    field: Option<(usize, usize)>,
    /// (ny, nx) of the grid of samples.
    samples: (usize, usize),
    /// Frame pixels.
    stamp_size: Option<NonZeroUsize>,
    oversampling: NonZeroUsize,
    wavelengths_um: Option<Vec<f64>>,
}

/// Samples the PSF of a telescope on a regular grid of positions.
#[pyfunction]
pub(crate) fn sample_telescope(
    py: Python<'_>,
    settings: &Bound<'_, PyMapping>,
    fit: &Bound<'_, PyMapping>,
) -> PyResult<PsfModel> {
    let settings: TelescopeSettings = from_python(settings)?;
    let options = from_python::<FitChoices>(fit)?.or(FitOptions::default());
    let name = &settings.telescope;
    if !Telescope::PRESETS.contains(&name.as_str()) && !Path::new(name).exists() {
        return Err(invalid(format!(
            "telescope must be the name of a built-in telescope ({}) or a TOML file, but there is no file {name}",
            Telescope::PRESETS.join(", ")
        )));
    }
    let drawn = threads::run_apart(py, move |watch| settings.draw(watch))?;
    Ok(PsfModel(Psf::new(drawn, options)))
}

impl TelescopeSettings {
    fn draw(&self, watch: &Watch) -> Result<PsfSamples, PsfieldError> {
        let described = match Telescope::preset(&self.telescope) {
            Some(preset) => preset,
            None => Telescope::from_toml_file(Path::new(&self.telescope))?,
        };
        let mut params = described.params().clone();
        if let Some((ny, nx)) = self.field {
            (params.frame.nx, params.frame.ny) = (nx, ny);
        }
        let frame_pixels = |stamp_pixels: usize| stamp_pixels.div_ceil(params.stamp.oversampling);
        let size = match self.stamp_size {
            Some(size) => (size.get(), size.get()),
            None => (frame_pixels(params.stamp.nx), frame_pixels(params.stamp.ny)),
        };
        let oversampling = self.oversampling.get();
        let pixels = |size: usize| size.saturating_mul(oversampling);
        (params.stamp.nx, params.stamp.ny) = (pixels(size.0), pixels(size.1));
        params.stamp.oversampling = oversampling;
        let telescope = Telescope::new(params)?;
        let (ny, nx) = self.samples;
        let method = UniformSampling::new(nx, ny)?;
        let states = self.wavelengths_um.as_ref().map_or(1, Vec::len);
        let count = nx.saturating_mul(ny).saturating_mul(states);
        psfield::stack_size::check_stack(count, telescope.grid())?;
        let Some(wavelengths_um) = &self.wavelengths_um else {
            return Ok(method.sample(&telescope, watch)?.samples);
        };
        let telescopes = wavelengths_um.iter().map(|&um| telescope.at_wavelength_um(um));
        let telescopes = telescopes.collect::<Result<Vec<_>, _>>()?;
        let sources: Vec<&dyn PsfSource> = telescopes.iter().map(|t| t as &dyn PsfSource).collect();
        let positions = method.positions(telescope.field())?;
        let states = (StateKind::Wavelength, &wavelengths_um[..]);
        Ok(draw_states(&sources, states, &positions, watch)?)
    }
}

/// A PSF that the Python function `f(x, y)` draws. The function returns the stamp `[y, x]` at a
/// position, in double precision. Two threads never call it at the same time.
struct FunctionSource<'a> {
    function: &'a Py<PyAny>,
    grid: StampGrid,
    field: FrameShape,
    watch: &'a Watch,
    /// Locked while the function runs. A thread takes this lock before it attaches to the
    /// interpreter. Otherwise a thread could hold the interpreter while it waits for the lock,
    /// which would be a deadlock.
    turn: Mutex<()>,
}

impl PsfSource for FunctionSource<'_> {
    fn grid(&self) -> StampGrid {
        self.grid
    }

    fn field(&self) -> FrameShape {
        self.field
    }

    fn draw_into(&self, position: Position, mut stamp: ArrayViewMut2<'_, f64>) -> Result<(), SourceError> {
        let failed =
            |source: Box<dyn std::error::Error + Send + Sync>| SourceError::External { position, source };
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        if self.watch.cancelled() {
            return Err(failed("sampling was cancelled".into()));
        }
        Python::attach(|py| {
            let drawn = self
                .function
                .call1(py, (position.x(), position.y()))
                .map_err(|e| failed(e.into()))?;
            let drawn: PyReadonlyArray2<'_, f64> = drawn.extract(py).map_err(|e: PyErr| failed(e.into()))?;
            let values = drawn.as_array();
            if values.dim() != stamp.dim() {
                let (got, expected) = (values.dim(), stamp.dim());
                return Err(failed(
                    format!("the function returned a stamp of shape {got:?} here, but {expected:?} in the middle of the field").into(),
                ));
            }
            stamp.assign(&values);
            Ok(())
        })
    }
}
