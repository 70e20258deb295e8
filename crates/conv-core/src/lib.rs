//! Convolution of a scene with a PSF that varies over the field
