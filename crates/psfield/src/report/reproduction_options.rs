//! How large a reproduction is.

use psf_types::FrameShape;

/// Sizes of a [`Reproduction`](super::Reproduction). Smaller ones run the same code on less.
#[derive(Debug, Clone, PartialEq)]
pub struct ReproductionOptions {
    /// The frame, over which the optics vary in the same way whatever its size; none: the telescope's own.
    pub frame: Option<FrameShape>,
    /// PSF samples along each axis.
    pub samples_across: usize,
    /// Objects along each axis.
    pub objects_across: usize,
    /// Tolerances of the fast engine; the default one is added where it is missing.
    pub tolerances: Vec<f64>,
    /// Sides of the images of Table 1.
    pub image_sides: Vec<usize>,
    /// Sides of patches.
    pub patches: Vec<usize>,
    /// Timed runs in Table 1.
    pub repeat: usize,
    /// Side of the image of the large galaxy.
    pub galaxy_side: usize,
    /// Interpolation error (relative L2) down to which the non-uniform sampling goes that is shown beside the uniform one.
    pub adaptive_threshold: f64,
    /// Chooses the light of Table 1 and the pixels compared.
    pub seed: u64,
}

impl ReproductionOptions {
    /// The paper's: 71 x 71 = 5041 samples, 54 x 54 = 2916 objects, the telescope's own frame.
    pub fn full() -> Self {
        Self {
            frame: None,
            samples_across: 71,
            objects_across: 54,
            tolerances: vec![1e-2, 1e-3, 1e-4, 1e-5],
            image_sides: vec![512, 1024],
            patches: vec![32, 64, 128, 256],
            repeat: 5,
            galaxy_side: 512,
            adaptive_threshold: 1e-3,
            seed: 1,
        }
    }

    /// The same on a frame of a quarter the side, with a quarter of the samples and a ninth of the objects.
    pub fn quick() -> Self {
        Self {
            frame: FrameShape::new(2308, 2304).ok(),
            samples_across: 36,
            objects_across: 18,
            repeat: 2,
            galaxy_side: 256,
            adaptive_threshold: 4e-3,
            ..Self::full()
        }
    }
}

impl Default for ReproductionOptions {
    fn default() -> Self {
        Self::full()
    }
}
