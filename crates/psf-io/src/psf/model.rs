//! PSF models: the `psf-model` layout.
//!
//! # Layout
//!
//! | HDU | content |
//! |---|---|
//! | 0, primary | double cube `[plane, y, x]`: the mean stamp if `CENTRED` is `T`, then the `NCOMP` orthonormal basis stamps |
//! | `COEFFS`, binary table | columns `X`, `Y` (doubles, 0-based pixels of the frame) and `A` (`NCOMP` doubles; absent for `NCOMP = 0`): one row per sample. Version 2: a column `WAVELENGTH`, `TIME`, `FRAME` or `SPECTRUM` as in [`psf-samples`](crate::samples), after `Y` |
//! | `SINGULAR`, binary table | optional: column `S`, the leading singular values of the fit (doubles) |
//! | `WINGS`, image | version 3: single-precision cube `[mode, y, x]`, the stamps of the wings, with the keywords `OVERSAMP`, `CENX`, `CENY`, `PIXCONV` and `STAMPINT` of their own |
//! | `WINGCOEF`, binary table | version 3: column `B`, one double for each of these stamps: the coefficients of the wings at the samples, in the order of `COEFFS` |
//!
//! | keyword of HDU 0 | meaning |
//! |---|---|
//! | `PSFMODEL` | version of the layout: 1, 2 if the PSF depends on more than the position, or 3 if it has wings |
//! | `NCOMP` | number of components `K` |
//! | `CENTRED` | `T` if plane 0 is the mean stamp, `F` (default) if there is none |
//! | `INTERPOL` | `auto`, `delaunay`, `natural-neighbour`, `idw`, `idw=POWER` (the last three on a tree of cells, see the crate `coeff-field`), `bilinear`, `bicubic`, `kriging=KERNEL,LENGTH_X,LENGTH_Y,TREND,NUGGET`, `polynomial=DEGREE`, `nearest` or `table=COLUMNS,ROWS` (the rows of `COEFFS` are the nodes of a table) |
//! | `TABLEOF` | optional: the method whose values are in the table |
//! | `OUTSIDE` | policy outside the area that the samples cover: `nearest`, `extend` or `error` |
//! | `NORMALIS` | `unit` (every PSF is scaled to unit flux) or `keep` |
//! | `CIRCERR` | optional: largest error of the flux in circles about the source at the samples, relative to the total flux, that the components left out cause |
//! | `OVERSAMP`, `CENX`, `CENY`, `PIXCONV`, `STAMPINT`, `FIELDNX`, `FIELDNY` | as in [`psf-samples`](crate::samples) |
//!
//! A model without wings whose PSF depends on the position only is always written as version 1.
//!
//! If there are wings, `basis[k]` is the basis of the PSF's core, and the wings, `sum_k B[k] * wings[k]`, are
//! added to the core with the centres of both on each other.
//!
//! The PSF at a sample is `mean + sum_k A[k] * basis[k]`, scaled to unit flux if `NORMALIS` is
//! `unit`. Without a mean stamp, `mean` is 0. Every number is read back bit by bit, because doubles
//! in the header are written with as many digits as needed.
//!
//! A model made in Python:
//!
//! ```python
//! from astropy.io import fits
//! primary = fits.PrimaryHDU(numpy.concatenate([mean[None], basis]))        # float64, basis[k, y, x] orthonormal
//! primary.header.update(PSFMODEL=1, NCOMP=len(basis), CENTRED=True,
//!                       INTERPOL="natural-neighbour", OUTSIDE="nearest", NORMALIS="unit")
//! columns = [fits.Column("X", "D", array=x), fits.Column("Y", "D", array=y),
//!            fits.Column("A", f"{len(basis)}D", array=a)]                   # a[sample, k]
//! fits.HDUList([primary, fits.BinTableHDU.from_columns(columns, name="COEFFS")]).writeto("model.fits")
//! ```

use std::path::Path;

