//! Reads and writes PSFEx models.

use std::path::Path;

use ndarray::{Array3, s};

use super::contexts::Contexts;
use super::{COLUMN, EXTENSION, PsfexFigures, PsfexModel, rows};
use crate::error::{IoError, invalid};
use crate::fits::card::{Card, CardValue, padded};
use crate::fits::columns::{Nans, Table};
use crate::fits::hdu::{Hdu, HduChoice, HduKind};
use crate::fits::header_cards::HeaderCards;
use crate::fits::image_out::{cards, in_single_precision, write_cards, write_fits};
use crate::fits::structure::{FitsStructure, PSF};

/// Returns whether a file holds PSFEx models.
pub(crate) fn is_psfex(structure: &FitsStructure) -> bool {
    structure.hdus.iter().any(holds_psf)
}

/// Returns whether a table is a PSFEx model, judged by its name or its column, or holds such models in its
/// rows.
fn holds_psf(hdu: &Hdu) -> bool {
    let is = |keyword: &str, text: &str| {
        hdu.text(keyword)
            .is_some_and(|value| value.trim().eq_ignore_ascii_case(text))
    };
    let is_model = is("EXTNAME", EXTENSION) || (is("TTYPE1", COLUMN) && hdu.header.get("PSF_SAMP").is_some());
    (hdu.kind == HduKind::BinaryTable && is_model) || rows::has_models(hdu)
}

/// Reads a PSFEx model in the [layout of PSFEx](super), whose PSF depends on nothing but the position.
///
/// A file holds one model per image extension. `extension` chooses one of several models.
///
/// # Errors
/// The errors of [`read_psfex_at`].
pub fn read_psfex(path: impl AsRef<Path>, extension: Option<&HduChoice>) -> Result<PsfexModel, IoError> {
    read_psfex_at(path, extension, &[])
}

/// Reads a PSFEx model in the [layout of PSFEx](super). Of the other quantities on which its PSF depends
/// besides the position, `contexts` gives the values, by their names (`POLNAMEi`, such as `MAG_AUTO`).
///
/// A file holds one model per image extension, or one per row of a table (legacypipe). `extension` chooses
/// one of several models: an extension, or a row by its `CCDNAME` or its number from 0.
///
/// # Errors
/// [`IoErrorKind::Setting`](crate::IoErrorKind::Setting) for several models without a choice, for a choice that is none of them, for a
/// context without a value, or a value of no context, [`Header`](crate::IoErrorKind::Header) for an
/// unsupported polynomial (see the [layout](super)), [`Table`](crate::IoErrorKind::Table) for a column that
/// is missing or has another format, [`Data`](crate::IoErrorKind::Data) for a value that is not finite
/// or out of range, and the [errors of any FITS file](crate#bad-files).
pub fn read_psfex_at(
    path: impl AsRef<Path>,
    extension: Option<&HduChoice>,
    contexts: &[(String, f64)],
) -> Result<PsfexModel, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let of_table = structure.hdus.iter().find(|hdu| rows::has_models(hdu));
    let row;
    let (hdu, header, number) = if let Some(hdu) = of_table {
        row = rows::chosen(hdu, extension)?;
        (hdu, &row.0, row.1)
    } else {
        let hdu = chosen(&structure, extension)?;
        (hdu, hdu, 0)
    };
    let table = Table::new(hdu)?;
    hdu.ensure(
        table.rows == 1 || of_table.is_some(),
        "NAXIS2",
        "must be 1, because the table of a PSFEx model has one row",
    )?;
    let read = Contexts::read(path, header, contexts)?;
    let terms = read
        .exponents()
        .ok_or_else(|| header.keyword_error("POLDEG1", FEWER))?;
    let planes = planes(hdu, header, &table, terms.len(), (number, of_table.is_some()))?;
    let (planes, polynomial) = read.of_position(path, header, planes, &terms)?;
    let sampling = header.required::<f64>("PSF_SAMP", SAMPLING)?;
    // The inverse of a smaller number above 0 may be infinite.
    if sampling < f64::MIN_POSITIVE {
        return Err(header.keyword_error("PSF_SAMP", SAMPLING));
    }
    let model = PsfexModel::new(planes, sampling, polynomial).map_err(invalid(path))?;
    Ok(model.with_figures(PsfexFigures {
        fwhm_px: header.optional_real("PSF_FWHM")?,
        loaded: header.optional("LOADED", COUNT)?,
        accepted: header.optional("ACCEPTED", COUNT)?,
        chi2: header.optional_real("CHI2")?,
    }))
}

const SAMPLING: &str = "the size of a pixel of the PSF in frame pixels, a number above 0";
const COUNT: &str = "a whole number";
const LENGTH: &str = "the length of an axis of PSF_MASK, a whole number above 0";
const FEWER: &str = "smaller: the polynomial has more than 10000 terms";
const TERMS: &str = "the number of terms of the polynomial";

