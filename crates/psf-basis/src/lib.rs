//! Orthonormal PSF bases: SVD with elbow, energy, error and noise-edge rank selection
