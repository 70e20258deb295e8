//! PSFEx models out.

use std::path::Path;

use super::{COLUMN, EXTENSION, PsfexModel};
use crate::card_text::padded;
use crate::error::bad_card;
use crate::new_fits::write_fits;
use crate::{Card, CardValue, HeaderCards, IoError};

/// Writes a PSFEx model in the [layout of PSFEx](super), which SExtractor and GalSim (`galsim.des.DES_PSFEx`) read.
///
/// Planes are stored in single precision, as PSFEx does; planes that were read from such a file come back bit by bit. `cards` go
/// to the header of the table, ahead of the layout's own. GalSim reads no model without a polynomial (`POLNAXIS = 0`);
/// SExtractor does.
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
/// [`IoError::Overflow`] for a value beyond single precision, [`IoError::Exists`] unless `overwrite`,
/// [`IoError::MissingDirectory`], or what the file system and CFITSIO report.
pub fn write_psfex(
    path: impl AsRef<Path>,
    model: &PsfexModel,
    cards: &[Card],
    overwrite: bool,
) -> Result<(), IoError> {
    let path = path.as_ref();
    let planes = model.planes();
    if planes.iter().any(|&value| (value as f32).is_infinite()) {
        return Err(IoError::Overflow {
            path: path.to_owned(),
        });
    }
    let (terms, ny, nx) = planes.dim();
    let header = HeaderCards::new().with(cards).with(&own_cards(path, model)?);
    let dimensions = padded(format!("{:<8}= '({nx}, {ny}, {terms})'", "TDIM1").as_bytes());
    write_fits(path, overwrite, |fits| {
        fits.create_table(EXTENSION, 1, &[(COLUMN, format!("{}E", planes.len()))])?;
        fits.write_record(&dimensions)?;
        for record in header.iter().flat_map(Card::records) {
            fits.write_record(record)?;
        }
        fits.write_column(1, planes.as_slice().expect("planes are row-major"))
    })
}

fn own_cards(path: &Path, model: &PsfexModel) -> Result<Vec<Card>, IoError> {
    let mut cards: Vec<(String, CardValue, &str)> = Vec::new();
    let mut add = |keyword: &str, value: CardValue, comment| cards.push((keyword.to_owned(), value, comment));
    let figures = model.figures();
    let counts = [
        ("LOADED", figures.loaded, "Number of loaded sources"),
        ("ACCEPTED", figures.accepted, "Number of accepted sources"),
    ];
    for (keyword, value, comment) in counts {
        if let Some(value) = value {
            add(keyword, value.into(), comment);
        }
    }
    if let Some(chi2) = figures.chi2 {
        add("CHI2", chi2.into(), "Final reduced chi2");
    }
    let axes = model
        .polynomial()
        .map(|polynomial| [polynomial.x(), polynomial.y()]);
    add(
        "POLNAXIS",
        axes.map_or(0, |axes| axes.len()).into(),
        "Number of context parameters",
    );
    for (i, axis) in axes.into_iter().flatten().enumerate() {
        let keyword = |stem: &str| format!("{stem}{}", i + 1);
        add(
            &keyword("POLGRP"),
            1.into(),
            "Polynom group for this context parameter",
        );
        add(
            &keyword("POLNAME"),
            axis.name().into(),
            "Name of this context parameter",
        );
        add(
            &keyword("POLZERO"),
            (axis.zero() + 1.0).into(),
            "Offset value for this context parameter",
        );
        add(
            &keyword("POLSCAL"),
            axis.scale().into(),
            "Scale value for this context parameter",
        );
    }
    if let Some(polynomial) = model.polynomial() {
        add("POLNGRP", 1.into(), "Number of context groups");
        add(
            "POLDEG1",
            polynomial.degree().into(),
            "Polynom degree for this context group",
        );
    } else {
        add("POLNGRP", 0.into(), "Number of context groups");
    }
    if let Some(fwhm) = figures.fwhm_px {
        add("PSF_FWHM", fwhm.into(), "PSF FWHM");
    }
    add(
        "PSF_SAMP",
        model.sampling().into(),
        "Sampling step of the PSF data",
    );
    let (terms, ny, nx) = model.planes().dim();
    add("PSFNAXIS", 3.into(), "Dimensionality of the PSF data");
    for (keyword, length) in [("PSFAXIS1", nx), ("PSFAXIS2", ny), ("PSFAXIS3", terms)] {
        add(keyword, length.into(), "Number of element along this axis");
    }
    cards
        .into_iter()
        .map(|(keyword, value, comment)| Card::new(&keyword, value, comment).map_err(bad_card(path)))
        .collect()
}
