//! What a plan is asked for.

use psf_types::Anchor;

use crate::{ConvError, ConvReal};

/// How tiles may be treated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Paths {
    /// Whatever is cheapest: transforms, the direct sum, single stamps, nothing.
    #[default]
    Cheapest,
    /// Transforms alone, wherever there is light.
    Transforms,
}

/// Tolerance, anchoring and limits of a [`Plan`](crate::Plan).
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
    anchor: Anchor,
    paths: Paths,
    memory_bytes: usize,
}

impl PlanOptions {
    /// What a plan keeps at most, unless told otherwise: 256 MiB.
    pub const DEFAULT_MEMORY_BYTES: usize = 256 << 20;
    /// The tolerance unless told otherwise.
    pub const DEFAULT_TOLERANCE: f64 = 1e-4;

    /// Options for a tolerance: the largest relative L2 error of the PSF that any single pixel sees,
    /// `|h_engine(.; x) - h(.; x)| <= tolerance |h(.; x)|`. At 0 every mode is kept that a tile has, up to rounding. The
    /// rounding of the working precision comes on top.
    ///
    /// # Errors
    /// [`ConvError::Tolerance`] unless it is a number of at least 0 and below 1.
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

    /// The same with another anchoring.
    #[must_use]
    pub fn with_anchor(self, anchor: Anchor) -> Self {
        Self { anchor, ..self }
    }

    /// The same with other paths.
    #[must_use]
    pub fn with_paths(self, paths: Paths) -> Self {
        Self { paths, ..self }
    }

    /// The same with another limit to the coefficients and stamps that the plan keeps. What does not fit is made anew by each
    /// execution, which takes time. Tiles are chosen with that in mind, so that another limit may give other tiles: the
    /// result differs by rounding and within the tolerance. The model, the modes (a few kB a block) and what threads work in (a few MB
    /// each; a spectrum for each mode of a tile) come on top.
    #[must_use]
    pub fn with_memory(self, bytes: usize) -> Self {
        Self {
            memory_bytes: bytes,
            ..self
        }
    }

    /// The tolerance.
    pub fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// The tolerance of plans in a working precision: errors of the PSF below it are rounding, and
    /// no mode is kept for them.
    pub(crate) fn tolerance_in<T: ConvReal>(&self) -> f64 {
        // A sixteenth of the precision in f32; in f64 the coordinates themselves are no better than a few times theirs.
        self.tolerance.max((T::epsilon().as_f64() / 16.0).max(1e-15))
    }

    /// The anchoring.
    pub fn anchor(&self) -> Anchor {
        self.anchor
    }

    /// The paths.
    pub fn paths(&self) -> Paths {
        self.paths
    }

    /// Bytes that the plan keeps at most.
    pub fn memory_bytes(&self) -> usize {
        self.memory_bytes
    }
}

impl Default for PlanOptions {
    fn default() -> Self {
        Self {
            tolerance: Self::DEFAULT_TOLERANCE,
            anchor: Anchor::default(),
            paths: Paths::default(),
            memory_bytes: Self::DEFAULT_MEMORY_BYTES,
        }
    }
}
