//! Telescopes to start from.

use crate::Telescope;

/// The TOML text of [`Telescope::survey_2m`].
pub const SURVEY_2M_TOML: &str = include_str!("../presets/survey_2m.toml");

/// The TOML text of [`Telescope::wide_field_lens`].
pub const WIDE_FIELD_LENS_TOML: &str = include_str!("../presets/wide_field_lens.toml");

impl Telescope {
    /// A 2 m off-axis survey telescope in space, without obscuration, at 0.074 arcsec a pixel on 9232 x 9216 pixels (the
    /// size and sampling of the CSST survey camera; the aberrations are made up, not those of the instrument).
    ///
    /// The file is [`SURVEY_2M_TOML`].
    pub fn survey_2m() -> Self {
        Self::from_toml_str(SURVEY_2M_TOML).expect("the preset is valid")
    }

    /// An under-sampled wide-field lens on the ground: 180 mm aperture, 11.7 arcsec a pixel on 4096 x 4096 pixels (the
    /// class of the GWAC cameras; the aberrations are made up).
    ///
    /// The file is [`WIDE_FIELD_LENS_TOML`].
    pub fn wide_field_lens() -> Self {
        Self::from_toml_str(WIDE_FIELD_LENS_TOML).expect("the preset is valid")
    }
}
