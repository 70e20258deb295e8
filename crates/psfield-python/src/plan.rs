//! Plans.

use std::sync::Arc;

use ndarray::Array2;
use numpy::{Element, IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadwriteArray2};
use psfield::conv_core::{ConvReal, PlanOptions};
use psfield::psf_types::PixelRegion;
use psfield::{Device, DeviceOptions, Method, SimulationOptions};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::choices::{frame_shape, parsed, region};
use crate::error::{Failure, invalid};
use crate::interruptible;
use crate::planned::Planned;
use crate::psf_model::PsfModel;
use crate::settings::Settings;
use crate::sources::{SourceColumns, Sources};
use crate::threads::pool;

/// How scenes of one shape are simulated.
#[pyclass(frozen, module = "psfield._native")]
pub(crate) struct Plan(AnyPlan);

enum AnyPlan {
    Single(Arc<Planned<f32>>),
    Double(Arc<Planned<f64>>),
}

/// Runs one body in either precision.
macro_rules! in_precision {
    ($plan:expr, $planned:ident => $body:expr) => {
        match &$plan.0 {
            AnyPlan::Single($planned) => $body,
            AnyPlan::Double($planned) => $body,
        }
    };
}

/// What lies on a GPU cannot be used by a child of the process that put it there.
fn check_process<T: ConvReal>(planned: &Planned<T>) -> PyResult<()> {
    if planned.is_on_foreign_gpu() {
        return Err(PyOSError::new_err(
            "this plan lies on a GPU that the parent of this process opened: make the plan in the forked process, or start processes with spawn",
        ));
    }
    Ok(())
}

/// The arguments of a plan by name.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct PlanWords {
    /// (ny, nx) of the scene.
    shape: (usize, usize),
    /// (x0, y0, nx, ny) in pixels of the image.
    frame: Option<(i64, i64, usize, usize)>,
    /// (x0, y0, nx, ny) in pixels of the frame.
    region: Option<(i64, i64, usize, usize)>,
    tolerance: f64,
    precision: String,
    anchor: String,
    method: String,
    memory: usize,
    oversample: usize,
    stamp_size: Option<usize>,
    device: String,
    gpu_adapter: Option<String>,
    gpu_memory: Option<u64>,
}

impl PlanWords {
    fn settings(&self) -> PyResult<Settings> {
        let method: Method = parsed(&self.method)?;
        let anchor = parsed(&self.anchor)?;
        let plan = PlanOptions::new(self.tolerance)
            .map_err(Failure::from)?
            .with_anchor(anchor)
            .with_memory(self.memory);
        if method.plan_options(plan).is_none() {
            return Err(invalid(format!("method must be auto or lowrank, got {method}")));
        }
        if self.stamp_size == Some(0) {
            return Err(invalid("stamp_size must be at least 1"));
        }
        let simulation = SimulationOptions::default()
            .with_stamp_size(self.stamp_size)
            .with_anchor(anchor)
            .with_oversample(self.oversample)
            .map_err(Failure::from)?;
        let adapter = self.gpu_adapter.clone();
        let device = match self.device.as_str() {
            "auto" => Device::Auto { adapter },
            "cpu" => Device::Cpu,
            "gpu" => Device::Gpu { adapter },
            other => return Err(invalid(format!("device must be auto, cpu or gpu, got {other}"))),
        };
        Ok(Settings {
            shape: frame_shape(self.shape)?,
            frame: self.frame.map(region).transpose()?,
            region: self.region.map(region).transpose()?,
            method,
            simulation,
            plan,
            device: DeviceOptions::new(device).with_gpu_memory(self.gpu_memory),
        })
    }
}

/// An image, or none where it went to an array of the caller's, and what should be known of it, in plain sentences.
type Simulated<'py> = (Option<Bound<'py, PyAny>>, Vec<String>);

