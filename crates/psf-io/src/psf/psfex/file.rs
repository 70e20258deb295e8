//! Reads and writes PSFEx models.

use std::path::Path;

use ndarray::Array3;

use super::{COLUMN, EXTENSION, PsfexAxis, PsfexFigures, PsfexModel, PsfexPolynomial};
use crate::error::{IoError, invalid};
use crate::fits::card::{Card, CardValue, padded};
use crate::fits::columns::Table;
use crate::fits::hdu::{Hdu, HduChoice, HduKind};
use crate::fits::header_cards::HeaderCards;
use crate::fits::image_out::{cards, in_single_precision, write_cards, write_fits};
use crate::fits::structure::{FitsStructure, PSF};

/// The part of a coordinate's name between its letter and `_IMAGE`. It names the method by which
/// SExtractor measures the position.
const POSITION_KINDS: [&str; 5] = ["", "WIN", "PSF", "PEAK", "MODEL"];

/// Returns whether a file holds PSFEx models.
pub(crate) fn is_psfex(structure: &FitsStructure) -> bool {
    structure.hdus.iter().any(holds_psf)
}

/// Returns whether a table is a PSFEx model, judged by its name or its column.
fn holds_psf(hdu: &Hdu) -> bool {
    let is = |keyword: &str, text: &str| {
        hdu.text(keyword)
            .is_some_and(|value| value.trim().eq_ignore_ascii_case(text))
    };
    hdu.kind == HduKind::BinaryTable
        && (is("EXTNAME", EXTENSION) || (is("TTYPE1", COLUMN) && hdu.header.get("POLNAXIS").is_some()))
}

/// Reads a PSFEx model in the [layout of PSFEx](super).
///
/// A file holds one model per image extension. `extension` chooses one of several models.
///
/// # Errors
/// [`IoErrorKind::Setting`](crate::IoErrorKind::Setting) for several models without a choice, or
/// for a choice that is none of them, [`Header`](crate::IoErrorKind::Header) for an unsupported
/// polynomial (see the [layout](super)), [`Table`](crate::IoErrorKind::Table) for a column that is
/// missing or has another format, [`Data`](crate::IoErrorKind::Data) for a value that is not finite
/// or out of range, and the [errors of any FITS file](crate#bad-files).
pub fn read_psfex(path: impl AsRef<Path>, extension: Option<&HduChoice>) -> Result<PsfexModel, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let hdu = chosen(&structure, extension)?;
    let table = Table::new(hdu)?;
    hdu.ensure(
        table.rows == 1,
        "NAXIS2",
        "must be 1, because the table of a PSFEx model has one row",
    )?;
    let polynomial = polynomial(path, hdu)?;
    let terms = PsfexPolynomial::term_count(polynomial.as_ref().map_or(0, PsfexPolynomial::degree));
    let (shape, values_per_row) = plane_shape(hdu, terms)?;
    check_dimensions(hdu, &table, shape)?;
    let values = table.read(COLUMN, values_per_row)?;
    let planes = Array3::from_shape_vec(shape, values).expect("as many values as the axes say");
    let sampling = hdu.required::<f64>("PSF_SAMP", SAMPLING)?;
    // The inverse of a smaller number above 0 may be infinite.
    if sampling < f64::MIN_POSITIVE {
        return Err(hdu.keyword_error("PSF_SAMP", SAMPLING));
    }
    let model = PsfexModel::new(planes, sampling, polynomial).map_err(invalid(path))?;
    Ok(model.with_figures(PsfexFigures {
        fwhm_px: hdu.optional_real("PSF_FWHM")?,
        loaded: hdu.optional("LOADED", COUNT)?,
        accepted: hdu.optional("ACCEPTED", COUNT)?,
        chi2: hdu.optional_real("CHI2")?,
    }))
}

const SAMPLING: &str = "the size of a pixel of the PSF in frame pixels, a number above 0";
const COUNT: &str = "a whole number";
const LENGTH: &str = "the length of an axis of PSF_MASK, a whole number above 0";
const TERMS: &str = "the number of terms of the polynomial, (d+1)(d+2)/2 for POLDEG1 = d";

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

/// The polynomial, or `None` for a constant PSF.
fn polynomial(path: &Path, hdu: &Hdu) -> Result<Option<PsfexPolynomial>, IoError> {
    const AXES: &str = "0 (a constant PSF) or 2 (a PSF that depends on x and y)";
    const GROUPS: &str = "1 (polynomials of several groups of coordinates are not supported)";
    const GROUP: &str = "1, the only group of coordinates";
    const DEGREE: &str = "the degree of the polynomial, 0 to 10";
    match hdu.required::<i64>("POLNAXIS", AXES)? {
        0 => return Ok(None),
        2 => {}
        more if more > 2 && hdu.header.get("POLNAME3").is_some() => {
            const THIRD: &str = "absent (PSFs that depend on more than the position are not supported)";
            return Err(hdu.keyword_error("POLNAME3", THIRD));
        }
        _ => return Err(hdu.keyword_error("POLNAXIS", AXES)),
    }
    if hdu.required::<i64>("POLNGRP", GROUPS)? != 1 {
        return Err(hdu.keyword_error("POLNGRP", GROUPS));
    }
    for keyword in ["POLGRP1", "POLGRP2"] {
        if hdu.optional(keyword, GROUP)?.unwrap_or(1_i64) != 1 {
            return Err(hdu.keyword_error(keyword, GROUP));
        }
    }
    let degree = usize::try_from(hdu.required::<i64>("POLDEG1", DEGREE)?)
        .ok()
        .filter(|&degree| degree <= PsfexPolynomial::MAX_DEGREE)
        .ok_or_else(|| hdu.keyword_error("POLDEG1", DEGREE))?;
    let (x, y) = (axis(path, hdu, &X_KEYWORDS)?, axis(path, hdu, &Y_KEYWORDS)?);
    PsfexPolynomial::new(x, y, degree)
        .map(Some)
        .map_err(invalid(path))
}

