//! Catalogues of sources, from files and from columns of numbers.

use std::path::PathBuf;

use numpy::{IntoPyArray, PyReadonlyArray1};
use psfield::colours::spectrum_in;
use psfield::error::error_text;
use psfield::psf_io::{
    Catalog, CatalogOptions, HduChoice, HeaderCards, MemoryTable, NeededColumn, ObservationDate,
    SkyCoordinates, SourceColours, catalog_of, read_cards, read_catalog_with,
};
use psfield::psf_types::{PointSource, SersicSource};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::{Failure, invalid};
use crate::settings::parsed;

/// The cards of an image, from those of a scene that is `oversample` times finer. The first pixel of the
/// image is pixel `first` (x, y) of the whole image. Both are the text of records of 80 characters.
#[pyfunction]
pub(crate) fn image_cards(cards: &str, first: (f64, f64), oversample: usize) -> String {
    let binned = HeaderCards::from_text(cards).binned(oversample);
    binned.shifted_origin(first.0, first.1).to_text()
}

/// The role of a column, its name, and the unit of its values.
type RoleOfColumn = (&'static str, String, Option<&'static str>);

/// The columns that a catalogue with these columns needs: their roles, names and units
/// ([`CatalogOptions::columns_of`]), and the columns that may change a source and are not read.
#[pyfunction]
pub(crate) fn catalog_columns(
    names: Vec<String>,
    spectra: bool,
    velocities: bool,
    wcs_cards: Option<&str>,
) -> PyResult<(Vec<RoleOfColumn>, Vec<String>)> {
    let mut options = CatalogOptions::new()
        .with_colours(spectra)
        .with_velocities(velocities);
    if let Some(cards) = wcs_cards {
        options = options.with_sky(sky_of(&HeaderCards::from_text(cards))?);
    }
    let picked = options.columns_of("catalog", &names);
    let ignored = options.ignored_columns(&names);
    let picked = picked.map_err(|e| invalid(error_text(&e)))?;
    let of = |column: NeededColumn| (column.role, column.name, column.unit);
    Ok((picked.into_iter().map(of).collect(), ignored))
}

pub(crate) fn sky_of(cards: &HeaderCards) -> PyResult<SkyCoordinates> {
    SkyCoordinates::from_header(cards).map_err(|e| invalid(format!("wcs: {}", error_text(&e))))
}

/// Returns whether psfield knows the world coordinates of these cards.
#[pyfunction]
pub(crate) fn knows_sky(cards: &str) -> bool {
    SkyCoordinates::from_header(&HeaderCards::from_text(cards)).is_ok()
}

/// A column of a table in memory, where NaN is a missing number.
#[derive(FromPyObject)]
pub(crate) enum Column<'py> {
    Numbers(PyReadonlyArray1<'py, f64>),
    Texts(Vec<String>),
}

/// Makes a table of columns: their names, values and units. An empty unit is that of the column's role.
pub(crate) fn memory_table<'py>(
    columns: impl IntoIterator<Item = (String, Column<'py>, String)>,
) -> PyResult<MemoryTable> {
    let add = |table: MemoryTable, (name, column, unit): (String, Column<'_>, String)| {
        let table = table.with_unit(&name, &unit);
        match column {
            Column::Numbers(values) => table.with_column(&name, values.as_array().to_vec()),
            Column::Texts(texts) => table.with_texts(&name, texts),
        }
    };
    let table = columns.into_iter().try_fold(MemoryTable::new("catalog"), add);
    table.map_err(|e| invalid(error_text(&e)))
}

/// The arguments of `psfield.read_catalog` that say how a file is read.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
#[allow(clippy::struct_excessive_bools, reason = "the arguments of a Python function")]
pub(crate) struct ReadSettings {
    columns: Option<String>,
    one_based: bool,
    zero_point: Option<f64>,
    skip_invalid: bool,
    table: Option<String>,
    /// A file with world coordinates.
    wcs: Option<PathBuf>,
    wcs_extension: Option<String>,
    /// The text of a header with world coordinates.
    wcs_cards: Option<String>,
    /// The unit of the image.
    flux_unit: Option<String>,
    date: Option<String>,
    epoch: Option<f64>,
    spectra: bool,
    velocities: bool,
}

impl ReadSettings {
    fn options(self) -> PyResult<CatalogOptions> {
        let mut options = CatalogOptions::new()
            .with_one_based(self.one_based)
            .with_invalid_skipped(self.skip_invalid)
            .with_colours(self.spectra)
            .with_velocities(self.velocities);
        if let Some(columns) = self.columns.as_deref() {
            options = options.with_columns(parsed(columns)?);
        }
        if let Some(zero_point) = self.zero_point {
            options = options.with_zero_point(zero_point).map_err(Failure::from)?;
        }
        if let Some(unit) = self.flux_unit {
            options = options.with_flux_unit(unit);
        }
        if let Some(date) = self.date.as_deref() {
            let date: ObservationDate = date.parse().map_err(|e| invalid(format!("date: {e}")))?;
            options = options.with_date(date);
        }
        if let Some(epoch) = self.epoch {
            options = options.with_epoch(epoch);
        }
        if let Some(table) = self.table.as_deref() {
            options = options.with_table(parsed::<HduChoice>(table)?);
        }
        let cards = match (self.wcs, self.wcs_cards.as_deref()) {
            (Some(wcs), _) => {
                let extension = self
                    .wcs_extension
                    .as_deref()
                    .map(parsed::<HduChoice>)
                    .transpose()?;
                Some(read_cards(wcs, extension.as_ref()).map_err(Failure::from)?)
            }
            (None, cards) => cards.map(HeaderCards::from_text),
        };
        if let Some(cards) = cards {
            options = options.with_sky(sky_of(&cards)?);
        }
        Ok(options)
    }
}

