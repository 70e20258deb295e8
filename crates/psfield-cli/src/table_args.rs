//! Options for reading a table of sources or positions.

use std::path::Path;

use psf_io::{CatalogColumns, CatalogOptions, HduChoice};

use crate::UsageError;
use crate::context::GivenOptions;

/// The table in a file, the names of its columns, and the first index of its positions (0 or 1).
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct TableArgs {
    /// Names of the columns, as in x=X_IMAGE,y=Y_IMAGE
    ///
    /// Roles: x and y. A catalogue also has flux (or mag), and for galaxies re, n, q, angle, g1 and
    /// g2. In a catalogue, ra and dec may replace x and y, with pmra, pmdec, parallax,
    /// radial_velocity and epoch, and re_arcsec and pa_deg may replace re and angle.
    #[arg(long, value_name = "ROLE=COLUMN,...")]
    columns: Option<CatalogColumns>,
    /// Positions of the table count from 1, as in SExtractor and FITS
    #[arg(long)]
    one_based: bool,
    /// HDU of the table: its number (0: primary) or EXTNAME [default: the only table with the
    /// columns]
    #[arg(long, value_name = "N|NAME", hide_short_help = true)]
    table: Option<HduChoice>,
}

impl TableArgs {
    pub(crate) fn options(&self) -> CatalogOptions {
        let mut options = CatalogOptions::new().with_one_based(self.one_based);
        if let Some(columns) = &self.columns {
            options = options.with_columns(columns.clone());
        }
        match &self.table {
            Some(table) => options.with_table(table.clone()),
            None => options,
        }
    }

    /// Refuses these options if there is no table of positions.
    pub(crate) fn check(at: Option<&Path>, given: &GivenOptions) -> Result<(), UsageError> {
        match (at, given.of_group::<Self>().first()) {
            (None, Some(option)) => Err(UsageError(format!("{option} applies only to the table of --at"))),
            _ => Ok(()),
        }
    }
}
