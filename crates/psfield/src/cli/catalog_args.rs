//! The options that say how a catalogue is to be understood.

use psf_io::{CatalogColumns, CatalogOptions};

/// Columns, origin and magnitudes of a catalogue.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Catalogue")]
pub(crate) struct CatalogArgs {
    /// Columns by what they mean, where they have other names: x, y (or ra, dec), flux (or mag), and for galaxies re, n, q, angle; as in
    /// x=X_IMAGE,y=Y_IMAGE,flux=FLUX_AUTO
    #[arg(long, value_name = "ROLE=COLUMN,...")]
    columns: Option<CatalogColumns>,
    /// Positions count from 1, as those of SExtractor and FITS do
    #[arg(long)]
    one_based: bool,
    /// The magnitude of flux 1, for catalogues with magnitudes
    #[arg(long, value_name = "MAG", allow_negative_numbers = true, value_parser = finite)]
    zero_point: Option<f64>,
    /// Leave out rows that make no source (a position or flux that is missing, a galaxy out of range), and count them
    #[arg(long)]
    skip_invalid: bool,
}

impl CatalogArgs {
    pub(crate) fn options(&self) -> anyhow::Result<CatalogOptions> {
        let mut options = CatalogOptions::new()
            .with_one_based(self.one_based)
            .with_invalid_skipped(self.skip_invalid);
        if let Some(columns) = &self.columns {
            options = options.with_columns(columns.clone());
        }
        if let Some(zero_point) = self.zero_point {
            options = options.with_zero_point(zero_point)?;
        }
        Ok(options)
    }

    /// The first option given.
    pub(crate) fn given(&self) -> Option<&'static str> {
        [
            ("--columns", self.columns.is_some()),
            ("--one-based", self.one_based),
            ("--zero-point", self.zero_point.is_some()),
            ("--skip-invalid", self.skip_invalid),
        ]
        .into_iter()
        .find_map(|(name, given)| given.then_some(name))
    }
}

fn finite(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err("a finite number is needed".to_owned()),
    }
}
