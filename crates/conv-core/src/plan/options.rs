//! Options of a plan.

use psf_types::{Anchor, FrameShape, PsfModel, ToleranceOn, Wings};

use crate::{ConvError, ConvReal};

/// The allowed methods for tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Paths {
    /// The cheapest method for each tile: transforms, the direct sum, or one stamp per lit pixel.
    /// Dark tiles are skipped.
    #[default]
    Cheapest,
    /// Only transforms. Dark tiles are skipped.
    Transforms,
}

/// Tolerance and the errors that it bounds, anchoring, methods for tiles and memory limit of a
/// [`Plan`](crate::Plan). A
/// [`SourcePlan`](crate::SourcePlan) uses these options too, except
/// for the methods for tiles.
///
/// ```
/// use conv_core::PlanOptions;
/// use psf_types::Anchor;
/// let options = PlanOptions::new(1e-3)?.with_anchor(Anchor::Output).with_memory(64 << 20);
/// assert_eq!(options.tolerance(), 1e-3);
/// assert!(PlanOptions::new(-1.0).is_err());
/// # Ok::<(), conv_core::ConvError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanOptions {
    tolerance: f64,
    tolerance_on: ToleranceOn,
    anchor: Anchor,
    paths: Paths,
    memory_bytes: usize,
    floor: f64,
}

impl PlanOptions {
    /// The default limit of the memory that a plan keeps: 256 MiB. Large frames and stamps need more
    /// ([`memory_for`](Self::memory_for)).
    pub const DEFAULT_MEMORY_BYTES: usize = 256 << 20;
    /// The default tolerance.
    pub const DEFAULT_TOLERANCE: f64 = 1e-4;

    /// Options for a tolerance: the largest relative L2 error of the PSF of any single pixel,
    /// `|h_engine(.; x) - h(.; x)| <= tolerance |h(.; x)|`. At 0 a tile keeps every mode above
    /// rounding. The rounding of the working precision is added to the error.
    /// [`with_tolerance_on`](Self::with_tolerance_on) chooses whether the tolerance also bounds the
    /// error of the flux in circles.
    ///
    /// # Errors
    /// [`ConvError::Tolerance`] unless the tolerance is a number of at least 0 and below 1.
    pub fn new(tolerance: f64) -> Result<Self, ConvError> {
        if (0.0..1.0).contains(&tolerance) {
            Ok(Self {
                tolerance,
                ..Self::default()
            })
        } else {
            Err(ConvError::Tolerance { got: tolerance })
        }
    }

    /// Sets the errors that the tolerance bounds. For [`ToleranceOn::Aperture`], the PSFs need a
    /// total flux: where positive and negative values nearly cancel, a tile keeps every mode above
    /// rounding.
    #[must_use]
    pub fn with_tolerance_on(self, tolerance_on: ToleranceOn) -> Self {
        Self { tolerance_on, ..self }
    }

    /// Sets the position at which the PSF is evaluated: source or output pixel.
    #[must_use]
    pub fn with_anchor(self, anchor: Anchor) -> Self {
        Self { anchor, ..self }
    }

    /// Sets the floor, in flux per pixel: light of stars and galaxies below it may be dropped. A source is drawn
    /// as far as its light exceeds the floor, and at least as far as the radius of 90 % of its light. How far
    /// depends on the source and the plan alone. [`SourcePlan::add_dropped_light`](crate::SourcePlan::add_dropped_light)
    /// says how much is dropped. At 0, the default, nothing is. Plans for images ignore it, and so do plans that
    /// draw stars from all components.
    ///
    /// # Errors
    /// [`ConvError::Floor`] unless the floor is a number of at least 0.
    pub fn with_floor(self, floor: f64) -> Result<Self, ConvError> {
        if floor >= 0.0 && floor.is_finite() {
            Ok(Self { floor, ..self })
        } else {
            Err(ConvError::Floor { got: floor })
        }
    }

    /// These options for the core of a PSF with wings, so that the errors of both together are within the
    /// tolerance. Its wings have at most the part [`Wings::LARGEST_NORM`] of the core's norm, and a plan of their
    /// own with the whole tolerance.
    #[must_use]
    pub fn beside_wings(self) -> Self {
        Self {
            tolerance: self.tolerance * (1.0 - Wings::LARGEST_NORM),
            ..self
        }
    }

    /// Sets the allowed methods for tiles.
    #[must_use]
    pub fn with_paths(self, paths: Paths) -> Self {
        Self { paths, ..self }
    }

    /// Limits the memory for the coefficients and stamps that the plan keeps. Each execution
    /// computes again the coefficients and stamps that do not fit, which takes time. The choice of
    /// tiles considers this time, so another limit may lead to other tiles. The result then differs
    /// within the tolerance. The limit does not include the model, the modes in compact form (a few
    /// kB per block) or the working memory of threads (a few MB each, with a spectrum for each mode
    /// of a tile, and up to 32 MiB for crowded stars).
    #[must_use]
    pub fn with_memory(self, bytes: usize) -> Self {
        Self {
            memory_bytes: bytes,
            ..self
        }
    }

    /// A limit for [`with_memory`](Self::with_memory) that follows from the work, so that it is the
    /// same on every machine: [`DEFAULT_MEMORY_BYTES`](Self::DEFAULT_MEMORY_BYTES), and room for two
    /// images of the frame and for the model's stamps, in the working precision `T`.
    pub fn memory_for<T: ConvReal>(frame: FrameShape, model: &PsfModel) -> usize {
        let stamps = model.stamp_count().saturating_mul(model.grid().pixel_count());
        let values = frame.pixel_count().saturating_mul(2).saturating_add(stamps);
        Self::DEFAULT_MEMORY_BYTES.saturating_add(values.saturating_mul(size_of::<T>()))
    }

    /// The tolerance.
    pub fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// The errors that the tolerance bounds.
    pub fn tolerance_on(&self) -> ToleranceOn {
        self.tolerance_on
    }

    /// The tolerance, but at least the rounding of the working precision `T`: no mode is kept for
    /// PSF errors that are only rounding.
    pub(crate) fn tolerance_in<T: ConvReal>(&self) -> f64 {
        self.tolerance.max(Self::rounding_in::<T>())
    }

    /// PSF errors up to this fraction are only rounding of the working precision `T`.
    pub(crate) fn rounding_in<T: ConvReal>() -> f64 {
        // The rounding is a sixteenth of epsilon in f32. In f64 it is 1e-15, because modes are
        // computed in f64, and the PSFs' coordinates are only accurate to a few epsilon.
        (T::epsilon().as_f64() / 16.0).max(1e-15)
    }

    /// The position at which the PSF is evaluated: source or output pixel.
    pub fn anchor(&self) -> Anchor {
        self.anchor
    }

    /// The floor, in flux per pixel ([`with_floor`](Self::with_floor)).
    pub fn floor(&self) -> f64 {
        self.floor
    }

    /// The allowed methods for tiles.
    pub fn paths(&self) -> Paths {
        self.paths
    }

    /// The largest number of bytes that the plan keeps ([`with_memory`](Self::with_memory)).
    pub fn memory_bytes(&self) -> usize {
        self.memory_bytes
    }
}

impl Default for PlanOptions {
    fn default() -> Self {
        Self {
            tolerance: Self::DEFAULT_TOLERANCE,
            tolerance_on: ToleranceOn::default(),
            anchor: Anchor::default(),
            paths: Paths::default(),
            memory_bytes: Self::DEFAULT_MEMORY_BYTES,
            floor: 0.0,
        }
    }
}
