//! Catalogues of sources, from files and from columns of numbers.

use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use psfield::psf_io::{
    CatalogColumns, CatalogOptions, HduChoice, HeaderCards, NeededColumn, NumberTable, SkyCoordinates,
    catalog_of, read_cards, read_catalog_with,
};
use psfield::psf_types::{PointSource, SersicSource};
use pyo3::prelude::*;

use crate::error::{Failure, invalid};
use crate::settings::parsed;

/// A column of doubles.
type Column<'py> = Bound<'py, PyArray1<f64>>;

/// Stars `(x, y, flux)`, galaxies `(x, y, flux, re, n, q, angle)`, the number of invalid rows that
/// were skipped, the number of rows that were skipped because the projection of the frame does
/// not reach their position on the sky, and the columns that change a source and were not read.
type Read<'py> = ([Column<'py>; 3], [Column<'py>; 7], usize, usize, Vec<String>);

/// The cards of an image, from those of a scene that is `oversample` times finer. The first pixel of the
/// image is pixel `first` (x, y) of the whole image. Both are the text of records of 80 characters.
#[pyfunction]
pub(crate) fn image_cards(cards: &str, first: (f64, f64), oversample: usize) -> String {
    let binned = HeaderCards::from_text(cards).binned(oversample);
    binned.shifted_origin(first.0, first.1).to_text()
}

/// Reads a catalogue from a file. `wcs` is a file with world coordinates, `wcs_cards` the text of such a
/// header. `flux_unit` is the unit of the image.
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
    flux_unit: Option<&str>,
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
    if let Some(unit) = flux_unit {
        options = options.with_flux_unit(unit);
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
                .map_err(|e| invalid(format!("wcs: {}", psfield::error::error_text(&e))))?,
        );
    }
    let catalog = py
        .detach(|| read_catalog_with(path, &options))
        .map_err(Failure::from)?;
    let skipped = (catalog.invalid_rows(), catalog.rows_off_projection());
    let ignored = catalog.ignored_columns().to_vec();
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
    Ok((star_columns, galaxy_columns, skipped.0, skipped.1, ignored))
}

/// The role of a column, its name, and the unit of its values.
type RoleOfColumn = (&'static str, String, Option<&'static str>);

/// The columns that a catalogue with these columns needs: their roles, names and units (`pix`, `deg`, `mag`, an
/// empty text for numbers without a unit, or `None` for a flux), and the columns that may change a source and
/// are not read.
#[pyfunction]
pub(crate) fn catalog_columns(names: Vec<String>) -> PyResult<(Vec<RoleOfColumn>, Vec<String>)> {
    let picked = CatalogColumns::default().columns_of("catalog", &names);
    let ignored = CatalogOptions::new().ignored_columns(&names);
    let picked = picked.map_err(|e| invalid(psfield::error::error_text(&e)))?;
    let of = |column: NeededColumn| (column.role, column.name, column.unit);
    Ok((picked.into_iter().map(of).collect(), ignored))
}

/// Stars and galaxies, with positions in pixels of the frame.
#[pyclass(module = "psfield._native", frozen)]
#[derive(Debug, Default)]
pub(crate) struct Sources {
    pub(crate) stars: Vec<PointSource>,
    pub(crate) galaxies: Vec<SersicSource>,
}

#[pymethods]
impl Sources {
    /// Takes the sources of columns of numbers, where NaN is a missing value.
    #[new]
    fn new(columns: Vec<(String, PyReadonlyArray1<'_, f64>)>) -> PyResult<Self> {
        let made = || {
            let mut table = NumberTable::new("catalog");
            for (name, values) in &columns {
                table = table.with_column(name, values.as_array().to_vec())?;
            }
            catalog_of(&table, &CatalogOptions::new())
        };
        let catalog = made().map_err(|e| invalid(psfield::error::error_text(&e)))?;
        let (stars, galaxies) = catalog.into_parts();
        Ok(Self { stars, galaxies })
    }

    fn __len__(&self) -> usize {
        self.stars.len() + self.galaxies.len()
    }
}
