//! Plans: simulators for scenes of one shape.

use std::sync::{Arc, Mutex};

use ndarray::parallel::prelude::*;
use ndarray::{Array, Array2, Array3, ArrayView3, ArrayViewMut2, ArrayViewMut3, Axis, Dimension, Ix2, Ix3};
use numpy::{Element, IntoPyArray, PyReadonlyArray2};
use psfield::conv_core::{ConvReal, DroppedLight, zeros};
use psfield::detector::BadPixelMask;
use psfield::psf_io::{ColumnValues, HeaderCards, TableColumn};
use psfield::psf_types::{Image, ImageView, NoProgress, PixelRegion};
use psfield::{
    ExposeOptions, Method, Preparation, PsfieldError, Scene, ShootBelow, SimulateOptions, SimulationWarning,
    Simulator, TruthTable, WantedGradients,
};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};
use rayon::ThreadPool;

use crate::arrays::{Borrowed, readonly, writable};
use crate::catalog::{Sources, sky_of};
use crate::colour::{Colour, ColourArguments};
use crate::detector::{Detector, Exposed, exposure_in_python};
use crate::error::{Failure, invalid, with_argument};
use crate::memory;
use crate::psf_model::{Basis, PsfModel, in_arrays};
use crate::settings::{from_python, to_python};
use crate::simulators::{Images, Simulators, dark_light};
use crate::source_columns::SourceColumns;
use crate::threads::{self, Watch, pool};

/// A simulator for scenes of one shape, with its plan.
#[pyclass(frozen, module = "psfield._native")]
pub(crate) struct Plan {
    simulators: AnySimulators,
    /// Locked while a thread outside the pool prepares the simulator for a new kind of scene (with
    /// or without stars or galaxies). Plans for other regions use the same lock, because they share
    /// the plans for stars and galaxies.
    making: Arc<Mutex<()>>,
    /// The process that made this plan.
    process: u32,
}

enum AnySimulators {
    Single(Arc<Simulators<f32>>),
    Double(Arc<Simulators<f64>>),
}

/// Runs one body of code in single or double precision.
macro_rules! in_precision {
    ($plan:expr, $simulators:ident => $body:expr) => {
        match &$plan.simulators {
            AnySimulators::Single($simulators) => $body,
            AnySimulators::Double($simulators) => $body,
        }
    };
}

/// Makes simulators from those of a plan, in the same precision.
macro_rules! another {
    ($plan:expr, $py:expr, |$of:ident, $watch:ident| $make:expr) => {
        match &$plan.simulators {
            AnySimulators::Single($of) => {
                let $of = Arc::clone($of);
                AnySimulators::Single(planned($py, move |$watch| $make)?)
            }
            AnySimulators::Double($of) => {
                let $of = Arc::clone($of);
                AnySimulators::Double(planned($py, move |$watch| $make)?)
            }
        }
    };
}

/// Reads the settings of a plan. Errors name the argument.
#[pyfunction]
pub(crate) fn plan_settings<'py>(given: &Bound<'py, PyMapping>) -> PyResult<Bound<'py, PyDict>> {
    to_python(given.py(), &options(given)?)
}

pub(crate) fn options(given: &Bound<'_, PyMapping>) -> PyResult<SimulateOptions> {
    let method = given.get_item("method");
    if let Ok(name) = method.and_then(|method| method.extract::<String>())
        && !name.parse().is_ok_and(Method::has_plan)
    {
        return Err(invalid(format!("method must be auto or lowrank, got {name}")));
    }
    let options: SimulateOptions = from_python(given)?;
    match options.plan_options() {
        Ok(_) => Ok(options),
        Err(error) if error.setting() == Some("floor") => Err(invalid(format!(
            "floor must be at least 0 and finite, got {}",
            options.floor
        ))),
        Err(_) => Err(invalid(format!(
            "tolerance must be at least 0 and below 1, got {}",
            options.tolerance
        ))),
    }
}

/// The image, or `None` if it was written to an array of the caller, and warnings in sentences.
type Simulated<'py> = (Option<Bound<'py, PyAny>>, Vec<String>);

/// (x0, y0, nx, ny, modes) of a block.
type BlockRow = (i64, i64, usize, usize, usize);

