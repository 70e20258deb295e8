//! Writes PSF files in the formats of [`PsfFormat`].

use std::path::Path;

use psf_io::{Card, Precision};
use psf_types::StampGrid;

use super::{SamplesAt, to_gridded, to_psfex, to_samples};
use crate::error::PsfieldError;
use crate::fit::Fit;
use crate::psf::Psf;

/// The format of a PSF file, with its settings.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum PsfFormat {
    /// PSFs at positions.
    Samples {
        /// The positions.
        at: SamplesAt,
        /// The type of the pixels.
        precision: Precision,
    },
    /// A basis and its coefficients.
    Model,
    /// A PSFEx model.
    Psfex {
        /// Total degree in x and y. None: the degree of the PSF, if it is a polynomial model.
        degree: Option<usize>,
    },
    /// A gridded library, in the format that photutils reads.
    Gridded {
        /// The positions.
        at: SamplesAt,
    },
}

/// Contents of a file that [`Psf::write`] wrote.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Written {
    /// Number of stamps, components or polynomial terms in the file.
    pub planes: usize,
    /// The pixel grid of the stamps.
    pub grid: StampGrid,
    /// The largest relative L2 error of the file's polynomial or of the interpolation between its
    /// grid positions. None if the file has no such error.
    pub max_error: Option<f64>,
    /// Notes in plain sentences: changes by the conversion, and properties of the PSF that the file
    /// cannot hold.
    pub notes: Vec<String>,
}

impl Psf {
    /// Writes a PSF file, with `cards` added to its header.
    ///
    /// # Errors
    /// [`ErrorKind::Io`](crate::ErrorKind::Io) if the file cannot be written, if it exists and
    /// `overwrite` is false, or if its format cannot hold the stamps. Other errors are the errors
    /// of [`to_samples`], [`record`](Self::record), [`to_psfex`] or [`to_gridded`].
    pub fn write(
        &self,
        path: impl AsRef<Path>,
        format: &PsfFormat,
        cards: &[Card],
        overwrite: bool,
    ) -> Result<Written, PsfieldError> {
        let path = path.as_ref();
        let (planes, grid, max_error, notes) = match format {
            PsfFormat::Samples { at, precision } => {
                let samples = to_samples(self, at)?;
                psf_io::write_samples(path, &samples, cards, *precision, overwrite)?;
                (samples.len(), samples.grid(), None, Vec::new())
            }
            PsfFormat::Model => {
                let record = self.record()?;
                let singular_values = self.fit()?.map_or(&[][..], Fit::singular_values);
                psf_io::write_model(path, record, singular_values, cards, overwrite)?;
                let basis = record.basis();
                (basis.rank(), basis.grid(), None, Vec::new())
            }
            PsfFormat::Psfex { degree } => {
                let converted = to_psfex(self, *degree)?;
                psf_io::write_psfex(path, &converted.model, cards, overwrite)?;
                let (terms, grid) = (converted.model.planes().dim().0, converted.model.grid());
                (terms, grid, Some(converted.max_error), converted.notes)
            }
            PsfFormat::Gridded { at } => {
                let converted = to_gridded(self, at)?;
                let (samples, mut notes) = (converted.samples, converted.notes);
                let planes = psf_io::write_gridded(path, &samples, cards, overwrite)?;
                if planes > samples.len() {
                    notes.push(format!(
                        "the file holds {planes} planes for {} samples: some releases of photutils exchange x and y. \
                         All releases agree if both axes have the same coordinates, so planes were added for this, interpolated \
                         bilinearly. psfield reads only the samples back",
                        samples.len()
                    ));
                }
                (planes, samples.grid(), converted.max_error, notes)
            }
        };
        Ok(Written {
            planes,
            grid,
            max_error,
            notes,
        })
    }
}
