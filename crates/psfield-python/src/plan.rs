//! Plans: simulators for scenes of one shape.

use std::sync::{Arc, Mutex};

use ndarray::parallel::prelude::*;
use ndarray::{Array, Array2, Array3, ArrayView2, ArrayViewMut2, ArrayViewMut3, Axis, Dimension, Ix2, Ix3};
use numpy::{Element, IntoPyArray, PyArray, PyArrayMethods, PyReadonlyArray, PyReadwriteArray};
use psfield::conv_core::{ConvReal, zeros};
use psfield::psf_types::{Image, ImageView, NoProgress, PixelRegion};
use psfield::{Method, Preparation, PsfieldError, Scene, SimulateOptions, SimulationWarning, Simulator};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::ThreadPool;

use crate::catalog::Sources;
use crate::error::{Failure, invalid, with_argument};
use crate::memory;
use crate::psf_model::PsfModel;
use crate::settings::{parsed, region};
use crate::threads::{self, Watch, pool};

/// A simulator for scenes of one shape, with its plan.
#[pyclass(frozen, module = "psfield._native")]
pub(crate) struct Plan {
    simulator: AnySimulator,
    /// Locked while a thread outside the pool prepares the simulator for a new kind of scene (with
    /// or without stars or galaxies). Plans for other regions use the same lock, because they share
    /// the plans for stars and galaxies.
    making: Arc<Mutex<()>>,
    /// The process that made this plan.
    process: u32,
}

enum AnySimulator {
    Single(Arc<Simulator<f32>>),
    Double(Arc<Simulator<f64>>),
}

/// Runs one body of code in single or double precision.
macro_rules! in_precision {
    ($plan:expr, $simulator:ident => $body:expr) => {
        match &$plan.simulator {
            AnySimulator::Single($simulator) => $body,
            AnySimulator::Double($simulator) => $body,
        }
    };
}

/// Makes a simulator from that of a plan, in the same precision.
macro_rules! another {
    ($plan:expr, $py:expr, |$of:ident, $watch:ident| $make:expr) => {
        match &$plan.simulator {
            AnySimulator::Single($of) => {
                let $of = Arc::clone($of);
                AnySimulator::Single(planned($py, move |$watch| $make)?)
            }
            AnySimulator::Double($of) => {
                let $of = Arc::clone($of);
                AnySimulator::Double(planned($py, move |$watch| $make)?)
            }
        }
    };
}

/// The arguments of a plan by name.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct PlanSettings {
    /// (ny, nx) of the scene.
    shape: (usize, usize),
    /// (x0, y0, nx, ny) in pixels of the image, counted from the scene's first pixel.
    frame: Option<(i64, i64, usize, usize)>,
    /// (x0, y0, nx, ny) in pixels of the image, counted from the frame's first pixel.
    region: Option<(i64, i64, usize, usize)>,
    tolerance: f64,
    tolerance_on: String,
    precision: String,
    anchor: String,
    method: String,
    memory: Option<usize>,
    oversample: usize,
    scene_pixels: String,
    stamp_size: Option<usize>,
    device: String,
    gpu_adapter: Option<String>,
    gpu_memory: Option<u64>,
}

impl PlanSettings {
    fn options(&self) -> PyResult<SimulateOptions> {
        let method: Method = parsed(&self.method)?;
        if !method.has_plan() {
            return Err(invalid(format!("method must be auto or lowrank, got {method}")));
        }
        Ok(SimulateOptions {
            method,
            tolerance: self.tolerance,
            tolerance_on: parsed(&self.tolerance_on)?,
            anchor: parsed(&self.anchor)?,
            memory: self.memory,
            oversample: self.oversample,
            scene_pixels: parsed(&self.scene_pixels)?,
            stamp_size: self.stamp_size,
            frame: self.frame.map(region).transpose()?,
            region: self.region.map(region).transpose()?,
            device: parsed(&self.device)?,
            gpu_adapter: self.gpu_adapter.clone(),
            gpu_memory: self.gpu_memory,
        })
    }
}

/// The image, or `None` if it was written to an array of the caller, and warnings in sentences.
type Simulated<'py> = (Option<Bound<'py, PyAny>>, Vec<String>);

/// (x0, y0, nx, ny, modes) of a block.
type BlockRow = (i64, i64, usize, usize, usize);

