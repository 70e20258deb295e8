//! A PSF that changes over the field.

use std::path::{Path, PathBuf};

use ndarray::ArrayViewMut2;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use psfield::coeff_field::CoeffFieldError;
use psfield::convert::{PsfFormat, SamplesAt, to_gridded};
use psfield::evaluate::{EvaluateOptions, OutputGrid, evaluate_stamps};
use psfield::fit::{Fit, OwnInterpolation, fit_by, fit_in_basis, fit_weighted};
use psfield::image_cards::provenance_cards;
use psfield::psf_basis::GivenStamps;
use psfield::psf_io::Precision;
use psfield::psf_types::{
    FrameShape, Position, PsfBasis, PsfModelRecord, PsfSamples, SampleCoefficients, SamplePositions,
    SampleStates, StateKind, WingsRecord,
};
use psfield::stack_size::MAX_STACK_BYTES;
use psfield::{FitChoices, FitOptions, Psf, PsfParameters, PsfieldError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};
use serde::Deserialize;

use crate::colour::Curved;
use crate::error::{Failure, invalid, with_argument};
use crate::memory;
use crate::settings::{GridSettings, frame_shape, from_python, parsed, positions, to_python};
use crate::threads;

/// A PSF that changes over the field.
#[pyclass(frozen, module = "psfield._native")]
pub(crate) struct PsfModel(pub(crate) Psf);

/// A stamp or a table of doubles.
type Plane<'py> = Bound<'py, PyArray2<f64>>;
/// A cube of doubles.
type Cube<'py> = Bound<'py, PyArray3<f64>>;
/// A mean stamp, if there is one, components and coefficients.
pub(crate) type Basis<'py> = (Option<Plane<'py>>, Cube<'py>, Plane<'py>);
/// The names of the interpolation, the outside policy and the normalisation, and of the method whose values
/// are in a table.
type Choices = (String, String, String, Option<String>);
/// A basis that the caller gave: that of a model, or a mean stamp and components.
#[derive(FromPyObject)]
enum GivenBasis<'py> {
    Model(PyRef<'py, PsfModel>),
    Stamps((Option<PyReadonlyArray2<'py, f64>>, PyReadonlyArray3<'py, f64>)),
}

/// The name of the quantity on which the PSF depends besides the position, and its values.
type States = Option<(String, Vec<f64>)>;
/// Bytes that a fit needs for each value of its samples.
const FIT_BYTES: usize = 5 * size_of::<f64>();

/// Columns x and y.
type Points<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

impl PsfModel {
    /// Runs long work on another thread, so that Ctrl-C can interrupt the call.
    fn apart<R: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Psf) -> Result<R, PsfieldError> + Send + 'static,
    ) -> PyResult<R> {
        if let Some((samples, _)) = self.0.samples().filter(|_| self.0.record_if_fitted().is_none()) {
            let bytes = samples.stamps().len().saturating_mul(FIT_BYTES);
            memory::check("the fit of the samples", bytes)?;
        }
        let psf = self.0.clone();
        threads::run_apart(py, move |_| work(&psf))
    }

    /// Returns the model in the form that files store.
    fn record(&self, py: Python<'_>) -> PyResult<&PsfModelRecord> {
        self.apart(py, |psf| psf.record().map(drop))?;
        Ok(self.0.record().map_err(Failure::from)?)
    }
}