/// The cards of a coordinate: the keywords of its name, offset and scale, the first letter of its
/// name, and a text about the supported names for errors.
type AxisKeywords = ([&'static str; 3], char, &'static str);

const X_KEYWORDS: AxisKeywords = (
    ["POLNAME1", "POLZERO1", "POLSCAL1"],
    'X',
    "the column coordinate in pixels, such as X_IMAGE or XWIN_IMAGE (PSFs that depend on anything else are not supported)",
);
const Y_KEYWORDS: AxisKeywords = (
    ["POLNAME2", "POLZERO2", "POLSCAL2"],
    'Y',
    "the row coordinate in pixels, such as Y_IMAGE or YWIN_IMAGE (PSFs that depend on anything else are not supported)",
);

/// Reads a coordinate, which is 1-based in the file.
fn axis(path: &Path, hdu: &Hdu, keywords: &AxisKeywords) -> Result<PsfexAxis, IoError> {
    const OFFSET: &str = "the offset of a coordinate in pixels, a number";
    const SCALE: &str = "the scale of a coordinate in pixels, a number other than 0";
    let &([name_keyword, zero_keyword, scale_keyword], letter, expected) = keywords;
    let name = hdu.required::<String>(name_keyword, expected)?;
    let name = name.trim().to_ascii_uppercase();
    let kind = name
        .strip_prefix(letter)
        .and_then(|rest| rest.strip_suffix("_IMAGE"));
    if !kind.is_some_and(|kind| POSITION_KINDS.contains(&kind)) {
        return Err(hdu.keyword_error(name_keyword, expected));
    }
    let zero = hdu.required::<f64>(zero_keyword, OFFSET)?;
    let scale = hdu.required::<f64>(scale_keyword, SCALE)?;
    if scale == 0.0 {
        return Err(hdu.keyword_error(scale_keyword, SCALE));
    }
    PsfexAxis::new(&name, zero - 1.0, scale).map_err(invalid(path))
}

/// The shape `[term, y, x]` from the header, and the total number of values.
fn plane_shape(hdu: &Hdu, terms: usize) -> Result<((usize, usize, usize), usize), IoError> {
    const AXES: &str = "3 (columns, rows, terms), or 2 if the polynomial has one term";
    let axes = hdu.required::<i64>("PSFNAXIS", AXES)?;
    let (nx, ny) = (
        hdu.required_length("PSFAXIS1", LENGTH)?,
        hdu.required_length("PSFAXIS2", LENGTH)?,
    );
    match axes {
        3 if hdu.required_length("PSFAXIS3", TERMS)? != terms => {
            return Err(hdu.keyword_error("PSFAXIS3", TERMS));
        }
        2 if terms == 1 => {}
        3 => {}
        _ => return Err(hdu.keyword_error("PSFNAXIS", AXES)),
    }
    let count = nx
        .checked_mul(ny)
        .and_then(|pixels| pixels.checked_mul(terms))
        .ok_or_else(|| hdu.keyword_error("PSFAXIS1", "smaller (the planes would be larger than any file)"))?;
    Ok(((terms, ny, nx), count))
}

/// Checks that the dimensions of the column, if it states them, agree with the header.
fn check_dimensions(
    hdu: &Hdu,
    table: &Table<'_>,
    (terms, ny, nx): (usize, usize, usize),
) -> Result<(), IoError> {
    let number = table.column(COLUMN)?.number;
    let keyword = format!("TDIM{number}");
    let given = hdu.header.get(&keyword).is_some();
    let agrees = hdu
        .text(&keyword)
        .is_some_and(|text| folds_to(&text, &[nx, ny, terms]));
    hdu.ensure(agrees || !given, &keyword, "must be (PSFAXIS1,PSFAXIS2,PSFAXIS3)")
}

/// Returns whether `(a,b,...)` lists these lengths. Lengths of 1 at the end may be left out.
fn folds_to(text: &str, expected: &[usize]) -> bool {
    let lengths: Option<Vec<usize>> = text
        .trim()
        .strip_prefix('(')
        .and_then(|text| text.strip_suffix(')'))
        .and_then(|text| text.split(',').map(|n| n.trim().parse().ok()).collect());
    let trimmed = |lengths: &[usize]| {
        let kept = lengths.iter().rposition(|&n| n != 1).map_or(0, |last| last + 1);
        lengths[..kept].to_vec()
    };
    lengths.is_some_and(|lengths| trimmed(&lengths) == trimmed(expected))
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