/// The table of the chosen PSFEx model. Without a choice, the file must hold one model.
fn chosen<'a>(structure: &'a FitsStructure, extension: Option<&HduChoice>) -> Result<&'a Hdu, IoError> {
    const WHAT: &str = "PSFEx models";
    if !is_psfex(structure) {
        return Err(structure.missing("binary table PSF_DATA with the column PSF_MASK of a PSFEx model"));
    }
    let is_meant = |hdu: &Hdu| holds_psf(hdu) && extension.is_none_or(|choice| choice.matches(hdu));
    match extension {
        Some(choice) if !structure.hdus.iter().any(is_meant) => {
            Err(structure.no_such(choice, PSF, WHAT, holds_psf))
        }
        _ => structure.only(WHAT, PSF, is_meant),
    }
}

/// The planes `[term, y, x]` in a row of the table. `header` states their axes, or else the column.
fn planes(
    hdu: &Hdu,
    header: &Hdu,
    table: &Table<'_>,
    terms: usize,
    (row, is_padded): (usize, bool),
) -> Result<Array3<f64>, IoError> {
    const AXES: &str = "3 (columns, rows, terms), or 2 if the polynomial has one term";
    const TOO_LARGE: &str = "smaller (the planes would be larger than any file)";
    let column = table.column(COLUMN)?;
    let dimensions = format!("TDIM{}", column.number);
    let given = hdu.header.get(&dimensions).is_some();
    let stored = hdu.text(&dimensions).and_then(|text| lengths(&text));
    let needed = "must be (columns, rows, terms)";
    hdu.ensure(stored.is_some() || !given, &dimensions, needed)?;
    let shape = match (&stored, header.optional::<i64>("PSFNAXIS", AXES)?) {
        (Some(stored), None) if stored.len() == terms.min(2) + 1 || stored.len() == 3 => {
            [stored[0], stored[1], stored.get(2).copied().unwrap_or(1)]
        }
        (_, None) => return Err(header.missing_keyword("PSFNAXIS", AXES)),
        (_, Some(axes)) => {
            if axes != 3 && !(axes == 2 && terms == 1) {
                return Err(header.keyword_error("PSFNAXIS", AXES));
            }
            let more = match axes {
                3 => header.required_length("PSFAXIS3", TERMS)?,
                _ => 1,
            };
            [
                header.required_length("PSFAXIS1", LENGTH)?,
                header.required_length("PSFAXIS2", LENGTH)?,
                more,
            ]
        }
    };
    if shape[2] != terms {
        let keyword = if header.header.get("PSFNAXIS").is_some() {
            "PSFAXIS3"
        } else {
            dimensions.as_str()
        };
        return Err(header.header_error(
            keyword,
            format!(
                "there are {} planes, but the polynomial has {terms} terms",
                shape[2]
            ),
        ));
    }
    // The planes of a table of models have the size of the largest ones, filled up with zeros.
    let room = match stored {
        Some(stored) if is_padded && stored.len() == 3 => [stored[0], stored[1], stored[2]],
        Some(stored) => {
            hdu.ensure(
                trimmed(&stored) == trimmed(&shape),
                &dimensions,
                "must be (PSFAXIS1,PSFAXIS2,PSFAXIS3)",
            )?;
            shape
        }
        None => shape,
    };
    hdu.ensure(
        (0..3).all(|axis| shape[axis] <= room[axis]),
        &dimensions,
        "is smaller than the planes",
    )?;
    let count = room
        .iter()
        .try_fold(1_usize, |product, &n| product.checked_mul(n))
        .ok_or_else(|| header.keyword_error("PSFAXIS1", TOO_LARGE))?;
    // Of several rows, only the values of the chosen one must be finite, which the model checks.
    let nans = if is_padded { Nans::Kept } else { Nans::Refused };
    let values = table.read_with(COLUMN, count, nans)?;
    let of_row = values[row * count..(row + 1) * count].to_vec();
    let all =
        Array3::from_shape_vec((room[2], room[1], room[0]), of_row).expect("as many values as the axes say");
    Ok(all.slice_move(s![..shape[2], ..shape[1], ..shape[0]]))
}

/// The lengths of `(a,b,...)`.
fn lengths(text: &str) -> Option<Vec<usize>> {
    let inner = text.trim().strip_prefix('(')?.strip_suffix(')')?;
    let numbers: Option<Vec<usize>> = inner.split(',').map(|n| n.trim().parse().ok()).collect();
    numbers.filter(|numbers| (2..=9).contains(&numbers.len()) && !numbers.contains(&0))
}

/// Lengths without those of 1 at the end.
fn trimmed(lengths: &[usize]) -> &[usize] {
    let kept = lengths.iter().rposition(|&n| n != 1).map_or(0, |last| last + 1);
    &lengths[..kept]
}