#[pymethods]
impl Plan {
    /// Plans for scenes of one shape.
    #[new]
    fn new(py: Python<'_>, model: &PsfModel, words: PlanWords) -> PyResult<Self> {
        let settings = words.settings()?;
        let made = match words.precision.as_str() {
            "f32" => planned(py, model, settings).map(|plan| AnyPlan::Single(Arc::new(plan))),
            "f64" => planned(py, model, settings).map(|plan| AnyPlan::Double(Arc::new(plan))),
            other => Err(invalid(format!("precision must be f32 or f64, got {other}"))),
        };
        made.map(Self)
    }

    /// The same for another region of the frame.
    fn for_region(&self, py: Python<'_>, at: (i64, i64, usize, usize)) -> PyResult<Self> {
        let at = region(at)?;
        let made = match &self.0 {
            AnyPlan::Single(planned) => {
                of_region(py, planned, at).map(|plan| AnyPlan::Single(Arc::new(plan)))
            }
            AnyPlan::Double(planned) => {
                of_region(py, planned, at).map(|plan| AnyPlan::Double(Arc::new(plan)))
            }
        };
        made.map(Self)
    }

    /// (x0, y0, nx, ny) of the part of the scene that reaches the image.
    fn light_region(&self) -> (i64, i64, usize, usize) {
        let light = in_precision!(self, planned => planned.light_region());
        (light.x0(), light.y0(), light.shape().nx(), light.shape().ny())
    }

    /// (ny, nx) of the image.
    fn frame_shape(&self) -> (usize, usize) {
        let shape = in_precision!(self, planned => planned.frame_shape());
        (shape.ny(), shape.nx())
    }

    /// The plan in figures.
    fn summary<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (summary, settings, placement) = in_precision!(self, planned => (
            planned.summary().ok_or_else(|| invalid("the plan has no figures"))?,
            planned.settings(),
            planned.placement(),
        ));
        let figures = PyDict::new(py);
        figures.set_item("text", summary.to_string())?;
        figures.set_item("shape", (settings.shape.ny(), settings.shape.nx()))?;
        figures.set_item("frame_shape", self.frame_shape())?;
        figures.set_item("precision", summary.precision)?;
        figures.set_item("tolerance", summary.tolerance)?;
        figures.set_item("anchor", summary.anchor.to_string())?;
        figures.set_item("method", settings.method.to_string())?;
        figures.set_item("device", placement.to_string())?;
        figures.set_item("gpu", placement.adapter())?;
        figures.set_item("tile_shape", (summary.tile.1, summary.tile.0))?;
        figures.set_item("transform_shape", (summary.transform.1, summary.transform.0))?;
        figures.set_item("tiles", summary.tiles)?;
        figures.set_item("blocks", summary.blocks)?;
        figures.set_item("mean_modes", summary.mean_modes())?;
        figures.set_item("most_modes", summary.most_modes())?;
        figures.set_item("predicted_seconds", summary.predicted_seconds)?;
        figures.set_item("kept_bytes", summary.kept_bytes.0 + summary.kept_bytes.1)?;
        Ok(figures)
    }

    /// The image of a scene and sources.
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        scene: Option<Bound<'py, PyAny>>,
        sources: Option<SourceColumns<'py>>,
        out: Option<Bound<'py, PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Simulated<'py>> {
        in_precision!(self, planned => simulate(py, planned, scene, sources, out, progress))
    }

    /// What each pixel of the scene gives to the scalar product of its image with this one.
    fn adjoint<'py>(
        &self,
        py: Python<'py>,
        image: Bound<'py, PyAny>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        in_precision!(self, planned => adjoint(py, planned, image, progress))
    }

    /// The figures of a check against the direct sum, as JSON.
    fn spot_check<'py>(
        &self,
        py: Python<'py>,
        image: Bound<'py, PyAny>,
        scene: Option<Bound<'py, PyAny>>,
        sources: Option<SourceColumns<'py>>,
        count: usize,
        seed: u64,
    ) -> PyResult<String> {
        in_precision!(self, planned => spot_check(py, planned, image, scene, sources, (count, seed)))
    }
}

