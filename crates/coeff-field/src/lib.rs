//! Interpolation of PSF coefficients over the field of view