use ndarray::{Array2, Axis, s};
use psf_types::{Interpolation, PsfBasis, PsfModelRecord, SampleCoefficients, SamplePositions, WingsRecord};

use crate::error::{IoError, IoErrorKind, Row, invalid};
use crate::fits::card::{Card, CardValue};
use crate::fits::columns::{Table, bad_value};
use crate::fits::hdu::Hdu;
use crate::fits::header_cards::HeaderCards;
use crate::fits::image::{read_stack, stack_shape};
use crate::fits::image_out::{cards, write_fits, write_image_hdu};
use crate::fits::structure::FitsStructure;
use crate::psf::position_table::{position_columns, read_positions_of, write_positions_of};
use crate::psf::samples::{field, grid_cards, stamp_grid};

/// The keyword that identifies a PSF model.
const VERSION_KEYWORD: &str = "PSFMODEL";
/// The newest version of the layout that this crate can read.
pub const MODEL_VERSION: i64 = 3;
const CIRCLE_ERROR: &str = "CIRCERR";
const TABLE_OF: &str = "TABLEOF";
const COEFFICIENTS: &str = "COEFFS";
const SINGULAR_VALUES: &str = "SINGULAR";
const WINGS: &str = "WINGS";
const WING_COEFFICIENTS: &str = "WINGCOEF";

/// The content of a `psf-model` file.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelFile {
    record: PsfModelRecord,
    singular_values: Vec<f64>,
    header: HeaderCards,
}

impl ModelFile {
    /// The model.
    pub fn record(&self) -> &PsfModelRecord {
        &self.record
    }

    /// The singular values of the fit. Empty if the file has none.
    pub fn singular_values(&self) -> &[f64] {
        &self.singular_values
    }

    /// The cards of the primary header, without those about the structure of the file.
    pub fn header(&self) -> &HeaderCards {
        &self.header
    }

    /// Returns the model without a copy.
    pub fn into_record(self) -> PsfModelRecord {
        self.record
    }
}

/// Returns whether a file is marked as a PSF model of any version.
pub(crate) fn is_model(structure: &FitsStructure) -> bool {
    structure.hdus[0].header.get(VERSION_KEYWORD).is_some()
}

/// Reads a PSF model in the [`psf-model` layout](self).
///
/// # Errors
/// The errors of [`read_model_file`].
pub fn read_model(path: impl AsRef<Path>) -> Result<PsfModelRecord, IoError> {
    read_model_file(path).map(ModelFile::into_record)
}