/// ((x0, y0), kernels `[kernel, y, x]`, weights `[kernel, y, x]`) of a block.
type BlockArrays<'py> = ((usize, usize), Bound<'py, PyAny>, Bound<'py, PyAny>);

/// The reach, the sampled pixels (first, step), and the blocks.
type PlanArrays<'py> = ((i64, i64), (usize, usize), Vec<BlockArrays<'py>>);

#[pymethods]
impl Plan {
    /// Makes a plan for scenes of one shape.
    #[new]
    fn new(
        py: Python<'_>,
        model: &PsfModel,
        shape: (usize, usize),
        precision: &str,
        settings: &Bound<'_, PyMapping>,
        colour: Option<ColourArguments>,
    ) -> PyResult<Self> {
        let (ny, nx) = shape;
        let pixels = ny.saturating_mul(nx);
        if pixels > Simulator::<f32>::MAX_PIXELS {
            let most = Simulator::<f32>::MAX_PIXELS;
            return Err(invalid(format!(
                "shape: {ny} x {nx} pixels are too many: at most 2^30 = {most}"
            )));
        }
        let (psf, options) = (model.0.clone(), options(settings)?);
        let colour = colour.map(Colour::new).transpose()?;
        let simulators = match precision {
            "f32" => AnySimulators::Single(planned(py, move |_| {
                Simulators::new(psf, shape, options, colour)
            })?),
            "f64" => AnySimulators::Double(planned(py, move |_| {
                Simulators::new(psf, shape, options, colour)
            })?),
            other => return Err(invalid(format!("precision must be f32 or f64, got {other}"))),
        };
        Ok(Self::of(simulators, Arc::default()))
    }

    /// Makes a plan for another region of the same frame.
    fn for_region(&self, py: Python<'_>, at: (i64, i64, usize, usize)) -> PyResult<Self> {
        let at = PixelRegion::try_from(at).map_err(Failure::from)?;
        let simulators = another!(self, py, |of, watch| of.for_region(at, watch));
        Ok(Self::of(simulators, Arc::clone(&self.making)))
    }

    /// Makes a plan for another PSF, with the settings of this plan and, if possible, its tiles.
    fn with_psf(&self, py: Python<'_>, model: &PsfModel) -> PyResult<Self> {
        let psf = model.0.clone();
        let simulators = another!(self, py, |of, watch| of.with_psf(&psf, watch));
        Ok(Self::of(simulators, Arc::default()))
    }

    /// (x0, y0, nx, ny) of the part of the scene whose light reaches the image, in pixels of the
    /// scene.
    fn light_region(&self) -> PyResult<(i64, i64, usize, usize)> {
        let light = in_precision!(self, of => of.first.light_region(&NoProgress));
        Ok(light.map_err(Failure::from)?.into())
    }

    /// (ny, nx) of the image.
    fn frame_shape(&self) -> (usize, usize) {
        let shape = in_precision!(self, of => of.first.image_shape());
        (shape.ny(), shape.nx())
    }

    /// The blocks, row by row, in pixels of the scene.
    fn blocks(&self) -> PyResult<Vec<BlockRow>> {
        let blocks = in_precision!(self, of => of.first.blocks(&NoProgress)).map_err(Failure::from)?;
        let values =
            |(at, modes): (PixelRegion, usize)| (at.x0(), at.y0(), at.shape().nx(), at.shape().ny(), modes);
        Ok(blocks.into_iter().map(values).collect())
    }

