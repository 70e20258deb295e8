//! Measurements of PSFs and images: Gaussian fits, adaptive moments, error norms
