//! Plans.

use std::sync::{Arc, Mutex};

use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView2, ArrayViewMut2, Axis};
use numpy::{Element, IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadwriteArray2};
use psfield::conv_core::ConvReal;
use psfield::psf_types::{Image, ImageView, NoProgress};
use psfield::{Method, Preparation, PsfieldError, Scene, SimulateOptions, SimulationWarning, Simulator};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::ThreadPool;

use crate::catalog::{SourceColumns, Sources};
use crate::error::{Failure, invalid};
use crate::psf_model::PsfModel;
use crate::threads::{self, Watch, pool};
use crate::words::{parsed, region};

/// How scenes of one shape are simulated.
#[pyclass(frozen, module = "psfield._native")]
pub(crate) struct Plan {
    simulator: AnySimulator,
    /// Held by a thread beside the pool that makes what a new kind of scene needs. Plans for other regions share it as they
    /// share the plan for stars.
    making: Arc<Mutex<()>>,
    /// The process that made it.
    process: u32,
}

enum AnySimulator {
    Single(Arc<Simulator<f32>>),
    Double(Arc<Simulator<f64>>),
}

/// Runs one body in either precision.
macro_rules! in_precision {
    ($plan:expr, $simulator:ident => $body:expr) => {
        match &$plan.simulator {
            AnySimulator::Single($simulator) => $body,
            AnySimulator::Double($simulator) => $body,
        }
    };
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
    fn options(&self) -> PyResult<SimulateOptions> {
        let method: Method = parsed(&self.method)?;
        if !method.has_plan() {
            return Err(invalid(format!("method must be auto or lowrank, got {method}")));
        }
        Ok(SimulateOptions {
            method,
            tolerance: self.tolerance,
            anchor: parsed(&self.anchor)?,
            memory: self.memory,
            oversample: self.oversample,
            stamp_size: self.stamp_size,
            frame: self.frame.map(region).transpose()?,
            region: self.region.map(region).transpose()?,
            device: parsed(&self.device)?,
            gpu_adapter: self.gpu_adapter.clone(),
            gpu_memory: self.gpu_memory,
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
        let builder = model.0.simulator(words.shape).options(words.options()?);
        let simulator = match words.precision.as_str() {
            "f32" => AnySimulator::Single(planned(py, move |_| builder.build())?),
            "f64" => AnySimulator::Double(planned(py, move |_| builder.build())?),
            other => return Err(invalid(format!("precision must be f32 or f64, got {other}"))),
        };
        Ok(Self {
            simulator,
            making: Arc::default(),
            process: std::process::id(),
        })
    }

    /// The same for another region of the frame.
    fn for_region(&self, py: Python<'_>, at: (i64, i64, usize, usize)) -> PyResult<Self> {
        let at = region(at)?;
        let simulator = match &self.simulator {
            AnySimulator::Single(of) => {
                let of = Arc::clone(of);
                AnySimulator::Single(planned(py, move |watch| of.for_region(at, watch))?)
            }
            AnySimulator::Double(of) => {
                let of = Arc::clone(of);
                AnySimulator::Double(planned(py, move |watch| of.for_region(at, watch))?)
            }
        };
        Ok(Self {
            simulator,
            making: Arc::clone(&self.making),
            process: std::process::id(),
        })
    }

    /// (x0, y0, nx, ny) of the part of the scene that reaches the image.
    fn light_region(&self) -> PyResult<(i64, i64, usize, usize)> {
        let light =
            in_precision!(self, simulator => simulator.light_region(&NoProgress)).map_err(Failure::from)?;
        Ok((light.x0(), light.y0(), light.shape().nx(), light.shape().ny()))
    }

    /// (ny, nx) of the image.
    fn frame_shape(&self) -> (usize, usize) {
        let shape = in_precision!(self, simulator => simulator.image_shape());
        (shape.ny(), shape.nx())
    }

    /// The plan in figures.
    fn summary<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let made = self.preparation()?;
        let (shape, method) =
            in_precision!(self, simulator => (simulator.scene_shape(), simulator.options().method));
        let summary = made.plan.ok_or_else(|| invalid("the plan has no figures"))?;
        let figures = PyDict::new(py);
        figures.set_item("text", summary.to_string())?;
        figures.set_item("shape", (shape.ny(), shape.nx()))?;
        figures.set_item("frame_shape", self.frame_shape())?;
        figures.set_item("precision", summary.precision)?;
        figures.set_item("tolerance", summary.tolerance)?;
        figures.set_item("anchor", summary.anchor.to_string())?;
        figures.set_item("method", method.to_string())?;
        figures.set_item("device", made.placement.to_string())?;
        figures.set_item("gpu", made.placement.adapter())?;
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
        self.check_process()?;
        let sources = sources_of(sources)?;
        in_precision!(self, simulator => {
            let scene = scene.as_ref().map(|scene| readonly(scene, "scene")).transpose()?;
            let mut out = out.as_ref().map(writable).transpose()?;
            let light = scene.as_ref().map(|scene| scene.as_array());
            let target = out.as_mut().map(|out| out.as_array_mut());
            let made = threads::run_beside(py, progress.as_ref(), &*pool()?, |watch, pool| {
                let scene = self.ready(simulator, light, sources, watch, pool)?;
                pool.install(|| simulated(simulator, &scene, target, watch))
            })?;
            let (image, warnings) = made?;
            let image = image.map(|image| image.into_pyarray(py).into_any());
            Ok((image, warnings.iter().map(text_of).collect()))
        })
    }

    /// What each pixel of the scene gives to the scalar product of its image with this one.
    fn adjoint<'py>(
        &self,
        py: Python<'py>,
        image: Bound<'py, PyAny>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.check_process()?;
        in_precision!(self, simulator => {
            let image = readonly(&image, "image")?;
            let pixels = image.as_array();
            let made = threads::run(py, progress.as_ref(), |watch| -> Result<_, Failure> {
                let image = ImageView::new(pixels).map_err(Failure::of("image"))?;
                Ok(simulator.adjoint(&image, watch)?)
            })?;
            Ok(made?.into_pixels().into_pyarray(py).into_any())
        })
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
        let sources = sources_of(sources)?;
        let check = in_precision!(self, simulator => {
            let image = readonly(&image, "image")?;
            let scene = scene.as_ref().map(|scene| readonly(scene, "scene")).transpose()?;
            let (pixels, light) = (image.as_array(), scene.as_ref().map(|scene| scene.as_array()));
            threads::run_beside(py, None, &*pool()?, |watch, pool| {
                let scene = self.ready(simulator, light, sources, watch, pool)?;
                pool.install(|| -> Result<_, Failure> {
                    let image = Image::new(pixels.to_owned())?;
                    Ok(simulator.spot_check(&scene, &image, (count, seed), watch)?)
                })
            })?
        });
        Ok(serde_json::to_string(&check?).expect("figures are plain numbers"))
    }
}

