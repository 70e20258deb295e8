//! What goes wrong with PSF libraries.

use thiserror::Error;

/// Why a PSF library cannot be read, or why samples cannot be written as one.
///
/// It reaches the caller as the source of [`IoError::Library`](crate::IoError::Library), which names the file. HDUs, planes and
/// pixels are counted from 0.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum GriddedError {
    /// A card that must be there.
    #[error("HDU {hdu} has no card {keyword} ({expected})")]
    MissingCard {
        /// The HDU.
        hdu: usize,
        /// The keyword.
        keyword: String,
        /// What it would hold.
        expected: &'static str,
    },
    /// A card whose value is not what it must be.
    #[error("HDU {hdu}: card {keyword} must be {expected}, got {got}")]
    BadCard {
        /// The HDU.
        hdu: usize,
        /// The keyword.
        keyword: String,
        /// What it must be.
        expected: &'static str,
        /// What it is.
        got: String,
    },
    /// A card that is there more than once.
    #[error("HDU {hdu}: card {keyword} is there more than once: remove the wrong one")]
    DuplicateCard {
        /// The HDU.
        hdu: usize,
        /// The keyword.
        keyword: String,
    },
    /// A number of planes that is not the one that the header states.
    #[error(
        "HDU {hdu} holds {planes} planes, {what} says {stated}: the file is damaged or of another format"
    )]
    PlaneCount {
        /// The HDU.
        hdu: usize,
        /// Planes of the cube.
        planes: usize,
        /// The cards in question.
        what: &'static str,
        /// What they say.
        stated: String,
    },
    /// A plane that holds no light.
    #[error("plane {plane} has flux {flux}: a PSF must have positive flux")]
    PlaneFlux {
        /// The plane of the file's cube.
        plane: usize,
        /// Its flux.
        flux: f64,
    },
    /// Two of the lines of a grid at one place.
    #[error("HDU {hdu}: {first} and {second} are both {value}: grid positions must differ")]
    EqualLines {
        /// The HDU.
        hdu: usize,
        /// The earlier card.
        first: String,
        /// The later card.
        second: String,
        /// Their value.
        value: f64,
    },
    /// An order of planes that neither the version nor the date of the writer tells.
    #[error(
        "HDU {hdu}: the order of the planes cannot be told, since neither VERSION nor DATE says which writer made the file: \
         choose with --psf-order cards or --psf-order sorted"
    )]
    UnknownOrder {
        /// The HDU.
        hdu: usize,
    },
    /// Several detectors and no choice, or a choice that is not among them.
    #[error(
        "{}the file holds the detectors {}: choose one with --psf-detector",
        got.map(|n| format!("there is no detector {n}: ")).unwrap_or_default(), list(detectors)
    )]
    Detector {
        /// The choice, if there was one.
        got: Option<usize>,
        /// Number and name of each detector.
        detectors: Vec<(usize, String)>,
    },
    /// Several wavelengths and no choice.
    #[error(
        "there are PSFs for the wavelengths {wavelengths_um:?} micrometres: choose the nearest to yours with --psf-wavelength"
    )]
    WavelengthNeeded {
        /// The wavelengths.
        wavelengths_um: Vec<f64>,
    },
    /// A map of layers with a value that is no layer.
    #[error(
        "HDU {hdu}: the map says layer {got} at {index:?} (0-based, x last), there are the layers 0 to {last}"
    )]
    Layer {
        /// The HDU of the map.
        hdu: usize,
        /// The pixel `[y, x]` or the row of the map.
        index: Vec<usize>,
        /// Its value.
        got: f64,
        /// The last layer.
        last: usize,
    },
    /// A cube without positions.
    #[error("there are {planes} stamps without positions: give one for each with --psf-positions")]
    PositionsNeeded {
        /// Planes of the cube.
        planes: usize,
    },
    /// Positions that do not form a grid.
    #[error(
        "the {samples} samples lie on {columns} x {rows} grid lines and do not fill them: a gridded library needs a stamp at \
         every crossing; evaluate the PSF on a regular grid first"
    )]
    NotAGrid {
        /// Number of samples.
        samples: usize,
        /// Number of different x.
        columns: usize,
        /// Number of different y.
        rows: usize,
    },
    /// An oversampling that is not a whole number.
    #[error(
        "the stamps are {got} x oversampled: a gridded library needs a whole number; resample the PSF first"
    )]
    FractionalOversampling {
        /// The oversampling.
        got: f64,
    },
    /// A stamp whose reference point is not its middle.
    #[error(
        "the stamps are centred at index ({x}, {y}): a gridded library needs the middle, ({}, {})",
        middle.0, middle.1
    )]
    OffCentre {
        /// Column index of the reference point.
        x: f64,
        /// Row index of the reference point.
        y: f64,
        /// The middle of the stamp.
        middle: (f64, f64),
    },
    /// Stamps without the response of a pixel.
    #[error(
        "the stamps lack the response of a frame pixel, which a gridded library includes: apply it first"
    )]
    PixelResponseMissing,
    /// Stamps that continue otherwise than by a cubic spline.
    #[error(
        "the stamps continue by {got} between their pixels, readers of gridded libraries use a cubic spline: resample the PSF \
         first"
    )]
    StampInterpolation {
        /// The rule of the stamps.
        got: String,
    },
    /// Stamps that are too small for a cubic spline.
    #[error("the stamps have {nx} x {ny} pixels: readers of gridded libraries need at least 4 x 4")]
    SmallStamps {
        /// Columns.
        nx: usize,
        /// Rows.
        ny: usize,
    },
    /// A library that would be larger than any that is meant.
    #[error(
        "x and y of the samples differ, so that the library needs {planes} planes, more than {limit}: evaluate the PSF on a grid \
         with the same lines in x and y"
    )]
    TooManyPlanes {
        /// Planes that would be written.
        planes: usize,
        /// The most.
        limit: usize,
    },
}

fn list(detectors: &[(usize, String)]) -> String {
    let names: Vec<String> = detectors
        .iter()
        .map(|(n, name)| format!("{n} ({name})"))
        .collect();
    names.join(", ")
}
