//! What a PSF file does not say of itself.

use psf_io::{FileKind, HduChoice, PlaneOrder};
use psf_types::Position;

/// What a PSF file does not say of itself, or leaves to be chosen. Each option is of some formats; to give one to a file of
/// another format is an error.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PsfFileOptions {
    /// Which of several models (PSFEx) or images (STPSF, STDPSF, a cube or a single stamp).
    pub extension: Option<HduChoice>,
    /// Which of several detectors (STDPSF).
    pub detector: Option<usize>,
    /// How positions belong to planes (STPSF).
    pub plane_order: Option<PlaneOrder>,
    /// The wavelength in micrometres, of several (ScopeSim).
    pub wavelength_um: Option<f64>,
    /// The size of a frame pixel in arcseconds (ScopeSim).
    pub pixel_scale_arcsec: Option<f64>,
    /// Where the centre of the field lies on the frame (ScopeSim).
    pub field_centre: Option<Position>,
    /// Where the planes of a cube belong.
    pub positions: Option<Vec<Position>>,
    /// Stamp pixels per frame pixel, of a cube or a single stamp.
    pub oversampling: Option<f64>,
    /// The stamps' reference point, a 0-based index that may be fractional, of a cube or a single stamp.
    pub centre: Option<Position>,
    /// Whether the pixel response is in the stamps, whatever the file says.
    pub pixel_response_included: Option<bool>,
}

impl PsfFileOptions {
    /// The first option given that a format does not know, and the formats that do.
    pub(crate) fn unknown_to(&self, kind: FileKind) -> Option<(&'static str, &'static str)> {
        use FileKind::{Cube, Image, Psfex, Scopesim, Stdpsf, Stpsf};
        const SCOPESIM: &str = "field-varying PSFs of ScopeSim";
        let table: [(bool, &[FileKind], &str, &str); 9] = [
            (
                self.extension.is_some(),
                &[Psfex, Stpsf, Stdpsf, Cube, Image],
                "--psf-extension",
                "PSFEx models, STPSF and STDPSF libraries, and plain stamps",
            ),
            (
                self.detector.is_some(),
                &[Stdpsf],
                "--psf-detector",
                "STDPSF libraries",
            ),
            (
                self.plane_order.is_some(),
                &[Stpsf],
                "--psf-order",
                "STPSF libraries",
            ),
            (
                self.wavelength_um.is_some(),
                &[Scopesim],
                "--psf-wavelength",
                SCOPESIM,
            ),
            (
                self.pixel_scale_arcsec.is_some(),
                &[Scopesim],
                "--pixel-scale",
                SCOPESIM,
            ),
            (
                self.field_centre.is_some(),
                &[Scopesim],
                "--field-centre",
                SCOPESIM,
            ),
            (
                self.positions.is_some(),
                &[Cube],
                "--psf-positions",
                "cubes without positions",
            ),
            (
                self.centre.is_some(),
                &[Cube, Image],
                "--psf-centre",
                "cubes and single stamps without a table POSITIONS",
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
