//! Detectors.

use std::path::PathBuf;

use numpy::{Element, IntoPyArray, PyArray2, PyReadonlyArray2};
use psfield::PsfieldError;
use psfield::detector::{self, BadPixelMask, DetectorParams, Exposure};
use psfield::psf_types::{Image, Real};
use pyo3::prelude::*;
use pyo3::types::PyMapping;

use crate::error::Failure;
use crate::settings::from_python;
use crate::threads;

/// A detector: it converts light to counts in several steps.
#[pyclass(frozen, module = "psfield._native")]
pub(crate) struct Detector(pub(crate) detector::Detector);

/// Counts, flags and the report as JSON.
pub(crate) type Exposed<'py> = (Bound<'py, PyAny>, Bound<'py, PyArray2<u8>>, String);

#[pymethods]
impl Detector {
    /// A detector from its parameters by name. The names are the same as in the TOML file.
    #[new]
    fn new(params: &Bound<'_, PyMapping>) -> PyResult<Self> {
        let params: DetectorParams = from_python(params)?;
        Ok(Self(detector::Detector::new(params).map_err(Failure::from)?))
    }

    /// A detector from a TOML file.
    #[staticmethod]
    fn from_toml(path: PathBuf) -> PyResult<Self> {
        let detector = detector::Detector::from_toml_file(path);
        Ok(Self(detector.map_err(Failure::from)?))
    }

    /// All parameters as JSON.
    fn params(&self) -> String {
        serde_json::to_string(self.0.params()).expect("parameters are plain numbers")
    }

    /// The unit of the counts: `electron` or `adu`.
    fn unit(&self) -> String {
        self.0.unit().to_string()
    }

    /// The noise of a dark pixel, in the unit of the image's flux.
    fn noise(&self) -> f64 {
        self.0.noise()
    }

    /// The count at which pixels saturate, if they do.
    fn saturation(&self) -> Option<f64> {
        self.0.saturation()
    }

    /// Exposes an image.
    fn expose<'py>(
        &self,
        py: Python<'py>,
        image: Bound<'py, PyAny>,
        seed: u64,
        bad_pixels: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Exposed<'py>> {
        let mask = bad_pixels.map(|mask| BadPixelMask::new(mask.as_array()));
        let mask = mask.transpose().map_err(Failure::from)?;
        if let Ok(single) = image.extract::<PyReadonlyArray2<'py, f32>>() {
            return self.exposed(py, &single, seed, mask.as_ref());
        }
        let double: PyReadonlyArray2<'py, f64> = image.extract()?;
        self.exposed(py, &double, seed, mask.as_ref())
    }
}

impl Detector {
    fn exposed<'py, T: Real + Element>(
        &self,
        py: Python<'py>,
        image: &PyReadonlyArray2<'py, T>,
        seed: u64,
        mask: Option<&BadPixelMask>,
    ) -> PyResult<Exposed<'py>> {
        let pixels = image.as_array();
        let made = threads::run(py, None, |_| -> Result<_, PsfieldError> {
            let light = Image::new(pixels.to_owned())?;
            let mut exposer = self.0.exposer(light.shape(), seed)?;
            if let Some(mask) = mask {
                exposer = exposer.with_mask(mask)?;
            }
            Ok(exposer.expose(&light)?)
        })?;
        Ok(exposure_in_python(py, made.map_err(Failure::from)?))
    }
}

/// Converts counts, flags and the report.
pub(crate) fn exposure_in_python<T: Real + Element>(py: Python<'_>, exposure: Exposure<T>) -> Exposed<'_> {
    let report = serde_json::to_string(exposure.report()).expect("the report is plain numbers");
    let (counts, flags) = exposure.into_counts_and_flags();
    let counts = counts.into_pixels().into_pyarray(py).into_any();
    (counts, flags.into_pyarray(py), report)
}
