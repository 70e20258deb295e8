//! What a PSF file does not say of itself.

use psf_io::{FileKind, HduChoice};
use psf_types::Position;

/// What a PSF file does not say of itself, or leaves to be chosen. Each option is of some formats; to give one to a file of
/// another format is an error.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PsfFileOptions {
    /// Which of several models (PSFEx).
    pub extension: Option<HduChoice>,
    /// Where the planes of a cube belong.
    pub positions: Option<Vec<Position>>,
    /// Stamp pixels per frame pixel, of a cube or a single stamp.
    pub oversampling: Option<f64>,
    /// Whether the pixel response is in the stamps, whatever the file says.
    pub pixel_response_included: Option<bool>,
}

impl PsfFileOptions {
    /// The first option given that a format does not know, and the formats that do.
    pub(crate) fn unknown_to(&self, kind: FileKind) -> Option<(&'static str, &'static str)> {
        use FileKind::{Cube, Image, Psfex};
        let table: [(bool, &[FileKind], &str, &str); 3] = [
            (
                self.extension.is_some(),
                &[Psfex],
                "--psf-extension",
                "PSFEx models",
            ),
            (
                self.positions.is_some(),
                &[Cube],
                "--psf-positions",
                "cubes without positions",
            ),
            (
                self.oversampling.is_some(),
                &[Cube, Image],
                "--psf-oversampling",
                "cubes and single stamps without a table POSITIONS",
            ),
        ];
        table
            .into_iter()
            .find(|(given, kinds, ..)| *given && !kinds.contains(&kind))
            .map(|(_, _, option, formats)| (option, formats))
    }
}
