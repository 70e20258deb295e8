//! Settings by name, which cross between Python and the library by serde.

use std::str::FromStr;

use numpy::PyReadonlyArray1;
use psfield::fit::OwnInterpolation;
use psfield::psf_sample::SamplingOptions;
use psfield::psf_types::{FrameShape, Position, Real, StampGrid, StampInterpolation};
use psfield::{FitChoices, FitOptions, PsfFileOptions, PsfieldError, SimulateOptions};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::error::{Failure, invalid, with_argument};

/// Parses a choice from its name.
pub(crate) fn parsed<C>(text: &str) -> PyResult<C>
where
    C: FromStr,
    C::Err: Into<PsfieldError>,
{
    Ok(text.parse().map_err(Failure::from)?)
}

/// Reads settings from Python arguments by name. Errors name the argument.
pub(crate) fn from_python<T: DeserializeOwned>(arguments: &Bound<'_, PyMapping>) -> PyResult<T> {
    let mut all = Map::new();
    for item in arguments.items()? {
        let (name, given): (String, Bound<'_, PyAny>) = item.extract()?;
        let value = plain(&name, &given, MOST_LEVELS)?;
        let problem = |value: Value| {
            let alone = Map::from_iter([(name.clone(), value)]);
            let error = T::deserialize(Value::Object(alone)).err()?.to_string();
            Some(error).filter(|error| !error.starts_with("missing field"))
        };
        if let Some(mut error) = problem(value.clone()) {
            if value.is_array() && error.starts_with("invalid") {
                // This error is of an item. That of a truth value says what the sequence must be.
                error = problem(Value::Bool(false)).unwrap_or(error);
            }
            return Err(refused(&name, &given, error));
        }
        all.insert(name, value);
    }
    T::deserialize(Value::Object(all)).map_err(|error| invalid(error.to_string()))
}

/// No setting has more levels of lists or dicts in one another.
const MOST_LEVELS: usize = 4;

/// Converts an argument to JSON. Numbers of NumPy are numbers.
fn plain(name: &str, given: &Bound<'_, PyAny>, levels: usize) -> PyResult<Value> {
    if given.is_none() {
        return Ok(Value::Null);
    }
    if let Ok(text) = given.extract::<String>() {
        return Ok(text.into());
    }
    if let Ok(truth) = given.extract::<bool>() {
        return Ok(truth.into());
    }
    if let Ok(whole) = given.call_method0("__index__") {
        let number = whole.extract().map(|number: i64| number.into());
        let number = number.or_else(|_| whole.extract().map(|number: u64| number.into()));
        return number.map_err(|_| {
            let limit = match whole.lt(0) {
                Ok(true) => format!("at least {}", i64::MIN),
                _ => format!("at most {}", u64::MAX),
            };
            invalid(format!("{name} must be {limit}, got {whole}"))
        });
    }
    if levels == 0 && given.len().is_ok() {
        return Err(invalid(format!(
            "{name} has lists in lists: it must be one value or a few"
        )));
    }
    if let Ok(mapping) = given.cast::<PyMapping>() {
        let items: Vec<(String, Bound<'_, PyAny>)> = mapping.items()?.extract()?;
        let field = |(key, item): (String, _)| plain(&key, &item, levels - 1).map(|value| (key, value));
        return items.into_iter().map(field).collect();
    }
    if given.len().is_ok()
        && let Ok(items) = given.try_iter()
    {
        return items.map(|item| plain(name, &item?, levels - 1)).collect();
    }
    match given.extract::<f64>() {
        Ok(number) if number.is_finite() => Ok(number.into()),
        Ok(_) => Err(invalid(format!("{name} must be finite, got {given}"))),
        // No setting accepts this value.
        Err(_) => Ok(Value::Array(vec![Value::Null])),
    }
}

/// Makes the exception for an argument that serde refused.
fn refused(name: &str, given: &Bound<'_, PyAny>, error: String) -> PyErr {
    let of_type = error.split_once(", expected ");
    let Some((problem, expected)) = of_type.filter(|_| error.starts_with("invalid")) else {
        let argument = Some(name).filter(|name| !error.starts_with(name));
        return invalid(with_argument(error, argument));
    };
    let wrong_type = !problem.starts_with("invalid value");
    let expected = match expected {
        "f64" => "a number",
        "a boolean" => "True or False",
        "a tuple of size 2" => "two numbers (x, y)",
        "a tuple of size 4" => "(x0, y0, nx, ny), four integers",
        "a nonzero usize" if !wrong_type => "at least 1",
        _ if problem.starts_with("invalid value: integer `-") => "at least 0",
        "usize" | "u64" | "u32" | "a nonzero usize" if wrong_type => "an integer",
        "usize" | "u64" | "u32" => "smaller",
        other if other.starts_with("struct ") => "a mapping",
        other => other,
    };
    let Ok(got) = given.repr() else {
        return invalid(error);
    };
    let each = if given.cast::<PyMapping>().is_ok() {
        "each value of "
    } else {
        ""
    };
    let text = format!("{each}{name} must be {expected}, got {got}");
    if wrong_type {
        PyTypeError::new_err(text)
    } else {
        invalid(text)
    }
}

/// Returns settings by name as a Python dict.
pub(crate) fn to_python<'py>(py: Python<'py>, settings: &impl Serialize) -> PyResult<Bound<'py, PyDict>> {
    let text = serde_json::to_string(settings).expect("settings have a JSON form");
    Ok(py.import("json")?.call_method1("loads", (text,))?.cast_into()?)
}

