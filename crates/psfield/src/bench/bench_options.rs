//! How contenders are measured.

use psf_types::Anchor;

/// How often contenders run and how their errors are measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BenchOptions {
    /// Whose PSF applies.
    pub anchor: Anchor,
    /// Timed turns of each contender, after a run that warms up; 0 counts as 1.
    pub repeat: usize,
    /// Random pixels at which images are compared with the direct sum; 0 counts as 1.
    pub pixels: usize,
    /// Chooses those pixels.
    pub seed: u64,
    /// The direct sum takes part only where its products (lit pixels x stamp pixels x stamps of the model) are not more.
    pub direct_products: f64,
}

impl BenchOptions {
    /// Products of the direct sum that take a few seconds.
    pub const DEFAULT_DIRECT_PRODUCTS: f64 = 2e9;
    /// Timed turns of each contender.
    pub const DEFAULT_REPEAT: usize = 3;
    /// Pixels compared.
    pub const DEFAULT_PIXELS: usize = 400;
    /// The seed.
    pub const DEFAULT_SEED: u64 = 1;
}

impl Default for BenchOptions {
    fn default() -> Self {
        Self {
            anchor: Anchor::default(),
            repeat: Self::DEFAULT_REPEAT,
            pixels: Self::DEFAULT_PIXELS,
            seed: Self::DEFAULT_SEED,
            direct_products: Self::DEFAULT_DIRECT_PRODUCTS,
        }
    }
}