#[pymethods]
impl PsfModel {
    /// Makes a model from samples `[sample, y, x]` at positions.
    #[staticmethod]
    fn from_samples(
        py: Python<'_>,
        stamps: PyReadonlyArray3<'_, f64>,
        x: PyReadonlyArray1<'_, f64>,
        y: PyReadonlyArray1<'_, f64>,
        states: States,
        field: Option<(usize, usize)>,
        grid: &Bound<'_, PyMapping>,
        fit: &Bound<'_, PyMapping>,
        gridded_library: bool,
        basis: Option<GivenBasis<'_>>,
        weights: Option<PyReadonlyArray3<'_, f64>>,
    ) -> PyResult<Self> {
        let (count, ny, nx) = stamps.as_array().dim();
        let grid = from_python::<GridSettings>(grid)?.grid((ny, nx))?;
        let positions = sample_positions(&x, &y, states, field)?;
        let defaults = match count {
            _ if gridded_library => FitOptions::of_gridded_library(&positions),
            1 => FitOptions::of_single_stamp(),
            _ => FitOptions::default(),
        };
        let options = from_python::<FitChoices>(fit)?.or(defaults);
        let stamps = stamps.as_array();
        memory::check("the samples", stamps.len().saturating_mul(size_of::<f64>()))?;
        let samples = py
            .detach(|| PsfSamples::new(stamps.to_owned(), positions, grid))
            .map_err(Failure::from)?;
        let fitted = match basis {
            None => match weights {
                None => return Ok(Self(Psf::new(samples, options))),
                Some(weights) => {
                    let weights = weights.as_array().to_owned();
                    let fit = || fit_weighted(samples, weights, &options);
                    py.detach(fit).map_err(Failure::of("weights"))?
                }
            },
            Some(GivenBasis::Model(basis)) => basis.apart(py, move |psf| {
                fit_in_basis(samples, psf.record()?.basis(), &options)
            })?,
            Some(GivenBasis::Stamps((mean, stamps))) => {
                let mean = mean.map(|mean| mean.as_array().to_owned());
                let stamps = stamps.as_array().to_owned();
                let fit = || -> Result<Fit, PsfieldError> {
                    fit_by(samples, &GivenStamps::new(stamps, mean)?, &options)
                };
                py.detach(fit).map_err(Failure::of("basis"))?
            }
        };
        Ok(Self(Psf::from(fitted)))
    }

    /// Makes a model from a mean stamp, components `[component, y, x]` and their coefficients
    /// `[sample, component]` at positions, perhaps with wings: their stamps `[mode, y, x]`, their coefficients
    /// `[sample, mode]` and the grid of the stamps.
    #[staticmethod]
    #[pyo3(signature = (mean, components, coefficients, x, y, states, field, grid, choices, wings=None))]
    fn from_basis(
        mean: Option<PyReadonlyArray2<'_, f64>>,
        components: PyReadonlyArray3<'_, f64>,
        coefficients: PyReadonlyArray2<'_, f64>,
        x: PyReadonlyArray1<'_, f64>,
        y: PyReadonlyArray1<'_, f64>,
        states: States,
        field: Option<(usize, usize)>,
        grid: &Bound<'_, PyMapping>,
        choices: Choices,
        wings: Option<GivenWings<'_>>,
    ) -> PyResult<Self> {
        let (_, ny, nx) = components.as_array().dim();
        let grid = from_python::<GridSettings>(grid)?.grid((ny, nx))?;
        let positions = sample_positions(&x, &y, states, field)?;
        let (interpolation, outside, normalise) =
            (parsed(&choices.0)?, parsed(&choices.1)?, parsed(&choices.2)?);
        let table_of = choices.3;
        let mean = mean.map(|mean| mean.as_array().to_owned());
        let basis = PsfBasis::new(mean, components.as_array().to_owned(), grid).map_err(Failure::from)?;
        let wings = wings
            .map(|wings| wings_of(&wings, positions.clone()))
            .transpose()?;
        let coefficients = SampleCoefficients::new(coefficients.as_array().to_owned(), positions);
        let coefficients = coefficients.map_err(Failure::from)?;
        let record = PsfModelRecord::new(basis, coefficients, interpolation, outside, normalise);
        let record = record.map_err(Failure::from)?.with_table_of(table_of);
        let record = record.with_wings(wings).map_err(Failure::from)?;
        Ok(Self(Psf::from(record)))
    }

    /// Returns this PSF with an interpolation of the caller's own: a function of columns x and y that returns
    /// coefficients `[position, component]`. It is called with this thread's hold of the interpreter.
    fn interpolated_by(
        &self,
        py: Python<'_>,
        name: &str,
        evaluate: &Bound<'_, PyAny>,
        predictions: (PyReadonlyArray2<'_, f64>, usize),
        table_error: f64,
    ) -> PyResult<Self> {
        self.record(py)?;
        let mut called = |at: &[Position], mut values: ArrayViewMut2<'_, f64>| {
            let (x, y): (Vec<f64>, Vec<f64>) = at.iter().map(|p| (p.x(), p.y())).unzip();
            let failed = |error: PyErr| CoeffFieldError::External(error.into());
            let found = evaluate.call1((x.into_pyarray(py), y.into_pyarray(py)));
            let found: PyReadonlyArray2<'_, f64> = found
                .map_err(failed)?
                .extract()
                .map_err(|error: PyErr| failed(error))?;
            values.assign(&found.as_array());
            Ok(())
        };
        let own = OwnInterpolation {
            name,
            evaluate: &mut called,
            table_error,
            predictions: Some((predictions.0.as_array(), predictions.1)),
        };
        Ok(Self(self.0.interpolated_by(own).map_err(Failure::from)?))
    }