impl Plan {
    /// A scene for which everything is made. Of threads that need the same, one makes it and the others wait, for as long as
    /// they want it.
    fn ready<'a, T: ConvReal>(
        &self,
        simulator: &Simulator<T>,
        light: Option<ArrayView2<'a, T>>,
        sources: Sources,
        watch: &Watch,
        pool: &ThreadPool,
    ) -> Result<Scene<'a, T>, Failure> {
        let scene = match light {
            Some(light) => pool
                .install(|| ImageView::new(light))
                .map_err(Failure::of("scene"))?
                .into(),
            None => Scene::dark(),
        };
        let scene = scene.with_stars(sources.stars).with_galaxies(sources.galaxies);
        if !simulator.is_prepared(&scene, false) {
            let _making = threads::turn(&self.making, watch)?;
            pool.install(|| simulator.prepare(&scene, false, watch))?;
        }
        Ok(scene)
    }

    /// What lies on a GPU cannot be used by a child of the process that put it there.
    fn check_process(&self) -> PyResult<()> {
        if self.process == std::process::id() || self.preparation()?.placement.adapter().is_none() {
            return Ok(());
        }
        Err(PyOSError::new_err(
            "this plan lies on a GPU that the parent of this process opened: make the plan in the forked process, or start processes with spawn",
        ))
    }

    /// What was made for images.
    fn preparation(&self) -> PyResult<Preparation<'_>> {
        let made = in_precision!(self, simulator => simulator.prepare(&Scene::dark(), true, &NoProgress));
        Ok(made.map_err(Failure::from)?)
    }
}

/// The image of a scene for which everything is made, none where it went to an array of the caller's, and what should be known
/// of it.
fn simulated<T: ConvReal>(
    simulator: &Simulator<T>,
    scene: &Scene<'_, T>,
    out: Option<ArrayViewMut2<'_, T>>,
    watch: &Watch,
) -> Result<(Option<Array2<T>>, Vec<SimulationWarning>), Failure> {
    let mut made = None;
    let mut image = match out {
        Some(mut out) => {
            let rows = out.axis_iter_mut(Axis(0)).into_par_iter();
            rows.for_each(|mut row| row.fill(T::zero()));
            out
        }
        None => made.insert(simulator.zeros()).view_mut(),
    };
    simulator.simulate_into(scene, image.view_mut(), watch)?;
    // As the library checks its own results.
    ImageView::new(image.view())?;
    Ok((made, simulator.warnings(scene)))
}

/// A simulator that has its plan for images.
fn planned<T: ConvReal>(
    py: Python<'_>,
    make: impl FnOnce(&Watch) -> Result<Simulator<T>, PsfieldError> + Send + 'static,
) -> PyResult<Arc<Simulator<T>>> {
    let made = threads::run_apart(py, move |watch, pool| {
        pool.install(|| -> Result<_, Failure> {
            let simulator = make(watch)?;
            simulator.prepare(&Scene::dark(), true, watch)?;
            Ok(Arc::new(simulator))
        })
    })?;
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

/// A warning whose remedy is an option, with the option as Python writes it.
fn text_of(warning: &SimulationWarning) -> String {
    warning.to_string().replace("--oversample 4", "oversample=4")
}
