//! Finds the kind of a file.

use std::path::Path;

use crate::catalogue;
use crate::error::IoError;
use crate::fits::hdu::{Hdu, HduChoice, HduKind};
use crate::fits::image::squeezed;
use crate::fits::structure::{FitsStructure, is_fits};
use crate::psf::{model, psfex, samples, scopesim, stdpsf, stpsf};

/// The kind of a file, found from its content and never from its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FileKind {
    /// A PSF model: [`read_model`](crate::read_model).
    PsfModel,
    /// PSF samples: [`read_samples`](crate::read_samples).
    PsfSamples,
    /// PSFEx models: [`read_psfex`](crate::read_psfex).
    Psfex,
    /// A gridded PSF library of STPSF or WebbPSF: [`read_stpsf`](crate::read_stpsf).
    Stpsf,
    /// An STDPSF library: [`read_stdpsf`](crate::read_stdpsf).
    Stdpsf,
    /// A PSF of ScopeSim that varies over the field or with the wavelength:
    /// [`read_scopesim`](crate::read_scopesim).
    Scopesim,
    /// An image: [`read_image`](crate::read_image).
    Image,
    /// A stack of images without positions: [`read_cube`](crate::read_cube).
    Cube,
    /// A FITS table with the columns x and y: [`read_catalog`](crate::read_catalog),
    /// [`read_positions`](crate::read_positions).
    PointTable,
    /// A FITS file of another kind.
    OtherFits,
    /// Not a FITS file. It may be a text table.
    NotFits,
}

impl std::fmt::Display for FileKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::PsfModel => "a PSF model",
            Self::PsfSamples => "PSF samples",
            Self::Psfex => "a PSFEx model",
            Self::Stpsf => "an STPSF library",
            Self::Stdpsf => "an STDPSF library",
            Self::Scopesim => "a PSF of ScopeSim",
            Self::Image => "an image",
            Self::Cube => "a cube",
            Self::PointTable => "a table of positions",
            Self::OtherFits => "a FITS file of another kind",
            Self::NotFits => "not a FITS file",
        })
    }
}

/// A kind and the test for it.
type Test = (FileKind, fn(&FitsStructure) -> bool);

/// The most specific tests are first.
const TESTS: &[Test] = &[
    (FileKind::PsfModel, model::is_model),
    (FileKind::PsfSamples, samples::is_samples),
    (FileKind::Psfex, psfex::file::is_psfex),
    (FileKind::Stpsf, stpsf::is_stpsf),
    (FileKind::Stdpsf, stdpsf::is_stdpsf),
    (FileKind::Scopesim, scopesim::is_scopesim),
    (FileKind::Image, |structure| image_axes(structure) == Some(2)),
    (FileKind::Cube, |structure| image_axes(structure) == Some(3)),
    (FileKind::PointTable, catalogue::has_points),
];

/// Finds the kind of a file. A file that is cut short or compressed in an unsupported way is an
/// error.
///
/// # Errors
/// The [errors of any FITS file](crate#bad-files).
pub fn detect(path: impl AsRef<Path>) -> Result<FileKind, IoError> {
    detect_hdu(path, None)
}

/// Finds the kind of a file, as [`detect`] does. If [`detect`] would return an image or a cube, the
/// axes of the chosen image decide: two for an image, three for a cube, or else
/// [`FileKind::OtherFits`].
///
/// # Errors
/// The errors of [`detect`]. If [`detect`] would return an image or a cube, also
/// [`IoErrorKind::Setting`](crate::IoErrorKind::Setting) for a choice that is not an image with
/// pixels.
pub fn detect_hdu(path: impl AsRef<Path>, choice: Option<&HduChoice>) -> Result<FileKind, IoError> {
    let path = path.as_ref();
    if !is_fits(path)? {
        return Ok(FileKind::NotFits);
    }
    let structure = FitsStructure::scan(path)?;
    let kind = TESTS.iter().find(|(_, test)| test(&structure));
    let kind = kind.map_or(FileKind::OtherFits, |&(kind, _)| kind);
    if choice.is_none() || !matches!(kind, FileKind::Image | FileKind::Cube) {
        return Ok(kind);
    }
    Ok(match squeezed(structure.image(choice)?).len() {
        2 => FileKind::Image,
        3 => FileKind::Cube,
        _ => FileKind::OtherFits,
    })
}

/// Describes a FITS file that is a PSF of other software which psfield cannot read, and says how to use it.
/// `None` for any other file.
///
/// # Errors
/// The [errors of any FITS file](crate#bad-files).
pub fn foreign_psf(path: impl AsRef<Path>) -> Result<Option<&'static str>, IoError> {
    const PIFF: &str = "a PSF of Piff, which only Piff can evaluate: draw its stamps at a grid of positions (PSF.draw), \
                        and give psfield the stamps with their positions";
    const PS_FIELD: &str = "a psField file of SDSS: reconstruct its PSFs at a grid of positions (read_PSF), and give psfield \
                            the stamps with their positions";
    let structure = FitsStructure::scan(path.as_ref())?;
    let is_table = |hdu: &&Hdu| hdu.kind == HduKind::BinaryTable;
    let named = |wanted: fn(&str) -> bool| {
        let names = structure.hdus.iter().filter(is_table).filter_map(Hdu::name);
        names
            .into_iter()
            .any(|name| wanted(&name.trim().to_ascii_lowercase()))
    };
    if named(|name| matches!(name, "psf" | "piff")) && named(|name| name.contains('_')) {
        return Ok(Some(PIFF));
    }
    let eigen = |hdu: &Hdu| hdu.has_column("RROWS") && hdu.has_column("RNROW");
    Ok(structure.hdus.iter().any(eigen).then_some(PS_FIELD))
}

/// Number of axes of the first image. If there are more than two axes, axes of length 1 at the end
/// in FITS order (such as `NAXIS3 = 1`) are not counted.
fn image_axes(structure: &FitsStructure) -> Option<usize> {
    structure.first_image().ok().map(|hdu| squeezed(hdu).len())
}
