//! Catalogues from files.

use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray1};
use psfield::psf_io::{CatalogOptions, HduChoice, SkyCoordinates, read_cards, read_catalog_with};
use pyo3::prelude::*;

use crate::choices::parsed;
use crate::error::{Failure, invalid};

/// A column of doubles.
type Column<'py> = Bound<'py, PyArray1<f64>>;

/// Stars `(x, y, flux)`, galaxies `(x, y, flux, re, n, q, angle)`, rows left out as invalid, and rows off the projection.
type Read<'py> = ([Column<'py>; 3], [Column<'py>; 7], usize, usize);

/// Reads a catalogue as the command line does.
#[pyfunction]
#[pyo3(signature = (path, columns, one_based, zero_point, skip_invalid, table, wcs, wcs_extension))]
#[allow(
    clippy::too_many_arguments,
    reason = "called by name from one place in Python"
)]
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
    if let Some(wcs) = wcs {
        let extension = wcs_extension.map(parsed::<HduChoice>).transpose()?;
        let cards = read_cards(wcs, extension.as_ref()).map_err(Failure::from)?;
        options = options.with_sky(
            SkyCoordinates::from_header(&cards)
                .map_err(|e| invalid(format!("wcs: {}", psfield::error_text(&e))))?,
        );
    }
    let catalog = py
        .detach(|| read_catalog_with(path, &options))
        .map_err(Failure::from)?;
    let left_out = (catalog.invalid_rows(), catalog.rows_off_projection());
    let (stars, galaxies) = catalog.into_parts();
    let column = |values: Vec<f64>| values.into_pyarray(py);
    let of_stars = [
        stars.iter().map(|s| s.position().x()).collect(),
        stars.iter().map(|s| s.position().y()).collect(),
        stars.iter().map(|s| s.flux()).collect(),
    ];
    let of_galaxies = [
        galaxies.iter().map(|g| g.position().x()).collect(),
        galaxies.iter().map(|g| g.position().y()).collect(),
        galaxies.iter().map(|g| g.flux()).collect(),
        galaxies
            .iter()
            .map(|g| g.profile().half_light_radius_px())
            .collect(),
        galaxies.iter().map(|g| g.profile().index()).collect(),
        galaxies.iter().map(|g| g.profile().axis_ratio()).collect(),
        galaxies.iter().map(|g| g.profile().angle_deg()).collect(),
    ];
    Ok((
        of_stars.map(column),
        of_galaxies.map(column),
        left_out.0,
        left_out.1,
    ))
}