#[pymethods]
impl Plan {
    /// Makes a plan for scenes of one shape.
    #[new]
    fn new(py: Python<'_>, model: &PsfModel, settings: PlanSettings) -> PyResult<Self> {
        let (ny, nx) = settings.shape;
        let pixels = ny.saturating_mul(nx);
        if pixels > Simulator::<f32>::MAX_PIXELS {
            let most = Simulator::<f32>::MAX_PIXELS;
            return Err(invalid(format!(
                "shape: {ny} x {nx} pixels are too many: at most 2^30 = {most}"
            )));
        }
        let builder = model.0.simulator(settings.shape).options(settings.options()?);
        let simulator = match settings.precision.as_str() {
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

    /// Makes a plan for another region of the same frame.
    fn for_region(&self, py: Python<'_>, at: (i64, i64, usize, usize)) -> PyResult<Self> {
        let at = region(at)?;
        let simulator = another!(self, py, |of, watch| of.for_region(at, watch));
        Ok(Self {
            simulator,
            making: Arc::clone(&self.making),
            process: std::process::id(),
        })
    }

    /// Makes a plan for another PSF, with the settings of this plan and, if possible, its tiles.
    fn for_model(&self, py: Python<'_>, model: &PsfModel) -> PyResult<Self> {
        let psf = model.0.clone();
        let simulator = another!(self, py, |of, watch| of.with_psf(psf, watch));
        Ok(Self {
            simulator,
            making: Arc::default(),
            process: std::process::id(),
        })
    }

    /// (x0, y0, nx, ny) of the part of the scene whose light reaches the image, in pixels of the
    /// scene.
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

    /// The blocks, row by row, in pixels of the scene.
    fn blocks(&self) -> PyResult<Vec<BlockRow>> {
        let blocks =
            in_precision!(self, simulator => simulator.blocks(&NoProgress)).map_err(Failure::from)?;
        let values =
            |(at, modes): (PixelRegion, usize)| (at.x0(), at.y0(), at.shape().nx(), at.shape().ny(), modes);
        Ok(blocks.into_iter().map(values).collect())
    }

    /// Properties of the plan by name.
    fn summary<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let made = self.preparation()?;
        let (shape, options) =
            in_precision!(self, simulator => (simulator.scene_shape(), simulator.options().clone()));
        let summary = made.plan.ok_or_else(|| invalid("this plan has no summary"))?;
        let found = PyDict::new(py);
        found.set_item("text", summary.to_string())?;
        found.set_item("shape", (shape.ny(), shape.nx()))?;
        found.set_item("frame_shape", self.frame_shape())?;
        found.set_item("precision", summary.precision)?;
        found.set_item("tolerance", summary.tolerance)?;
        found.set_item("tolerance_on", summary.tolerance_on.to_string())?;
        found.set_item("anchor", summary.anchor.to_string())?;
        found.set_item("method", options.method.to_string())?;
        found.set_item("scene_pixels", options.scene_pixels.to_string())?;
        found.set_item("device", made.placement.to_string())?;
        found.set_item("gpu", made.placement.adapter())?;
        found.set_item("tile_shape", (summary.tile.1, summary.tile.0))?;
        found.set_item("transform_shape", (summary.transform.1, summary.transform.0))?;
        found.set_item("tiles", summary.tiles)?;
        found.set_item("blocks", summary.blocks)?;
        found.set_item("mean_modes", summary.mean_modes())?;
        found.set_item("most_modes", summary.most_modes())?;
        found.set_item("predicted_seconds", summary.predicted_seconds)?;
        found.set_item("kept_bytes", summary.kept_bytes.0 + summary.kept_bytes.1)?;
        Ok(found)
    }

    /// Simulates the image of a scene and sources.
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        scene: Option<Bound<'py, PyAny>>,
        sources: Option<PyRef<'py, Sources>>,
        out: Option<Bound<'py, PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Simulated<'py>> {
        self.check_process()?;
        memory::check("the image", self.image_bytes(usize::from(out.is_none())))?;
        let none = Sources::default();
        let sources = sources.as_deref().unwrap_or(&none);
        in_precision!(self, simulator => {
            let scene = scene.as_ref().map(|scene| readonly::<_, Ix2>(scene, "scene")).transpose()?;
            let mut out = out.as_ref().map(writable::<_, Ix2>).transpose()?;
            let light = scene.as_ref().map(|scene| scene.as_array());
            let target = out.as_mut().map(|out| out.as_array_mut());
            let made = threads::run_beside(py, progress.as_ref(), &*pool()?, |watch, pool| {
                let scene = self.ready(simulator, light, sources, watch, pool)?;
                pool.install(|| simulated(simulator, &scene, target, watch))
            })?;
            Ok(in_python(py, made?))
        })
    }

    /// Simulates the images of scenes `[n, y, x]`.
    fn simulate_many<'py>(
        &self,
        py: Python<'py>,
        scenes: Bound<'py, PyAny>,
        out: Option<Bound<'py, PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Simulated<'py>> {
        self.check_process()?;
        in_precision!(self, simulator => {
            let scenes = readonly::<_, Ix3>(&scenes, "scene")?;
            let mut out = out.as_ref().map(writable::<_, Ix3>).transpose()?;
            let (lights, target) = (scenes.as_array(), out.as_mut().map(|out| out.as_array_mut()));
            memory::check("the stack of images", self.image_bytes(target.as_ref().map_or(lights.dim().0, |_| 0)))?;
            let made = threads::run_beside(py, progress.as_ref(), &*pool()?, |watch, pool| {
                let check = |(n, light)| {
                    let light = ImageView::new(light).map_err(Failure::of(format!("scene[{n}]")));
                    light.map(Scene::from)
                };
                let scenes = lights.outer_iter().enumerate().map(check);
                let scenes: Vec<Scene<'_, _>> = pool.install(|| scenes.collect::<Result<_, _>>())?;
                if let Some(light) = lights.outer_iter().next() {
                    self.ready(simulator, Some(light), &Sources::default(), watch, pool)?;
                }
                pool.install(|| many_simulated(simulator, &scenes, target, watch))
            })?;
            Ok(in_python(py, made?))
        })
    }

    /// Applies the transpose of the simulation to an image.
    fn adjoint<'py>(
        &self,
        py: Python<'py>,
        image: Bound<'py, PyAny>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.check_process()?;
        in_precision!(self, simulator => {
            let image = readonly::<_, Ix2>(&image, "image")?;
            let pixels = image.as_array();
            memory::check("the adjoint", self.image_bytes(1))?;
            let made = threads::run(py, progress.as_ref(), |watch| -> Result<_, Failure> {
                let image = ImageView::new(pixels).map_err(Failure::of("image"))?;
                Ok(simulator.adjoint(&image, watch)?)
            })?;
            let light = made?.pop().expect("a scene has a layer");
            Ok(light.into_pixels().into_pyarray(py).into_any())
        })
    }

