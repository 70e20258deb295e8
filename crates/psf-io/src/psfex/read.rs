//! PSFEx models in.

use std::path::Path;

use ndarray::Array3;

use super::{COLUMN, EXTENSION, PsfexAxis, PsfexFigures, PsfexModel, PsfexPolynomial};
use crate::columns::Table;
use crate::error::invalid;
use crate::hdu::Hdu;
use crate::structure::FitsStructure;
use crate::{CardValue, HduChoice, IoError};

/// The option of the command line that chooses an extension, for errors.
const OPTION: &str = "--psf-extension N|NAME";
/// What stands between the letter of a coordinate and `_IMAGE`: SExtractor's ways of measuring a position.
const POSITION_KINDS: [&str; 5] = ["", "WIN", "PSF", "PEAK", "MODEL"];

/// Whether a file holds PSFEx models.
pub(crate) fn is_psfex(structure: &FitsStructure) -> bool {
    structure.tables().any(holds_psf)
}

/// Whether a table is a PSFEx model, by its name or its column.
fn holds_psf(hdu: &Hdu) -> bool {
    let is = |keyword: &str, text: &str| {
        hdu.text(keyword)
            .is_some_and(|value| value.trim().eq_ignore_ascii_case(text))
    };
    is("EXTNAME", EXTENSION) || (is("TTYPE1", COLUMN) && hdu.header.get("POLNAXIS").is_some())
}

/// Reads a PSFEx model in the [layout of PSFEx](super).
///
/// `extension` chooses where the file holds several models, one an image extension.
///
/// # Errors
/// [`IoError::SeveralHdus`] when there are several models and no choice, [`IoError::NoSuchHdu`] for a choice that is none of
/// them, [`IoError::Keyword`] and [`IoError::MissingKeyword`] for what PSFEx's polynomials may not be (see the
/// [layout](super)), [`IoError::ColumnFormat`], [`IoError::Value`] for NaN, and the errors of any FITS file.
pub fn read_psfex(path: impl AsRef<Path>, extension: Option<&HduChoice>) -> Result<PsfexModel, IoError> {
    let path = path.as_ref();
    let structure = FitsStructure::scan(path)?;
    let hdu = chosen(&structure, extension)?;
    let table = Table::new(&structure, hdu)?;
    if table.rows() != 1 {
        return Err(hdu.header_error("NAXIS2", "the table of a PSFEx model has one row"));
    }
    let polynomial = polynomial(path, hdu)?;
    let terms = PsfexPolynomial::term_count(polynomial.as_ref().map_or(0, PsfexPolynomial::degree));
    let (shape, values_per_row) = plane_shape(hdu, terms)?;
    check_dimensions(hdu, &table, shape)?;
    let values = table.read(COLUMN, values_per_row)?;
    let planes = Array3::from_shape_vec(shape, values).expect("as many values as the axes say");
    let sampling = hdu.required_real("PSF_SAMP", SAMPLING)?;
    if sampling <= 0.0 {
        return Err(hdu.keyword_error("PSF_SAMP", SAMPLING));
    }
    let model = PsfexModel::new(planes, sampling, polynomial).map_err(invalid(path))?;
    Ok(model.with_figures(PsfexFigures {
        fwhm_px: hdu.optional_real("PSF_FWHM")?,
        loaded: hdu.optional_integer("LOADED", COUNT)?,
        accepted: hdu.optional_integer("ACCEPTED", COUNT)?,
        chi2: hdu.optional_real("CHI2")?,
    }))
}

const SAMPLING: &str = "the frame pixels that a pixel of the PSF spans, a number above 0";
const COUNT: &str = "a whole number";
const LENGTH: &str = "the length of an axis of PSF_MASK, a whole number above 0";
const TERMS: &str = "the number of terms of the polynomial, (d+1)(d+2)/2 for POLDEG1 = d";

/// The table meant.
fn chosen<'a>(structure: &'a FitsStructure, extension: Option<&HduChoice>) -> Result<&'a Hdu, IoError> {
    const WHAT: &str = "PSFEx models";
    let all: Vec<&Hdu> = structure.tables().filter(|hdu| holds_psf(hdu)).collect();
    if all.is_empty() {
        return Err(structure.missing("binary table PSF_DATA with the column PSF_MASK of a PSFEx model"));
    }
    let labels = |hdus: &[&Hdu]| hdus.iter().map(|hdu| hdu.described()).collect();
    let meant: Vec<&Hdu> = all
        .iter()
        .copied()
        .filter(|hdu| extension.is_none_or(|choice| choice.matches(hdu)))
        .collect();
    match (meant.as_slice(), extension) {
        (&[hdu], _) => Ok(hdu),
        (&[], Some(choice)) => Err(IoError::NoSuchHdu {
            path: structure.path.clone(),
            what: WHAT,
            wanted: choice.clone(),
            found: labels(&all),
        }),
        _ => Err(IoError::SeveralHdus {
            path: structure.path.clone(),
            what: WHAT,
            option: OPTION,
            found: labels(&meant),
        }),
    }
}