    /// Reads any PSF file.
    #[staticmethod]
    fn read(
        py: Python<'_>,
        path: PathBuf,
        file: &Bound<'_, PyMapping>,
        fit: &Bound<'_, PyMapping>,
    ) -> PyResult<Self> {
        let (file, choices) = (from_python(file)?, from_python(fit)?);
        threads::run_apart(py, move |_| Psf::open_with(&path, &file, &choices)).map(Self)
    }

    /// Notes on how the file was read, in sentences.
    fn notes(&self) -> Vec<String> {
        let notes = self.0.notes().iter();
        notes
            .map(|note| with_argument(note.to_string(), note.setting()))
            .collect()
    }

    /// The name of a constructor and the arguments with which it makes an equal model.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<(&'static str, Bound<'py, PyAny>)> {
        let (x, y) = self.positions(py);
        let field = self.field();
        let grid = to_python(py, &GridSettings::of(self.0.grid())?)?;
        if let Some((samples, options)) = self.0.samples() {
            let stamps = samples.stamps().to_owned().into_pyarray(py);
            let fit = to_python(py, &FitChoices::from(*options))?;
            let state = (
                stamps,
                x,
                y,
                self.states(),
                field,
                grid,
                fit,
                false,
                None::<Self>,
                None::<Self>,
            );
            return Ok(("from_samples", state.into_pyobject(py)?.into_any()));
        }
        let record = self.record(py)?;
        let (mean, components, coefficients) = arrays_of(py, record);
        let choices = choices_of(record);
        let states = self.states();
        let wings = record.wings().map(|wings| -> PyResult<_> {
            let stamps = wings.stamps().to_owned().into_pyarray(py);
            let coefficients = wings.coefficients().values().to_owned().into_pyarray(py);
            Ok((
                stamps,
                coefficients,
                to_python(py, &GridSettings::of(wings.grid())?)?,
            ))
        });
        let wings = wings.transpose()?;
        let state = (
            mean,
            components,
            coefficients,
            x,
            y,
            states,
            field,
            grid,
            choices,
            wings,
        );
        Ok(("from_basis", state.into_pyobject(py)?.into_any()))
    }

    /// Returns whether the model was made from samples.
    fn has_samples(&self) -> bool {
        self.0.samples().is_some()
    }

    /// The grid of whole stamps, in the form that the constructors accept.
    fn grid<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        to_python(py, &GridSettings::of(self.0.whole_grid())?)
    }

    /// (ny, nx) of the stamps.
    fn stamp_shape(&self) -> (usize, usize) {
        self.0.whole_grid().dim()
    }

    /// Positions of the samples. For a model without samples, these are the positions at which its
    /// coefficients are given.
    fn positions<'py>(&self, py: Python<'py>) -> Points<'py> {
        points(py, self.0.positions())
    }

    /// The name of the quantity on which the PSF depends besides the position, and its value for
    /// every sample.
    fn states(&self) -> States {
        let states = self.0.states()?;
        Some((states.kind().to_string(), states.per_sample().collect()))
    }

    /// Returns the PSF at a wavelength, a time or a frame.
    fn at_state(&self, py: Python<'_>, value: f64) -> PyResult<Self> {
        self.apart(py, move |psf| psf.at_state(value)).map(Self)
    }

    /// Returns the PSF of a spectrum in a bandpass: the mean over the detected photons.
    fn for_spectrum(&self, py: Python<'_>, bandpass: Curved, spectrum: Curved) -> PyResult<Self> {
        let (bandpass, spectrum) = (bandpass.bandpass()?, spectrum.spectrum()?);
        let mixed = move |psf: &Psf| psf.for_spectra(&bandpass, &[spectrum])?.at_state(0.0);
        self.apart(py, mixed).map(Self)
    }

    /// (ny, nx) of the field, if it is known.
    fn field(&self) -> Option<(usize, usize)> {
        self.0.positions().field().map(|field| (field.ny(), field.nx()))
    }

    /// (ny, nx) of the frame: as stated or, for a PSFEx model, the frame that fits its stars.
    fn field_shape(&self) -> Option<(usize, usize)> {
        self.0.field_shape().map(|field| (field.ny(), field.nx()))
    }

    /// The names of the interpolation, the outside policy and the normalisation of the model.
    fn choices(&self, py: Python<'_>) -> PyResult<Choices> {
        Ok(choices_of(self.record(py)?))
    }

    /// Mean stamp, components, coefficients, as given to [`with_parameters`](Self::with_parameters).
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Basis<'py>> {
        self.record(py)?;
        let parameters = self.0.parameters().map_err(Failure::from)?;
        Ok(in_arrays(py, parameters.clone()))
    }

    /// The parameters given to [`with_parameters`](Self::with_parameters), if the model does not hold them.
    fn given_parameters<'py>(&self, py: Python<'py>) -> Option<Basis<'py>> {
        let given = self.0.given_parameters()?;
        Some(in_arrays(py, given.clone()))
    }

    /// Returns this model with other parameters. Those that are not given stay.
    fn with_parameters(
        &self,
        py: Python<'_>,
        mean: Option<PyReadonlyArray2<'_, f64>>,
        components: Option<PyReadonlyArray3<'_, f64>>,
        coefficients: Option<PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<Self> {
        self.record(py)?;
        let mut parameters = self.0.parameters().map_err(Failure::from)?.clone();
        if let Some(mean) = mean {
            parameters.mean = Some(mean.as_array().to_owned());
        }
        if let Some(components) = components {
            parameters.components = components.as_array().to_owned();
        }
        if let Some(coefficients) = coefficients {
            parameters.coefficients = coefficients.as_array().to_owned();
        }
        self.apart(py, move |psf| psf.with_parameters(parameters))
            .map(Self)
    }

    /// The number of components, or `None` if the samples have not been fitted yet.
    fn rank_if_fitted(&self) -> Option<usize> {
        Some(self.0.record_if_fitted()?.basis().rank())
    }

    /// The report on the fit as JSON. `None` for a model without samples.
    fn fit_report(&self, py: Python<'_>) -> PyResult<Option<String>> {
        let report = self.apart(py, |psf| psf.fit()?.map(Fit::report).transpose())?;
        Ok(report
            .map(|report| serde_json::to_string(&report).expect("every value of the report has a JSON form")))
    }

    /// Evaluates the PSF. Returns stamps `[position, y, x]`.
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray1<'_, f64>,
        y: PyReadonlyArray1<'_, f64>,
        native: bool,
        size: Option<usize>,
        sub_pixel: bool,
    ) -> PyResult<(Cube<'py>, Option<String>)> {
        let at = positions(&x, &y)?;
        let grid = self.0.whole_grid();
        let stamp = size.map_or(grid.pixel_count(), |size| size.saturating_mul(size));
        let bytes = at
            .len()
            .saturating_mul(stamp)
            .saturating_mul(2 * size_of::<f64>());
        // The library refuses more.
        if bytes <= 2 * MAX_STACK_BYTES {
            memory::check("the evaluation", bytes)?;
        }
        let grid = if native {
            OutputGrid::Native
        } else {
            OutputGrid::Model
        };
        let options = EvaluateOptions {
            grid,
            size,
            sub_pixel,
        };
        let (stamps, extrapolation) = self.apart(py, move |psf| {
            let (stamps, _) = evaluate_stamps(psf.model()?, &at, options)?;
            Ok((stamps, psf.extrapolation(&at)))
        })?;
        let warning =
            extrapolation.map(|extrapolation| with_argument(extrapolation.to_string(), Some("outside")));
        Ok((stamps.into_pyarray(py), warning))
    }

    /// Returns a gridded library: stamps, positions (x and y), oversampling, and the largest error
    /// of bilinear interpolation. The error is `None` if the model itself is bilinear there.
    fn gridded<'py>(
        &self,
        py: Python<'py>,
        at: Option<(usize, usize)>,
    ) -> PyResult<(Cube<'py>, Points<'py>, f64, Option<f64>)> {
        let converted = self.apart(py, move |psf| to_gridded(psf, &samples_at(at)))?;
        let samples = converted.samples;
        let oversampling = samples.grid().oversampling();
        Ok((
            samples.stamps().to_owned().into_pyarray(py),
            points(py, samples.positions()),
            oversampling,
            converted.max_error,
        ))
    }

    /// Writes a file. Returns notes for the user, in sentences.
    fn write(&self, py: Python<'_>, path: PathBuf, settings: &Bound<'_, PyMapping>) -> PyResult<Vec<String>> {
        let settings: WriteSettings = from_python(settings)?;
        threads::run(py, None, |_| settings.write(&path, &self.0))?
    }
}