fn planned<T: ConvReal>(py: Python<'_>, model: &PsfModel, settings: Settings) -> PyResult<Planned<T>> {
    let psf = model.psf();
    let made = interruptible::run_apart(py, move |watch, pool| Planned::new(psf, settings, watch, pool))?;
    Ok(made?)
}

fn of_region<T: ConvReal>(
    py: Python<'_>,
    planned: &Arc<Planned<T>>,
    region: PixelRegion,
) -> PyResult<Planned<T>> {
    let planned = Arc::clone(planned);
    let made = interruptible::run_apart(py, move |watch, pool| planned.for_region(region, watch, pool))?;
    Ok(made?)
}

/// A NumPy array of the plan's precision; Python has seen to its type.
fn readonly<'py, T: Element>(array: &Bound<'py, PyAny>, name: &str) -> PyResult<PyReadonlyArray2<'py, T>> {
    let array = array.cast::<PyArray2<T>>()?;
    array.try_readonly().map_err(|_| {
        invalid(format!(
            "{name}: another call writes its image to this array: wait for it"
        ))
    })
}

/// The same for an array that is written to.
fn writable<'py, T: Element>(array: &Bound<'py, PyAny>) -> PyResult<PyReadwriteArray2<'py, T>> {
    let array = array.cast::<PyArray2<T>>()?;
    array
        .try_readwrite()
        .map_err(|_| invalid("out: another call reads or writes this array: give each call one of its own"))
}

fn sources_of(columns: Option<SourceColumns<'_>>) -> PyResult<Sources> {
    columns.map_or_else(|| Ok(Sources::default()), |columns| columns.sources())
}

fn simulate<'py, T: ConvReal + Element>(
    py: Python<'py>,
    planned: &Planned<T>,
    scene: Option<Bound<'py, PyAny>>,
    sources: Option<SourceColumns<'py>>,
    out: Option<Bound<'py, PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Simulated<'py>> {
    check_process(planned)?;
    let scene = scene
        .as_ref()
        .map(|scene| readonly::<T>(scene, "scene"))
        .transpose()?;
    let mut out = out.as_ref().map(writable::<T>).transpose()?;
    let sources = sources_of(sources)?;
    let (light, target) = (
        scene.as_ref().map(|s| s.as_array()),
        out.as_mut().map(|o| o.as_array_mut()),
    );
    let made = interruptible::run_beside(py, progress.as_ref(), &*pool()?, |watch, pool| {
        planned.simulate(light, sources, target, watch, pool)
    })?;
    let (image, warnings) = made?;
    let image = image.map(|image| image.into_pyarray(py).into_any());
    Ok((image, warnings.iter().map(ToString::to_string).collect()))
}

fn adjoint<'py, T: ConvReal + Element>(
    py: Python<'py>,
    planned: &Planned<T>,
    image: Bound<'py, PyAny>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    check_process(planned)?;
    let image = readonly::<T>(&image, "image")?;
    let pixels = image.as_array();
    let made = interruptible::run(py, progress.as_ref(), |watch| planned.adjoint(pixels, watch))?;
    let scene: Array2<T> = made?;
    Ok(scene.into_pyarray(py).into_any())
}

fn spot_check<'py, T: ConvReal + Element>(
    py: Python<'py>,
    planned: &Planned<T>,
    image: Bound<'py, PyAny>,
    scene: Option<Bound<'py, PyAny>>,
    sources: Option<SourceColumns<'py>>,
    pixels: (usize, u64),
) -> PyResult<String> {
    let (image, scene) = (
        readonly::<T>(&image, "image")?,
        scene
            .as_ref()
            .map(|scene| readonly::<T>(scene, "scene"))
            .transpose()?,
    );
    let sources = sources_of(sources)?;
    let (image, light) = (image.as_array(), scene.as_ref().map(|s| s.as_array()));
    let check = interruptible::run_beside(py, None, &*pool()?, |watch, pool| {
        planned.spot_check(light, sources, image, pixels, watch, pool)
    })?;
    let check = check?;
    Ok(serde_json::to_string(&check).expect("figures are plain numbers"))
}