    /// The plan as arrays: the reach, the sampled pixels (first, step), and the blocks.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<PlanArrays<'py>> {
        if in_precision!(self, of => of.in_colour()) {
            return Err(invalid(
                "a plan in colour needs the native engine: use simulate and adjoint",
            ));
        }
        let blocks = self.blocks()?;
        let values = blocks.iter().map(|(_, _, nx, ny, modes)| nx * ny * modes);
        memory::check("the plan as arrays", values.sum::<usize>() * self.value_bytes())?;
        in_precision!(self, of => {
            let made = threads::run(py, None, |watch| of.first.plan_arrays(watch))?;
            let arrays = made.map_err(Failure::from)?;
            let blocks = arrays.blocks.into_iter().map(|block| {
                let kernels = block.kernels.into_pyarray(py).into_any();
                (block.first, kernels, block.weights.into_pyarray(py).into_any())
            });
            Ok((arrays.reach, of.first.sampled_pixels(), blocks.collect()))
        })
    }

    /// Properties of the plan by name.
    fn summary<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let made = self.preparation()?;
        let (shape, options) =
            in_precision!(self, of => (of.first.scene_shape(), of.first.options().clone()));
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

    /// Simulates the image of a scene's images, each with the name of its spectrum, and of sources.
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        images: Vec<(Option<String>, Bound<'py, PyAny>)>,
        sources: Option<PyRef<'py, Sources>>,
        out: Option<Bound<'py, PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Simulated<'py>> {
        self.check_process()?;
        memory::check("the image", self.image_bytes(usize::from(out.is_none())))?;
        let none = Sources::default();
        let sources = sources.as_deref().unwrap_or(&none);
        in_precision!(self, simulators => {
            let images = Borrowed::new(&images)?;
            let mut out = out.as_ref().map(writable::<_, Ix2>).transpose()?;
            let (images, target) = (images.views(), out.as_mut().map(|out| out.as_array_mut()));
            let made = threads::run_beside(py, progress.as_ref(), &*pool()?, |watch, pool| {
                let (simulator, scene) = self.ready(simulators, images, sources, watch, pool)?;
                pool.install(|| simulated(&simulator, &scene, target, watch))
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
        in_precision!(self, simulators => {
            let scenes = readonly::<_, Ix3>(&scenes, "scene")?;
            let mut out = out.as_ref().map(writable::<_, Ix3>).transpose()?;
            let (lights, target) = (scenes.as_array(), out.as_mut().map(|out| out.as_array_mut()));
            memory::check("the stack of images", self.image_bytes(target.as_ref().map_or(lights.dim().0, |_| 0)))?;
            let made = threads::run_beside(py, progress.as_ref(), &*pool()?, |watch, pool| {
                let none = Sources::default();
                let scene = |(n, light)| {
                    let scene = simulators.scene(vec![(None, light)], &none);
                    scene.map_err(|failure| failure.caused_by(format!("scene[{n}]")))
                };
                let scenes = lights.outer_iter().enumerate().map(scene);
                let scenes: Vec<(_, Scene<'_, _>)> = pool.install(|| scenes.collect::<Result<_, _>>())?;
                let (of_scenes, scenes): (Vec<_>, Vec<_>) = scenes.into_iter().unzip();
                let simulator = of_scenes.first().unwrap_or(&simulators.first);
                if let Some(scene) = scenes.first() {
                    self.prepare(simulator, scene, watch, pool)?;
                }
                pool.install(|| many_simulated(simulator, &scenes, target, watch))
            })?;
            Ok(in_python(py, made?))
        })
    }

    /// Applies the transpose of the simulation to an image. In colour, returns the light of each of these
    /// spectra.
    fn adjoint<'py>(
        &self,
        py: Python<'py>,
        image: Bound<'py, PyAny>,
        spectra: Vec<String>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Vec<Bound<'py, PyAny>>> {
        self.check_process()?;
        memory::check("the adjoint", self.image_bytes(spectra.len().max(1)))?;
        in_precision!(self, simulators => {
            let image = readonly::<_, Ix2>(&image, "image")?;
            let pixels = image.as_array();
            let made = threads::run(py, progress.as_ref(), |watch| -> Result<_, Failure> {
                let image = ImageView::new(pixels).map_err(Failure::of("image"))?;
                let simulator = simulators.of_spectra(&dark_light(&spectra))?;
                Ok(simulator.adjoint(&image, watch)?)
            })?;
            let array = |light: Image<_>| light.into_pixels().into_pyarray(py).into_any();
            Ok(made?.into_iter().map(array).collect())
        })
    }

    /// Applies the transpose of the simulation to images `[n, y, x]`, for a plan of one spectrum at most.
    fn adjoint_many<'py>(
        &self,
        py: Python<'py>,
        images: Bound<'py, PyAny>,
        spectrum: Option<String>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.check_process()?;
        in_precision!(self, simulators => {
            let images = readonly::<_, Ix3>(&images, "image")?;
            let pixels = images.as_array();
            memory::check("the adjoints", self.image_bytes(pixels.dim().0))?;
            let made = threads::run(py, progress.as_ref(), |watch| -> Result<_, Failure> {
                let images = views(pixels, "image")?;
                let spectra: Vec<String> = spectrum.into_iter().collect();
                let simulator = simulators.of_spectra(&dark_light(&spectra))?;
                Ok(simulator.adjoint_many(&images, watch)?)
            })?;
            Ok(made?.into_pyarray(py).into_any())
        })
    }

    /// The derivatives of the sum over images of light times cotangents: with respect to the light, if it is
    /// wanted, and with respect to mean, components and coefficients of the PSF, if they are wanted. Arrays are
    /// `[n, y, x]`.
    fn gradients<'py>(
        &self,
        py: Python<'py>,
        lights: Bound<'py, PyAny>,
        images: Bound<'py, PyAny>,
        light: bool,
        coefficients: bool,
        stamps: bool,
    ) -> PyResult<(Option<Bound<'py, PyAny>>, Option<Basis<'py>>)> {
        self.check_process()?;
        in_precision!(self, simulators => {
            let (lights, images) = (readonly::<_, Ix3>(&lights, "light")?, readonly::<_, Ix3>(&images, "image")?);
            let (of_lights, of_images) = (lights.as_array(), images.as_array());
            memory::check("the derivatives", self.image_bytes(2 * of_images.dim().0))?;
            let made = threads::run(py, None, |watch| -> Result<_, Failure> {
                let (lights, images) = (views(of_lights, "light")?, views(of_images, "image")?);
                let wanted = WantedGradients {
                    light,
                    coefficients,
                    stamps,
                };
                Ok(simulators.first.gradients(&lights, &images, wanted, watch)?)
            })?;
            let made = made?;
            let light = made.light.map(|light| light.into_pyarray(py).into_any());
            Ok((light, made.psf.map(|psf| in_arrays(py, psf))))
        })
    }

    /// Draws sources of columns ([`SourceColumns`]).
    fn draw_sources<'py>(
        &self,
        py: Python<'py>,
        columns: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.check_process()?;
        memory::check("the image", self.image_bytes(1))?;
        let sources = SourceColumns::new(columns.as_array())?;
        in_precision!(self, simulators => {
            let made = threads::run_beside(py, None, &*pool()?, |watch, pool| {
                let (simulator, scene) = (&simulators.first, sources.scene());
                self.prepare(simulator, &scene, watch, pool)?;
                pool.install(|| simulated(simulator, &scene, None, watch))
            })?;
            let (image, _) = made?;
            Ok(image.expect("without an array of the caller").into_pyarray(py).into_any())
        })
    }

    /// The derivatives of the sum of an image times the image of sources of columns ([`SourceColumns`]) with respect
    /// to the numbers in the columns.
    fn source_gradients<'py>(
        &self,
        py: Python<'py>,
        columns: PyReadonlyArray2<'py, f64>,
        image: Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.check_process()?;
        let sources = SourceColumns::new(columns.as_array())?;
        in_precision!(self, simulators => {
            let image = readonly::<_, Ix2>(&image, "image")?;
            let pixels = image.as_array();
            let made = threads::run_beside(py, None, &*pool()?, |watch, pool| -> Result<_, Failure> {
                let image = ImageView::new(pixels).map_err(Failure::of("image"))?;
                let (simulator, scene) = (&simulators.first, sources.scene());
                self.prepare(simulator, &scene, watch, pool)?;
                Ok(pool.install(|| simulator.source_gradients(&scene, &image, watch))?)
            })?;
            Ok(sources.derivatives(&made?).into_pyarray(py).into_any())
        })
    }

    /// Simulates a scene as [`simulate`](Self::simulate), and exposes the image. `shoot_below` is a number of
    /// photons, or below 0 for a choice by the cost. Returns counts, flags, the report, and warnings.
    #[allow(clippy::too_many_arguments, reason = "the arguments of Python's method")]
    fn expose<'py>(
        &self,
        py: Python<'py>,
        images: Vec<(Option<String>, Bound<'py, PyAny>)>,
        sources: Option<PyRef<'py, Sources>>,
        detector: PyRef<'py, Detector>,
        seed: u64,
        shoot_below: f64,
        bad_pixels: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<(Exposed<'py>, Vec<String>)> {
        self.check_process()?;
        memory::check("the exposure", self.image_bytes(3))?;
        let none = Sources::default();
        let sources = sources.as_deref().unwrap_or(&none);
        let mask = bad_pixels.map(|mask| BadPixelMask::new(mask.as_array()));
        let mask = mask.transpose().map_err(Failure::from)?;
        let detector = &detector.0;
        let options = ExposeOptions {
            detector,
            seed,
            shoot_below: match shoot_below {
                0.0 => None,
                below if below > 0.0 => Some(ShootBelow::Photons(below)),
                _ => Some(ShootBelow::Auto),
            },
            bad_pixels: mask.as_ref(),
        };
        in_precision!(self, simulators => {
            let images = Borrowed::new(&images)?;
            let images = images.views();
            let made = threads::run_beside(py, None, &*pool()?, |watch, pool| {
                let (simulator, scene) = self.ready(simulators, images, sources, watch, pool)?;
                pool.install(|| -> Result<_, Failure> {
                    let exposure = simulator.expose(&scene, options, watch)?;
                    let noise = Some(detector.noise()).filter(|noise| *noise > 0.0);
                    Ok((exposure, simulator.warnings(&scene, noise)))
                })
            })?;
            let (exposure, warnings) = made?;
            Ok((exposure_in_python(py, exposure), texts(&warnings)))
        })
    }

    /// The columns of a truth table. `wcs_cards` are the world coordinates of the image from the scene's first pixel.
    fn truth_table<'py>(
        &self,
        py: Python<'py>,
        sources: PyRef<'py, Sources>,
        wcs_cards: Option<&str>,
        flags: Option<PyReadonlyArray2<'py, u8>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let sky = wcs_cards
            .map(|cards| sky_of(&HeaderCards::from_text(cards)))
            .transpose()?;
        let shown = in_precision!(self, simulators => simulators.first.shown_region());
        let mut table = TruthTable::new(&sources.catalog, shown, sky.as_ref());
        if let Some(flags) = flags {
            table = table.with_flags(flags.as_array());
        }
        let columns = PyDict::new(py);
        for TableColumn { name, values, .. } in table.columns() {
            match values {
                ColumnValues::Numbers(values) => columns.set_item(name, values.into_pyarray(py))?,
                ColumnValues::Integers(values) => columns.set_item(name, values.into_pyarray(py))?,
                ColumnValues::Flags(values) => columns.set_item(name, values.into_pyarray(py))?,
                _ => unreachable!("a column of another kind"),
            }
        }
        Ok(columns)
    }

    /// Upper limits of the light of sources that is dropped: in any pixel, and as a fraction of their flux.
    fn dropped_light(&self, py: Python<'_>, sources: PyRef<'_, Sources>) -> PyResult<(f64, f64)> {
        let sources = &*sources;
        let dropped = in_precision!(self, simulators => {
            threads::run_beside(py, None, &*pool()?, |watch, pool| {
                let (simulator, scene) = self.ready(simulators, Vec::new(), sources, watch, pool)?;
                pool.install(|| -> Result<_, Failure> { Ok(simulator.dropped_light(&scene)?) })
            })?
        });
        let limits = |dropped: DroppedLight| (dropped.largest(), dropped.fraction());
        Ok(dropped?.map_or((0.0, 0.0), limits))
    }

    /// Checks an image against the direct sum. Returns the result as JSON.
    fn spot_check<'py>(
        &self,
        py: Python<'py>,
        image: Bound<'py, PyAny>,
        images: Vec<(Option<String>, Bound<'py, PyAny>)>,
        sources: Option<PyRef<'py, Sources>>,
        count: usize,
        seed: u64,
    ) -> PyResult<String> {
        memory::check("the check", self.image_bytes(2))?;
        let none = Sources::default();
        let sources = sources.as_deref().unwrap_or(&none);
        let check = in_precision!(self, simulators => {
            let (image, images) = (readonly::<_, Ix2>(&image, "image")?, Borrowed::new(&images)?);
            let (pixels, images) = (image.as_array(), images.views());
            threads::run_beside(py, None, &*pool()?, |watch, pool| {
                let (simulator, scene) = self.ready(simulators, images, sources, watch, pool)?;
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
    /// A plan of this process.
    fn of(simulators: AnySimulators, making: Arc<Mutex<()>>) -> Self {
        Self {
            simulators,
            making,
            process: std::process::id(),
        }
    }

    /// Makes a scene and prepares its simulator.
    fn ready<'a, T: ConvReal>(
        &self,
        simulators: &Simulators<T>,
        images: Images<'a, T>,
        sources: &'a Sources,
        watch: &Watch,
        pool: &ThreadPool,
    ) -> Result<(Arc<Simulator<T>>, Scene<'a, T>), Failure> {
        let (simulator, scene) = pool.install(|| simulators.scene(images, sources))?;
        self.prepare(&simulator, &scene, watch, pool)?;
        Ok((simulator, scene))
    }

    /// Prepares a simulator for a scene. If several threads need the same preparation, one thread makes it.
    /// The others wait for it, or until they are cancelled.
    fn prepare<T: ConvReal>(
        &self,
        simulator: &Simulator<T>,
        scene: &Scene<'_, T>,
        watch: &Watch,
        pool: &ThreadPool,
    ) -> Result<(), Failure> {
        if !simulator.is_prepared(scene) {
            let _making = threads::turn(&self.making, watch)?;
            pool.install(|| simulator.prepare(scene, watch))?;
        }
        Ok(())
    }

    /// The bytes of a value in the precision of the plan.
    fn value_bytes(&self) -> usize {
        match &self.simulators {
            AnySimulators::Single(_) => size_of::<f32>(),
            AnySimulators::Double(_) => size_of::<f64>(),
        }
    }

    /// The bytes of so many images of this plan.
    fn image_bytes(&self, count: usize) -> usize {
        let (ny, nx) = self.frame_shape();
        [ny, nx, self.value_bytes()]
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
        let made = in_precision!(self, of => of.first.prepare(&Scene::streamed(), &NoProgress));
        Ok(made.map_err(Failure::from)?)
    }
}

/// The images of a stack. Errors name the argument and the image.
fn views<'a, T: ConvReal>(
    stack: ArrayView3<'a, T>,
    name: &'static str,
) -> Result<Vec<ImageView<'a, T>>, Failure> {
    let planes = stack.into_outer_iter().enumerate();
    let view = |(n, plane): (usize, _)| ImageView::new(plane).map_err(Failure::of(format!("{name}[{n}]")));
    planes.map(view).collect()
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
    Ok((made, simulator.warnings(scene, None)))
}

/// Converts an image, or images, and warnings.
fn in_python<T: Element, D: Dimension>(
    py: Python<'_>,
    (image, warnings): (Option<Array<T, D>>, Vec<SimulationWarning>),
) -> Simulated<'_> {
    (
        image.map(|image| image.into_pyarray(py).into_any()),
        texts(&warnings),
    )
}

/// Warnings in sentences that name arguments of Python.
fn texts(warnings: &[SimulationWarning]) -> Vec<String> {
    let text = |w: &SimulationWarning| with_argument(w.to_string(), w.setting());
    warnings.iter().map(text).collect()
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
    let warnings = scenes.first().map(|scene| simulator.warnings(scene, None));
    Ok((made, warnings.unwrap_or_default()))
}

/// Builds simulators, and makes the model and the plan for scenes that contain an image, unless their spectra
/// are not known. Those for stars and galaxies, or for other spectra, are made later, when a scene needs them.
fn planned<T: ConvReal>(
    py: Python<'_>,
    make: impl FnOnce(&Watch) -> Result<Simulators<T>, PsfieldError> + Send + 'static,
) -> PyResult<Arc<Simulators<T>>> {
    threads::run_apart(py, move |watch| -> Result<_, PsfieldError> {
        let simulators = make(watch)?;
        if simulators.has_spectrum() {
            simulators.first.prepare(&Scene::streamed(), watch)?;
        }
        Ok(Arc::new(simulators))
    })
}