    /// Checks an image against the direct sum. Returns the result as JSON.
    fn spot_check<'py>(
        &self,
        py: Python<'py>,
        image: Bound<'py, PyAny>,
        scene: Option<Bound<'py, PyAny>>,
        sources: Option<PyRef<'py, Sources>>,
        count: usize,
        seed: u64,
    ) -> PyResult<String> {
        memory::check("the check", self.image_bytes(2))?;
        let none = Sources::default();
        let sources = sources.as_deref().unwrap_or(&none);
        let check = in_precision!(self, simulator => {
            let image = readonly::<_, Ix2>(&image, "image")?;
            let scene = scene.as_ref().map(|scene| readonly::<_, Ix2>(scene, "scene")).transpose()?;
            let (pixels, light) = (image.as_array(), scene.as_ref().map(|scene| scene.as_array()));
            threads::run_beside(py, None, &*pool()?, |watch, pool| {
                let scene = self.ready(simulator, light, sources, watch, pool)?;
                pool.install(|| -> Result<_, Failure> {
                    let image = Image::new(pixels.to_owned())?;
                    Ok(simulator.spot_check(&scene, &image, (count, seed), watch)?)
                })
            })?
        });
        Ok(serde_json::to_string(&check?).expect("the result is plain numbers"))
    }
}

