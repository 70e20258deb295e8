//! Catalogues of sources, from files and from columns of numbers.

use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use psfield::psf_io::{
    CatalogOptions, HduChoice, HeaderCards, SkyCoordinates, read_cards, read_catalog_with,
};
use psfield::psf_types::{DataError, PointSource, Position, SersicProfile, SersicSource};
use pyo3::prelude::*;

use crate::error::{Failure, invalid};
use crate::settings::parsed;

/// A column of doubles.
type Column<'py> = Bound<'py, PyArray1<f64>>;

/// Stars `(x, y, flux)`, galaxies `(x, y, flux, re, n, q, angle)`, the number of invalid rows that
/// were skipped, and the number of rows that were skipped because the projection of the frame does
/// not reach their position on the sky.
type Read<'py> = ([Column<'py>; 3], [Column<'py>; 7], usize, usize);

/// The cards of an image, from those of a scene that is `oversample` times finer. The first pixel of the
/// image is pixel `first` (x, y) of the whole image. Both are the text of records of 80 characters.
#[pyfunction]
pub(crate) fn image_cards(cards: &str, first: (f64, f64), oversample: usize) -> String {
    let binned = HeaderCards::from_text(cards).binned(oversample);
    binned.shifted_origin(first.0, first.1).to_text()
}

/// Reads a catalogue from a file. `wcs` is a file with world coordinates, `wcs_cards` the text of such a
/// header.
#[pyfunction]
pub(crate) fn read_catalog<'py>(
    py: Python<'py>,
    path: PathBuf,
    columns: Option<&str>,
    one_based: bool,
    zero_point: Option<f64>,
    skip_invalid: bool,
    table: Option<&str>,
    wcs: Option<PathBuf>,
    wcs_extension: Option<&str>,
    wcs_cards: Option<&str>,
) -> PyResult<Read<'py>> {
    let mut options = CatalogOptions::new()
        .with_one_based(one_based)
        .with_invalid_skipped(skip_invalid);
    if let Some(columns) = columns {
        options = options.with_columns(parsed(columns)?);
    }
    if let Some(zero_point) = zero_point {
        options = options.with_zero_point(zero_point).map_err(Failure::from)?;
    }
    if let Some(table) = table {
        options = options.with_table(parsed::<HduChoice>(table)?);
    }
    let cards = match (wcs, wcs_cards) {
        (Some(wcs), _) => {
            let extension = wcs_extension.map(parsed::<HduChoice>).transpose()?;
            Some(read_cards(wcs, extension.as_ref()).map_err(Failure::from)?)
        }
        (None, cards) => cards.map(HeaderCards::from_text),
    };
    if let Some(cards) = cards {
        options = options.with_sky(
            SkyCoordinates::from_header(&cards)
                .map_err(|e| invalid(format!("wcs: {}", psfield::error_text(&e))))?,
        );
    }
    let catalog = py
        .detach(|| read_catalog_with(path, &options))
        .map_err(Failure::from)?;
    let skipped = (catalog.invalid_rows(), catalog.rows_off_projection());
    let (stars, galaxies) = catalog.into_parts();
    let of_star = |value: fn(&PointSource) -> f64| -> Column<'py> {
        stars.iter().map(value).collect::<Vec<_>>().into_pyarray(py)
    };
    let of_galaxy = |value: fn(&SersicSource) -> f64| -> Column<'py> {
        galaxies.iter().map(value).collect::<Vec<_>>().into_pyarray(py)
    };
    let star_columns = [
        of_star(|star| star.position().x()),
        of_star(|star| star.position().y()),
        of_star(|star| star.flux()),
    ];
    let galaxy_columns = [
        of_galaxy(|galaxy| galaxy.position().x()),
        of_galaxy(|galaxy| galaxy.position().y()),
        of_galaxy(|galaxy| galaxy.flux()),
        of_galaxy(|galaxy| galaxy.profile().half_light_radius_px()),
        of_galaxy(|galaxy| galaxy.profile().index()),
        of_galaxy(|galaxy| galaxy.profile().axis_ratio()),
        of_galaxy(|galaxy| galaxy.profile().angle_deg()),
    ];
    Ok((star_columns, galaxy_columns, skipped.0, skipped.1))
}

/// Stars and galaxies, with positions in pixels of the frame.
#[derive(Debug, Default)]
pub(crate) struct Sources {
    pub(crate) stars: Vec<PointSource>,
    pub(crate) galaxies: Vec<SersicSource>,
}

/// The columns of a catalogue, all of the same length. A row whose `re` is 0 is a star.
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
    g1: Option<PyReadonlyArray1<'py, f64>>,
    g2: Option<PyReadonlyArray1<'py, f64>>,
}

impl SourceColumns<'_> {
    /// Makes the sources from the columns.
    ///
    /// # Errors
    /// `ValueError` that names the first invalid row, or a column whose length differs from x.
    pub(crate) fn sources(&self) -> PyResult<Sources> {
        let (x, y, flux) = (self.x.as_array(), self.y.as_array(), self.flux.as_array());
        let optional = |column: &Option<PyReadonlyArray1<'_, f64>>, otherwise: f64| match column {
            Some(column) => column.as_array().to_vec(),
            None => vec![otherwise; x.len()],
        };
        let (re, n) = (optional(&self.re, 0.0), optional(&self.n, f64::NAN));
        let (q, angle) = (optional(&self.q, 1.0), optional(&self.angle, 0.0));
        let (g1, g2) = (optional(&self.g1, 0.0), optional(&self.g2, 0.0));
        for (name, length) in [
            ("y", y.len()),
            ("flux", flux.len()),
            ("re", re.len()),
            ("n", n.len()),
            ("q", q.len()),
            ("angle", angle.len()),
            ("g1", g1.len()),
            ("g2", g2.len()),
        ] {
            if length != x.len() {
                return Err(invalid(format!(
                    "catalog: {name} has {length} rows, but x has {}",
                    x.len()
                )));
            }
        }
        let mut sources = Sources::default();
        for row in 0..x.len() {
            let mut place = || -> Result<(), DataError> {
                let position = Position::new(x[row], y[row])?;
                if flux[row] == 0.0 {
                    return Err(DataError::setting("the flux", "other than 0", flux[row]));
                }
                if re[row].is_nan() {
                    let allowed = "a number of pixels (0 for a star)";
                    return Err(DataError::setting("the half-light radius re", allowed, "none"));
                }
                if re[row] == 0.0 {
                    sources.stars.push(PointSource::new(position, flux[row])?);
                } else {
                    let profile = SersicProfile::new(re[row], n[row], q[row], angle[row])?;
                    let profile = profile.sheared(g1[row], g2[row])?;
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