fn sample_positions(
    x: &PyReadonlyArray1<'_, f64>,
    y: &PyReadonlyArray1<'_, f64>,
    states: States,
    field: Option<(usize, usize)>,
) -> PyResult<SamplePositions> {
    let field: Option<FrameShape> = field.map(frame_shape).transpose()?;
    let states = match states {
        Some((kind, values)) => {
            Some(SampleStates::new(parsed::<StateKind>(&kind)?, &values).map_err(Failure::from)?)
        }
        None => None,
    };
    Ok(SamplePositions::with_states(positions(x, y)?, field, states).map_err(Failure::from)?)
}

fn points<'py>(py: Python<'py>, of: &SamplePositions) -> Points<'py> {
    let (x, y): (Vec<f64>, Vec<f64>) = of.as_slice().iter().map(|p| (p.x(), p.y())).unzip();
    (x.into_pyarray(py), y.into_pyarray(py))
}

fn choices_of(record: &PsfModelRecord) -> Choices {
    (
        record.interpolation().to_string(),
        record.outside().to_string(),
        record.normalisation().to_string(),
        record.table_of().map(str::to_owned),
    )
}

/// Stamps `[mode, y, x]` of wings, their coefficients `[sample, mode]`, and their grid.
type GivenWings<'py> = (
    PyReadonlyArray3<'py, f32>,
    PyReadonlyArray2<'py, f64>,
    Bound<'py, PyMapping>,
);