/// Stars and galaxies, with positions in pixels of the frame.
#[pyclass(module = "psfield._native", frozen)]
#[derive(Debug, Default)]
pub(crate) struct Sources {
    pub(crate) catalog: Catalog,
    /// The folder in which relative names of spectra begin.
    pub(crate) folder: PathBuf,
}

#[pymethods]
impl Sources {
    /// Takes the sources of columns, which may be some `rows` of a table, and their spectra (`sed`, `teff`)
    /// and velocities (`vx`, `vy`) if there are such columns. `wcs_cards` are the text of a header with the world
    /// coordinates of positions on the sky.
    #[new]
    #[pyo3(signature = (columns, rows=None, wcs_cards=None))]
    fn new(
        columns: Vec<(String, Column<'_>)>,
        rows: Option<Vec<usize>>,
        wcs_cards: Option<&str>,
    ) -> PyResult<Self> {
        let mut options = CatalogOptions::new().with_colours(true).with_velocities(true);
        if let Some(cards) = wcs_cards {
            options = options.with_sky(sky_of(&HeaderCards::from_text(cards))?);
        }
        let table = memory_table(
            columns
                .into_iter()
                .map(|(name, column)| (name, column, String::new())),
        )?;
        let catalog = catalog_of(&table, &options).map_err(|e| invalid(error_text(&e)))?;
        Ok(Self {
            catalog: match rows {
                Some(rows) => catalog.with_rows_of(&rows),
                None => catalog,
            },
            folder: PathBuf::new(),
        })
    }

    /// Reads a catalogue from a file.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf, settings: ReadSettings) -> PyResult<Self> {
        let options = settings.options()?;
        let folder = path.parent().map(PathBuf::from).unwrap_or_default();
        let read = py.detach(|| read_catalog_with(path, &options));
        let catalog = read.map_err(Failure::from)?;
        Ok(Self { catalog, folder })
    }

    /// The number of invalid rows that were skipped, the number of rows that were skipped because the
    /// projection of the frame does not reach their position on the sky, and the columns that change a
    /// source and were not read.
    fn left_out(&self) -> (usize, usize, Vec<String>) {
        let catalog = &self.catalog;
        let ignored = catalog.ignored_columns().to_vec();
        (catalog.invalid_rows(), catalog.rows_off_projection(), ignored)
    }

    /// The columns by name: stars first, whose `re` is 0.
    fn columns<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (stars, galaxies) = (self.catalog.stars(), self.catalog.galaxies());
        let columns = PyDict::new(py);
        let add = |name, of_star: &dyn Fn(&PointSource) -> f64, of_galaxy: fn(&SersicSource) -> f64| {
            let values = stars.iter().map(of_star).chain(galaxies.iter().map(of_galaxy));
            columns.set_item(name, values.collect::<Vec<_>>().into_pyarray(py))
        };
        add("x", &|star| star.position().x(), |galaxy| galaxy.position().x())?;
        add("y", &|star| star.position().y(), |galaxy| galaxy.position().y())?;
        add("flux", &|star| star.flux(), |galaxy| galaxy.flux())?;
        if !galaxies.is_empty() {
            add("re", &|_| 0.0, |galaxy| galaxy.profile().half_light_radius_px())?;
            add("n", &|_| f64::NAN, |galaxy| galaxy.profile().index())?;
            add("q", &|_| 1.0, |galaxy| galaxy.profile().axis_ratio())?;
            add("angle", &|_| 0.0, |galaxy| galaxy.profile().angle_deg())?;
        }
        match self.catalog.colours() {
            Some(SourceColours::Names(names)) => {
                let name = |name: &String| spectrum_in(&self.folder, name);
                columns.set_item("sed", names.iter().map(name).collect::<Vec<_>>())?;
            }
            Some(SourceColours::Temperatures(all)) => {
                columns.set_item("teff", all.clone().into_pyarray(py))?;
            }
            _ => {}
        }
        for (axis, name) in ["vx", "vy"].into_iter().enumerate() {
            if let Some(all) = self.catalog.velocities() {
                let values: Vec<f64> = all.iter().map(|velocity| velocity[axis]).collect();
                columns.set_item(name, values.into_pyarray(py))?;
            }
        }
        Ok(columns)
    }

    fn __len__(&self) -> usize {
        self.catalog.rows().len()
    }
}
