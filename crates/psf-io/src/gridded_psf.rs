//! A PSF library in memory.

use std::path::Path;

use ndarray::{Array3, Axis};
use psf_types::{Position, PsfSamples, SamplePositions, StampGrid};

use crate::error::{invalid, unsuitable};
use crate::hdu::Hdu;
use crate::image::squeezed;
use crate::{GriddedError, IoError};

/// PSFs at positions of one detector, as a library of [STPSF](crate::stpsf) or [STDPSF](crate::stdpsf) has them.
///
/// * [`samples`](Self::samples): positions are 0-based pixels of the detector. The stamps' reference point is the middle, index
///   `(n - 1) / 2`; the pixel response is in them; between their pixels they continue by the interpolating cubic spline; the
///   values are those of the file, not scaled to unit flux.
/// * The makers' own tools (photutils' `GriddedPSFModel`) interpolate bilinearly between the positions and take the nearest point
///   of the grid outside: [`Interpolation::Bilinear`](psf_types::Interpolation::Bilinear) with
///   [`OutsidePolicy::Nearest`](psf_types::OutsidePolicy::Nearest).
#[derive(Debug, Clone, PartialEq)]
pub struct GriddedPsf {
    samples: PsfSamples,
    detector: Option<String>,
    notes: Vec<String>,
}

/// What a reader has found.
pub(crate) struct Planes {
    /// `[sample, y, x]`.
    pub(crate) stamps: Array3<f64>,
    /// The plane of the file that each sample comes from.
    pub(crate) numbers: Vec<usize>,
    pub(crate) positions: Vec<Position>,
    pub(crate) oversampling: f64,
    pub(crate) detector: Option<String>,
    pub(crate) notes: Vec<String>,
}

impl GriddedPsf {
    pub(crate) fn new(path: &Path, planes: Planes) -> Result<Self, IoError> {
        let (_, ny, nx) = planes.stamps.dim();
        let grid = StampGrid::new(nx, ny)
            .and_then(|grid| grid.with_centre(middle(nx), middle(ny)))
            .and_then(|grid| grid.with_oversampling(planes.oversampling))
            .map_err(invalid(path))?;
        check_flux(path, &planes.stamps, grid, |sample| planes.numbers[sample])?;
        let positions = SamplePositions::new(planes.positions, None).map_err(invalid(path))?;
        Ok(Self {
            samples: PsfSamples::new(planes.stamps, positions, grid).map_err(invalid(path))?,
            detector: planes.detector,
            notes: planes.notes,
        })
    }

    /// The PSFs with their positions.
    pub fn samples(&self) -> &PsfSamples {
        &self.samples
    }

    /// The PSFs with their positions, without a copy.
    pub fn into_samples(self) -> PsfSamples {
        self.samples
    }

    /// The name of the detector, where the file tells it.
    pub fn detector(&self) -> Option<&str> {
        self.detector.as_deref()
    }

    /// What a user should know of how the file was read, in plain sentences: which order of planes or which detector was taken,
    /// which border rows are bad.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }
}

/// The middle of `n` pixels, as an index.
pub(crate) fn middle(n: usize) -> f64 {
    (n as f64 - 1.0) / 2.0
}

/// A cube's shape `(planes, ny, nx)`; an image is a cube of one plane.
pub(crate) fn cube_shape(hdu: &Hdu) -> Result<(usize, usize, usize), IoError> {
    match squeezed(hdu)[..] {
        [ny, nx] => Ok((1, ny, nx)),
        [planes, ny, nx] => Ok((planes, ny, nx)),
        _ => Err(hdu.axes_error("a cube of PSFs [plane, y, x]")),
    }
}

/// Refuses stamps without light, by the number of their plane in the file.
pub(crate) fn check_flux(
    path: &Path,
    stamps: &Array3<f64>,
    grid: StampGrid,
    plane: impl Fn(usize) -> usize,
) -> Result<(), IoError> {
    for (sample, stamp) in stamps.axis_iter(Axis(0)).enumerate() {
        let flux = grid.flux_of_sum(stamp.sum());
        if !(flux > 0.0 && flux.is_finite()) {
            let plane = plane(sample);
            return Err(unsuitable(path)(GriddedError::PlaneFlux { plane, flux }));
        }
    }
    Ok(())
}
