//! Options for reading a catalogue of sources.

use std::str::FromStr as _;

use psf_io::{CatalogOptions, ObservationDate};

use crate::table_args::TableArgs;
use crate::values::finite;

/// Options for the columns, positions and magnitudes of a catalogue.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Catalogue")]
pub(crate) struct CatalogArgs {
    #[command(flatten)]
    table: TableArgs,
    /// Magnitude of flux 1 (required with a column mag)
    ///
    /// flux = 10^(-0.4 (mag - MAG)).
    #[arg(long, value_name = "MAG", value_parser = finite)]
    zero_point: Option<f64>,
    /// Date of the frame, to which sources with proper motions and parallaxes move [default: that of
    /// the header of the scene or of --wcs]
    ///
    /// As in 2031-05-17 or 2031-05-17T12:00:00 (UTC), a Julian year as in 2031.25, or a modified
    /// Julian date as in 62700.5. The header states it by MJD-AVG, DATE-AVG, MJD-OBS or DATE-OBS.
    #[arg(long, value_name = "DATE", value_parser = ObservationDate::from_str, hide_short_help = true)]
    date: Option<ObservationDate>,
    /// Epoch of the catalogue's positions (Julian year) [default: the column epoch or ref_epoch]
    ///
    /// 2016 for Gaia DR3. Without an epoch and a date, sources do not move.
    #[arg(long, value_name = "YEAR", value_parser = finite, hide_short_help = true)]
    epoch: Option<f64>,
    /// Skip invalid rows and count them [default: an invalid row is an error]
    ///
    /// A row is invalid if position, flux, mag or re is missing, if flux is 0, or if dec, re, n, q,
    /// angle or the shear (g1, g2) is out of range. A negative flux is valid.
    #[arg(long, hide_short_help = true)]
    skip_invalid: bool,
}

impl CatalogArgs {
    pub(crate) fn options(&self) -> anyhow::Result<CatalogOptions> {
        let mut options = self.table.options().with_invalid_skipped(self.skip_invalid);
        if let Some(date) = self.date {
            options = options.with_date(date);
        }
        if let Some(epoch) = self.epoch {
            options = options.with_epoch(epoch);
        }
        Ok(match self.zero_point {
            Some(zero_point) => options.with_zero_point(zero_point)?,
            None => options,
        })
    }
}