impl Plan {
    /// Makes a scene, prepares the simulator for it, and returns the scene. If several threads need
    /// the same preparation, one thread makes it. The others wait for it, or until they are
    /// cancelled.
    fn ready<'a, T: ConvReal>(
        &self,
        simulator: &Simulator<T>,
        light: Option<ArrayView2<'a, T>>,
        sources: &'a Sources,
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
        let scene = scene.with_stars(&sources.stars).with_galaxies(&sources.galaxies);
        if !simulator.is_prepared(&scene) {
            let _making = threads::turn(&self.making, watch)?;
            pool.install(|| simulator.prepare(&scene, watch))?;
        }
        Ok(scene)
    }

    /// The bytes of so many images of this plan.
    fn image_bytes(&self, count: usize) -> usize {
        let (ny, nx) = self.frame_shape();
        let size = match &self.simulator {
            AnySimulator::Single(_) => size_of::<f32>(),
            AnySimulator::Double(_) => size_of::<f64>(),
        };
        [ny, nx, size]
            .iter()
            .fold(count, |bytes, n| bytes.saturating_mul(*n))
    }

    /// Refuses a plan on a GPU if this process is a child of the process that made the plan.
    fn check_process(&self) -> PyResult<()> {
        if self.process == std::process::id() || self.preparation()?.placement.adapter().is_none() {
            return Ok(());
        }
        Err(PyOSError::new_err(
            "this plan is on a GPU opened by the parent of this process: make the plan in the forked \
             process, or start processes with spawn",
        ))
    }

    /// Returns the preparation of the simulator for scenes with an image.
    fn preparation(&self) -> PyResult<Preparation<'_>> {
        let made = in_precision!(self, simulator => simulator.prepare(&Scene::streamed(), &NoProgress));
        Ok(made.map_err(Failure::from)?)
    }
}

/// Simulates a prepared scene. Returns the image, or `None` if it was written to an array of the
/// caller, and the warnings.
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
    // `new` checks that every pixel is finite, as the library does for images that it allocates.
    ImageView::new(image.view())?;
    Ok((made, simulator.warnings(scene)))
}

/// Converts an image, or images, and warnings.
fn in_python<T: Element, D: Dimension>(
    py: Python<'_>,
    (image, warnings): (Option<Array<T, D>>, Vec<SimulationWarning>),
) -> Simulated<'_> {
    let text = |w: &SimulationWarning| with_argument(w.to_string(), w.setting());
    let image = image.map(|image| image.into_pyarray(py).into_any());
    (image, warnings.iter().map(text).collect())
}

/// Simulates prepared scenes. Returns the images `[n, y, x]`, or `None` if they were written to an
/// array of the caller, and the warnings of the first scene.
fn many_simulated<T: ConvReal>(
    simulator: &Simulator<T>,
    scenes: &[Scene<'_, T>],
    out: Option<ArrayViewMut3<'_, T>>,
    watch: &Watch,
) -> Result<(Option<Array3<T>>, Vec<SimulationWarning>), Failure> {
    let mut made = None;
    let shape = simulator.image_shape();
    let mut images = if let Some(mut out) = out {
        out.fill(T::zero());
        out
    } else {
        let rows = zeros((scenes.len() * shape.ny(), shape.nx()));
        let images = rows.into_shape_with_order((scenes.len(), shape.ny(), shape.nx()));
        made.insert(images.expect("row-major")).view_mut()
    };
    simulator.simulate_many_into(scenes, images.outer_iter_mut().collect(), watch)?;
    for image in images.outer_iter() {
        // `new` checks that every pixel is finite.
        ImageView::new(image)?;
    }
    let warnings = scenes.first().map(|scene| simulator.warnings(scene));
    Ok((made, warnings.unwrap_or_default()))
}

/// Builds a simulator, and makes its model and plan for scenes that contain an image. Those for
/// stars and galaxies are made later, when a scene needs them.
fn planned<T: ConvReal>(
    py: Python<'_>,
    make: impl FnOnce(&Watch) -> Result<Simulator<T>, PsfieldError> + Send + 'static,
) -> PyResult<Arc<Simulator<T>>> {
    let made = threads::run_apart(py, move |watch, pool| {
        pool.install(|| -> Result<_, Failure> {
            let simulator = make(watch)?;
            simulator.prepare(&Scene::streamed(), watch)?;
            Ok(Arc::new(simulator))
        })
    })?;
    Ok(made?)
}

/// Borrows a NumPy array for reading. The Python code has already converted the array to the plan's
/// precision.
fn readonly<'py, T: Element, D: Dimension>(
    array: &Bound<'py, PyAny>,
    name: &str,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    let array = array.cast::<PyArray<T, D>>()?;
    array.try_readonly().map_err(|_| {
        invalid(format!(
            "{name}: another call is writing its image to this array: wait until it returns"
        ))
    })
}

/// Borrows a NumPy array for writing.
fn writable<'py, T: Element, D: Dimension>(
    array: &Bound<'py, PyAny>,
) -> PyResult<PyReadwriteArray<'py, T, D>> {
    let array = array.cast::<PyArray<T, D>>()?;
    array
        .try_readwrite()
        .map_err(|_| invalid("out: another call reads or writes this array: give each call its own array"))
}
