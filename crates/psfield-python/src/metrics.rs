//! Measurements of stamps and images.

use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyReadonlyArrayDyn};
use psfield::measure::{MeasureOptions, Measurement};
use psfield::metrics::{AdaptiveMomentFinder, Comparison, GaussianFitter, QuadrupoleMoments, Window};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::Failure;
use crate::settings::positions;
use crate::threads;

/// Measured values by name.
type Measured<'py> = PyResult<Bound<'py, PyDict>>;

/// Returns a window of `size` x `size` pixels about the middle of the stamp, or about the pixel
/// (column, row). Without a size, returns the whole stamp.
fn window(size: Option<usize>, about: Option<(usize, usize)>) -> Window {
    match (size, about) {
        (None, _) => Window::whole(),
        (Some(size), None) => Window::central(size),
        (Some(size), Some((column, row))) => Window::about(size, column, row),
    }
}

fn by_name<'py>(py: Python<'py>, named: &[(&str, f64)]) -> Measured<'py> {
    let by_name = PyDict::new(py);
    for (name, value) in named {
        by_name.set_item(name, value)?;
    }
    Ok(by_name)
}

/// Fits a Gaussian to a stamp.
#[pyfunction]
pub(crate) fn fit_gaussian<'py>(
    py: Python<'py>,
    stamp: PyReadonlyArray2<'py, f64>,
    size: Option<usize>,
    about: Option<(usize, usize)>,
    background: bool,
    round: bool,
) -> Measured<'py> {
    let fitter = if round {
        GaussianFitter::round()
    } else {
        GaussianFitter::elliptical()
    };
    let fit = fitter
        .with_background(background)
        .with_window(window(size, about))
        .fit(stamp.as_array())
        .map_err(Failure::from)?;
    let named = [
        ("flux", fit.flux()),
        ("amplitude", fit.amplitude()),
        ("x", fit.x_centroid()),
        ("y", fit.y_centroid()),
        ("fwhm", fit.fwhm_px()),
        ("fwhm_major", fit.fwhm_major_px()),
        ("fwhm_minor", fit.fwhm_minor_px()),
        ("angle", fit.angle_rad()),
        ("eccentricity", fit.eccentricity()),
        ("residual_rms", fit.residual_rms()),
    ];
    let found = by_name(py, &named)?;
    found.set_item("background", fit.background())?;
    Ok(found)
}

/// Measures the adaptive moments of a stamp, as HSM does in GalSim.
#[pyfunction]
pub(crate) fn adaptive_moments<'py>(
    py: Python<'py>,
    stamp: PyReadonlyArray2<'py, f64>,
    size: Option<usize>,
    about: Option<(usize, usize)>,
    start: Option<(f64, f64, f64)>,
) -> Measured<'py> {
    let mut finder = AdaptiveMomentFinder::new().with_window(window(size, about));
    if let Some((x, y, sigma)) = start {
        finder = finder.with_start(x, y, sigma);
    }
    let moments = finder.measure(stamp.as_array()).map_err(Failure::from)?;
    let named = [
        ("amplitude", moments.amplitude()),
        ("x", moments.x_centroid()),
        ("y", moments.y_centroid()),
        ("sigma", moments.sigma_px()),
        ("e1", moments.e1()),
        ("e2", moments.e2()),
        ("g1", moments.g1()),
        ("g2", moments.g2()),
    ];
    by_name(py, &named)
}

/// Measures unweighted second moments of a stamp.
#[pyfunction]
pub(crate) fn quadrupole_moments<'py>(
    py: Python<'py>,
    stamp: PyReadonlyArray2<'py, f64>,
    size: Option<usize>,
    about: Option<(usize, usize)>,
) -> Measured<'py> {
    let moments = QuadrupoleMoments::measure(stamp.as_array(), window(size, about)).map_err(Failure::from)?;
    let named = [
        ("flux", moments.flux()),
        ("x", moments.x_centroid()),
        ("y", moments.y_centroid()),
        ("sigma", moments.sigma_px()),
        ("e1", moments.e1()),
        ("e2", moments.e2()),
        ("g1", moments.g1()),
        ("g2", moments.g2()),
    ];
    by_name(py, &named)
}

/// Compares two arrays of the same shape. Undefined values are `None`.
#[pyfunction]
pub(crate) fn compare<'py>(
    py: Python<'py>,
    result: PyReadonlyArrayDyn<'py, f64>,
    reference: PyReadonlyArrayDyn<'py, f64>,
) -> Measured<'py> {
    let (result, reference) = (result.as_array(), reference.as_array());
    let found = py
        .detach(|| Comparison::of(result, reference))
        .map_err(Failure::from)?;
    let errors = [
        ("mae", found.mae()),
        ("mse", found.mse()),
        ("max_abs", found.max_abs()),
    ];
    let named = by_name(py, &errors)?;
    named.set_item("max_abs_index", found.max_abs_index())?;
    named.set_item("relative_l2", found.relative_l2().ok())?;
    named.set_item("max_over_peak", found.max_over_peak().ok())?;
    named.set_item("mae_over_mean", found.mae_over_mean().ok())?;
    named.set_item("snr_db", found.snr_db().ok())?;
    Ok(named)
}

/// Measures sizes and shapes of every plane of a cube. Returns JSON.
#[pyfunction]
pub(crate) fn measure_stamps(
    py: Python<'_>,
    stamps: PyReadonlyArray3<'_, f64>,
    size: Option<usize>,
    background: bool,
) -> PyResult<String> {
    let stamps = stamps.as_array();
    let options = MeasureOptions {
        window: size,
        background,
    };
    Ok(json(&threads::run(py, None, |_| options.cube(stamps, None))?))
}

/// Measures sizes and shapes in a window about each position of an image. Returns JSON.
#[pyfunction]
pub(crate) fn measure_image(
    py: Python<'_>,
    image: PyReadonlyArray2<'_, f64>,
    x: PyReadonlyArray1<'_, f64>,
    y: PyReadonlyArray1<'_, f64>,
    size: Option<usize>,
    background: bool,
) -> PyResult<String> {
    let image = image.as_array();
    let at = positions(&x, &y)?;
    let options = MeasureOptions {
        window: size,
        background,
    };
    Ok(json(&threads::run(py, None, |_| options.image(image, &at))?))
}

fn json(measurements: &[Measurement]) -> String {
    serde_json::to_string(measurements).expect("measurements are plain numbers")
}
