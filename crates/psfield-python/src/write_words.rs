//! PSF files from Python.

use std::path::Path;

use psfield::convert::{SamplesAt, to_gridded, to_psfex, to_samples};
use psfield::psf_io::{self, Card, Precision};
use psfield::{Fit, PsfieldError, provenance_cards};
use pyo3::prelude::*;

use crate::error::{Failure, invalid};
use crate::kept_psf::KeptPsf;

/// What is written, by name.
#[derive(Debug, FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct WriteWords {
    format: String,
    /// Of PSFEx's polynomial.
    degree: Option<usize>,
    /// (ny, nx) of a grid of positions.
    at: Option<(usize, usize)>,
    /// Samples in double precision.
    double: bool,
    overwrite: bool,
}

/// The words of a file's HISTORY.
const HISTORY: &str = "psfield for Python";

impl WriteWords {
    /// Writes the file; returns what should be known of it.
    pub(crate) fn write(&self, path: &Path, psf: &KeptPsf) -> PyResult<Vec<String>> {
        let cards = provenance_cards(HISTORY);
        let notes = match self.format.as_str() {
            "psf-model" => self.model(path, psf, &cards),
            "psf-samples" => self.samples(path, psf, &cards),
            "psfex" => self.psfex(path, psf, &cards),
            "gridded" => self.gridded(path, psf, &cards),
            other => {
                return Err(invalid(format!(
                    "format must be psf-model, psf-samples, psfex or gridded, got {other}"
                )));
            }
        };
        Ok(notes.map_err(Failure::from)?)
    }

    fn model(&self, path: &Path, psf: &KeptPsf, cards: &[Card]) -> Result<Vec<String>, PsfieldError> {
        let singular_values = psf.fitted()?.map_or(&[][..], Fit::singular_values);
        psf_io::write_model(path, psf.record()?, singular_values, cards, self.overwrite)?;
        Ok(Vec::new())
    }

    fn samples(&self, path: &Path, psf: &KeptPsf, cards: &[Card]) -> Result<Vec<String>, PsfieldError> {
        let precision = if self.double {
            Precision::Double
        } else {
            Precision::Single
        };
        let samples = to_samples(psf.input().clone(), &samples_at(self.at))?;
        psf_io::write_samples(path, &samples, cards, precision, self.overwrite)?;
        Ok(Vec::new())
    }

    fn psfex(&self, path: &Path, psf: &KeptPsf, cards: &[Card]) -> Result<Vec<String>, PsfieldError> {
        let converted = to_psfex(psf.input().clone(), self.degree)?;
        psf_io::write_psfex(path, &converted.model, cards, self.overwrite)?;
        Ok(converted.notes)
    }

    fn gridded(&self, path: &Path, psf: &KeptPsf, cards: &[Card]) -> Result<Vec<String>, PsfieldError> {
        let converted = to_gridded(psf.input().clone(), &samples_at(self.at))?;
        psf_io::write_gridded(path, &converted.samples, cards, self.overwrite)?;
        Ok(converted.notes)
    }
}

/// A grid of (ny, nx) positions, or the PSF's own.
pub(crate) fn samples_at(at: Option<(usize, usize)>) -> SamplesAt {
    match at {
        Some((ny, nx)) => SamplesAt::Grid { nx, ny },
        None => SamplesAt::Own,
    }
}