/// Reads a PSF model with its singular values and header.
///
/// # Errors
/// [`IoErrorKind::Format`] for an unknown version of the layout or a missing table,
/// [`IoErrorKind::Header`] for a keyword that is missing or has a value of another type,
/// [`IoErrorKind::Axes`] if `NCOMP` and `CENTRED` do not match the cube, [`IoErrorKind::Table`] for
/// a column that is missing or has another format, [`IoErrorKind::Data`] for a value that is not
/// allowed, such as an unknown interpolation or a basis that is not orthonormal, and the
/// [errors of any FITS file](crate#bad-files).
pub fn read_model_file(path: impl AsRef<Path>) -> Result<ModelFile, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let hdu = &structure.hdus[0];
    let version = hdu.required::<i64>(
        VERSION_KEYWORD,
        "the version of a PSF model: a whole number above 0",
    )?;
    if !(1..=MODEL_VERSION).contains(&version) {
        let problem = format!(
            "this is a psf-model file of version {version}, but the newest version that this psfield reads is {MODEL_VERSION}: update psfield if the file is newer"
        );
        return Err(IoError::new(path, IoErrorKind::Format, problem));
    }
    let shape = stack_shape(hdu, "a cube of the mean and the basis stamps [plane, y, x]")?;
    let centred = hdu.optional_logical("CENTRED")?.unwrap_or(false);
    let rank = usize::try_from(hdu.required::<i64>("NCOMP", "the number of components")?)
        .ok()
        .filter(|&rank| rank.checked_add(usize::from(centred)) == Some(shape.0))
        .ok_or_else(|| hdu.axes_error("a cube of NCOMP planes (NCOMP + 1 if CENTRED is T)"))?;
    let interpolation = hdu.required_choice("INTERPOL", "the interpolation, such as natural-neighbour")?;
    let outside = hdu.required_choice("OUTSIDE", "nearest, extend or error")?;
    let normalisation = hdu.required_choice("NORMALIS", "unit or keep")?;
    let circle_error = hdu.optional::<f64>(CIRCLE_ERROR, "a number of at least 0")?;
    let table_of = hdu.optional::<String>(TABLE_OF, "the name of a method")?;
    let grid = stamp_grid(hdu, shape.2, shape.1)?;
    let field = field(hdu)?;

    let needed = "binary table COEFFS with the positions X and Y and the coefficients A of the samples";
    let table = Table::new(structure.needed_table(COEFFICIENTS, needed)?)?;
    let positions = read_positions_of(&table, path, field)?;
    let values = if rank == 0 {
        Vec::new()
    } else {
        table.read("A", rank)?
    };
    let values = Array2::from_shape_vec((table.rows, rank), values).expect("a row has NCOMP values");
    let coefficients = SampleCoefficients::new(values, positions).map_err(invalid(path))?;

    let planes = read_stack(hdu, shape)?;
    let mean = centred.then(|| planes.index_axis(Axis(0), 0).to_owned());
    // Moves the array instead of copying the components. With NCOMP = 0 the copy would have no
    // planes, which fails ndarray's debug assertions.
    let components = planes.slice_move(s![usize::from(centred).., .., ..]);
    let basis = PsfBasis::new(mean, components, grid).map_err(invalid(path))?;
    let wings = read_wings(&structure, coefficients.positions())?;
    let record = PsfModelRecord::new(basis, coefficients, interpolation, outside, normalisation)
        .map_err(invalid(path))?
        .with_circle_error(circle_error)
        .with_table_of(table_of)
        .with_wings(wings)
        .map_err(invalid(path))?;
    let singular_values = match structure.table(SINGULAR_VALUES) {
        Some(table) => Table::new(table)?.read("S", 1)?,
        None => Vec::new(),
    };
    Ok(ModelFile {
        record,
        singular_values,
        header: hdu.header.carried(),
    })
}

/// Reads the wings of a model, if it has any. `positions` are those of its samples.
fn read_wings(
    structure: &FitsStructure,
    positions: &SamplePositions,
) -> Result<Option<WingsRecord>, IoError> {
    let is_wings = |hdu: &&Hdu| hdu.name().is_some_and(|name| name == WINGS);
    let Some(hdu) = structure.hdus.iter().find(is_wings) else {
        return Ok(None);
    };
    let path = &structure.path;
    let shape = stack_shape(hdu, "a cube of the wings' stamps [mode, y, x]")?;
    let grid = stamp_grid(hdu, shape.2, shape.1)?;
    let needed = "binary table WINGCOEF with the coefficients B of the wings";
    let table = Table::new(structure.needed_table(WING_COEFFICIENTS, needed)?)?;
    let values = Array2::from_shape_vec((table.rows, shape.0), table.read("B", shape.0)?);
    let values = values.expect("a row has a value for each stamp");
    let coefficients = SampleCoefficients::new(values, positions.clone()).map_err(invalid(path))?;
    let wings = WingsRecord::new(read_stack(hdu, shape)?, coefficients, grid);
    wings.map(Some).map_err(invalid(path))
}

