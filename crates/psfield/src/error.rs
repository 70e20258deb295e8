//! What can go wrong in the pipeline.

use std::error::Error;
use std::path::PathBuf;

use psf_io::FileKind;
use psf_types::{DataError, FrameShape};

/// Errors of the pipeline: those of its stages, and of what joins them.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PsfieldError {
    /// Data that break an invariant.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Making the basis failed.
    #[error(transparent)]
    Basis(#[from] psf_basis::BasisError),
    /// Interpolating the coefficients failed.
    #[error(transparent)]
    Interpolation(#[from] coeff_field::CoeffFieldError),
    /// The PSF has no value at a position.
    #[error(transparent)]
    Field(#[from] psf_types::FieldError),
    /// The convolution failed.
    #[error(transparent)]
    Convolution(#[from] conv_core::ConvError),
    /// A file could not be read or written.
    #[error(transparent)]
    Io(#[from] psf_io::IoError),
    /// A detector that cannot be, or what it cannot expose.
    #[error(transparent)]
    Detector(#[from] detector::DetectorError),
    /// A mask of bad pixels with values that are none.
    #[error("{}: this is no mask of bad pixels", path.display())]
    Mask {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: detector::DetectorError,
    },
    /// One file in two roles.
    #[error("{} would be written over another file of this run: choose another name", path.display())]
    SameFile {
        /// The file.
        path: PathBuf,
    },
    /// A header card that cannot be written.
    #[error(transparent)]
    Card(#[from] psf_io::CardError),
    /// A measurement failed that everything else needs.
    #[error(transparent)]
    Metrics(#[from] metrics::MetricsError),
    /// The stars of a frame gave no samples.
    #[error(transparent)]
    Stars(Box<psf_stars::StarError>),
    /// The frame is larger than the field over which the PSF is known.
    #[error(
        "the frame is {frame} pixels, but the PSF is known over a field of {field} pixels: cut the scene to the field \
         with a frame (--frame X0,Y0,NX,NY); light of the scene beyond it still comes in"
    )]
    FrameBeyondField {
        /// The frame.
        frame: FrameShape,
        /// The field of the PSF.
        field: FrameShape,
    },
    /// A method that cannot be read.
    #[error("the method must be auto, lowrank, basis, patch=N (N at least 1) or direct, got {got}")]
    BadMethod {
        /// What was given.
        got: String,
    },
    /// An option that the format of a PSF file does not know.
    #[error("{}: {option} is for {formats}; this file holds {kind}: leave it out", path.display())]
    ForeignOption {
        /// The file.
        path: PathBuf,
        /// What it holds.
        kind: FileKind,
        /// The option.
        option: &'static str,
        /// What the option is for.
        formats: &'static str,
    },
    /// A choice of the fit for a file that holds a model.
    #[error(
        "{}: this file holds {kind}: of the fit options only --outside and --normalise apply to it; leave the others out, or give \
         the samples",
        path.display()
    )]
    FitOfModel {
        /// The file.
        path: PathBuf,
        /// What it holds.
        kind: FileKind,
    },
    /// Something that a PSF file does not say, so that it must be chosen.
    #[error("{}: {kind} without {what}: give {option}", path.display())]
    MissingChoice {
        /// The file.
        path: PathBuf,
        /// What it holds.
        kind: FileKind,
        /// What it does not hold.
        what: &'static str,
        /// The option that says it.
        option: &'static str,
    },
    /// A polynomial model whose PSF has no light within the area that it was made for.
    #[error(
        "the PSF at {position} has flux {flux}: a model needs positive flux over the whole area that it was fitted to"
    )]
    DarkNode {
        /// Where.
        position: psf_types::Position,
        /// The flux there.
        flux: f64,
    },
    /// Something that a format cannot hold.
    #[error("{format} cannot hold {what}: {remedy}")]
    Unholdable {
        /// The format.
        format: &'static str,
        /// What it cannot hold.
        what: &'static str,
        /// What to do.
        remedy: &'static str,
    },
    /// A polynomial without a degree.
    #[error(
        "the source is no polynomial, whose degree could be taken: choose one, as in --to psfex=2 (a total degree in x and y, 0 to 10)"
    )]
    DegreeNeeded,
    /// Samples that leave a polynomial undetermined.
    #[error(
        "a polynomial of degree {degree} in x and y has {terms} terms, which {samples} samples at these positions do not determine: \
         choose a lower degree"
    )]
    PolynomialUndetermined {
        /// The total degree.
        degree: usize,
        /// Its terms.
        terms: usize,
        /// The samples.
        samples: usize,
    },
    /// A grid over a field that is not known.
    #[error(
        "the PSF is known along no more than a line, and its file says nothing of the field: a grid needs an area; give positions"
    )]
    NoExtent,
    /// A position outside the field over which the PSF is known.
    #[error(
        "position {index} (0-based) at {position} lies outside the field of {field} pixels over which the PSF is known"
    )]
    OutsideField {
        /// Index of the position.
        index: usize,
        /// The position.
        position: psf_types::Position,
        /// The field of the PSF.
        field: FrameShape,
    },
    /// No positions at all.
    #[error("there are no positions: at least one is needed")]
    NoPositions,
    /// A position that is there twice.
    #[error("positions {first} and {second} (0-based) are both {position}: remove one")]
    DuplicatePositions {
        /// Index of the first.
        first: usize,
        /// Index of the other.
        second: usize,
        /// The position.
        position: psf_types::Position,
    },
    /// Sub-pixel phases on a grid that is not the frame's.
    #[error("sub-pixel phases need the frame's own pixels: choose the native grid")]
    SubPixelNeedsNative,
    /// A stack of stamps that is larger than any that is meant.
    #[error("{stamps} stamps of {nx} x {ny} pixels would fill more than {} GiB: ask for fewer or smaller ones", limit >> 30)]
    TooLarge {
        /// Number of stamps.
        stamps: usize,
        /// Columns of each.
        nx: usize,
        /// Rows of each.
        ny: usize,
        /// The largest stack in bytes.
        limit: usize,
    },
    /// Scenes that are too fine.
    #[error("a scene may have 1 to {most} pixels along each side of a frame pixel, got {got} (--oversample)")]
    Oversample {
        /// What was given.
        got: usize,
        /// The most.
        most: usize,
    },
    /// A scene that holds no whole number of pixels of its image.
    #[error(
        "the scene is {shape} pixels, which is no multiple of --oversample {oversample}: cut it, or choose a part of it with --frame"
    )]
    UnevenScene {
        /// The scene, in its own pixels.
        shape: FrameShape,
        /// Scene pixels along each side of a pixel of the image.
        oversample: usize,
    },
    /// A scene without an image that is larger than any that is meant.
    #[error("shape: {nx} x {ny} pixels are too many")]
    SceneTooLarge {
        /// Columns asked for.
        nx: usize,
        /// Rows asked for.
        ny: usize,
    },
    /// A frame that reaches beyond the scene.
    #[error("frame: {source}")]
    FrameOffScene {
        /// Which, in pixels of the scene.
        source: DataError,
    },
    /// A frame so far off or so large that its pixels cannot be counted.
    #[error(
        "frame: {} x {} pixels at ({}, {}) lie off any scene",
        frame.shape().nx(), frame.shape().ny(), frame.x0(), frame.y0()
    )]
    FrameOffAnyScene {
        /// The frame, in pixels of the image.
        frame: psf_types::PixelRegion,
    },
    /// A source brighter than the working precision can tell.
    #[error("a flux of {flux:e} is beyond single precision: choose --precision f64")]
    FluxBeyondPrecision {
        /// Its flux.
        flux: f64,
    },
    /// A model with a coefficient field of the caller's own has stamps on other pixels.
    #[error(
        "the stamps of a model with a coefficient field of your own cannot be resampled: give stamps at the frame's pixels, \
         without oversample and stamp_size, or sample the model first"
    )]
    ModelNotResampled,
    /// A GPU was requested for a method without a plan.
    #[error("only the methods auto and lowrank run on a GPU: choose one of them, or the device cpu")]
    GpuNeedsPlan,
    /// A region of the frame asked of a method without a plan.
    #[error("a region of the frame can be made by the methods auto and lowrank alone: make the whole frame")]
    RegionNeedsPlan,
    /// The transpose asked of a method without a plan.
    #[error("the adjoint can be made by the methods auto and lowrank alone")]
    AdjointNeedsPlan,
    /// A stream asked of a method without a plan.
    #[error("rows can be streamed by the methods auto and lowrank alone")]
    StreamNeedsPlan,
    /// A device that cannot be read.
    #[error("device must be auto, cpu or gpu, got {got}")]
    BadDevice {
        /// What was given.
        got: String,
    },
    /// A GPU asked of a build without support of GPUs.
    #[error(
        "this psfield was built without support of GPUs: build it with its feature gpu (cargo build --release -p psfield-cli --features gpu)"
    )]
    NoGpuSupport,
    /// Sampling a PSF over its field failed.
    #[error(transparent)]
    Sampling(Box<psf_sample::SampleError>),
    /// A source has no PSF at a position.
    #[error(transparent)]
    Source(#[from] psf_types::SourceError),
    /// A telescope that cannot be.
    #[error(transparent)]
    Optics(#[from] psf_optics::OpticsError),
}

impl PsfieldError {
    /// Whether a GPU is to blame: what was handed to it is not to be used again.
    pub fn is_of_gpu(&self) -> bool {
        #[cfg(feature = "gpu")]
        let of_gpu = matches!(self, Self::Convolution(conv_core::ConvError::Gpu(_)));
        #[cfg(not(feature = "gpu"))]
        let of_gpu = matches!(self, Self::NoGpuSupport);
        of_gpu
    }
}

impl From<psf_sample::SampleError> for PsfieldError {
    fn from(error: psf_sample::SampleError) -> Self {
        Self::Sampling(Box::new(error))
    }
}

impl From<psf_stars::StarError> for PsfieldError {
    fn from(error: psf_stars::StarError) -> Self {
        Self::Stars(Box::new(error))
    }
}

/// An error with its causes in one line, `what: why: why that`. Errors that show their cause themselves repeat it in the chain; everything is
/// said once.
///
/// ```
/// use psfield::{Psf, error_text};
/// let error = Psf::open("no such file.fits").unwrap_err();
/// assert!(error_text(&error).starts_with("no such file.fits: cannot read the file: "));
/// ```
pub fn error_text(error: &dyn Error) -> String {
    let mut last = error.to_string();
    let mut all = last.clone();
    let mut cause = error.source();
    while let Some(error) = cause {
        let text = error.to_string();
        if !last.contains(&text) {
            all = format!("{all}: {text}");
            last = text;
        }
        cause = error.source();
    }
    all
}
