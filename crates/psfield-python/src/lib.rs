//! The native part of the Python package `psfield`: the module `psfield._native`.
//!
//! This module is a thin layer. It checks arguments, calls [`psfield`] and releases the interpreter
//! while the work runs. Errors become `ValueError` or `OSError` with the texts of the Rust library.
//! The Python code in `python/psfield` handles tables and units, and holds the documentation. Only
//! this code calls the module. It passes arrays of the types that the signatures name.

#![allow(
    clippy::too_many_arguments,
    reason = "each function is called from a single place in Python"
)]

mod arrays;
mod catalog;
mod colour;
mod detector;
mod error;
mod inject;
mod memory;
mod metrics;
mod plan;
mod psf_model;
mod sampling;
mod series;
mod settings;
mod simulators;
mod source_columns;
mod survey;
mod threads;

use pyo3::prelude::*;

/// The native part of psfield. Use the package `psfield`.
#[pymodule]
mod _native {
    #[pymodule_export]
    use crate::catalog::{Sources, catalog_columns, image_cards, knows_sky};
    #[pymodule_export]
    use crate::detector::Detector;
    #[pymodule_export]
    use crate::inject::RealFrame;
    #[pymodule_export]
    use crate::metrics::{
        adaptive_moments, compare, fit_gaussian, measure_image, measure_stamps, quadrupole_moments,
    };
    #[pymodule_export]
    use crate::plan::{Plan, plan_settings};
    #[pymodule_export]
    use crate::psf_model::PsfModel;
    #[pymodule_export]
    use crate::sampling::{sample_function, sample_telescope};
    #[pymodule_export]
    use crate::series::Series;
    #[pymodule_export]
    use crate::survey::Survey;
    #[pymodule_export]
    use crate::threads::{set_threads, threads};

    #[pymodule_init]
    fn init(module: &super::Bound<'_, super::PyModule>) -> super::PyResult<()> {
        use pyo3::types::PyModuleMethods as _;
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("DEFAULTS", crate::settings::defaults(module.py())?)
    }
}
