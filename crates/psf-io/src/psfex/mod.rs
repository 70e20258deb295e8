//! PSFEx models: the `.psf` files that PSFEx writes and SExtractor reads (E. Bertin 2011, ADASS XX, 435).
//!
//! # Layout
//!
//! An empty primary HDU, then a binary table of one row for each image extension that PSFEx has modelled, usually named
//! `PSF_DATA`:
//!
//! | in the table | meaning |
//! |---|---|
//! | column `PSF_MASK` | single-precision planes `[term, y, x]`, `TDIMn = (nx, ny, terms)` |
//! | `POLNAXIS` | 2, or 0 for a PSF that is the same everywhere |
//! | `POLNAME1`, `POLNAME2` | the coordinates: `X_IMAGE` and `Y_IMAGE`, or windowed ones (`XWIN_IMAGE` ...): 1-based pixels of the frame |
//! | `POLZEROi`, `POLSCALi` | their offset and scale |
//! | `POLNGRP`, `POLGRPi`, `POLDEG1` | one group of both coordinates, of total degree `POLDEG1` |
//! | `PSF_SAMP` | frame pixels a plane pixel: the stamps are `1 / PSF_SAMP` times oversampled |
//! | `PSFNAXIS`, `PSFAXIS1`, `PSFAXIS2`, `PSFAXIS3` | 3 axes: columns, rows, terms; 2 are enough where there is one term |
//! | `PSF_FWHM`, `LOADED`, `ACCEPTED`, `CHI2` | figures of PSFEx's own; optional |
//!
//! `h(u; x, y) = sum_t t(x, y) plane_t(u)` with `t = X^i Y^j`, `X = (x - POLZERO1) / POLSCAL1`, likewise `Y`, in the order
//! `for j in 0..=d, for i in 0..=d - j`: 1, X, X^2, Y, XY, Y^2 for degree 2.
//!
//! # Conventions
//! The PSF's reference point is the plane pixel `n / 2` (integer division), as in PSFEx. (GalSim takes the middle of the plane,
//! half a plane pixel away where `n` is even; [`write_psfex`] leaves planes as they are.) The response of a frame pixel is in the
//! values, which need not have unit flux. Between the pixels PSFEx's own tools use a Lanczos kernel, so the grid says
//! [`StampInterpolation::Lanczos3`](psf_types::StampInterpolation::Lanczos3). Positions are 1-based in the file and 0-based in
//! [`PsfexModel`].
//!
//! # What is refused
//! Polynomials in anything but the position (a magnitude, a colour, a header keyword), in one coordinate alone, or of several
//! groups: the error names the keyword.

mod model;
mod read;
mod write;

pub use model::{PsfexAxis, PsfexFigures, PsfexModel, PsfexPolynomial};
pub(crate) use read::is_psfex;
pub use read::read_psfex;
pub use write::write_psfex;

/// The usual name of the table.
const EXTENSION: &str = "PSF_DATA";
/// The column that holds the planes.
const COLUMN: &str = "PSF_MASK";
