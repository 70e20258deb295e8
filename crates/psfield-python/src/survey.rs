//! Surveys: frames of a camera.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use psfield::PsfieldError;
use psfield::psf_io::MemoryTable;
use psfield::survey::{Observer, SurveyFile, SurveyFrame};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::catalog::{Column, memory_table};
use crate::error::{Failure, invalid};
use crate::threads::{self, pool};

/// A survey, and the observer that makes its frames.
#[pyclass(frozen, module = "psfield._native")]
pub(crate) struct Survey {
    shared: Arc<psfield::survey::Survey>,
    /// The thread that makes a frame holds the lock.
    observer: Mutex<Observer>,
}

#[pymethods]
impl Survey {
    /// Takes the JSON of a survey file, whose relative paths refer to `folder`, and the columns of a catalogue in
    /// memory: their names, values and units.
    #[new]
    fn new(
        json: &str,
        folder: PathBuf,
        columns: Option<Vec<(String, Column<'_>, String)>>,
    ) -> PyResult<Self> {
        let table = columns.map(memory_table).transpose()?;
        Self::of(SurveyFile::from_json(json, &folder), table)
    }

    /// Reads a survey file.
    #[staticmethod]
    fn read(path: PathBuf) -> PyResult<Self> {
        Self::of(SurveyFile::read(path), None)
    }

    /// The number of frames.
    fn __len__(&self) -> usize {
        self.shared.frames().len()
    }

    /// The frames: dicts of their properties.
    fn frames<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let frames = self.shared.frames().iter();
        frames.map(|frame| self.frame(py, frame)).collect()
    }

    /// Makes a frame, and returns its report as JSON.
    fn observe(&self, py: Python<'_>, number: usize, overwrite: bool) -> PyResult<String> {
        let report = threads::run_beside(py, None, &*pool()?, |watch, pool| {
            let mut observer = self.observer.lock().unwrap_or_else(PoisonError::into_inner);
            let observer = &mut *observer;
            pool.install(|| observer.observe(number, overwrite, watch))
        })?;
        serde_json::to_string(&report).map_err(|e| invalid(e.to_string()))
    }

    /// Joins the frames of an exposure to one file, if all exist.
    fn join(&self, exposure: &str) -> PyResult<bool> {
        Ok(self.shared.join(exposure).map_err(Failure::from)?)
    }

    /// Writes the list of frames.
    fn write_list(&self, overwrite: bool) -> PyResult<()> {
        Ok(self.shared.write_list(overwrite).map_err(Failure::from)?)
    }
}

impl Survey {
    fn of(file: Result<SurveyFile, PsfieldError>, table: Option<MemoryTable>) -> PyResult<Self> {
        let made = file.and_then(|file| psfield::survey::Survey::with_table(file, table));
        let shared = Arc::new(made.map_err(Failure::from)?);
        Ok(Self {
            observer: Mutex::new(Observer::new(Arc::clone(&shared))),
            shared,
        })
    }

    fn frame<'py>(&self, py: Python<'py>, frame: &SurveyFrame) -> PyResult<Bound<'py, PyDict>> {
        let survey = &self.shared;
        let footprint = survey.footprint(frame, 0.0).map_err(Failure::from)?;
        let header = survey.header(frame).map_err(Failure::from)?;
        let entry = &survey.detectors()[frame.detector].entry;
        let properties = PyDict::new(py);
        properties.set_item("exposure", &frame.exposure)?;
        properties.set_item("detector", &entry.name)?;
        properties.set_item("shape", (entry.shape[1], entry.shape[0]))?;
        properties.set_item("output", frame.output.display().to_string())?;
        properties.set_item("extension", frame.is_extension.then_some(&entry.name))?;
        properties.set_item("band", frame.band.as_ref())?;
        properties.set_item("date", frame.date.as_ref())?;
        properties.set_item("exposure_s", frame.exposure_s)?;
        properties.set_item("seed", frame.seed)?;
        properties.set_item("centre_deg", footprint.centre_deg)?;
        properties.set_item("corners_deg", footprint.corners_deg.to_vec())?;
        properties.set_item("header", header.to_text())?;
        Ok(properties)
    }
}