/// Writes a PSFEx model in the [layout of PSFEx](super), which SExtractor and GalSim
/// (`galsim.des.DES_PSFEx`) read.
///
/// Planes are stored in single precision, as in PSFEx. Planes that were read from a PSFEx file are
/// written back bit by bit. `added` cards are written to the header of the table, before the cards
/// of the layout. SExtractor reads a model without a polynomial (`POLNAXIS = 0`), but GalSim does
/// not.
///
/// ```
/// # let directory = tempfile::tempdir()?;
/// # let path = directory.path().join("field.psf");
/// use ndarray::Array3;
/// use psf_io::{PsfexAxis, PsfexModel, PsfexPolynomial, read_psfex, write_psfex};
/// let x = PsfexAxis::new("X_IMAGE", 511.5, 1024.0)?;
/// let y = PsfexAxis::new("Y_IMAGE", 511.5, 1024.0)?;
/// let planes = Array3::from_elem((3, 25, 25), 0.0625); // 1, X, Y
/// let model = PsfexModel::new(planes, 0.5, Some(PsfexPolynomial::new(x, y, 1)?))?;
/// write_psfex(&path, &model, &[], false)?;
/// assert_eq!(read_psfex(&path, None)?, model);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`IoErrorKind::Limit`](crate::IoErrorKind::Limit) for a value beyond single precision,
/// [`Header`](crate::IoErrorKind::Header) for a statistic that is not finite, and the errors of
/// [`write_image`](crate::write_image).
pub fn write_psfex(
    path: impl AsRef<Path>,
    model: &PsfexModel,
    added: &[Card],
    overwrite: bool,
) -> Result<(), IoError> {
    let path = path.as_ref();
    let planes = model.planes();
    in_single_precision(path, planes)?;
    let (terms, ny, nx) = planes.dim();
    let header = HeaderCards::new()
        .with(added)
        .with(&cards(path, own_cards(model))?);
    let dimensions = padded(format!("{:<8}= '({nx}, {ny}, {terms})'", "TDIM1").as_bytes());
    write_fits(path, overwrite, |fits| {
        fits.create_table(EXTENSION, 1, &[(COLUMN, format!("{}E", planes.len()))])?;
        fits.write_record(&dimensions)?;
        write_cards(fits, &header)?;
        fits.write_column(1, planes.as_slice().expect("planes are row-major"))
    })
}

/// Keyword, value and comment of each card of the layout.
fn own_cards(model: &PsfexModel) -> Vec<(&'static str, CardValue, &'static str)> {
    let mut list = Vec::new();
    let mut add = |keyword, value: Option<CardValue>, comment| {
        list.extend(value.map(|value| (keyword, value, comment)));
    };
    let (figures, polynomial) = (model.figures(), model.polynomial());
    let [loaded, accepted] = [figures.loaded, figures.accepted].map(|count| count.map(Into::into));
    add("LOADED", loaded, "Number of loaded sources");
    add("ACCEPTED", accepted, "Number of accepted sources");
    add("CHI2", figures.chi2.map(Into::into), "Final reduced chi2");
    let axes = polynomial.map(|polynomial| [polynomial.x(), polynomial.y()]);
    let count = axes.map_or(0, |axes| axes.len()).into();
    add("POLNAXIS", Some(count), "Number of context parameters");
    let keywords = [
        ["POLGRP1", "POLNAME1", "POLZERO1", "POLSCAL1"],
        ["POLGRP2", "POLNAME2", "POLZERO2", "POLSCAL2"],
    ];
    for ([group, name, zero, scale], axis) in keywords.into_iter().zip(axes.into_iter().flatten()) {
        let (offset, size) = ((axis.zero() + 1.0).into(), axis.scale().into());
        add(group, Some(1.into()), "Polynom group for this context parameter");
        add(name, Some(axis.name().into()), "Name of this context parameter");
        add(zero, Some(offset), "Offset value for this context parameter");
        add(scale, Some(size), "Scale value for this context parameter");
    }
    let degree = polynomial.map(|polynomial| polynomial.degree().into());
    let groups = i32::from(degree.is_some()).into();
    add("POLNGRP", Some(groups), "Number of context groups");
    add("POLDEG1", degree, "Polynom degree for this context group");
    add("PSF_FWHM", figures.fwhm_px.map(Into::into), "PSF FWHM");
    let sampling = model.sampling().into();
    add("PSF_SAMP", Some(sampling), "Sampling step of the PSF data");
    add("PSFNAXIS", Some(3.into()), "Dimensionality of the PSF data");
    let (terms, ny, nx) = model.planes().dim();
    for (keyword, length) in [("PSFAXIS1", nx), ("PSFAXIS2", ny), ("PSFAXIS3", terms)] {
        add(keyword, Some(length.into()), "Number of element along this axis");
    }
    list
}
