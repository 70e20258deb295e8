//! `psfield evaluate`.

use std::path::PathBuf;

use anyhow::Context as _;
use psfield::evaluate::{EvaluateOptions, OutputGrid};

use super::context::{Context, object, signature, with_option};
use super::values::{Precision, stamp_size};
use crate::files::OutputFile;
use crate::psf_args::{PsfArgs, notes_of};
use crate::table_args::TableArgs;

/// Write the PSF at given positions
#[derive(Debug, clap::Args)]
pub(crate) struct EvaluateArgs {
    /// PSF: a model, samples (which are fitted), or any PSF file that convert reads
    #[arg(value_name = "PSF")]
    psf: PathBuf,
    /// Positions: CSV or FITS table with columns x, y (0-based pixels)
    #[arg(long, value_name = "POSITIONS.csv")]
    at: PathBuf,
    #[command(flatten)]
    table: TableArgs,
    /// Stamps to write, in the layout of PSF samples
    #[arg(short, long, value_name = "STAMPS.fits")]
    output: OutputFile,
    /// Replace the output if it exists
    #[arg(long)]
    overwrite: bool,
    /// Pixels of the stamps (model: the model's own, native: the frame's)
    #[arg(long, default_value = "model", value_enum)]
    pixels: Grid,
    /// Cut or pad to N x N pixels around the centre [default: the stamp's own size]
    #[arg(long, value_name = "N", value_parser = stamp_size)]
    size: Option<usize>,
    /// Shift each PSF by the fractional part of its position (needs --pixels native)
    #[arg(long)]
    sub_pixel: bool,
    /// Precision of the stamps
    #[arg(long, default_value_t, value_enum)]
    precision: Precision,
    #[command(flatten)]
    fit: PsfArgs,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Grid {
    /// The model's own sampling
    Model,
    /// The frame's pixels, with the PSF integrated over the area of each
    Native,
}

impl EvaluateArgs {
    pub(crate) fn run(self, context: &Context) -> anyhow::Result<()> {
        if self.sub_pixel && matches!(self.pixels, Grid::Model) {
            return Err(super::UsageError("--sub-pixel needs --pixels native".to_owned()).into());
        }
        let positions = psf_io::read_positions_with(&self.at, &self.table.options())?;
        let psf = self.fit.open(&self.psf, context)?;
        let spinner = context.spinner("evaluating");
        psf.model()
            .with_context(|| format!("with the PSF of {}", self.psf.display()))?;
        let options = EvaluateOptions {
            grid: match self.pixels {
                Grid::Model => OutputGrid::Model,
                Grid::Native => OutputGrid::Native,
            },
            size: self.size,
            sub_pixel: self.sub_pixel,
        };
        if let Some(extrapolation) = psf.extrapolation(&positions) {
            context.warn(&with_option(&extrapolation, Some("outside")));
        }
        let stamps = psf
            .evaluate(positions, options)
            .with_context(|| format!("at the positions of {}", self.at.display()))?;
        psf_io::write_samples(
            &self.output,
            &stamps,
            &signature(),
            self.precision.into(),
            self.overwrite,
        )?;
        drop(spinner);
        let grid = stamps.grid();
        let report = object! {
            output: self.output,
            stamps: stamps.len(),
            shape: [grid.nx(), grid.ny()],
            oversampling: grid.oversampling(),
            // Notes on how the PSF was read.
            notes: notes_of(&psf),
        };
        context.report(&report, || {
            let [nx, ny] = report.shape;
            format!(
                "{}: {} stamps of {nx} x {ny} pixels",
                report.output.display(),
                report.stamps
            )
        })
    }
}