/// The geometry of stamps: the relation between their pixels and the frame's pixels.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct GridSettings {
    oversampling: f64,
    centre: Option<Position>,
    pixel_response_included: bool,
    stamp_interpolation: StampInterpolation,
}

impl GridSettings {
    /// The grid for stamps of `(ny, nx)` pixels.
    pub(crate) fn grid(&self, (ny, nx): (usize, usize)) -> PyResult<StampGrid> {
        let made = || {
            let grid = StampGrid::new(nx, ny)?.with_oversampling(self.oversampling)?;
            match self.centre {
                Some(centre) => grid.with_centre(centre.x(), centre.y()),
                None => Ok(grid),
            }
        };
        Ok(made()
            .map_err(Failure::from)?
            .with_pixel_response_included(self.pixel_response_included)
            .with_interpolation(self.stamp_interpolation))
    }

    /// The settings of a grid.
    pub(crate) fn of(grid: StampGrid) -> PyResult<Self> {
        let centre = Position::new(grid.centre_x(), grid.centre_y()).map_err(Failure::from)?;
        Ok(Self {
            oversampling: grid.oversampling(),
            centre: Some(centre),
            pixel_response_included: grid.pixel_response_included(),
            stamp_interpolation: grid.interpolation(),
        })
    }
}

/// Makes a shape from `(ny, nx)`, the order of NumPy.
pub(crate) fn frame_shape((ny, nx): (usize, usize)) -> PyResult<FrameShape> {
    Ok(FrameShape::new(nx, ny).map_err(Failure::from)?)
}

/// Makes positions from columns x and y of the same length.
pub(crate) fn positions(
    x: &PyReadonlyArray1<'_, f64>,
    y: &PyReadonlyArray1<'_, f64>,
) -> PyResult<Vec<Position>> {
    let (x, y) = (x.as_array(), y.as_array());
    if x.len() != y.len() {
        return Err(invalid(format!(
            "x and y must have the same length, got {} and {}",
            x.len(),
            y.len()
        )));
    }
    let made: Result<_, _> = x.iter().zip(y).map(|(&x, &y)| Position::new(x, y)).collect();
    Ok(made.map_err(Failure::from)?)
}

/// The defaults of the library by the names of the Python arguments, for each kind of settings.
pub(crate) fn defaults(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    let sampling = SamplingOptions::default();
    let others = json!({
        "precision": f32::NAME,
        "table_error": OwnInterpolation::TABLE_ERROR,
        "measure": sampling.measure.to_string(),
        "threshold": sampling.threshold,
        "max_draws": sampling.max_draws,
        "seed": sampling.seed,
    });
    let grid = StampGrid::new(1, 1).map_err(Failure::from)?;
    let kinds = json!({
        "plan": SimulateOptions::default(),
        "fit": FitChoices::from(FitOptions::default()),
        "file": PsfFileOptions::default(),
        "grid": GridSettings::of(grid)?,
        "others": others,
    });
    to_python(py, &kinds)
}
