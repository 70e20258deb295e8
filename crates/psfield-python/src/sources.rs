//! Stars and galaxies from columns of numbers.

use numpy::PyReadonlyArray1;
use psfield::psf_types::{DataError, PointSource, Position, SersicProfile, SersicSource};
use pyo3::prelude::*;

use crate::error::{Failure, invalid};

/// Sources in pixels of the frame.
#[derive(Debug, Default)]
pub(crate) struct Sources {
    pub(crate) stars: Vec<PointSource>,
    pub(crate) galaxies: Vec<SersicSource>,
}

/// The columns of a catalogue, all of one length: a row whose `re` is 0 or NaN is a star.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct SourceColumns<'py> {
    x: PyReadonlyArray1<'py, f64>,
    y: PyReadonlyArray1<'py, f64>,
    flux: PyReadonlyArray1<'py, f64>,
    re: Option<PyReadonlyArray1<'py, f64>>,
    n: Option<PyReadonlyArray1<'py, f64>>,
    q: Option<PyReadonlyArray1<'py, f64>>,
    angle: Option<PyReadonlyArray1<'py, f64>>,
}

impl SourceColumns<'_> {
    /// The sources; the first row that makes none is an error that names it.
    pub(crate) fn sources(&self) -> PyResult<Sources> {
        let (x, y, flux) = (self.x.as_array(), self.y.as_array(), self.flux.as_array());
        let optional = |column: &Option<PyReadonlyArray1<'_, f64>>, otherwise: f64| match column {
            Some(column) => column.as_array().to_vec(),
            None => vec![otherwise; x.len()],
        };
        let (re, n) = (optional(&self.re, 0.0), optional(&self.n, f64::NAN));
        let (q, angle) = (optional(&self.q, 1.0), optional(&self.angle, 0.0));
        for (name, length) in [
            ("y", y.len()),
            ("flux", flux.len()),
            ("re", re.len()),
            ("n", n.len()),
            ("q", q.len()),
            ("angle", angle.len()),
        ] {
            if length != x.len() {
                return Err(invalid(format!(
                    "catalog: {name} has {length} rows, x has {}",
                    x.len()
                )));
            }
        }
        let mut sources = Sources::default();
        for row in 0..x.len() {
            let mut place = || -> Result<(), DataError> {
                let position = Position::new(x[row], y[row])?;
                if re[row] == 0.0 || re[row].is_nan() {
                    sources.stars.push(PointSource::new(position, flux[row])?);
                } else {
                    let profile = SersicProfile::new(re[row], n[row], q[row], angle[row])?;
                    sources
                        .galaxies
                        .push(SersicSource::new(position, flux[row], profile)?);
                }
                Ok(())
            };
            place().map_err(|error| {
                let text = PyErr::from(Failure::from(error));
                Python::attach(|py| invalid(format!("catalog: row {row} (0-based): {}", text.value(py))))
            })?;
        }
        Ok(sources)
    }
}