/// Writes a PSF model in the [`psf-model` layout](self).
///
/// `singular_values` may be empty. `added` cards are written to the primary header, before the
/// cards of the layout.
///
/// # Errors
/// [`IoErrorKind::Data`] for a singular value that is not finite, and the errors of
/// [`write_image`](crate::write_image).
pub fn write_model(
    path: impl AsRef<Path>,
    record: &PsfModelRecord,
    singular_values: &[f64],
    added: &[Card],
    overwrite: bool,
) -> Result<(), IoError> {
    let path = path.as_ref();
    if let Some(row) = singular_values.iter().position(|s| !s.is_finite()) {
        let got = singular_values[row].to_string();
        return Err(bad_value(path, Row::Index(row), "S (singular values)", &got));
    }
    let (basis, coefficients) = (record.basis(), record.coefficients());
    let (grid, positions, rank) = (basis.grid(), coefficients.positions(), basis.rank());
    let choices = [
        record.interpolation().to_string(),
        record.outside().to_string(),
        record.normalisation().to_string(),
    ];
    let [interpolation, outside, normalisation] = choices.map(CardValue::from);
    let of_interpolation = match record.interpolation() {
        Interpolation::NaturalNeighbour | Interpolation::InverseDistance { .. } => {
            "interpolation, on a tree of cells"
        }
        _ => "interpolation of the coefficients",
    };
    let centred = basis.mean().is_some();
    // Older versions of psfield read version 1.
    let version = match (record.wings(), positions.states()) {
        (Some(_), _) => 3,
        (None, Some(_)) => 2,
        (None, None) => 1,
    };
    let own = [
        (VERSION_KEYWORD, version.into(), "version of this layout"),
        ("NCOMP", rank.into(), "number of components"),
        ("CENTRED", centred.into(), "plane 0 is the mean stamp"),
        ("INTERPOL", interpolation, of_interpolation),
        ("OUTSIDE", outside, "policy outside the area of samples"),
        ("NORMALIS", normalisation, "normalisation of every PSF"),
    ];
    let circle_error = record.circle_error().map(|error| {
        (
            CIRCLE_ERROR,
            error.into(),
            "error of the flux in circles, relative",
        )
    });
    let table_of = record.table_of().map(|name| (TABLE_OF, name.into(), ""));
    let own = cards(path, own.into_iter().chain(circle_error).chain(table_of))?;
    let header = HeaderCards::new()
        .with(added)
        .with(&own)
        .with(&grid_cards(grid, positions.field()));
    let mean = basis.mean();
    let (mean_values, components) = (mean.iter().flatten(), basis.components());
    let planes: Vec<f64> = mean_values.chain(&components).copied().collect();
    let shape = [rank + usize::from(mean.is_some()), grid.ny(), grid.nx()];
    write_fits(path, overwrite, |fits| {
        write_image_hdu(fits, &shape, &planes, &header)?;
        let mut columns = position_columns(positions);
        if rank > 0 {
            columns.push(("A", format!("{rank}D")));
        }
        fits.create_table(COEFFICIENTS, positions.len(), &columns)?;
        write_positions_of(fits, positions)?;
        if rank > 0 {
            let values = coefficients.values();
            fits.write_column(
                columns.len(),
                values.as_slice().expect("coefficients are row-major"),
            )?;
        }
        if !singular_values.is_empty() {
            fits.create_table(SINGULAR_VALUES, singular_values.len(), &[("S", "D".to_owned())])?;
            fits.write_column(1, singular_values)?;
        }
        if let Some(wings) = record.wings() {
            let (modes, ny, nx) = wings.stamps().dim();
            let name = cards(path, [("EXTNAME", WINGS.into(), "wings of the PSF")])?;
            let header = HeaderCards::new()
                .with(&name)
                .with(&grid_cards(wings.grid(), None));
            let stamps = wings.stamps();
            let pixels = stamps.as_slice().expect("stamps are row-major");
            write_image_hdu(fits, &[modes, ny, nx], pixels, &header)?;
            let coefficients = wings.coefficients().values();
            fits.create_table(WING_COEFFICIENTS, positions.len(), &[("B", format!("{modes}D"))])?;
            fits.write_column(1, coefficients.as_slice().expect("coefficients are row-major"))?;
        }
        Ok(())
    })
}
