//! How a catalogue is to be understood.

use psf_types::DataError;

use crate::{CatalogColumns, HduChoice, SkyCoordinates};

/// How a catalogue is to be understood: its columns, the origin of its pixels, its magnitudes, its table.
///
/// ```
/// use psf_io::CatalogOptions;
/// // A catalogue as SExtractor writes it
/// let options = CatalogOptions::new()
///     .with_columns("x=X_IMAGE,y=Y_IMAGE,mag=MAG_AUTO".parse()?)
///     .with_one_based(true)
///     .with_zero_point(25.0)?;
/// # let _ = options;
/// # Ok::<(), psf_types::DataError>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct CatalogOptions {
    pub(crate) columns: CatalogColumns,
    pub(crate) one_based: bool,
    pub(crate) zero_point: Option<f64>,
    pub(crate) skip_invalid: bool,
    pub(crate) table: Option<HduChoice>,
    pub(crate) sky: Option<SkyCoordinates>,
}

impl CatalogOptions {
    /// The default columns, 0-based pixels, no zero point, no world coordinates, every row needed, the only table that fits.
    pub fn new() -> Self {
        Self::default()
    }

    /// With these columns.
    #[must_use]
    pub fn with_columns(self, columns: CatalogColumns) -> Self {
        Self { columns, ..self }
    }

    /// With positions in pixels counted from 1, as SExtractor's and those of FITS are (`true`), or from 0.
    #[must_use]
    pub fn with_one_based(self, one_based: bool) -> Self {
        Self { one_based, ..self }
    }

    /// With the magnitude of flux 1.
    ///
    /// # Errors
    /// [`DataError::Setting`] when it is not finite.
    pub fn with_zero_point(self, zero_point: f64) -> Result<Self, DataError> {
        if !zero_point.is_finite() {
            return Err(DataError::Setting {
                name: "the zero point",
                allowed: "a finite magnitude",
                got: zero_point.to_string(),
            });
        }
        Ok(Self {
            zero_point: Some(zero_point),
            ..self
        })
    }

    /// With the world coordinates of the frame, for catalogues of positions on the sky.
    #[must_use]
    pub fn with_sky(self, sky: SkyCoordinates) -> Self {
        Self {
            sky: Some(sky),
            ..self
        }
    }

    /// Whether rows that make no source (a position or flux that is missing or not finite, a galaxy out of range) are left out and counted
    /// (`true`), or errors.
    #[must_use]
    pub fn with_invalid_skipped(self, skip_invalid: bool) -> Self {
        Self { skip_invalid, ..self }
    }

    /// With this table of a FITS file.
    #[must_use]
    pub fn with_table(self, table: HduChoice) -> Self {
        Self {
            table: Some(table),
            ..self
        }
    }
}
