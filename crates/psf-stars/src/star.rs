//! The pixels of one star.

/// A pixel about a star.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StarPixel {
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// Above the background.
    pub(crate) value: f64,
    /// Noise of the background.
    pub(crate) rms: f64,
    /// Part of its weight that it keeps: 0 where it is saturated or belongs to a neighbour, less than 1 for outliers.
    pub(crate) trust: f64,
}

/// A star that is to become a sample.
#[derive(Debug, Clone)]
pub(crate) struct Star {
    /// Index of its source.
    pub(crate) source: usize,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) flux: f64,
    /// What the background map is off by about it.
    pub(crate) offset: f64,
    pub(crate) pixels: Vec<StarPixel>,
}