fn wings_of(
    (stamps, coefficients, grid): &GivenWings<'_>,
    positions: SamplePositions,
) -> PyResult<WingsRecord> {
    let (_, ny, nx) = stamps.as_array().dim();
    let grid = from_python::<GridSettings>(grid)?.grid((ny, nx))?;
    let coefficients = SampleCoefficients::new(coefficients.as_array().to_owned(), positions);
    let coefficients = coefficients.map_err(Failure::from)?;
    Ok(WingsRecord::new(stamps.as_array().to_owned(), coefficients, grid).map_err(Failure::from)?)
}

fn arrays_of<'py>(py: Python<'py>, record: &PsfModelRecord) -> Basis<'py> {
    let basis = record.basis();
    (
        basis.mean().map(|mean| mean.to_owned().into_pyarray(py)),
        basis.components().to_owned().into_pyarray(py),
        record.coefficients().values().to_owned().into_pyarray(py),
    )
}

/// Parameters, or derivatives with respect to them.
pub(crate) fn in_arrays(py: Python<'_>, parameters: PsfParameters) -> Basis<'_> {
    (
        parameters.mean.map(|mean| mean.into_pyarray(py)),
        parameters.components.into_pyarray(py),
        parameters.coefficients.into_pyarray(py),
    )
}

/// The arguments of `write` by name.
#[derive(Debug, Deserialize)]
struct WriteSettings {
    format: String,
    /// The degree of PSFEx's polynomial.
    degree: Option<usize>,
    /// (ny, nx) of a grid of positions.
    at: Option<(usize, usize)>,
    /// If true, samples are written in double precision.
    double: bool,
    overwrite: bool,
}

/// The name of the program in the HISTORY card of files that are written.
const COMMAND: &str = "psfield for Python";

impl WriteSettings {
    /// Writes the file. Returns notes for the user, in sentences.
    fn write(&self, path: &Path, psf: &Psf) -> PyResult<Vec<String>> {
        let at = samples_at(self.at);
        let format = match self.format.as_str() {
            "psf-model" => PsfFormat::Model,
            "psf-samples" => PsfFormat::Samples {
                at,
                precision: if self.double {
                    Precision::Double
                } else {
                    Precision::Single
                },
            },
            "psfex" => PsfFormat::Psfex { degree: self.degree },
            "gridded" => PsfFormat::Gridded { at },
            other => {
                let known = "psf-model, psf-samples, psfex or gridded";
                return Err(invalid(format!("format must be {known}, got {other}")));
            }
        };
        let written = psf.write(path, &format, &provenance_cards(COMMAND), self.overwrite);
        Ok(written.map_err(Failure::from)?.notes)
    }
}

/// A grid of (ny, nx) positions, or the PSF's own positions.
fn samples_at(at: Option<(usize, usize)>) -> SamplesAt {
    match at {
        Some((ny, nx)) => SamplesAt::Grid { nx, ny },
        None => SamplesAt::Own,
    }
}
