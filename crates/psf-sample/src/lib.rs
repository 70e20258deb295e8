//! Uniform and non-uniform sampling of a PSF over the field of view
