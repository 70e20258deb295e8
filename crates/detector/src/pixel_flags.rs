//! What is wrong with a pixel.

/// Flags of a pixel, as sums of these numbers in a `u8`: the values of quality images and of bad-pixel masks.
#[derive(Debug, Clone, Copy)]
pub struct PixelFlags;

impl PixelFlags {
    /// The pixel never holds charge.
    pub const DEAD: u8 = 1;
    /// The pixel has a dark current of its own.
    pub const HOT: u8 = 2;
    /// The pixel's column holds no charge.
    pub const BAD_COLUMN: u8 = 4;
    /// The pixel is at its full well or at the upper end of the converter. Of an exposure, not of the sensor.
    pub const SATURATED: u8 = 8;
    /// What belongs to the sensor.
    pub const BAD: u8 = Self::DEAD | Self::HOT | Self::BAD_COLUMN;
    /// All there are.
    pub const ALL: u8 = Self::BAD | Self::SATURATED;
    /// Without charge.
    pub(crate) const NO_CHARGE: u8 = Self::DEAD | Self::BAD_COLUMN;
}