/// The polynomial; none where the PSF is the same everywhere.
fn polynomial(path: &Path, hdu: &Hdu) -> Result<Option<PsfexPolynomial>, IoError> {
    const AXES: &str = "0 (a PSF that is the same everywhere) or 2 (one that depends on x and y)";
    const GROUPS: &str = "1: polynomials of several groups of coordinates are not supported";
    const GROUP: &str = "1, the only group of coordinates";
    const DEGREE: &str = "the degree of the polynomial, 0 to 10";
    match hdu.required_integer("POLNAXIS", AXES)? {
        0 => return Ok(None),
        2 => {}
        more if more > 2 => {
            const THIRD: &str = "absent: PSFs that depend on more than the position are not supported";
            if hdu.header.get("POLNAME3").is_some() {
                return Err(hdu.keyword_error("POLNAME3", THIRD));
            }
            return Err(hdu.keyword_error("POLNAXIS", AXES));
        }
        _ => return Err(hdu.keyword_error("POLNAXIS", AXES)),
    }
    if hdu.required_integer("POLNGRP", GROUPS)? != 1 {
        return Err(hdu.keyword_error("POLNGRP", GROUPS));
    }
    for keyword in ["POLGRP1", "POLGRP2"] {
        if hdu
            .optional_integer(keyword, GROUP)?
            .is_some_and(|group| group != 1)
        {
            return Err(hdu.keyword_error(keyword, GROUP));
        }
    }
    let degree = hdu.required_integer("POLDEG1", DEGREE)?;
    let degree = usize::try_from(degree)
        .ok()
        .filter(|&degree| degree <= PsfexPolynomial::MAX_DEGREE)
        .ok_or_else(|| hdu.keyword_error("POLDEG1", DEGREE))?;
    let x = axis(
        path,
        hdu,
        ["POLNAME1", "POLZERO1", "POLSCAL1"],
        'X',
        "the column coordinate in pixels, X_IMAGE, XWIN_IMAGE or the like: PSFs that depend on anything else are not supported",
    )?;
    let y = axis(
        path,
        hdu,
        ["POLNAME2", "POLZERO2", "POLSCAL2"],
        'Y',
        "the row coordinate in pixels, Y_IMAGE, YWIN_IMAGE or the like: PSFs that depend on anything else are not supported",
    )?;
    PsfexPolynomial::new(x, y, degree)
        .map(Some)
        .map_err(invalid(path))
}

/// A coordinate; 1-based in the file.
fn axis(
    path: &Path,
    hdu: &Hdu,
    [name_keyword, zero_keyword, scale_keyword]: [&'static str; 3],
    letter: char,
    expected: &'static str,
) -> Result<PsfexAxis, IoError> {
    const OFFSET: &str = "the offset of a coordinate in pixels";
    const SCALE: &str = "the scale of a coordinate in pixels, a number other than 0";
    let name = hdu
        .optional_text(name_keyword, expected)?
        .ok_or_else(|| hdu.missing_keyword(name_keyword, expected))?;
    let name = name.trim().to_ascii_uppercase();
    let kind = name
        .strip_prefix(letter)
        .and_then(|rest| rest.strip_suffix("_IMAGE"));
    if !kind.is_some_and(|kind| POSITION_KINDS.contains(&kind)) {
        return Err(hdu.keyword_error(name_keyword, expected));
    }
    let zero = hdu.required_real(zero_keyword, OFFSET)?;
    let scale = hdu.required_real(scale_keyword, SCALE)?;
    if scale == 0.0 {
        return Err(hdu.keyword_error(scale_keyword, SCALE));
    }
    PsfexAxis::new(&name, zero - 1.0, scale).map_err(invalid(path))
}

/// `[term, y, x]` by the header, and the number of values in all.
fn plane_shape(hdu: &Hdu, terms: usize) -> Result<((usize, usize, usize), usize), IoError> {
    const AXES: &str = "3 (columns, rows, terms), or 2 where the polynomial has one term";
    let length = |keyword, expected| {
        usize::try_from(hdu.required_integer(keyword, expected)?)
            .ok()
            .filter(|&n| n > 0)
            .ok_or_else(|| hdu.keyword_error(keyword, expected))
    };
    let axes = hdu.required_integer("PSFNAXIS", AXES)?;
    let (nx, ny) = (length("PSFAXIS1", LENGTH)?, length("PSFAXIS2", LENGTH)?);
    match axes {
        3 if length("PSFAXIS3", TERMS)? != terms => return Err(hdu.keyword_error("PSFAXIS3", TERMS)),
        2 if terms == 1 => {}
        3 => {}
        _ => return Err(hdu.keyword_error("PSFNAXIS", AXES)),
    }
    let count = nx
        .checked_mul(ny)
        .and_then(|pixels| pixels.checked_mul(terms))
        .ok_or_else(|| hdu.keyword_error("PSFAXIS1", "small enough for the planes to be counted"))?;
    Ok(((terms, ny, nx), count))
}

/// Where the column says how its values are to be folded, it must say what the header says.
fn check_dimensions(
    hdu: &Hdu,
    table: &Table<'_>,
    (terms, ny, nx): (usize, usize, usize),
) -> Result<(), IoError> {
    table.column(COLUMN)?;
    let number = 1 + table
        .columns
        .iter()
        .position(|column| column.name.eq_ignore_ascii_case(COLUMN))
        .expect("the column is there");
    let keyword = format!("TDIM{number}");
    let Some(card) = hdu.header.get(&keyword) else {
        return Ok(());
    };
    let expected = [nx, ny, terms];
    let agrees = matches!(card.value(), Some(CardValue::Text(text)) if folds_to(&text, &expected));
    if agrees {
        Ok(())
    } else {
        Err(hdu.header_error(&keyword, "must be (PSFAXIS1,PSFAXIS2,PSFAXIS3)"))
    }
}

/// Whether `(a,b,...)` names these lengths, those of 1 at the end left out or not.
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
